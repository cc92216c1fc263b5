# SPDX-License-Identifier: Apache-2.0
"""What the rules of `checks` look at: raw rows of a short, fixed span of time, put side by side.

A span begins at a multiple of `SPAN` of the stamps, and is looked at once all rows up to `AROUND` after it
are there. So a rule meets the same rows in the same portions, however the messages were cut into blocks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, VELOCITY, OnboardSettings
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import GRAVITY
from smallwheel_ros.pipeline.tables import Array, Flags, Integers

from .ground_speed import Known
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
    """The rolling wheels with measured rim speeds; arrays have one value for each.

    x, y: their places, m. radius: m. mass: kg, of the vehicle; 0: not known. gravity: m/s^2. steered:
    names of those that are steered.
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
    """Times (s from the beginning of the span) and values (rows, columns) of one source."""

    t: Array
    x: Array

    @cached_property
    def dt(self) -> Array:
        """How long each row holds, s; 0 over a gap."""
        dt = np.diff(self.t, append=self.t[-1:])
        return np.where(dt > GAP, 0.0, dt)

    @cached_property
    def inside(self) -> Flags:
        """Which rows are of the span itself."""
        return np.asarray((self.t >= 0.0) & (self.t < SPAN / SECOND))

    def at(self, t: Array, column: int) -> Array:
        """A column, interpolated linearly.

        Parameters
        ----------
        t
            Shape (times,), s.
        column
            Number of the column.

        Returns
        -------
        ndarray
            Shape (times,); NaN over a gap and outside.
        """
        if len(self.t) < 2:
            return np.full(t.size, np.nan)
        y = np.interp(t, self.t, self.x[:, column], np.nan, np.nan)
        after = np.clip(np.searchsorted(self.t, t), 1, len(self.t) - 1)
        return np.where(self.t[after] - self.t[after - 1] > 2 * GAP, np.nan, y)

    @cached_property
    def changes(self) -> Flags:
        """Which values differ, bit for bit, from those of the row before; NaN is no value."""
        before = np.vstack([self.x[:1], self.x[:-1]])
        return np.asarray((self.x != before) & np.isfinite(self.x) & np.isfinite(before))

    @cached_property
    def same(self) -> Flags:
        """Which rows are, bit for bit, the one before."""
        before = np.vstack([np.full((1, self.x.shape[1]), np.inf), self.x[:-1]])
        alike = (self.x == before) | (np.isnan(self.x) & np.isnan(before))
        return np.asarray(alike.all(axis=1) & np.isfinite(self.x).any(axis=1))

    @cached_property
    def stale(self) -> Flags:
        """Rows that have repeated an older one for longer than `GAP`: they are no evidence."""
        last_new = np.maximum.accumulate(np.where(self.same, -np.inf, self.t))
        return np.asarray(self.t - last_new > GAP)


@dataclass
class Memory:
    """Knowledge from the whole drive that changes how a span is read.

    known: what has turned out of odometry and imu. turns: whether the odometry ever had a yaw rate that is
    not 0. way: m by the rims, up to the span. doubted: streams that the rules before have named in this span.
    """

    known: Known = field(default_factory=Known)
    turns: bool = False
    way: float = 0.0
    doubted: set[str] = field(default_factory=set)


class Window:
    """The rows of a span and around it; None where there are none. begin: ns. rims: m/s at the rim."""

    def __init__(self, vehicle: CheckedWheels, raw: Raw, begin: int, memory: Memory) -> None:
        self.vehicle, self.begin, self.memory = vehicle, begin, memory
        self._raw = {name: self._cut(*rows) for name, rows in raw.items()}
        self.rims = self._wheels("wheel_speed", vehicle.radius)
        ones = np.ones(len(vehicle.names))
        self.loads, self.sinkages = self._wheels("load", ones), self._wheels("sinkage", ones)
        self.imu = self._source(IMU, 4)
        self.odometry = self._source(ODOMETRY, 6)
        self.velocity = self._source(VELOCITY, 2)
        if self.odometry is not None:
            memory.turns |= bool(np.nan_to_num(self.moves.x[:, YAW_RATE]).any())

    def _cut(self, stamps: Integers, values: Array) -> Rows:
        first, last = np.searchsorted(stamps, [self.begin - AROUND, self.begin + SPAN + AROUND])
        return Rows((stamps[first:last] - self.begin) / SECOND, values[first:last])

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

    @cached_property
    def moves(self) -> Rows:
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

    @cached_property
    def rim_way(self) -> Array:
        """Way by the rims at their rows, m from the beginning of the drive."""
        assert self.rims is not None
        speed = np.nan_to_num(np.abs(np.nanmedian(np.abs(self.rims.x), axis=1)))
        way = np.concatenate([[0.0], np.cumsum((speed * self.rims.dt)[:-1])])
        return np.asarray(way - np.interp(0.0, self.rims.t, way) + self.memory.way)

    def way(self, t: Array) -> Array:
        """Way by the rims at times of the window, m."""
        if self.rims is None:
            return np.full(t.size, self.memory.way)
        return np.interp(t, self.rims.t, self.rim_way)

    def seconds(self, t: Array) -> Array:
        """Stamps of times of the window, s."""
        return np.asarray(t + self.begin / SECOND)

    def rims_at(self, t: Array) -> Array:
        """Speeds of the rims at times of the window, (times, wheels)."""
        assert self.rims is not None
        return np.stack([self.rims.at(t, i) for i in range(self.rims.x.shape[1])], axis=1)

    def angles_at(self, t: Array) -> Array:
        """Steering angles (rad, to the left) at times of the window, (times, wheels); NaN: not known."""
        found = np.zeros((t.size, len(self.vehicle.names)))
        for i, name in enumerate(self.vehicle.names):
            if name in self.vehicle.steered:
                rows = self._raw.get(f"{name}/steering")
                found[:, i] = np.nan if rows is None else rows.at(t, 0)
        return found

    def direction_at(self, t: Array) -> Array:
        """Way that the vehicle goes against its heading (rad) by poses 0.5 s apart; NaN: not known.

        Within 90 degrees of ahead, backward too. Poses that are computed from the wheels show none.
        """
        o = self.odometry
        if o is None or self.memory.known.of_wheels or not o.x[:, [X, Y]].any():
            return np.full(t.size, np.nan)
        x, y, cosine, sine = (Rows(o.t, o.x[:, [k]]) for k in (X, Y, COSINE, SINE))
        dx, dy = (c.at(t + GAP / 2, 0) - c.at(t - GAP / 2, 0) for c in (x, y))
        ahead = dx * cosine.at(t, 0) + dy * sine.at(t, 0)
        left = dy * cosine.at(t, 0) - dx * sine.at(t, 0)
        moves = np.hypot(dx, dy) > MOVES * GAP / 2
        return np.where(moves, np.arctan2(left * np.sign(ahead), np.abs(ahead)), np.nan)

    def rims_ahead_at(self, t: Array) -> Array:
        """Parts ahead of the rims' speeds, (times, wheels); NaN of wheels that are steered far."""
        rims = self.rims_at(t)
        return self._ahead(rims, t) if self.vehicle.steered else rims

    def _ahead(self, rims: Array, t: Array) -> Array:
        angles = self.angles_at(t)
        return np.where(np.abs(angles) <= FAR, np.cos(angles) * rims, np.nan)

    @cached_property
    def motion(self) -> Motion | None:
        """Rows of the rims with all that is compared to them; None without rims."""
        rims, memory = self.rims, self.memory
        if rims is None:
            return None
        nothing: Array = np.full(len(rims.t), np.nan)
        v: Array = nothing
        w: Array = nothing
        if self.odometry is not None and not memory.known.of_wheels:
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
        return Motion(rims.t, rims.dt, ahead, v, w, gyro, straight, rims.inside)


@dataclass(frozen=True)
class Motion:
    """Rows of the rims: times and durations (s), rims (m/s), speed, yaw rates, straight, of the span.

    Of steered wheels rims are their parts ahead, NaN where they point far aside.
    """

    t: Array
    dt: Array
    rim: Array
    v: Array
    w: Array
    gyro: Array
    straight: Flags
    inside: Flags
