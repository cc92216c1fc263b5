# SPDX-License-Identifier: Apache-2.0
"""Speed of a joint: the velocity in its messages, or the difference of their positions."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.stamps import SECOND

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# rad: a velocity of exactly 0 while the position moves so far is not measured, since no joint at rest does.
MOVES = 0.5
# rad by which a joint at rest may turn as the rover settles; between this and `MOVES` its speed is unknown.
_SETTLES = 0.05
# ns: a tick of an encoder (0.006 rad with 1,000 of them) is 0.06 rad/s over it.
_SPAN = SECOND // 10
_TURNS = 0.2  # rad/s over that: three ticks, and 1 cm/s of the smallest wheel
_GAP = SECOND  # ns: what comes after so long is no speed of the time in between
_NEAR = (
    0.05  # rad: positions further beyond half or a whole turn than this do not begin anew each turn
)

BY_POSITIONS = "its velocity is missing or always 0: its speed is the difference of its positions"


class JointMotion:
    """Computes the speed of one joint from its messages, in the order in which they arrive.

    The speed is the velocity; if that is missing, or 0 while the position moves, the speed is computed from
    positions.

    Attributes
    ----------
    by_positions
        Whether the speed is computed from positions.
    left_out
        Number of messages that were not used because they have no velocity although earlier ones had: they
        are from another publisher.
    unknown
        Stamps (ns) of messages of the last call that have no speed, because the velocity is 0 while the
        position moves, and it is not yet known which of the two is right.
    """

    def __init__(self) -> None:
        self.by_positions = False
        self.left_out = 0
        self.unknown: list[int] = []
        self._told = False  # a velocity has come, be it 0
        self._moves = False  # and one that is not 0
        self._since = math.nan  # rad, unwrapped position of the first velocity of 0
        self._raw, self._place = math.nan, 0.0  # rad, as it came last, and unwrapped
        self._low, self._high = math.inf, -math.inf
        self._before: deque[tuple[int, float]] = deque()  # stamps and unwrapped positions

    def take(
        self, stamps: Integers, velocity: Array, position: Array, has: NDArray[np.bool_]
    ) -> tuple[Integers, Array, Integers]:
        """Compute speeds from further messages, in the order in which they arrived.

        Parameters
        ----------
        stamps
            Shape (messages,), ns.
        velocity, position
            rad/s and rad, shape (messages,); NaN where a message has none.
        has
            Whether a message has the field for the joint's velocity, even if that is NaN, shape (messages,).

        Returns
        -------
        stamps : ndarray
            Stamps of the speeds, shape (speeds,), ns: those of messages, or midway between two positions.
        speeds : ndarray
            Shape (speeds,), rad/s.
        message : ndarray
            Index of the message by which each speed became known, shape (speeds,).
        """
        found: list[tuple[int, float, int]] = []
        self.unknown = []
        number = 0
        while number < stamps.size and not self._moves:
            one = int(stamps[number]), float(velocity[number]), float(position[number])
            made = self._one(*one, bool(has[number]))
            if made is not None:
                found.append((*made, number))
            number += 1
        rest = np.flatnonzero(has[number:]) + number
        self.left_out += stamps.size - number - rest.size
        if not found:
            return stamps[rest], velocity[rest], rest
        before = list(zip(*found, strict=True))
        return (
            np.concatenate([np.array(before[0], dtype=np.int64), stamps[rest]]),
            np.concatenate([np.array(before[1], dtype=float), velocity[rest]]),
            np.concatenate([np.array(before[2], dtype=np.int64), rest]),
        )

    def _one(
        self, stamp: int, velocity: float, position: float, has: bool
    ) -> tuple[int, float] | None:
        """Stamp (ns) and speed (rad/s) that a message gives, or None."""
        if has and velocity != 0.0 and not math.isnan(velocity):
            self._moves, self.by_positions = True, False
            return stamp, velocity
        if not has and self._told:
            self.left_out += 1
            return None
        if has and not self._told:
            self._told, self.by_positions = True, False
            self._before.clear()
        speed = self._by_difference(stamp, position) if math.isfinite(position) else None
        if not has:
            self.by_positions = self.by_positions or math.isfinite(position)
            return speed
        if math.isnan(velocity) or not math.isfinite(position):
            return stamp, velocity
        if math.isnan(self._since):
            self._since = self._place
        moved = abs(self._place - self._since)
        self.by_positions = self.by_positions or moved >= MOVES
        if self.by_positions:
            return speed
        if moved <= _SETTLES and (speed is None or abs(speed[1]) <= _TURNS):
            return stamp, velocity
        self.unknown.append(stamp)
        return None

    def _by_difference(self, stamp: int, position: float) -> tuple[int, float] | None:
        """Stamp (ns) and speed (rad/s) midway between a position and one at least 0.1 s before, or None."""
        before = self._before
        if before and not 0 < stamp - before[-1][0] <= _GAP:
            if 0 < before[-1][0] - stamp < _GAP or stamp == before[-1][0]:
                return None  # late, or twice
            before.clear()
        self._low, self._high = min(self._low, position), max(self._high, position)
        step = 0.0 if math.isnan(self._raw) else position - self._raw
        if abs(step) > math.pi and self._begins_anew:
            step -= math.tau * round(step / math.tau)
        self._raw, self._place = position, self._place + step
        before.append((stamp, self._place))
        while len(before) > 1 and stamp - before[1][0] >= _SPAN:
            before.popleft()
        since, place = before[0]
        if stamp - since < _SPAN:
            return None
        return (since + stamp) // 2, (self._place - place) * SECOND / (stamp - since)

    @property
    def _begins_anew(self) -> bool:
        """Whether all positions so far are within one revolution: -pi to pi, or 0 to 2 pi."""
        half = self._low >= -math.pi - _NEAR and self._high <= math.pi + _NEAR
        return half or (self._low >= -_NEAR and self._high <= math.tau + _NEAR)
