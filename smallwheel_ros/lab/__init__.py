# SPDX-License-Identifier: Apache-2.0
"""Tests of a lab: plates, bevameter, shear; and their joint result for one soil."""
