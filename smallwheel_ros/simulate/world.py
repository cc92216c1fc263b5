# SPDX-License-Identifier: Apache-2.0
"""The specification of a simulated drive: a rover, the legs of its route, its ground and its sensors."""

from __future__ import annotations

from dataclasses import dataclass, replace

Range = tuple[float, float]  # a number is drawn evenly between the two
GRAVITY = 9.80665


@dataclass(frozen=True)
class RoverWheel:
    """One wheel of a rover.

    Attributes
    ----------
    name
        AXLE_SIDE, such as `front_left`.
    diameter, width
        m.
    x, y
        Place in base_link, forward and left, m.
    steered
        Whether it is steered, about an axis through its middle.
    """

    name: str
    diameter: float
    width: float
    x: float
    y: float
    steered: bool = False


@dataclass(frozen=True)
class SimulatedRover:
    """A rover: wheels on a rigid frame.

    Attributes
    ----------
    wheels
        The wheels.
    mass
        Mass of the whole rover, kg.
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
        """Distance (m) ahead of base_link of the axis about which it turns, which does not move sideways.

        It is the mean axis of the wheels that are not steered; base_link if all are, or none is.
        """
        fixed = [wheel.x for wheel in self.wheels if not wheel.steered]
        return sum(fixed) / len(fixed) if self.steers and fixed else 0.0


def wheels_on_axles(*axles: tuple[float, float, float, float]) -> tuple[RoverWheel, ...]:
    """Wheels of two or three axles, named `front_left`, `front_right`, `rear_left` and so on.

    axles: from front to rear; for each its place ahead of base_link, half of its track, and diameter and
    width of its wheels, m.
    """
    names = ("front", "rear") if len(axles) == 2 else ("front", "middle", "rear")
    return tuple(
        RoverWheel(f"{name}_{side}", diameter, width, x, sign * half)
        for name, (x, half, diameter, width) in zip(names, axles, strict=True)
        for side, sign in (("left", 1.0), ("right", -1.0))
    )


# Axles of the rovers of `smallwheel simulate drive`. The larger rear wheels run beside the front wheels'
# ruts, so that the influence of ruts is not confused with that of the diameter.
_AXLE = (0.35, 0.28, 0.25, 0.10)
_SAME, _LARGER = (-0.35, 0.28, 0.25, 0.10), (-0.35, 0.42, 0.40, 0.12)
_SIX = (0.36, 0.27, 0.20, 0.10), (0.0, 0.31, 0.20, 0.10), (-0.36, 0.27, 0.20, 0.10)


def steered(wheels: tuple[RoverWheel, ...], *axles: str) -> tuple[RoverWheel, ...]:
    """Return the wheels of a rover with those of some axles steered.

    Parameters
    ----------
    wheels
        The wheels, named AXLE_SIDE.
    *axles
        Names of the axles whose wheels are steered: `front`, `middle`, `rear`.

    Returns
    -------
    tuple of RoverWheel
        In the same order; wheels of other axles are unchanged.
    """
    return tuple(
        replace(wheel, steered=True) if wheel.name.split("_")[0] in axles else wheel
        for wheel in wheels
    )


# `six_steered`: four of six wheels are steered, as on most rovers.
ROVERS = {
    "four": SimulatedRover(wheels_on_axles(_AXLE, _SAME)),
    "two_sizes": SimulatedRover(wheels_on_axles(_AXLE, _LARGER)),
    "six_steered": SimulatedRover(
        steered(wheels_on_axles(*_SIX), "front", "rear"), 22.0, 0.01, -0.01, 0.28
    ),
}


@dataclass(frozen=True)
class Leg:
    """One leg of a route: turn on the spot, then drive along a bend, then stand.

    Attributes
    ----------
    metres
        Distance to drive, m; backward if negative.
    bend
        Curvature of the path, 1/m, positive to the left.
    turn
        Angle to turn on the spot before that, rad, positive to the left.
    stand
        Time to stand after it, s.
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
    """The sensors of a vehicle, and their errors; SI units, noise as standard deviations.

    Attributes
    ----------
    sinkage, load, torque, pull
        Whether each is measured; pull (drawbar pull) comes as often as load.
    current
        Whether torque comes from a motor's current, which has no sign and is 0 at standstill.
    noise_factor
        Factor on all noise.
    sinkage_noise
        Constant part of the noise of sinkage, m; another part is 0.03 of the sinkage.
    sinkage_told
        Part of the stated standard deviation of sinkage that is proportional to sinkage, as a fraction of it;
        the constant part is `sinkage_noise`.
    sinkage_rate, load_rate, joint_rate, imu_rate
        Readings per second, Hz; those of wheel speeds, steering and torque have `joint_rate`.
    zero, gain, zero_drift
        Errors of sinkage: its zero, m; a factor on it; drift of the zero over the whole drive, m.
    rough, correlated
        Errors of sinkage that are correlated over 0.05 m of travel (rough ground), and over 1 s, m.
    step
        Resolution of sinkage, m; 0 for none.
    outliers
        Share of the readings of sinkage that are gross errors.
    delay
        Delay of sinkage, s.
    rebound
        Rise of the soil before the sinkage is measured, per pressure under the wheel, m/Pa.
    pitch_error
        Error of sinkage per climb of the vehicle, m/rad; it is subtracted.
    load_noise
        Relative noise of load; another part is 0.4 N.
    load_scale
        Factor on the load that each wheel's cell shows; empty for 1.
    tare
        Error of the load cells' zero, N.
    torque_scale
        Standard deviation of the factor about 1 by which each wheel's measured torque is wrong.
    friction
        Friction that the torque of a turning wheel includes, N m.
    encoder_steps
        Steps of an encoder per turn of a wheel; one of these values is drawn.
    odometry
        `own` comes from camera or lidar, `wheels` from the joints, `filter` from joints and imu, `half`
        from a filter of wheels and camera; `pose` has positions only.
    odometry_rate
        Readings per second, Hz; one of these values is drawn.
    lag, noise
        Delay of the odometry, s, and noise of its speed, m/s; each is drawn between its two values.
    alike
        Time over which errors of `own` are correlated, s; 0 for independent errors. Only the first of the two
        is used.
    scale
        Standard deviation of the factor about 1 by which the speed of `own` is wrong.
    told
        Standard deviation that the odometry states for its speed, divided by the true one; 0: it states none.
    pitch
        Whether its orientation has the pitch.
    imu
        Empty for none; `level` without faults; `driven` shakes and has no orientation.
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
    """The route, the ground and the vehicle of a drive.

    Deviations are standard deviations; grip is a factor on the forces of shear.

    Attributes
    ----------
    name
        Name of the world.
    legs
        Legs of the route.
    speed, ramp
        Speed of the rims, m/s, and the largest rate at which it changes, m/s^2.
    turning
        Rate of turning on the spot, rad/s.
    floor
        Whether all ground is hard.
    law
        Name of the law of thrust and resistance, in `wheel_laws.LAWS`.
    slope
        Largest slope of each of two waves, 5 and 11 m long, eastward and northward, rad.
    swing
        Factor on the usual share of load, up to 0.24, that uneven ground shifts from the wheels of one
        diagonal to those of the other.
    grip, own_grip, scatter
        Deviations of ln grip from place to place, of ln grip of each track in addition, and of ln k.
    drift
        Deviation of the change of ln k over 5 m, by a random walk.
    digging
        Sinkage in metres for each metre by which a rim turns further than the wheel travels; drawn between
        the two values.
    dragging
        Resistance over load, dimensionless, in addition to that of the law; drawn between the two.
    hardpan
        Depth of a hard layer, m; None for none.
    rut
        Factor on the sinkage of a wheel that rolls in the rut of one other; it tends to its square with more.
    right
        ln of a factor on k under the right wheels.
    bumps
        Height of the highest stones, as a fraction of the first wheel's diameter.
    skid
        Share of a commanded turn that is reached, if the vehicle turns by skidding, drawn between the two;
        None if its turns are true, except on the spot.
    differential
        Whether the two wheels of an axle share its torque.
    spare
        Share of the weight on a wheel that is not listed.
    sticks
        Whether a drive on which the vehicle gets stuck is kept; else its ground is drawn anew (`rates`).
    patience
        Time for which rims spin before the driver gives up, s.
    sensors
        The sensors of the vehicle.
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
