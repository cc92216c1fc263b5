# SPDX-License-Identifier: Apache-2.0
"""Plots as plain data (layers.py), and pictures of results by matplotlib."""
