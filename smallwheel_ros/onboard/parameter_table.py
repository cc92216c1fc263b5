# SPDX-License-Identifier: Apache-2.0
"""The one table of the node's parameters: name, default, unit, range, and what it means.

It makes the settings' defaults, the node's ROS descriptors, config/template.yaml, docs/parameters.md
and the validation. Defaults of estimator and cost map are those of their settings' classes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from smallwheel_ros.costmap.cost_map import CostSettings
from smallwheel_ros.estimator.settings import EstimatorSettings
from smallwheel_ros.onboard.parameter import WHEEL, Parameter, choice, number, text
from smallwheel_ros.onboard.wheel_on_soil import REFERENCE_SLIP
from smallwheel_ros.physics.conditions import PRESSED, ROLLING
from smallwheel_ros.physics.soil import SOILS

_ESTIMATOR, _COST = EstimatorSettings(), CostSettings()
_OF_SOIL = "Without it: that of soil.name."
_COST_BEFORE = "Not used any more: cost is the risk of getting stuck, see cost.required_margin."

_DESCRIPTIONS: dict[Parameter, str] = {
    Parameter("wheels", "string_array", None, required=True, at_start=True): (
        "Names of the wheels. Each has parameters of its own, see <wheel>."
    ),
    Parameter("autostart", "bool", True, at_start=True): (
        "Configure and activate at the start. False: leave it to a lifecycle manager."
    ),
    text("robot_description_topic", "robot_description", form="topic", at_start=True): (
        "Topic (std_msgs/String, latched) of the URDF, from which diameter, width, positions and"
        " joint_sign of the wheels come where they are not given (docs/node.md). Empty: from none."
    ),
    text("base_frame", "base_link", at_start=True): (
        "Link of the URDF that positions of wheels are measured from. Where the URDF has no"
        " base_link: its root link."
    ),
    Parameter("load_sign", "integer", 1, choices=(1, -1)): (
        "1: force.z (or effort) of a load is positive when the wheel presses on the soil (the soil"
        " pushes the wheel up). -1: negative."
    ),
    text("velocity_topic", "", form="topic"): (
        "Topic (geometry_msgs/TwistStamped) of a velocity over ground that the wheels do not"
        " measure: radar, optical flow, visual odometry. Empty: odom's is used."
    ),
    number("velocity_lateral_position", 0.0, "m", -10.0, 10.0): (
        "Place of the velocity sensor left of base_link: in a turn it is faster or slower."
        " Without it: by tf, if tf2_ros is installed."
    ),
    number("velocity_yaw", 0.0, "rad", -3.15, 3.15): (
        "Direction of the velocity sensor's x axis in base_link, positive to the left."
        " Without it: by tf, if tf2_ros is installed."
    ),
    number("maximum_speed", 10.0, "m/s", 0.01, 1000.0): (
        "A vehicle is not faster: messages that say so are refused and counted."
    ),
    number("vehicle.mass", None, "kg", 0.01, 1e5): (
        "Mass of the vehicle. With it the balance of its forces on a slope, and while it gains speed,"
        " tells the soil's strength; the loads are compared with it. Without it: not used."
    ),
    number("vehicle.gravity_height", None, "m", 0.01, 10.0): (
        "Height of the centre of gravity above ground: with load.source static, how a slope moves load"
        " from wheel to wheel. Without it: 1.2 times the mean diameter of the wheels."
    ),
    text("imu_topic", "", form="topic"): (
        "Topic (sensor_msgs/Imu) whose orientation (or, without one, acceleration with gravity) gives"
        " the slope for that balance. Empty: by the orientation of odom's pose."
    ),
    number("imu_yaw", 0.0, "rad", -3.15, 3.15): (
        "Direction of the imu's x axis in base_link, positive to the left; its z axis is upright."
    ),
    Parameter("odometry_from_wheels", "bool", False): (
        "Whether odom is made from the wheels. It then cannot show slip: without velocity_topic"
        " there is no slip, no thrust, no drawbar pull, and that is said."
    ),
    choice("load.source", "wrench", "joint_states", "static"): (
        "Where loads come from. wrench: each wheel's load_topic. joint_states: the effort of each"
        " wheel's load_joint. static: nobody measures them; load.mass is split over the wheels."
    ),
    number("load.mass", None, "kg", 0.01, 1e5): (
        "Mass of the vehicle; needed by load.source static, which splits it by load_share."
    ),
    number("load.static_std", 0.3, "1", 0.01, 1.0): (
        "Standard deviation of a static load as a share of it: uneven ground, turns. Slopes are worked out"
        " where they are measured (imu_topic, or odom with pitch)."
    ),
    number("load.per_effort", 1.0, "N", 1e-6, 1e6): (
        "Load per unit of effort with load.source joint_states: 1.0 where efforts are N."
    ),
    number("standstill_speed", 0.01, "m/s", 0.0, 1.0): (
        "At or below it vehicle and wheels count as standing: no slip, no travel."
    ),
    number("reference_slip", REFERENCE_SLIP, "1", 0.02, 0.9): (
        "Slip at which mobility margin and steepest slope are worked out, and so the cost map."
    ),
    number("mobility.rate", 10.0, "Hz", 0.0, 1000.0): (
        "So many estimates a second of each wheel's mobility at most, by stamps. 0: one for each measured"
        " sinkage. Soil, strength and warnings go by every measurement at any rate."
    ),
    text("model_file", "", form="path"): (
        "Model file (of fit, add or diagnose --apply): its soil in place of the library's, and its"
        " effects. Of several soils soil.name says which."
    ),
    text("effects_file", "", form="path", at_start=True): (
        "Python file with effects of your own that model_file names. It is run: only yours."
    ),
    text("soil.name", None): (
        "Soil that the estimate starts from, its strength included. Of the library"
        f" ({', '.join(SOILS)}), or of model_file."
    ),
    text("soil.file", "", form="path"): (
        "File that ~/save_soil writes, and that the estimate goes on from at the start where it is"
        " there. Empty: ~/save_soil has nowhere to write to."
    ),
    number("soil.k", None, "Pa/m^(n+m)", 1.0, 1e12): f"Modulus k of the start. {_OF_SOIL}",
    number("soil.n", None, "1", 0.04, 2.9): f"Exponent of sinkage of the start. {_OF_SOIL}",
    number("soil.m", None, "1", -2.9, 2.9): f"Exponent of diameter of the start. {_OF_SOIL}",
    number("soil.log_reference_pressure_std", 0.7, "1", 1e-3, 3.0): (
        "Standard deviation, at the start, of ln of the pressure at 10 mm sinkage under a wheel of"
        " 0.2 m: 0.7 is a factor of 2."
    ),
    number("soil.n_std", None, "1", 1e-3, 3.0): (
        "Standard deviation of n at the start. Without it: 0.3, less near the ends of n's range."
    ),
    number("soil.m_std", 0.4, "1", 1e-3, 3.0): "Standard deviation of m at the start.",
    number("soil.cohesion", None, "Pa", 0.0, 1e6): f"Cohesion c. {_OF_SOIL}",
    number("soil.cohesion_std", 400.0, "Pa", 0.0, 1e6): "Standard deviation of the cohesion.",
    number("soil.friction_angle", None, "rad", 0.0, 1.5): (
        f"Angle of internal friction. {_OF_SOIL}"
    ),
    number("soil.friction_angle_std", 0.05, "rad", 0.0, 1.5): ("Standard deviation of that angle."),
    number("soil.shear_displacement", None, "m", 1e-4, 1.0): (
        f"Shear deformation modulus kappa of Janosi and Hanamoto. {_OF_SOIL}"
    ),
    number("soil.shear_displacement_std", 0.005, "m", 0.0, 1.0): ("Standard deviation of kappa."),
    number("noise.sinkage", _ESTIMATOR.sinkage_std, "m", 1e-5, 1.0): (
        "Standard deviation of a measured sinkage whose message does not give its variance."
    ),
    number("noise.load", 0.5, "N", 0.0, 1e5): "Standard deviation of a measured load.",
    number("noise.load_relative", 0.02, "1", 0.0, 1.0): (
        "The same as a share of the load; both together count."
    ),
    number("noise.drawbar_pull", 0.6, "N", 1e-3, 1e5): (
        "Standard deviation of a measured drawbar pull."
    ),
    number("noise.speed", 0.01, "m/s", 0.0, 10.0): ("Standard deviation of odometry's speed."),
    number("noise.wheel_speed_relative", 0.01, "1", 0.0, 1.0): (
        "Standard deviation of a rim's speed as a share of it, effective radius included."
    ),
    number("timing.reorder_time", 0.2, "s", 0.0, 5.0): (
        "How long (by stamps) a sinkage waits for those of other wheels that belong before it."
        " 0: it waits for nothing, with least delay; results then depend on the order of arrival."
    ),
    number("timing.silent_after", 1.0, "s", 0.0, 60.0): (
        "A sinkage waits for load, odometry and wheel speed of its instant, unless their topic has"
        " been silent (by stamps) for so long."
    ),
    number("timing.maximum_gap", 0.2, "s", 1e-3, 10.0): (
        "Load, speed and odometry are interpolated or held over at most so long."
    ),
    number("timing.future_tolerance", 0.5, "s", 0.0, 3600.0): (
        "Messages stamped further ahead of the clock are refused."
    ),
    number("timing.maximum_age", 5.0, "s", 0.01, 1e9): (
        "Messages stamped further behind the clock are refused."
    ),
    number("timing.jump_tolerance", 1.0, "s", 0.01, 3600.0): (
        "Stamps (and clock) that go back by more reset the estimate; by less, a message is late."
    ),
    number("estimator.reference_sinkage", _ESTIMATOR.reference_sinkage, "m", 1e-4, 1.0): (
        "Sinkage at which ~/soil gives the reference pressure."
    ),
    number("estimator.reference_diameter", _ESTIMATOR.reference_diameter, "m", 1e-3, 10.0): (
        "Wheel diameter for which ~/soil gives reference pressure and effective modulus."
    ),
    number("estimator.process_noise", _ESTIMATOR.process_noise, "1/sqrt(m)", 0.0, 10.0): (
        "How fast the soil may change: growth of the standard deviation of ln pressure per square"
        " root of travel."
    ),
    number("estimator.soil_scatter", _ESTIMATOR.soil_scatter, "1", 1e-3, 3.0): (
        "Standard deviation of ln k from place to place of one soil, until it is learnt."
    ),
    number("estimator.scatter_length", _ESTIMATOR.scatter_length, "m", 1e-4, 1e3): (
        "Path after which a wheel stands on other soil: the readings on one stretch of this length"
        " become one measurement. For a pressed wheel, new depth."
    ),
    number("estimator.gate_probability", _ESTIMATOR.gate_probability, "1", 0.5, 0.999999): (
        "Share of good readings that pass for good ones; the others are counted as outliers."
    ),
    Parameter("estimator.surprises_to_reopen", "integer", 5, low=1, high=1000): (
        "Not used any more: a change of soil is judged on averages over several stretches of path."
    ),
    number("sinkage_zero_std", _ESTIMATOR.sinkage_zero_std, "m", 0.0, 1.0): (
        "What the zero of the sinkage sensors is good for. It limits how well n and the pressure can"
        " be known: set the zeros on firm ground, or with the wheels lifted, and say so here."
    ),
    number("pass_std", _ESTIMATOR.pass_std, "1", 0.0, 1.0): (
        "Standard deviation of ln sinkage per doubling of the wheels that have passed, for wheels"
        " whose track overlaps with that of a wheel ahead (lateral_position). 0: ruts change nothing."
    ),
    number("load_scale_std", _ESTIMATOR.load_scale_std, "1", 0.0, 1.0): (
        "Standard deviation of the scale of the load cells, all together."
    ),
    number("load_zero_std", _ESTIMATOR.load_zero_std, "1", 0.0, 1.0): (
        "Standard deviation of the zero of the load cells, as a share of a wheel's usual load."
    ),
    number("delay_std", _ESTIMATOR.delay_std, "s", 0.0, 1.0): (
        "Standard deviation of the time by which sinkage is shown behind the load."
    ),
    number("digging_in.slip", 0.5, "1", 0.31, 1.0): (
        "A wheel digs itself in where its slip is at least this, and all that follows holds."
    ),
    number("digging_in.sinkage_rise", 0.3, "1", 0.01, 10.0): (
        "Its sinkage is above that of ordinary driving (slip up to 0.3) by this share of it."
    ),
    number("digging_in.speed_drop", 0.3, "1", 0.01, 1.0): (
        "Its speed over ground is below that of ordinary driving by this share of it."
    ),
    number("digging_in.time", 1.0, "s", 0.0, 60.0): "All of it for so long.",
    number("cost.resolution", _COST.resolution, "m", 0.01, 10.0): "Side of a cell of ~/cost.",
    number("cost.size", _COST.size, "m", 1.0, 2000.0): (
        "Side of the window of crossed ground that goes along with the robot; what it leaves behind"
        " is forgotten. At most 4 million cells."
    ),
    number("cost.period", _COST.period, "s", 0.1, 3600.0): (
        "Shortest time between two grids; none is published while nothing has changed."
    ),
    text("cost.frame", ""): (
        "Frame of ~/cost. Empty: that of odom. Nothing is transformed: set it only where odom's"
        " poses are in this frame."
    ),
    choice("cost.slope", "measured", "level"): (
        "measured: cost is the risk on the slope that was measured at a place (imu_topic, or odom with"
        " pitch), the steepest way; where none is measured, and on terrain classes not crossed, on the level."
        " level: on level ground everywhere."
    ),
    number("cost.spread", None, "m", 0.0, 10.0): (
        "Each cell of ~/cost costs what the dearest within this distance does. Without it: from base_link"
        " to the outermost edge of the wheels, for planners that plan by base_link; 0.0 for planners that"
        " know the vehicle's footprint."
    ),
    choice("cost.unknown", "prior", "none"): (
        "What ground costs that nobody has crossed. prior: what was believed of any ground before"
        " driving. none: -1, nothing is said of it (docs/nav2.md)."
    ),
    number("cost.required_margin", _COST.rules.required_margin, "1", -1.0, 2.0): (
        "Mobility margin that the vehicle needs everywhere beyond that (see cost.slope): tangent of the"
        " slopes that it has to climb."
        " Cost is the risk, in per cent, that the ground does not give it (docs/nav2.md)."
    ),
    number("cost.easy_margin", 0.1, "1", 0.001, 10.0): _COST_BEFORE,
    number("cost.hard_margin", -0.1, "1", -10.0, 10.0): _COST_BEFORE,
    number("cost.confidence", 0.95, "1", 0.5, 0.9999): _COST_BEFORE,
    number("cost.class_scatter", _COST.rules.class_scatter, "1", 0.0, 10.0): (
        "Standard deviation of the margin between places of one terrain class, until enough of them"
        " have been crossed to tell."
    ),
    number("<wheel>.diameter", None, "m", 0.005, 5.0, required=True): (
        "Diameter of the wheel. Without it: twice the radius of its link's cylinder in the URDF."
    ),
    number("<wheel>.width", None, "m", 0.001, 5.0, required=True): (
        "Width of the wheel. Without it: the length of its link's cylinder in the URDF."
    ),
    choice("<wheel>.contact", ROLLING, PRESSED): (
        f"{ROLLING}, or {PRESSED} for a wheel that is pushed straight down (a test rig): soil"
        " carries it on both sides of its lowest point, and no odometry is needed."
    ),
    number("<wheel>.lateral_position", 0.0, "m", -10.0, 10.0): (
        "Place of the wheel left of base_link: in turns it travels slower or faster than that."
        " Without it: that in the URDF, if there is one."
    ),
    number("<wheel>.longitudinal_position", 0.0, "m", -10.0, 10.0): (
        "Place of the wheel ahead of base_link: which ground of the cost map it is on, which wheels come"
        " to another soil first, and which follow in a rut. Without it another soil is found only"
        " when all wheels are on it."
        " Without it: that in the URDF, if there is one."
    ),
    text("<wheel>.load_topic", "<wheel>/load", form="topic"): "Topic of the wheel's load.",
    text("<wheel>.drawbar_pull_topic", "", form="topic"): (
        "Topic (geometry_msgs/WrenchStamped) whose force.x is what a rolling wheel pulls the vehicle with,"
        " positive forward; it tells the soil's strength. It may be load_topic. Empty: nobody"
        " measures it."
    ),
    text("<wheel>.load_joint", "<wheel>_load_joint"): (
        "Joint whose effort is the load, with load.source joint_states."
    ),
    number("<wheel>.load_share", None, "1", 0.001, 1.0): (
        "Share of load.mass on this wheel, with load.source static. Without it: an equal share."
    ),
    text("<wheel>.sinkage_topic", "<wheel>/sinkage", form="topic"): (
        "Topic of the wheel's sinkage. Empty: nobody measures it, it is only predicted."
    ),
    choice("<wheel>.sinkage_source", "WheelSinkage", "Range"): (
        "Type of that topic: smallwheel_ros/WheelSinkage, or sensor_msgs/Range of a sensor that"
        " looks down at undisturbed soil beside the wheel: sinkage = range_height - range."
    ),
    number("<wheel>.range_height", None, "m", 0.0, 10.0): (
        "What the range sensor shows on hard ground: its height above the wheel's lowest point."
        " Needed by sinkage_source Range."
    ),
    text("<wheel>.joint", "<wheel>_joint"): "Name of its joint in joint_states and in the URDF.",
    Parameter("<wheel>.joint_sign", "integer", 1, choices=(1, -1)): (
        "-1: its joint turns backwards when the wheel drives forward (a mirrored axis)."
        " Without it: by the joint's axis in the URDF, if there is one."
    ),
    choice("<wheel>.torque_source", "none", "effort"): (
        "effort: the effort of the wheel's joint is the torque of its motor (N m), which tells its"
        " thrust. none: nobody measures it."
    ),
    number("<wheel>.gear_ratio", 1.0, "1", 1e-3, 1e4): (
        "Torque at the wheel over that effort, without losses: 1.0 where the effort is the wheel's."
    ),
    number("<wheel>.gear_efficiency", 1.0, "1", 0.01, 1.0): "Share of it that the gear leaves.",
    Parameter("<wheel>.load_sign", "integer", 0, choices=(0, 1, -1)): (
        "As load_sign, for this wheel's sensor; 0: as load_sign says."
    ),
}

PARAMETERS = {p.name: replace(p, description=words) for p, words in _DESCRIPTIONS.items()}
GENERAL = tuple(p for p in PARAMETERS.values() if WHEEL not in p.name)
PER_WHEEL = tuple(p for p in PARAMETERS.values() if WHEEL in p.name)


def parameters_for(wheels: Sequence[str]) -> tuple[Parameter, ...]:
    """Return all parameters of a vehicle with these wheels."""
    return GENERAL + tuple(p.for_wheel(wheel) for wheel in wheels for p in PER_WHEEL)
