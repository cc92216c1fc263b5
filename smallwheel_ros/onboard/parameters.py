"""From the values of parameters to settings of the estimate; the same for node and replay."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior
from smallwheel_ros.onboard.parameter import Parameter
from smallwheel_ros.onboard.parameter_table import GENERAL, PER_WHEEL
from smallwheel_ros.onboard.settings import OnboardSettings, SensorNoise, Timing
from smallwheel_ros.physics.soil import nearest, soil
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

NODE_NAME = "mobility_estimator"
# rclpy's own; every node has them
_FOREIGN = ("use_sim_time", "start_type_description_service")
_FOREIGN_PREFIX = "qos_overrides."


class ParametersError(SmallwheelError):
    """Parameters that nothing can be configured with; one line for each that is wrong."""


@dataclass(frozen=True)
class WheelInputs:
    """Where a wheel's measurements come from; sinkage_topic is empty where there is none."""

    load_topic: str
    sinkage_topic: str
    joint: str


@dataclass(frozen=True)
class NodeSettings:
    """What the parameters say: settings of the estimate, and the wheels' inputs by name."""

    onboard: OnboardSettings
    inputs: Mapping[str, WheelInputs]
    load_sign: int
    autostart: bool


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


def settings_from(values: Mapping[str, object]) -> NodeSettings:
    """Turn parameters into settings; defaults for those that are missing or None.

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
        names = [field.name for field in fields(kind)]
        return {n: v[f"{prefix}.{n}"] for n in names if f"{prefix}.{n}" in v}

    try:
        onboard = OnboardSettings(
            wheels=tuple(
                Wheel(
                    name,
                    v[f"{name}.diameter"],
                    v[f"{name}.width"],
                    v[f"{name}.contact"],
                    v[f"{name}.lateral_position"],
                )
                for name in wheels
            ),
            prior=_prior(v),
            strength=_strength(v),
            estimator=EstimatorSettings(
                **group("estimator", EstimatorSettings), sinkage_std=v["noise.sinkage"]
            ),
            noise=SensorNoise(**group("noise", SensorNoise)),
            timing=Timing(**group("timing", Timing)),
            standstill_speed=v["standstill_speed"],
            without_sinkage=frozenset(w for w in wheels if not v[f"{w}.sinkage_topic"]),
            reference_slip=v["reference_slip"],
        )
    except SmallwheelError as error:
        raise ParametersError(str(error)) from error
    inputs = {
        name: WheelInputs(v[f"{name}.load_topic"], v[f"{name}.sinkage_topic"], v[f"{name}.joint"])
        for name in wheels
    }
    return NodeSettings(onboard, inputs, v["load_sign"], v["autostart"])


def _prior(v: Mapping[str, Any]) -> SoilPrior:
    kind = soil(v["soil.name"])
    law = {name: v[f"soil.{name}"] for name in ("k", "n", "m") if v[f"soil.{name}"] is not None}
    return SoilPrior.from_soil(
        replace(kind, **law),
        v["soil.log_reference_pressure_std"],
        v["soil.n_std"],
        v["soil.m_std"],
    )


def _strength(v: Mapping[str, Any]) -> Strength:
    kind = soil(v["soil.name"])

    def quantity(name: str) -> Quantity:
        value = v[f"soil.{name}"]
        return Quantity(getattr(kind, name) if value is None else value, v[f"soil.{name}_std"])

    return Strength(
        quantity("cohesion"), quantity("friction_angle"), quantity("shear_displacement")
    )
