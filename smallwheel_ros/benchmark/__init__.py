# SPDX-License-Identifier: Apache-2.0
"""The public measured benchmark: a table of laws on data that anybody may have, parts left out in turn.

A law of one's own is a class of about ten lines: `from smallwheel_ros.benchmark import Law, parameter`.
"""

from smallwheel_ros.benchmark.own import Law, parameter

__all__ = ["Law", "parameter"]
