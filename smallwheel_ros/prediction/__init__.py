# SPDX-License-Identifier: Apache-2.0
"""Predictions of a model for one wheel or a grid of settings, with deviations."""
