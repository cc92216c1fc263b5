"""The one table of the node's parameters: names, defaults, units, ranges, descriptions.

It makes the node's ROS descriptors, config/template.yaml, docs/parameters.md and the validation.
The defaults of estimator, noise and timing are those of their classes.
"""

from __future__ import annotations

from smallwheel_ros.estimator.settings import EstimatorSettings
from smallwheel_ros.onboard.force_gradients import REFERENCE_SLIP
from smallwheel_ros.onboard.parameter import Parameter, double
from smallwheel_ros.onboard.parameter_table_inputs import INPUTS, PER_WHEEL
from smallwheel_ros.onboard.parameter_table_outputs import COST, DIGGING_IN
from smallwheel_ros.onboard.settings import SensorNoise, Timing
from smallwheel_ros.physics.soil import SOILS

_TIMING, _NOISE, _ESTIMATOR = Timing(), SensorNoise(), EstimatorSettings()
__all__ = ["GENERAL", "PER_WHEEL"]

_OF_SOIL = "Without it: that of soil.name."

GENERAL: tuple[Parameter, ...] = (
    Parameter(
        "wheels",
        "string_array",
        None,
        "",
        "Names of the wheels. Each has parameters of its own, see <wheel>.",
        required=True,
        read_only=True,
    ),
    Parameter(
        "autostart",
        "bool",
        True,
        "",
        "Configure and activate at the start. False: leave it to a lifecycle manager.",
        read_only=True,
    ),
    *INPUTS,
    double(
        "standstill_speed",
        0.01,
        "m/s",
        0.0,
        1.0,
        "At or below it vehicle and wheels count as standing: no slip, no travel.",
    ),
    double(
        "reference_slip",
        REFERENCE_SLIP,
        "1",
        0.02,
        0.9,
        "Slip at which mobility margin and steepest slope are worked out, and so the cost map.",
    ),
    Parameter(
        "model_file",
        "string",
        "",
        "",
        "Model file (of fit, add or diagnose --apply): its soil in place of the library's, and its"
        " effects. Of several soils soil.name says which.",
    ),
    Parameter(
        "effects_file",
        "string",
        "",
        "",
        "Python file with effects of your own that model_file names. It is run: only yours.",
    ),
    Parameter(
        "soil.name",
        "string",
        None,
        "",
        "Soil that the estimate starts from, its strength included. Of the library"
        f" ({', '.join(SOILS)}), or of model_file.",
    ),
    Parameter(
        "soil.file",
        "string",
        "",
        "",
        "File that ~/save_soil writes, and that the estimate goes on from at the start where it is"
        " there. Empty: ~/save_soil has nowhere to write to.",
    ),
    double("soil.k", None, "Pa/m^(n+m)", 1.0, 1e12, f"Modulus k of the start. {_OF_SOIL}"),
    double("soil.n", None, "1", 0.04, 2.9, f"Exponent of sinkage of the start. {_OF_SOIL}"),
    double("soil.m", None, "1", -2.9, 2.9, f"Exponent of diameter of the start. {_OF_SOIL}"),
    double(
        "soil.log_reference_pressure_std",
        0.7,
        "1",
        1e-3,
        3.0,
        "Standard deviation, at the start, of ln of the pressure at 10 mm sinkage under a wheel of"
        " 0.2 m: 0.7 is a factor of 2.",
    ),
    double(
        "soil.n_std",
        None,
        "1",
        1e-3,
        3.0,
        "Standard deviation of n at the start. Without it: 0.3, less near the ends of n's range.",
    ),
    double("soil.m_std", 0.4, "1", 1e-3, 3.0, "Standard deviation of m at the start."),
    double("soil.cohesion", None, "Pa", 0.0, 1e6, f"Cohesion c. {_OF_SOIL}"),
    double("soil.cohesion_std", 400.0, "Pa", 0.0, 1e6, "Standard deviation of the cohesion."),
    double("soil.friction_angle", None, "rad", 0.0, 1.5, f"Angle of internal friction. {_OF_SOIL}"),
    double("soil.friction_angle_std", 0.05, "rad", 0.0, 1.5, "Standard deviation of that angle."),
    double(
        "soil.shear_displacement",
        None,
        "m",
        1e-4,
        1.0,
        f"Shear deformation modulus kappa of Janosi and Hanamoto. {_OF_SOIL}",
    ),
    double("soil.shear_displacement_std", 0.005, "m", 0.0, 1.0, "Standard deviation of kappa."),
    double(
        "noise.sinkage",
        _ESTIMATOR.sinkage_std,
        "m",
        1e-5,
        1.0,
        "Standard deviation of a measured sinkage whose message does not give its variance.",
    ),
    double("noise.load", _NOISE.load, "N", 0.0, 1e5, "Standard deviation of a measured load."),
    double(
        "noise.load_relative",
        _NOISE.load_relative,
        "1",
        0.0,
        1.0,
        "The same as a share of the load; both together count.",
    ),
    double(
        "noise.drawbar_pull",
        _NOISE.drawbar_pull,
        "N",
        1e-3,
        1e5,
        "Standard deviation of a measured drawbar pull.",
    ),
    double(
        "noise.speed", _NOISE.speed, "m/s", 0.0, 10.0, "Standard deviation of odometry's speed."
    ),
    double(
        "noise.wheel_speed_relative",
        _NOISE.wheel_speed_relative,
        "1",
        0.0,
        1.0,
        "Standard deviation of a rim's speed as a share of it, effective radius included.",
    ),
    double(
        "timing.reorder_time",
        _TIMING.reorder_time,
        "s",
        0.0,
        5.0,
        "How long (by stamps) a sinkage waits for those of other wheels that belong before it."
        " 0: it waits for nothing, with least delay; results then depend on the order of arrival.",
    ),
    double(
        "timing.silent_after",
        _TIMING.silent_after,
        "s",
        0.0,
        60.0,
        "A sinkage waits for load, odometry and wheel speed of its instant, unless their topic has"
        " been silent (by stamps) for so long.",
    ),
    double(
        "timing.maximum_gap",
        _TIMING.maximum_gap,
        "s",
        1e-3,
        10.0,
        "Load, speed and odometry are interpolated or held over at most so long.",
    ),
    double(
        "timing.future_tolerance",
        _TIMING.future_tolerance,
        "s",
        0.0,
        3600.0,
        "Messages stamped further ahead of the clock are refused.",
    ),
    double(
        "timing.maximum_age",
        _TIMING.maximum_age,
        "s",
        0.01,
        1e9,
        "Messages stamped further behind the clock are refused.",
    ),
    double(
        "timing.jump_tolerance",
        _TIMING.jump_tolerance,
        "s",
        0.01,
        3600.0,
        "Stamps (and clock) that go back by more reset the estimate; by less, a message is late.",
    ),
    double(
        "estimator.reference_sinkage",
        _ESTIMATOR.reference_sinkage,
        "m",
        1e-4,
        1.0,
        "Sinkage at which ~/soil gives the reference pressure.",
    ),
    double(
        "estimator.reference_diameter",
        _ESTIMATOR.reference_diameter,
        "m",
        1e-3,
        10.0,
        "Wheel diameter for which ~/soil gives reference pressure and effective modulus.",
    ),
    double(
        "estimator.process_noise",
        _ESTIMATOR.process_noise,
        "1/sqrt(m)",
        0.0,
        10.0,
        "How fast the soil may change: growth of the standard deviation of ln pressure per square"
        " root of travel.",
    ),
    double(
        "estimator.soil_scatter",
        _ESTIMATOR.soil_scatter,
        "1",
        1e-3,
        3.0,
        "Standard deviation of ln k from spot to spot of one soil.",
    ),
    double(
        "estimator.scatter_length",
        _ESTIMATOR.scatter_length,
        "m",
        1e-4,
        1e3,
        "Travel after which a wheel stands on another spot; for a pressed wheel, new depth.",
    ),
    double(
        "estimator.gate_probability",
        _ESTIMATOR.gate_probability,
        "1",
        0.5,
        0.999999,
        "Share of good measurements that the outlier gate lets pass.",
    ),
    Parameter(
        "estimator.surprises_to_reopen",
        "integer",
        _ESTIMATOR.surprises_to_reopen,
        "",
        "So many outliers at different spots, with nothing fitting in between, are another soil.",
        1,
        1000,
    ),
    *DIGGING_IN,
    *COST,
)
