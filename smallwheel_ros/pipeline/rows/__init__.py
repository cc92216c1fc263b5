# SPDX-License-Identifier: Apache-2.0
"""Believed measurements, assembled into a row for each wheel at each instant."""
