# SPDX-License-Identifier: Apache-2.0
"""Comparison of laws, on one table or on a folder of data sets, with parts left out in turn.

A law of your own is a class of about ten lines: `from smallwheel_ros.compare import Law, parameter`.
"""

from smallwheel_ros.compare.own_law import Law, parameter

__all__ = ["Law", "parameter"]
