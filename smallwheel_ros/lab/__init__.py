# SPDX-License-Identifier: Apache-2.0
"""Tests of a lab: plates, bevameter, shear; what they say together of one soil."""
