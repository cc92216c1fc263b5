# SPDX-License-Identifier: Apache-2.0
"""Wheel speeds against each other and against the speed over ground: who is wrong is named, and left out.

The rims of one vehicle roll over one ground at one speed, each at that of its place, so their slips are
nearly alike. A wheel is doubted where its joint

    turns against the travel for 0.5 m: the axis is mirrored, or it is another joint;
    shows exactly 0 for 0.3 m on which the others turn: the encoder is dead, or the wheel is blocked;
    shows exactly one speed for a second in which that of the others changes by a tenth, or for 1.5 m of
    their noise;
    has a slip that is 0.2 off the middle of the others' for 0.5 m, and off that of the wheel beside it: an
    axle of which both sides slip alike is braked, or tested.

Its slip is that of the others then, give or take 0.2, and in each step in which it is so far off, until it
moves and agrees with them again over 0.3 m. The speed over ground is not known while its messages repeat one
and the same (see `SensorBuffer`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median

from smallwheel_ros.estimator.path_steps import PathStep
from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Quantity, Wheel

_AGAINST = 0.5  # m of the wheel's own path on which it turned against its travel throughout
_RATIO = 0.3  # of rim speed over speed: less may be a wheel that is locked
_DEAD = 0.3  # m
_HELD, _STILL = 1.0, 1.5  # s, m
_CHANGED, _LEAST = 0.1, 0.02  # of the others' speed, and m/s
# Radii, bends and loads make slips differ by some hundredths.
_APART, _TOGETHER = 0.2, 0.1
_STEPS, _AGREEING = 5, 3  # of 0.1 m
_OTHERS = 2  # wheels that it takes to say who is wrong
_REPEATED = SECOND  # ns


@dataclass
class _Joint:
    """Of a wheel: paths (m) since which something holds, and slips off those of the others."""

    last: float = 0.0
    against: float = 0.0
    dead: float = 0.0
    still: float = 0.0  # of a rim that shows one speed while those of the others change
    held: float = 0.0  # rim speed, m/s, since it has not changed
    others: float | None = None  # and that of the others then
    fixed: bool = False
    off: deque[float] = field(default_factory=lambda: deque(maxlen=_STEPS))
    why: str = ""


class MotionWatch:
    """Of a vehicle; feed it every instant and step in the order of time."""

    def __init__(self, wheels: Sequence[Wheel]) -> None:
        rolling = [wheel for wheel in wheels if wheel.contact == ROLLING]
        self._joints = {wheel.name: _Joint() for wheel in rolling}
        self._place = {wheel.name: wheel.longitudinal_position for wheel in rolling}
        self._rims: dict[str, float] = {}  # the newest of each, m/s
        self._held: dict[str, float] = {}  # s since which they have not changed
        self._repeated: int | None = None  # stamp since which the speed repeats
        self._odometry = ""

    def add(self, instant: Instant) -> Instant:
        """Take an instant; return it without a slip that is none."""
        name = instant.wheel.name
        joint = self._joints.get(name)
        if joint is None:
            return instant
        self._watch_odometry(instant)
        if instant.rim_speed is not None:
            self._rims[name], self._held[name] = instant.rim_speed, instant.rim_held
        if instant.speed is None or instant.rim_speed is None or instant.stands:
            joint.last = instant.path
            return instant
        self._compare(joint, instant, [v for n, v in self._rims.items() if n != name])
        # A wheel that turns faster than the others may well dig itself in: its slip is kept.
        if joint.why and not (instant.slip is not None and joint.off and joint.off[-1] > 0.0):
            return instant._replace(slip=None)
        return instant

    def _watch_odometry(self, instant: Instant) -> None:
        if not instant.speed_repeats:
            self._repeated, self._odometry = None, ""
            return
        self._repeated = self._repeated or instant.stamp
        if instant.stamp - self._repeated >= _REPEATED:
            self._odometry = (
                "odometry repeats one and the same message while the vehicle moves (odom, or velocity_topic):"
                " slip is unknown and no way is counted until it changes; check its driver"
            )

    def _compare(self, joint: _Joint, instant: Instant, others: list[float]) -> None:
        """Look at one reading of a joint."""
        speed, rim = instant.speed or 0.0, instant.rim_speed or 0.0
        way = max(instant.path - joint.last, 0.0)
        joint.last = instant.path
        against = rim * speed < -_RATIO * speed * speed
        joint.against = joint.against + way if against else 0.0
        around = median(map(abs, others)) if len(others) >= _OTHERS else None
        joint.dead = joint.dead + way if rim == 0.0 and around else 0.0
        if rim != joint.held or around is None:
            joint.held, joint.others = rim, around
        joint.fixed = instant.rim_held >= _HELD
        moving = all(held < _HELD for n, held in self._held.items() if n != instant.wheel.name)
        joint.still = joint.still + way if joint.fixed and moving and around is not None else 0.0
        changed = 0.0
        if around is not None and joint.others is not None:
            changed = abs(around - joint.others) - _CHANGED * joint.others - _LEAST
        if joint.against >= _AGAINST:
            joint.why = (
                f"its joint has turned against the travel for {joint.against:.1f} m: the axis is mirrored, or"
                f" it is another joint (parameters {instant.wheel.name}.joint_sign,"
                f" {instant.wheel.name}.joint)"
            )
        elif joint.dead >= _DEAD:
            joint.why = (
                "its joint shows 0 while the vehicle moves and the others turn: the encoder is dead, or the"
                " wheel is blocked"
            )
        elif rim != 0.0 and ((changed > 0.0 and joint.fixed) or joint.still >= _STILL):
            joint.why = (
                f"its joint shows {abs(rim):.3g} m/s at the rim without change while the others turn faster"
                " or slower: check its encoder"
            )

    def compared(self, step: PathStep) -> PathStep:
        """Compare the slips of a step; return it with those of doubted wheels as the others have them."""
        trusted = {n: m.slip.value for n, m in step.wheels.items() if not self._joints[n].why}
        means = dict(step.wheels)
        for name, mean in step.wheels.items():
            joint = self._joints[name]
            others = [slip for other, slip in trusted.items() if other != name]
            if len(others) < _OTHERS:
                if joint.why:
                    del means[name]  # nobody knows
                continue
            middle, place = median(others), self._place[name]
            for beside in (n for n in trusted if n != name and self._place[n] == place):
                if abs(trusted[beside] - mean.slip.value) < _TOGETHER:
                    middle = trusted[beside]
            joint.off.append(mean.slip.value - middle)
            if joint.why:
                self._release(joint)
            elif len(joint.off) == _STEPS and min(map(abs, joint.off)) > _APART:
                joint.why = (
                    f"its joint shows a slip of {mean.slip.value:.2f} where the others have {middle:.2f}:"
                    " check its encoder, its diameter, and whether it turns freely"
                )
            if joint.why or abs(joint.off[-1]) > _APART:
                slip = Quantity(middle, mean.slip.standard_deviation)
                means[name] = mean._replace(slip=slip, doubt=_APART)
        return step._replace(wheels=means)

    def _release(self, joint: _Joint) -> None:
        lately = list(joint.off)[-_AGREEING:]
        agrees = len(lately) == _AGREEING and max(map(abs, lately)) < _TOGETHER
        if agrees and not joint.fixed and joint.against == 0.0:
            joint.why, joint.others = "", None

    @property
    def findings(self) -> tuple[str, ...]:
        """In words, with what to check."""
        wheels = (
            f"wheel '{name}': {joint.why}" for name, joint in self._joints.items() if joint.why
        )
        return (*wheels, *([self._odometry] if self._odometry else []))
