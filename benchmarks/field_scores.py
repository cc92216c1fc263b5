# SPDX-License-Identifier: Apache-2.0
"""How right the whole pipeline is on a drive of `field_drives`, and what it says of its sensors."""

from __future__ import annotations

import math
import re
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from benchmarks.field_drives import EPOCH, FieldDrive
from smallwheel_ros.onboard.feed import Feed
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.onboard.result import Result

SETTLE = 2.0  # m, before which forces are not scored
SOON = 5.0  # m, within which a fault has to be said
QUANTITIES = ("sinkage", "resistance", "pull", "margin")
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


def statements(onboard: Onboard) -> tuple[str, ...]:
    """What the pipeline says of its sensors."""
    words = [*onboard.findings]
    if onboard.health.concern:
        words.append(onboard.health.concern)
    return tuple(words)


def run(drive: FieldDrive, seed: int = 0) -> tuple[Onboard, FieldScore]:
    """Drive through the pipeline, from messages on."""
    settings = settings_from(drive.parameters)
    onboard = Onboard(settings.onboard)
    feed = Feed(onboard, settings)
    topics = {topic.name: topic for topic in feed.topics}
    score = FieldScore(drive.world.name, seed, length=float(drive.path[-1]))
    judge = _Judge(drive, score, onboard)
    looked = 0
    for stamp, topic, message in drive.messages:
        if topic in topics:
            for result in topics[topic].handle(message, None):
                judge.result(result)
        if stamp - looked > 500_000_000:
            looked = stamp
            judge.look(stamp)
    for result in onboard.flush():
        judge.result(result)
    judge.look(drive.messages[-1][0])
    return onboard, score


class _Judge:
    def __init__(self, drive: FieldDrive, score: FieldScore, onboard: Onboard) -> None:
        self.drive, self.score, self.onboard = drive, score, onboard
        self.order = {w.name: j for j, w in enumerate(drive.rover.wheels)}
        self.newest: dict[str, Result] = {}
        self.last_warned = -math.inf

    def place(self, stamp: int) -> int:
        time = (stamp - EPOCH) / 1e9
        return min(int(np.searchsorted(self.drive.time, time)), len(self.drive.time) - 1)

    def add(self, name: str, value: float, deviation: float, true: float) -> None:
        score, off = self.score, value - true
        for sums, more in (
            (score.counts, 1),
            (score.inside, int(abs(off) <= 1.96 * deviation)),
            (score.squares, off * off),
            (score.variances, deviation * deviation),
        ):
            sums[name] = sums.get(name, 0) + more  # type: ignore[operator]

    def result(self, result: Result) -> None:
        drive, i, j = self.drive, self.place(result.reading.stamp), self.order[result.wheel]
        self.newest[result.wheel] = result
        forces = result.forces
        if drive.path[i] < SETTLE:
            return
        if result.sinkage_predicted is not None:
            found = result.sinkage_predicted
            true = float(drive.sinkage[i, j])
            self.add("sinkage", found.value, found.standard_deviation, true)
        if forces is None:
            return
        value = forces.compaction_resistance.value + forces.other_resistance.value
        ratio = forces.rolling_resistance_coefficient
        deviation = ratio.standard_deviation / ratio.value * value if ratio.value else 0.0
        self.add("resistance", value, abs(deviation), float(drive.resistance[i, j]))
        if forces.drawbar_pull is not None and drive.moves[i]:
            pull = forces.drawbar_pull
            self.add("pull", pull.value, pull.standard_deviation, float(drive.pull[i, j]))
        margins = [
            (r.forces.margin, r.reading.load.value)
            for r in self.newest.values()
            if r.forces is not None and r.forces.margin is not None and r.reading.load is not None
        ]
        if len(margins) == len(self.order):
            whole = sum(load for _, load in margins)
            mean = sum(m.value * load for m, load in margins) / whole
            spread = sum(m.standard_deviation * load for m, load in margins) / whole
            true = float(drive.held[i].sum() / drive.load[i].sum())
            self.add("margin", mean, spread, true)
            if drive.world.classes is not None and j == 0:
                self.score.classes.append([float(drive.kind[i, 0]), mean, spread, true])

    def look(self, stamp: int) -> None:
        drive, score, i = self.drive, self.score, self.place(stamp)
        at = float(drive.path[i])
        for words in statements(self.onboard):
            plain = re.sub(r"[-+]?\d+\.?\d*", "#", words)
            if plain not in {re.sub(r"[-+]?\d+\.?\d*", "#", known) for known in score.findings}:
                score.findings[words] = at
        said = drive.world.said
        known = said and any(re.search(said, words) for words in statements(self.onboard))
        if known and math.isnan(score.said) and at >= drive.world.onset:
            score.said = at - drive.world.onset
        warning = self.onboard.stuck.warning
        if warning and at >= SETTLE:
            if at - self.last_warned > _EPISODE:
                score.warned += 1
                score.warnings[warning] = at
            self.last_warned = at
        soil = self.onboard.soil
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
