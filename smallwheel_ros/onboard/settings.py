# SPDX-License-Identifier: Apache-2.0
"""What the estimate on board rests on besides the measurements, and the node's parameters, which make it.

A parameter is declared in the settings of its group, or in `Given` and `WheelInputs`, and nowhere else.
Declarations make the settings, the node's ROS descriptors, config/template.yaml, docs/parameters.md and
the validation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Literal

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.parameter import WHEEL, Parameter, parameters_of
from smallwheel_ros.costmap.cost_map import CostSettings
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior
from smallwheel_ros.physics.conditions import PRESSED, ROLLING
from smallwheel_ros.physics.soil import SOILS
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

# Streams of the vehicle; those of wheels are `<wheel>/load` and so on.
ODOMETRY = "odom"
IMU = "imu"
VELOCITY = "velocity"
VelocitySource = Literal["odometry", "topic", "none"]
# The slip at which pulls are compared: what a driver accepts on a slope before turning back. With
# the 20 % at which wheels are often compared on a bench, small wheels hold hardly any slope.
REFERENCE_SLIP = 0.4


class OnboardError(SmallwheelError):
    """A wheel that is not of this vehicle."""


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
class TwistSettings:
    """How the twist of the rims is told."""

    rim_delay: float = Parameter(0.0, "s", 0.0, 1.0).means(
        "How much later the wheel speeds are stamped than the imu's readings of the same instant."
    )
    correlation_time: float = Parameter(0.4, "s", 0.0, 10.0).means(
        "Errors of slip last, and a filter takes each message for a new one: variances sent are multiplied"
        " by twice this times the rate. 0: the variance of one reading."
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
    standstill_speed: float = 0.01
    reference_slip: float = REFERENCE_SLIP
    velocity_lateral_position: float = 0.0
    maximum_speed: float = 10.0
    mass: float = 0.0
    gravity_height: float = 0.0
    mobility_rate: float = 10.0
    soil_told: bool = True
    twist: TwistSettings | None = None

    @property
    def without_soil_sensors(self) -> bool:
        """Whether nobody measures the sinkage of any wheel."""
        return len(self.without_sinkage) == len(self.wheels)

    @property
    def law_unknown(self) -> bool:
        """Whether nobody will ever know how deep a wheel sinks into this soil."""
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


_OF_SOIL = "Without it: that of soil.name."


@dataclass(frozen=True)
class Start:
    """Law and strength of the soil that the estimate starts from; None: as the soil of that name has it."""

    k: float | None = Parameter(None, "Pa/m^(n+m)", 1.0, 1e12).means(
        f"Modulus k of the start. {_OF_SOIL}"
    )
    n: float | None = Parameter(None, "1", 0.04, 2.9).means(
        f"Exponent of sinkage of the start. {_OF_SOIL}"
    )
    m: float | None = Parameter(None, "1", -2.9, 2.9).means(
        f"Exponent of diameter of the start. {_OF_SOIL}"
    )
    log_reference_pressure_std: float = Parameter(0.7, "1", 1e-3, 3.0).means(
        "Standard deviation, at the start, of ln of the pressure at 10 mm sinkage under a wheel of"
        " 0.2 m: 0.7 is a factor of 2."
    )
    n_std: float | None = Parameter(None, "1", 1e-3, 3.0).means(
        "Standard deviation of n at the start. Without it: 0.3, less near the ends of n's range."
    )
    m_std: float = Parameter(0.4, "1", 1e-3, 3.0).means("Standard deviation of m at the start.")
    cohesion: float | None = Parameter(None, "Pa", 0.0, 1e6).means(f"Cohesion c. {_OF_SOIL}")
    cohesion_std: float = Parameter(400.0, "Pa", 0.0, 1e6).means(
        "Standard deviation of the cohesion."
    )
    friction_angle: float | None = Parameter(None, "rad", 0.0, 1.5).means(
        f"Angle of internal friction. {_OF_SOIL}"
    )
    friction_angle_std: float = Parameter(0.05, "rad", 0.0, 1.5).means(
        "Standard deviation of that angle."
    )
    shear_displacement: float | None = Parameter(None, "m", 1e-4, 1.0).means(
        f"Shear deformation modulus kappa of Janosi and Hanamoto. {_OF_SOIL}"
    )
    shear_displacement_std: float = Parameter(0.005, "m", 0.0, 1.0).means(
        "Standard deviation of kappa."
    )


@dataclass(frozen=True)
class Given:
    """Every parameter but those of wheels, with its value."""

    wheels: Sequence[str] = Parameter(required=True, at_start=True).means(
        "Names of the wheels. Each has parameters of its own, see <wheel>."
    )
    autostart: bool = Parameter(True, at_start=True).means(
        "Configure and activate at the start. False: leave it to a lifecycle manager."
    )
    robot_description_topic: str = Parameter(
        "robot_description", form="topic", at_start=True
    ).means(
        "Topic (std_msgs/String, latched) of the URDF, from which diameter, width, positions and"
        " joint_sign of the wheels come where they are not given (docs/node.md). Empty: from none."
    )
    base_frame: str = Parameter("base_link", at_start=True).means(
        "Link of the URDF that positions of wheels are measured from. Where the URDF has no"
        " base_link: its root link."
    )
    load_sign: Literal[1, -1] = Parameter(1).means(
        "1: force.z (or effort) of a load is positive when the wheel presses on the soil (the soil"
        " pushes the wheel up). -1: negative."
    )
    velocity_topic: str = Parameter("", form="topic").means(
        "Topic (geometry_msgs/TwistStamped) of a velocity over ground that the wheels do not"
        " measure: radar, optical flow, visual odometry. Empty: odom's is used."
    )
    velocity_lateral_position: float = Parameter(
        OnboardSettings.velocity_lateral_position, "m", -10.0, 10.0
    ).means("Place of the velocity sensor left of base_link: in a turn it is faster or slower.")
    velocity_yaw: float = Parameter(0.0, "rad", -3.15, 3.15).means(
        "Direction of the velocity sensor's x axis in base_link, positive to the left."
    )
    maximum_speed: float = Parameter(OnboardSettings.maximum_speed, "m/s", 0.01, 1000.0).means(
        "A vehicle is not faster: messages that say so are refused and counted."
    )
    vehicle_mass: float | None = Parameter(None, "kg", 0.01, 1e5, "vehicle.mass").means(
        "Mass of the vehicle. With it the balance of its forces on a slope, and while it gains speed,"
        " tells the soil's strength; the loads are compared with it. Without it: not used."
    )
    gravity_height: float | None = Parameter(None, "m", 0.01, 10.0, "vehicle.gravity_height").means(
        "Height of the centre of gravity above ground: with load.source static, how a slope moves load"
        " from wheel to wheel. Without it: 1.2 times the mean diameter of the wheels."
    )
    imu_topic: str = Parameter("", form="topic").means(
        "Topic (sensor_msgs/Imu) whose orientation (or, without one, acceleration with gravity) gives"
        " the slope for that balance. Empty: by the orientation of odom's pose."
    )
    imu_yaw: float = Parameter(0.0, "rad", -3.15, 3.15).means(
        "Direction of the imu's x axis in base_link, positive to the left; its z axis is upright."
    )
    odometry_from_wheels: bool = Parameter(False).means(
        "Whether odom is made from the wheels. It then cannot show slip: without velocity_topic"
        " there is no slip, no thrust, no drawbar pull, and that is said."
    )
    load_source: Literal["wrench", "joint_states", "static"] = Parameter(
        "wrench", name="load.source"
    ).means(
        "Where loads come from. wrench: each wheel's load_topic. joint_states: the effort of each"
        " wheel's load_joint. static: nobody measures them; load.mass is split over the wheels."
    )
    load_mass: float | None = Parameter(None, "kg", 0.01, 1e5, "load.mass").means(
        "Mass of the vehicle; needed by load.source static, which splits it by load_share."
    )
    static_std: float = Parameter(0.3, "1", 0.01, 1.0, "load.static_std").means(
        "Standard deviation of a static load as a share of it: uneven ground, turns. Slopes are worked out"
        " where they are measured (imu_topic, or odom with pitch)."
    )
    load_per_effort: float = Parameter(1.0, "N", 1e-6, 1e6, "load.per_effort").means(
        "Load per unit of effort with load.source joint_states: 1.0 where efforts are N."
    )
    standstill_speed: float = Parameter(OnboardSettings.standstill_speed, "m/s", 0.0, 1.0).means(
        "At or below it vehicle and wheels count as standing: no slip, no travel."
    )
    reference_slip: float = Parameter(OnboardSettings.reference_slip, "1", 0.02, 0.9).means(
        "Slip at which mobility margin and steepest slope are worked out, and so the cost map."
    )
    mobility_rate: float = Parameter(
        OnboardSettings.mobility_rate, "Hz", 0.0, 1000.0, "mobility.rate"
    ).means(
        "So many estimates a second of each wheel's mobility at most, by stamps. 0: one for each measured"
        " sinkage. Soil, strength and warnings go by every measurement at any rate."
    )
    model_file: str = Parameter("", form="path").means(
        "Model file (of fit, add or diagnose --apply): its soil in place of the library's, and its"
        " effects. Of several soils soil.name says which."
    )
    effects_file: str = Parameter("", form="path", at_start=True).means(
        "Python file with effects of your own that model_file names. It is run: only yours."
    )
    soil_name: str | None = Parameter(name="soil.name").means(
        "Soil that the estimate starts from, its strength included. Of the library"
        f" ({', '.join(SOILS)}), or of model_file."
    )
    soil_file: str = Parameter("", name="soil.file", form="path").means(
        "File that ~/save_soil writes, and that the estimate goes on from at the start where it is"
        " there. Empty: ~/save_soil has nowhere to write to."
    )
    twist_publish: bool = Parameter(False, name="twist.publish").means(
        "Whether ~/twist is sent: the twist of the rims with a covariance that grows with slip, for"
        " robot_localization and others (docs/odometry.md). It needs imu_topic and lateral_position of the"
        " wheels."
    )
    twist: TwistSettings = field(default_factory=TwistSettings)
    soil: Start = field(default_factory=Start)
    noise: SensorNoise = field(default_factory=SensorNoise)
    timing: Timing = field(default_factory=Timing)
    estimator: EstimatorSettings = field(default_factory=EstimatorSettings)
    cost: CostSettings = field(default_factory=CostSettings)


@dataclass(frozen=True)
class WheelInputs:
    """A wheel, and where its measurements come from: `<wheel>.*`; a topic is empty where there is none.

    load_sign: that of the wheel, or of all.
    """

    diameter: float = Parameter(None, "m", 0.005, 5.0, required=True).means(
        "Diameter of the wheel. Without it: twice the radius of its link's cylinder in the URDF."
    )
    width: float = Parameter(None, "m", 0.001, 5.0, required=True).means(
        "Width of the wheel. Without it: the length of its link's cylinder in the URDF."
    )
    contact: Literal["rolling", "pressed"] = Parameter(ROLLING).means(
        f"{ROLLING}, or {PRESSED} for a wheel that is pushed straight down (a test rig): soil"
        " carries it on both sides of its lowest point, and no odometry is needed."
    )
    lateral_position: float = Parameter(0.0, "m", -10.0, 10.0).means(
        "Place of the wheel left of base_link: in turns it travels slower or faster than that."
        " Without it: that in the URDF, if there is one."
    )
    longitudinal_position: float = Parameter(0.0, "m", -10.0, 10.0).means(
        "Place of the wheel ahead of base_link: which ground of the cost map it is on, which wheels come"
        " to another soil first, and which follow in a rut. Without it another soil is found only"
        " when all wheels are on it."
        " Without it: that in the URDF, if there is one."
    )
    load_topic: str = Parameter(f"{WHEEL}/load", form="topic").means("Topic of the wheel's load.")
    drawbar_pull_topic: str = Parameter("", form="topic").means(
        "Topic (geometry_msgs/WrenchStamped) whose force.x is what a rolling wheel pulls the vehicle with,"
        " positive forward; it tells the soil's strength. It may be load_topic. Empty: nobody"
        " measures it."
    )
    load_joint: str = Parameter(f"{WHEEL}_load_joint").means(
        "Joint whose effort is the load, with load.source joint_states."
    )
    load_share: float | None = Parameter(None, "1", 0.001, 1.0).means(
        "Share of load.mass on this wheel, with load.source static. Without it: an equal share."
    )
    sinkage_topic: str = Parameter(f"{WHEEL}/sinkage", form="topic").means(
        "Topic of the wheel's sinkage. Empty: nobody measures it, it is only predicted."
    )
    sinkage_source: Literal["WheelSinkage", "Range"] = Parameter("WheelSinkage").means(
        "Type of that topic: smallwheel_ros/WheelSinkage, or sensor_msgs/Range of a sensor that"
        " looks down at undisturbed soil beside the wheel: sinkage = range_height - range."
    )
    range_height: float | None = Parameter(None, "m", 0.0, 10.0).means(
        "What the range sensor shows on hard ground: its height above the wheel's lowest point."
        " Needed by sinkage_source Range."
    )
    joint: str = Parameter(f"{WHEEL}_joint").means(
        "Name of its joint in joint_states and in the URDF."
    )
    joint_sign: Literal[1, -1] = Parameter(1).means(
        "-1: its joint turns backwards when the wheel drives forward (a mirrored axis)."
        " Without it: by the joint's axis in the URDF, if there is one."
    )
    torque_source: Literal["none", "effort"] = Parameter("none").means(
        "effort: the effort of the wheel's joint is the torque of its motor (N m), which tells its"
        " thrust. none: nobody measures it."
    )
    gear_ratio: float = Parameter(1.0, "1", 1e-3, 1e4).means(
        "Torque at the wheel over that effort, without losses: 1.0 where the effort is the wheel's."
    )
    gear_efficiency: float = Parameter(1.0, "1", 0.01, 1.0).means(
        "Share of it that the gear leaves."
    )
    load_sign: Literal[0, 1, -1] = Parameter(0).means(
        "As load_sign, for this wheel's sensor; 0: as load_sign says."
    )


@dataclass(frozen=True, kw_only=True)
class NodeSettings(Given):
    """What the parameters say, with what follows from them: the estimate's settings, inputs by wheel."""

    onboard: OnboardSettings
    inputs: Mapping[str, WheelInputs]


_DIGGING_BEFORE = "Not used any more: wheels dig in while the warning's second level is exceeded."
_COST_BEFORE = "Not used any more: cost is the risk of getting stuck, see cost.required_margin."


@dataclass(frozen=True)
class NotUsed:
    """Parameters of earlier releases, which files may still have: judged, and no more."""

    surprises_to_reopen: int = Parameter(5, "", 1, 1000, "estimator.surprises_to_reopen").means(
        "Not used any more: a change of soil is judged on averages over several stretches of path."
    )
    slip: float = Parameter(0.5, "1", 0.31, 1.0, "digging_in.slip").means(_DIGGING_BEFORE)
    sinkage_rise: float = Parameter(0.3, "1", 0.01, 10.0, "digging_in.sinkage_rise").means(
        _DIGGING_BEFORE
    )
    speed_drop: float = Parameter(0.3, "1", 0.01, 1.0, "digging_in.speed_drop").means(
        _DIGGING_BEFORE
    )
    time: float = Parameter(1.0, "s", 0.0, 60.0, "digging_in.time").means(_DIGGING_BEFORE)
    easy_margin: float = Parameter(0.1, "1", 0.001, 10.0, "cost.easy_margin").means(_COST_BEFORE)
    hard_margin: float = Parameter(-0.1, "1", -10.0, 10.0, "cost.hard_margin").means(_COST_BEFORE)
    confidence: float = Parameter(0.95, "1", 0.5, 0.9999, "cost.confidence").means(_COST_BEFORE)


_groups: dict[str, list[Parameter]] = {}
for _parameter in (*parameters_of(Given), *parameters_of(NotUsed)):
    _groups.setdefault(_parameter.name.split(".")[0], []).append(_parameter)
GENERAL = tuple(chain.from_iterable(_groups.values()))
PER_WHEEL = tuple(parameters_of(WheelInputs, f"{WHEEL}."))
PARAMETERS = {parameter.name: parameter for parameter in GENERAL + PER_WHEEL}


def parameters_for(wheels: Sequence[str]) -> tuple[Parameter, ...]:
    """Return all parameters of a vehicle with these wheels."""
    return GENERAL + tuple(p.for_wheel(wheel) for wheel in wheels for p in PER_WHEEL)
