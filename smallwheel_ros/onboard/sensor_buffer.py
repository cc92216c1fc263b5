# SPDX-License-Identifier: Apache-2.0
"""What the sensors said lately of a vehicle, and what of it belongs to one instant of a wheel."""

from __future__ import annotations

import math
from collections.abc import Sequence

from smallwheel_ros.estimator.reading import SECOND, Reading
from smallwheel_ros.estimator.traction import GRAVITY
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, VELOCITY, OnboardSettings
from smallwheel_ros.onboard.streams import (
    Motion,
    Series,
    StampFault,
    Travel,
    drives_forward,
    nanoseconds,
)
from smallwheel_ros.physics.conditions import PRESSED, ROLLING
from smallwheel_ros.physics.wheel import Quantity, Wheel, wheel_slip

Values = dict[str, tuple[float, ...] | None]  # of streams at an instant, by kind

_LEAST_LOAD = 0.05  # of a static load
_SAME = 5  # messages in a row that are the same by more than chance
_HELD = 0.3  # s
# By which a rim's speed has to change before a speed over ground that does not is wrong, share and m/s.
_CHANGED, _LEAST_CHANGE = 0.1, 0.03
_GAINING = nanoseconds(0.4)  # over which the vehicle's acceleration is taken


class Stream(Series):
    """The recent values of what comes by one name, `<wheel>/load`, `odom`, ...

    order: number of the wheel. predicts: numbers of the wheels without sinkage sensor that this
    gives their instants. same, same_since: messages in a row, to the newest, that hold exactly the
    same values, and the stamp (ns) of the first.
    """

    def __init__(self, name: str, horizon: int, order: int = -1) -> None:
        super().__init__(horizon)
        self.name, self.order = name, order
        self.kind = name.rpartition("/")[2]
        self.predicts: list[int] = []
        self.same, self.same_since = 0, 0

    def add(self, stamp: int, values: tuple[float, ...]) -> StampFault | None:
        """Keep values at their place; a fault says why they were not kept."""
        before = self.values[-1] if self.values else ()
        fault = super().add(stamp, values)
        if fault is None and stamp == self.newest:
            # What is not known is math.nan, one object, and so the same as itself.
            if before == values:
                self.same += 1
            else:
                self.same, self.same_since = 1, stamp
        return fault

    def held(self, stamp: int) -> float:
        """Time (s) for which the newest values have been exactly the same, at an instant (ns)."""
        return max(stamp - self.same_since, 0) / SECOND if self.same >= _SAME else 0.0


class WheelState:
    """A wheel with its streams, and how far it has come.

    measured: streams that its instants are put together from. needed: those among them that an instant
    waits for. timing: the stream that gives the instants.
    path: travelled so far, m; stood: what noise added to it, m. answered: stamp of the newest instant (ns).
    deepest: sinkage so far, m. lever: per m of the centre of gravity's height, the share of the weight that
    a tilt moves on the wheel, forward and to the left.
    """

    def __init__(
        self, settings: OnboardSettings, order: int, odometry: Stream, velocity: Stream, imu: Stream
    ) -> None:
        self.wheel = wheel = settings.wheels[order]
        self.streams = [
            Stream(f"{wheel.name}/{kind}", odometry.horizon, order)
            for kind in ("load", "sinkage", "drawbar_pull", "wheel_speed", "torque")
        ]
        load, self.sinkage, _, self.wheel_speed, _ = self.streams
        self.rim_then: float | None = None  # m/s, when the speed over ground began to repeat
        self.static_load = settings.static_loads.get(wheel.name)
        vehicle = [odometry, velocity, imu]
        used = set(settings.streams) - {self.sinkage.name}
        self.measured = [stream for stream in (*self.streams, *vehicle) if stream.name in used]
        rolls = wheel.contact == ROLLING
        self.needed = [one for one in self.measured if rolls or one not in vehicle]
        self.timing = self.sinkage
        if wheel.name in settings.without_sinkage:
            self.timing = load if self.static_load is None else odometry
            self.timing.predicts.append(order)
        self.path = self.deepest = self.stood = 0.0
        self.lever = _lever(wheel, settings.wheels)
        self.answered = 0


def _lever(wheel: Wheel, wheels: Sequence[Wheel]) -> tuple[float, float]:
    """Place of a wheel about the middle of all, over the sum of the squares of these places, 1/m."""
    found = []
    for name in ("longitudinal_position", "lateral_position"):
        places = [getattr(one, name) for one in wheels]
        middle = sum(places) / len(places)
        squares = sum((place - middle) ** 2 for place in places)
        found.append((getattr(wheel, name) - middle) / squares if squares > 0.0 else 0.0)
    return found[0], found[1]


class SensorBuffer:
    """Recent values of all streams of a vehicle; wheels go by their number.

    Attributes
    ----------
    streams
        By name.
    wheels
        In the order of the settings.
    distance
        Path of the vehicle so far, m.
    """

    def __init__(self, settings: OnboardSettings) -> None:
        self.settings = settings
        timing = settings.timing
        self._gap = nanoseconds(timing.maximum_gap)
        longest_wait = max(timing.reorder_time, timing.silent_after)
        horizon = nanoseconds(longest_wait + timing.maximum_gap + timing.jump_tolerance)
        vehicle = [Stream(name, horizon) for name in (ODOMETRY, VELOCITY, IMU)]
        self._odometry, self._velocity, _ = vehicle
        # Paths come from the same source as slip.
        by_topic = settings.velocity == "topic"
        self._speeds = self._velocity if by_topic else self._odometry
        self._pitches = False
        self._pose_moves = False
        self._velocity_turns = False
        self.wheels = [WheelState(settings, i, *vehicle) for i in range(len(settings.wheels))]
        self.distance = 0.0
        streams = [*vehicle, *(stream for state in self.wheels for stream in state.streams)]
        self.streams = {stream.name: stream for stream in streams}
        # The vehicle's, then those of the wheels.
        lateral = (0.0, *(wheel.lateral_position for wheel in settings.wheels))
        self._travel = Travel(horizon, self._gap, settings.standstill_speed, lateral)
        self._pressed_path = 0.0
        self._stood = 0.0  # m, what the noise of speeds added up to where the vehicle stood

    def add(self, stream: Stream, stamp: int, values: tuple[float, ...]) -> StampFault | None:
        """Keep values, and the travel that they show; a fault says why they were not kept."""
        if stream is self._velocity:
            # A yaw rate of exactly 0 in every message so far is none: then odometry's is used.
            speed, yaw_rate, variance = values
            self._velocity_turns = self._velocity_turns or yaw_rate != 0.0
            values = (speed, yaw_rate if self._velocity_turns else math.nan, variance)
        fault = stream.add(stamp, values)
        if isinstance(values, Motion):
            # An odometry of the plane has a pitch of exactly 0 in every message: it measures none.
            self._pitches = self._pitches or values.pitch != 0.0
            self._pose_moves = self._pose_moves or (values.x, values.y) != (0.0, 0.0)
        if fault is None and stream is self._speeds:
            if stream is self._velocity:
                odometry = self._odometry.at(stamp, self._gap)
                values = self._middle(values, None if odometry is None else Motion(*odometry))
            self._travel.move(stamp, *values[:4])
        return fault

    def reading(self, stamp: int, order: int, measured: Sequence[float]) -> Reading:
        """Put together what belongs to a wheel's instant; call it in the order of stamps.

        measured: its sinkage (m) and variance (m^2, not known where it is not over 0), if any.
        """
        state, noise, gap = self.wheels[order], self.settings.noise, self._gap
        now = {one.kind: one.at(stamp, gap) for one in state.measured}
        load, pull, torque = now.get("load"), now.get("drawbar_pull"), now.get("torque")
        odometry = now.get(ODOMETRY)
        motion = None if odometry is None else Motion(*odometry)
        slope, gained, across = self._felt(stamp, now, motion)
        carried = state.static_load
        if load is not None:
            carried = Quantity(load[0], math.hypot(noise.load, noise.load_relative * load[0]))
        elif carried is not None:
            carried = self._spread(state, carried, slope, gained, across)
        over_ground, turning = self._moves(state.wheel, now, motion)
        repeats = self._repeats(stamp, state, turning)
        if repeats:
            over_ground = None
        speed = None if over_ground is None else over_ground.value
        rim = None if turning is None else turning.value
        slip = None
        stands = False
        if over_ground is not None and turning is not None:
            slip = wheel_slip(over_ground, turning, self.settings.standstill_speed)
            stands = slip is None
        forward = drives_forward(speed, rim)
        way = 1.0 if forward else -1.0
        sinkage = None
        if measured:
            value, variance = measured
            known = math.isfinite(variance) and variance > 0
            deviation = math.sqrt(variance) if known else self.settings.estimator.sinkage_std
            sinkage = Quantity(value, deviation)
        self._advance(state, order, stamp, sinkage, stands or repeats)
        place = vehicle = heading = None
        if motion is not None:
            place, vehicle, heading = (
                motion.place(state.wheel),
                (motion.x, motion.y),
                motion.heading,
            )
        return Reading(
            state.wheel,
            stamp,
            carried,
            slip,
            sinkage,
            speed,
            self.distance,
            state.path,
            place,
            state.static_load is not None,
            vehicle,
            None if pull is None else Quantity(pull[0], noise.drawbar_pull),
            0.0 if motion is None else motion.pitch,
            rim,
            None if slope is None else way * slope,
            None if torque is None else way * torque[0],
            forward,
            None if gained is None else way * gained,
            0.0 if over_ground is None else over_ground.standard_deviation,
            0.0 if turning is None else turning.standard_deviation,
            stands,
            across,
            heading,
            state.wheel_speed.held(stamp),
            repeats,
        )

    def _repeats(self, stamp: int, state: WheelState, turning: Quantity | None) -> bool:
        """Whether the speed over ground is one and the same message while the vehicle moves.

        Its pose cannot be the same then; where it has none, the rims' speed tells. One of exactly 0 may be
        right: wheels that spin on one place.
        """
        speeds = self._speeds
        if (
            speeds.held(stamp) < _HELD
            or abs(speeds.values[-1][0]) <= self.settings.standstill_speed
        ):
            state.rim_then = None
            return False
        if speeds is self._odometry and self._pose_moves:
            return True
        rim = 0.0 if turning is None else turning.value
        if state.rim_then is None:
            state.rim_then = rim
        return abs(rim - state.rim_then) > _CHANGED * abs(state.rim_then) + _LEAST_CHANGE

    def _spread(
        self,
        state: WheelState,
        level: Quantity,
        slope: float | None,
        gained: float | None,
        across: float | None,
    ) -> Quantity:
        """Static load of a wheel (N) where it is level, as tilt and gained speed move it (a rigid frame)."""
        behind, right = ((slope or 0.0) + (gained or 0.0)) / GRAVITY, (across or 0.0) / GRAVITY
        along, aside = state.lever
        weight = sum(load.value for load in self.settings.static_loads.values())
        height = self.settings.gravity_height
        moved = -weight * height * (behind * along + right * aside)
        load = max(level.value + moved, _LEAST_LOAD * level.value)
        # Half of the height is what is known of it.
        return Quantity(load, math.hypot(level.standard_deviation, 0.5 * moved))

    def _felt(
        self, stamp: int, now: Values, motion: Motion | None
    ) -> tuple[float | None, float | None, float | None]:
        """What slope and gaining speed take of the wheels per mass, m/s^2, positive forward.

        And the slope across, positive where the left side is higher.
        """
        speed, before = now.get(self._speeds.kind), self._speeds.at(stamp - _GAINING, self._gap)
        gained = None
        if speed is not None and before is not None:
            gained = (speed[0] - before[0]) / (_GAINING / SECOND)
        # Between a message with orientation and one without neither is known.
        force, felt, across = now.get(IMU) or (math.nan, math.nan, math.nan)
        if not math.isnan(force):
            return force, gained, across
        if not math.isnan(felt):
            # An accelerometer feels both.
            return felt - (gained or 0.0), gained or 0.0, across
        if not self.settings.with_imu and motion is not None and self._pitches:
            across = GRAVITY * math.cos(motion.pitch) * math.sin(motion.roll)
            return -GRAVITY * math.sin(motion.pitch), gained, across
        return None, gained, None

    def _middle(self, velocity: Sequence[float], motion: Motion | None) -> tuple[float, float]:
        """Speed of the vehicle's middle and yaw rate, by the velocity sensor.

        A sensor that is beside the middle moves with v_x = v - omega y.
        """
        speed, yaw_rate = velocity[:2]
        if math.isnan(yaw_rate):
            yaw_rate = 0.0 if motion is None else motion.yaw_rate
        return speed + yaw_rate * self.settings.velocity_lateral_position, yaw_rate

    def _moves(
        self, wheel: Wheel, now: Values, motion: Motion | None
    ) -> tuple[Quantity | None, Quantity | None]:
        """Speed of a wheel's place over ground and of its rim, m/s; None where not known."""
        noise = self.settings.noise
        lateral = wheel.lateral_position
        if wheel.contact != ROLLING:
            return None, None
        if self.settings.velocity == "topic":
            values = now.get(VELOCITY)
            if values is None:
                return None, None
            (middle, yaw_rate), variance = self._middle(values, motion), values[2]
        elif motion is None:
            return None, None
        else:
            middle, yaw_rate = motion.speed, motion.yaw_rate
            variance = motion.speed_variance + motion.yaw_rate_variance * lateral**2
        deviation = math.sqrt(variance) if variance > 0.0 else noise.speed
        speed = Quantity(middle - yaw_rate * lateral, deviation)
        turning = now.get("wheel_speed")
        if turning is None or self.settings.velocity == "none":
            return speed, None
        rim = turning[0] * wheel.diameter / 2
        return speed, Quantity(rim, noise.wheel_speed_relative * abs(rim))

    def _advance(
        self, state: WheelState, order: int, stamp: int, sinkage: Quantity | None, stands: bool
    ) -> None:
        """Paths so far (m), which never fall; who stands adds none, whatever noise adds up to."""
        if sinkage is not None and state.wheel.contact == PRESSED:
            # A pressed wheel meets new soil by going deeper than it has been.
            self._pressed_path += max(0.0, sinkage.value - state.deepest)
            state.deepest = max(state.deepest, sinkage.value)
        paths = self._travel.at(stamp) or self._travel.start
        whole, own = paths[0] - self._stood, paths[1 + order] - state.stood
        if stands:
            self._stood += max(whole + self._pressed_path - self.distance, 0.0)
            state.stood += max(own + self._pressed_path - state.path, 0.0)
        else:
            self.distance = max(self.distance, whole + self._pressed_path)
            state.path = max(state.path, own + self._pressed_path)
        state.answered = stamp
