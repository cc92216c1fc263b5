# SPDX-License-Identifier: Apache-2.0
"""What a simulated drive is made from: a rover, the legs of its way, its ground and its sensors."""

from __future__ import annotations

from dataclasses import dataclass, replace

Range = tuple[float, float]  # a number is drawn between
GRAVITY = 9.80665


@dataclass(frozen=True)
class RoverWheel:
    """One wheel: size and place in base_link (x forward, y left), metres; steered: about its own middle."""

    name: str
    diameter: float
    width: float
    x: float
    y: float
    steered: bool = False


@dataclass(frozen=True)
class SimulatedRover:
    """Wheels on a rigid frame. Mass in kg; centre of gravity in m, its height above the ground."""

    wheels: tuple[RoverWheel, ...]
    mass: float = 24.0
    gravity_x: float = 0.02
    gravity_y: float = -0.01
    gravity_height: float = 0.33

    @property
    def steers(self) -> bool:
        """Whether any wheel is steered."""
        return any(wheel.steered for wheel in self.wheels)

    @property
    def pivot(self) -> float:
        """Where ahead (m) the line across is that moves along the heading alone, but for crab steering.

        That of the wheels that are not steered; without any it is that of base_link.
        """
        fixed = [wheel.x for wheel in self.wheels if not wheel.steered]
        return sum(fixed) / len(fixed) if self.steers and fixed else 0.0


def wheels_on_axles(*axles: tuple[float, float, float, float]) -> tuple[RoverWheel, ...]:
    """Wheels of axles from front to rear: place, half of the track, diameter and width, m."""
    names = ("front", "rear") if len(axles) == 2 else ("front", "middle", "rear")
    return tuple(
        RoverWheel(f"{name}_{side}", diameter, width, x, sign * half)
        for name, (x, half, diameter, width) in zip(names, axles, strict=True)
        for side, sign in (("left", 1.0), ("right", -1.0))
    )


# Those of `smallwheel simulate drive`. The larger rear wheels run beside the front wheels' ruts: what ruts do
# is not taken for wheel size.
_AXLE = (0.35, 0.28, 0.25, 0.10)
_SAME, _LARGER = (-0.35, 0.28, 0.25, 0.10), (-0.35, 0.42, 0.40, 0.12)
_SIX = (0.36, 0.27, 0.20, 0.10), (0.0, 0.31, 0.20, 0.10), (-0.36, 0.27, 0.20, 0.10)


def steered(wheels: tuple[RoverWheel, ...], *axles: str) -> tuple[RoverWheel, ...]:
    """The same wheels, those of some axles steered.

    Parameters
    ----------
    wheels
        Named AXLE_SIDE.
    *axles
        Axles whose wheels are steered.

    Returns
    -------
    tuple of RoverWheel
        In the same order.
    """
    return tuple(
        replace(wheel, steered=True) if wheel.name.split("_")[0] in axles else wheel
        for wheel in wheels
    )


# `six_steered`: as most rovers have it, four of six wheels are steered.
ROVERS = {
    "four": SimulatedRover(wheels_on_axles(_AXLE, _SAME)),
    "two_sizes": SimulatedRover(wheels_on_axles(_AXLE, _LARGER)),
    "six_steered": SimulatedRover(
        steered(wheels_on_axles(*_SIX), "front", "rear"), 22.0, 0.01, -0.01, 0.28
    ),
}


@dataclass(frozen=True)
class Leg:
    """Turn on the spot (rad), drive so far (m, backward below 0) along a bend (1/m), then stand (s).

    crab: rad to the left of its heading, in which a vehicle of which all wheels are steered drives.
    """

    metres: float = 0.0
    bend: float = 0.0
    turn: float = 0.0
    stand: float = 0.0
    crab: float = 0.0


@dataclass(frozen=True)
class Sensors:
    """What the vehicle measures, how often (Hz) and how well; SI units.

    sinkage, load, torque, pull: whether it is measured, the pull as often as the load; without loads they are
    the weight's. current: torque by a motor's current, which is 0 at standstill. noise_factor: on
    all noise. sinkage_told: share of the sinkage in its variance, besides the noise; the true one is 0.03.
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


@dataclass(frozen=True)
class World:
    """What the ground and the vehicle of a drive are like; lengths in m, speeds in m/s, angles in rad.

    legs: of the way. floor: all ground is hard. law: of `wheel_laws`. slope: deviation of the waves. swing:
    of the loads from one diagonal to the other, over its usual size. grip, own_grip, scatter: deviations of
    ln grip, of places and of what each wheel finds, and of ln k. drift: of ln k, after 5 m. digging: m of
    sinkage per m by which a rim gets ahead, drawn between. dragging: resistance that no law of sinkage gives,
    over load, drawn between. rut: factor on the sinkage of a wheel in a track, once. right: ln of a factor on
    k under the right wheels. skid: how much of a turn comes, where all turns are made by skidding.
    differential: whether the wheels of an axle share its torque. spare: share of the weight on a wheel that
    is not listed. sticks: whether it may get stuck. patience: s for which rims spin before the driver gives
    up.
    """

    name: str
    legs: tuple[Leg, ...] = ()
    speed: float = 0.3
    ramp: float = 0.6
    turning: float = 0.5
    floor: bool = False
    law: str = "rim"
    slope: float = 0.05
    swing: float = 1.0
    grip: float = 0.12
    own_grip: float = 0.05
    scatter: float = 0.06
    drift: float = 0.0
    digging: Range = (0.0, 0.0)
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
    sensors: Sensors = Sensors()
