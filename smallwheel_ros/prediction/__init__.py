# SPDX-License-Identifier: Apache-2.0
"""What a model says of one wheel or of a grid of settings, with deviations."""
