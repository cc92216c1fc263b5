# SPDX-License-Identifier: Apache-2.0
"""What the estimate on board rests on besides the measurements: values of the parameters, by group.

`parameters.settings_from` makes them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from smallwheel_ros.costmap.cost import CostSettings
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.onboard.prior import EstimatorSettings, SoilPrior
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

# Streams of the vehicle; those of wheels are `<wheel>/load` and so on.
ODOMETRY = "odom"
IMU = "imu"
VELOCITY = "velocity"
VelocitySource = Literal["odometry", "topic", "none"]
LoadSource = Literal["wrench", "joint_states", "static"]
# m/s: at or below it vehicle and wheels stand, with no slip and no travel; one deviation of odometry's speed.
STANDSTILL_SPEED = 0.01
# The slip at which pulls are compared: what a driver accepts on a slope before turning back. With
# the 20 % at which wheels are often compared on a bench, small wheels hold hardly any slope.
REFERENCE_SLIP = 0.4


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of measurements: load (N), drawbar pull (N), speed of the odometry (m/s).

    Those of messages that state their own count in their place.
    """

    load: float = 0.5
    drawbar_pull: float = 0.6
    speed: float = 0.01


@dataclass(frozen=True)
class Timing:
    """What is expected of stamps, s.

    reorder_time: how long a sinkage waits for those of other wheels that belong before it. maximum_age:
    what is stamped further behind the clock is refused.
    """

    reorder_time: float = 0.2
    maximum_age: float = 5.0


@dataclass(frozen=True)
class TwistSettings:
    """How the twist of the rims is reported, s.

    rim_delay: by which wheel speeds are stamped later than the imu's readings of the same instant.
    correlation_time: how long errors of slip last.
    """

    rim_delay: float = 0.0
    correlation_time: float = 0.4


@dataclass(frozen=True)
class OnboardSettings:
    """Everything that the pipeline needs to know before the first message; `settings_from` checks it.

    Attributes
    ----------
    wheels
        The vehicle's wheels, with names of their own.
    prior, strength
        The soil's law before any measurement, and its shear strength.
    without_sinkage
        Names of wheels whose sinkage is not measured; they get predictions at the times of loads.
    with_drawbar_pull
        Names of rolling wheels whose drawbar pull is measured.
    with_torque
        Names of rolling wheels whose torque is measured.
    with_imu
        Whether the slope comes from an imu; else from odometry's pose.
    effects
        Effects of the model beside pressure and sinkage, in their order.
    static_loads
        Loads (N) of wheels whose load is not measured, by name.
    velocity
        Where the speed over ground comes from that slip is worked out with: odometry that the
        wheels do not measure, a topic of its own, or none, since the wheels make the odometry.
    mass
        kg, of the vehicle; 0: not known, and then no balance of its forces tells of the strength.
    gravity_height
        m, of the centre of gravity above ground, for static loads.
    mobility_rate
        Hz, estimates of each wheel at most; 0: one for each measured sinkage.
    soil_told
        Whether the user has said which soil it is; else it is any.
    twist
        How the twist of the rims is told; None: it is not.
    """

    wheels: tuple[Wheel, ...]
    prior: SoilPrior
    strength: Strength
    estimator: EstimatorSettings = field(default_factory=EstimatorSettings)
    noise: SensorNoise = field(default_factory=SensorNoise)
    timing: Timing = field(default_factory=Timing)
    effects: tuple[Effect, ...] = ()
    without_sinkage: frozenset[str] = frozenset()
    with_drawbar_pull: frozenset[str] = frozenset()
    with_torque: frozenset[str] = frozenset()
    with_imu: bool = False
    static_loads: Mapping[str, Quantity] = field(default_factory=dict)
    velocity: VelocitySource = "odometry"
    reference_slip: float = REFERENCE_SLIP
    mass: float = 0.0
    gravity_height: float = 0.0
    mobility_rate: float = 10.0
    soil_told: bool = True
    twist: TwistSettings | None = None

    @property
    def without_soil_sensors(self) -> bool:
        """Whether no wheel's sinkage is measured."""
        return len(self.without_sinkage) == len(self.wheels)

    @property
    def law_unknown(self) -> bool:
        """Whether how deep a wheel sinks into this soil will never be known."""
        return self.without_soil_sensors and not self.soil_told

    @property
    def unknown_positions(self) -> str:
        """Which rolling wheels have one place between them, and what that costs, in words; empty: none."""
        at: dict[tuple[float, float], list[str]] = {}
        for wheel in self.wheels:
            if wheel.contact == ROLLING:
                place = wheel.longitudinal_position, wheel.lateral_position
                at.setdefault(place, []).append(wheel.name)
        same = [", ".join(names) for names in at.values() if len(names) > 1]
        if not same:
            return ""
        return (
            f"positions of wheels are not known ({'; '.join(same)}: all at one place): the cost map has a"
            " strip as wide as one wheel, slip in turns is that of base_link, passes are not counted, and"
            " another soil is found only when all wheels are on it; give lateral_position and"
            " longitudinal_position of each wheel"
        )

    @property
    def mean_diameter(self) -> float:
        """Mean diameter of the wheels, m: what is known best of a soil is how it carries them."""
        mean = sum(wheel.diameter for wheel in self.wheels) / len(self.wheels)
        return round(mean, 6)  # it is printed

    @property
    def streams(self) -> tuple[str, ...]:
        """Names of everything that is listened to: `<wheel>/load`, `odom`, ..."""
        wheels, rolling = self.wheels, [w for w in self.wheels if w.contact == ROLLING]
        by_topic = rolling and self.velocity == "topic"
        return (
            *(f"{w.name}/load" for w in wheels if w.name not in self.static_loads),
            *(f"{w.name}/sinkage" for w in wheels if w.name not in self.without_sinkage),
            *(f"{w.name}/drawbar_pull" for w in wheels if w.name in self.with_drawbar_pull),
            *(f"{w.name}/wheel_speed" for w in rolling),
            *((ODOMETRY,) if rolling else ()),
            *((VELOCITY,) if by_topic else ()),
            *(f"{w.name}/torque" for w in rolling if w.name in self.with_torque),
            *((IMU,) if rolling and self.with_imu else ()),
        )


@dataclass(frozen=True)
class WheelInputs:
    """Where a wheel's measurements come from; a topic is empty where there is none.

    range_height: m; given, sinkage_topic is a range sensor that shows this on hard ground. torque_per_effort:
    0 where it is not measured.
    """

    load_topic: str
    load_joint: str
    load_sign: int
    sinkage_topic: str
    range_height: float | None
    drawbar_pull_topic: str
    joint: str
    joint_sign: int
    torque_per_effort: float


@dataclass(frozen=True, kw_only=True)
class NodeSettings:
    """What the parameters say: the estimate's settings, where each input comes from, and the cost map's."""

    onboard: OnboardSettings
    inputs: Mapping[str, WheelInputs]  # by wheel
    load_source: LoadSource
    load_per_effort: float
    velocity_topic: str
    imu_topic: str
    imu_yaw: float
    robot_description_topic: str
    base_frame: str
    soil_file: str
    cost: CostSettings
