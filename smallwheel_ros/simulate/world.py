# SPDX-License-Identifier: Apache-2.0
"""The specification of a simulated drive: a rover, the legs of its route, its ground and its sensors."""

from __future__ import annotations

from dataclasses import dataclass, replace

Range = tuple[float, float]  # a number is drawn between
GRAVITY = 9.80665


@dataclass(frozen=True)
class RoverWheel:
    """One wheel: size and place in base_link (x forward, y left), m; a steered one turns about its middle."""

    name: str
    diameter: float
    width: float
    x: float
    y: float
    steered: bool = False


@dataclass(frozen=True)
class SimulatedRover:
    """Wheels on a rigid frame.

    Attributes
    ----------
    mass
        kg.
    gravity_x, gravity_y
        Centre of gravity in base_link, m.
    gravity_height
        Its height above the ground, m.
    """

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
        """Distance (m) ahead of base_link of the line that cannot move sideways, except when crabbing.

        It is the line of the wheels that are not steered; without any it is at base_link.
        """
        fixed = [wheel.x for wheel in self.wheels if not wheel.steered]
        return sum(fixed) / len(fixed) if self.steers and fixed else 0.0


def wheels_on_axles(*axles: tuple[float, float, float, float]) -> tuple[RoverWheel, ...]:
    """Wheels of axles from front to rear, each given by place, half of the track, diameter and width, m."""
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
    """The wheels with those of some axles steered.

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
    """One leg of a route: turn on the spot, drive along a bend, stand.

    Attributes
    ----------
    metres
        Distance to drive, m; backward if negative.
    bend
        Curvature of the path, 1/m.
    turn
        Angle to turn on the spot before that, rad.
    stand
        Time to stand, s.
    crab
        Angle of the course to the left of the heading, rad, for a vehicle all of whose wheels are steered.
    """

    metres: float = 0.0
    bend: float = 0.0
    turn: float = 0.0
    stand: float = 0.0
    crab: float = 0.0


@dataclass(frozen=True)
class Sensors:
    """What the vehicle measures, how often (Hz) and how well; SI units.

    Attributes
    ----------
    sinkage, load, torque, pull
        Whether it is measured; pull comes as often as load. Without measured loads, the weight is split
        over the wheels.
    current
        Whether torque comes from a motor's current, which is 0 at standstill.
    noise_factor
        Factor on all noise.
    sinkage_told
        Part of the stated deviation that is proportional to the sinkage, 1, in addition to the noise; the
        true one is 0.03.
    load_scale
        Factor by which each wheel's cell shows its load; empty: 1.
    encoder_steps
        Steps in a turn of a wheel.
    odometry
        `own` comes from camera or lidar, `wheels` from the joints, `filter` from joints and imu, `half`
        from a filter of wheels and camera; `pose` has positions only.
    lag, noise
        Delay of the odometry, s, and noise of its speed, m/s.
    alike
        Time over which errors of `own` are correlated, s.
    told
        Stated deviation of its speed over the true one.
    pitch
        Whether its orientation has the pitch.
    imu
        `` none; `level` without faults; `driven` shakes and has no orientation.
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
    """The ground and the vehicle of a drive; lengths in m, speeds in m/s, angles in rad.

    Attributes
    ----------
    legs
        Legs of the route.
    floor
        Whether all ground is hard.
    law
        Name of the law of `wheel_laws`.
    slope
        Standard deviation of the slope of the ground's waves, 1.
    swing
        How much load uneven ground shifts from one diagonal to the other, over the usual amount, 1.
    grip, own_grip, scatter
        Deviations of ln grip from place to place, of ln grip under each wheel, and of ln k.
    drift
        Standard deviation of the change of ln k over 5 m, by a random walk.
    digging
        Sinkage for each metre by which a rim turns further than the wheel travels, 1, drawn between the
        two.
    dragging
        Resistance over load that is in no law of sinkage, drawn between the two.
    rut
        Factor on the sinkage of a wheel in a track, once.
    right
        ln of a factor on k under the right wheels.
    skid
        Share of a commanded turn that is reached, if the vehicle turns by skidding.
    differential
        Whether the wheels of an axle share its torque.
    spare
        Share of the weight on a wheel that is not listed.
    sticks
        Whether the vehicle may get stuck.
    patience
        Time for which rims spin before the driver gives up, s.
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
