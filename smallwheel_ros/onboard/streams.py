# SPDX-License-Identifier: Apache-2.0
"""Header stamps (ns), recent values by stamp, how a vehicle moves, and the paths that speeds add up to."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

from smallwheel_ros.estimator.reading import SECOND
from smallwheel_ros.onboard.settings import Timing
from smallwheel_ros.physics.wheel import Wheel

_EVER = 1 << 63  # ns: further apart are no stamps


def nanoseconds(seconds: float) -> int:
    """Turn seconds into whole nanoseconds."""
    return round(seconds * SECOND)


class StampFault(Enum):
    """Why a header stamp cannot be used; the values are keys to count by."""

    ZERO = "stamp_zero"
    FUTURE = "stamp_in_future"
    TOO_OLD = "stamp_too_old"
    LATE = "late"
    DUPLICATE = "duplicate"
    JUMP_BACK = "time_jump"


def stamp_problem(
    stamp: int, newest: int | None, now: int | None, timing: Timing
) -> tuple[StampFault, str] | None:
    """Judge a stamp by the newest one so far and the clock (None or 0: no clock, no opinion).

    Returns what is wrong with it, also in words with what to do. JUMP_BACK is not a bad message:
    time itself went back (a bag that loops), and what was collected before is void.
    """
    if stamp <= 0:
        return StampFault.ZERO, "header.stamp is zero: the publisher must stamp its messages"
    ahead = (stamp - now) / SECOND if now else 0.0
    if ahead > timing.future_tolerance:
        return StampFault.FUTURE, (
            f"header.stamp is {ahead:.3f} s ahead of the clock, at most {timing.future_tolerance:g}"
            " s expected: are the clocks synchronised?"
        )
    if -ahead > timing.maximum_age:
        return StampFault.TOO_OLD, (
            f"header.stamp is {-ahead:.3f} s behind the clock, at most {timing.maximum_age:g} s"
            " expected: for a bag, set use_sim_time and play it with its clock"
        )
    behind = (newest - stamp) / SECOND if newest else 0.0
    if behind <= timing.jump_tolerance:
        return None
    # A clock that has not gone back itself makes this one message late, and time no jump.
    if now and behind + ahead <= timing.future_tolerance:
        return StampFault.LATE, late_words(behind, timing)
    text = f"time went back by {behind:.3f} s (a bag that loops?): soil and buffers are reset"
    return StampFault.JUMP_BACK, text


def late_words(behind: float, timing: Timing) -> str:
    """Say that a stamp is so much (s) behind the newest message, and what to do."""
    return (
        f"header.stamp is {behind:.3f} s behind the newest message: too late to be used (parameter"
        f" reorder_time, now {timing.reorder_time:g} s)"
    )


class Series:
    """The recent values of one stream, sorted by stamp in whatever order they came.

    horizon: how far back from the newest stamp values are kept (ns). stamps, values: what is kept.
    newest: the newest stamp; None when there is none.
    """

    def __init__(self, horizon: int) -> None:
        self.horizon = horizon
        self.stamps: list[int] = []
        self.values: list[tuple[float, ...]] = []
        self.newest: int | None = None

    def add(self, stamp: int, values: tuple[float, ...]) -> StampFault | None:
        """Keep values at their place; a fault says why they were not kept."""
        stamps, newest = self.stamps, self.newest
        if newest is None or stamp > newest:
            self.newest = stamp
            stamps.append(stamp)
            self.values.append(values)
            # In batches: taking one element off the front of a list moves all others.
            if stamps[0] < stamp - 2 * self.horizon:
                keep = bisect_left(stamps, stamp - self.horizon)
                del stamps[:keep], self.values[:keep]
            return None
        if stamp < newest - self.horizon:
            return StampFault.LATE
        place = bisect_left(stamps, stamp)
        if stamps[place] == stamp:
            return StampFault.DUPLICATE
        stamps.insert(place, stamp)
        self.values.insert(place, values)
        return None

    def at(self, stamp: int, reach: int = _EVER) -> tuple[float, ...] | None:
        """Values at an instant: interpolated linearly, or held from the nearest stamp.

        Only values within `reach` (ns) of the instant matter; None when there is none.
        """
        stamps, values = self.stamps, self.values
        after = bisect_left(stamps, stamp)
        later = after < len(stamps) and stamps[after] - stamp <= reach
        if later and stamps[after] == stamp:
            return values[after]
        earlier = after > 0 and stamp - stamps[after - 1] <= reach
        if earlier and later:
            start, end = stamps[after - 1], stamps[after]
            share = (stamp - start) / (end - start)
            pairs = zip(values[after - 1], values[after], strict=True)
            return tuple([a + share * (b - a) for a, b in pairs])
        if earlier:
            return values[after - 1]
        return values[after] if later else None


class Travel(Series):
    """Paths (m) of points of a vehicle: their speeds over stamps; standing still adds nothing.

    Its values are the paths, then speed, yaw rate and position of the vehicle.

    Parameters
    ----------
    horizon
        How far back values are kept (ns).
    longest_gap
        Between stamps further apart than this (ns) the straight distance of the positions counts,
        where they are known; else the smaller one of both speeds.
    standstill
        Speeds up to this (m/s) are noise of a standing vehicle.
    lateral_positions
        Of the points, m left of the vehicle's middle.

    Attributes
    ----------
    start
        Paths before anything has come.
    """

    def __init__(
        self,
        horizon: int,
        longest_gap: int,
        standstill: float,
        lateral_positions: Sequence[float] = (0.0,),
    ) -> None:
        super().__init__(horizon)
        self._gap = longest_gap
        self._standstill = standstill
        self._lateral = lateral_positions
        self.start = (0.0,) * len(lateral_positions)

    def move(
        self,
        stamp: int,
        speed: float,
        yaw_rate: float = 0.0,
        x: float = math.nan,
        y: float = math.nan,
    ) -> None:
        """Take speed (m/s) and yaw rate (rad/s) of the vehicle, and its position where known (m)."""
        stamps, values, motion = self.stamps, self.values, (speed, yaw_rate, x, y)
        late = bool(stamps) and stamp <= stamps[-1]
        paths = self.start
        if stamps and not late:
            paths = self._paths(values[-1], motion, stamp - stamps[-1])
        if self.add(stamp, (*paths, *motion)) is not None or not late:
            return
        # A late message changes the paths at every later stamp.
        place = bisect_left(stamps, stamp)
        if place == 0:
            steps = self._paths((*self.start, *motion), values[1][-4:], stamps[1] - stamp)
            paths = tuple(path - step for path, step in zip(values[1], steps, strict=False))
            values[0] = (*paths, *motion)
        for i in range(max(place, 1), len(stamps)):
            paths = self._paths(values[i - 1], values[i][-4:], stamps[i] - stamps[i - 1])
            values[i] = (*paths, *values[i][-4:])

    def _paths(
        self, before: tuple[float, ...], motion: tuple[float, ...], time: int
    ) -> tuple[float, ...]:
        """Paths a time (ns) after what was before, with this motion then."""
        *paths, v0, turn0, x0, y0 = before
        v1, turn1, x1, y1 = motion
        duration, is_gap = time / SECOND, time > self._gap
        straight = math.hypot(x1 - x0, y1 - y0) if is_gap else math.nan
        if not math.isnan(straight):
            step = straight if straight > self._standstill * duration else 0.0
            return tuple([path + step for path in paths])
        found = []
        for path, lateral in zip(paths, self._lateral, strict=True):
            first, last = abs(v0 - turn0 * lateral), abs(v1 - turn1 * lateral)
            first = first if first > self._standstill else 0.0
            last = last if last > self._standstill else 0.0
            mean = min(first, last) if is_gap else 0.5 * (first + last)
            found.append(path + mean * duration)
        return tuple(found)


def drives_forward(speed: float | None, rim_speed: float | None) -> bool:
    """Whether a wheel drives forward; speeds of its place over ground and of its rim, m/s.

    The faster of them tells: the speed over ground of a wheel that spins on one place is noise of
    either sign, and so is the rim of one that is dragged.
    """
    if speed is None:
        return True
    return (rim_speed if rim_speed is not None and abs(rim_speed) > abs(speed) else speed) >= 0.0


class Motion(NamedTuple):
    """Of a vehicle: forward speed (m/s), yaw rate (rad/s), place (m), cosine and sine of the yaw.

    Between two messages the latter two are not of unit length; they are NaN where yaw is not known.
    speed_variance, yaw_rate_variance: as the message has them, 0 where it does not. pitch: rad,
    positive nose down, and roll, positive left side up; 0 where not known.
    """

    speed: float
    yaw_rate: float
    x: float
    y: float
    cosine: float = math.nan
    sine: float = math.nan
    speed_variance: float = 0.0
    yaw_rate_variance: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0

    @classmethod
    def of(
        cls,
        x: float,
        y: float,
        speed: float,
        yaw_rate: float,
        yaw: float | None,
        pitch: float,
        variances: tuple[float, float],
        roll: float = 0.0,
    ) -> Motion:
        """Return the motion in an odometry; what of it may be unknown is so where it is no number."""
        turn = (math.nan, math.nan)
        if yaw is not None and math.isfinite(yaw):
            turn = (math.cos(yaw), math.sin(yaw))
        of_speed, of_yaw = (value if 0.0 < value < math.inf else 0.0 for value in variances)
        angles = (angle if math.isfinite(angle) else 0.0 for angle in (pitch, roll))
        return cls(speed, yaw_rate, x, y, *turn, of_speed, of_yaw, *angles)

    @property
    def heading(self) -> float | None:
        """Yaw (rad); None where it is not known."""
        known = math.isfinite(self.cosine + self.sine)
        return math.atan2(self.sine, self.cosine) if known else None

    def place(self, wheel: Wheel) -> tuple[float, float] | None:
        """Where a wheel is; None where nobody knows which way the vehicle looks."""
        length = math.hypot(self.cosine, self.sine)
        if not length > 0.0:
            return None
        cosine, sine = self.cosine / length, self.sine / length
        ahead, left = wheel.longitudinal_position, wheel.lateral_position
        return self.x + cosine * ahead - sine * left, self.y + sine * ahead + cosine * left
