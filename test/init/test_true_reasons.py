# SPDX-License-Identifier: Apache-2.0
"""Every refusal has the reason that holds: each is given an input in which another, that looks alike, holds.

Two inputs a row, of which the words of one must not be those of the other.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "onboard"))
import robots

import smallwheel_ros as sw
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.init.rover import wheel_joints
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.onboard.felt_gravity import unlike_gravity
from smallwheel_ros.onboard.idle_publisher import IDLE, IdlePublisher
from smallwheel_ros.onboard.joint_units import VelocityUnit
from smallwheel_ros.pipeline.intake.buffer import StampRules
from smallwheel_ros.pipeline.intake.plausible import fault
from smallwheel_ros.pipeline.intake.streams import Streams

SECOND = 1_000_000_000


def table(**columns: object) -> str:
    """What is said of a table of wheels with these columns in place of its own: a refusal, or warnings."""
    rng = np.random.default_rng(0)
    own = {
        "run": [f"r{i}" for i in range(12)],
        "load [N]": np.tile([20.0, 40.0, 60.0, 80.0], 3),
        "diameter [mm]": 200.0,
        "width [mm]": 80.0,
        "sinkage [mm]": np.tile([3.0, 5.0, 7.0, 9.0], 3) * np.exp(rng.normal(0.0, 0.03, 12)),
    }
    own.update(columns)
    frame = pd.DataFrame({name: column for name, column in own.items() if column is not None})
    try:
        found = read_measurements(frame)
    except SmallwheelError as error:
        return str(error)
    return "; ".join((*found.understood, *found.notes, *found.warnings))


def plates(change: str = "", **columns: object) -> pd.DataFrame:
    """Three plates, pressed three times each, with a change, or columns in place of their own."""
    depth, rng = np.linspace(0.5, 20.0, 40), np.random.default_rng(1)  # mm
    made = []
    for i, (size, most) in enumerate(
        [(100.0, 100.0), (150.0, 200.0), (200.0, 400.0)] * (2 if change == "twice" else 3)
    ):
        load = most * (depth / 20.0) ** 0.9 * np.exp(rng.normal(0.0, 0.01, 40))
        read = depth + rng.normal(0.0, 0.05, 40)
        if i == 1 and change == "unloaded":
            load = np.concatenate([load, load[35:20:-1] * 0.3])
            read = np.concatenate([read, read[35:20:-1]])
        if i == 1 and change == "travel":
            load = np.concatenate([rng.uniform(0.01, 0.03, 20), load])
            read = np.concatenate([np.linspace(1.0, 30.0, 20), 30.0 + read])
        if i == 1 and change == "spikes":
            read[[5, 14, 31]] *= 5.0
        if i == 1 and change == "zero":
            read += 30.0
        if i == 1 and change == "still":
            read[:] = 7.0
        made.append(pd.DataFrame({
            "run": f"c{i}", "contact": "plate", "load [N]": load, "diameter [mm]": size, "sinkage [mm]": read,
        }))  # fmt: skip
    frame = pd.concat(made, ignore_index=True).assign(**columns)
    return frame.drop(columns=[name for name, column in columns.items() if column is None])


def curves(change: str = "", **columns: object) -> str:
    """What is said of these curves as they are read."""
    try:
        found = read_measurements(plates(change, **columns))
    except SmallwheelError as error:
        return str(error)
    return "; ".join((*found.understood, *found.notes, *found.warnings))


def fitted(change: str) -> str:
    """What is said of these curves by a fit."""
    return "; ".join(sw.fit(plates(change)).notes)


def description(text: str) -> str:
    try:
        return "; ".join(wheel_joints(text)[1])
    except SmallwheelError as error:
        return str(error)


def logged(text: str) -> str:
    """What is said of a text file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        path.write_text(text)
        try:
            return "; ".join(read_measurements(path).understood)
        except SmallwheelError as error:
            return str(error)


def two_arms() -> str:
    return robots.robot(*robots.arm("0 0.3 0.7", "_l", 7), *robots.arm("0 -0.3 0.7", "_r", 7))


def unit(factor: float, *, turns: bool = True) -> str:
    """What is wrong with velocities that are so many times the rate of their positions."""
    seconds = np.arange(600) / 50.0
    stamps, speed = (seconds * SECOND).astype(np.int64) + SECOND, 4.0 + np.sin(seconds)
    position = np.cumsum(speed) / 50.0 if turns else np.full(600, 0.3)
    one = VelocityUnit()
    one.take(stamps, np.column_stack([factor * speed, position]))
    return one.wrong


def second(position: float) -> str:
    """What is said of every other message of a joint, that stands at a position."""
    stamps = SECOND + np.arange(100) * SECOND // 50
    positions, speeds = 2.0 + np.arange(100) / 50.0, np.ones(100)
    positions[1::2], speeds[1::2] = position, 0.0
    return IDLE if IdlePublisher().idle(stamps, speeds, positions).any() else ""


def stamp(kind: str) -> str:
    """What is said of one message, of a topic that comes at 10 Hz beside another."""
    streams = Streams({"odom": 10, "imu": 8}, StampRules())
    odom, imu = (0.3, *[0.0] * 9), (0.0, 0.0, 0.0, 9.81, *[math.nan] * 4)
    start = 1000 * SECOND
    for i in range(60):
        streams.add("odom", start + i * SECOND // 10, odom, start + i * SECOND // 10)
        if i < 20:
            streams.add("imu", start + i * SECOND // 10, imu, start + i * SECOND // 10)
    newest = streams.latest
    at = {
        "swapped": ("odom", newest - SECOND // 20),
        "twice": ("odom", newest),
        "silent": ("imu", newest - SECOND // 2),
        "ahead": ("odom", newest + 60 * SECOND),
        "old": ("odom", newest - 600 * SECOND),
        "none": ("odom", 0),
    }[kind]
    streams.add(*at, odom if at[0] == "odom" else imu, newest)
    return "; ".join(streams.words.values())


def imu(along: float, up: float = 0.0) -> str:
    return unlike_gravity(math.hypot(along, up))


def with_first(cell: str) -> list[str]:
    """Loads, of which the first is written so."""
    return [cell, *map(str, np.tile([20.0, 40.0, 60.0, 80.0], 3)[1:])]


N = 9.80665
# Columns of its own that a table lacks.
NOTHING = dict.fromkeys(("run", "load [N]", "diameter [mm]", "width [mm]", "sinkage [mm]"))
# What holds, words of it, and what looks alike with words of its own.
PAIRS: dict[str, tuple[Callable[[], str], str, Callable[[], str], str]] = {
    "an imu in g, one without gravity": (
        lambda: imu(1.0), "gravity in g?", lambda: imu(0.9 * 0.9), "gravity has been taken out",
    ),
    "an imu that is all zero, one without gravity": (
        lambda: imu(0.0), "are all 0", lambda: imu(0.1), "gravity has been taken out",
    ),
    "an imu in g, one of half of gravity": (
        lambda: imu(1.0), "gravity in g?", lambda: imu(0.5 * N), "gravity has been taken out",
    ),
    "an imu in cm/s^2, one that feels too much": (
        lambda: imu(100.0 * N), "in mg or cm/s^2", lambda: imu(1.5 * N), "14.71 m/s^2 on average, expected",
    ),
    "a velocity in rpm, one in m/s": (
        lambda: unit(30.0 / math.pi), "in rpm", lambda: unit(0.12), "in m/s at the rim",
    ),
    "a velocity in deg/s, that of a motor": (
        lambda: unit(180.0 / math.pi), "in deg/s", lambda: unit(30.0), "of a motor before its gear",
    ),
    "a wrong unit, positions that nobody fills in": (
        lambda: unit(30.0 / math.pi), "times what its position turns",
        lambda: unit(30.0 / math.pi, turns=False), "",
    ),
    "a second publisher of zeros, one of other numbers": (
        lambda: second(0.0), "more than one publisher", lambda: second(1.0), "",
    ),
    "two neighbours swapped, one stamp twice": (
        lambda: stamp("swapped"), "of one topic have to come in order", lambda: stamp("twice"), "came twice",
    ),
    "two neighbours swapped, a topic that was silent": (
        lambda: stamp("swapped"), "of one topic have to come in order",
        lambda: stamp("silent"), "timing.reorder_time",
    ),
    "a clock that is ahead, an old bag": (
        lambda: stamp("ahead"), "ahead of the clock", lambda: stamp("old"), "behind the clock",
    ),
    "no stamp, an old one": (
        lambda: stamp("none"), "must stamp its messages", lambda: stamp("old"), "behind the clock",
    ),
    "a range that sees nothing, a sinkage that is none": (
        lambda: str(fault("sinkage", (math.nan, 0.0))), "REP 117",
        lambda: str(fault("sinkage", (1e300, 0.0))), "expected a number smaller than",
    ),
    "joints about the vertical, joints of less than a turn": (
        lambda: description(robots.four(axis="0 0 1")), "(about (0 0 1))",
        lambda: description(robots.four(kind="revolute", limit=robots.HALF_TURN)), "less than a turn",
    ),
    "meshes that turn like wheels, boxes that do not turn": (
        lambda: description(robots.four(body=robots.MESH)), "",
        lambda: description(robots.four(body=robots.MESH, kind="fixed")), "none of its 4 joints turns",
    ),
    "xacro, a part of a description": (
        lambda: description("<robot name='a' xmlns:xacro='http://ros.org/wiki/xacro'><xacro:a/></robot>"),
        "xacro that has not been expanded", lambda: description("<robot name='a'/>"), "it has no joint",
    ),
    "a track, eight wheels": (
        lambda: description(robots.tracked()), "tracks? A tracked vehicle",
        lambda: description(robots.tracked(sprockets=False)), "",
    ),
    "an articulated body, four wheels that are steered": (
        lambda: description(robots.articulated()), "(articulated)", lambda: description(robots.four()), "",
    ),
    "loads in kN under [N], light loads": (
        lambda: table(**{"load [N]": np.tile([0.02, 0.04, 0.06, 0.08], 3)}), "read in kN it is",
        lambda: table(**{"load [N]": np.tile([2.0, 4.0, 6.0, 8.0], 3)}), "",
    ),
    "rows that were pasted again, repeats": (
        lambda: table(**{"sinkage [mm]": np.tile([3.013, 5.127, 7.211, 9.456], 3)}), "copies of others",
        table, "",
    ),
    "a column without a known unit, a text": (
        lambda: table(notes=["wet"] * 12), "is text: kept as a label",
        lambda: table(notes=["wet", *range(11)]), "left out, and not needed",
    ),
    "a unit in a cell, a text in it": (
        lambda: table(**{"load [N]": with_first("20 N")}), "write the unit in the header, not in the cell",
        lambda: table(**{"load [N]": with_first("much")}), "'much' found, expected a number",
    ),
    "a limit, a deviation": (
        lambda: table(**{"load [N]": with_first("<20")}), "a limit is no measurement",
        lambda: table(**{"load [N]": with_first("20 ± 1")}), "write the deviation in a column of its own",
    ),
    "slips in per cent, slips": (
        lambda: table(slip=20.0), "in per cent? then the header is 'slip [%]'",
        lambda: table(slip=0.2), "",
    ),
    "a diameter under the width, a wheel": (
        lambda: table(**{"diameter [mm]": 80.0, "width [mm]": 200.0}), "with the headers interchanged?",
        table, "",
    ),
    "wheels without a width, plates": (
        lambda: table(**{"width [mm]": None}), "no column 'width'",
        lambda: table(**{"width [mm]": None, "contact": "plate"}), "",
    ),
    "a row a reading, a label": (
        lambda: table(**NOTHING, VarName=["Radlast", "Einsinkung"] * 6, VarValue=np.arange(12.0)),
        "it has one row a reading",
        lambda: table(**NOTHING, site=["N", "S"] * 6, depth=np.arange(12.0)), "no column 'load'",
    ),
    "a caster, an arm": (
        lambda: description(robots.one_caster()), "(a caster)",
        lambda: description(two_arms()), "others: an arm)",
    ),
    "nothing, XML that is cut": (
        lambda: description(""), "it is empty", lambda: description("<robot>"), "it is no XML",
    ),
    "a world, xacro without its namespace": (
        lambda: description("<sdf/>"), "its outermost element is 'sdf'",
        lambda: description("<robot><xacro:a/></robot>"), "xacro that has not been expanded",
    ),
    "wheels that do not turn, wheels": (
        lambda: description(robots.mobile_manipulator("fixed")), "right_wheel_joint (fixed)",
        lambda: description(robots.mobile_manipulator()), "joints that turn and are no wheels",
    ),
    "travel before the plate touches, a load taken off": (
        lambda: curves("travel"), "curves begin before the body touches",
        lambda: curves("unloaded"), "the load was taken off",
    ),
    "a curve of a bad zero, spikes": (
        lambda: fitted("zero"), "off the best model", lambda: fitted("spikes"), "",
    ),
    "a gauge that stood still, one of a bad zero": (
        lambda: fitted("still"), "as if its gauge were stuck", lambda: fitted("zero"), "off the best model",
    ),
    "loads along a curve, settings in the order of the runs": (
        lambda: curves("twice"), "",
        lambda: table(**{"load [N]": np.linspace(20.0, 80.0, 12)}), "load follows the order of",
    ),
    "a load cell without a signal, one of the other sign": (
        lambda: curves(**{"load [N]": 0.0}), "load is 0 throughout",
        lambda: curves(**{"load [N]": -np.tile(np.arange(1.0, 41.0), 9)}), "is its sign the other one?",
    ),
    "a gauge of the other sign, one whose zero stands in it": (
        lambda: curves(**{"sinkage [mm]": -np.tile(np.arange(1.0, 41.0), 9)}), "is its sign the other one?",
        lambda: curves(**{"sinkage [mm]": -np.tile(np.linspace(127.0, 121.0, 40), 9)}),
        "has its zero been subtracted?",
    ),
    "curves without runs, curves with names": (
        lambda: curves(run=None), "no column 'run'", curves, "",
    ),
    "a plate's pressure, a plate without a size": (
        lambda: curves(**{"load [N]": None, "pressure [kPa]": np.tile(np.arange(1.0, 41.0), 9)}),
        "load = pressure x area of the plate",
        lambda: curves(**{"diameter [mm]": None}), "no column 'diameter'",
    ),
    "a log without a header, one without a load": (
        lambda: logged("774.35,0,0,41.38\n774.35,0,0,41.36\n"), "nothing but numbers, expected a header",
        lambda: logged("x,a,b,c\n774.35,0,0,41.36\n"), "no column 'load'",
    ),
    "a knee, a wheel on a rocker": (
        lambda: description(robots.legged("<inertial><origin xyz='0 0 -0.08'/></inertial>")), "a leg)",
        lambda: description(robots.legged("")), "",
    ),
    "no load at all, a load that is blank": (
        lambda: table(**{"load [N]": None}), "no column 'load'",
        lambda: table(**{"load [N]": np.nan}), "the whole column is blank",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", PAIRS)
def test_the_reason_is_the_one_that_holds(name: str) -> None:
    one, words, other, others = PAIRS[name]
    assert words in one()
    assert others in other()
    assert not words or words not in other()
    assert not others or others not in one()


@pytest.mark.parametrize("kind", ["ahead", "old"])
def test_stamps_of_another_clock_are_answered_by_what_reads_a_bag_of_them(kind: str) -> None:
    """In `replay` there is no use_sim_time; --no-clock compares stamps with each other."""
    assert "--no-clock" in stamp(kind)
