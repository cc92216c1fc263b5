# SPDX-License-Identifier: Apache-2.0
"""What the estimate on board rests on besides the measurements: vehicle, soil, sensors, time.

A field that is a parameter of the node is declared as one; `parameter_table` has all of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.parameter import Parameter
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior
from smallwheel_ros.onboard.wheel_on_soil import REFERENCE_SLIP
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

# Streams of the vehicle; those of wheels are `<wheel>/load` and so on.
ODOMETRY = "odom"
IMU = "imu"
VELOCITY = "velocity"
VelocitySource = Literal["odometry", "topic", "none"]


class OnboardError(SmallwheelError):
    """A wheel that is not of this vehicle."""


@dataclass(frozen=True)
class DiggingInRules:
    """When a wheel is taken to dig itself in: all of it at once."""

    slip: float = Parameter(0.5, "1", 0.31, 1.0).means(
        "A wheel digs itself in where its slip is at least this, and all that follows holds."
    )
    sinkage_rise: float = Parameter(0.3, "1", 0.01, 10.0).means(
        "Its sinkage is above that of ordinary driving (slip up to 0.3) by this share of it."
    )
    speed_drop: float = Parameter(0.3, "1", 0.01, 1.0).means(
        "Its speed over ground is below that of ordinary driving by this share of it."
    )
    time: float = Parameter(1.0, "s", 0.0, 60.0).means("All of it for so long.")


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of measurements whose messages do not carry them."""

    sinkage: float = Parameter(EstimatorSettings.sinkage_std, "m", 1e-5, 1.0).means(
        "Standard deviation of a measured sinkage whose message does not give its variance."
    )
    load: float = Parameter(0.5, "N", 0.0, 1e5).means("Standard deviation of a measured load.")
    load_relative: float = Parameter(0.02, "1", 0.0, 1.0).means(
        "The same as a share of the load; both together count."
    )
    drawbar_pull: float = Parameter(0.6, "N", 1e-3, 1e5).means(
        "Standard deviation of a measured drawbar pull."
    )
    speed: float = Parameter(0.01, "m/s", 0.0, 10.0).means(
        "Standard deviation of odometry's speed."
    )
    wheel_speed_relative: float = Parameter(0.01, "1", 0.0, 1.0).means(
        "Standard deviation of a rim's speed as a share of it, effective radius included."
    )


@dataclass(frozen=True)
class Timing:
    """What is expected of stamps."""

    reorder_time: float = Parameter(0.2, "s", 0.0, 5.0).means(
        "How long (by stamps) a sinkage waits for those of other wheels that belong before it."
        " 0: it waits for nothing, with least delay; results then depend on the order of arrival."
    )
    silent_after: float = Parameter(1.0, "s", 0.0, 60.0).means(
        "A sinkage waits for load, odometry and wheel speed of its instant, unless their topic has"
        " been silent (by stamps) for so long."
    )
    maximum_gap: float = Parameter(0.2, "s", 1e-3, 10.0).means(
        "Load, speed and odometry are interpolated or held over at most so long."
    )
    future_tolerance: float = Parameter(0.5, "s", 0.0, 3600.0).means(
        "Messages stamped further ahead of the clock are refused."
    )
    maximum_age: float = Parameter(5.0, "s", 0.01, 1e9).means(
        "Messages stamped further behind the clock are refused."
    )
    jump_tolerance: float = Parameter(1.0, "s", 0.01, 3600.0).means(
        "Stamps (and clock) that go back by more reset the estimate; by less, a message is late."
    )


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
    standstill_speed: float = 0.01
    reference_slip: float = REFERENCE_SLIP
    velocity_lateral_position: float = 0.0
    maximum_speed: float = 10.0
    mass: float = 0.0
    gravity_height: float = 0.0
    mobility_rate: float = 10.0
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
