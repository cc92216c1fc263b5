# SPDX-License-Identifier: Apache-2.0
"""How right the whole pipeline is on a drive of `field_drives`, and what it says of its sensors."""

from __future__ import annotations

import math
import re
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from benchmarks._fed import newest_of_each, turns_of
from benchmarks.field_drives import EPOCH, FieldDrive
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Array, Estimates, Flags, Integers

SETTLE = 2.0  # m, before which forces are not scored
SOON = 5.0  # m, within which a fault has to be said
QUANTITIES = ("sinkage", "resistance", "pull", "margin")
_PERIOD = 500_000_000  # ns, of turns and looks
_EPISODE = 0.5  # m without a warning between two of them


@dataclass
class FieldScore:
    """What came of a drive.

    counts, inside: of each quantity, estimates and those with the truth in their 95 % band. squares,
    variances: sums of squared errors, and of what was stated. warned: episodes of a warning of getting
    stuck, none of which is right. said: m after its onset that the fault was said rightly, NaN: never.
    findings, warnings: what was said, with the first place (m). flags: looks at which a parameter was
    said to be determined; wrong: the most deviations that one was off, over 3. classes: of the first
    wheel's estimates the kind of ground, the vehicle's margin, its deviation, and the true one.
    """

    world: str
    seed: int
    counts: dict[str, int] = field(default_factory=dict)
    inside: dict[str, int] = field(default_factory=dict)
    squares: dict[str, float] = field(default_factory=dict)
    variances: dict[str, float] = field(default_factory=dict)
    warned: int = 0
    length: float = 0.0
    said: float = math.nan
    findings: dict[str, float] = field(default_factory=dict)
    warnings: dict[str, float] = field(default_factory=dict)
    flags: int = 0
    wrong: dict[str, float] = field(default_factory=dict)
    classes: list[list[float]] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """For a file."""
        return asdict(self)

    def held(self, name: str) -> float:
        """Share of a quantity's estimates that hold the truth."""
        return self.inside.get(name, 0) / self.counts[name] if self.counts.get(name) else math.nan


def statements(pipeline: Pipeline) -> tuple[str, ...]:
    """What the pipeline says of its sensors."""
    return (*pipeline.findings, *([pipeline.concern] if pipeline.concern else []))


def run(drive: FieldDrive, seed: int = 0) -> tuple[Pipeline, FieldScore]:
    """Drive through the pipeline, from messages on."""
    settings = settings_from(drive.parameters)
    pipeline = Pipeline(settings.onboard)
    score = FieldScore(drive.world.name, seed, length=float(drive.path[-1]))
    judge = _Judge(drive, score, pipeline)
    for stamp, turns in turns_of(pipeline, settings, drive.messages, _PERIOD):
        for turn in turns:
            judge.estimates(turn.estimates)
        judge.look(stamp)
    return pipeline, score


class _Judge:
    def __init__(self, drive: FieldDrive, score: FieldScore, pipeline: Pipeline) -> None:
        self.drive, self.score, self.pipeline = drive, score, pipeline
        # Newest margin, deviation and load of each wheel.
        self.newest = np.full((3, len(drive.rover.wheels)), math.nan)
        self.last_warned = -math.inf

    def place(self, stamp: Integers) -> Integers:
        time = (stamp - EPOCH) / 1e9
        return np.minimum(np.searchsorted(self.drive.time, time), len(self.drive.time) - 1)

    def add(self, name: str, value: Array, deviation: Array, true: Array, rows: Flags) -> None:
        rows = rows & np.isfinite(value) & np.isfinite(deviation)
        score, off = self.score, (value - true)[rows]
        for sums, more in (
            (score.counts, int(rows.sum())),
            (score.inside, int((np.abs(off) <= 1.96 * deviation[rows]).sum())),
            (score.squares, float((off**2).sum())),
            (score.variances, float((deviation[rows] ** 2).sum())),
        ):
            sums[name] = sums.get(name, 0) + more  # type: ignore[operator]

    def estimates(self, made: Estimates) -> None:
        drive, i, j = self.drive, self.place(made.stamp), made.wheel
        scored = drive.path[i] >= SETTLE
        self.add("sinkage", made.sinkage, made.sinkage_std, drive.sinkage[i, j], scored)
        value = made.compaction_resistance + made.other_resistance
        deviation = made.rolling_resistance_coefficient_std * made.load
        self.add("resistance", value, deviation, drive.resistance[i, j], scored)
        pull, moves = drive.pull[i, j], drive.moves[i]
        self.add("pull", made.drawbar_pull, made.drawbar_pull_std, pull, scored & moves)
        columns = made.margin, made.margin_std, made.load
        margin, spread, load = (
            newest_of_each(j, column, before)
            for column, before in zip(columns, self.newest, strict=True)
        )
        if len(made):
            self.newest = np.stack([margin[-1], spread[-1], load[-1]])
        whole = load.sum(axis=1)
        mean, deviation = (margin * load).sum(axis=1) / whole, (spread * load).sum(axis=1) / whole
        true = drive.held[i].sum(axis=1) / drive.load[i].sum(axis=1)
        self.add("margin", mean, deviation, true, scored)
        if drive.world.classes is not None:
            rows = scored & (j == 0) & np.isfinite(mean)
            told = np.stack([drive.kind[i, 0], mean, deviation, true], axis=1)[rows]
            self.score.classes += told.tolist()

    def look(self, stamp: int) -> None:
        drive, score = self.drive, self.score
        i = int(self.place(np.array([stamp]))[0])
        at = float(drive.path[i])
        for words in statements(self.pipeline):
            plain = re.sub(r"[-+]?\d+\.?\d*", "#", words)
            if plain not in {re.sub(r"[-+]?\d+\.?\d*", "#", known) for known in score.findings}:
                score.findings[words] = at
        said = drive.world.said
        known = said and any(re.search(said, words) for words in statements(self.pipeline))
        if known and math.isnan(score.said) and at >= drive.world.onset:
            score.said = at - drive.world.onset
        warning = self.pipeline.warning
        if warning and at >= SETTLE:
            if at - self.last_warned > _EPISODE:
                score.warned += 1
                score.warnings[warning] = at
            self.last_warned = at
        soil = self.pipeline.soil
        pressure, n = drive.law
        plain_ground = drive.world.border is None and drive.world.classes is None
        if not plain_ground or drive.world.rut != 1.0 or drive.world.hardpan is not None:
            return
        if drive.world.random_ground:
            return
        for name, value, true, deviation in (
            (
                "reference_pressure",
                soil.log_reference_pressure,
                pressure,
                math.sqrt(soil.log_covariance[0, 0]),
            ),
            ("n", soil.n, n, math.sqrt(soil.log_covariance[1, 1])),
        ):
            if getattr(soil.identifiable, name):
                score.flags += 1
                sigmas = abs(value - true) / deviation
                if sigmas > max(3.0, score.wrong.get(name, 0.0)):
                    score.wrong[name] = sigmas
