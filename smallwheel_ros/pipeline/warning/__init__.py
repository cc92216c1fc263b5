# SPDX-License-Identifier: Apache-2.0
"""The warning of getting stuck, and the margin of any ground."""
