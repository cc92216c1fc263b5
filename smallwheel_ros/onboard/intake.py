"""Put together what belongs to one instant of one wheel, from topics that come as they like.

A measured sinkage waits until load, speeds and other wheels' sinkages of the same instant are there
(by stamps, see `Timing`), so the order in which topics arrive does not matter. Stamps are
ns. Nothing that a message holds raises: what cannot be used is counted, and put in words.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from typing import NamedTuple

from smallwheel_ros.onboard.arrivals import ODOMETRY, VELOCITY, Arrivals
from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.memory import Memory
from smallwheel_ros.onboard.settings import OnboardError, OnboardSettings
from smallwheel_ros.onboard.streams import SECOND, Motion, Series, StampFault, nanoseconds

# Predictions for a wheel without sinkage sensor come so far apart.
_PREDICTION_PERIOD = SECOND // 10


class _Streams(NamedTuple):
    """A wheel's number, and the names of its streams."""

    order: int
    load: str
    sinkage: str
    wheel_speed: str
    drawbar_pull: str


class _Waiting(NamedTuple):
    stamp: int
    order: int  # of the wheel: decides between measurements of one instant
    sinkage: float | None
    variance: float


class _Hold(NamedTuple):
    """What the first one that waits needs: something new of a series, or that it gets so late."""

    series: Series
    newest: int | None  # of that series
    until: int  # newest stamp of all (ns) from which on the series is not waited for


class Intake:
    """Takes messages as they arrive, and gives instants in the order of their stamps.

    Each `add_` method takes the stamp (ns) of the measurement and what the clock says now (None or
    0 where there is no clock). `arrivals` counts them.
    """

    def __init__(self, settings: OnboardSettings) -> None:
        self.settings = settings
        self.arrivals = Arrivals(settings.timing, self._on_time_jump)
        self._streams = {
            wheel.name: _Streams(i, *(f"{wheel.name}/{what}" for what in _Streams._fields[1:]))
            for i, wheel in enumerate(settings.wheels)
        }
        self._waiting: list[_Waiting] = []
        self._memory = Memory(settings)
        self._released = [0] * len(settings.wheels)  # newest stamp that was answered
        self._velocity_turns = False  # the velocity sensor has shown a yaw rate
        self.apply(settings)

    def apply(self, settings: OnboardSettings) -> None:
        """Go on with other settings of the same wheels; what was collected is forgotten."""
        self.settings = settings
        self._reorder = nanoseconds(settings.timing.reorder_time)
        self._silence = nanoseconds(settings.timing.silent_after)
        # Way and time go on: the estimate takes no measurement from behind the newest one.
        released = self._released
        self._begin(Memory(settings, self._memory), "settings were changed")
        self._released = released
        self.arrivals.apply(settings.timing)

    def start_over(self, why: str) -> None:
        """Forget what was collected; the counts go on, and measurements that waited are counted."""
        self._begin(Memory(self.settings), why)

    def _begin(self, memory: Memory, why: str) -> None:
        for measurement in self._waiting:
            if measurement.sinkage is not None:
                name = self.settings.wheels[measurement.order].name
                text = f"not used: {why}"
                self.arrivals.problems.add(f"{name}/sinkage", "dropped_by_reset", text)
        self._waiting.clear()
        self._hold: _Hold | None = None
        self._memory = memory
        self.arrivals.start_over()
        self._released = [0] * len(self.settings.wheels)

    def add_load(
        self, wheel: str, stamp: int, load: float, *, now: int | None = None
    ) -> list[Instant]:
        """Take the normal load (N, positive when the wheel presses on the soil) of one wheel.

        stamp: when it was measured. now: what the clock says, None or 0 where there is no clock.
        Returns what this message has made ready. Raises OnboardError for an unknown wheel.
        """
        place, arrivals = self._wheel(wheel), self.arrivals
        stream = place.load
        if not arrivals.take(stream, stamp, now):
            return []
        if not arrivals.is_number(stream, "load", load, "N"):
            pass
        elif load <= 0:
            arrivals.problems.add(
                stream,
                "load_not_positive",
                f"load is {load:g} N, expected more than 0: the wheel is in the air, or the"
                " sensor's sign is the other one (parameter load_sign)",
            )
        else:
            fault = self._memory.loads[place.order].add(stamp, (load,))
            kept = arrivals.kept(stream, stamp, fault)
            if kept and wheel in self.settings.without_sinkage:
                self._predict_later(place.order, stamp)
        return self._release()

    def add_drawbar_pull(
        self, wheel: str, stamp: int, pull: float, *, now: int | None = None
    ) -> list[Instant]:
        """Take what a wheel pulls the vehicle with (N, positive forward)."""
        place = self._wheel(wheel)
        if not self.arrivals.take(place.drawbar_pull, stamp, now):
            return []
        if self.arrivals.is_number(place.drawbar_pull, "drawbar pull", pull, "N"):
            fault = self._memory.pulls[place.order].add(stamp, (pull,))
            self.arrivals.kept(place.drawbar_pull, stamp, fault)
        return self._release()

    def add_odometry(
        self,
        stamp: int,
        x: float,
        y: float,
        speed: float,
        yaw_rate: float = 0.0,
        yaw: float | None = None,
        *,
        pitch: float = 0.0,
        variances: tuple[float, float] = (0.0, 0.0),
        now: int | None = None,
    ) -> list[Instant]:
        """Take pose (m, rad), forward speed (m/s) and yaw rate (rad/s) of the vehicle.

        variances: of speed and yaw rate, 0 where not known.
        """
        if not self.arrivals.take(ODOMETRY, stamp, now):
            return []
        is_number = self.arrivals.is_number
        good = (
            is_number(ODOMETRY, "position x", x, "m")
            and is_number(ODOMETRY, "position y", y, "m")
            and self._is_speed(ODOMETRY, speed)
            and is_number(ODOMETRY, "yaw rate", yaw_rate, "rad/s")
            and (yaw is None or is_number(ODOMETRY, "yaw", yaw, "rad"))
        )
        if not good:
            return self._release()
        # An angle is not interpolated across its jump at pi, its cosine and sine are.
        turn = (math.nan, math.nan) if yaw is None else (math.cos(yaw), math.sin(yaw))
        of_speed, of_yaw = (value if 0.0 < value < math.inf else 0.0 for value in variances)
        nose = pitch if math.isfinite(pitch) else 0.0
        motion = Motion(x, y, speed, yaw_rate, *turn, of_speed, of_yaw, nose)
        if self.arrivals.kept(ODOMETRY, stamp, self._memory.add_odometry(stamp, motion)):
            for name in self.settings.without_sinkage & self.settings.static_loads.keys():
                self._predict_later(self._streams[name].order, stamp)
        return self._release()

    def add_velocity(
        self,
        stamp: int,
        speed: float,
        yaw_rate: float = 0.0,
        variance: float = 0.0,
        *,
        now: int | None = None,
    ) -> list[Instant]:
        """Take forward speed (m/s) and yaw rate (rad/s) as a sensor of its own measures them.

        A yaw rate of exactly 0 in every message so far is none: then odometry's is used. variance:
        of the speed, 0 where not known.
        """
        if not self.arrivals.take(VELOCITY, stamp, now):
            return []
        good = self._is_speed(VELOCITY, speed)
        good = self.arrivals.is_number(VELOCITY, "yaw rate", yaw_rate, "rad/s") and good
        if good:
            self._velocity_turns = self._velocity_turns or yaw_rate != 0.0
            turning = yaw_rate if self._velocity_turns else math.nan
            known = variance if 0.0 < variance < math.inf else 0.0
            fault = self._memory.add_velocity(stamp, speed, turning, known)
            self.arrivals.kept(VELOCITY, stamp, fault)
        return self._release()

    def _is_speed(self, stream: str, speed: float) -> bool:
        """Whether a vehicle can be as fast as that; counted where not."""
        if not self.arrivals.is_number(stream, "speed", speed, "m/s"):
            return False
        most = self.settings.maximum_speed
        if abs(speed) <= most:
            return True
        text = f"speed is {speed:g} m/s, expected at most {most:g} (parameter maximum_speed)"
        self.arrivals.problems.add(stream, "not_plausible", text)
        return False

    def add_wheel_speeds(
        self, stamp: int, speeds: Sequence[tuple[str, float]], *, now: int | None = None
    ) -> list[Instant]:
        """Take angular velocities (rad/s, positive when driving forward) of wheels by their names."""
        arrivals = self.arrivals
        for wheel, speed in speeds:
            place = self._wheel(wheel)
            stream = place.wheel_speed
            if arrivals.take(stream, stamp, now) and arrivals.is_number(
                stream, "wheel speed", speed, "rad/s"
            ):
                fault = self._memory.speeds[place.order].add(stamp, (speed,))
                arrivals.kept(stream, stamp, fault)
        return self._release()

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
        place = self._wheel(wheel)
        order, stream = place.order, place.sinkage
        if not self.arrivals.take(stream, stamp, now):
            return []
        if not self.arrivals.is_number(stream, "sinkage", sinkage, "m"):
            pass
        else:
            measured = self._memory.sinkages[order]
            fault: StampFault | None = StampFault.LATE
            if stamp in measured:
                fault = StampFault.DUPLICATE
            elif stamp > self._released[order]:
                fault = measured.add(stamp, ())
            if self.arrivals.kept(stream, stamp, fault):
                self._wait(_Waiting(stamp, order, sinkage, variance))
        return self._release()

    def flush(self) -> list[Instant]:
        """Give everything that waits, with what is there: nothing more will come."""
        return self._release(everything=True)

    def _wheel(self, name: str) -> _Streams:
        try:
            return self._streams[name]
        except KeyError:
            known = ", ".join(self._streams)
            raise OnboardError(f"no wheel '{name}': the vehicle has {known}") from None

    def _on_time_jump(self) -> None:
        self.start_over("time went back before its turn came")

    # --- When a measurement's turn has come

    def _wait(self, measurement: _Waiting) -> None:
        heapq.heappush(self._waiting, measurement)
        if self._waiting[0] is measurement:
            self._hold = None

    def _predict_later(self, order: int, stamp: int) -> None:
        """Let a wheel without sinkage sensor take its turn at times of its loads."""
        series = self._memory.sinkages[order]
        if stamp >= (series.newest or self._released[order]) + _PREDICTION_PERIOD:
            series.add(stamp, ())
            self._wait(_Waiting(stamp, order, None, 0.0))

    def _release(self, everything: bool = False) -> list[Instant]:
        ready: list[Instant] = []
        hold = self._hold
        if hold is not None and not everything:
            # Most messages change nothing about what the first one that waits needs.
            latest = self.arrivals.latest
            assert latest is not None
            if latest < hold.until and hold.series.newest == hold.newest:
                return ready
        while self._waiting and (everything or self._is_ready()):
            stamp, order, sinkage, variance = heapq.heappop(self._waiting)
            self._hold = None
            self._released[order] = stamp
            ready.append(self._memory.instant(order, stamp, sinkage, variance))
        return ready

    def _is_ready(self) -> bool:
        """Whether everything that belongs to the first one that waits, or before it, has come."""
        latest = self.arrivals.latest
        assert latest is not None
        self._hold = self._held_by(self._waiting[0], latest)
        return self._hold is None

    def _held_by(self, measurement: _Waiting, latest: int) -> _Hold | None:
        if self._reorder == 0:
            return None
        stamp, memory = measurement.stamp, self._memory
        own = self._first_behind(memory.needed[measurement.order], stamp, latest)
        if own is not None:
            return own
        last = stamp + self._reorder  # so long it waits for the other wheels
        if latest >= last:
            return None
        other = self._first_behind(memory.timing, stamp, latest)
        return None if other is None else other._replace(until=min(other.until, last))

    def _first_behind(self, group: Sequence[Series], stamp: int, latest: int) -> _Hold | None:
        """The first series of which something may still come at this stamp or before it."""
        for series in group:
            newest = series.newest
            if newest is None or newest < stamp:
                since = self.arrivals.first if newest is None else newest
                until = since + self._silence + 1
                if latest < until:
                    return _Hold(series, newest, until)
        return None
