# SPDX-License-Identifier: Apache-2.0
"""What each stage of the pipeline owes, checked of it alone: cuts, gaps, what is unknown, zeros, doubts.

    stage      made anew for a vehicle; takes what is new in (since, done] and gives a table, or None
    check_...  runs it over a drive, whole and otherwise, and compares

A drive is a table of what is believed of its raw rows, whose window is moved on: no other stage is at work
but those whose tables the stage takes, which are made once, of the whole drive.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, wraps
from itertools import pairwise
from typing import TypeVar

import numpy as np
from rows_of_drives import START, Row

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.onboard.settings import IMU, OnboardSettings
from smallwheel_ros.pipeline.checks.believed import BelievedRows, RawRows
from smallwheel_ros.pipeline.checks.sensor_checks import SensorChecks
from smallwheel_ros.pipeline.intake.buffer import Samples
from smallwheel_ros.pipeline.intake.layout import width_of
from smallwheel_ros.pipeline.mobility.answer import AnswerState, KnownGround, OnGround, answer
from smallwheel_ros.pipeline.mobility.vehicle import VehicleState
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.rows.align import Align
from smallwheel_ros.pipeline.rows.motion import MotionState, motion
from smallwheel_ros.pipeline.soil.stretches import Loads, Stretches, StretchState, stretches
from smallwheel_ros.pipeline.strength.steps import Steps, steps
from smallwheel_ros.pipeline.tables import (
    Aligned,
    Array,
    Columns,
    Estimates,
    Flags,
    Integers,
    Readings,
)
from smallwheel_ros.pipeline.twist.twist import TwistState, twist
from smallwheel_ros.pipeline.warning.hazard import PERIOD
from smallwheel_ros.pipeline.warning.judgement import Judged, Judgement

Table = Columns
Streams = dict[str, Samples]
Made = TypeVar("Made")


def made_once(make: Callable[[BelievedRows], Made]) -> Callable[[BelievedRows], Made]:
    """What is made of a drive, made once: stages only read it. Drives are told apart by identity."""
    known: dict[int, tuple[BelievedRows, Made]] = {}

    @wraps(make)
    def of(believed: BelievedRows) -> Made:
        if id(believed) not in known:
            known[id(believed)] = believed, make(believed)
        return known[id(believed)][1]

    return of


def streams_of(rows: Sequence[Row], settings: OnboardSettings) -> Streams:
    """Raw rows of a drive, by those streams that the vehicle has."""
    found = {}
    for name in settings.streams:
        own = [(stamp, values) for stream, stamp, values, _ in rows if stream == name]
        stamps = np.array([stamp for stamp, _ in own], dtype=np.int64)
        values = np.array([values for _, values in own], dtype=float)
        found[name] = Samples(stamps, values.reshape(stamps.size, width_of(name)))
    return found


def last_of(streams: Streams) -> int:
    """Stamp up to which all is there."""
    return min(int(one.stamps[-1]) for one in streams.values())


def believed_of(streams: Streams, settings: OnboardSettings) -> BelievedRows:
    """What is believed of a whole drive, all of it new."""
    checks = SensorChecks(settings)
    found = checks.take(RawRows(streams, last_of(streams)))
    return replace(found, since=START - SECOND)


@dataclass(frozen=True)
class Stage:
    """A stage as it is checked. parts: its tables over windows that end at some stamps, in order."""

    name: str
    parts: Callable[[BelievedRows, Sequence[int]], list[Table | None]]

    @cached_property
    def whole(self) -> Callable[[BelievedRows], Table | None]:
        """Gives its table in one go."""
        return made_once(lambda believed: joined(self.parts(believed, [believed.done])))


def joined(parts: Sequence[Table | None]) -> Table | None:
    """All rows."""
    there = [part for part in parts if part is not None and len(part)]
    return type(there[0]).joined(there) if there else None


def windows(believed: BelievedRows, ends: Sequence[int]) -> list[BelievedRows]:
    """Windows one after the other."""
    bounds = [believed.since, *ends]
    return [replace(believed, since=a, done=b) for a, b in pairwise(bounds)]


def _between(rows: Columns, window: BelievedRows) -> Columns:
    stamps = vars(rows)["stamp"]
    return rows.take((stamps > window.since) & (stamps <= window.done))


def _aligned(believed: BelievedRows, ends: Sequence[int]) -> list[Table | None]:
    stage = Align(believed.settings)
    return [stage.take(window) for window in windows(believed, ends)]


@made_once
def _rows(believed: BelievedRows) -> Aligned | None:
    return joined(_aligned(believed, [believed.done]))  # type: ignore[return-value]


def _readings(believed: BelievedRows, ends: Sequence[int]) -> list[Table | None]:
    rows, state = _rows(believed), MotionState.of(believed.settings)
    found: list[Table | None] = []
    for window in windows(believed, ends):
        part = None if rows is None else _between(rows, window)
        found.append(motion(state, part, believed.settings) if part else None)  # type: ignore[arg-type]
    return found


@made_once
def _all_readings(believed: BelievedRows) -> Readings | None:
    return joined(_readings(believed, [believed.done]))  # type: ignore[return-value]


def _over_readings(
    take: Callable[[Readings, BelievedRows], Table | None],
    believed: BelievedRows,
    ends: Sequence[int],
) -> list[Table | None]:
    rows = _all_readings(believed)
    if rows is None:
        return []
    parts = [(_between(rows, window), window) for window in windows(believed, ends)]
    return [take(part, window) for part, window in parts]  # type: ignore[arg-type]


def _closed(believed: BelievedRows, ends: Sequence[int]) -> list[Table | None]:
    state = StretchState.of(believed.settings)

    def take(rows: Readings, _: BelievedRows) -> Stretches | None:
        return stretches(state, rows, believed.settings)[0] if len(rows) else None

    return _over_readings(take, believed, ends)


def _loads(believed: BelievedRows, ends: Sequence[int]) -> list[Table | None]:
    state = StretchState.of(believed.settings)

    def take(rows: Readings, _: BelievedRows) -> Loads | None:
        return stretches(state, rows, believed.settings)[1] if len(rows) else None

    return _over_readings(take, believed, ends)


def _judged(believed: BelievedRows, ends: Sequence[int]) -> list[Table | None]:
    stage = Judgement(believed.settings)

    def take(rows: Readings, window: BelievedRows) -> Judged:
        return stage.take(rows, window)

    return _over_readings(take, believed, ends)


def _warned(believed: BelievedRows, ends: Sequence[int]) -> list[Table | None]:
    stage = Judgement(believed.settings)

    def take(rows: Readings, window: BelievedRows) -> Table | None:
        stage.take(rows, window)
        return stage.warned

    return _over_readings(take, believed, ends)


def _twists(believed: BelievedRows, ends: Sequence[int]) -> list[Table | None]:
    settings = believed.settings
    state = TwistState(settings, settings.twist)
    return [twist(state, window.new_motion(), ()) for window in windows(believed, ends)]


# --- Stages that go on from one another: each is given what those before it made of the whole drive


@dataclass(frozen=True)
class BelievedAt(Columns):
    """What a filter believed at rows: means, variances, and of what: readings used, or number of the step."""

    stamp: Integers
    mean: Array
    variance: Array
    used: Integers


@dataclass(frozen=True)
class _Chain:
    """A drive through all stages up to the answer, in one go."""

    pipeline: Pipeline
    rows: Readings
    closed: Stretches | None
    ground: OnGround
    made: Steps | None
    judged: Judged


@made_once
def _chain(believed: BelievedRows) -> _Chain | None:
    """The chain of a drive; what is made of it is only read."""
    rows = _all_readings(believed)
    if rows is None:
        return None
    pipeline = Pipeline(believed.settings)
    closed, loads = stretches(pipeline.stretches, rows, believed.settings)
    version, first_soil = pipeline.soils.take(closed, rows, believed.anew)
    made = steps(
        pipeline.steps, rows, loads.load, loads.load_std, version, pipeline.soils, believed.settings
    )
    none = np.empty(0, dtype=np.int64)
    ends = none if made is None else pipeline.strengths.take(made, believed.anew)
    strength = np.searchsorted(ends, rows.stamp)
    refused = np.zeros(len(rows), dtype=np.int64)
    ground = OnGround(loads.load, loads.load_std, version, first_soil, strength, refused)
    judged = Judgement(believed.settings).take(rows, believed)
    return _Chain(pipeline, rows, closed, ground, made, judged)


def _soils(believed: BelievedRows, ends: Sequence[int]) -> list[Table | None]:
    chain, stage = _chain(believed), Pipeline(believed.settings).soils
    if chain is None:
        return []
    found: list[Table | None] = []
    for window in windows(believed, ends):
        rows = _between(chain.rows, window)
        if not len(rows):
            continue
        version, _ = stage.take(_closed_in(chain, window), rows, believed.anew)  # type: ignore[arg-type]
        of = [stage.versions[number] for number in version.tolist()]
        found.append(
            BelievedAt(
                vars(rows)["stamp"],
                np.array([one.law for one in of]),
                np.array([np.diag(one.covariance)[:3] for one in of]),
                np.array([one.accepted for one in of], dtype=np.int64),
            )
        )
    return found


def _of_steps(made: Steps, which: Flags) -> Steps:
    """Some of the steps, with the wheels' rows in them."""
    own = which[made.step]
    number = np.cumsum(which) - 1
    of_steps = ("end", "length", "forward", "force", "force_std", "soil", "level", "unlisted")
    columns = {name: vars(made)[name] for name in of_steps}
    columns = {name: None if column is None else column[which] for name, column in columns.items()}
    rows = {
        name: column[own]
        for name, column in vars(made).items()
        if name not in {*of_steps, "contact", "step"}
    }
    return Steps(**columns, **rows, step=number[made.step[own]], contact=made.contact.take(own))


def _strengths(believed: BelievedRows, ends: Sequence[int]) -> list[Table | None]:
    chain, stage = _chain(believed), Pipeline(believed.settings).strengths
    if chain is None or chain.made is None:
        return []
    made, found = chain.made, list[Table | None]()
    for window in windows(believed, ends):
        part = _of_steps(made, (made.end > window.since) & (made.end <= window.done))
        before = stage.believed.count
        stamps = stage.take(part, believed.anew)
        of = [stage.believed[before + number][0] for number in range(stamps.size)]
        if of:
            found.append(
                BelievedAt(
                    stamps,
                    np.array([one.x for one in of]),
                    np.array([np.diag(one.P) for one in of]),
                    np.arange(before, before + stamps.size),
                )
            )
    return found


def _answers(believed: BelievedRows, ends: Sequence[int]) -> list[Table | None]:
    chain = _chain(believed)
    if chain is None:
        return []
    known = KnownGround(chain.pipeline.soils.versions, chain.pipeline.strengths)
    state, stamp, found = AnswerState(), chain.rows.stamp, list[Table | None]()
    for window in windows(believed, ends):
        now = (stamp > window.since) & (stamp <= window.done)
        tables = chain.rows.take(now), chain.judged.take(now), chain.ground.take(now)
        found.append(answer(state, *tables, known, believed.settings))
    return found


def _steps(believed: BelievedRows, ends: Sequence[int]) -> list[Table | None]:
    """With the soils' filter before it, whose versions it lets go that no open step needs."""
    chain, settings = _chain(believed), believed.settings
    if chain is None:
        return []
    of, found = Pipeline(settings), list[Table | None]()
    stamp, ground = chain.rows.stamp, chain.ground
    for window in windows(believed, ends):
        now = (stamp > window.since) & (stamp <= window.done)
        if not now.any():
            continue
        rows, loads = chain.rows.take(now), (ground.load[now], ground.load_std[now])
        version, _ = of.soils.take(_closed_in(chain, window), rows, believed.anew)
        made = steps(of.steps, rows, *loads, version, of.soils, settings)
        if made is not None:
            mean = np.stack([made.length, made.force], axis=1)
            found.append(BelievedAt(made.end, mean, made.force_std[:, None] ** 2, made.soil))
    return found


def _closed_in(chain: _Chain, window: BelievedRows) -> Stretches | None:
    """Stretches that end in a window."""
    if chain.closed is None:
        return None
    ends = chain.closed.end
    part = chain.closed.take((ends > window.since) & (ends <= window.done))
    return part if len(part) else None


def _vehicle(believed: BelievedRows, ends: Sequence[int]) -> list[Table | None]:
    chain, settings = _chain(believed), believed.settings
    if chain is None:
        return []
    judgement = Judgement(settings)
    judgement.take(chain.rows, believed)
    instants, warned = judgement.instants, judgement.warned
    assert instants is not None
    assert warned is not None
    estimates = joined(_answers(believed, [believed.done]))
    assert isinstance(estimates, Estimates)
    tenths = np.concatenate([one.stamps // PERIOD for one in believed.streams.values()])
    heard = (np.unique(tenths) + 1) * PERIOD
    stage, found = VehicleState(settings), list[Table | None]()
    for window in windows(believed, ends):
        inside = [
            (stamps > window.since) & (stamps <= window.done)
            for stamps in (heard, instants.stamp, chain.rows.stamp, estimates.stamp)
        ]
        of_instants, of_rows, of_answers = inside[1:]
        some = of_instants.any()
        found.append(
            stage.take(
                heard[inside[0]],
                instants.take(of_instants) if some else None,
                warned.take(of_instants) if some else None,
                judgement.stuck[of_instants],
                chain.rows.take(of_rows),
                chain.judged.take(of_rows),
                estimates.take(of_answers),
                chain.pipeline.soils.versions,
            )
        )
    return found


STAGES = {
    stage.name: stage
    for stage in (
        Stage("align", _aligned),
        Stage("motion", _readings),
        Stage("stretches", _closed),
        Stage("loads", _loads),
        Stage("judged", _judged),
        Stage("warned", _warned),
        Stage("twist", _twists),
        Stage("soils", _soils),
        Stage("steps", _steps),
        Stage("strengths", _strengths),
        Stage("answer", _answers),
        Stage("vehicle", _vehicle),
    )
}


# --- What each owes


def assert_alike(whole: Table | None, other: Table | None) -> None:
    """The same rows, to rounding."""
    if whole is None or other is None:
        assert whole is other
        return
    assert len(whole) == len(other)
    for name, column in vars(whole).items():
        np.testing.assert_allclose(
            vars(other)[name], column, rtol=1e-9, atol=1e-12, equal_nan=True, err_msg=name
        )


NO_DIFFERENCE = {"step"}  # the least difference of two readings: infinite where all are the same


def assert_numbers(table: Table | None) -> None:
    """What is not known is NaN; nothing is infinite."""
    for name, column in {} if table is None else vars(table).items():  # type: ignore[union-attr]
        assert name in NO_DIFFERENCE or not np.isinf(column).any(), name


def check_cuts(stage: Stage, believed: BelievedRows, ends: Sequence[int]) -> None:
    """A table does not depend on where it is cut; a window without a row, or of no length, adds none."""
    ends = sorted({*ends, believed.done})
    whole = stage.whole(believed)
    assert whole is not None
    assert_alike(whole, joined(stage.parts(believed, ends)))
    twice = [end for end in ends for _ in (0, 1)]  # every other window is empty
    assert_alike(whole, joined(stage.parts(believed, twice)))


def without(believed: BelievedRows, stream: str, column: int) -> BelievedRows:
    """The drive of which a column is not known."""
    streams = dict(believed.streams)
    values = streams[stream].values.copy()
    values[:, column] = np.nan
    streams[stream] = Samples(streams[stream].stamps, values)
    return believed_of(streams, believed.settings)


def with_zeros(believed: BelievedRows, names: Sequence[str]) -> BelievedRows:
    """The drive with streams that show exactly 0 throughout."""
    streams = dict(believed.streams)
    for name in names:
        streams[name] = Samples(streams[name].stamps, np.zeros_like(streams[name].values))
    return believed_of(streams, believed.settings)


def check_numbers(stage: Stage, drive: Callable[[], BelievedRows]) -> None:
    """Of a drive that lacks something nothing fails, nothing is infinite, and nothing is divided by 0."""
    with np.errstate(divide="raise"):
        assert_numbers(stage.whole(drive()))


def one_wheel() -> OnboardSettings:
    """The vehicle with its first wheel alone."""
    return settings_from(
        {
            "wheels": ["fl"],
            "fl.diameter": 0.25,
            "fl.width": 0.1,
            "vehicle.mass": 6.0,
            "imu_topic": IMU,
        }
    ).onboard


def halves(
    table: Table, stamp: int, believed: BelievedRows
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Columns up to a stamp, and after it; a stretch is at its end."""
    stamps = vars(table).get("stamp", vars(table).get("end"))
    if stamps is None:  # a row for each of the readings
        readings = _all_readings(believed)
        assert readings is not None
        stamps = readings.stamp
    early = stamps <= stamp
    return tuple(  # type: ignore[return-value]
        {name: column[which] for name, column in vars(table).items()} for which in (early, ~early)
    )
