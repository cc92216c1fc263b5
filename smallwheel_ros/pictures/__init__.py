# SPDX-License-Identifier: Apache-2.0
"""Pictures; each function returns a matplotlib figure or writes one file."""
