# SPDX-License-Identifier: Apache-2.0
"""Checks of sensors: a table of rules, each of which reports only what nothing but a fault explains.

    checks = Checks(settings, ground, doubts)  # ground has learnt of the rows before they are taken
    for finding in checks.take(rows, watermark): ...      # raw rows of all streams since checks.done
    doubts.at(stream, stamps)   # whether it is not to be used there

1. A difference of slips is no fault: stuck vehicles spin diagonally. No wheel is judged by others' slips.
2. Exact before statistical: bit-for-bit repeats over a path, signs, impossible sizes, sums.
3. Rows are chosen: signs and radii on straight rows, signs of turning on rows that turn.
4. A source already reported is no evidence, such as odometry that repeats or is computed from the wheels.
5. Faults that look the same are reported as "A or B", or not at all.

Rules are judged at fixed stamps, once in each `SPAN`, from sums of bounded size, so that a report
does not depend on where blocks are cut. A missing value is never replaced by one of another sensor.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from smallwheel_ros.common.stamps import NEVER, SECOND
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, OnboardSettings
from smallwheel_ros.pipeline.tables import Array, Integers

from .doubts import SHOWS_NO_SLIP, Doubts
from .ground_speed import DOWN, GroundSpeed
from .lateness import MADE, PIECES, SIGN_SHARE
from .loads import (
    SWAP,
    SWAP_PIECES,
    SWAP_SURE,
    WEIGHT_OFF,
    ZERO_OFF,
    HeldColumn,
    Impossible,
    Swapped,
    Weight,
)
from .odometry import (
    FRAME_ASIDE,
    FRAME_FITS,
    FRAME_MOVES,
    FRAME_WAY,
    GRAVITY_TIME,
    JUMP,
    JUMP_FACTOR,
    LATE,
    LATE_ALIKE,
    NO_TWIST_WAY,
    REPEAT_WAY,
    STANDS,
    TILT,
    TILT_CHANCE,
    FeltGravity,
    Jumps,
    Late,
    NoTwist,
    OfWheelsRule,
    RepeatedTwists,
    Tilt,
    TwistFrame,
    ZDown,
)  # fmt: skip
from .rims import (
    DEAD_WAY,
    HELD,
    LEVEL,
    ROLL_OFF,
    ROLL_PIECES,
    ROLL_SCATTER,
    ROLL_SURE,
    SIGN_WAY,
    TURN,
    TURN_AGREES,
    UNIT_FAR,
    UNIT_PIECE,
    UNIT_PIECES,
    UNIT_SCATTER,
    UNIT_SURE,
    AnotherUnit,
    Dead,
    Held,
    Mirrored,
    RollingAll,
    RollingPair,
    TurnRule,
)  # fmt: skip
from .steering import (
    SIGN_ANGLE,
    SIGN_OFF,
    SIGN_REMOVES,
    SIGN_STEERED,
    SIGN_SURE,
    SteeringSign,
)
from .sums import Said
from .window import AROUND, SPAN, CheckedWheels, Memory, Raw, Window


class Judge(Protocol):
    """A rule as it runs on one vehicle: it processes one span of 2 s after the other."""

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return every fault that the rule reports at its end."""


@dataclass(frozen=True)
class Rule:
    """A rule: a row of the table `RULES`, and of docs/checks.md.

    Attributes
    ----------
    name
        Name of the rule in findings and in docs/checks.md.
    rows
        In words, the rows that it uses.
    statistic
        In words, what it computes from these rows.
    limit
        In words, the value of the statistic beyond which it reports.
    reason
        Why that limit; includes the largest value on a drive whose sensors were all good.
    says
        In words, what may be wrong.
    starts
        Makes the rule's `Judge` for a vehicle.
    """

    name: str
    rows: str
    statistic: str
    limit: str
    reason: str
    says: str
    starts: Callable[[CheckedWheels], Judge]


# Rules whose result other rules use come first: an odometry that is computed from the wheels, repeats or has
# just jumped is no evidence; an imu that looks down is turned over.
RULES: tuple[Rule, ...] = (
    Rule(
        "of wheels",
        "the last half metres of the rims",
        "difference of its distance to the rims', or of its turn to right less left: rms over the distance",
        f"under {MADE:g}, {PIECES} pieces",
        "the best independent odometries wander by 0.005; worst good drive 0.03",
        "the odometry is computed from the wheels and shows no slip",
        lambda vehicle: OfWheelsRule(),
    ),
    Rule(
        "z down",
        "all rows of the imu",
        "rows that feel gravity down along z less those that feel it up",
        f"over 0; counted where it is over {DOWN:g} g",
        "no vehicle drives on slopes over 60 degrees",
        "z of the imu looks down; it is turned over",
        lambda vehicle: ZDown(),
    ),
    Rule(
        "repeats",
        "messages of the odometry while the rims move",
        "longest distance of the rims during which one message is repeated",
        f"over {REPEAT_WAY:g} m",
        "a lost connection, not one missed message",
        "driver of the odometry",
        lambda vehicle: RepeatedTwists(ODOMETRY),
    ),
    Rule(
        "jumps",
        "steps of the pose, gaps under 1 s",
        f"step less {JUMP_FACTOR:g} times the longest distance that rims or twist give",
        f"over {JUMP:g} m",
        "worst good drive 0.8 m (lidar in violent spins)",
        "positions are off by that",
        Jumps,
    ),
    Rule(
        "frame",
        f"odometry rows whose pose goes ahead {FRAME_ASIDE:g} of its speed off x of its frame",
        "twist's speed less the pose's speed along x, over the distance",
        f"under {FRAME_FITS:g}, over {FRAME_WAY:g} m, {FRAME_MOVES:g} of it by the twist",
        "the vehicle's own speed is twice that off; good drives 0.86 to 0.99",
        "frame of the twist",
        lambda vehicle: TwistFrame(),
    ),
    Rule(
        "mirrored",
        "straight rows on which the wheel turns",
        "share of the distance on which it turns against the travel",
        f"over {SIGN_SHARE:g} of at least {SIGN_WAY:g} m",
        "a delay of 0.5 s at 1 m/s stays under it; worst good wheel 0.03",
        "joint_sign or joint; all wheels at once, where no slide is possible: the odometry looks backward",
        Mirrored,
    ),
    Rule(
        "dead",
        "straight rows on which most others roll",
        "longest distance on which the joint shows exactly 0",
        f"over {DEAD_WAY:g} m",
        "a blocked wheel may be dragged that far; worst good wheel 1.1 m",
        "the encoder is dead, or the wheel blocked",
        Dead,
    ),
    Rule(
        "held",
        "rows on which the rims move",
        "changes of most other joints while one repeats a value, not 0, bit for bit",
        f"over {HELD}",
        "coarse counters repeat at a steady speed, all at once; worst good wheel 4",
        "encoder, or its driver",
        Held,
    ),
    Rule(
        "turn",
        f"rows that turn, {TURN:g} rad in all",
        "correlation about 0 of each two of right less left, odometry and gyro; of each wheel with its side",
        f"under {-TURN_AGREES:g}",
        "two outvote one; else it is one or the other",
        "mounting of the imu, frame of the odometry, joints interchanged",
        TurnRule,
    ),
    Rule(
        "steering",
        f"rows on which a wheel is steered by over {SIGN_ANGLE:g} rad, {SIGN_STEERED:g} m in all; 4 wheels"
        " or more",
        "misfit of rims, headings, gyro and poses to the nearest rigid motion, less that with the other sign"
        " of some wheels, over their rims' speed",
        f"over {SIGN_OFF:g}; over {SIGN_REMOVES:g} of what a wrong sign would cost, and {SIGN_SURE:g}"
        " standard errors over 0",
        "zeros of joints are off by 3 degrees; no change of sign removes differences in slip",
        "steering_sign, or steering_joint",
        SteeringSign,
    ),
    Rule(
        "unit",
        f"all so far, in pieces of {UNIT_PIECE:g} m",
        "distance by the rims over that by the odometry",
        f"under {1.0 / UNIT_FAR:g} on {UNIT_PIECES} pieces, or over {UNIT_FAR:g} and near a unit's factor on"
        f" {UNIT_SURE}; scatter under {UNIT_SCATTER:g} of it",
        "a unit never changes, slip does",
        "unit of velocities or positions",
        AnotherUnit,
    ),
    Rule(
        "rolling",
        f"straight, level metres (mean acceleration ahead under {LEVEL:g} g)",
        "median of the distance by the rims over that by the odometry",
        f"under 1 - max({ROLL_OFF:g}, {ROLL_SURE:g} standard errors), {ROLL_PIECES} m",
        "driven wheels do not skid on the level; over 1 it is slip",
        "diameters, or scale of the odometry",
        RollingAll,
    ),
    Rule(
        "rolling",
        "metres of two wheels of one side",
        "median of the ratio of their distances",
        f"{ROLL_OFF:g} off, scatter under {ROLL_SCATTER:g}, {ROLL_PIECES} m",
        "a radius is the same on each metre (scatter 0.005), slip is not (0.05 to 0.36 in snow)",
        "diameters of both",
        RollingPair,
    ),
    Rule(
        "no twist",
        "all rows of the odometry",
        "distance by the pose while the twist is exactly 0",
        f"over {NO_TWIST_WAY:g} m",
        "exact",
        "speed is taken from the pose",
        lambda vehicle: NoTwist(),
    ),
    Rule(
        "frozen",
        "messages of the imu while the rims move",
        "longest distance of the rims during which one message is repeated",
        f"over {REPEAT_WAY:g} m",
        "as for the odometry",
        "driver of the imu",
        lambda vehicle: RepeatedTwists(IMU),
    ),
    Rule(
        "late",
        "changes over 0.5 s of rims and odometry, while the wheels of each side agree",
        "lag of the best correlation",
        f"{LATE:g} s, correlation over {LATE_ALIKE:g}, changes over {Late.FOLLOWS:g} of the rims'",
        "the worst good odometry that follows the rims so well is 0.1 s late",
        "stamps of the odometry",
        Late,
    ),
    Rule(
        "gravity",
        f"all rows of the imu, {GRAVITY_TIME:g} s or more",
        "length of the mean acceleration over g",
        "under 0.82, or over 1.22",
        "no accelerometer is off by so much; worst good drive 0.003 off",
        "unit of the accelerations, or gravity taken out: no slope is taken from them",
        FeltGravity,
    ),
    Rule(
        "tilt",
        f"standstills over 1 s, {STANDS} or more",
        "zero of the imu, from all headings: zero and slope each with a prior deviation",
        f"over {math.degrees(TILT):.1f} degrees, and a chance of {TILT_CHANCE:g} by its scatter",
        "smaller zeros are usual; worst good drive 1.1 degrees",
        "level the imu",
        Tilt,
    ),
    Rule(
        "held load",
        "loads while the rims move",
        "distance on which it repeats a number, 0 too, while most others change",
        f"over {REPEAT_WAY:g} m, {HELD} changes",
        "as for joints",
        "driver of the cell",
        partial(HeldColumn, "load"),
    ),
    Rule(
        "held sinkage",
        "sinkages while the rims move",
        "distance on which it repeats a number, 0 too, while most others change",
        f"over {REPEAT_WAY:g} m, {HELD} changes",
        "as for joints",
        "driver of the sensor",
        partial(HeldColumn, "sinkage"),
    ),
    Rule(
        "weight",
        "measured loads of all wheels",
        "median of their sum over m g",
        f"{WEIGHT_OFF:g} off",
        "mass known to 5 %, cells to 5 %; loads that are given are not weighed",
        "unit, cell or mass; a wheel under a tenth of the others is named",
        Weight,
    ),
    Rule(
        "swapped",
        f"changes from 0.2 m to 0.2 m, {SWAP_PIECES} pieces",
        "correlation of ln sinkage of one wheel with ln load of another",
        f"{SWAP_SURE:g} standard errors (mean of the crossed pairs), each {SWAP:g} over that with its own",
        "neighbours in one rut correlate too, but no more than with their own: worst good drive 0.12 more",
        "load_topic, sinkage_topic",
        Swapped,
    ),
    Rule(
        "sinkage",
        "sinkages while the vehicle moves",
        "median",
        f"over the radius, or under {-ZERO_OFF:g} of it",
        "on hard ground a good sensor shows 0 and the error of its zero",
        "unit, or zero",
        Impossible,
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """A fault of a sensor that a rule has reported.

    Attributes
    ----------
    stamp
        Stamp at which it was judged, ns.
    rule, subject
        Name of the rule, and the wheel or source at fault.
    text
        What is wrong, since when, and what to do.
    """

    stamp: int
    rule: str
    subject: str
    text: str


class Checks:
    """Applies the rules to one vehicle.

    Parameters
    ----------
    settings
        Settings of the vehicle.
    ground
        What has been learnt of odometry and imu; it must be up to date before the rules judge.
    doubts
        Record to which doubts are added; None: a new one.

    Attributes
    ----------
    doubted
        Streams that are not to be used now, each with the stamp at which its fault began, ns; 0 if it was
        there from the beginning of the drive.
    anew
        Stamps (ns) at which the soil is learnt anew, because a stream that it was learnt from turned
        out to have been wrong from the beginning.
    done
        Stamp (ns) up to which raw rows were taken.
    holds
        Faults that the rules report at the end of the newest span of 2 s, new or not.
    """

    def __init__(
        self, settings: OnboardSettings, ground: GroundSpeed, doubts: Doubts | None = None
    ) -> None:
        self.vehicle, self.ground = CheckedWheels.of(settings), ground
        self.doubts = Doubts() if doubts is None else doubts
        self.memory = Memory()
        self.judges = [(rule.name, rule.starts(self.vehicle)) for rule in RULES]
        self.doubted: dict[str, int] = {}
        self.anew: list[int] = []
        self.holds: tuple[Finding, ...] = ()
        self.done = self._next = NEVER
        self._rows: dict[str, tuple[Integers, Array]] = {}
        self._said: set[tuple[str, str]] = set()

    def take(self, raw: Raw, until: int) -> list[Finding]:
        """Keep new raw rows, and judge all spans of 2 s that are complete.

        Parameters
        ----------
        raw
            New rows by stream: stamps (ns) and values (rows, width).
        until
            Stamp up to which all rows have arrived, ns.

        Returns
        -------
        list of Finding
            Faults that were not reported before.
        """
        self.keep(raw)
        return self.judge(until)

    def judge(self, until: int) -> list[Finding]:
        """Judge all complete spans of the kept rows; return faults that were not reported before.

        until: stamp up to which all rows have arrived, ns.
        """
        self.done = max(self.done, until)
        return self._judge(until - AROUND)

    def flush(self) -> list[Finding]:
        """Judge the rows left over at the end of a drive; return faults that were not reported before."""
        newest = max(
            (int(stamps[-1]) for stamps, _ in self._rows.values() if stamps.size), default=NEVER
        )
        return self._judge(newest + SPAN + 1) if newest > NEVER else []

    def keep(self, raw: Raw) -> None:
        """Keep new raw rows until they are judged; by stream, stamps (ns) and values (rows, width)."""
        for name, (stamps, values) in raw.items():
            if not stamps.size:
                continue
            if name in self._rows:
                old = self._rows[name]
                stamps, values = np.concatenate([old[0], stamps]), np.concatenate([old[1], values])
            self._rows[name] = stamps, values

    def _judge(self, until: int) -> list[Finding]:
        """Judge all spans that end at or before a stamp (ns), and drop rows that are no longer needed."""
        found: list[Finding] = []
        if not self.vehicle.names:
            self._rows.clear()
            return found
        while True:
            ahead = [
                int(stamps[place])
                for stamps, _ in self._rows.values()
                if (place := int(np.searchsorted(stamps, self._next))) < stamps.size
            ]
            begin = min(ahead, default=until) // SPAN * SPAN
            if not ahead or begin + SPAN > until:
                break
            found += self._span(begin)
            self._next = begin + SPAN
        for name, (stamps, values) in self._rows.items():
            drop = int(np.searchsorted(stamps, self._next - AROUND))
            self._rows[name] = stamps[drop:], values[drop:]
        return found

    def _span(self, begin: int) -> list[Finding]:
        found: list[Finding] = []
        holds: list[Finding] = []
        doubted: dict[str, int] = {}
        unusable: set[str] = set()
        taught = False
        self.memory.doubted.clear()
        self.memory.known = self.ground.known(begin + SPAN)
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # rows of NaN alone have no median
            window = Window(self.vehicle, self._rows, begin, self.memory)
            for rule, judge in self.judges:
                for said in judge.take(window):
                    since = 0 if math.isnan(said.since) else round(said.since * SECOND)
                    self.memory.doubted.update(said.doubts)
                    unusable |= {SHOWS_NO_SLIP} if said.places else set(said.doubts)
                    for stream in said.doubts:
                        doubted[stream] = min(since, doubted.get(stream, since))
                    holds.append(Finding(begin + SPAN, rule, said.subject, _words(said, begin)))
                    if (rule, said.subject) not in self._said:
                        self._said.add((rule, said.subject))
                        found.append(holds[-1])
                        taught |= said.taught
            if window.rims is not None:
                self.memory.way = float(window.way(np.array([SPAN / SECOND]))[0])
        self.doubted, self.holds = doubted, tuple(holds)
        self.doubts.hold(begin + SPAN + AROUND, unusable)
        if taught:
            self.anew.append(begin + SPAN + AROUND)
        return found


def _words(said: Said, begin: int) -> str:
    """Text of a finding, with the duration of a fault that has not been there from the beginning."""
    if math.isnan(said.since):
        dropped = "; what the soil has learnt until then is dropped" if said.taught else ""
        return f"{said.subject}: {said.text}{dropped}"
    return f"{said.subject}: {said.text} (for {max(begin / SECOND + 2.0 - said.since, 0.0):.0f} s)"


def table() -> str:
    """The rules as a table of Markdown."""
    lines = [
        "| rule | rows | statistic | limit | why | says |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    lines += [
        f"| {rule.name} | {rule.rows} | {rule.statistic} | {rule.limit} | {rule.reason} | {rule.says} |"
        for rule in RULES
    ]
    return "\n".join(lines) + "\n"
