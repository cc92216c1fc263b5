# SPDX-License-Identifier: Apache-2.0
"""A first parameter file, from a bag, a robot description or a number of wheels."""
