# SPDX-License-Identifier: Apache-2.0
"""One drive of a world through the whole pipeline, and how right what it says is: sums, as a line of JSON.

The rows of the drive's sensors go to the pipeline's streams a second at a time. Estimates are held
against the truth of their instants from 2 m on; flags and findings are looked at after each turn.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping

import numpy as np
from scipy.ndimage import uniform_filter1d

from rates.drive_worlds import WorldDrive, make_drive
from rates.faults import BEGINS, FAULTS, Raw
from rates.judges import Line
from rates.random_worlds import RandomWorld
from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.settings import ODOMETRY
from smallwheel_ros.pipeline.pipeline import Pipeline, Turn
from smallwheel_ros.pipeline.soil.identifiability import SoilEstimate
from smallwheel_ros.pipeline.tables import Array, Estimates, Flags, Integers
from smallwheel_ros.pipeline.warning.hazard import Warned
from smallwheel_ros.simulate.vehicle import EPOCH, TICK
from smallwheel_ros.simulate.world_ground import DIAMETER, SINKAGE

SETTLE = 2.0  # m, before which nothing is scored
ROLLS = 0.15  # m/s of a rim, from which slip should be known
NAMES = ("reference_pressure", "n", "m", "effective_modulus")
SIGMAS = 3.0  # a flag is wrong beyond so many deviations
THRESHOLDS = (0.2, 0.3, 0.4, 0.5)  # of the middle wheel's slip, mean of half a second
TRUE_THRESHOLD = 0.3  # on a slip that is known without error
_PERIOD = SECOND  # of turns and looks
_PAUSE = 1.0  # s without a warning between two of them
_HARMLESS = 0.3  # slip under which a warning was a false one
_WITHIN = 1.35  # m of the front wheels' way behind a border in which either soil is right
_NUMBER = re.compile(r"[-+]?\d+\.?\d*")


def trial(world: RandomWorld, seed: int) -> Line:
    """Make a drive, let the pipeline drive it, and judge."""
    return judged(make_drive(world, seed))[1]


def with_faults(drive: WorldDrive) -> Raw:
    """The rows with the faults that the world has."""
    raw = Raw.of(drive)
    for name in drive.world.faults:
        FAULTS[name].done(raw)
    return raw


def turns_of(
    pipeline: Pipeline, raw: Raw, period: int = _PERIOD
) -> Iterator[tuple[int, list[Turn]]]:
    """Newest stamp (ns), and what the turn then gave, each `period` (ns) and at the end."""
    last = max(int(stamps[-1]) for stamps, _ in raw.rows.values() if stamps.size)
    begin = min(int(stamps[0]) for stamps, _ in raw.rows.values() if stamps.size)
    ends = np.arange(begin + period, last + period, period)
    for i, end in enumerate(ends.tolist()):
        block = {}
        for name, (stamps, values) in raw.rows.items():
            part = slice(*np.searchsorted(stamps, [end - period, end]).tolist())
            if stamps[part].size:
                block[name] = stamps[part], values[part]
        order = np.argsort(np.concatenate([one[0] for one in block.values()]), kind="stable")
        number = np.empty(order.size, dtype=np.int64)
        number[order] = np.arange(order.size)
        ends_of = np.cumsum([one[0].size for one in block.values()])[:-1]
        numbers = np.split(number, ends_of)
        pipeline.streams.add_rows(
            {name: (*block[name], own) for name, own in zip(block, numbers, strict=True)}
        )
        yield min(end, last), list(pipeline.turns(last=i + 1 == ends.size))


def newest_of_each(wheel: Integers, values: Array, before: Array) -> Array:
    """At each row the newest value of every wheel, (rows, wheels). before: those of the last block."""
    found = np.empty((wheel.size, before.size))
    index = np.arange(wheel.size)
    for j in range(before.size):
        last = np.maximum.accumulate(np.where(wheel == j, index, -1))
        found[:, j] = np.where(last < 0, before[j], values[np.maximum(last, 0)])
    return found


def judged(drive: WorldDrive) -> tuple[Pipeline, Line]:
    """Drive through the pipeline."""
    raw = with_faults(drive)
    pipeline = Pipeline(raw.settings)
    judge = _Judge(drive, pipeline)
    warned: list[Warned] = []
    for stamp, turns in turns_of(pipeline, raw):
        for turn in turns:
            judge.estimates(turn.estimates)
            warned += [] if turn.warned is None else [turn.warned]
        judge.look(stamp)
    judge.end(warned, raw)
    return pipeline, judge.line


def add_sums(
    line: Line, name: str, value: Array, deviation: Array, true: Array, rows: Flags
) -> None:
    """Add to the sums of one quantity: counts and squares of those rows in which all is known."""
    rows = rows & np.isfinite(value) & np.isfinite(deviation) & np.isfinite(true)
    off = (value - true)[rows]
    for what, more in (
        ("counts", int(rows.sum())),
        ("inside", int((np.abs(off) <= 1.96 * deviation[rows]).sum())),
        ("squares", float((off**2).sum())),
        ("variances", float((deviation[rows] ** 2).sum())),
    ):
        line[what][name] = line[what].get(name, 0) + more


def flags_line(line: Line, soil: SoilEstimate, truth: Mapping[str, tuple[float, float]]) -> None:
    """Count what is flagged as determined, and what of it is wrong. truth: least and most that is right."""
    modulus, deviation = soil.effective_modulus()
    covariance = soil.log_covariance
    values = {
        "reference_pressure": (soil.log_pressure, covariance[0, 0]),
        "n": (soil.n, covariance[1, 1]),
        "m": (soil.m, covariance[2, 2]),
        "effective_modulus": (math.log(modulus), (deviation / modulus) ** 2),
    }
    line["error"], line["stated"] = {}, {}
    for name, (value, variance) in values.items():
        least, most = truth[name]
        error = float(min(value - least, 0.0) + max(value - most, 0.0))
        line["error"][name], line["stated"][name] = error, math.sqrt(variance)
        if not getattr(soil.identifiable, name):
            continue
        line["looks"][name] += 1
        sigmas = abs(error) / math.sqrt(variance)
        if sigmas > SIGMAS:
            line["wrong"][name] = line["wrong"].get(name, 0) + 1
            line["worst"][name] = max(sigmas, line["worst"].get(name, 0.0))


class _Judge:
    def __init__(self, drive: WorldDrive, pipeline: Pipeline) -> None:
        self.drive, self.pipeline, self.truth = drive, pipeline, drive.truth
        self.newest = np.full((5, len(drive.rover.wheels)), math.nan)
        self.line: Line = {
            "length": float(self.truth.path[-1]),
            "stuck": self.truth.stuck is not None,
            "known": [0, 0],
            "brier": [0.0, 0],
            "risks": [[0, 0.0, 0] for _ in range(5)],
            "looks": dict.fromkeys(NAMES, 0),
            "found": None,
            "said": None,
        }
        for name in ("counts", "inside", "squares", "variances", "wrong", "worst", "findings"):
            self.line[name] = {}
        needed = np.tan(self.truth.climb) > self.truth.margin
        ahead = np.searchsorted(self.truth.path, self.truth.path + 1.0)
        sums = np.concatenate([[0], np.cumsum(needed)])
        self.too_steep = sums[np.minimum(ahead + 1, needed.size)] > sums[:-1]
        self.seen = (ahead < needed.size) | (self.truth.stuck is not None)

    def estimates(self, made: Estimates) -> None:
        """Those of a turn."""
        drive, truth, j = self.drive, self.truth, made.wheel
        i = drive.at(made.stamp)
        late, any_row = truth.path[i] >= SETTLE, np.ones(len(made), dtype=bool)
        rolls = np.abs(truth.rim[i, j]) > ROLLS
        self.line["known"][0] += int((rolls & np.isfinite(made.slip)).sum())
        self.line["known"][1] += int(rolls.sum())
        if drive.world.sensors.sinkage:
            add_sums(
                self.line, "sinkage", made.sinkage, made.sinkage_std, truth.sinkage[i, j], late
            )
        resistance = made.compaction_resistance + made.other_resistance
        spread = made.rolling_resistance_coefficient_std * made.load
        moves = late & (np.abs(truth.speed[i]) > 0.004)
        add_sums(self.line, "resistance", resistance, spread, truth.resistance[i, j], moves)
        add_sums(
            self.line, "pull", made.drawbar_pull, made.drawbar_pull_std, truth.pull[i, j], moves
        )
        add_sums(self.line, "slip", made.slip, made.slip_std, truth.slip[i, j], any_row)
        stated = made.probability_drawbar_pull_positive
        known = moves & np.isfinite(stated)
        self.line["brier"][0] += float(np.sum((stated - (truth.pull[i, j] > 0.0))[known] ** 2))
        self.line["brier"][1] += int(known.sum())
        columns = made.margin, made.margin_std, made.thrust, made.thrust_std, made.load
        margin, margin_std, thrust, thrust_std, load = (
            newest_of_each(j, column, before)
            for column, before in zip(columns, self.newest, strict=True)
        )
        if len(made):
            self.newest = np.stack(
                [one[-1] for one in (margin, margin_std, thrust, thrust_std, load)]
            )
        whole, first = load.sum(axis=1), late & (j == 0)
        means = ((one * load).sum(axis=1) / whole for one in (margin, margin_std))
        add_sums(self.line, "margin", *means, truth.margin[i], first)
        used = truth.thrust[i].sum(axis=1) / truth.load[i].sum(axis=1)
        add_sums(
            self.line,
            "used grip",
            thrust.sum(axis=1) / whole,
            thrust_std.sum(axis=1) / whole,
            used,
            first & moves,
        )
        risky = first & np.isfinite(made.risk) & self.seen[i]
        fifth = np.clip((5.0 * np.nan_to_num(made.risk)).astype(int), 0, 4)
        for k, sums in enumerate(self.line["risks"]):
            at = risky & (fifth == k)
            sums[0] += int(at.sum())
            sums[1] += float(made.risk[at].sum())
            sums[2] += int(self.too_steep[i[at]].sum())

    def look(self, stamp: int) -> None:
        """At findings and flags."""
        world, line = self.drive.world, self.line
        i = int(self.drive.at(np.array([stamp]))[0])
        path = float(self.truth.path[i])
        for words in self.pipeline.findings:
            plain = _NUMBER.sub("#", words)
            if plain not in {_NUMBER.sub("#", known) for known in line["findings"]}:
                line["findings"][words] = path
        onset = BEGINS * line["length"] if any(_dies(name) for name in world.faults) else 0.0
        is_said = world.said and any(re.search(world.said, w) for w in self.pipeline.findings)
        if is_said and line["said"] is None and path >= onset:
            line["said"] = path - onset
        if line["found"] is None and self.pipeline.soils.changes:
            line["found"] = float(self.truth.place[i])
        if world.sensors.sinkage:
            self._flags(float(self.truth.place[i]))

    def _flags(self, place: float) -> None:
        """Whether what is said to be determined is right."""
        world, soil = self.drive.world, self.pipeline.soil
        if world.hardpan is not None or (world.rut != 1.0 and "back" in world.way):
            return
        flags_line(self.line, soil, _soil_at(self.drive, place, soil.reference_diameter))

    def end(self, warned: list[Warned], raw: Raw) -> None:
        """What holds of the drive as a whole."""
        line, soil = self.line, self.pipeline.soil
        line["determined"] = {name: bool(getattr(soil.identifiable, name)) for name in NAMES}
        line["changes"] = self.pipeline.soils.changes
        alarm = self.pipeline.missing_effect
        line["effect"] = "" if alarm is None else alarm.effect
        detectors = detectors_of(self.drive, warned, raw)
        line["ahead"], line["false"] = {}, {}
        for name, series in detectors.items():
            line["ahead"][name], line["false"][name] = warnings_of(self.drive, *series)


def _dies(fault: str) -> bool:
    return any(word in fault for word in ("frozen", "holds", "shows 0", "repeats"))


def _soil_at(drive: WorldDrive, place: float, diameter: float) -> dict[str, tuple[float, float]]:
    """Lowest and highest numbers that count as right where the vehicle is, under a wheel of that diameter.

    A border that the front wheels have come to has to be found within a metre: so long the soil behind it
    counts as well. Where sides differ, so do all between them.
    """
    ground, soil = drive.ground, drive.ground.soil
    front = max(wheel.x for wheel in drive.rover.wheels)
    places = place + front + np.linspace(-_WITHIN, 0.0, 28)
    common = soil.pressure + np.interp(places, ground.at, ground.common)
    common = common + soil.m * math.log(diameter / DIAMETER)
    n = soil.n + ground.value("exponent", places)
    right = sorted((0.0, drive.world.right))
    modulus = common - n * math.log(SINKAGE)
    return {
        "reference_pressure": (float(common.min()) + right[0], float(common.max()) + right[1]),
        "n": (float(n.min()), float(n.max())),
        "m": (soil.m, soil.m),
        "effective_modulus": (float(modulus.min()) + right[0], float(modulus.max()) + right[1]),
    }


# --- Warnings, ours and those of a threshold on slip


def detectors_of(
    drive: WorldDrive, warned: list[Warned], raw: Raw
) -> dict[str, tuple[Array, Flags]]:
    """Times (s) and whether there is a warning then, by detector."""
    made = Warned.joined(warned) if warned else None
    found: dict[str, tuple[Array, Flags]] = {}
    for level, name in ((1, "first level"), (2, "second level")):
        if made is None:
            found[name] = np.empty(0), np.empty(0, dtype=bool)
        else:
            found[name] = (made.stamp - EPOCH) / 1e9, made.level >= level
    time, slip = shown_slip(raw)
    found |= {f"slip over {t}": (time, slip > t) for t in THRESHOLDS}
    times = np.arange(0.0, drive.truth.time[-1], 0.1)
    true = np.interp(times, drive.truth.time, drive.truth.middle_slip)
    found[f"true slip over {TRUE_THRESHOLD}"] = times, true > TRUE_THRESHOLD
    return found


def warned_on(warned: list[Warned], level: int, epoch: int) -> Array:
    """Times (s) at which there is a warning of a level, or of a higher one."""
    if not warned:
        return np.empty(0)
    made = Warned.joined(warned)
    return np.asarray((made.stamp[made.level >= level] - epoch) / 1e9)


def shown_slip(raw: Raw) -> tuple[Array, Array]:
    """Slip of the middle wheel, mean of half a second, as a driver of its own would have it; times, s."""
    stamps, moves = raw.rows[ODOMETRY]
    speed, rate = np.abs(moves[:, 0]), np.abs(moves[:, 1])
    time = (stamps - EPOCH) / 1e9
    if not speed.any():
        speed = np.hypot(*np.gradient(moves[:, 2:4], time, axis=0).T)
    rims = []
    for wheel in raw.settings.wheels:
        at, values = raw.rows[f"{wheel.name}/wheel_speed"]
        rims.append(np.abs(np.interp(stamps, at, values[:, 0])) * 0.5 * wheel.diameter)
    rim = np.median(rims, axis=0)
    # Slower than this nobody trusts a slip; nor while it turns on the spot.
    trusted = (rim > 0.05) & (rate * 0.3 <= speed)
    slip = np.where(trusted, 1.0 - speed / np.maximum(rim, 1e-9), 0.0)
    count = max(round(0.5 / max(float(np.median(np.diff(time))), 1e-3)), 1)
    mean = np.convolve(slip, np.ones(count) / count)[: slip.size]
    return time, mean


def warnings_of(drive: WorldDrive, times: Array, on: Flags) -> tuple[list[float] | None, int]:
    """Metres and seconds from the last warning's beginning to being stuck, and warnings that nothing came of.

    Nothing: slip stayed under 0.3 from half a metre before to two metres after it, or the vehicle only
    turned.
    """
    truth, begin, ahead = drive.truth, math.inf, None
    warned = times[on]
    path = np.interp(warned, truth.time, truth.path)
    starts = np.flatnonzero(np.diff(warned, prepend=-math.inf) > _PAUSE)
    if truth.stuck is not None:
        ahead = [0.0, 0.0]
        before = warned[warned <= truth.stuck]
        if before.size and truth.stuck - before[-1] <= _PAUSE:
            begin = float(warned[starts[starts < before.size][-1]])
            way = np.interp([begin, truth.stuck], truth.time, truth.path)
            ahead = [float(way[1] - way[0]), truth.stuck - begin]
    slip = uniform_filter1d(truth.middle_slip, round(0.5 / TICK))
    false = 0
    for i in starts:
        if warned[i] < begin and path[i] >= SETTLE:
            near = (truth.path > path[i] - 0.5) & (truth.path < path[i] + 2.0)
            false += bool(slip[near].max() < _HARMLESS)
    return ahead, false
