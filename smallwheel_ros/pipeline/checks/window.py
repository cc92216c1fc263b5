# SPDX-License-Identifier: Apache-2.0
"""The rows that the rules of `checks` use: those of all sources over a span of 2 s, and around it.

A span begins at a multiple of `SPAN` and is judged once all rows up to `AROUND` after its end have arrived.
A rule therefore gets the same rows in the same portions, however the messages were cut into blocks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, VELOCITY, OnboardSettings
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import GRAVITY
from smallwheel_ros.pipeline.tables import Array, Flags, Integers

from .lateness import MOVES

SPAN = 2 * SECOND  # ns, between judgements: long against the work of one, short against a fault
AROUND = (
    2 * SECOND
)  # ns of rows on both sides: a delay of 1 s, changes over 0.5 s and their mean are in it
GAP = 0.5  # s: over a longer gap nothing is added up
FAR = 0.5  # rad of a steering angle, beyond which what a rim does ahead hangs on the angle itself
STRAIGHT = 0.1  # of v: what a bend may add to the speed of a wheel's place; a radius is known to that anyway
SPEED, YAW_RATE, X, Y, COSINE, SINE = range(6)  # of a row of the odometry
GYRO, AHEAD, LEFT, ABOVE = range(4)  # of a row of the imu
Raw = Mapping[str, tuple[Integers, Array]]  # of streams: stamps (ns) and values (rows, width)


@dataclass(frozen=True)
class CheckedWheels:
    """The rolling wheels with measured rim speeds; arrays of shape (wheels,).

    Attributes
    ----------
    names
        Names of the wheels.
    x, y
        Positions ahead and to the left of the base frame, m.
    radius
        Radii of the wheels, m.
    mass
        Mass of the vehicle, kg; 0: not known.
    gravity
        Acceleration of gravity, m/s^2.
    steered
        Names of the steered wheels.
    """

    names: tuple[str, ...]
    x: Array
    y: Array
    radius: Array
    mass: float = 0.0
    gravity: float = GRAVITY
    steered: frozenset[str] = frozenset()

    @classmethod
    def of(cls, settings: OnboardSettings) -> CheckedWheels:
        """The vehicle that the settings describe."""
        wheels = [
            wheel
            for wheel in settings.wheels
            if wheel.contact == ROLLING and f"{wheel.name}/wheel_speed" in settings.streams
        ]
        return cls(
            tuple(wheel.name for wheel in wheels),
            np.array([wheel.longitudinal_position for wheel in wheels]),
            np.array([wheel.lateral_position for wheel in wheels]),
            np.array([0.5 * wheel.diameter for wheel in wheels]),
            settings.mass,
            settings.gravity,
            frozenset(settings.steered),
        )


@dataclass(frozen=True)
class Rows:
    """Rows of one source.

    Attributes
    ----------
    t
        Times from the beginning of the span, rising, shape (rows,), s.
    x
        Values, shape (rows, columns), SI.
    """

    t: Array
    x: Array

    @property
    def held(self) -> Array:
        """Time until the next row, s, (rows,); 0 before a gap of more than `GAP`, and for the last row."""
        dt = np.diff(self.t, append=self.t[-1:])
        return np.where(dt > GAP, 0.0, dt)

    def at(self, t: Array, column: int) -> Array:
        """Interpolate a column linearly.

        Parameters
        ----------
        t
            Times from the beginning of the span, shape (times,), s.
        column
            Index of the column.

        Returns
        -------
        ndarray
            Shape (times,); NaN between rows more than 1 s apart, and outside of all rows.
        """
        if len(self.t) < 2:
            return np.full(t.size, np.nan)
        y = np.interp(t, self.t, self.x[:, column], np.nan, np.nan)
        after = np.clip(np.searchsorted(self.t, t), 1, len(self.t) - 1)
        return np.where(self.t[after] - self.t[after - 1] > 2 * GAP, np.nan, y)


@dataclass(frozen=True)
class Source(Rows):
    """Rows of one source, with what the rules need of each row; shape (rows,) unless stated.

    Attributes
    ----------
    t, x
        Times and values as in `Rows`.
    stamp
        Stamp, s.
    dt
        Time until the next row, s; 0 before a gap.
    inside
        Whether the row lies in the span itself, not only around it.
    changes
        Mask of the values that differ, bit for bit, from the row before, (rows, columns); False for NaN.
    same
        Whether the whole row equals, bit for bit, the one before.
    stale
        Whether it has repeated an older row for longer than `GAP`, so that it is no evidence.
    rims
        Speeds of the rims at the row, (rows, wheels), m/s.
    way
        Path of the rims from the beginning of the drive, m.
    """

    stamp: Array
    dt: Array
    inside: Flags
    changes: Flags
    same: Flags
    stale: Flags
    rims: Array
    way: Array

    @classmethod
    def of(cls, rows: Rows, begin: int, rims: Array, way: Array) -> Source:
        """Compute everything that rules need of a source's rows.

        Parameters
        ----------
        rows
            Rows of the source, in the span and around it.
        begin
            Beginning of the span, ns.
        rims
            Speeds of the rims at these rows, shape (rows, wheels), m/s.
        way
            Path of the rims from the beginning of the drive, shape (rows,), m.

        Returns
        -------
        Source
            The rows, as many as were given.
        """
        t, x = rows.t, rows.x
        before = np.vstack([x[:1], x[:-1]])
        changes = (x != before) & np.isfinite(x) & np.isfinite(before)
        before[:1] = np.inf
        same = ((x == before) | (np.isnan(x) & np.isnan(before))).all(axis=1)
        same &= np.isfinite(x).any(axis=1)
        stale = t - np.maximum.accumulate(np.where(same, -np.inf, t)) > GAP
        inside = (t >= 0.0) & (t < SPAN / SECOND)
        return cls(t, x, t + begin / SECOND, rows.held, inside, changes, same, stale, rims, way)


@dataclass(frozen=True)
class Known:
    """What `GroundSpeed` has learnt of odometry and imu, for the rules that report it.

    Attributes
    ----------
    share
        For an odometry computed from the wheels, relative difference of its path from a constant multiple of
        that of the rims; NaN for an independent one.
    no_twist
        Distance by the pose while every twist was 0, m; NaN once one was not.
    down
        Whether z of the imu points down.
    against
        Distance over which the odometry goes against the rims, m, if that is nearly all of its path and no
        slide; else 0.
    slides
        Whether the speed goes against the rims over nearly all of its path, but the vehicle may be sliding
        down a slope.
    """

    share: float = math.nan
    no_twist: float = 0.0
    down: bool = False
    against: float = 0.0
    slides: bool = False

    @cached_property
    def of_wheels(self) -> bool:
        """Whether the odometry is computed from the wheels."""
        return math.isfinite(self.share)

    @cached_property
    def twist(self) -> bool:
        """Whether any twist was other than 0."""
        return math.isnan(self.no_twist)


@dataclass
class Memory:
    """What earlier spans have shown that the rules need for the present span, and what this has shown so far.

    Attributes
    ----------
    known
        What is known of odometry and imu at the end of the span.
    turns
        Whether the odometry ever had a yaw rate other than 0.
    way
        Path of the rims up to the beginning of the span, m.
    of_map
        Whether the odometry's twist was found to be along the axes of the map.
    doubted
        Streams that rules already run on the present span have reported (rules run in the order of `RULES` in
        `rules.py`); emptied at each span.
    """

    known: Known = field(default_factory=Known)
    turns: bool = False
    way: float = 0.0
    of_map: bool = False
    doubted: set[str] = field(default_factory=set)


class Window:
    """The rows of all sources in a span of 2 s and around it; None for a source with fewer than three rows.

    `pose_steps` has the steps (m) of the odometry's pose along x and y over `GAP` about its rows.

    Parameters
    ----------
    vehicle
        The wheels.
    raw
        Rows by stream: stamps (ns) and values (rows, width).
    begin
        Stamp at which the span begins, ns.
    memory
        What earlier spans have shown; its `turns` is updated.

    Attributes
    ----------
    rims, loads, sinkages
        Rim speeds (m/s), loads (N) and sinkages (m), a column for each wheel, NaN where one has no row.
    imu
        Yaw rate (rad/s) and specific force ahead, left and up (m/s^2).
    odometry
        Speed (m/s), yaw rate (rad/s), x and y (m), cosine and sine of the heading.
    velocity
        Speed (m/s) and yaw rate (rad/s) of a velocity topic.
    moves
        Speed (m/s), yaw rate (rad/s) and heading (rad) by the odometry; never None, without an odometry
        there are no rows.
    motion
        Motion of the vehicle at the stamps of the rims.
    """

    def __init__(self, vehicle: CheckedWheels, raw: Raw, begin: int, memory: Memory) -> None:
        self.vehicle, self.begin, self.memory = vehicle, begin, memory
        self._raw = {name: self._cut(*rows) for name, rows in raw.items()}
        ones = np.ones(len(vehicle.names))
        self._rims = self._wheels("wheel_speed", vehicle.radius)
        self._rim_way = None if self._rims is None else self._way_of(self._rims)
        self.rims = self._asked(self._rims)
        self.loads = self._asked(self._wheels("load", ones))
        self.sinkages = self._asked(self._wheels("sinkage", ones))
        self.imu = self._asked(self._source(IMU, 4))
        self.odometry = self._asked(self._source(ODOMETRY, 6))
        o = self.odometry
        self.pose_steps = np.zeros((2, 0)) if o is None else self._pose_steps(o, o.t)
        self.velocity = self._source(VELOCITY, 2)
        self.moves = self._moves()
        if self.odometry is not None:
            memory.turns |= bool(np.nan_to_num(self.moves.x[:, YAW_RATE]).any())
        self.motion = self._motion()

    def _cut(self, stamps: Integers, values: Array) -> Rows:
        first, last = np.searchsorted(stamps, [self.begin - AROUND, self.begin + SPAN + AROUND])
        return Rows((stamps[first:last] - self.begin) / SECOND, values[first:last])

    def _asked(self, rows: Rows | None) -> Source | None:
        return (
            None
            if rows is None
            else Source.of(rows, self.begin, self.rims_at(rows.t), self.way(rows.t))
        )

    def _source(self, name: str, columns: int) -> Rows | None:
        rows = self._raw.get(name)
        if rows is None or len(rows.t) < 3 or rows.x.shape[1] < columns:
            return None
        return Rows(rows.t, rows.x[:, :columns])

    @cached_property
    def oriented(self) -> bool:
        """Whether the imu has orientations."""
        rows = self._raw.get(IMU)
        return rows is not None and bool(np.isfinite(rows.x[:, 4:]).any())

    def _wheels(self, kind: str, factor: Array) -> Rows | None:
        """All wheels at the stamps of the slowest: the newest value of each, NaN where it is over `GAP` old.

        Messages of one joint state have one stamp; load cells may publish one by one.
        """
        each = [self._raw.get(f"{name}/{kind}") for name in self.vehicle.names]
        told = [rows for rows in each if rows is not None and len(rows.t) >= 3]
        if not told:
            return None
        t = min(told, key=lambda rows: len(rows.t)).t
        x = np.full((t.size, len(each)), np.nan)
        for i, rows in enumerate(each):
            if rows is None or not len(rows.t):
                continue
            last = np.searchsorted(rows.t, t, side="right") - 1
            fresh = (last >= 0) & (t - rows.t[np.maximum(last, 0)] <= GAP)
            x[fresh, i] = rows.x[last[fresh], 0] * factor[i]
        return Rows(t, x)

    def _moves(self) -> Rows:
        """Odometry as speed, yaw rate and heading: by its twist, or by the pose while that was always 0."""
        o = self.odometry
        if o is None:
            return Rows(np.zeros(0), np.zeros((0, 3)))
        heading = np.unwrap(np.arctan2(o.x[:, SINE], o.x[:, COSINE]))
        if self.memory.known.twist:
            return Rows(o.t, np.column_stack([o.x[:, SPEED], o.x[:, YAW_RATE], heading]))
        dx, dy, turn = (
            (np.interp(o.t + GAP, o.t, c) - np.interp(o.t - GAP, o.t, c)) / (2 * GAP)
            for c in (o.x[:, X], o.x[:, Y], heading)
        )
        speed = dx * np.cos(heading) + dy * np.sin(heading)
        return Rows(o.t, np.column_stack([speed, turn, heading]))

    def _way_of(self, rims: Rows) -> Array:
        """Path of the rims from the beginning of the drive, at their rows, m."""
        speed = np.nan_to_num(np.abs(np.nanmedian(np.abs(rims.x), axis=1)))
        way = np.concatenate([[0.0], np.cumsum((speed * rims.held)[:-1])])
        return np.asarray(way - np.interp(0.0, rims.t, way) + self.memory.way)

    def way(self, t: Array) -> Array:
        """Path of the rims from the beginning of the drive (m) at times from that of the span (s)."""
        if self._rims is None or self._rim_way is None:
            return np.full(t.size, self.memory.way)
        return np.interp(t, self._rims.t, self._rim_way)

    def rims_at(self, t: Array) -> Array:
        """Speeds of the rims at times from the beginning of the span (s), (times, wheels), m/s."""
        rims, wheels = self._rims, len(self.vehicle.names)
        if rims is None:
            return np.full((t.size, wheels), np.nan)
        return np.stack([rims.at(t, i) for i in range(wheels)], axis=1)

    def angles_at(self, t: Array) -> Array:
        """Steering angles (rad, to the left) at times from the beginning of the span (s), (times, wheels).

        0 for a wheel that is not steered; NaN where an angle is unknown.
        """
        found = np.zeros((t.size, len(self.vehicle.names)))
        for i, name in enumerate(self.vehicle.names):
            if name in self.vehicle.steered:
                rows = self._raw.get(f"{name}/steering")
                found[:, i] = np.nan if rows is None else rows.at(t, 0)
        return found

    def direction_at(self, t: Array) -> Array:
        """Direction of travel to the left of the heading, by poses 0.5 s apart, rad.

        Within 90 degrees of straight ahead, also when the vehicle backs up. NaN if unknown, as with poses
        that are computed from the wheels. t: times from the beginning of the span, s.
        """
        o = self.odometry
        if o is None or self.memory.known.of_wheels or not o.x[:, [X, Y]].any():
            return np.full(t.size, np.nan)
        dx, dy = self._pose_steps(o, t)
        cosine, sine = o.at(t, COSINE), o.at(t, SINE)
        ahead, left = dx * cosine + dy * sine, dy * cosine - dx * sine
        moves = np.hypot(dx, dy) > MOVES * GAP / 2
        return np.where(moves, np.arctan2(left * np.sign(ahead), np.abs(ahead)), np.nan)

    @staticmethod
    def _pose_steps(rows: Rows, t: Array) -> Array:
        """Steps (m) of the pose along x and y of its frame, over `GAP` about times, shape (2, times)."""
        return np.stack([rows.at(t + GAP / 2, k) - rows.at(t - GAP / 2, k) for k in (X, Y)])

    def rims_ahead_at(self, t: Array) -> Array:
        """Components of the rims' speeds along the heading, (times, wheels), m/s; NaN at large angles."""
        rims = self.rims_at(t)
        return self._ahead(rims, t) if self.vehicle.steered else rims

    def _ahead(self, rims: Array, t: Array) -> Array:
        angles = self.angles_at(t)
        return np.where(np.abs(angles) <= FAR, np.cos(angles) * rims, np.nan)

    def _motion(self) -> Motion | None:
        """Rows of the rims with all that is compared to them; None without rims."""
        rims, memory = self.rims, self.memory
        if rims is None:
            return None
        nothing: Array = np.full(len(rims.t), np.nan)
        v: Array = nothing
        w: Array = nothing
        if self.odometry is not None and not (memory.known.of_wheels or memory.of_map):
            moves = Rows(self.moves.t, np.where(self.odometry.stale[:, None], np.nan, self.moves.x))
            v = moves.at(rims.t, SPEED)
            w = moves.at(rims.t, YAW_RATE) if memory.turns else nothing
        elif self.velocity is not None and not memory.known.of_wheels:
            v = self.velocity.at(rims.t, SPEED)
        gyro: Array = nothing
        if self.imu is not None:
            imu = Rows(self.imu.t, np.where(self.imu.stale[:, None], np.nan, self.imu.x))
            gyro = imu.at(rims.t, GYRO) * (-1.0 if memory.known.down else 1.0)
        yaw = np.fmax(np.abs(w), np.abs(gyro))
        half = float(np.ptp(self.vehicle.y)) / 2
        straight = (np.abs(v) > MOVES) & ~(yaw * half >= STRAIGHT * np.abs(v)) & np.isfinite(yaw)
        ahead = self._ahead(rims.x, rims.t) if self.vehicle.steered else rims.x
        return Motion(rims.t, rims.stamp, rims.dt, ahead, v, w, gyro, straight, rims.inside)


@dataclass(frozen=True)
class Motion:
    """Motion of the vehicle over the span and around it, a row for each stamp of the rims.

    Attributes
    ----------
    t, stamp, dt
        Time from the beginning of the span, stamp, and time until the next row (0 before a gap), s.
    rim
        Speeds of the rims, m/s, (rows, wheels); on a vehicle that steers their components along the heading,
        NaN at angles over `FAR`.
    v, w, gyro
        Speed over ground (m/s), and yaw rate by the odometry and by the gyro (rad/s), (rows,); NaN where
        unknown, or where the odometry is computed from the wheels.
    straight, inside
        Whether the vehicle drives straight; whether the row lies in the span itself.
    """

    t: Array
    stamp: Array
    dt: Array
    rim: Array
    v: Array
    w: Array
    gyro: Array
    straight: Flags
    inside: Flags
