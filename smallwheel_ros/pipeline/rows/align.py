# SPDX-License-Identifier: Apache-2.0
"""Assemble what was measured of each wheel at each instant: believed streams in, aligned rows out.

    raw rows -> checks -> BelievedRows -> Aligned -> Readings

A value that the checks doubt is NaN in everything assembled from it: speed, slip, slope, gained, loads. A
doubted gyro is replaced by the odometry's yaw rate; without that the speed of a wheel beside the middle is
unknown.

The instants are those of the measured sinkages. A wheel without them has the instants of its load,
or of the odometry where its load is static, at most ten a second. Other measurements are
interpolated between the messages around an instant, or held (`Sampled.at`).
"""

from __future__ import annotations

import numpy as np

from smallwheel_ros.common.stamps import NEVER, SECOND
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, STANDSTILL_SPEED, OnboardSettings
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.checks.believed import (
    FELT,
    MOVES,
    BelievedRows,
    Trust,
    mean_of_known,
)
from smallwheel_ros.pipeline.checks.ground_speed import (
    COSINE,
    PITCH,
    ROLL,
    SINE,
    SPEED_VARIANCE,
    YAW_RATE,
    YAW_VARIANCE,
    X,
    Y,
)
from smallwheel_ros.pipeline.tables import Aligned, Array, Flags, Integers, unknown

from .slip import assembled_slip, rim_std_of
from .steering import Course, SteeredRows, along_course, speed_aside

_LOAD_STD = 0.02  # of the load, until stretches have learnt it
_GAINING = round(
    0.4 * SECOND
)  # over which the vehicle's acceleration is taken, of a slow odometry 2 periods
_LEAST_LOAD, _LIGHTEST = 0.05, 1e-6  # of a static load; N
_HELD, _HELD_WAY = (
    0.5,
    1.0,
)  # s with a speed, m by the rims: one message for so long is a dropped connection
_PREDICTIONS = SECOND // 10
_UPRIGHT = 0.5  # no vehicle drives on 60 degrees


class Align:
    """Aligns the new rows of believed streams into one table."""

    def __init__(self, settings: OnboardSettings) -> None:
        self.settings = settings
        rolls = np.array([wheel.contact == ROLLING for wheel in settings.wheels])
        # Of each wheel among those that roll.
        self._order = np.where(rolls, np.cumsum(rolls) - 1, -1)
        self._predicted = dict.fromkeys((w.name for w in settings.wheels), NEVER)
        self._pitches = False  # whether the odometry has ever had a pitch
        self._turns = False  # whether the velocity has ever had a yaw rate
        self._moves_turn = False  # and whatever tells the speed
        self._course = Course()
        # Whether a torque has ever been anything but 0.
        self._strains = [False for _ in settings.wheels]

    def take(self, believed: BelievedRows) -> Aligned | None:
        """Align the new rows, those in (since, done]; in order of stamp and wheel, None if there are none."""
        parts = []
        for number, wheel in enumerate(self.settings.wheels):
            stamps = self._instants(wheel, believed)
            if stamps.size:
                parts.append((np.full(stamps.size, number), stamps))
        if not parts:
            return None
        wheel_of, stamps = (np.concatenate(column) for column in zip(*parts, strict=True))
        order = np.lexsort((wheel_of, stamps))
        return self._assemble(believed, wheel_of[order], stamps[order])

    def _instants(self, wheel: Wheel, believed: BelievedRows) -> Integers:
        """Stamps (ns) at which a wheel has rows, shape (rows,)."""
        settings = self.settings
        name = f"{wheel.name}/sinkage"
        if name not in believed.streams:
            name = ODOMETRY if wheel.name in settings.static_loads else f"{wheel.name}/load"
        stamps, _ = believed.new(name)
        if name.endswith("/sinkage") or not stamps.size:
            return stamps
        period = stamps // _PREDICTIONS
        new = np.diff(period, prepend=self._predicted[wheel.name]) > 0
        self._predicted[wheel.name] = int(period[-1])
        return stamps[new]

    def _assemble(self, believed: BelievedRows, wheel: Integers, stamps: Integers) -> Aligned:
        settings, noise, wheels = self.settings, self.settings.noise, self.settings.wheels
        diameter, lateral = (
            np.array([getattr(w, name) for w in wheels])[wheel]
            for name in ("diameter", "lateral_position")
        )
        rolls = np.array([w.contact == ROLLING for w in wheels])[wheel]
        own = {
            kind: unknown(stamps.size) for kind in ("load", "drawbar_pull", "wheel_speed", "torque")
        }
        sinkage, variance = unknown(stamps.size), unknown(stamps.size)
        shown = self._shown(believed, stamps)
        for number, one in enumerate(wheels):
            mine = wheel == number
            for kind, column in own.items():
                if f"{one.name}/{kind}" in shown:
                    column[mine] = shown[f"{one.name}/{kind}"][mine, 0]
            if f"{one.name}/sinkage" in shown:
                sinkage[mine], variance[mine] = shown[f"{one.name}/sinkage"][mine].T
        moves, felt = shown[ODOMETRY], shown[FELT]
        trust, period = believed.trust(stamps), believed.period(stamps)
        rims = believed.each_rim_of(shown, stamps.size)
        # Earlier values: rims by the delay of the speed before, and speeds of which the gain is computed.
        over = np.maximum(_GAINING, 2 * period)
        late = (SECOND * (trust.lag + (0.5 * period / SECOND + trust.mean))).astype(np.int64)
        ago = np.concatenate([stamps - late // 2, stamps - late, stamps - over])
        earlier = believed.at_once([*believed.rim_streams, MOVES], ago)
        rims_ago = believed.each_rim_of(earlier, ago.size).reshape(len(rims), 3, stamps.size)[:, :2]
        moved = earlier[MOVES][-stamps.size :]
        rim = np.where(rolls, own["wheel_speed"] * diameter / 2.0, np.nan)
        middle, turn = self._middle(shown[MOVES], moves, trust)
        gyro = ~np.isnan(felt[:, 0])
        yaw_rate = np.where(gyro, felt[:, 0], self._turned(believed, stamps, rims, turn))
        steered, lever = None, lateral
        aside: Array = np.zeros(stamps.size)
        course: Array = aside
        speed = np.where(rolls, middle - yaw_rate * lateral, np.nan)
        if settings.steered:
            course = self._course.take(believed, stamps)
            aside = speed_aside(settings, shown[MOVES][:, 2], middle, yaw_rate, course)
            motion_ = middle, aside, yaw_rate
            steered = SteeredRows(believed, wheel, stamps, self._order, motion_)
            speed, lever = np.where(rolls, steered.speed, np.nan), steered.lever
        variance_told = moves[:, SPEED_VARIANCE] + np.where(
            gyro, 0.0, moves[:, YAW_VARIANCE] * lever**2
        )
        told = (variance_told > 0.0) & (settings.velocity != "topic")
        speed_std = np.sqrt(np.where(told, variance_told, trust.variance))
        speed_std = np.hypot(speed_std, self._unsteady(believed, wheel, rims, rims_ago, gyro))
        if steered is not None:
            speed_std = np.hypot(speed_std, steered.std)
        if settings.velocity == "none":
            rim = unknown(stamps.size)
        slip, slip_std, stands = assembled_slip(speed, speed_std, rim, trust)
        faster = np.where(np.abs(rim) > np.abs(speed), rim, speed)
        slope, gained, across, pushed = self._felt(
            (middle - moved[:, 0]) / (over / SECOND), moves, felt
        )
        torque = self._torque(wheel, own["torque"])
        load = np.where(own["load"] >= _LIGHTEST, own["load"], np.nan)
        load_std = np.hypot(noise.load, _LOAD_STD * load)
        pitch = _pitch(slope, settings.gravity, moves[:, PITCH])
        apart = np.nan_to_num(slope) + np.nan_to_num(gained)
        pushed_by = np.where(np.isnan(pushed), apart, pushed)
        load, load_std = self._static(wheel, load, load_std, pushed_by, np.nan_to_num(across))
        angle: Array = np.zeros(stamps.size)
        slip_angle: Array = angle
        if steered is not None:
            angle, slip_angle = steered.angle, steered.slip_angle
            left = np.nan_to_num((shown[MOVES][:, 2] - moved[:, 2]) / (over / SECOND))
            pushed, _ = along_course(course, pushed, np.nan_to_num(across) + left)
            gained, _ = along_course(course, gained, left)
            slope, across = along_course(course, slope, across)
            middle, _ = along_course(course, middle, np.where(np.isnan(aside), 0.0, aside))
        known = np.isfinite(variance) & (variance > 0.0)
        usual = settings.estimator.sinkage_std
        heading = np.arctan2(moves[:, SINE], moves[:, COSINE])
        return Aligned(
            stamp=stamps, wheel=wheel, sinkage=sinkage,
            sinkage_std=np.where(known, np.sqrt(np.where(known, variance, 1.0)), usual),
            load=load, load_std=load_std, vehicle_speed=middle, speed=speed, speed_std=speed_std,
            rim_speed=rim, rim_std=rim_std_of(rim), slip=slip, slip_std=slip_std,
            stands=stands, forward=~(faster < 0.0), slope=slope, gained=gained,
            pushed=pushed, across=across, yaw_rate=yaw_rate, vertical=felt[:, 3], torque=torque,
            pull=own["drawbar_pull"],
            pitch=pitch, x=moves[:, X], y=moves[:, Y], heading=heading,
            steering=angle, slip_angle=slip_angle, course=course,
        )  # fmt: skip

    def _shown(self, believed: BelievedRows, stamps: Integers) -> dict[str, Array]:
        """Values of all streams of wheels and vehicle at the rows' stamps, by name, each (rows, width)."""
        instants, row = np.unique(stamps, return_inverse=True)
        names = [ODOMETRY, MOVES, FELT, *(name for name in believed.streams if "/" in name)]
        return {name: each[row] for name, each in believed.at_once(names, instants).items()}

    def _middle(self, measured: Array, moves: Array, trust: Trust) -> tuple[Array, Array]:
        """Speed of the vehicle's middle, m/s, and yaw rate without a gyro, rad/s; both (rows,).

        The speed is NaN where its messages repeat themselves. measured: columns of `MOVES`. moves: rows of
        the odometry.
        """
        speed, turn = measured[:, 0], measured[:, 1]
        posed = (moves[:, X] != 0.0) | (moves[:, Y] != 0.0)
        if self.settings.velocity == "topic":
            # A yaw rate of exactly 0 in every message so far is none: then odometry's is used.
            turned = np.logical_or.accumulate(np.concatenate([[self._turns], np.abs(turn) > 0.0]))[
                1:
            ]
            self._turns = bool(turned[-1])
            turn = np.where(turned, turn, np.nan_to_num(moves[:, YAW_RATE]))
            posed[:] = False
        # A pose cannot stay the same at a speed; what has none may, until the wheels have come a long way.
        same = (trust.since >= _HELD) & (
            (posed & (np.abs(speed) > STANDSTILL_SPEED)) | (trust.way > _HELD_WAY)
        )
        return np.where(same, np.nan, speed), turn

    def _turned(self, believed: BelievedRows, stamps: Integers, rims: Array, turn: Array) -> Array:
        """Yaw rate (rad/s) of the odometry, in place of a gyro: `turn`, with NaN where that is no evidence.

        That is where it has been 0 throughout, the gyro is doubted, and the rims show a bend. rims: speeds
        of the rims, (wheels, rows), m/s.
        """
        turned = np.logical_or.accumulate(np.append(self._moves_turn, np.abs(turn) > 0.0))[1:]
        self._moves_turn = bool(turned[-1])
        _, size, across = believed.rims(stamps, rims)
        # A vehicle whose sides run alike goes straight on, whatever the imu shows.
        bends = np.abs(across) > 0.02 * size
        return np.where(~turned & bends & believed.doubted.at(IMU, stamps), np.nan, turn)

    def _unsteady(
        self, believed: BelievedRows, wheel: Integers, rims: Array, ago: Array, gyro: Flags
    ) -> Array:
        """Error (m/s) of a speed that comes late or is a mean over time: change of the rims in that time.

        The change is that of the mean of all wheels; without a gyro, when the late source also gives the yaw
        rate, it is that of the wheel's own rim. Shape (rows,). rims: speeds at the rows, (wheels, rows), m/s.
        ago: speeds half the delay and the whole delay before, (wheels, 2, rows), m/s. gyro: mask of the rows
        with a gyro.
        """
        if not len(rims) or believed.source not in believed.streams:
            return np.zeros(wheel.size)
        each = np.concatenate([rims[:, None], ago], axis=1)
        own = np.ptp(each, axis=1)[self._order[wheel], np.arange(wheel.size)]
        # Mean of the wheels that are known: a doubted one does not make the others more certain.
        common = np.ptp(mean_of_known(each), axis=0)
        rolls = self._order[wheel] >= 0
        return np.asarray(np.nan_to_num(np.where(rolls & ~gyro, own, common)))

    def _torque(self, wheel: Integers, torque: Array) -> Array:
        """Torques (N m); NaN while all of a wheel were 0 so far, as its driver may leave the effort empty."""
        found = torque.copy()
        for number in range(len(self._strains)):
            mine = wheel == number
            there = np.concatenate([[self._strains[number]], np.abs(torque[mine]) > 0.0])
            strains = np.logical_or.accumulate(there)[1:]
            found[mine] = np.where(strains, torque[mine], np.nan)
            self._strains[number] |= bool(strains.any())
        return found

    def _felt(self, gained: Array, moves: Array, felt: Array) -> tuple[Array, Array, Array, Array]:
        """Return slope, gained, across and pushed as in `Aligned`, m/s^2, along the axes of the vehicle.

        gained: dv/dt, m/s^2. moves, felt: rows of odometry and imu.
        """
        gravity = self.settings.gravity
        if self.settings.with_imu:
            _, ahead, left, above, *up = felt.T
            oriented = ~np.isnan(up[2])
            slope = np.where(oriented, gravity * up[0], ahead - gained)
            across = np.where(oriented, gravity * up[1], left)
            upright = np.where(oriented, gravity * up[2], above) > _UPRIGHT * gravity
            # Without an orientation and a speed, slope and gain cannot be separated, but their sum is felt.
            both = slope + gained
            both = np.where(np.isnan(both), ahead, both)
            slope, across, both = (
                np.where(upright, each, np.nan) for each in (slope, across, both)
            )
            return slope, gained, across, both
        # An odometry of the plane has a pitch of exactly 0 in every message: it measures none.
        pitch = moves[:, PITCH]
        pitches = np.logical_or.accumulate(np.concatenate([[self._pitches], np.abs(pitch) > 0.0]))[
            1:
        ]
        self._pitches = bool(pitches[-1])
        slope = np.where(pitches, -gravity * np.sin(pitch), np.nan)
        across = np.where(pitches, gravity * np.cos(pitch) * np.sin(moves[:, ROLL]), np.nan)
        return slope, gained, across, slope + gained

    def _static(
        self,
        wheel: Integers,
        load: Array,
        load_std: Array,
        pushed: Array,
        across: Array,
    ) -> tuple[Array, Array]:
        """Loads and their deviations (N): measured, or static ones shifted by tilt and acceleration.

        The frame is taken as rigid. pushed: g sin(slope) + dv/dt, m/s^2. across: g sin(slope to the side),
        m/s^2.
        """
        settings = self.settings
        if not settings.static_loads:
            return load, load_std
        names = [w.name for w in settings.wheels]
        level = np.array([getattr(settings.static_loads.get(n), "value", np.nan) for n in names])[
            wheel
        ]
        spread = [
            getattr(settings.static_loads.get(n), "standard_deviation", np.nan) for n in names
        ]
        weight = sum(one.value for one in settings.static_loads.values())
        behind, right = pushed / settings.gravity, across / settings.gravity
        along, aside = (
            _levers(settings.wheels, name)[wheel]
            for name in ("longitudinal_position", "lateral_position")
        )
        moved = -weight * settings.gravity_height * (behind * along + right * aside)
        static = np.maximum(level + moved, _LEAST_LOAD * level)
        static_std = np.hypot(
            np.array(spread)[wheel], 0.5 * moved
        )  # the height of the centre of gravity is known to half of itself
        given = ~np.isnan(level)
        return np.where(given, static, load), np.where(given, static_std, load_std)


def _pitch(slope: Array, gravity: float, shown: Array) -> Array:
    """Pitch (rad, positive nose down) from the slope, g sin(slope) in m/s^2; where that is NaN, `shown`."""
    by_slope = -np.arcsin(np.clip(slope / gravity, -1.0, 1.0))
    return np.where(np.isnan(slope), np.nan_to_num(shown), by_slope)


def _levers(wheels: tuple[Wheel, ...], name: str) -> Array:
    """Positions of wheels relative to their mean, divided by the sum of their squares, 1/m, (wheels,).

    name: the attribute of `Wheel` that holds the position.
    """
    places = np.array([getattr(wheel, name) for wheel in wheels])
    off = places - places.mean()
    squares = float(off @ off)
    return off / squares if squares > 0.0 else np.zeros(off.size)
