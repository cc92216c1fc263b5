"""Short memories of what the sensors said, by header stamp: for node and replay alike.

Stamps are whole nanoseconds. Messages of several topics come late, out of order, twice, or from a
bag that starts again; what belongs to one instant is put together here, and what cannot be used is
told apart by reason.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

SECOND = 1_000_000_000  # ns


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


@dataclass(frozen=True)
class StampRules:
    """What is expected of header stamps; all in ns.

    Attributes
    ----------
    future_tolerance
        How far a stamp may be ahead of the clock.
    maximum_age
        How far it may be behind the clock.
    jump_tolerance
        How far it may be behind the newest stamp before it counts as a jump of time.
    """

    future_tolerance: int
    maximum_age: int
    jump_tolerance: int

    def fault(self, stamp: int, newest: int | None, now: int | None) -> StampFault | None:
        """Judge a stamp by the newest one so far and the clock (None or 0: no clock, no opinion).

        JUMP_BACK is not a bad message: time itself went back (a bag that loops), and what was
        collected before is void.
        """
        if stamp <= 0:
            return StampFault.ZERO
        if now:
            if stamp > now + self.future_tolerance:
                return StampFault.FUTURE
            if stamp < now - self.maximum_age:
                return StampFault.TOO_OLD
        if newest is None or stamp >= newest - self.jump_tolerance:
            return None
        # A clock that has not gone back itself makes this one message late, and time no jump.
        clock_stands_by = now and now + self.future_tolerance >= newest
        return StampFault.LATE if clock_stands_by else StampFault.JUMP_BACK


class Series:
    """The recent values of one stream, sorted by stamp in whatever order they came.

    Parameters
    ----------
    horizon
        How far back from the newest stamp values are kept (ns).

    Attributes
    ----------
    stamps, values
        What is kept, sorted by stamp.
    newest
        The newest stamp; None when there is none.
    """

    def __init__(self, horizon: int) -> None:
        self.horizon = horizon
        self.stamps: list[int] = []
        self.values: list[tuple[float, ...]] = []
        self.newest: int | None = None

    def __len__(self) -> int:
        return len(self.stamps)

    def __contains__(self, stamp: int) -> bool:
        place = bisect_left(self.stamps, stamp)
        return place < len(self.stamps) and self.stamps[place] == stamp

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

    def at(self, stamp: int, reach: int) -> tuple[float, ...] | None:
        """Values at an instant: interpolated linearly, or held from the nearest stamp.

        Only values within `reach` (ns) of the instant count; None when there is none.
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

    def clear(self) -> None:
        """Forget everything."""
        self.stamps.clear()
        self.values.clear()
        self.newest = None


class Motion(NamedTuple):
    """Of a vehicle: place (m), forward speed (m/s), yaw rate (rad/s), cosine and sine of the yaw.

    Between two messages the latter two are not of unit length; they are NaN where yaw is not known.
    speed_variance, yaw_rate_variance: as the message has them, 0 where it does not. pitch: rad,
    positive nose down, 0 where not known.
    """

    x: float
    y: float
    speed: float
    yaw_rate: float
    cosine: float
    sine: float
    speed_variance: float = 0.0
    yaw_rate_variance: float = 0.0
    pitch: float = 0.0

    @property
    def yaw(self) -> float | None:
        """Direction that the vehicle looks to, rad; None where it is not known."""
        return None if math.isnan(self.cosine) else math.atan2(self.sine, self.cosine)


class PathSeries:
    """Path (m) by integrating a speed over stamps; standing still adds nothing.

    Parameters
    ----------
    horizon
        How far back values are kept (ns).
    longest_gap
        Between stamps further apart than this (ns) the straight distance of the positions counts,
        where they are known; else the smaller one of both speeds.
    standstill
        Speeds up to this (m/s) are noise of a standing vehicle.
    """

    def __init__(self, horizon: int, longest_gap: int, standstill: float) -> None:
        self._series = Series(horizon)  # speed, x, y
        self._path: list[float] = []  # at each stamp of the series
        self._gap = longest_gap
        self._standstill = standstill

    def add(self, stamp: int, speed: float, x: float = math.nan, y: float = math.nan) -> None:
        """Take a speed (m/s, either sign), and the position (m) where it is known."""
        series, path = self._series, self._path
        last = series.newest
        if last is None or stamp > last:
            so_far = 0.0
            if last is not None:
                so_far = path[-1] + self._step(last, series.values[-1], stamp, (speed, x, y))
            series.add(stamp, (speed, x, y))
            path.append(so_far)
            del path[: -len(series)]  # what the series has forgotten
            return
        if series.add(stamp, (speed, x, y)) is not None:
            return
        # A late message changes the path at every later stamp.
        place = bisect_left(series.stamps, stamp)
        path.insert(place, 0.0)
        if place == 0:
            path[0] = path[1] - self._step_to(1)
        for i in range(max(place, 1), len(series)):
            path[i] = path[i - 1] + self._step_to(i)

    def _step_to(self, i: int) -> float:
        """Path to stamp i from the one before it."""
        stamps, values = self._series.stamps, self._series.values
        return self._step(stamps[i - 1], values[i - 1], stamps[i], values[i])

    def _step(
        self, start: int, first: tuple[float, ...], end: int, last: tuple[float, ...]
    ) -> float:
        """Path between two stamps with speed, x and y at both."""
        (before, x0, y0), (after, x1, y1) = first, last
        duration = (end - start) / SECOND
        before, after = self._moving(before), self._moving(after)
        if end - start <= self._gap:
            return 0.5 * (before + after) * duration
        straight = math.hypot(x1 - x0, y1 - y0)
        if math.isnan(straight):
            return min(before, after) * duration
        return straight if straight > self._standstill * duration else 0.0

    def _moving(self, speed: float) -> float:
        return abs(speed) if abs(speed) > self._standstill else 0.0

    def at(self, stamp: int) -> float:
        """Path (m) at an instant; held before the first and after the last message."""
        stamps, path = self._series.stamps, self._path
        if not stamps:
            return 0.0
        after = bisect_right(stamps, stamp)
        if after in (0, len(stamps)):
            return path[min(after, len(stamps) - 1)]
        start, end = stamps[after - 1], stamps[after]
        share = (stamp - start) / (end - start)
        return path[after - 1] + share * (path[after] - path[after - 1])
