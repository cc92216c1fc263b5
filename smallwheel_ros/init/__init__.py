# SPDX-License-Identifier: Apache-2.0
"""A parameter file to start from: out of a bag, a robot description or a number of wheels."""
