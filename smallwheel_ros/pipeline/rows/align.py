# SPDX-License-Identifier: Apache-2.0
"""Put together what belongs to each instant of each wheel: streams in, Readings out.

    raw rows -> checks -> what is believed -> Readings

Checks look at raw rows up to each two seconds of the stamps, and what they doubt is NaN from there on to all
that is assembled: speed, slip, slope, gained, loads. A doubted gyro is replaced by odometry's yaw rate; where
there is none the speed of a wheel aside is not known.

The instants are those of the measured sinkages. A wheel whose sinkage is not measured has those of its
load, or of the odometry where its load is static, at most ten a second. What else was measured then is
interpolated between the messages around it, or held within `MAXIMUM_GAP`.
"""

from __future__ import annotations

import numpy as np

from smallwheel_ros.onboard.settings import (
    IMU,
    ODOMETRY,
    STANDSTILL_SPEED,
    VELOCITY,
    OnboardSettings,
)
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.checks.doubts import SHOWS_NO_SLIP, Doubts
from smallwheel_ros.pipeline.checks.ground_speed import (
    COSINE,
    PITCH,
    ROLL,
    SINE,
    SPEED_VARIANCE,
    WINDOW,
    YAW_VARIANCE,
    GroundSpeed,
    Trust,
    X,
    Y,
)
from smallwheel_ros.pipeline.checks.rules import Checks, Finding
from smallwheel_ros.pipeline.checks.window import SPAN
from smallwheel_ros.pipeline.intake.buffer import NEVER, StampRules
from smallwheel_ros.pipeline.intake.streams import Streams
from smallwheel_ros.pipeline.tables import SECOND, Array, Flags, Integers, Readings, unknown

WIDTHS = {"load": 1, "sinkage": 2, "drawbar_pull": 1, "wheel_speed": 1, "torque": 1}
WIDTHS |= {ODOMETRY: 10, VELOCITY: 3, IMU: 7}
# s. What is measured at 5 Hz and more is interpolated; slower, wheel and ground change in between.
MAXIMUM_GAP = 0.2
_SILENT_AFTER = 1.0  # s: what has not come for so long is not waited for
_FUTURE_TOLERANCE = 0.5  # s: clocks of two computers that are set by NTP differ by less
_JUMP_TOLERANCE = 1.0  # s: what goes back by less is late, by more a bag that starts over
_LOAD_STD = 0.02  # of the load, until stretches have learnt it
_RIM_STD = 0.01  # of a rim's speed: encoders are exact, the effective radius is known to 1 %
_MOVES = 4.0  # deviations of a speed: one reading in 16,000 of what stands is beyond them
_GAINING = round(
    0.4 * SECOND
)  # over which the vehicle's acceleration is taken, of a slow odometry 2 periods
_PAST = 2 * SECOND  # what is learnt of an odometry looks so far back, and its lag half of it
_LEAST_LOAD, _LIGHTEST = 0.05, 1e-6  # of a static load; N
_HELD, _HELD_WAY = (
    0.5,
    1.0,
)  # s with a speed, m by the rims: one message for so long is a dropped connection
_PREDICTIONS = SECOND // 10
_UPRIGHT = 0.5  # no vehicle drives on 60 degrees
_HIDDEN = 0.3  # slip that an odometry of the wheels may hide: what the twist takes slip for, too


def rules_of(settings: OnboardSettings) -> StampRules:
    """The rules for stamps: those of the parameters `timing.*`, and what is the same on every vehicle."""
    timing = settings.timing
    waits = _SILENT_AFTER, timing.reorder_time, MAXIMUM_GAP, _JUMP_TOLERANCE
    clock = _FUTURE_TOLERANCE, timing.maximum_age
    return StampRules(*(round(each * SECOND) for each in (*waits, *clock)))


def widths_of(settings: OnboardSettings) -> dict[str, int]:
    """Values in a row of each stream that is listened to."""
    return {name: WIDTHS[name.rpartition("/")[2]] for name in settings.streams}


class Align:
    """Gives the rows between the last watermark and the next.

    since, done: stamps (ns) behind which, and up to which, the newest rows are.
    """

    def __init__(self, settings: OnboardSettings, streams: Streams) -> None:
        self.settings, self.streams = settings, streams
        self.doubts = Doubts()
        self.ground = GroundSpeed(settings, streams, self.doubts)
        self.checks = Checks(settings, self.ground, self.doubts)
        self.since = self.done = NEVER
        self.findings: tuple[Finding, ...] = ()
        rolls = np.array([wheel.contact == ROLLING for wheel in settings.wheels])
        self._order = np.where(
            rolls, np.cumsum(rolls) - 1, -1
        )  # of each wheel among those that roll
        self._predicted = dict.fromkeys((w.name for w in settings.wheels), NEVER)
        self._pitches = False  # whether the odometry has ever had a pitch
        self._turns = False  # whether the velocity has ever had a yaw rate
        self._moves_turn = False  # and whatever tells the speed
        self._strains = [
            False for _ in settings.wheels
        ]  # whether a torque has ever been anything but 0

    def rows(self, until: int, *, last: bool = False) -> Readings | None:
        """Rows up to a stamp (ns) at which all is there, by stamp and wheel; None: there are none.

        last: whether nothing more will come, so that the newest speed is held. What the rows were made of is
        kept until the next turn. `findings`: what checks have found meanwhile.
        """
        self._forget()
        self.ground.take()
        until = until if last else self.ground.bound(until)
        parts = []
        for number, wheel in enumerate(self.settings.wheels):
            stamps = self._instants(wheel, until)
            if stamps.size:
                parts.append((np.full(stamps.size, number), stamps))
        self.since, self.done = self.done, max(self.done, until)
        self._check(last)
        if not parts:
            return None
        wheel_of, stamps = (np.concatenate(column) for column in zip(*parts, strict=True))
        order = np.lexsort((wheel_of, stamps))
        return self._assemble(wheel_of[order], stamps[order])

    def raw(self) -> dict[str, tuple[Integers, Array]]:
        """The raw rows between the two newest watermarks, by stream."""
        return {
            name: stream.between(self.since, self.done) for name, stream in self.streams.all.items()
        }

    def doubted(self) -> dict[str, Flags]:
        """By stream which of the raw rows are not believed, those that show no slip included."""
        found = {name: self.doubts.at(name, stamps) for name, (stamps, _) in self.raw().items()}
        if ODOMETRY in found:
            found[ODOMETRY] |= self.doubts.at(SHOWS_NO_SLIP, self.raw()[ODOMETRY][0])
        return found

    def _check(self, last: bool) -> None:
        """Learn and check span by span: what is learnt in one depends on what was doubted before it."""
        ends = np.unique(np.concatenate([stamps // SPAN for stamps, _ in self.raw().values()]))
        self.findings, before = (), self.since
        for end in [*(ends[ends * SPAN > self.since] * SPAN).tolist(), self.done]:
            if end > before:
                self.ground.learn(end)
                rows = {name: one.between(before, end) for name, one in self.streams.all.items()}
                self.findings += tuple(self.checks.take(rows, end))
                before = end
        if last:
            self.findings += tuple(self.checks.flush())

    def _forget(self) -> None:
        """Drop the raw rows that the turn, and the next ones, do not need any more."""
        rules = self.streams.rules
        before = self.done - _PAST - WINDOW - 2 * rules.widest
        self.streams.forget(before)
        self.ground.forget(before)
        self.doubts.forget(before)

    def _instants(self, wheel: Wheel, until: int) -> Integers:
        """Stamps of a wheel's rows."""
        settings, streams = self.settings, self.streams.all
        name = f"{wheel.name}/sinkage"
        if name not in streams:
            name = ODOMETRY if wheel.name in settings.static_loads else f"{wheel.name}/load"
        stamps = streams[name].stamps
        stamps = stamps[(stamps > self.done) & (stamps <= until)]
        if name.endswith("/sinkage") or not stamps.size:
            return stamps
        period = stamps // _PREDICTIONS
        new = np.diff(period, prepend=self._predicted[wheel.name]) > 0
        self._predicted[wheel.name] = int(period[-1])
        return stamps[new]

    def _sampled(self, name: str, stamps: Integers) -> Array:
        if name not in self.streams.all:
            return np.full((stamps.size, WIDTHS[name.rpartition("/")[2]]), np.nan)
        return self.ground.believed(name, stamps)

    def _assemble(self, wheel: Integers, stamps: Integers) -> Readings:
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
        for number, one in enumerate(wheels):
            mine = wheel == number
            for kind, column in own.items():
                if f"{one.name}/{kind}" in self.streams.all:
                    column[mine] = self._sampled(f"{one.name}/{kind}", stamps[mine])[:, 0]
            if f"{one.name}/sinkage" in self.streams.all:
                exact = self._sampled(f"{one.name}/sinkage", stamps[mine])
                sinkage[mine], variance[mine] = exact.T
        moves = self._sampled(ODOMETRY, stamps)
        felt = self.ground.imu(stamps)
        trust = self.ground.trust(stamps)
        rim = np.where(rolls, own["wheel_speed"] * diameter / 2.0, np.nan)
        middle, turn = self._middle(stamps, moves, trust)
        gyro = ~np.isnan(felt[:, 0])
        yaw_rate = np.where(gyro, felt[:, 0], self._turned(stamps, turn))
        speed = np.where(rolls, middle - yaw_rate * lateral, np.nan)
        variance_told = moves[:, SPEED_VARIANCE] + np.where(
            gyro, 0.0, moves[:, YAW_VARIANCE] * lateral**2
        )
        told = (variance_told > 0.0) & (settings.velocity != "topic")
        speed_std = np.sqrt(np.where(told, variance_told, trust.variance))
        speed_std = np.hypot(speed_std, self._unsteady(wheel, stamps, trust, gyro))
        if settings.velocity == "none":
            rim = unknown(stamps.size)
        rim_std = _RIM_STD * np.abs(rim)
        slip, slip_std, stands = slip_of(speed, speed_std, rim, rim_std, STANDSTILL_SPEED)
        # A rim that stops before a speed that is late, or has jumped, may stand as the vehicle does: there
        # the speed's deviation counts whole, and not by the share of it that the rim has left.
        skids = np.minimum(
            np.hypot(speed_std, rim_std) / np.maximum(np.abs(speed), STANDSTILL_SPEED), 1.0
        )
        slip_std = np.fmax(slip_std, np.where(np.abs(rim) < np.abs(speed), skids, _RIM_STD))
        slip_std = np.where(np.isfinite(slip), slip_std, np.nan)
        slip, slip_std = (np.where(trust.of_wheels, np.nan, each) for each in (slip, slip_std))
        # What may be made of the wheels says as little as nothing at all.
        slip_std = np.maximum(slip_std, np.where(trust.may_be, _HIDDEN, 0.0))
        faster = np.where(np.abs(rim) > np.abs(speed), rim, speed)
        slope, gained, across = self._felt(stamps, moves, middle, felt)
        torque = self._torque(wheel, own["torque"])
        load = np.where(own["load"] >= _LIGHTEST, own["load"], np.nan)
        load_std = np.hypot(noise.load, _LOAD_STD * load)
        load, load_std = self._static(wheel, load, load_std, slope, gained, across)
        known = np.isfinite(variance) & (variance > 0.0)
        usual = settings.estimator.sinkage_std
        heading = np.arctan2(moves[:, SINE], moves[:, COSINE])
        zeros, no = np.zeros(stamps.size), np.zeros(stamps.size, dtype=bool)
        return Readings(
            stamp=stamps, wheel=wheel, sinkage=sinkage,
            sinkage_std=np.where(known, np.sqrt(np.where(known, variance, 1.0)), usual),
            load=load, load_std=load_std, vehicle_speed=middle, speed=speed, speed_std=speed_std,
            rim_speed=rim, rim_std=rim_std, slip=slip, slip_std=slip_std,
            stands=stands, forward=~(faster < 0.0), slope=slope, gained=gained,
            across=across, yaw_rate=yaw_rate, vertical=felt[:, 3], torque=torque, pull=own["drawbar_pull"],
            pitch=np.nan_to_num(moves[:, PITCH]), x=moves[:, X], y=moves[:, Y], heading=heading,
            distance=zeros, path=zeros, onward=~no, pass_number=unknown(stamps.size), passes=zeros,
            pass_doubt=zeros, due=no,
        )  # fmt: skip

    def _middle(self, stamps: Integers, moves: Array, trust: Trust) -> tuple[Array, Array]:
        """Speed of the vehicle's middle, NaN where it is frozen, and yaw rate, without a gyro."""
        speed, turn = self.ground.speeds(stamps).T
        posed = (moves[:, X] != 0.0) | (moves[:, Y] != 0.0)
        if self.settings.velocity == "topic":
            # A yaw rate of exactly 0 in every message so far is none: then odometry's is used.
            turned = np.logical_or.accumulate(np.concatenate([[self._turns], np.abs(turn) > 0.0]))[
                1:
            ]
            self._turns = bool(turned[-1])
            turn = np.where(turned, turn, np.nan_to_num(moves[:, 1]))
            posed[:] = False
        # A pose cannot stay the same at a speed; what has none may, until the wheels have come a long way.
        same = (trust.since >= _HELD) & (
            (posed & (np.abs(speed) > STANDSTILL_SPEED)) | (trust.way > _HELD_WAY)
        )
        return np.where(same, np.nan, speed), turn

    def _turned(self, stamps: Integers, turn: Array) -> Array:
        """Yaw rate of an odometry, in place of a gyro that is doubted; none where it never turned."""
        turned = np.logical_or.accumulate(np.append(self._moves_turn, np.abs(turn) > 0.0))[1:]
        self._moves_turn = bool(turned[-1])
        _, size, across = self.ground.rims(stamps)
        # Sides whose rims run alike go straight on, whatever the imu says.
        bends = np.abs(across) > 0.02 * size
        return np.where(~turned & bends & self.doubts.at(IMU, stamps), np.nan, turn)

    def _unsteady(self, wheel: Integers, stamps: Integers, trust: Trust, gyro: Flags) -> Array:
        """By how much a speed is off (m/s) that comes late or is a mean over time: what the rims change by.

        Those of all wheels; of the wheel's own where the late one tells the turn, too.
        """
        source = self.streams.all.get(self.ground.source)
        if source is None:
            return np.zeros(stamps.size)
        spread = 0.5 * self._period(stamps) / SECOND + trust.mean
        earlier = (SECOND * (trust.lag + spread)).astype(np.int64)
        ago = np.stack([stamps, stamps - earlier // 2, stamps - earlier])
        rims = self.ground.each_rim(ago.ravel()).reshape(-1, *ago.shape)
        if not len(rims):
            return np.zeros(stamps.size)
        own = np.ptp(rims, axis=1)[self._order[wheel], np.arange(stamps.size)]
        common = np.ptp(rims.mean(axis=0), axis=0)
        rolls = self._order[wheel] >= 0
        return np.asarray(np.nan_to_num(np.where(rolls & ~gyro, own, common)))

    def _period(self, stamps: Integers) -> Integers:
        """Time (ns) between the messages of speed before each instant."""
        moves = self.ground.moves.stamps
        if not moves.size:
            return np.zeros(stamps.size, dtype=np.int64)
        row = np.maximum(np.searchsorted(moves, stamps, side="right") - 1, 0)
        periods = self.ground.moves.periods(moves)[row]
        return np.asarray(np.minimum(periods, self.streams.rules.widest))

    def _torque(self, wheel: Integers, torque: Array) -> Array:
        """Torques; of a driver that leaves the effort empty, 0 in every message, they are not known."""
        found = torque.copy()
        for number in range(len(self._strains)):
            mine = wheel == number
            there = np.concatenate([[self._strains[number]], np.abs(torque[mine]) > 0.0])
            strains = np.logical_or.accumulate(there)[1:]
            found[mine] = np.where(strains, torque[mine], np.nan)
            self._strains[number] |= bool(strains.any())
        return found

    def _felt(
        self, stamps: Integers, moves: Array, middle: Array, felt: Array
    ) -> tuple[Array, Array, Array]:
        """What slope and gaining speed take of the wheels per mass, and the slope across, m/s^2."""
        over = np.maximum(_GAINING, 2 * self._period(stamps))
        before = self.ground.speeds(stamps - over)[:, 0]
        gained = (middle - before) / (over / SECOND)
        gravity = self.settings.gravity
        if self.settings.with_imu:
            _, ahead, left, above, *up = felt.T
            oriented, rest = ~np.isnan(up[2]), np.nan_to_num(gained)
            slope = np.where(oriented, gravity * up[0], ahead - rest)
            across = np.where(oriented, gravity * up[1], left)
            upright = np.where(oriented, gravity * up[2], above) > _UPRIGHT * gravity
            gained = np.where(oriented | np.isnan(ahead), gained, rest)
            slope, across = (np.where(upright, each, np.nan) for each in (slope, across))
            return slope, gained, across
        # An odometry of the plane has a pitch of exactly 0 in every message: it measures none.
        pitch = moves[:, PITCH]
        pitches = np.logical_or.accumulate(np.concatenate([[self._pitches], np.abs(pitch) > 0.0]))[
            1:
        ]
        self._pitches = bool(pitches[-1])
        slope = np.where(pitches, -gravity * np.sin(pitch), np.nan)
        across = np.where(pitches, gravity * np.cos(pitch) * np.sin(moves[:, ROLL]), np.nan)
        return slope, gained, across

    def _static(
        self,
        wheel: Integers,
        load: Array,
        load_std: Array,
        slope: Array,
        gained: Array,
        across: Array,
    ) -> tuple[Array, Array]:
        """Loads that are not measured: as configured, as tilt and gained speed move them (a rigid frame)."""
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
        behind = (np.nan_to_num(slope) + np.nan_to_num(gained)) / settings.gravity
        right = np.nan_to_num(across) / settings.gravity
        along, aside = (
            _levers(settings.wheels, name)[wheel]
            for name in ("longitudinal_position", "lateral_position")
        )
        moved = -weight * settings.gravity_height * (behind * along + right * aside)
        static = np.maximum(level + moved, _LEAST_LOAD * level)
        static_std = np.hypot(
            np.array(spread)[wheel], 0.5 * moved
        )  # half the height is what is known of it
        given = ~np.isnan(level)
        return np.where(given, static, load), np.where(given, static_std, load_std)


def _levers(wheels: tuple[Wheel, ...], name: str) -> Array:
    """Places of wheels about the middle of all, over the sum of their squares, 1/m."""
    places = np.array([getattr(wheel, name) for wheel in wheels])
    off = places - places.mean()
    squares = float(off @ off)
    return off / squares if squares > 0.0 else np.zeros(off.size)


def slip_of(
    speed: Array, speed_std: Array, rim: Array, rim_std: Array, standstill: float
) -> tuple[Array, Array, Flags]:
    """Slip of wheels, its deviation, and which of them stand.

    i = 1 - v/(r omega) driven, r omega/v - 1 skidding. One of both speeds must be above
    `standstill` (m/s) and four of its own deviations: else nothing tells that the wheel moves at all.
    """
    with np.errstate(all="ignore"):
        driven = np.abs(rim) >= np.abs(speed)
        base, other = np.where(driven, rim, speed), np.where(driven, speed, rim)
        base_std, other_std = (
            np.where(driven, rim_std, speed_std),
            np.where(driven, speed_std, rim_std),
        )
        known = np.isfinite(speed) & np.isfinite(rim)
        moves = (np.abs(rim) > np.maximum(standstill, _MOVES * rim_std)) | (
            np.abs(speed) > np.maximum(standstill, _MOVES * speed_std)
        )
        moves &= known
        ratio = other / base
        spread = np.hypot(other_std, ratio * base_std) / np.abs(base)
        slip = np.minimum(1.0, 1.0 - ratio)
        slip = np.where(moves, np.where(driven, slip, -slip), np.nan)
        return slip, np.where(moves, np.minimum(spread, 1.0), np.nan), known & ~moves
