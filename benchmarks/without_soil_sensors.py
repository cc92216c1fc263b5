# SPDX-License-Identifier: Apache-2.0
"""Slip, grip and warnings where nobody measures sinkage and load, beside thresholds on slip alone.

    python benchmarks/without_soil_sensors.py --seeds 0:8 --jobs 1 --scores out/plain.jsonl
    python benchmarks/without_soil_sensors.py --seeds 0:0 --scores out/plain.jsonl

A drive of `slip_drives` goes message by message through the pipeline of the node, with the parameters that
its user would give. The same messages go to thresholds on the middle wheel's slip, as a driver of its own
would have them: over half a second, with no other knowledge.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.stats import binomtest, chi2

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks._fed import newest_of_each, turns_of
from benchmarks.field_drives import EPOCH
from benchmarks.robot_rates import run_worlds
from benchmarks.slip_drives import TICK, SlipDrive, make_drive
from benchmarks.slip_worlds import WORLDS
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Array, Estimates, Flags
from smallwheel_ros.pipeline.warnings import FIRST, Warned

SETTLE = 2.0  # m, before which nothing is scored
THRESHOLDS = (0.2, 0.3, 0.4, 0.5, 0.6)
TRUE = (0.2, 0.25, 0.3)  # of thresholds on a slip that is known without error
METRES, SECONDS = 0.5, 3.0  # ahead of being stuck that is in time
_PAUSE = 1.0  # s without a warning between two of them
_HARMLESS = 0.3  # slip under which a warning was a false one
OURS = "this program"
# Of the same instants: what else the first level could be, and the second one.
STAGE = (
    f"hazard over {FIRST}, or slip over 0.3, gates",
    "slip over 0.3, gates",
    "second level",
)
_PERIOD = 100_000_000  # ns, of turns


@dataclass
class SlipScore:
    """What came of a drive.

    counts, inside, squares, variances: of each quantity, estimates, those with the truth in their 95 % band,
    sums of squared errors and of what was stated. ahead: by detector, m and s from the last warning to where
    it was stuck; empty where it was not. false: warnings that nothing came of, by detector. said: m after
    which its odometry was said to show no slip, NaN: never. words: with the first place, m.
    """

    world: str
    seed: int
    length: float = 0.0
    stuck: bool = False
    counts: dict[str, int] = field(default_factory=dict)
    inside: dict[str, int] = field(default_factory=dict)
    squares: dict[str, float] = field(default_factory=dict)
    variances: dict[str, float] = field(default_factory=dict)
    ahead: dict[str, list[float]] = field(default_factory=dict)
    false: dict[str, int] = field(default_factory=dict)
    said: float = math.nan
    words: dict[str, float] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """For a file."""
        return asdict(self)

    def add(self, name: str, value: Array, deviation: Array, true: Array, rows: Flags) -> None:
        """Count estimates, of those rows in which all is known."""
        rows = rows & np.isfinite(value) & np.isfinite(deviation) & np.isfinite(true)
        off = (value - true)[rows]
        for sums, more in (
            (self.counts, int(rows.sum())),
            (self.inside, int((np.abs(off) <= 1.96 * deviation[rows]).sum())),
            (self.squares, float((off**2).sum())),
            (self.variances, float((deviation[rows] ** 2).sum())),
        ):
            sums[name] = sums.get(name, 0) + more  # type: ignore[operator]

    def in_time(self, detector: str) -> bool:
        """Whether it was warned of early enough."""
        metres, seconds = self.ahead.get(detector, [0.0, 0.0])
        return metres >= METRES or seconds >= SECONDS


class _SlipAlone:
    """Thresholds on the slip of the middle wheel, mean of half a second."""

    def __init__(self, diameter: float) -> None:
        self._radius = 0.5 * diameter
        self._rims: list[float] = []
        self._recent: deque[tuple[int, float]] = deque()
        self.slip = 0.0

    def handle(self, stamp: int, topic: str, message: Any) -> None:
        """Take a message."""
        if topic == "joint_states":
            self._rims = [abs(speed) * self._radius for speed in message.velocity]
        elif topic == "odom" and self._rims:
            rim, speed = median(self._rims), abs(message.twist.twist.linear.x)
            # Slower than this nobody trusts a slip; nor while it turns on the spot.
            turning = abs(message.twist.twist.angular.z) * 0.3 > speed
            slip = 1.0 - speed / rim if rim > 0.05 and not turning else 0.0
            self._recent.append((stamp, slip))
            while stamp - self._recent[0][0] > 500_000_000:
                self._recent.popleft()
            self.slip = sum(s for _, s in self._recent) / len(self._recent)


def run(drive: SlipDrive, seed: int = 0) -> tuple[Pipeline, SlipScore]:
    """Drive through the pipeline, from messages on."""
    settings = settings_from(drive.parameters)
    pipeline = Pipeline(settings.onboard)
    score = SlipScore(drive.world.name, seed, float(drive.path[-1]), drive.stuck is not None)
    judge, warned = _Judge(drive, score), _by_threshold(drive)
    made: list[Warned] = []
    for stamp, turns in turns_of(pipeline, settings, drive.messages, _PERIOD):
        at = _path(drive, (stamp - EPOCH) / 1e9)
        for turn in turns:
            judge.estimates(turn.estimates)
            made += [turn.warned] if turn.warned is not None else []
        for words in (pipeline.warning, *pipeline.findings):
            plain = re.sub(r"[\d.]+", "#", words)
            if words and plain not in {re.sub(r"[\d.]+", "#", known) for known in score.words}:
                score.words[words] = at
        if math.isnan(score.said) and any("shows no slip" in words for words in pipeline.findings):
            score.said = at
    warned |= _by_stage(made)
    for name, series in (*warned.items(), *_by_true_slip(drive).items()):
        _score_warnings(drive, name, series, score)
    return pipeline, score


def _detectors() -> tuple[str, ...]:
    return OURS, *STAGE, *(f"slip over {threshold}" for threshold in THRESHOLDS)


def _by_threshold(drive: SlipDrive) -> dict[str, list[tuple[float, bool]]]:
    """What thresholds on the slip that the messages show say."""
    alone, looked = _SlipAlone(drive.rover.wheels[0].diameter), 0
    found: dict[str, list[tuple[float, bool]]] = {f"slip over {t}": [] for t in THRESHOLDS}
    for stamp, topic, message in drive.messages:
        alone.handle(stamp, topic, message)
        if stamp - looked >= _PERIOD:
            looked = stamp
            for threshold in THRESHOLDS:
                on = alone.slip > threshold
                found[f"slip over {threshold}"].append(((stamp - EPOCH) / 1e9, on))
    return found


def _by_stage(made: Sequence[Warned]) -> dict[str, list[tuple[float, bool]]]:
    """Of each instant whether there is a warning, and what other rules would say."""
    if not made:
        return {name: [] for name in (OURS, *STAGE)}
    said = Warned.joined(made)
    times = ((said.stamp - EPOCH) / 1e9).tolist()
    first, slips = said.level > 0, said.slip > 0.3
    flags = first, first | slips, slips, said.level > 1
    return {
        name: list(zip(times, flag.tolist(), strict=True))
        for name, flag in zip((OURS, *STAGE), flags, strict=True)
    }


def _by_true_slip(drive: SlipDrive) -> dict[str, list[tuple[float, bool]]]:
    """What thresholds would say if somebody knew the slip without any error."""
    middle = np.nanmedian(np.nan_to_num(drive.slip), axis=1)
    times = np.arange(0.0, drive.time[-1], 0.1)
    slip = np.interp(times, drive.time, middle)
    return {
        f"true slip over {threshold}": [
            (float(t), bool(s > threshold)) for t, s in zip(times, slip, strict=True)
        ]
        for threshold in TRUE
    }


def _path(drive: SlipDrive, time: float) -> float:
    return float(np.interp(time, drive.time, drive.path))


class _Judge:
    """Compares estimates with the truth of their instants."""

    def __init__(self, drive: SlipDrive, score: SlipScore) -> None:
        self.drive, self.score = drive, score
        # Newest margin and thrust, each with its deviation, and load of each wheel.
        self.newest = np.full((5, len(drive.rover.wheels)), math.nan)

    def estimates(self, made: Estimates) -> None:
        """Those of a turn."""
        drive, j = self.drive, made.wheel
        i = np.searchsorted(drive.time, (made.stamp - EPOCH) / 1e9, side="right") - 1
        true, all_rows = drive.slip[i, j], np.ones(len(made), dtype=bool)
        self.score.add("slip", made.slip, made.slip_std, true, all_rows)
        columns = made.margin, made.margin_std, made.thrust, made.thrust_std, made.load
        *sums, load = (
            newest_of_each(j, column, before)
            for column, before in zip(columns, self.newest, strict=True)
        )
        if len(made):
            self.newest = np.stack([*(column[-1] for column in sums), load[-1]])
        whole, first = load.sum(axis=1), (j == 0) & (drive.path[i] >= SETTLE)
        margin, margin_std = ((column * load).sum(axis=1) / whole for column in sums[:2])
        self.score.add("margin", margin, margin_std, drive.held[i], first)
        used, used_std = (column.sum(axis=1) / whole for column in sums[2:])
        self.score.add("used grip", used, used_std, drive.used[i], first & np.isfinite(true))


def _score_warnings(
    drive: SlipDrive, name: str, series: Sequence[tuple[float, bool]], score: SlipScore
) -> None:
    """How far ahead the last warning began; and how many came to nothing."""
    begin = math.inf
    if drive.stuck is not None:
        before = [(time, on) for time, on in series if time <= drive.stuck]
        last = drive.stuck
        for time, on in reversed(before):
            if on:
                begin = last = time
            elif last - time > _PAUSE:
                break
        score.ahead[name] = [0.0, 0.0]
        if begin < math.inf:
            metres = _path(drive, drive.stuck) - _path(drive, begin)
            score.ahead[name] = [metres, drive.stuck - begin]
    turning = np.all(np.isnan(drive.slip), axis=1) | (np.abs(drive.speed) < 0.02)
    middle = np.where(turning, 0.0, np.nanmedian(np.nan_to_num(drive.slip), axis=1))
    slip = uniform_filter1d(middle, round(0.5 / TICK))
    last, count = -math.inf, 0
    for time, on in series:
        if not on:
            continue
        at = _path(drive, time)
        if time - last > _PAUSE and time < begin and at >= SETTLE:
            near = (drive.path > at - 0.5) & (drive.path < at + 2.0)
            count += drive.world.quiet or slip[near].max() < _HARMLESS
        last = time
    score.false[name] = int(count)


def drive_and_score(task: tuple[str, int]) -> SlipScore:
    """Make and run one drive."""
    name, seed = task
    return run(make_drive(WORLDS[name], seed), seed)[1]


def band(scores: Sequence[SlipScore], name: str) -> str:
    """Share inside the band, its 95 % interval by the bootstrap over drives, and stated over true error."""
    pairs = np.array([(s.inside.get(name, 0), s.counts.get(name, 0)) for s in scores], dtype=float)
    if not pairs[:, 1].sum():
        return "unknown"
    drawn = pairs[np.random.default_rng(1).integers(len(pairs), size=(1000, len(pairs)))].sum(
        axis=1
    )
    drawn = drawn[drawn[:, 1] > 0]
    low, high = np.quantile(drawn[:, 0] / drawn[:, 1], (0.025, 0.975))
    whole = pairs.sum(axis=0)
    squares = sum(s.squares.get(name, 0.0) for s in scores)
    wide = math.sqrt(sum(s.variances.get(name, 0.0) for s in scores) / max(squares, 1e-12))
    off = math.sqrt(squares / whole[1])
    return f"{whole[0] / whole[1]:.3f} ({low:.3f} to {high:.3f}; rms {off:.3f}, stated {wide:.1f} of it)"


def in_time(scores: Sequence[SlipScore], name: str) -> str:
    """How many of the drives that got stuck were warned of in time, with Wilson's 95 % interval."""
    stuck = [score for score in scores if score.stuck]
    if not stuck:
        return "-"
    good = sum(score.in_time(name) for score in stuck)
    bounds = binomtest(good, len(stuck)).proportion_ci(method="wilson")
    return f"{good} of {len(stuck)} ({100 * bounds.low:.0f} to {100 * bounds.high:.0f} %)"


def false(scores: Sequence[SlipScore], name: str, per: float) -> str:
    """Warnings that nothing came of, and by Poisson's law how many in so many metres."""
    count, metres = sum(s.false[name] for s in scores), sum(s.length for s in scores)
    if not metres:
        return "-"
    low = 0.5 * chi2.ppf(0.025, 2 * count) if count else 0.0
    high = 0.5 * chi2.ppf(0.975, 2 * count + 2)
    each = per / metres
    return f"{count} in {metres:.0f} m: {count * each:.1f} ({low * each:.1f} to {high * each:.1f})"


def table(scores: Sequence[SlipScore], worlds: Sequence[str]) -> list[str]:
    """One line a world."""
    lines = [
        "| world | drives | slip in its band | margin | used grip | in time | false | shows no slip |",
        "| --- " * 8 + "|",
    ]
    for world in worlds:
        mine = [score for score in scores if score.world == world]
        if mine:
            said = sum(not math.isnan(s.said) for s in mine)
            cells = [band(mine, n) for n in ("slip", "margin", "used grip")]
            cells += [in_time(mine, OURS), str(sum(s.false[OURS] for s in mine)), str(said)]
            lines.append(f"| {world} | {len(mine)} | " + " | ".join(cells) + " |")
    return lines


def summary(scores: Sequence[SlipScore]) -> list[str]:
    """The rates over all worlds, and of thresholds beside."""
    knows = [s for s in scores if WORLDS[s.world].odometry == "own"]
    made = [s for s in scores if WORLDS[s.world].odometry in ("wheels", "filter")]
    quiet = [s for s in knows if WORLDS[s.world].quiet]
    other = [s for s in knows if not WORLDS[s.world].quiet]
    lines = [f"slip in its band: {band(knows, 'slip')}"]
    for name, mine in (("made of wheels", made), ("of its own", knows)):
        said = [s.said for s in mine if not math.isnan(s.said)]
        if mine:
            middle = f", after {median(said):.1f} m" if said else ""
            lines.append(
                f"odometry {name}: {len(said)} of {len(mine)} said to show no slip{middle}"
            )
    lines += [
        "",
        "| warned where | warned in time | false in 500 m, soil | in 1000 m, firm, on the spot, bumps |",
        "| --- | --- | --- | --- |",
    ]
    lines += [
        f"| {n} | {in_time(other, n)} | {false(other, n, 500.0)} | {false(quiet, n, 1000.0)} |"
        for n in (*_detectors(), *(f"true slip over {threshold}" for threshold in TRUE))
    ]
    return lines


def main() -> None:
    """Run the worlds and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--words", action="store_true", help="what was said in each drive, too")
    given, worlds, scores = run_worlds(parser, WORLDS, SlipScore, drive_and_score)
    print("\n".join([*summary(scores), "", *table(scores, worlds)]))
    if given.words:
        for score in scores:
            print(f"\n{score.world}, seed {score.seed}: {score.ahead.get(OURS)}, {score.false}")
            for words, at in score.words.items():
                print(f"  {at:6.1f}  {words}")


if __name__ == "__main__":
    main()
