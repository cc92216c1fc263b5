# SPDX-License-Identifier: Apache-2.0
"""The soil's strength from what the wheels pull."""
