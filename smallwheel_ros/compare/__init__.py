# SPDX-License-Identifier: Apache-2.0
"""Laws side by side, on one table or on a folder of data that anybody may have, parts left out in turn.

A law of one's own is a class of about ten lines: `from smallwheel_ros.compare import Law, parameter`.
"""

from smallwheel_ros.compare.own_law import Law, parameter

__all__ = ["Law", "parameter"]
