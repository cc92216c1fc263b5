# SPDX-License-Identifier: Apache-2.0
"""Decides which streams are doubted, and from which stamp on; learns how accurate sources of motion are."""
