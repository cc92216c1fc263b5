# SPDX-License-Identifier: Apache-2.0
"""Settings of the estimate on board: the parameters, and what follows from them.

`parameters.settings_from` makes them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.onboard.declared import DriveParameters, Parameters
from smallwheel_ros.onboard.prior import EstimatorSettings, SoilPrior, covariates_of
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

# Streams of the vehicle; those of wheels are `<wheel>/load` and so on.
ODOMETRY = "odom"
IMU = "imu"
VELOCITY = "velocity"
VelocitySource = Literal["odometry", "topic", "none"]
# m/s: at or below it vehicle and wheels stand, with no slip and no travel; one deviation of odometry's speed.
STANDSTILL_SPEED = 0.01
# m/s: a rim that drives is faster (encoders of one at rest show 0.02 at most). Slower rims give no slip of
# the vehicle, which is a ratio of two speeds.
SLOWEST_RIM = 0.05
# The body of a small vehicle is above its wheels.
_GRAVITY_HEIGHT = 1.2  # mean diameters


@dataclass(frozen=True)
class Steered:
    """Geometry of a steered wheel.

    Attributes
    ----------
    arm
        Distance of its middle to the left of the steering axis, when it points ahead, m; None if unknown.
    linkage
        For two wheels with one central angle, distance of their axle ahead of the line across the vehicle on
        which its turning centre lies, m; 0 if the wheel has a joint of its own.
    """

    arm: float | None = None
    linkage: float = 0.0


@dataclass(frozen=True)
class OnboardSettings(DriveParameters):
    """All settings that the pipeline needs before the first message; `settings_from` checks them.

    Attributes
    ----------
    wheels
        The vehicle's wheels; no two have the same name.
    prior, strength
        The soil's pressure-sinkage law, and its shear strength, before any measurement.
    estimator
        Settings of the soil's estimate about sensors and ground.
    without_sinkage
        Names of wheels whose sinkage is not measured; they get predictions at the times of loads.
    with_drawbar_pull
        Names of rolling wheels whose drawbar pull is measured.
    with_torque
        Names of rolling wheels whose torque is measured.
    with_imu
        Whether the slope comes from an imu; otherwise from the odometry's pose.
    effects
        Effects of the model other than pressure and sinkage, in their order.
    static_loads
        Loads (N) of wheels whose load is not measured, by name.
    steered
        Rolling wheels whose steering angle is measured, by name.
    velocity
        Source of the speed over ground for slip: `odometry`; `topic`, if there is a topic of velocities; or
        `none`, if the odometry is declared to be computed from the wheels.
    soil_told
        Whether the user has named the soil; if not, it may be any soil.
    strength_measured
        Whether the model file's strength was measured, so that it holds for this ground from the start.
    model_note
        Remarks on the model file, for the user: that the mean of several models is used, which its data
        cannot tell apart, and which wheels or gravity are beyond those measured; empty if there are none.
    """

    wheels: tuple[Wheel, ...]
    prior: SoilPrior
    strength: Strength
    estimator: EstimatorSettings = field(default_factory=EstimatorSettings)
    effects: tuple[Effect, ...] = ()
    without_sinkage: frozenset[str] = frozenset()
    with_drawbar_pull: frozenset[str] = frozenset()
    with_torque: frozenset[str] = frozenset()
    with_imu: bool = False
    static_loads: Mapping[str, Quantity] = field(default_factory=dict)
    steered: Mapping[str, Steered] = field(default_factory=dict)
    velocity: VelocitySource = "odometry"
    soil_told: bool = True
    strength_measured: bool = False
    model_note: str = ""

    @property
    def mass(self) -> float:
        """Mass of the vehicle, kg; 0: unknown, so that no force balance shows the strength."""
        return self.vehicle.mass or 0.0

    @property
    def gravity_height(self) -> float:
        """Height of the centre of gravity above ground for static loads, m."""
        rolling = [wheel.diameter for wheel in self.wheels if wheel.contact == ROLLING]
        mean = sum(rolling) / max(len(rolling), 1)
        return self.vehicle.gravity_height or _GRAVITY_HEIGHT * mean

    @cached_property
    def without_soil_sensors(self) -> bool:
        """Whether no wheel's sinkage is measured."""
        return len(self.without_sinkage) == len(self.wheels)

    @cached_property
    def law_unknown(self) -> bool:
        """Whether sinkage cannot be predicted: no wheel measures it, and the soil is not named."""
        return self.without_soil_sensors and not self.soil_told

    @property
    def unknown_positions(self) -> str:
        """Which rolling wheels share one place, and what that costs, in words; empty if none."""
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

    @cached_property
    def covariates(self) -> tuple[str, ...]:
        """Which of `slip` and `speed` effects read; a row without these has no predicted sinkage."""
        return covariates_of(self.effects)

    @cached_property
    def rolling(self) -> tuple[Wheel, ...]:
        """The wheels that roll."""
        return tuple(wheel for wheel in self.wheels if wheel.contact == ROLLING)

    @property
    def unsteered_place(self) -> float:
        """Mean position ahead of the base frame (m) of the wheels that are not steered; 0 without any."""
        fixed = [w.longitudinal_position for w in self.rolling if w.name not in self.steered]
        return sum(fixed) / len(fixed) if fixed else 0.0

    @property
    def mean_diameter(self) -> float:
        """Mean diameter of the wheels, m: the one for which the soil's reference pressure is estimated."""
        mean = sum(wheel.diameter for wheel in self.wheels) / len(self.wheels)
        return round(mean, 6)  # it is printed

    @property
    def streams(self) -> tuple[str, ...]:
        """Names of all streams that are used: `<wheel>/load`, `odom`, ..."""
        wheels, rolling = self.wheels, [w for w in self.wheels if w.contact == ROLLING]
        by_topic = rolling and self.velocity == "topic"
        return (
            *(f"{w.name}/load" for w in wheels if w.name not in self.static_loads),
            *(f"{w.name}/sinkage" for w in wheels if w.name not in self.without_sinkage),
            *(f"{w.name}/drawbar_pull" for w in wheels if w.name in self.with_drawbar_pull),
            *(f"{w.name}/wheel_speed" for w in rolling),
            *(f"{w.name}/steering" for w in rolling if w.name in self.steered),
            *((ODOMETRY,) if rolling else ()),
            *((VELOCITY,) if by_topic else ()),
            *(f"{w.name}/torque" for w in rolling if w.name in self.with_torque),
            *((IMU,) if rolling and self.with_imu else ()),
        )


@dataclass(frozen=True, kw_only=True)
class NodeSettings(Parameters):
    """The node's parameters, with the settings of the pipeline that follow from them.

    Attributes
    ----------
    onboard
        Settings of the pipeline.
    """

    onboard: OnboardSettings

    def frame_of(self, wheel: str) -> str:
        """Frame (frame_id) of the messages about a wheel, given the wheel's name."""
        return self.inputs[wheel].frame or wheel
