# SPDX-License-Identifier: Apache-2.0
"""Put together what belongs to one instant of one wheel, from streams that come as they like.

A measured sinkage waits until load, speeds and other wheels' sinkages of the same instant are there
(by stamps, see `Timing`), so the order in which topics arrive does not matter. Stamps are ns.
Nothing that a message holds raises: what cannot be used is counted, and put in words.
"""

from __future__ import annotations

import heapq
import math
from collections import Counter
from collections.abc import Callable, Iterable

from smallwheel_ros.estimator.reading import SECOND, Reading
from smallwheel_ros.onboard.problems import ProblemLog
from smallwheel_ros.onboard.sensor_buffer import SensorBuffer
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, VELOCITY, OnboardError, OnboardSettings
from smallwheel_ros.onboard.streams import StampFault, late_words, nanoseconds, stamp_problem

Measured = tuple[str, tuple[float, ...]]  # the name of a stream, and its values

# By the end of a stream's name: what has to be a number, with its unit; further values may be
# unknown. In SI units nothing on a vehicle is larger than 1e9; squares of such numbers are finite.
_NUMBERS = {
    "load": (("load", "N"),),
    "drawbar_pull": (("drawbar pull", "N"),),
    "wheel_speed": (("wheel speed", "rad/s"),),
    "torque": (("torque", "N m"),),
    "sinkage": (("sinkage", "m"),),
    ODOMETRY: (("speed", "m/s"), ("yaw rate", "rad/s"), ("position x", "m"), ("position y", "m")),
    VELOCITY: (("speed", "m/s"), ("yaw rate", "rad/s")),
    IMU: (),  # what is not known of it is NaN
}
_LARGEST = 1e9
_STRONGEST = 100.0  # m/s^2, ten times gravity: beyond any vehicle that drives
_LIGHTEST = 1e-6  # N: no load cell tells less from nothing
# Predictions for a wheel without sinkage sensor come so far apart.
_PREDICTION_PERIOD = SECOND // 10


class Synchroniser:
    """Takes messages' values as they arrive, and gives readings in the order of their stamps.

    Parameters
    ----------
    on_time_jump
        Called when time has gone back: what was collected is void.

    Attributes
    ----------
    problems
        What could not be used.
    received
        Values so far, by stream, good and bad.
    """

    def __init__(self, settings: OnboardSettings, on_time_jump: Callable[[], None]) -> None:
        self.problems = ProblemLog()
        self.received: Counter[str] = Counter()
        self._settings, self._on_time_jump = settings, on_time_jump
        self._reorder = nanoseconds(settings.timing.reorder_time)
        self._silence = nanoseconds(settings.timing.silent_after)
        self._jump = nanoseconds(settings.timing.jump_tolerance)
        # Stamp, wheel's number (it decides between measurements of one instant), values of sinkage.
        self._waiting: list[tuple[int, int, tuple[float, ...]]] = []
        self._begin()

    def start_over(self, why: str) -> None:
        """Forget what was collected; the counts go on, and measurements that waited are counted."""
        for _, order, measured in self._waiting:
            if measured:
                name = self._buffer.wheels[order].sinkage.name
                self.problems.add(name, "dropped_by_reset", f"not used: {why}")
        self._waiting.clear()
        self._begin()

    def newest(self, stream: str) -> int | None:
        """Return the newest stamp (ns) of what was kept of a stream; None where there is none."""
        return self._buffer.streams[stream].newest

    def add(
        self, stamp: int, measured: Iterable[Measured], now: int | None = None
    ) -> list[Reading]:
        """Take what was measured at one instant; return the readings that are complete now.

        stamp: when it was measured. now: what the clock says, None or 0 where there is no clock.
        Raises OnboardError for an unknown wheel.
        """
        for name, values in measured:
            self._take(name, stamp, values, now)
        ready = []
        while self._waiting and not self._is_held():
            ready.append(self._buffer.reading(*heapq.heappop(self._waiting)))
        return ready

    def flush(self) -> list[Reading]:
        """Give everything that waits, with what is there: nothing more will come."""
        waiting, self._waiting = sorted(self._waiting), []
        return [self._buffer.reading(*one) for one in waiting]

    def _begin(self) -> None:
        self._buffer = buffer = SensorBuffer(self._settings)
        self._oldest = self._latest = 0  # stamps of what was kept; 0: nothing
        self._doubted: int | None = None  # a stamp far from all others
        # What a measurement of each wheel waits for: its own streams, and the times of the others.
        others = [(state.timing, True) for state in buffer.wheels]
        self._awaited = [
            [*((stream, False) for stream in state.needed), *others] if self._reorder else []
            for state in buffer.wheels
        ]

    # --- What comes in

    def _take(self, name: str, stamp: int, values: tuple[float, ...], now: int | None) -> None:
        if name not in self._buffer.streams:
            known = ", ".join(wheel.name for wheel in self._settings.wheels)
            raise OnboardError(f"no wheel '{name.partition('/')[0]}': the vehicle has {known}")
        self.received[name] += 1
        if not self._is_timely(name, stamp, now):
            return
        stream = self._buffer.streams[name]  # not before: a jump of time makes it anew
        problem = self._implausible(stream.kind, values)
        if problem is not None:
            self.problems.add(name, *problem)
            return
        fault = self._buffer.add(stream, stamp, values)
        measured = stream.kind == "sinkage"
        if measured and not fault and stamp <= self._buffer.wheels[stream.order].answered:
            fault = StampFault.LATE
        if fault is not None:
            text = late_words((self._latest - stamp) / SECOND, self._settings.timing)
            if fault is StampFault.DUPLICATE:
                text = f"header.stamp {stamp / SECOND:.9f} came twice: is there more than one publisher?"
            self.problems.add(name, fault.value, text)
            return
        if not measured:  # what becomes of a sinkage is known when its turn comes
            self.problems.good(name)
        self._oldest = self._oldest or stamp
        self._latest = max(self._latest, stamp)
        if measured:
            heapq.heappush(self._waiting, (stamp, stream.order, values))
        for order in stream.predicts:
            state = self._buffer.wheels[order]
            if stamp >= (state.sinkage.newest or state.answered) + _PREDICTION_PERIOD:
                state.sinkage.add(stamp, ())
                heapq.heappush(self._waiting, (stamp, order, ()))

    def _is_timely(self, name: str, stamp: int, now: int | None) -> bool:
        """Whether a stamp can be used; so can the first one of a new time."""
        latest = self._latest
        problem = stamp_problem(stamp, latest, now, self._settings.timing)
        back = problem is not None and problem[0] is StampFault.JUMP_BACK
        if not now and latest and (back or (problem is None and stamp > latest + self._jump)):
            # Without a clock one message far from all others may be corrupt: another has to agree.
            doubted, self._doubted = self._doubted, stamp
            if doubted is None or abs(stamp - doubted) > self._jump:
                apart, way = abs(stamp - latest) / SECOND, "behind" if back else "ahead of"
                text = f"header.stamp is {apart:.3f} s {way} all others: another has to agree first"
                problem = StampFault.LATE if back else StampFault.FUTURE, text
                back = False
            else:
                self._doubted = None
        if problem is None:
            return True
        fault, text = problem
        self.problems.add(name, fault.value, text, unused=not back)
        if back:
            self.start_over("time went back before its turn came")
            self._on_time_jump()
        return back

    def _implausible(self, kind: str, values: tuple[float, ...]) -> tuple[str, str] | None:
        """Key and words of a value that nothing can be computed with; None: there is none."""
        for i, (name, unit) in enumerate(_NUMBERS[kind]):
            value = values[i]
            if not abs(value) < _LARGEST:
                reason = "not_plausible" if math.isfinite(value) else "not_finite"
                expected = f"expected a number (smaller than {_LARGEST:g})"
                return reason, f"{name} is {value:g} {unit}, {expected}"
        first, fastest = values[0], self._settings.maximum_speed
        if kind in (ODOMETRY, VELOCITY) and abs(first) > fastest:
            expected = f"expected at most {fastest:g} (parameter maximum_speed)"
            return "not_plausible", f"speed is {first:g} m/s, {expected}"
        if kind == IMU and not any(abs(value) <= _STRONGEST for value in values[:2]):
            known = [value for value in values[:2] if not math.isnan(value)] or [math.nan]
            reason = "not_plausible" if math.isfinite(known[0]) else "not_finite"
            return reason, f"acceleration is {known[0]:g} m/s^2, expected at most {_STRONGEST:g}"
        if kind == "torque" and first == 0.0:
            return "torque_zero", (
                "torque is exactly 0 N m, expected a measured one: the driver leaves the effort of this"
                " joint empty (parameter torque_source)"
            )
        if kind == "load" and first < _LIGHTEST:
            return "load_not_positive", (
                f"load is {first:g} N, expected more than 0: the wheel is in the air, or the"
                " sensor's sign is the other one (parameter load_sign)"
            )
        return None

    # --- When a measurement's turn has come

    def _is_held(self) -> bool:
        """Whether something that belongs to the first one that waits, or before it, may come yet."""
        stamp, order, _ = self._waiting[0]
        for stream, is_other in self._awaited[order]:
            newest = stream.newest
            if newest is None or newest < stamp:
                until = (self._oldest if newest is None else newest) + self._silence
                if is_other:
                    until = min(until, stamp + self._reorder - 1)
                if self._latest <= until:
                    return True
        return False
