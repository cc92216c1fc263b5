# SPDX-License-Identifier: Apache-2.0
"""The one reader of measurements: tables of steady single-wheel rows, with units and checks."""
