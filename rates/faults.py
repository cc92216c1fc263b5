# SPDX-License-Identifier: Apache-2.0
"""Faults put into copies of drives: rows of what is done, and by which rule and subject it should be named.

Subject `faults`: when each is named, what is reported beside it, and what is reported of drives on which all
sensors are good. Held values, zeros and repeats begin at 30 % of the way of the rims, a jump at 50 %; all
else is there from the beginning. Way: of the rims from the beginning until it is reported.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from rates.drive_worlds import WorldDrive, make_drive
from rates.judges import Judge, Line, Subject, middle, share
from rates.random_worlds import RandomWorld
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, OnboardSettings
from smallwheel_ros.pipeline.checks.believed import RawRows
from smallwheel_ros.pipeline.checks.rules import Finding
from smallwheel_ros.pipeline.checks.sensor_checks import SensorChecks
from smallwheel_ros.pipeline.intake.buffer import Samples
from smallwheel_ros.pipeline.tables import Array, Integers
from smallwheel_ros.simulate.sensors import Rows
from smallwheel_ros.simulate.world import GRAVITY

Stream = tuple[Integers, Array]
BEGINS, JUMPS_AT = 0.3, 0.5  # share of the way


@dataclass
class Raw:
    """A drive as the streams have it: rows by stream; loads that are given are not among them."""

    settings: OnboardSettings
    rows: Rows

    @classmethod
    def of(cls, drive: WorldDrive) -> Raw:
        """A drive of a world, as its user's parameters have it, with rows of its own."""
        settings = settings_from(drive.parameters).onboard
        return cls(settings, {name: copy.deepcopy(drive.rows[name]) for name in settings.streams})

    def way(self) -> tuple[Integers, Array]:
        """Stamps of the rims and way of their median up to them, m."""
        names = [name for name in self.rows if name.endswith("/wheel_speed")]
        radius = {w.name: 0.5 * w.diameter for w in self.settings.wheels}
        stamps = self.rows[names[0]][0]
        rims = [self.rows[name][1][:, 0] * radius[name.rpartition("/")[0]] for name in names]
        dt = np.diff(stamps, prepend=stamps[:1]) / 1e9
        return stamps, np.cumsum(np.median(np.abs(rims), axis=0) * np.where(dt > 0.5, 0.0, dt))

    def at(self, share: float) -> int:
        """Stamp at which a share of the way is done."""
        stamps, way = self.way()
        return int(stamps[min(np.searchsorted(way, share * way[-1]), stamps.size - 1)])


def heard(drive: Raw) -> list[tuple[Finding, float]]:
    """What is reported of a drive, with the way at which it is."""
    until = max(int(stamps[-1]) for stamps, _ in drive.rows.values() if stamps.size)
    checks = SensorChecks(drive.settings)
    streams = {name: Samples(*drive.rows[name]) for name in drive.settings.streams}
    checks.take(RawRows(streams, until), last=True)
    stamps, way = drive.way()
    return [(one, float(np.interp(one.stamp, stamps, way))) for one in checks.findings]


# --- Faults


def _one(drive: Raw, what: str, i: int = 0) -> Stream:
    return drive.rows[f"{drive.settings.wheels[i].name}/{what}"]


def _all(drive: Raw, what: str) -> list[Stream]:
    return [rows for name, rows in drive.rows.items() if name.endswith(f"/{what}")]


def _swap(drive: Raw, i: int, j: int, what: str) -> None:
    one, two = (f"{drive.settings.wheels[k].name}/{what}" for k in (i, j))
    drive.rows[one], drive.rows[two] = drive.rows[two], drive.rows[one]


def _swap_sides(drive: Raw) -> None:
    _swap(drive, 0, 1, "wheel_speed")
    _swap(drive, 2, 3, "wheel_speed")


def _from(rows: Stream, stamp: int) -> int:
    return min(int(np.searchsorted(rows[0], stamp)), len(rows[0]) - 1)


def _hold(rows: Stream, stamp: int, moving: bool = False) -> None:
    i = _from(rows, stamp)
    while moving and i < len(rows[1]) - 1 and rows[1][i, 0] == 0.0:
        i += 1
    rows[1][i:] = rows[1][i]


def _zero(rows: Stream, stamp: int) -> None:
    rows[1][_from(rows, stamp) :] = 0.0


def _add(rows: Stream, value: float) -> None:
    rows[1][:, 0] += value


def _factor(of: Iterable[Stream], factor: float, columns: Any = slice(None)) -> None:
    for _, values in of:
        values[:, columns] *= factor


def _of_wheels(drive: Raw) -> None:
    stamps, values = drive.rows[ODOMETRY]
    wheels = drive.settings.wheels
    turned = [np.interp(stamps, at, turns[:, 0]) for at, turns in _all(drive, "wheel_speed")]
    rims = np.array([0.5 * w.diameter * turns for w, turns in zip(wheels, turned, strict=True)])
    left = np.array([wheel.lateral_position > 0 for wheel in wheels])
    track = np.ptp([wheel.lateral_position for wheel in wheels])
    values[:, 0] = rims.mean(axis=0)
    values[:, 1] = (rims[~left].mean(axis=0) - rims[left].mean(axis=0)) / track


def _late(drive: Raw) -> None:
    stamps, values = drive.rows[ODOMETRY]
    drive.rows[ODOMETRY] = stamps + 300_000_000, values


def _jump(drive: Raw) -> None:
    rows = drive.rows[ODOMETRY]
    rows[1][_from(rows, drive.at(JUMPS_AT)) :, 2] += 3.0


def _tilted(drive: Raw) -> None:
    values, (s, c) = drive.rows[IMU][1], (math.sin(math.radians(3)), math.cos(math.radians(3)))
    values[:, 1], values[:, 3] = (
        c * values[:, 1] + s * values[:, 3],
        c * values[:, 3] - s * values[:, 1],
    )


def _noise(drive: Raw) -> None:
    _, values = _one(drive, "load")
    values[:, 0] = np.random.default_rng(0).normal(0.0, 0.3, len(values))


@dataclass(frozen=True)
class Fault:
    """What is done, and by which rule and subject (a part of it; empty: any) it should be named."""

    name: str
    rule: str
    subject: str
    done: Callable[[Raw], Any]


_FAULTS = (
    Fault("encoder shows 0", "dead", "front_left", lambda d: _zero(_one(d, "wheel_speed"), d.at(BEGINS))),
    Fault("encoder holds", "held", "front_left", lambda d: _hold(_one(d, "wheel_speed"), d.at(BEGINS), True)),
    Fault("mirrored", "mirrored", "front_left", lambda d: _factor([_one(d, "wheel_speed")], -1.0)),
    Fault("one radius +10 %", "rolling", "front_left", lambda d: _factor([_one(d, "wheel_speed")], 1.1)),
    Fault("one radius -10 %", "rolling", "front_left", lambda d: _factor([_one(d, "wheel_speed")], 0.9)),
    Fault("all radii 10 % small", "rolling", "radii", lambda d: _factor(_all(d, "wheel_speed"), 0.9)),
    Fault("front wheels interchanged", "turn", "front_left", lambda d: _swap(d, 0, 1, "wheel_speed")),
    Fault("left and right interchanged", "turn", "", _swap_sides),
    Fault("odometry repeats", "repeats", "odom", lambda d: _hold(d.rows[ODOMETRY], d.at(BEGINS))),
    Fault("no twist", "no twist", "odom", lambda d: _factor([d.rows[ODOMETRY]], 0.0, [0, 1])),
    Fault("odometry of wheels", "of wheels", "odom", _of_wheels),
    Fault("odometry 1.3 times", "rolling", "radii", lambda d: _factor([d.rows[ODOMETRY]], 1.3, [0, 2, 3])),
    Fault("odometry 0.75 times", "rolling", "radii", lambda d: _factor([d.rows[ODOMETRY]], 0.75, [0, 2, 3])),
    Fault("odometry 0.3 s late", "late", "odom", _late),
    Fault("odometry jumps 3 m", "jumps", "odom", _jump),
    Fault("imu 3 degrees", "tilt", "imu", _tilted),
    Fault("imu z down", "z down", "imu", lambda d: _factor([d.rows[IMU]], -1.0, [0, 2, 3])),
    Fault("gyro sign", "turn", "imu", lambda d: _factor([d.rows[IMU]], -1.0, [0])),
    Fault("imu frozen", "frozen", "imu", lambda d: _hold(d.rows[IMU], d.at(BEGINS))),
    Fault("loads in kg", "weight", "loads", lambda d: _factor(_all(d, "load"), 1 / GRAVITY)),
    Fault("front loads swapped", "swapped", "front_left", lambda d: _swap(d, 0, 1, "load")),
    Fault("left loads swapped", "swapped", "front_left", lambda d: _swap(d, 0, 2, "load")),
    Fault("one load frozen", "held load", "front_left", lambda d: _hold(_one(d, "load"), d.at(BEGINS))),
    Fault("one load 0", "held load", "front_left", lambda d: _zero(_one(d, "load"), d.at(BEGINS))),
    Fault("one load noise about 0", "weight", "front_left", _noise),
    Fault("one load 10 % high", "weight", "", lambda d: _factor([_one(d, "load")], 1.1)),
    Fault("one sinkage in mm", "sinkage", "front_left", lambda d: _factor([_one(d, "sinkage")], 1e3, [0])),
    Fault(
        "one sinkage frozen", "held sinkage", "front_left",
        lambda d: _hold(_one(d, "sinkage"), d.at(BEGINS)),
    ),
    Fault("zero 20 mm up", "sinkage", "front_left", lambda d: _add(_one(d, "sinkage"), -0.02)),
    Fault("zero 5 mm down", "sinkage", "front_left", lambda d: _add(_one(d, "sinkage"), 0.005)),
)  # fmt: skip
FAULTS = {fault.name: fault for fault in _FAULTS}


# --- The subject

# Drives by seed, on which all sensors are good.
DRIVES = (
    RandomWorld("good, plain"),
    RandomWorld("good, two sizes", vehicle="two sizes", way="bends"),
    RandomWorld("good, long", vehicle="long", way="straight", speed=0.6),
    RandomWorld("good, manoeuvres", way="manoeuvres"),
    RandomWorld("good, stops", way="stop and go", speed=0.5),
)
NOTHING = "nothing"


def good_drive(seed: int) -> Raw:
    """A drive on which all sensors are good."""
    return Raw.of(make_drive(DRIVES[seed % len(DRIVES)], seed))


def trial(name: str, seed: int) -> Line:
    """Put one fault into a drive: the way at which it is named, and what is reported beside it."""
    drive = good_drive(seed)
    before = {(finding.rule, finding.subject) for finding, _ in heard(drive)}
    if name == NOTHING:
        return {"accused": [f"{rule}: {subject}" for rule, subject in before]}
    fault = FAULTS[name]
    fault.done(drive)
    found = heard(drive)
    named = [way for f, way in found if _named(fault, f.rule, f.subject)]
    beside = [
        f"{f.rule}: {f.subject}"
        for f, _ in found
        if (f.rule, f.subject) not in before and not _named(fault, f.rule, f.subject)
    ]
    return {"named": bool(named), "way": named[0] if named else None, "beside": beside}


def _named(fault: Fault, rule: str, subject: str) -> bool:
    return rule == fault.rule and fault.subject in subject


def _has_fault(line: Line) -> int:
    return int("named" in line)


def _is_good(line: Line) -> int:
    return 1 - _has_fault(line)


def _is_named(line: Line) -> bool:
    return bool(line.get("named"))


def _else_reported(line: Line) -> bool:
    return bool(line.get("beside"))


def _accused(line: Line) -> bool:
    return bool(line.get("accused"))


JUDGES = [
    Judge("faults named", share(_is_named, _has_fault), 0.9, each="."),
    Judge("metres until it is named", middle(lambda one: one.get("way"))),
    Judge("something else reported beside it", share(_else_reported, _has_fault), most=0.1),
    Judge("good sensors accused", share(_accused, _is_good), most=0.05),
]
SUBJECTS = [Subject("faults", [NOTHING, *FAULTS], trial, JUDGES, 5, 3.0)]
