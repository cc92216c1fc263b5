# SPDX-License-Identifier: Apache-2.0
"""Made drives as lists of rows of streams, in the order of arrival, and the pipeline over them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.pipeline.checks.believed import BelievedRows
from smallwheel_ros.pipeline.intake.layout import rules_of, widths_of
from smallwheel_ros.pipeline.intake.streams import Streams
from smallwheel_ros.pipeline.mobility.vehicle import VehicleEstimates
from smallwheel_ros.pipeline.pipeline import Pipeline, Turn
from smallwheel_ros.pipeline.rows.motion import motion
from smallwheel_ros.pipeline.tables import Columns, Estimates, Integers, Readings, none_of
from smallwheel_ros.simulate import Drive
from smallwheel_ros.simulate.drive_bag import recorded

Array = NDArray[np.float64]
Row = tuple[str, int, tuple[float, ...], int | None]  # stream, stamp, values, what the clock said
START = 1_700_000_000 * SECOND
PLACES = {"fl": (0.3, 0.25), "fr": (0.3, -0.25), "rl": (-0.3, 0.25), "rr": (-0.3, -0.25)}
G = 9.80665


def rover(**parameters: object) -> NodeSettings:
    """Four driven wheels of 0.25 m, their sinkages and loads measured, with an imu."""
    given: dict[str, object] = {"wheels": list(PLACES), "vehicle.mass": 24.0, "imu_topic": "imu"}
    for name, (ahead, left) in PLACES.items():
        given |= {f"{name}.diameter": 0.25, f"{name}.width": 0.1}
        given |= {f"{name}.longitudinal_position": ahead, f"{name}.lateral_position": left}
    given |= parameters
    return settings_from({key: value for key, value in given.items() if value is not None})


def static_rover(**parameters: object) -> NodeSettings:
    """The same without load cells and sinkage sensors, as most robots are."""
    given: dict[str, object] = {"load.source": "static"}
    given |= {f"{name}.sinkage_topic": "" for name in PLACES}
    return rover(**(given | parameters))


def drive(
    seconds: float = 12.0,
    *,
    seed: int = 0,
    speed: Callable[[Array], Array] = lambda t: np.where(t > 1.0, 0.3, 0.0),
    turn: Callable[[Array], Array] = lambda t: 0.0 * t,
    slip: float = 0.1,
    wave: float = 0.0,
    noise: float = 0.005,
    soil: bool = True,
    twist: bool = True,
    odometry_rate: float = 20.0,
    late: float = 0.0,
    of_wheels: bool = False,
    imu_down: bool = False,
    oriented: bool = False,
) -> list[Row]:
    """Rows of a drive on the level in the order of their stamps.

    wave: how much, of itself, slip comes and goes.
    late: s by which odometry shows what was before. of_wheels: whether it is made of the rims.
    """
    random = np.random.default_rng(seed)
    rows: list[Row] = []

    def add(name: str, t: Array, *values: Array) -> None:
        for i, at in enumerate(t):
            stamp = START + round(float(at) * 1e9)
            rows.append((name, stamp, tuple(float(value[i]) for value in values), stamp))

    def times(rate: float, offset: float) -> Array:
        return np.arange(offset, seconds, 1.0 / rate)

    fine = np.arange(-2.0, seconds + 1.0, 0.001)
    step = 0.001
    heading = np.cumsum(turn(fine)) * step
    x = np.cumsum(speed(fine) * np.cos(heading)) * step
    y = np.cumsum(speed(fine) * np.sin(heading)) * step
    for k, (name, (_, left)) in enumerate(PLACES.items()):
        t = times(50.0, 0.001 * k)
        ground = speed(t) - turn(t) * left
        rim = ground / (1.0 - slip * (1.0 + wave * np.sin(0.7 * t)))
        add(f"{name}/wheel_speed", t, rim / 0.125)
        if soil:
            t = times(25.0, 0.003 + 0.001 * k)
            load = 58.0 + 2.0 * np.sin(t + k)
            add(f"{name}/load", t, load + 0.3 * random.standard_normal(t.size))
            depth = 0.012 * (load / 58.0) + 5e-4 * random.standard_normal(t.size)
            add(f"{name}/sinkage", t + 0.002, depth, np.full(t.size, 2.5e-7))
    t = times(odometry_rate, 0.0105)
    s = t - late
    v = speed(s) / (1.0 - slip) if of_wheels else speed(s) + noise * random.standard_normal(t.size)
    w = turn(s) / (1.0 - slip) if of_wheels else turn(s) + noise * random.standard_normal(t.size)
    pose = [np.interp(s, fine, column) for column in (x, y, heading)]
    zero = np.zeros(t.size)
    twists = (v, w) if twist else (zero, zero)
    add(
        "odom",
        t,
        *twists,
        pose[0],
        pose[1],
        np.cos(pose[2]),
        np.sin(pose[2]),
        zero,
        zero,
        zero,
        zero,
    )
    t = times(50.0, 0.0071)
    sign = -1.0 if imu_down else 1.0
    felt = np.gradient(speed(t), t) + 0.05 * random.standard_normal(t.size)
    up = np.full(t.size, sign if oriented else np.nan)
    flat = np.zeros(t.size) if oriented else up
    left = speed(t) * turn(t)
    unknown = np.full(t.size, np.nan)  # the pitch rate
    above = np.full(t.size, sign * G)
    add("imu", t, sign * turn(t), felt, sign * left, above, flat, flat, up, unknown)
    return sorted(rows, key=lambda row: row[1])


def rover_of(made: Drive, **changes: object) -> NodeSettings:
    """Settings of the rover of a simulated drive."""
    values: dict[str, object] = {"wheels": [wheel.name for wheel in made.rover.wheels]}
    for wheel in made.rover.wheels:
        values |= {f"{wheel.name}.diameter": wheel.diameter, f"{wheel.name}.width": wheel.width}
        values[f"{wheel.name}.lateral_position"] = wheel.y
        values[f"{wheel.name}.longitudinal_position"] = wheel.x
    return settings_from({**values, **changes})


def rows_of(made: Drive, late: Callable[[str], float] = lambda _: 0.0) -> list[Row]:
    """Rows of a simulated drive in the order of arrival; the clock says when each arrives.

    Its odometry tells neither variances nor a slope.
    late: s by which those of a stream arrive later than they were recorded.
    """
    found: list[Row] = []

    arrivals = recorded(made)
    for name, (stamps, values) in made.rows.items():
        kind = name.rpartition("/")[2]
        if kind not in ("load", "sinkage", "wheel_speed", "odom"):
            continue
        if kind == "odom":
            values = np.column_stack([values[:, :6], np.zeros((len(values), 4))])
        arrival = arrivals["joint_states" if kind == "wheel_speed" else name]
        arrival = (arrival + round(late(name) * SECOND)).tolist()
        each = zip(stamps.tolist(), values.tolist(), arrival, strict=True)
        found += [(name, stamp, tuple(row), now) for stamp, row, now in each]
    return sorted(found, key=lambda row: (row[3], row[0]))


class FirstStages(Pipeline):
    """The pipeline up to the readings, with its checks: most of its work comes after them."""

    def _through(self, believed: BelievedRows, heard: Integers) -> Turn:
        aligned = self.align.take(believed)
        rows = none_of(Readings) if aligned is None else motion(self.motion, aligned, self.settings)
        nothing = none_of(Estimates), none_of(VehicleEstimates), None, None
        return Turn(
            believed.done, self._starts_over, rows, rows.wheel, *nothing, self.checks.findings
        )


def readings_of(
    settings: NodeSettings,
    rows: Sequence[Row],
    cuts: Sequence[int] = (),
    *,
    pipeline: Pipeline | None = None,
) -> Readings:
    """Readings alone, without what the stages after them make of them."""
    return run(settings, rows, cuts, pipeline=pipeline or FirstStages(settings.onboard))[0]


def run(
    settings: NodeSettings,
    rows: Sequence[Row],
    cuts: Sequence[int] = (),
    *,
    together: bool = False,
    span: int | None = None,
    pipeline: Pipeline | None = None,
) -> tuple[Readings, Estimates]:
    """Readings and estimates of rows with turns at cuts. together: rows between cuts are given at once.

    span: ns of a turn, of which two are taken at a cut; None: one takes all.
    """
    pipeline = pipeline or Pipeline(settings.onboard)
    known = set(widths_of(settings.onboard))
    rows = [row for row in rows if row[0] in known]
    turns = []
    begin = 0
    for cut in [*sorted(set(cuts)), len(rows)]:
        give(pipeline.streams, rows[begin:cut], together=together)
        turns += islice(pipeline.turns(span=span), 2 if span else None)
        begin = cut
    turns += pipeline.turns(last=True, span=span)
    readings = Readings.joined([turn.readings for turn in turns])
    return readings, Estimates.joined([turn.estimates for turn in turns])


def give(streams: Streams, rows: Sequence[Row], *, together: bool = False) -> None:
    """Give rows to streams, one by one or at once."""
    if not together:
        for row in rows:
            streams.add(*row)
        return
    parts = {}
    for name in dict.fromkeys(row[0] for row in rows):
        mine = [(i, row) for i, row in enumerate(rows) if row[0] == name]
        stamps = np.array([row[1] for _, row in mine], dtype=np.int64)
        values = np.array([row[2] for _, row in mine], dtype=float).reshape(len(mine), -1)
        parts[name] = stamps, values, np.array([i for i, _ in mine])
    streams.add_rows(parts, np.array([row[3] or 0 for row in rows], dtype=np.int64))


def streams_of(settings: NodeSettings) -> Streams:
    """Empty streams of a vehicle."""
    onboard = settings.onboard
    return Streams(widths_of(onboard), rules_of(onboard))


def assert_same(one: Columns, two: Columns) -> None:
    """All columns are equal to 1e-9, relative and absolute."""
    assert len(one) == len(two)
    for field in fields(one):
        a, b = getattr(one, field.name), getattr(two, field.name)
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9, err_msg=field.name)
