# SPDX-License-Identifier: Apache-2.0
"""What the estimate on board rests on besides the measurements: vehicle, soil, sensors, time.

A setting that is a parameter is described, with its unit and range, in `parameter_table`; it has
the parameter's name, in the class of its group or with _ for the point.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.costmap.cost_map import CostSettings
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior
from smallwheel_ros.onboard.parameter_table import PARAMETERS
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

# Streams of the vehicle; those of wheels are `<wheel>/load` and so on.
ODOMETRY = "odom"
IMU = "imu"
VELOCITY = "velocity"
VelocitySource = Literal["odometry", "topic", "none"]


class OnboardError(SmallwheelError):
    """A wheel that is not of this vehicle."""


def _default(name: str) -> Any:
    return PARAMETERS[name].default


@dataclass(frozen=True)
class DiggingInRules:
    """When a wheel is taken to dig itself in: all of `digging_in.*` at once."""

    slip: float = _default("digging_in.slip")
    sinkage_rise: float = _default("digging_in.sinkage_rise")
    speed_drop: float = _default("digging_in.speed_drop")
    time: float = _default("digging_in.time")


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of measurements whose messages do not carry them: `noise.*`."""

    load: float = _default("noise.load")
    load_relative: float = _default("noise.load_relative")
    drawbar_pull: float = _default("noise.drawbar_pull")
    speed: float = _default("noise.speed")
    wheel_speed_relative: float = _default("noise.wheel_speed_relative")


@dataclass(frozen=True)
class Timing:
    """What is expected of stamps, s: `timing.*`."""

    reorder_time: float = _default("timing.reorder_time")
    silent_after: float = _default("timing.silent_after")
    maximum_gap: float = _default("timing.maximum_gap")
    future_tolerance: float = _default("timing.future_tolerance")
    maximum_age: float = _default("timing.maximum_age")
    jump_tolerance: float = _default("timing.jump_tolerance")


@dataclass(frozen=True)
class OnboardSettings:
    """Everything that `Onboard` needs to know before the first message; `settings_from` checks it.

    Attributes
    ----------
    wheels
        The vehicle's wheels, with names of their own.
    prior, strength
        The soil's law before any measurement, and its shear strength.
    without_sinkage
        Names of wheels whose sinkage nobody measures; they get predictions at the times of loads.
    with_drawbar_pull
        Names of rolling wheels whose drawbar pull is measured.
    with_torque
        Names of rolling wheels whose torque is measured.
    with_imu
        Whether the slope comes from an imu; else from odometry's pose.
    effects
        Effects of the model beside pressure and sinkage, in their order.
    static_loads
        Loads (N) of wheels whose load nobody measures, by name.
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
    """

    wheels: tuple[Wheel, ...]
    prior: SoilPrior
    strength: Strength
    estimator: EstimatorSettings = field(default_factory=EstimatorSettings)
    noise: SensorNoise = field(default_factory=SensorNoise)
    timing: Timing = field(default_factory=Timing)
    digging_in: DiggingInRules = field(default_factory=DiggingInRules)
    effects: tuple[Effect, ...] = ()
    without_sinkage: frozenset[str] = frozenset()
    with_drawbar_pull: frozenset[str] = frozenset()
    with_torque: frozenset[str] = frozenset()
    with_imu: bool = False
    static_loads: Mapping[str, Quantity] = field(default_factory=dict)
    velocity: VelocitySource = "odometry"
    standstill_speed: float = _default("standstill_speed")
    reference_slip: float = _default("reference_slip")
    velocity_lateral_position: float = _default("velocity_lateral_position")
    maximum_speed: float = _default("maximum_speed")
    mass: float = 0.0
    gravity_height: float = 0.0
    mobility_rate: float = _default("mobility.rate")
    soil_told: bool = True

    @property
    def without_soil_sensors(self) -> bool:
        """Whether nobody measures the sinkage of any wheel."""
        return len(self.without_sinkage) == len(self.wheels)

    @property
    def law_unknown(self) -> bool:
        """Whether nobody will ever know how deep a wheel sinks into this soil."""
        return self.without_soil_sensors and not self.soil_told

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
    """Where a wheel's measurements come from: `<wheel>.*`; a topic is empty where there is none.

    load_sign: that of the wheel, or of all.
    """

    load_topic: str
    drawbar_pull_topic: str
    load_joint: str
    sinkage_topic: str
    sinkage_source: Literal["WheelSinkage", "Range"]
    range_height: float | None
    joint: str
    joint_sign: int
    gear_ratio: float
    gear_efficiency: float
    load_sign: int


@dataclass(frozen=True)
class NodeSettings:
    """What the parameters say: settings of the estimate and the cost map, and inputs by wheel."""

    onboard: OnboardSettings
    inputs: Mapping[str, WheelInputs]
    cost: CostSettings
    autostart: bool
    load_source: Literal["wrench", "joint_states", "static"]
    load_per_effort: float
    velocity_topic: str
    velocity_yaw: float
    imu_topic: str
    imu_yaw: float
    soil_file: str
    robot_description_topic: str
