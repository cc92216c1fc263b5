# SPDX-License-Identifier: Apache-2.0
"""Unit of a joint's velocity, by comparison with the change of position in the same messages."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.stamps import SECOND

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_BLOCK = SECOND // 10  # ns: ticks of an encoder and its delay are small against what turns in it
_LONGEST = SECOND  # ns: over a longer gap nothing is added up
_TURNED = 2.0  # rad, by positions, after which it is judged: a filter's delay is small against that
_FEWEST = 10  # blocks
_STANDS = 30.0  # rad by velocities after which positions that have not moved are no evidence
# Units differ by 6 and more, rims of small wheels turn by 2 rad and more in a metre; no delay makes a half.
_APART = 2.0
# rad by positions, and a factor that no start from rest gives: beyond it nothing is used yet.
_LITTLE, _FAR = 0.05, 4.0
# Ticks of an encoder, and rad, after which its turn is known within a fourth: positions of a joint at rest
# flicker by less.
_TICKS, _FLICKERS = 4, 0.01
# Share of the time for which streams wait for late messages: messages wait here as long, while the unit is
# unknown.
_WAITS = 0.75
_STARTED = 5  # blocks, after which a filter's delay no longer makes a fourth of a speed
_ALIKE = 0.9  # correlation of the two, under which they are not of one joint
_NEAR = 0.04  # of a known factor
# Velocity in another unit over that in rad/s, by unit.
UNITS_OF_TURNING = {"rpm": 30.0 / math.pi, "deg/s": 180.0 / math.pi, "turns/s": 0.5 / math.pi}
_POSITIONS = (math.tau, math.pi / 180.0)  # factors at which positions are in turns or degrees


class VelocityUnit:
    """Holds back the messages of one joint until it is known whether its velocities are in rad/s.

    Attributes
    ----------
    wrong
        Why the velocities are not used, in words; empty if they are, or as long as that is unknown.
    """

    def __init__(self) -> None:
        self.wrong = ""
        self._known = False
        self._last: tuple[int, float, float] | None = None
        self._block = [0, 0.0, 0.0]  # how long (ns), turned by positions and by velocities, rad
        self._count, self._pp, self._vv, self._pv = 0, 0.0, 0.0, 0.0
        self._by_position = self._by_velocity = 0.0
        self._suspect = False  # far from rad/s by the little that has turned so far
        # rad that it has turned since the beginning, by positions and by velocities; whether these agreed
        self._net_position = self._net_velocity = 0.0
        self._agreed = False
        self._tick = math.inf  # rad, the least by which its position has changed
        self._waiting: deque[tuple[int, Array]] = deque()

    def take(
        self, stamps: Integers, values: Array, wait: int = 0
    ) -> tuple[Integers, Array, Integers, Integers]:
        """Release or refuse further messages of the joint, in the order in which they arrived.

        While the unit is unknown, messages are held back, once the joint turns, for at most three quarters of
        `wait`; then they are released, or refused where the unit is, or may be, another one.

        Parameters
        ----------
        stamps
            ns, shape (messages,).
        values
            Velocity (rad/s) and position (rad) of each message, NaN where it has none, and further columns
            that belong to it, shape (messages, columns).
        wait
            Time by which the streams can wait for messages that come late, ns.

        Returns
        -------
        stamps, values : ndarray
            Stamps, shape (released,), ns, and rows, shape (released, columns), of messages that may be used,
            including those held back by earlier calls.
        message : ndarray
            Index of the message of this call by which each of them was released, shape (released,).
        refused : ndarray
            Stamps of messages that must not be used, since their velocity is, or may be, in another unit,
            shape (refused,), ns.
        """
        if self._known and not self._waiting:
            every = np.arange(0 if self.wrong else stamps.size)
            return stamps[every], values[every], every, stamps[every.size :]
        found: list[tuple[int, Array, int]] = []
        left_out: list[int] = []
        for number, stamp in enumerate(stamps.tolist()):
            self._one(stamp, values[number], round(_WAITS * wait), number, found, left_out)
        refused = np.array(left_out, dtype=np.int64)
        if not found:
            return stamps[:0], values[:0], np.empty(0, dtype=np.int64), refused
        free, rows, numbers = zip(*found, strict=True)
        return np.array(free, dtype=np.int64), np.array(rows), np.array(numbers), refused

    def _one(
        self,
        stamp: int,
        row: Array,
        wait: int,
        number: int,
        found: list[tuple[int, Array, int]],
        refused: list[int],
    ) -> None:
        """Process a message; those that are released with it are appended to `found` or to `refused`."""
        waiting = self._waiting
        velocity, position = float(row[0]), float(row[1])
        if not self._known:
            self._add(stamp, velocity, position)
        doubtful = bool(self.wrong) or (not self._known and (self._suspect or self._not_yet()))
        goes_back = bool(waiting) and abs(stamp - waiting[-1][0]) > _LONGEST
        waiting.append((stamp, row))
        tells = not self._known and math.isfinite(velocity) and math.isfinite(position)
        keeps = tells and not self._agreed and not goes_back and bool(velocity or len(waiting) > 1)
        while waiting and not (keeps and stamp - waiting[0][0] < wait):
            first, values = waiting.popleft()
            if doubtful:
                refused.append(first)
            else:
                found.append((first, values, number))

    def _add(self, stamp: int, velocity: float, position: float) -> None:
        if not (math.isfinite(velocity) and math.isfinite(position)):
            return
        last, self._last = self._last, (stamp, velocity, position)
        if last is None or not 0 < stamp - last[0] <= _LONGEST:
            return
        turned = position - last[2]
        if abs(turned) > math.pi:  # it begins anew at each turn
            return
        if turned:
            self._tick = min(self._tick, abs(turned))
        by_velocity = 0.5 * (velocity + last[1]) * (stamp - last[0]) / SECOND
        self._net_position += turned
        self._net_velocity += by_velocity
        block = self._block
        block[0] += stamp - last[0]
        block[1] += turned
        block[2] += by_velocity
        if block[0] < _BLOCK or (abs(block[1]) < _FLICKERS and block[0] < SECOND):
            return
        _, by_position, by_velocity = block
        self._block = [0, 0.0, 0.0]
        self._by_velocity += abs(by_velocity)
        self._known = self._by_velocity > _STANDS > 100.0 * self._by_position
        if by_velocity == 0.0 or abs(by_position) < _FLICKERS:
            return
        self._count += 1
        self._pp += by_position**2
        self._vv += by_velocity**2
        self._pv += by_position * by_velocity
        self._by_position += abs(by_position)
        factor = abs(self._pv) / self._pp if self._by_position > _LITTLE else 1.0
        slow = self._count >= _STARTED and factor < 1.0 / _FAR
        self._suspect = factor > _FAR or slow
        if self._by_position >= _TURNED and self._count >= _FEWEST:
            self._judge()

    def _not_yet(self) -> bool:
        """Whether the joint turns by its positions, and its velocities have not yet shown that they agree."""
        turned = abs(self._net_position)
        little = min(_LITTLE, max(_FLICKERS, _TICKS * self._tick))
        # Of velocities that are 0 so far, `JointMotion` knows what they are.
        if self._agreed or self._known or turned < little or self._net_velocity == 0.0:
            return False
        self._agreed = turned / _APART <= abs(self._net_velocity) <= turned * _APART
        return not self._agreed

    def _judge(self) -> None:
        self._known = True
        if abs(self._pv) < _ALIKE * math.sqrt(self._pp * self._vv):
            return
        factor = abs(self._pv) / self._pp
        if 1.0 / _APART <= factor <= _APART:
            return
        if any(abs(factor / known - 1.0) < _NEAR for known in _POSITIONS):
            return  # velocities are right, and nothing else is needed
        near = [u for u, known in UNITS_OF_TURNING.items() if abs(factor / known - 1.0) < _NEAR]
        other = "in m/s at the rim" if factor < 1.0 else "of a motor before its gear"
        perhaps = f"in {near[0]}" if near else other
        times = f"its velocity is {factor:.3g} times what its position turns"
        self.wrong = f"{times}, perhaps {perhaps}: expected rad/s"
