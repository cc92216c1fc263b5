# SPDX-License-Identifier: Apache-2.0
"""Slip of wheels, and its uncertainty."""

from __future__ import annotations

import numpy as np

from smallwheel_ros.onboard.settings import STANDSTILL_SPEED
from smallwheel_ros.pipeline.checks.believed import Trust
from smallwheel_ros.pipeline.tables import Array, Flags

_MOVES = 4.0  # deviations of a speed: one reading in 16,000 of what stands is beyond them
_RIM_STD = 0.01  # of a rim's speed: encoders are exact, the effective radius is known to 1 %
_HIDDEN = 0.3  # slip that an odometry computed from the wheels may hide; the twist assumes the same


def rim_std_of(rim: Array) -> Array:
    """Standard deviation of rim speeds, 1 % of their magnitude; in the unit and shape of the speeds."""
    return _RIM_STD * np.abs(rim)


def assembled_slip(
    speed: Array, speed_std: Array, rim: Array, trust: Trust
) -> tuple[Array, Array, Flags]:
    """Compute the slip of wheels from believed speeds, respecting what is known of the ground speed's source.

    Parameters
    ----------
    speed
        Speed over ground of the wheel's place along its heading, shape (rows,), m/s; NaN: unknown.
    speed_std
        Standard deviation of the speed, shape (rows,), m/s.
    rim
        Speed of the rim, shape (rows,), m/s; NaN: unknown.
    trust
        Whether the ground speed is, or may be, computed from the wheels: then slip is unknown, or uncertain
        by 0.3.

    Returns
    -------
    slip, slip_std : ndarray
        Slip, -1 to 1, and its standard deviation, shape (rows,); NaN where slip is not known.
    stands : ndarray
        Whether the wheel is known to stand, shape (rows,), bool.
    """
    rim_std = rim_std_of(rim)
    slip, slip_std, stands = slip_of(speed, speed_std, rim, rim_std, STANDSTILL_SPEED)
    # A rim that stops before a speed that is late, or has jumped, may stand as the vehicle does: there
    # the speed's deviation counts whole, and not by the share of it that the rim has left.
    skids = np.minimum(
        np.hypot(speed_std, rim_std) / np.maximum(np.abs(speed), STANDSTILL_SPEED), 1.0
    )
    slip_std = np.fmax(slip_std, np.where(np.abs(rim) < np.abs(speed), skids, _RIM_STD))
    slip_std = np.where(np.isfinite(slip), slip_std, np.nan)
    slip, slip_std = (np.where(trust.of_wheels, np.nan, each) for each in (slip, slip_std))
    # An odometry that may be computed from the wheels may hide slip.
    return slip, np.maximum(slip_std, np.where(trust.may_be, _HIDDEN, 0.0)), stands


def slip_of(
    speed: Array, speed_std: Array, rim: Array, rim_std: Array, standstill: float
) -> tuple[Array, Array, Flags]:
    """Compute the slip of wheels from their speeds over ground and those of their rims.

    i = 1 - v/(r omega) driven, r omega/v - 1 skidding. One of the two speeds must exceed `standstill` and
    four of its own deviations: otherwise the wheel counts as standing, and has no slip.

    Parameters
    ----------
    speed, speed_std
        Speed over ground and its standard deviation, shape (rows,), m/s.
    rim, rim_std
        Speed of the rim and its standard deviation, shape (rows,), m/s.
    standstill
        Speed up to which a wheel counts as standing, m/s.

    Returns
    -------
    slip, slip_std : ndarray
        Slip, -1 to 1, and its standard deviation, 0 to 1, shape (rows,); NaN where the wheel stands or a
        speed is unknown.
    stands : ndarray
        Whether both speeds are known and the wheel stands, shape (rows,), bool.
    """
    with np.errstate(all="ignore"):
        driven = np.abs(rim) >= np.abs(speed)
        base, other = np.where(driven, rim, speed), np.where(driven, speed, rim)
        base_std, other_std = (
            np.where(driven, rim_std, speed_std),
            np.where(driven, speed_std, rim_std),
        )
        known = np.isfinite(speed) & np.isfinite(rim)
        moves = (np.abs(rim) > np.maximum(standstill, _MOVES * rim_std)) | (
            np.abs(speed) > np.maximum(standstill, _MOVES * speed_std)
        )
        moves &= known
        ratio = other / base
        spread = np.hypot(other_std, ratio * base_std) / np.abs(base)
        slip = np.minimum(1.0, 1.0 - ratio)
        slip = np.where(moves, np.where(driven, slip, -slip), np.nan)
        return slip, np.where(moves, np.minimum(spread, 1.0), np.nan), known & ~moves
