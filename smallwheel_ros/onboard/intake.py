"""Put together what belongs to one instant of one wheel, from topics that come as they like.

A measured sinkage waits until load, speeds and other wheels' sinkages of the same instant are there
(by stamps, see `Timing`), so the order in which topics arrive does not matter. Stamps are
ns. Nothing that a message holds raises: what cannot be used is counted, and put in words.
"""

from __future__ import annotations

import heapq
import math
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.memory import Memory
from smallwheel_ros.onboard.problems import ProblemLog, stamp_problem
from smallwheel_ros.onboard.settings import OnboardError, OnboardSettings, VelocitySource
from smallwheel_ros.onboard.streams import (
    SECOND,
    Odometer,
    Series,
    StampFault,
    StampRules,
    nanoseconds,
)
from smallwheel_ros.physics.conditions import ROLLING

# Predictions for a wheel without sinkage sensor come so far apart.
_PREDICTION_PERIOD = SECOND // 10
# In SI units nothing on a vehicle is larger; squares of such numbers still are finite.
_LARGEST = 1e9

ODOMETRY = "odom"
VELOCITY = "velocity"


class _Waiting(NamedTuple):
    stamp: int
    order: int  # of the wheel: decides between measurements of one instant
    sinkage: float | None
    variance: float


class Intake:
    """Takes messages as they arrive, and gives instants in the order of their stamps.

    Each `add_` method takes the stamp (ns) of the measurement and what the clock says now (None or
    0 where there is no clock). `newest` has each stream's newest good stamp; `time_jumps` counts
    how often everything was forgotten because time
    went back.
    """

    def __init__(self, settings: OnboardSettings) -> None:
        self.settings = settings
        self.problems = ProblemLog()
        self.received: Counter[str] = Counter()
        self.newest: dict[str, int] = {}
        self.time_jumps = 0
        self._order = {wheel.name: i for i, wheel in enumerate(settings.wheels)}
        self._waiting: list[_Waiting] = []
        self._memory = Memory(settings)
        self._released = [0] * len(settings.wheels)  # newest stamp that was answered
        self.apply(settings)

    def apply(self, settings: OnboardSettings) -> None:
        """Go on with other settings of the same wheels; what was collected is forgotten."""
        self.settings = settings
        timing = settings.timing
        self._reorder = nanoseconds(timing.reorder_time)
        self._silence = nanoseconds(timing.silent_after)
        self._rules = StampRules(
            nanoseconds(timing.future_tolerance),
            nanoseconds(timing.maximum_age),
            nanoseconds(timing.jump_tolerance),
        )
        # Way and time go on: the estimate takes no measurement from behind the newest one.
        released = self._released
        self._begin(Memory(settings, self._memory.distance), "settings were changed")
        self._released = released

    def start_over(self, why: str) -> None:
        """Forget what was collected; the counts go on, and measurements that waited are counted."""
        self._begin(Memory(self.settings), why)

    def _begin(self, memory: Memory, why: str) -> None:
        for measurement in self._waiting:
            if measurement.sinkage is not None:
                name = self.settings.wheels[measurement.order].name
                self.problems.add(f"{name}/sinkage", "dropped_by_reset", f"not used: {why}")
        self._waiting.clear()
        self._memory = memory
        self._newest: int | None = None
        self.newest.clear()
        self._first = 0
        self._released = [0] * len(self.settings.wheels)

    @property
    def streams(self) -> tuple[str, ...]:
        """Names of everything that is listened to: `<wheel>/load`, `odom`, ..."""
        settings = self.settings
        rolling = [w for w in settings.wheels if w.contact == ROLLING]
        own_velocity = rolling and settings.velocity is VelocitySource.TOPIC
        return (
            *(f"{w.name}/load" for w in settings.wheels if w.name not in settings.static_loads),
            *(
                f"{w.name}/sinkage"
                for w in settings.wheels
                if w.name not in settings.without_sinkage
            ),
            *(f"{w.name}/wheel_speed" for w in rolling),
            *((ODOMETRY,) if rolling else ()),
            *((VELOCITY,) if own_velocity else ()),
        )

    def add_load(
        self, wheel: str, stamp: int, load: float, *, now: int | None = None
    ) -> list[Instant]:
        """Take the normal load (N, positive when the wheel presses on the soil) of one wheel.

        stamp: when it was measured. now: what the clock says, None or 0 where there is no clock.
        Returns what this message has made ready. Raises OnboardError for an unknown wheel.
        """
        order, stream = self._wheel(wheel), f"{wheel}/load"
        if not self._good_stamp(stream, stamp, now):
            return []
        if not self._is_number(stream, "load", load, "N"):
            pass
        elif load <= 0:
            self.problems.add(
                stream,
                "load_not_positive",
                f"load is {load:g} N, expected more than 0: the wheel is in the air, or the"
                " sensor's sign is the other one (parameter load_sign)",
            )
        elif self._kept(stream, stamp, self._memory.loads[order].add(stamp, (load,))):
            self._saw(stamp)
            if wheel in self.settings.without_sinkage:
                self._predict_later(order, stamp)
        return list(self._release())

    def add_odometry(
        self,
        stamp: int,
        x: float,
        y: float,
        speed: float,
        yaw_rate: float = 0.0,
        yaw: float | None = None,
        *,
        now: int | None = None,
    ) -> list[Instant]:
        """Take pose (m, rad), forward speed (m/s) and yaw rate (rad/s) of the vehicle."""
        if not self._good_stamp(ODOMETRY, stamp, now):
            return []
        good = all(
            self._is_number(ODOMETRY, name, value, unit)
            for name, value, unit in (
                ("position x", x, "m"),
                ("position y", y, "m"),
                ("speed", speed, "m/s"),
                ("yaw rate", yaw_rate, "rad/s"),
                ("yaw", 0.0 if yaw is None else yaw, "rad"),
            )
        )
        values = (x, y, speed, yaw_rate, yaw)
        if good and self._kept(ODOMETRY, stamp, self._memory.odometer.add(stamp, *values)):
            self._saw(stamp)
            for wheel in self.settings.without_sinkage & self.settings.static_loads.keys():
                self._predict_later(self._order[wheel], stamp)
        return list(self._release())

    def add_velocity(
        self, stamp: int, speed: float, yaw_rate: float = 0.0, *, now: int | None = None
    ) -> list[Instant]:
        """Take forward speed (m/s) and yaw rate (rad/s) as a sensor of its own measures them."""
        if not self._good_stamp(VELOCITY, stamp, now):
            return []
        good = self._is_number(VELOCITY, "speed", speed, "m/s")
        good = self._is_number(VELOCITY, "yaw rate", yaw_rate, "rad/s") and good
        if good and self._kept(
            VELOCITY, stamp, self._memory.velocity.add(stamp, (speed, yaw_rate))
        ):
            self._saw(stamp)
        return list(self._release())

    def add_wheel_speed(
        self, wheel: str, stamp: int, angular_velocity: float, *, now: int | None = None
    ) -> list[Instant]:
        """Take the angular velocity of a wheel (rad/s, positive when it drives forward)."""
        order, stream = self._wheel(wheel), f"{wheel}/wheel_speed"
        if not self._good_stamp(stream, stamp, now):
            return []
        good = self._is_number(stream, "wheel speed", angular_velocity, "rad/s")
        if good and self._kept(
            stream, stamp, self._memory.speeds[order].add(stamp, (angular_velocity,))
        ):
            self._saw(stamp)
        return list(self._release())

    def add_sinkage(
        self,
        wheel: str,
        stamp: int,
        sinkage: float,
        variance: float = 0.0,
        *,
        now: int | None = None,
    ) -> list[Instant]:
        """Take the measured sinkage of a wheel (m, positive down) and its variance (m^2).

        A variance of 0 or less, or one that is not finite, means that it is not known.
        """
        order, stream = self._wheel(wheel), f"{wheel}/sinkage"
        if not self._good_stamp(stream, stamp, now):
            return []
        if not self._is_number(stream, "sinkage", sinkage, "m"):
            pass
        elif sinkage < 0:
            text = f"sinkage is {sinkage:g} m, expected 0 or more (positive down): wrong zero?"
            self.problems.add(stream, "sinkage_negative", text)
        elif stamp in self._memory.sinkages[order].stamps:
            self._kept(stream, stamp, StampFault.DUPLICATE)
        elif stamp <= self._released[order]:
            self._kept(stream, stamp, StampFault.LATE)
        else:
            self._memory.sinkages[order].add(stamp, ())
            heapq.heappush(self._waiting, _Waiting(stamp, order, sinkage, variance))
            self._saw(stamp)
        return list(self._release())

    def flush(self) -> list[Instant]:
        """Give everything that waits, with what is there: nothing more will come."""
        return list(self._release(everything=True))

    # --- Which messages are good, and when a measurement's turn has come

    def _wheel(self, name: str) -> int:
        try:
            return self._order[name]
        except KeyError:
            known = ", ".join(self._order)
            raise OnboardError(f"no wheel '{name}': the vehicle has {known}") from None

    def _is_number(self, stream: str, name: str, value: float, unit: str) -> bool:
        if abs(value) < _LARGEST:
            return True
        reason = "not_plausible" if math.isfinite(value) else "not_finite"
        text = f"{name} is {value:g} {unit}, expected a number (smaller than {_LARGEST:g})"
        self.problems.add(stream, reason, text)
        return False

    def _good_stamp(self, stream: str, stamp: int, now: int | None) -> bool:
        self.received[stream] += 1
        fault = self._rules.fault(stamp, self._newest, now)
        if fault is StampFault.JUMP_BACK:
            # The message itself is good: it is the first one of the new time.
            text = stamp_problem(fault, stamp, self._newest, now, self.settings.timing)
            self.problems.add(stream, fault.value, text, unused=False)
            self.time_jumps += 1
            self.start_over("time went back before its turn came")
        elif not self._kept(stream, stamp, fault, now):
            return False
        self.newest[stream] = max(stamp, self.newest.get(stream, 0))
        return True

    def _kept(
        self, stream: str, stamp: int, fault: StampFault | None, now: int | None = None
    ) -> bool:
        """Count a fault of a stamp, and put it in words."""
        if fault is not None:
            text = stamp_problem(fault, stamp, self._newest, now, self.settings.timing)
            self.problems.add(stream, fault.value, text)
        return fault is None

    def _saw(self, stamp: int) -> None:
        if self._newest is None:
            self._first = stamp
        self._newest = max(stamp, self._newest or stamp)

    def _predict_later(self, order: int, stamp: int) -> None:
        """Let a wheel without sinkage sensor take its turn at times of its loads."""
        series = self._memory.sinkages[order]
        if stamp >= (series.newest or self._released[order]) + _PREDICTION_PERIOD:
            series.add(stamp, ())
            heapq.heappush(self._waiting, _Waiting(stamp, order, None, 0.0))

    def _release(self, everything: bool = False) -> Iterator[Instant]:
        while self._waiting and (everything or self._complete(self._waiting[0])):
            measurement = heapq.heappop(self._waiting)
            self._released[measurement.order] = measurement.stamp
            yield self._memory.instant(
                measurement.order, measurement.stamp, measurement.sinkage, measurement.variance
            )

    def _complete(self, measurement: _Waiting) -> bool:
        """Whether everything that belongs to this measurement or before it has come."""
        assert self._newest is not None
        if self._reorder == 0:
            return True
        stamp, order = measurement.stamp, measurement.order
        own = self._memory.newest_of(order)
        if not all(self._has_passed(stamp, newest) for newest in own):
            return False
        if self._newest - stamp >= self._reorder:
            return True
        measured = (self._timed_by(i).newest for i in range(len(self.settings.wheels)))
        return all(self._has_passed(stamp, newest) for newest in measured)

    def _timed_by(self, order: int) -> Series | Odometer:
        """The stream that gives a wheel its instants."""
        name = self.settings.wheels[order].name
        if name not in self.settings.without_sinkage:
            return self._memory.sinkages[order]
        if name in self.settings.static_loads:
            return self._memory.odometer
        return self._memory.loads[order]

    def _has_passed(self, stamp: int, newest: int | None) -> bool:
        """Whether nothing is to be expected of a stream any more at this stamp or before it."""
        assert self._newest is not None
        if newest is None:
            return self._newest - self._first > self._silence
        return newest >= stamp or self._newest - newest > self._silence
