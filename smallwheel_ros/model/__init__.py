# SPDX-License-Identifier: Apache-2.0
"""Soil, geometry and effects together: a model, and its file."""
