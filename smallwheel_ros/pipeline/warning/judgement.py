# SPDX-License-Identifier: Apache-2.0
"""Warnings, and the margin of any ground: readings in, warning and margin at each of them out.

    judged    each 0.1 s: hazard, its levels, and which wheels spin on the spot; each second: the margin

What holds at a row is that of its stamp, and does not depend on where blocks are cut.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from smallwheel_ros.common.stamps import NEVER, SECOND
from smallwheel_ros.costmap.terrain import SPINS
from smallwheel_ros.onboard.settings import (
    IMU,
    ODOMETRY,
    SLOWEST_RIM,
    VELOCITY,
    OnboardSettings,
)
from smallwheel_ros.pipeline.checks.believed import BelievedRows
from smallwheel_ros.pipeline.tables import Array, Columns, Flags, Integers, Readings

from .hazard import Instants, Warned, Warnings, level_at
from .margin import AnyGround, Margins

_SURELY = 2.0  # deviations of the speed over ground
_ASKED_STALE = 2 * SECOND  # ns that a risk holds: it is known some tenths after its second


@dataclass(frozen=True)
class Judged(Columns):
    """Warning and margin of the ground at each row; arrays of shape (rows,).

    The margin is that by slip and accelerometer alone, without knowledge of the soil (`AnyGround`).

    Attributes
    ----------
    level
        Level of the warning: 0, 1 (may get stuck) or 2 (gets stuck).
    spins
        Whether the wheel rolls while the rims turn and the vehicle surely gets nowhere.
    margin, margin_std
        Mean margin of ground ahead and its standard deviation, 1, from `GroundMargin.moments`.
    median, lower_std, beyond
        Belief about ground ahead as given by `GroundMargin.ahead`, 1.
    asked
        Pull over load that the last metre has required, and that the next is taken to require, 1; NaN if
        unknown.
    risk
        Probability, 0 to 1, that ground ahead does not give `asked` at any slip; NaN if unknown.
    """

    level: Integers
    spins: Flags
    margin: Array
    margin_std: Array
    median: Array
    lower_std: Array
    beyond: Array
    asked: Array
    risk: Array


class Judgement:
    """Warnings and the margin of any ground (see `margin`) for one vehicle.

    Attributes
    ----------
    warnings
        Computes the warning.
    ground
        Computes the margin.
    warned
        State of the warning in the newest turn of the pipeline; None if no tenth of a second has ended.
    instants
        The instants of `warned`, or None.
    stuck
        Whether the rims turn and the vehicle does not move at each of the newest instants, (instants,).
    """

    def __init__(self, settings: OnboardSettings) -> None:
        self.settings = settings
        self.warnings = Warnings(settings.wheels, IMU in settings.streams, settings.gravity)
        self.ground = AnyGround(self.warnings.side, settings.reference_slip, settings.gravity)
        self.warned: Warned | None = None
        self.instants: Instants | None = None
        self.stuck: Flags = np.empty(0, dtype=bool)
        self._speed_is = (
            VELOCITY
            if VELOCITY in settings.streams
            else ODOMETRY
            if settings.velocity != "none"
            else ""
        )
        self._spinning: tuple[Integers, Flags] = np.empty(0, dtype=np.int64), np.empty((0, 0), bool)
        self._levels: tuple[Integers, Integers] = np.array([NEVER]), np.zeros(1, dtype=np.int64)
        self._margins: Margins | None = None
        self._slip = np.nan
        self._of_wheels = False  # whether the odometry is known to be computed from the wheels
        self._anew: list[int] = []  # stamps from which on what was learnt of the ground is dropped

    # --- Warning and margin

    def take(self, rows: Readings, believed: BelievedRows) -> Judged:
        """Process new readings, and update `warned`, `instants` and `stuck`.

        Parameters
        ----------
        rows
            New readings, in order of stamps.
        believed
            The believed rows that they were assembled from.

        Returns
        -------
        Judged
            Warning and margin at each reading.
        """
        rows = self._by_ground(rows, believed)
        self._anew += believed.motion_anew()
        speeds, imu = believed.new(self._speed_is)[0], believed.new_imu()
        made = self.warnings.take(rows, speeds, imu if imu[0].size else None, believed.done)
        self.warned = self.instants = None
        if made is not None:
            instants, self.warned = made
            self.instants = instants
            self._slip = float(self.warned.slip[-1])
            self._levels = _carried(self._levels, self.warned.stamp, self.warned.level)
            self._spin(instants.stamp.size)
            margins = self.ground.take(instants, self._anew)
            self._anew = []
            if margins is not None:
                # The margin of a second holds from the first instant after that second.
                behind = np.searchsorted(instants.stamp, margins.stamp, side="right")
                margins = replace(margins, stamp=instants.stamp[behind])
                old = self._margins
                self._margins = margins if old is None else Margins.joined([old, margins])
        found = self._at(rows)
        self._levels = self._levels[0][-1:], self._levels[1][-1:]
        self._spinning = self._spinning[0][-1:], self._spinning[1][-1:]
        if self._margins is not None:
            self._margins = self._margins.take(slice(-1, None))
        return found

    def _by_ground(self, rows: Readings, believed: BelievedRows) -> Readings:
        """Readings with NaN for ground speeds that are computed from the wheels, and so show no slip."""
        of_wheels = believed.trust(rows.stamp).of_wheels
        if not of_wheels.any():
            return rows
        if not self._of_wheels:
            self._of_wheels = True
            self._anew.append(int(rows.stamp[np.argmax(of_wheels)]))
        return replace(
            rows,
            speed=np.where(of_wheels, np.nan, rows.speed),
            vehicle_speed=np.where(of_wheels, np.nan, rows.vehicle_speed),
        )

    @property
    def slip(self) -> float:
        """Slip of the middle wheel at the newest instant, 1; NaN where it is not judged."""
        return self._slip

    @property
    def level(self) -> int:
        """Present level of the warning: 0, 1 or 2."""
        return int(self._levels[1][-1])

    def _spin(self, count: int) -> None:
        """Update `stuck` by `count` new instants: whether the vehicle surely stays while its rims turn.

        Each is judged by the second before it. The vehicle is judged as a whole, since one that is stuck may
        spin two wheels on a diagonal while the others stand. One whose rims stand, or drive both ways as in a
        turn on the spot, is not stuck. Surely means by two deviations of the speed over ground, whose error
        lasts for the whole second.
        """
        whole = self.warnings.done
        assert whole is not None
        spins = np.zeros((count, whole.rim.shape[1]), dtype=bool)
        first = whole.stamp.size - count
        for k in range(count):
            end = first + k + 1
            begin = int(np.searchsorted(whole.stamp, whole.stamp[end - 1] - SECOND, side="right"))
            part = slice(begin, end)
            spins[k] = end - begin >= 10 and _gets_nowhere(
                whole.rim[part], whole.ground[part], whole.ground_std[part]
            )
        self.stuck = np.asarray(spins.any(axis=1))
        before, flags = self._spinning
        flags = flags if flags.shape[1] else np.zeros((0, spins.shape[1]), dtype=bool)
        self._spinning = np.concatenate([before, whole.stamp[first:]]), np.vstack([flags, spins])

    def _at(self, rows: Readings) -> Judged:
        count = rows.stamp.size
        level = level_at(*self._levels, rows.stamp)
        spins = np.zeros(count, dtype=bool)
        stamps, flags = self._spinning
        if stamps.size:
            order = np.full(len(self.settings.wheels), -1)
            order[self.warnings.rolling] = np.arange(self.warnings.rolling.size)
            place = np.searchsorted(stamps, rows.stamp, side="right") - 1
            fresh = (place >= 0) & (order[rows.wheel] >= 0)
            spins[fresh] = flags[place[fresh], order[rows.wheel[fresh]]]
        margin, margin_std, median, lower_std, beyond, asked, risk = np.full((7, count), np.nan)
        margins = self._margins
        if margins is None:
            margin[:], margin_std[:] = self.ground.ground.moments()
            median[:], lower_std[:], beyond[:] = self.ground.ground.ahead()
        else:
            place = np.searchsorted(margins.stamp, rows.stamp, side="right") - 1
            at = np.maximum(place, 0)
            fresh = (place >= 0) & (rows.stamp - margins.stamp[at] <= _ASKED_STALE)
            margin, margin_std = margins.margin[at], margins.margin_std[at]
            median, lower_std = margins.median[at], margins.lower_std[at]
            beyond = margins.beyond[at]
            asked[fresh], risk[fresh] = margins.asked[at[fresh]], margins.risk[at[fresh]]
        return Judged(level, spins, margin, margin_std, median, lower_std, beyond, asked, risk)


def _gets_nowhere(rims: Array, ground: Array, spread: Array) -> bool:
    """Whether a vehicle's rims drive one way at all of some instants while the vehicle surely does not move.

    rims, ground, spread: speeds of the rims, over ground, and the latter's deviation, (instants, wheels),
    m/s.
    """
    known = (np.isfinite(rims) & np.isfinite(ground)).all(axis=0)
    if 2 * known.sum() <= known.size:
        return False
    rims, ground, spread = (each[:, known] for each in (rims, ground, np.nan_to_num(spread)))
    along = -1.0 if rims.mean() < 0.0 else 1.0
    each = along * rims.mean(axis=1)
    rim, reached = float(each.mean()), along * float(ground.mean()) + _SURELY * float(spread.mean())
    drives = (
        rim > SLOWEST_RIM
        and each.min() > 0.5 * rim
        and (along * rims.mean(axis=0)).min() > -SLOWEST_RIM
    )
    return bool(drives and reached < (1.0 - SPINS) * rim)


def _carried(
    before: tuple[Integers, Integers], stamps: Integers, values: Integers
) -> tuple[Integers, Integers]:
    return np.concatenate([before[0], stamps]), np.concatenate([before[1], values])
