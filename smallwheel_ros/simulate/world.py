# SPDX-License-Identifier: Apache-2.0
"""A world of drives is a row: vehicle, way, ground, sensors and their faults; a seed draws its numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

Range = tuple[float, float]  # a number is drawn between
GRAVITY = 9.80665
_SPOT = 0.5 * math.pi


@dataclass(frozen=True)
class RoverWheel:
    """One wheel: size and place in base_link (x forward, y left), metres."""

    name: str
    diameter: float
    width: float
    x: float
    y: float


@dataclass(frozen=True)
class SimulatedRover:
    """Wheels on a rigid frame. Mass in kg; centre of gravity in m, its height above the ground."""

    wheels: tuple[RoverWheel, ...]
    mass: float = 24.0
    gravity_x: float = 0.02
    gravity_y: float = -0.01
    gravity_height: float = 0.33


def _vehicle(
    mass: float, axles: tuple[tuple[float, float, float, float], ...], height: float, ahead: float = 0.0
) -> SimulatedRover:  # fmt: skip
    """Axles from front to rear: place, half of the track, diameter and width, m."""
    names = ("front", "rear") if len(axles) == 2 else ("front", "middle", "rear")
    wheels = tuple(
        RoverWheel(f"{name}_{side}", diameter, width, x, sign * half)
        for name, (x, half, diameter, width) in zip(names, axles, strict=True)
        for side, sign in (("left", 1.0), ("right", -1.0))
    )
    return SimulatedRover(wheels, mass, ahead, 0.0, height)


VEHICLES = {
    "four": _vehicle(23.6, ((0.35, 0.28, 0.25, 0.10), (-0.35, 0.28, 0.25, 0.10)), 0.30, 0.02),
    "two sizes": _vehicle(
        30.0, ((0.35, 0.28, 0.25, 0.10), (-0.35, 0.42, 0.40, 0.12)), 0.35, 0.02
    ),
    "two sizes, one track": _vehicle(
        30.0, ((0.35, 0.28, 0.25, 0.10), (-0.35, 0.28, 0.40, 0.12)), 0.35, 0.02
    ),
    "six": _vehicle(
        26.0, tuple((x, 0.30, 0.22, 0.09) for x in (0.45, 0.0, -0.45)), 0.28, 0.02
    ),
    "long": _vehicle(80.0, ((0.60, 0.35, 0.40, 0.15), (-0.50, 0.35, 0.40, 0.15)), 0.45, 0.05),
    "20 kg": _vehicle(20.0, tuple((x, 0.22, 0.20, 0.08) for x in (0.28, -0.28)), 0.22),
    "35 kg, six": _vehicle(35.0, tuple((x, 0.30, 0.22, 0.10) for x in (0.42, 0.0, -0.42)), 0.24),
    "80 kg": _vehicle(80.0, tuple((x, 0.35, 0.33, 0.13) for x in (0.45, -0.45)), 0.36),
    "200 kg": _vehicle(200.0, tuple((x, 0.50, 0.50, 0.20) for x in (0.65, -0.65)), 0.55),
    "300 kg, six": _vehicle(300.0, tuple((x, 0.55, 0.46, 0.20) for x in (0.80, 0.0, -0.80)), 0.51),
}  # fmt: skip

# Those of `smallwheel simulate drive`. The larger rear wheels run beside the front wheels' ruts: what ruts do
# is not taken for wheel size.
ROVERS = {
    name.replace(" ", "_"): SimulatedRover(VEHICLES[name].wheels) for name in ("four", "two sizes")
}


@dataclass(frozen=True)
class Leg:
    """Drive so far (m, backward below 0) along a bend (1/m), or turn on the spot (rad), then stand (s)."""

    metres: float = 0.0
    bend: float = 0.0
    turn: float = 0.0
    stand: float = 0.0


WAYS = {
    "plain": (Leg(20.0, stand=1.0),),
    "straight": (Leg(24.0, stand=1.0),),
    "half": (Leg(12.0, stand=1.0),),
    "short": (Leg(8.0, stand=1.0),),
    "bends": (Leg(6.0, 0.2), Leg(6.0, -0.3), Leg(6.0, 0.1), Leg(6.0, stand=1.0)),
    "stop and go": (Leg(1.5, stand=2.0),) * 14,
    "stops of 40 s": (Leg(4.0, stand=40.0),) * 4,
    "manoeuvres": (Leg(3.0), Leg(-1.5, 0.5, stand=1.0), Leg(2.5, -0.4), Leg(turn=_SPOT, stand=1.0)) * 3,
    "there and back": (Leg(8.0, stand=1.0), Leg(-8.0, stand=1.0), Leg(8.0)),
    "turned": (Leg(8.0), Leg(turn=math.pi), Leg(8.0, 0.05), Leg(turn=_SPOT), Leg(6.0)),
    "turning": (Leg(6.0), Leg(turn=2.0 * math.pi)) * 4,
    "on the spot": (
        Leg(3.0, stand=1.0), Leg(turn=_SPOT), Leg(3.0, stand=1.0), Leg(turn=-2.0 * _SPOT),
        Leg(3.0, stand=1.0), Leg(turn=4.0 * _SPOT, stand=1.0), Leg(3.0), Leg(turn=-_SPOT), Leg(3.0),
        Leg(turn=3.0 * _SPOT, stand=1.0), Leg(4.0), Leg(turn=-3.0 * _SPOT), Leg(3.0),
    ),
    "to and fro": (Leg(6.0, stand=1.0), Leg(-4.0, stand=1.0), Leg(8.0), Leg(-3.0, stand=1.0), Leg(6.0)),
}  # fmt: skip


@dataclass(frozen=True)
class Feature:
    """Something of the ground that begins at a place, a share of the way, over `edge` (m).

    what: `modulus` and `grip` (ln of a factor), `exponent` (added to n), `climb` (rad), `floor` (hard ground,
    size 1). length: m, after which it ends; None: it stays.
    """

    what: str
    size: Range
    start: Range = (0.5, 0.5)
    edge: Range = (0.02, 0.02)
    length: Range | None = None


@dataclass(frozen=True)
class Sensors:
    """What the vehicle measures, how often (Hz) and how well; SI units.

    sinkage, load, torque, pull: whether it is measured, the pull as often as the load; without loads they are
    the weight's. current: the torque is told by a motor's current, which is 0 at standstill. noise_factor: on
    all noise. sinkage_told: share of the sinkage in its variance, beside the noise; the true one is 0.03.
    load_scale: of each wheel. encoder_steps: in a turn of a wheel, one of them. odometry: `own` is made of
    pictures or echoes, `wheels` of the joints, `filter` of joints and imu, `half` a filter of wheels and
    pictures, `pose` tells places alone. lag, noise: s and m/s, of the odometry; alike: s over which its
    errors are alike, of `own`; told: deviation of its speed, as told, over the true one; pitch: whether its
    orientation has that. imu: `` none, `level` all right, `driven` shakes and has no orientation.
    """

    sinkage: bool = True
    load: bool = True
    torque: bool = False
    current: bool = False
    pull: bool = False
    noise_factor: float = 1.0
    sinkage_noise: float = 5e-4
    sinkage_told: float = 0.0
    sinkage_rate: float = 10.0
    zero: float = 0.0
    gain: float = 1.0
    zero_drift: float = 0.0
    rough: float = 0.0
    correlated: float = 0.0
    step: float = 0.0
    outliers: float = 0.0
    delay: float = 0.0
    rebound: float = 0.0
    pitch_error: float = 0.0
    load_rate: float = 20.0
    load_noise: float = 0.012
    load_scale: tuple[float, ...] = ()
    tare: float = 0.0
    torque_scale: float = 0.03
    friction: float = 0.05
    joint_rate: float = 20.0
    encoder_steps: tuple[int, ...] = (4_000, 8_000, 30_000)
    odometry: str = "own"
    odometry_rate: tuple[float, ...] = (20.0,)
    lag: Range = (0.0, 0.02)
    noise: Range = (0.008, 0.008)
    alike: Range = (0.0, 0.0)
    scale: float = 0.0
    told: float = 1.0
    pitch: bool = False
    imu: str = "level"
    imu_rate: float = 50.0


PLAIN = Sensors(
    sinkage=False, load=False, odometry_rate=(10.0, 15.0, 30.0), lag=(0.0, 0.06), noise=(0.005, 0.015),
    alike=(0.3, 0.3), scale=0.007,
)  # fmt: skip


@dataclass(frozen=True)
class World:
    """What is in a world; lengths in m, speeds in m/s, angles in rad.

    soil: `sand` is drawn about dry sand, as a prior has it; `any` so that the wheels sink by 2 to 7 % of
    their diameter; `loam`; `floor`. law: of `wheel_laws`. slope: deviation of the waves. swing: of the
    loads from one diagonal to the other, over its usual size. grip, own_grip, scatter: deviations of ln
    grip, of places and of what each wheel finds, and of ln k. drift: of ln k, after 5 m. digging: m of
    sinkage per m by which a rim gets ahead. rolling, residual: as in `RimStrength`. dragging: resistance
    that no law of sinkage gives, over load. rut: factor on the sinkage of a wheel in a track, once. right:
    ln of a factor on k under the right wheels. skid: how much of a turn comes, where all turns are made by
    skidding. differential: whether the wheels of an axle share its torque. spare: share of the weight on a
    wheel that is not listed. sticks: whether it may get stuck. patience: s for which rims spin before the
    driver gives up. priors: whether sensors, sides, ruts and digging are off by as much as the node's priors
    state, by the seed (`drawn`). told: parameters. faults: of the sensors, by name, put in by the code that
    drives it. said: pattern of what has to be reported; "": nothing may be.
    """

    name: str
    vehicle: str = "four"
    way: str | tuple[Leg, ...] = "plain"
    speed: float = 0.3
    ramp: float = 0.6
    turning: float = 0.5
    soil: str = "sand"
    law: str = "rim"
    features: tuple[Feature, ...] = ()
    firmness: float = 0.0
    exponent: float | None = None
    slope: float = 0.05
    swing: float = 1.0
    grip: float = 0.12
    own_grip: float = 0.05
    scatter: float = 0.06
    drift: float = 0.0
    digging: Range = (0.0, 0.0)
    rolling: Range = (1.0, 1.0)
    residual: float = 1.0
    dragging: Range = (0.0, 0.0)
    hardpan: float | None = None
    rut: float = 1.0
    right: float = 0.0
    bumps: float = 0.0
    skid: Range | None = None
    differential: bool = False
    spare: float = 0.0
    sticks: bool = False
    patience: float = 1.5
    priors: bool = False
    sensors: Sensors = Sensors()
    told: Mapping[str, Any] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    said: str = ""

    @property
    def legs(self) -> tuple[Leg, ...]:
        """Of the way; a name is one of `WAYS`."""
        return WAYS[self.way] if isinstance(self.way, str) else self.way

    def drawn(self, seed: int) -> World:
        """The world itself, or with `priors` what is off of sensors and soil, with the deviations of priors.

        Those of docs/estimator.md: of the sinkage sensors' zero 2 mm and of their scale 0.05, of all loads'
        scale 0.1 and of each wheel's half of that, of their zero 0.03 of a wheel's load, of the sides of a
        vehicle a factor of 1.8 in k, of the delay 0.1 s, of pitch 0.01 m/rad, of ruts 0.3 in ln of the
        sinkage. Slip digs, at one deviation, as deep as half of that of its prior: it cannot fill up.
        """
        if not self.priors:
            return self
        normal = np.random.default_rng([seed, *self.name.encode()]).standard_normal
        rover = VEHICLES[self.vehicle]
        count = len(rover.wheels)
        scales = np.exp(0.1 * normal() + 0.05 * normal(count))
        sensors = replace(
            self.sensors, zero=0.002 * normal(), load_scale=tuple(scales.tolist()),
            tare=0.03 * rover.mass * GRAVITY / count * normal(), delay=0.1 * abs(normal()),
            pitch_error=0.01 * normal(), torque_scale=0.1, friction=0.05,
        )  # fmt: skip
        digging = 0.05 * abs(normal())
        rut, right = math.exp(0.3 * normal()), math.log(1.8) * normal()
        sensors = replace(sensors, gain=math.exp(0.05 * normal()))
        return replace(
            self, sensors=sensors, rut=rut, right=right, digging=(digging, digging)
        )  # fmt: skip
