# SPDX-License-Identifier: Apache-2.0
"""Subject `foreign`: drives of a rover that another author simulated (`foreign_rover`), soil sensors and all.

Nothing gets stuck on most of these fields, so that each warning there is a false one, and each cell of 100
good ground made lethal. On those that give way it does, in motion or as it starts again after a stop. All
sensors are good: whatever is reported of them accuses one.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np

from rates.drive_trial import NAMES, add_sums, flags_line, newest_of_each, turns_of, warned_on
from rates.drives import FLAGS, FLAGS_AT_THE_END, METRES, SECONDS, band
from rates.faults import Raw
from rates.foreign_rover import EPOCH, WHEELS, ForeignDrive, ForeignWorld, driven
from rates.judges import Judge, Line, Subject, events, ratio, share
from smallwheel_ros.costmap.grid import HIGHEST
from smallwheel_ros.drive.ground_map import GroundMapper, cost_map_of
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Array, Estimates
from smallwheel_ros.pipeline.warning.hazard import Warned

SETTLE = 2.0  # m, before which nothing is scored
PAUSE = 1.0  # s without a warning between two of them
LEVELS = ("first level", "second level")
_LEAST_SINKAGE = 0.01  # m, at which the reference pressure is

# Nearly even ground that holds less and less, as snow does, until the rover is stuck in it.
_GIVES_WAY: dict[str, Any] = {
    "fades": 0.2, "waves": 0.2, "distance": 24.0, "soil_sensors": False
}  # fmt: skip
_ALL = (
    ForeignWorld("plain"),
    ForeignWorld("stiffer", border=2.2),
    ForeignWorld("softer", border=0.45, distance=40.0),
    ForeignWorld("slip digs", hidden="slip"),
    ForeignWorld("hardpan", hidden="hardpan"),
    ForeignWorld("stiffer with speed", hidden="speed"),
    ForeignWorld("half is lost", distance=36.0, lost=0.5, zero=0.002),
    ForeignWorld("no soil sensors", soil_sensors=False),
    ForeignWorld("gives way", **_GIVES_WAY),
    ForeignWorld("gives way slowly", loose=3.0, **_GIVES_WAY),
)
WORLDS = {world.name: world for world in _ALL}


def parameters_of(drive: ForeignDrive) -> dict[str, Any]:
    """What the rover's user tells."""
    found: dict[str, Any] = {"wheels": [wheel.name for wheel in WHEELS], "imu_topic": "imu"}
    found["vehicle.mass"] = drive.truth.mass
    for wheel in WHEELS:
        found |= {f"{wheel.name}.diameter": wheel.diameter, f"{wheel.name}.width": wheel.width}
        found |= {
            f"{wheel.name}.lateral_position": wheel.y,
            f"{wheel.name}.longitudinal_position": wheel.x,
        }
        if not drive.world.soil_sensors:
            found[f"{wheel.name}.sinkage_topic"] = ""
    if not drive.world.soil_sensors:
        found["load.source"] = "static"
    return found


def trial(name: str, seed: int) -> Line:
    """Drive, let the pipeline follow, and judge."""
    return judged(driven(WORLDS[name], seed))


def judged(drive: ForeignDrive) -> Line:
    """What came of a drive."""
    settings = settings_from(parameters_of(drive))
    pipeline, truth = Pipeline(settings.onboard), drive.truth
    wheels = settings.onboard.wheels
    mapper = GroundMapper(cost_map_of(settings), wheels)
    line: Line = {
        "length": float(truth.path[-1]), "stuck": truth.stuck is not None, "found": None, "accused": [],
        "slip_digs": False,
        "looks": dict.fromkeys(NAMES, 0), "error": {}, "stated": {},
    }  # fmt: skip
    line |= {name: {} for name in ("counts", "inside", "squares", "variances", "wrong", "worst")}
    warned: list[Warned] = []
    newest = np.full((3, len(WHEELS)), math.nan)
    for stamp, turns in turns_of(pipeline, Raw(settings.onboard, dict(drive.rows))):
        for turn in turns:
            newest = _score(line, drive, turn.estimates, newest)
            mapper.add(turn.estimates, "odom")
            warned += [] if turn.warned is None else [turn.warned]
        _look(line, drive, pipeline, stamp)
    _of_the_whole(line, drive, pipeline, warned, mapper)
    return line


def _score(line: Line, drive: ForeignDrive, made: Estimates, newest: Array) -> Array:
    """Estimates against what was so; the newest margins and loads of all wheels."""
    truth, j, i = drive.truth, made.wheel, drive.at(made.stamp)
    late = truth.path[i] >= SETTLE
    moves = late & (np.abs(truth.speed[i]) > 0.02)
    if drive.world.soil_sensors:
        add_sums(line, "sinkage", made.sinkage, made.sinkage_std, truth.sinkage[i, j], late)
    add_sums(line, "pull", made.drawbar_pull, made.drawbar_pull_std, truth.pull[i, j], moves)
    add_sums(line, "slip", made.slip, made.slip_std, truth.slip[i, j], moves)
    margin, deviation, load = (
        newest_of_each(j, column, before)
        for column, before in zip((made.margin, made.margin_std, made.load), newest, strict=True)
    )
    if not len(made):
        return newest
    means = ((one * load).sum(axis=1) / load.sum(axis=1) for one in (margin, deviation))
    add_sums(line, "margin", *means, truth.margin[i], late & (j == 0))
    return np.stack([one[-1] for one in (margin, deviation, load)])


def _look(line: Line, drive: ForeignDrive, pipeline: Pipeline, stamp: int) -> None:
    """At findings, the border and flags."""
    truth, i = drive.truth, int(drive.at(np.array([stamp]))[0])
    line["accused"] += [words for words in pipeline.findings if words not in line["accused"]]
    line["slip_digs"] |= bool(pipeline.soil.remarks)
    if line["found"] is None and pipeline.soils.changes:
        line["found"] = float(truth.path[i])
    world, soil, true = drive.world, pipeline.soil, truth.soil
    if not world.soil_sensors or world.hidden in ("slip", "speed"):
        return
    modulus = math.log(true.k) + true.m * math.log(soil.reference_diameter)
    front = truth.path[i] + WHEELS[0].x
    border, way = math.log(world.border), front - 0.5 * world.distance
    # A border has to be found within a metre of the rear axle: so long either soil is right.
    low, high = sorted((border * (way > 2.0), border * (way > 0.0)))
    # Over a hard layer n, m and the modulus are those of what lies above it, the pressure is the ground's.
    depth = np.array(_LEAST_SINKAGE)
    pressure = math.log(float(true.pressure(depth, soil.reference_diameter)))
    flags_line(
        line, soil,
        {
            "reference_pressure": (pressure + low, pressure + high),
            "n": (true.n, true.n),
            "m": (true.m, true.m),
            "effective_modulus": (modulus + low, modulus + high),
        },
    )  # fmt: skip
    if world.hidden:
        line["error"], line["stated"] = {}, {}  # no n and no modulus is right


def _of_the_whole(
    line: Line, drive: ForeignDrive, pipeline: Pipeline, warned: list[Warned], mapper: GroundMapper
) -> None:
    truth, soil = drive.truth, pipeline.soil
    line["determined"] = {name: bool(getattr(soil.identifiable, name)) for name in NAMES}
    line["changes"] = pipeline.soils.changes
    alarm = pipeline.missing_effect
    line["effect"] = "" if alarm is None else alarm.effect
    grid = mapper.map.whole()
    known = np.zeros(0) if grid is None else grid.cells[grid.cells >= 0]
    line["cells"], line["lethal"] = int(known.size), int(np.sum(known == HIGHEST))
    line["warnings"], line["ahead"] = {}, {}
    for level, name in enumerate(LEVELS, 1):
        times = warned_on(warned, level, EPOCH)
        line["warnings"][name] = int(np.sum(np.diff(times, prepend=-math.inf) > PAUSE))
        ahead = None
        if truth.stuck is not None:
            before = times[times <= truth.stuck]
            ahead = [0.0, 0.0]
            if before.size and truth.stuck - before[-1] <= PAUSE:
                begin = float(
                    before[np.flatnonzero(np.diff(before, prepend=-math.inf) > PAUSE)[-1]]
                )
                way = np.interp([begin, truth.stuck], truth.time, truth.path)
                ahead = [float(way[1] - way[0]), truth.stuck - begin]
        line["ahead"][name] = ahead


# --- What is counted


def _good_way(line: Line) -> float:
    """m of a drive that did not get stuck."""
    return 0.0 if line["stuck"] else float(line["length"])


def _false(level: str, line: Line) -> int:
    return 0 if line["stuck"] else int(line["warnings"][level])


def _in_time(level: str, line: Line) -> bool:
    metres, seconds = line["ahead"][level] or (0.0, 0.0)
    return bool(line["stuck"] and (metres >= METRES or seconds >= SECONDS))


def _stuck(line: Line) -> int:
    return int(line["stuck"])


def _has(border: bool, line: Line) -> int:
    return int((WORLDS[line["world"]].border != 1.0) == border and not WORLDS[line["world"]].hidden)


def _border_found(line: Line) -> int:
    """From when the front wheels are on it until the rear ones have been for a metre."""
    middle, found = 0.5 * WORLDS[line["world"]].distance, line["found"]
    return int(_has(True, line) and found is not None and -0.5 <= found - middle <= 1.5)


def _one_soil(line: Line) -> float:
    """m of a drive over one soil without anything hidden."""
    return float(line["length"]) * _has(False, line)


def _changes(line: Line) -> int:
    return int(line["changes"]) * _has(False, line)


def _hides(line: Line) -> int:
    return int(bool(WORLDS[line["world"]].hidden))


def _plain(line: Line) -> int:
    return 1 - _hides(line)


def _lethal(line: Line) -> int:
    return 0 if line["stuck"] else int(line["lethal"])


def _cells(line: Line) -> int:
    return int(line["cells"])


def _accused(line: Line) -> int:
    return int(bool(line["accused"]))


def _named(hidden: bool, line: Line) -> int:
    return int(bool(line["effect"]) and bool(_hides(line)) == hidden)


def _digs(hidden: bool, line: Line) -> int:
    """Whether wheels dig in with slip, or do not, where sinkages are measured."""
    world = WORLDS[line["world"]]
    return int(world.soil_sensors and (world.hidden == "slip") == hidden)


def _said_to_dig(hidden: bool, line: Line) -> int:
    return _digs(hidden, line) * int(line["slip_digs"])


_FALSE = [
    Judge(
        f"false in 500 m by {name}, nothing stuck",
        events(partial(_false, name), _good_way, 500.0),
        most=most,
    )
    for name, most in zip(LEVELS, (7.0, 1.4), strict=True)
]
JUDGES = [
    *_FALSE,
    *(
        Judge(f"stuck, and in time by {name}", share(partial(_in_time, name), _stuck))
        for name in LEVELS
    ),
    Judge("crossed cells of 100, nothing stuck", ratio(_lethal, _cells), most=0.0),
    Judge("good sensors accused", share(_accused), most=0.1),
    *(judge for name in ("slip", "sinkage", "pull", "margin") for judge in band(name, 0.88)),
    *FLAGS,
    *FLAGS_AT_THE_END,
    Judge("borders found within a metre", share(_border_found, partial(_has, True)), 0.8),
    Judge("changes in 500 m of one soil", events(_changes, _one_soil, 500.0), most=2.0),
    Judge("effects named where there are none", share(partial(_named, False), _plain), most=0.05),
    Judge("hidden effects that raise the alarm", share(partial(_named, True), _hides)),
    *(
        Judge(
            f"slip sinkage in the status, {words}",
            share(partial(_said_to_dig, hidden), partial(_digs, hidden)),
            most=most,
        )
        for words, hidden, most in (("hidden", True, None), ("none there", False, 0.05))
    ),
]
SUBJECTS = [Subject("foreign", list(WORLDS), trial, JUDGES, 3, 25.0)]
