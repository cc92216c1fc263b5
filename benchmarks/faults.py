# SPDX-License-Identifier: Apache-2.0
"""Faults put into copies of drives: when each is said, and what is said beside it; and what good drives hear.

    python benchmarks/faults.py --drives ../shared/data/real_drives        # real ones and five simulated
    python benchmarks/faults.py --simulated                                # the simulated ones alone

Held values, zeros and repeats begin at 30 % of the way of the rims, a jump at 50 %; all else is there from
the beginning. Way: of the rims from the beginning until it is said.
"""

from __future__ import annotations

import argparse
import copy
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from smallwheel_ros.bags import BagReader
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, OnboardSettings
from smallwheel_ros.pipeline.checks import Checks, Finding
from smallwheel_ros.simulate.drive import simulate_drive
from smallwheel_ros.simulate.ride import DriveSettings

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
GRAVITY = 9.80665
BEGINS, JUMPS_AT = 0.3, 0.5  # share of the way
# Of drives on which all sensors are good; what is truly so of the real ones is said beside.
SIMULATED: dict[str, dict[str, Any]] = {
    "mixed soil": {"seed": 1, "wheels": "four"},
    "mixed soil, two sizes": {"seed": 2, "wheels": "two_sizes"},
    "long": {"seed": 3, "wheels": "four", "distance": 60.0},
    "fast": {"seed": 4, "wheels": "four", "speed": 0.9},
    "stuck": {"seed": 5, "wheels": "four", "finish": "slippery"},
}
REAL = {
    "warthog_grass": ("warthog.yaml", "/icp_odom"),
    "warthog_grass_pose_only": ("warthog.yaml", "/icp_odom"),
    "warthog_sand1": ("warthog.yaml", "/icp_odom"),
    "pathfinder_flat": ("pathfinder.yaml", "/gnss/odom"),
    "husky_snow": ("husky.yaml", "/husky_velocity_controller/odom"),
}
TRUE = {  # rule and subject that are right of a real drive
    "warthog_grass_pose_only": {("no twist", ODOMETRY)},
    "pathfinder_flat": {("z down", "imu"), ("rolling", "radii")},
    "husky_snow": {("of wheels", "odometry")},
}


@dataclass
class Raw:
    """A drive as the streams have it: rows by stream; loads that are given are not among them."""

    name: str
    settings: OnboardSettings
    rows: dict[str, tuple[Integers, Array]]

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

    def copied(self) -> Raw:
        """With rows of its own."""
        return Raw(self.name, self.settings, copy.deepcopy(self.rows))


def heard(drive: Raw) -> list[tuple[Finding, float]]:
    """What is said of a drive, with the way at which it is."""
    checks = Checks(drive.settings)
    until = max(int(stamps[-1]) for stamps, _ in drive.rows.values() if stamps.size)
    found = [*checks.take(drive.rows, until), *checks.flush()]
    stamps, way = drive.way()
    return [(finding, float(np.interp(finding.stamp, stamps, way))) for finding in found]


# --- Drives


def parameters_of(path: Path) -> dict[str, Any]:
    """Parameters of a file of ROS, groups written with points."""
    found: dict[str, Any] = {}

    def add(prefix: str, group: dict[str, Any]) -> None:
        for name, value in group.items():
            if isinstance(value, dict):
                add(f"{prefix}{name}.", value)
            else:
                found[prefix + name] = value

    add("", yaml.safe_load(path.read_text(encoding="utf-8"))["/**"]["ros__parameters"])
    return found


def real_drive(folder: Path, name: str) -> Raw:
    """A drive of `REAL`."""
    config, topic = REAL[name]
    settings = settings_from(parameters_of(folder / config))
    joints, odometry, imu = [], [], []
    with BagReader(folder / name) as bag:
        for message in bag.messages(["/joint_states", topic, "/imu/data"]):
            m = message.message
            stamp = m.header.stamp.sec * 1_000_000_000 + m.header.stamp.nanosec
            if message.topic == "/joint_states":
                speeds = dict(zip(m.name, m.velocity, strict=True))
                joints.append(
                    (stamp, [speeds[i.joint] * i.joint_sign for i in settings.inputs.values()])
                )
            elif message.topic == topic:
                odometry.append((stamp, odometry_row(m.pose.pose, m.twist.twist)))
            else:
                imu.append((stamp, imu_row(m)))
    rows = {IMU: _rows(imu), ODOMETRY: _rows(odometry)}
    stamps, values = _rows(joints)
    rows |= {f"{w}/wheel_speed": (stamps, values[:, [i]]) for i, w in enumerate(settings.inputs)}
    return Raw(name, settings.onboard, rows)


def odometry_row(pose: Any, twist: Any) -> list[float]:
    """The ten columns of the odometry's stream."""
    q, p = pose.orientation, pose.position
    yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (q.w * q.y - q.z * q.x))))
    roll = math.atan2(2 * (q.w * q.x + q.y * q.z), 1 - 2 * (q.x * q.x + q.y * q.y))
    moves = [twist.linear.x, twist.angular.z, p.x, p.y, math.cos(yaw), math.sin(yaw)]
    return [*moves, 0.0, 0.0, pitch, roll]


def imu_row(message: Any) -> list[float]:
    """The seven columns of the imu's stream: yaw rate, specific force, which way is up."""
    q, a = message.orientation, message.linear_acceleration
    turn = getattr(message, "angular_velocity", None)
    up = [math.nan] * 3
    if (
        abs(q.x**2 + q.y**2 + q.z**2 + q.w**2 - 1.0) <= 0.01
        and message.orientation_covariance[0] != -1.0
    ):
        up = [2 * (q.x * q.z - q.w * q.y), 2 * (q.y * q.z + q.w * q.x), 1 - 2 * (q.x**2 + q.y**2)]
    return [turn.z if turn else math.nan, a.x, a.y, a.z, *up]


def _rows(found: list[tuple[int, list[float]]]) -> tuple[Integers, Array]:
    """By stamp; of two with one stamp the first."""
    stamps, first = np.unique(
        np.array([stamp for stamp, _ in found], dtype=np.int64), return_index=True
    )
    return stamps, np.array([row for _, row in found], dtype=float)[first]


def simulated_drive(name: str) -> Raw:
    """A drive of `SIMULATED`."""
    made = simulate_drive(DriveSettings(**SIMULATED[name]))
    wheels = made.rover.wheels
    given: dict[str, Any] = {"wheels": [w.name for w in wheels], "soil.name": "dry_sand"}
    given |= {"vehicle.mass": made.rover.mass, "imu_topic": "imu"}
    rows: dict[str, tuple[Integers, Array]] = {}
    for i, wheel in enumerate(wheels):
        given |= {f"{wheel.name}.diameter": wheel.diameter, f"{wheel.name}.width": wheel.width}
        given[f"{wheel.name}.longitudinal_position"] = wheel.x
        given[f"{wheel.name}.lateral_position"] = wheel.y
        load, sinkage = made.load[wheel.name], made.sinkage[wheel.name]
        rows[f"{wheel.name}/load"] = load.stamp, load.normal[:, None]
        rows[f"{wheel.name}/sinkage"] = (
            sinkage.stamp,
            np.stack([sinkage.sinkage, sinkage.variance], 1),
        )
        rows[f"{wheel.name}/wheel_speed"] = made.joints.stamp, made.joints.velocity[:, [i]]
    o, imu = made.odometry, made.imu
    x, y, z, w = o.orientation.T
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    columns = [
        o.forward_speed,
        o.yaw_rate,
        o.x,
        o.y,
        np.cos(yaw),
        np.sin(yaw),
        *np.zeros((4, x.size)),
    ]
    rows[ODOMETRY] = o.stamp, np.stack(columns, axis=1)
    x, y, z, w = imu.orientation.T
    up = [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
    rows[IMU] = imu.stamp, np.stack([imu.yaw_rate, *imu.acceleration.T, *up], axis=1)
    return Raw(name, settings_from(given).onboard, rows)


# --- Faults


def _rim(drive: Raw, i: int) -> tuple[Integers, Array]:
    return drive.rows[f"{drive.settings.wheels[i].name}/wheel_speed"]


def _swap(drive: Raw, i: int, j: int, what: str) -> None:
    one, two = (f"{drive.settings.wheels[k].name}/{what}" for k in (i, j))
    drive.rows[one], drive.rows[two] = drive.rows[two], drive.rows[one]


def _sides(drive: Raw) -> None:
    _swap(drive, 0, 1, "wheel_speed")
    _swap(drive, 2, 3, "wheel_speed")


def _from(rows: tuple[Integers, Array], stamp: int) -> int:
    return min(int(np.searchsorted(rows[0], stamp)), len(rows[0]) - 1)


def _hold(rows: tuple[Integers, Array], stamp: int, moving: bool = False) -> None:
    i = _from(rows, stamp)
    while moving and i < len(rows[1]) - 1 and rows[1][i, 0] == 0.0:
        i += 1
    rows[1][i:] = rows[1][i]


def _zero(rows: tuple[Integers, Array], stamp: int) -> None:
    rows[1][_from(rows, stamp) :] = 0.0


def _factor(
    of: Iterable[tuple[Integers, Array]], factor: float, columns: Any = slice(None)
) -> None:
    for _, values in of:
        values[:, columns] *= factor


def _of_wheels(drive: Raw) -> None:
    stamps, values = drive.rows[ODOMETRY]
    wheels = drive.settings.wheels
    rims = [
        np.interp(stamps, *(_rim(drive, i)[0], _rim(drive, i)[1][:, 0])) for i in range(len(wheels))
    ]
    rims = [0.5 * wheel.diameter * rim for wheel, rim in zip(wheels, rims, strict=True)]
    left = np.array([wheel.lateral_position > 0 for wheel in wheels])
    track = np.ptp([wheel.lateral_position for wheel in wheels])
    values[:, 0] = np.mean(rims, axis=0)
    values[:, 1] = (np.array(rims)[~left].mean(axis=0) - np.array(rims)[left].mean(axis=0)) / track


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
    values = drive.rows[f"{drive.settings.wheels[0].name}/load"][1]
    values[:, 0] = np.random.default_rng(0).normal(0.0, 0.3, len(values))


def _all(drive: Raw, what: str) -> list[tuple[Integers, Array]]:
    return [rows for name, rows in drive.rows.items() if name.endswith(f"/{what}")]


def _one(drive: Raw, what: str) -> tuple[Integers, Array]:
    return drive.rows[f"{drive.settings.wheels[0].name}/{what}"]


@dataclass(frozen=True)
class Fault:
    """What is done, and by which rule and subject (a part of it; empty: any) it should be named."""

    name: str
    rule: str
    subject: str
    done: Callable[[Raw], Any]


def _add(rows: tuple[Integers, Array], value: float) -> None:
    rows[1][:, 0] += value


MOTION = (
    Fault("encoder shows 0", "dead", "front_left", lambda d: _zero(_rim(d, 0), d.at(BEGINS))),
    Fault("encoder holds", "held", "front_left", lambda d: _hold(_rim(d, 0), d.at(BEGINS), True)),
    Fault("mirrored", "mirrored", "front_left", lambda d: _factor([_rim(d, 0)], -1.0)),
    Fault("one radius +10 %", "rolling", "front_left", lambda d: _factor([_rim(d, 0)], 1.1)),
    Fault("one radius -10 %", "rolling", "front_left", lambda d: _factor([_rim(d, 0)], 0.9)),
    Fault("all radii 10 % small", "rolling", "radii", lambda d: _factor(_all(d, "wheel_speed"), 0.9)),
    Fault("front wheels interchanged", "turn", "front_left", lambda d: _swap(d, 0, 1, "wheel_speed")),
    Fault(
        "left and right interchanged", "turn", "",
        _sides,
    ),
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
)  # fmt: skip
SOIL = (
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


def injected(drives: list[Raw], faults: Iterable[Fault], kind: str) -> list[str]:
    """A line of the table for each fault; drives that have the fault themselves are left out."""
    before = {d.name: {(f.rule, f.subject) for f, _ in heard(d)} for d in drives}
    lines = []
    for fault in faults:
        ways, missed, beside, count = [], [], Counter[str](), 0
        for drive in drives:
            said = before[drive.name]
            if any(_named(fault, *one) for one in said) or (
                ("of wheels", "odometry") in said
                and (fault.rule in ("late", "of wheels") or fault.name.startswith("odometry 1.3"))
            ):
                continue
            changed = drive.copied()
            fault.done(changed)
            found, count = heard(changed), count + 1
            right = [way for f, way in found if _named(fault, f.rule, f.subject)]
            ways += right[:1]
            missed += [] if right else [drive.name]
            for f, _ in found:
                if (f.rule, f.subject) not in said and not _named(fault, f.rule, f.subject):
                    beside[f"{f.rule}: {f.subject}"] += 1
        way = f"{np.median(ways):.1f}" if ways else "-"
        words = ", ".join(f"{name} ({n})" for name, n in beside.items())
        lines.append(
            f"| {fault.name} | {kind} | {len(ways)} of {count} | {way} | {words} | {', '.join(missed)} |"
        )
        print(lines[-1], flush=True)
    return lines


def _named(fault: Fault, rule: str, subject: str) -> bool:
    return rule == fault.rule and fault.subject in subject


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--drives", type=Path, help="folder of the real drives")
    parser.add_argument("--simulated", action="store_true", help="only the simulated ones")
    given = parser.parse_args()
    real = []
    if not given.simulated:
        if given.drives is None or not given.drives.is_dir():
            parser.error(f"--drives: expected the folder of the real drives, found {given.drives}")
        real = [real_drive(given.drives, name) for name in REAL]
    made = [simulated_drive(name) for name in SIMULATED]
    print("| drive | way, m | said of it | at m | true |\n| --- | --- | --- | --- | --- |")
    wrong = 0
    for drive in (*real, *made):
        found = heard(drive)
        for finding, way in found:
            true = (finding.rule, finding.subject) in TRUE.get(drive.name, set())
            wrong, answer = wrong + (not true), "yes" if true else "NO"
            print(f"| {drive.name} | | {finding.rule}: {finding.text} | {way:.1f} | {answer} |")
        if not found:
            print(f"| {drive.name} | {drive.way()[1][-1]:.0f} | nothing | | |")
    print(f"\n{wrong} good sensors accused\n")
    print(
        "| fault | drives | named | way, m | beside it | missed |\n| --- | --- | --- | --- | --- | --- |"
    )
    if real:
        injected(real, MOTION, "real")
    injected(made, (*MOTION, *SOIL), "simulated")


if __name__ == "__main__":
    main()
