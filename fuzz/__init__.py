# SPDX-License-Identifier: Apache-2.0
"""Inputs that nobody intended, by the hundred thousand: `make fuzz`."""
