# SPDX-License-Identifier: Apache-2.0
"""From the values of parameters to settings of the estimate; the same for node and replay."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

from smallwheel_ros.common.errors import SmallwheelError, nearest
from smallwheel_ros.costmap.cost import CostRules
from smallwheel_ros.costmap.cost_map import CostSettings
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.registry import load
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior
from smallwheel_ros.estimator.soil_estimator import SoilEstimator
from smallwheel_ros.estimator.traction import GRAVITY
from smallwheel_ros.model.model_file import read_model
from smallwheel_ros.onboard.parameter_table import GENERAL, parameters_for
from smallwheel_ros.onboard.settings import (
    DiggingInRules,
    NodeSettings,
    OnboardSettings,
    SensorNoise,
    Timing,
    WheelInputs,
)
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.soil import Soil, SoilError, soil
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

_Settings = TypeVar("_Settings")
NODE_NAME = "mobility_estimator"
# rclpy's own; every node has them
_FOREIGN = ("use_sim_time", "start_type_description_service")
_FOREIGN_PREFIX = "qos_overrides."


class ParametersError(SmallwheelError):
    """Parameters that nothing can be configured with; one line for each that is wrong."""


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
    found = []
    for name in values:
        if name in (*known, *_FOREIGN) or name.startswith(_FOREIGN_PREFIX):
            continue
        meant, sign, _ = nearest(name, known).partition("?")
        mend = f": {meant}?" if sign else " (see docs/parameters.md)"
        found.append(f"parameter {name} is unknown and not used{mend}")
    return found


def problems(values: Mapping[str, object]) -> list[str]:
    """Say what is wrong with the values of parameters, one sentence each; unknown ones aside."""
    try:
        wheels = wheel_names(values.get("wheels"))
    except ParametersError as error:
        return [str(error)]
    found = (p.problem(values.get(p.name)) for p in parameters_for(wheels))
    return [problem for problem in found if problem is not None]


@dataclass(frozen=True)
class StartingModels:
    """What can be started from: the soils of one model file with its effects, or the library.

    model_file: empty for the library. soils: those of the file.
    """

    model_file: str = ""
    soils: tuple[Soil, ...] = ()
    effects: tuple[Effect, ...] = ()

    def choose(self, name: str | None) -> Soil:
        """Return the soil of that name; None: the only one of the file, or the library's dry sand.

        Raises ParametersError where there is no such soil.
        """
        if not self.model_file:
            try:
                return soil(name or "dry_sand")
            except SoilError as error:
                raise ParametersError(f"parameter soil.name: {error}") from None
        found = {kind.name: kind for kind in self.soils}
        if name is None and len(found) == 1:
            return self.soils[0]
        if name not in found:
            asked = f"has no soil '{name}'" if name else "has several soils"
            raise ParametersError(
                f"{self.model_file} {asked}, parameter soil.name says which."
                f" {nearest(name or '', list(found))}"
            )
        return found[name]


def read_models(values: Mapping[str, Any]) -> StartingModels:
    """Read the files that parameters name, if any. An effects file is run.

    Raises ParametersError where a file cannot be read, or the estimate cannot follow the model.
    """
    model_file, effects_file = values.get("model_file"), values.get("effects_file")
    if not model_file:
        if effects_file:
            raise ParametersError(
                "parameter effects_file is given without model_file: an effect needs its numbers"
            )
        return StartingModels()
    try:
        effects = load(Path(effects_file).expanduser()) if effects_file else None
        model = read_model(Path(model_file).expanduser(), effects).model
    except SmallwheelError as error:
        raise ParametersError(str(error)) from error
    if model.geometry != "contact_integral":
        raise ParametersError(
            f"{model_file}: geometry is {model.geometry}, expected contact_integral: the estimate on"
            " board solves the contact exactly; fit the model again without the closed form"
        )
    return StartingModels(model_file, tuple(model.soils), tuple(model.effects))


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
    for name in wheels:
        v[f"{name}.load_sign"] = v[f"{name}.load_sign"] or v["load_sign"]
    try:
        onboard = _onboard(v, wheels, models or read_models(v))
        # What the estimator says of its settings and effects, it says now.
        SoilEstimator(onboard.prior, onboard.estimator, onboard.effects)
        cost = _of(CostSettings, v, "cost.", rules=_of(CostRules, v, "cost."))
    except SmallwheelError as error:
        raise ParametersError(str(error)) from error
    inputs = {name: _of(WheelInputs, v, f"{name}.") for name in wheels}
    for name, source in inputs.items():
        if source.sinkage_source == "Range" and source.range_height is None:
            raise ParametersError(
                f"parameter {name}.range_height is missing: sinkage_source Range needs what the"
                " sensor shows on hard ground, in m"
            )
    plain = {name.replace(".", "_"): value for name, value in v.items()}
    return _of(NodeSettings, plain, "", onboard=onboard, inputs=inputs, cost=cost)


def _of(kind: type[_Settings], v: Mapping[str, Any], group: str, **given: Any) -> _Settings:
    """Make settings of what is given and, by the names of the fields, of a group of parameters."""
    names = [entry.name for entry in fields(kind)]  # type: ignore[arg-type]
    return kind(**{n: v[f"{group}{n}"] for n in names if f"{group}{n}" in v} | given)


def _onboard(
    v: Mapping[str, Any], wheels: Sequence[str], models: StartingModels
) -> OnboardSettings:
    start = models.choose(v["soil.name"])
    law = {n: v[f"soil.{n}"] for n in ("k", "n", "m") if v[f"soil.{n}"] is not None}
    prior = SoilPrior.from_soil(
        replace(start, **law),
        v["soil.log_reference_pressure_std"],
        v["soil.n_std"],
        v["soil.m_std"],
    )
    strength = {}
    for n in ("cohesion", "friction_angle", "shear_displacement"):
        value = getattr(start, n) if v[f"soil.{n}"] is None else v[f"soil.{n}"]
        strength[n] = Quantity(value, v[f"soil.{n}_std"])
    static = _static_loads(v, wheels)
    sensors = ("sinkage_zero_std", "pass_std", "load_scale_std", "load_zero_std", "delay_std")
    estimator = {name: v[name] for name in sensors} | {"sinkage_std": v["noise.sinkage"]}
    if static:
        # What is wrong with a load that nobody measures stays wrong as long as slope and curve do:
        # like another soil at each spot, it does not average out over measurements at one place.
        scatter = math.hypot(v["estimator.soil_scatter"], v["load.static_std"])
        estimator |= {"soil_scatter": scatter, "loads_measured": False}
    velocity = "none" if v["odometry_from_wheels"] else "odometry"
    rolling = [w for w in wheels if v[f"{w}.contact"] == ROLLING]
    return _of(
        OnboardSettings,
        v,
        "",
        wheels=tuple(_of(Wheel, v, f"{name}.", name=name) for name in wheels),
        prior=prior,
        strength=Strength(**strength),
        estimator=_of(EstimatorSettings, v, "estimator.", **estimator),
        noise=_of(SensorNoise, v, "noise."),
        timing=_of(Timing, v, "timing."),
        digging_in=_of(DiggingInRules, v, "digging_in."),
        effects=models.effects,
        without_sinkage=frozenset(w for w in wheels if not v[f"{w}.sinkage_topic"]),
        with_drawbar_pull=frozenset(w for w in rolling if v[f"{w}.drawbar_pull_topic"]),
        with_torque=frozenset(w for w in rolling if v[f"{w}.torque_source"] == "effort"),
        with_imu=bool(v["imu_topic"]),
        mass=v["vehicle.mass"] or 0.0,
        mobility_rate=v["mobility.rate"],
        soil_told=bool(v["soil.name"] or v["model_file"] or v["soil.k"] is not None),
        static_loads=static,
        gravity_height=v["vehicle.gravity_height"] or _usual_height(v, rolling),
        velocity="topic" if v["velocity_topic"] else velocity,
    )


def _usual_height(v: Mapping[str, Any], rolling: Sequence[str]) -> float:
    """Height (m) of the centre of gravity of a small vehicle: its body is above its wheels."""
    diameters = [v[f"{name}.diameter"] for name in rolling]
    return 1.2 * sum(diameters) / len(diameters) if diameters else 0.0


def _static_loads(v: Mapping[str, Any], wheels: Sequence[str]) -> dict[str, Quantity]:
    """Loads that nobody measures, N: the weight split over the wheels."""
    if v["load.source"] != "static":
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
    weight = v["load.mass"] * GRAVITY
    loads = {name: weight * (share or 1.0 / len(wheels)) for name, share in shares.items()}
    return {name: Quantity(load, v["load.static_std"] * load) for name, load in loads.items()}
