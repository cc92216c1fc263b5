# SPDX-License-Identifier: Apache-2.0
"""Models against measurements, side by side."""
