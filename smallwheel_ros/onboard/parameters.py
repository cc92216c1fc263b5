"""From the values of parameters to settings of the estimate; the same for node and replay."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

from smallwheel_ros.costmap.cost import CostRules
from smallwheel_ros.costmap.cost_map import CostSettings
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior
from smallwheel_ros.estimator.soil_estimator import SoilEstimator
from smallwheel_ros.onboard.parameter import Parameter
from smallwheel_ros.onboard.parameter_table import GENERAL, PER_WHEEL, LoadSource, SinkageSource
from smallwheel_ros.onboard.settings import (
    DiggingInRules,
    OnboardSettings,
    SensorNoise,
    Timing,
    VelocitySource,
)
from smallwheel_ros.onboard.starting_model import StartingModels, read_starting_models
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.soil import Soil, nearest
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

__all__ = [
    "NODE_NAME",
    "LoadSource",
    "NodeSettings",
    "ParametersError",
    "SinkageSource",
    "WheelInputs",
    "parameters_for",
    "problems",
    "settings_from",
    "unknown_parameters",
    "wheel_names",
]

NODE_NAME = "mobility_estimator"
_GRAVITY = 9.81  # m/s^2
# rclpy's own; every node has them
_FOREIGN = ("use_sim_time", "start_type_description_service")
_FOREIGN_PREFIX = "qos_overrides."


class ParametersError(SmallwheelError):
    """Parameters that nothing can be configured with; one line for each that is wrong."""


@dataclass(frozen=True)
class WheelInputs:
    """Where a wheel's measurements come from; a topic is empty where there is none.

    range_height: what a range sensor shows on hard ground, m; None where there is no such sensor.
    joint_sign: 1 where the joint turns forward when the wheel drives forward, else -1. load_sign: 1
    where a load is positive when the wheel presses on the soil, else -1.
    """

    load_topic: str
    sinkage_topic: str
    joint: str
    load_joint: str = ""
    sinkage_source: SinkageSource = SinkageSource.SINKAGE
    range_height: float | None = None
    drawbar_pull_topic: str = ""
    joint_sign: int = 1
    load_sign: int = 1


@dataclass(frozen=True)
class NodeSettings:
    """What the parameters say: settings of the estimate and the cost map, and inputs by wheel.

    load_per_effort: N. velocity_yaw: of the velocity sensor, rad. soil_file: where the soil is saved
    and restored from; empty: nowhere. robot_description_topic: empty where there is none.
    """

    onboard: OnboardSettings
    inputs: Mapping[str, WheelInputs]
    autostart: bool
    load_source: LoadSource = LoadSource.WRENCH
    load_per_effort: float = 1.0
    velocity_topic: str = ""
    velocity_yaw: float = 0.0
    soil_file: str = ""
    cost: CostSettings = field(default_factory=CostSettings)
    robot_description_topic: str = ""


def parameters_for(wheels: Sequence[str]) -> tuple[Parameter, ...]:
    """Return all parameters of a vehicle with these wheels."""
    return GENERAL + tuple(p.for_wheel(wheel) for wheel in wheels for p in PER_WHEEL)


def wheel_names(value: object) -> list[str]:
    """Return the names in the parameter `wheels`.

    Raises
    ------
    ParametersError
        If it is not a list of different names that topics and parameters can have.
    """
    table = GENERAL[0]
    example = f"for example {table.name}: [front_left, front_right]"
    if value is None or value == []:
        raise ParametersError(f"parameter {table.name} is missing: name the wheels, {example}")
    problem = table.problem(value)
    if problem is not None:
        raise ParametersError(f"{problem}; {example}")
    assert isinstance(value, list)
    groups = {p.name.split(".")[0] for p in GENERAL} | {"qos_overrides"}
    for i, name in enumerate(value):
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
            reason = "expected letters, digits and _, a letter first"
        elif name in groups:
            reason = "there is a group of parameters of that name"
        elif name in value[:i]:
            reason = "it is there twice"
        else:
            continue
        raise ParametersError(
            f"parameter {table.name}: a wheel cannot be called {name!r}: {reason}"
        )
    return list(value)


def unknown_parameters(values: Mapping[str, object], wheels: Sequence[str]) -> list[str]:
    """Say of each parameter that nobody knows, what might have been meant."""
    known = [p.name for p in parameters_for(wheels)]
    return [
        f"parameter {name} is unknown and not used: {nearest(name, known).split(' There is')[0]}"
        if "did you mean" in nearest(name, known)
        else f"parameter {name} is unknown and not used (see docs/parameters.md)"
        for name in values
        if name not in known and name not in _FOREIGN and not name.startswith(_FOREIGN_PREFIX)
    ]


def problems(values: Mapping[str, object]) -> list[str]:
    """Say what is wrong with the values of parameters, one sentence each; unknown ones aside."""
    try:
        wheels = wheel_names(values.get("wheels"))
    except ParametersError as error:
        return [str(error)]
    found = []
    for parameter in parameters_for(wheels):
        value = values.get(parameter.name)
        if value is not None:
            problem = parameter.problem(value)
        elif parameter.required:
            problem = f"parameter {parameter.name} is missing, expected {parameter.expected}"
        else:
            problem = None
        if problem is not None:
            found.append(problem)
    return found


def read_models(values: Mapping[str, object]) -> StartingModels:
    """Read the model and effects files that parameters name. Raises ParametersError."""
    files = {}
    for name in ("model_file", "effects_file"):
        value = values.get(name) or ""
        if not isinstance(value, str):
            raise ParametersError(f"parameter {name} is {value!r}, expected a string")
        files[name] = value
    try:
        return read_starting_models(**files)
    except SmallwheelError as error:
        raise ParametersError(str(error)) from error


def settings_from(
    values: Mapping[str, object], models: StartingModels | None = None
) -> NodeSettings:
    """Turn parameters into settings; defaults for those that are missing or None.

    models: what has been read of the files that the parameters name; None: they are read now.

    Raises
    ------
    ParametersError
        With a sentence for each parameter that is missing or wrong.
    """
    wrong = problems(values)
    if wrong:
        raise ParametersError("; ".join(wrong))
    wheels = wheel_names(values["wheels"])
    v: dict[str, Any] = {p.name: p.default for p in parameters_for(wheels)}
    v.update({name: value for name, value in values.items() if value is not None})

    def group(prefix: str, kind: type) -> dict[str, Any]:
        names = [entry.name for entry in fields(kind)]
        return {n: v[f"{prefix}.{n}"] for n in names if f"{prefix}.{n}" in v}

    try:
        start = (models or read_models(v)).choose(v["soil.name"])
        onboard = OnboardSettings(
            wheels=tuple(
                Wheel(
                    name,
                    v[f"{name}.diameter"],
                    v[f"{name}.width"],
                    v[f"{name}.contact"],
                    v[f"{name}.lateral_position"],
                    v[f"{name}.longitudinal_position"],
                )
                for name in wheels
            ),
            prior=_prior(v, start.soil),
            strength=_strength(v, start.soil),
            estimator=_estimator(v, group("estimator", EstimatorSettings)),
            noise=SensorNoise(**group("noise", SensorNoise)),
            timing=Timing(**group("timing", Timing)),
            standstill_speed=v["standstill_speed"],
            without_sinkage=frozenset(w for w in wheels if not v[f"{w}.sinkage_topic"]),
            reference_slip=v["reference_slip"],
            effects=start.effects,
            static_loads=_static_loads(v, wheels),
            velocity=_velocity(v),
            digging_in=DiggingInRules(**group("digging_in", DiggingInRules)),
            velocity_lateral_position=v["velocity_lateral_position"],
            maximum_speed=v["maximum_speed"],
            with_drawbar_pull=frozenset(
                w for w in wheels if v[f"{w}.drawbar_pull_topic"] and v[f"{w}.contact"] == ROLLING
            ),
        )
        # What the estimator says of its settings and effects, it says now.
        SoilEstimator(onboard.prior, onboard.estimator, onboard.effects)
        cost = CostSettings(
            **group("cost", CostSettings), rules=CostRules(**group("cost", CostRules))
        )
    except SmallwheelError as error:
        raise ParametersError(str(error)) from error
    return NodeSettings(
        onboard,
        {name: _inputs(v, name) for name in wheels},
        v["autostart"],
        LoadSource(v["load.source"]),
        v["load.per_effort"],
        v["velocity_topic"],
        v["velocity_yaw"],
        v["soil.file"],
        cost,
        v["robot_description_topic"],
    )


def _inputs(v: Mapping[str, Any], wheel: str) -> WheelInputs:
    source, height = SinkageSource(v[f"{wheel}.sinkage_source"]), v[f"{wheel}.range_height"]
    if source is SinkageSource.RANGE and height is None:
        raise ParametersError(
            f"parameter {wheel}.range_height is missing: sinkage_source {source.value} needs what"
            " the sensor shows on hard ground, in m"
        )
    return WheelInputs(
        v[f"{wheel}.load_topic"],
        v[f"{wheel}.sinkage_topic"],
        v[f"{wheel}.joint"],
        v[f"{wheel}.load_joint"],
        source,
        height,
        v[f"{wheel}.drawbar_pull_topic"],
        v[f"{wheel}.joint_sign"],
        v[f"{wheel}.load_sign"] or v["load_sign"],
    )


def _estimator(v: Mapping[str, Any], values: dict[str, Any]) -> EstimatorSettings:
    if LoadSource(v["load.source"]) is LoadSource.STATIC:
        # What is wrong with a load that nobody measures stays wrong as long as slope and curve do:
        # like another soil at each spot, it does not average out over measurements at one place.
        scatter = math.hypot(values["soil_scatter"], v["load.static_std"])
        values = {**values, "soil_scatter": scatter}
    for name in ("sinkage_zero_std", "pass_std", "load_scale_std", "delay_std"):
        values[name] = v[name]
    return EstimatorSettings(**values, sinkage_std=v["noise.sinkage"])


def _velocity(v: Mapping[str, Any]) -> VelocitySource:
    if v["velocity_topic"]:
        return VelocitySource.TOPIC
    return VelocitySource.NONE if v["odometry_from_wheels"] else VelocitySource.ODOMETRY


def _static_loads(v: Mapping[str, Any], wheels: Sequence[str]) -> dict[str, Quantity]:
    """Loads that nobody measures, N: the weight split over the wheels."""
    if LoadSource(v["load.source"]) is not LoadSource.STATIC:
        return {}
    if v["load.mass"] is None:
        raise ParametersError(
            "parameter load.mass is missing: load.source static needs the vehicle's mass in kg"
        )
    shares = {name: v[f"{name}.load_share"] for name in wheels}
    given = [share for share in shares.values() if share is not None]
    if given and (len(given) < len(wheels) or not math.isclose(sum(given), 1.0, abs_tol=0.01)):
        raise ParametersError(
            f"parameters load_share: {len(given)} of {len(wheels)} wheels have one, with a sum of"
            f" {sum(given):g}: give all of them, with a sum of 1, or none"
        )
    weight = v["load.mass"] * _GRAVITY
    loads = {name: weight * (share or 1.0 / len(wheels)) for name, share in shares.items()}
    return {name: Quantity(load, v["load.static_std"] * load) for name, load in loads.items()}


def _prior(v: Mapping[str, Any], kind: Soil) -> SoilPrior:
    law = {name: v[f"soil.{name}"] for name in ("k", "n", "m") if v[f"soil.{name}"] is not None}
    return SoilPrior.from_soil(
        replace(kind, **law),
        v["soil.log_reference_pressure_std"],
        v["soil.n_std"],
        v["soil.m_std"],
    )


def _strength(v: Mapping[str, Any], kind: Soil) -> Strength:
    def quantity(name: str) -> Quantity:
        value = v[f"soil.{name}"]
        return Quantity(getattr(kind, name) if value is None else value, v[f"soil.{name}_std"])

    return Strength(
        quantity("cohesion"), quantity("friction_angle"), quantity("shear_displacement")
    )
