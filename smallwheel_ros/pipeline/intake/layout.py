# SPDX-License-Identifier: Apache-2.0
"""The widths of a vehicle's streams, and the rules for their stamps."""

from __future__ import annotations

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, VELOCITY, OnboardSettings

from .buffer import StampRules

WIDTHS = {"load": 1, "sinkage": 2, "drawbar_pull": 1, "wheel_speed": 1, "torque": 1, "steering": 1}
WIDTHS |= {ODOMETRY: 10, VELOCITY: 3, IMU: 8}
# s. What is measured at 5 Hz and more is interpolated; slower, wheel and ground change in between.
MAXIMUM_GAP = 0.2
_SILENT_AFTER = 1.0  # s: what has not come for so long is not waited for
_FUTURE_TOLERANCE = 0.5  # s: clocks of two computers that are set by NTP differ by less
_JUMP_TOLERANCE = 1.0  # s: what goes back by less is late, by more a bag that starts over


def width_of(stream: str) -> int:
    """Return the number of values in a row of a stream, given its name, such as `<wheel>/load` or `odom`."""
    return WIDTHS[stream.rpartition("/")[2]]


def widths_of(settings: OnboardSettings) -> dict[str, int]:
    """Return the number of values in a row of each stream that the vehicle uses, by name.

    The odometry of a vehicle that steers has one value more, its sideways speed: others move along their
    heading.
    """
    found = {name: width_of(name) for name in settings.streams}
    if settings.steered and ODOMETRY in found:
        found[ODOMETRY] += 1
    return found


def rules_of(settings: OnboardSettings) -> StampRules:
    """Return the rules for stamps, from the parameters `timing.*` and constants that hold for any vehicle."""
    timing = settings.timing
    waits = _SILENT_AFTER, timing.reorder_time, MAXIMUM_GAP, _JUMP_TOLERANCE
    clock = _FUTURE_TOLERANCE, timing.maximum_age
    return StampRules(*(round(each * SECOND) for each in (*waits, *clock)))
