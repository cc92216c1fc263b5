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

What both tell of slip where nothing else is measured is what `OdometryWatch` finds.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median

import numpy as np
from scipy.stats import chi2

from smallwheel_ros.estimator.path_steps import PathStep
from smallwheel_ros.estimator.reading import SECOND, Reading
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Quantity, Wheel, wheel_slip

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
    """Of a vehicle; feed it every reading and step in the order of time."""

    def __init__(self, wheels: Sequence[Wheel]) -> None:
        rolling = [wheel for wheel in wheels if wheel.contact == ROLLING]
        self._joints = {wheel.name: _Joint() for wheel in rolling}
        self._place = {wheel.name: wheel.longitudinal_position for wheel in rolling}
        self._rims: dict[str, float] = {}  # the newest of each, m/s
        self._held: dict[str, float] = {}  # s since which they have not changed
        self._repeated: int | None = None  # stamp since which the speed repeats
        self._odometry = ""

    def add(self, reading: Reading) -> Reading:
        """Take a reading; return it without a slip that is none."""
        name = reading.wheel.name
        joint = self._joints.get(name)
        if joint is None:
            return reading
        self._watch_odometry(reading)
        if reading.rim_speed is not None:
            self._rims[name], self._held[name] = reading.rim_speed, reading.rim_held
        if reading.speed is None or reading.rim_speed is None or reading.stands:
            joint.last = reading.path
            return reading
        self._compare(joint, reading)
        # A wheel that turns faster than the others may well dig itself in: its slip is kept.
        if joint.why and not (reading.slip is not None and joint.off and joint.off[-1] > 0.0):
            return reading._replace(slip=None)
        return reading

    def _watch_odometry(self, reading: Reading) -> None:
        if not reading.speed_repeats:
            self._repeated, self._odometry = None, ""
            return
        self._repeated = self._repeated or reading.stamp
        if reading.stamp - self._repeated >= _REPEATED:
            self._odometry = (
                "odometry repeats one and the same message while the vehicle moves (odom, or velocity_topic):"
                " slip is unknown and no way is counted until it changes; check its driver"
            )

    def _around(self, name: str) -> float | None:
        """Speed of the other rims, m/s; None where there are too few."""
        others = [abs(rim) for other, rim in self._rims.items() if other != name]
        return median(others) if len(others) >= _OTHERS else None

    def _compare(self, joint: _Joint, reading: Reading) -> None:
        """Look at one reading of a joint."""
        speed, rim = reading.speed or 0.0, reading.rim_speed or 0.0
        way = max(reading.path - joint.last, 0.0)
        joint.last = reading.path
        against = rim * speed < -_RATIO * speed * speed
        joint.against = joint.against + way if against else 0.0
        name, around = reading.wheel.name, None
        if rim in (0.0, joint.held):
            around = self._around(name)
        joint.dead = joint.dead + way if rim == 0.0 and around else 0.0
        if rim != joint.held or joint.others is None:
            joint.held, joint.others = rim, around
        joint.fixed = reading.rim_held >= _HELD
        moving = joint.fixed and all(h < _HELD for n, h in self._held.items() if n != name)
        joint.still = joint.still + way if moving and around is not None else 0.0
        changed = 0.0
        if around is not None and joint.others is not None:
            changed = abs(around - joint.others) - _CHANGED * joint.others - _LEAST
        if joint.against >= _AGAINST:
            joint.why = (
                f"its joint has turned against the travel for {joint.against:.1f} m: the axis is mirrored, or"
                f" it is another joint (parameters {reading.wheel.name}.joint_sign,"
                f" {reading.wheel.name}.joint)"
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


_DIFFERENCE = 0.5  # s, between the differences
_MEMORY, _ENOUGH = 100, 20  # second differences of a wheel
_NORMAL = 0.6745  # median of the size of a standard normal number
_SCALE_STD = 0.01  # of an odometry: a camera's height, a lens
_LATE_STD = 0.1  # s: a picture or two at 10 to 20 Hz
_PATCHES = 0.02  # of the way, by which slip differs from metre to metre
_LATEST = 0.5  # s
_STRETCH, _STRETCHES = 1.0, 12  # m, and how many of the newest count
_FEWEST = 4  # stretches, before anything is said
_OWN = 0.005  # of the way: the best odometry that knows nothing of the wheels
_EXPLAINED = 3.0 * math.hypot(
    _SCALE_STD, 0.01
)  # a slip that is none: scale, and a tread's hundredth of a radius
_SURE = 0.975


class OdometryWatch:
    """How sure a slip is by odometry and wheel speeds alone, how late it is, and whether it is one.

    How sure. The difference d between the speed of a rim and that of its place over ground has the noise of
    both in it. Slip changes little within half a second, so second differences of d over 0.5 s are noise:
    their variance is six times that of d, whatever the messages say of it. What does not change from reading
    to reading comes on top: the radius of the wheel and the scale of the odometry.

    How late. An odometry of pictures or echoes is late by some tenths of a second, which looks like slip
    while speed changes. Over each metre, with s the way of the rims and i the slip, means of all wheels,

        integral of (rim - speed) dt = i s + tau (change of rim speed)

    so that starts and stops tell tau, with a prior of 0.1 s; the rim is compared as it was tau ago.

    Whether it shows any. An odometry that is made of the wheels, alone or by a filter with an imu, has their
    speed: i is 0 wherever it drives, but for radii and scales. The best odometries that know nothing of
    wheels wander by half a hundredth of the way (Geiger and others 2012, "Are we ready for autonomous
    driving?", and its table since), and slip on soil by more. So where i is surely the same within that from
    metre to metre, and no more than radii and scales are off by, odometry shows no slip: slip is not known
    then. An odometry of its own on a firm floor may be as good; the first metre that slips shows it.

    Of a vehicle; feed it every reading in the order of time.

    Attributes
    ----------
    shows_slip
        False where the odometry has agreed with the wheels as only one that is made of them does.
    late
        s, by which its speed is behind that of the wheels.
    """

    def __init__(self, wheels: Sequence[Wheel], standstill: float) -> None:
        """Begin. wheels: of the vehicle; standstill: m/s, at or below which nobody moves."""
        self._standstill = standstill
        self._noise = {wheel.name: _Noise() for wheel in wheels if wheel.contact == ROLLING}
        self._now: dict[str, tuple[float, float]] = {}  # rim and speed (m/s) of this instant
        self._stamp: int | None = None
        # m, way of the rims in this stretch, and what it is more than the odometry's.
        self._way = self._apart = 0.0
        self._begin = self._rim = 0.0  # m/s, of the rims where the stretch began, and now
        self._stretches: deque[tuple[float, float, float]] = deque(maxlen=_STRETCHES)
        self.shows_slip = True
        self.late = Quantity(0.0, _LATE_STD)

    @property
    def findings(self) -> tuple[str, ...]:
        """In words, with what to check."""
        if self.shows_slip:
            return ()
        return (
            "odometry shows no slip: over the last metres it has agreed with the wheels to"
            f" {self._scatter()[1]:.1%} of the way, as one does that is made of the wheels, or filtered"
            " with them. Slip, risk and warnings are unknown until it differs from them: give an odometry"
            " that the wheels have no part in (odom, or velocity_topic: visual odometry, radar, optical"
            " flow)",
        )

    def add(self, reading: Reading) -> Reading:
        """Take a reading; return it with a slip that is as sure as it is, or with none."""
        noise = self._noise.get(reading.wheel.name)
        if noise is None or reading.speed is None or reading.rim_speed is None:
            return reading
        self._travelled(reading, reading.rim_speed, reading.speed)
        then, deviation = noise.add(reading, reading.rim_speed, reading.speed, self.late)
        if not self.shows_slip:
            return reading._replace(slip=None, rim_speed=None)
        if reading.stands or reading.slip is None:
            return reading
        speed = Quantity(reading.speed, deviation)
        rim = Quantity(then, math.hypot(reading.rim_std, _SCALE_STD * then))
        return reading._replace(
            slip=wheel_slip(speed, rim, self._standstill),
            rim_speed=then,
            speed_std=speed.standard_deviation,
            rim_std=rim.standard_deviation,
        )

    def _travelled(self, reading: Reading, rim: float, speed: float) -> None:
        """Add up the ways of one instant of all wheels."""
        if self._stamp is not None and reading.stamp != self._stamp:
            if len(self._now) == len(self._noise):
                seconds = min((reading.stamp - self._stamp) / SECOND, _DIFFERENCE)
                rims, speeds = np.mean(list(self._now.values()), axis=0).tolist()
                self._rim = abs(rims)
                self._way += abs(rims) * seconds
                self._apart += math.copysign(1.0, rims) * (rims - speeds) * seconds
            self._now = {}
        self._stamp = reading.stamp
        self._now[reading.wheel.name] = rim, speed
        if self._way >= _STRETCH:
            self._stretches.append((self._way, self._apart, self._rim - self._begin))
            self._way, self._apart, self._begin = 0.0, 0.0, self._rim
            self._judge()

    def _judge(self) -> None:
        """Say of the newest stretches how late the odometry is, and whether it shows slip."""
        way, apart, gained = np.array(self._stretches).T
        # Least squares of slip and delay, the latter with its prior; the slip is taken out of both.
        changed = gained - way * float(way @ gained) / float(way @ way)
        known = float(changed @ changed) + (_PATCHES / _LATE_STD) ** 2
        late = float(changed @ apart) / known
        self.late = Quantity(min(max(late, 0.0), _LATEST), _PATCHES / math.sqrt(known))
        count = len(self._stretches)
        if count >= _FEWEST:
            mean, deviation = self._scatter()
            # How large the variance of normal numbers may be.
            largest = (count - 2) * deviation**2 / float(chi2.ppf(1.0 - _SURE, count - 2))
            self.shows_slip = largest > _OWN**2 or abs(mean) > _EXPLAINED

    def _scatter(self) -> tuple[float, float]:
        """Mean slip of the newest stretches, and how they scatter about it; the delay is taken out."""
        way, apart, gained = np.array(self._stretches).T
        columns = np.stack([np.ones(len(way)), gained / way], axis=1)
        found = np.linalg.lstsq(columns, apart / way)[0]
        left = apart / way - columns @ found
        return float(found[0]), math.sqrt(float(left @ left) / (len(way) - 2))


class _Noise:
    """Of the difference between rim and ground at one wheel."""

    def __init__(self) -> None:
        self._recent: deque[tuple[int, float, float]] = (
            deque()
        )  # stamp (ns), difference and rim (m/s)
        self._found: deque[float] = deque(maxlen=_MEMORY)  # sizes of second differences, m/s

    def add(
        self, reading: Reading, rim: float, speed: float, late: Quantity
    ) -> tuple[float, float]:
        """Take a reading; return the rim's speed as late as the odometry, and the deviation of both.

        In m/s.
        """
        recent, step = self._recent, int(_DIFFERENCE * SECOND)
        if reading.stands or (recent and reading.stamp - recent[-1][0] > step):
            recent.clear()
        stamps, rims = zip(*((one[0], one[2]) for one in recent), (reading.stamp, rim), strict=True)
        then = float(np.interp(reading.stamp - late.value * SECOND, stamps, rims))
        recent.append((reading.stamp, then - speed, rim))
        while reading.stamp - recent[0][0] > 2 * step + step // 2:
            recent.popleft()
        first = recent[0]
        if reading.stamp - first[0] >= 2 * step:
            middle = min(recent, key=lambda one: abs(2 * one[0] - first[0] - reading.stamp))
            self._found.append(abs(first[1] - 2.0 * middle[1] + then - speed))
        old = recent[max(len(recent) - 4, 0)]
        gaining = (rim - old[2]) / max((reading.stamp - old[0]) / SECOND, 0.1)
        deviation = reading.speed_std
        if len(self._found) >= _ENOUGH:
            deviation = median(self._found) / _NORMAL / math.sqrt(6.0)
        return then, math.hypot(deviation, late.standard_deviation * gaining)
