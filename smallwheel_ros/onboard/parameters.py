# SPDX-License-Identifier: Apache-2.0
"""From a parameter file to values, and from values to settings; the same for node and replay."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from smallwheel_ros.common.errors import SmallwheelError, nearest
from smallwheel_ros.common.parameter import Value, settings_of
from smallwheel_ros.common.plain_yaml import PlainYamlError, read_yaml
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.registry import load
from smallwheel_ros.estimator.settings import SoilPrior, covariates_of
from smallwheel_ros.model.model_file import read_model
from smallwheel_ros.onboard.settings import (
    GENERAL,
    Given,
    NodeSettings,
    OnboardSettings,
    VelocitySource,
    WheelInputs,
    parameters_for,
)
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.soil import Soil, SoilError, soil
from smallwheel_ros.physics.wheel import GRAVITY, Quantity, Strength, Wheel

NODE_NAME = "mobility_estimator"
_SECTION = "ros__parameters"
# rclpy's own; every node has them
_FOREIGN = ("use_sim_time", "start_type_description_service")
# In files that 0.2.0 dumped.
_GONE_PREFIX = "qos_overrides."


class ParametersError(SmallwheelError):
    """Parameters that nothing can be configured with; one line for each that is wrong."""


# --- From a file to values


def read_parameters(path: Path | str, node: str = NODE_NAME) -> dict[str, Value]:
    """Read the values that a ROS parameter file gives a node, by full name.

    Sections `/**` and those of the node count, in the order of the file.

    Raises
    ------
    ParametersError
        If the file cannot be read, is not YAML, or has nothing for this node.
    """
    try:
        content = read_yaml(path)
    except PlainYamlError as error:
        raise ParametersError(f"{path}: {error}") from error
    sections = content if isinstance(content, dict) else {}
    own = re.compile(rf"/\*\*|(/\*\*|/\w+)*/?{re.escape(node)}")
    found = {name: section for name, section in sections.items() if own.fullmatch(str(name))}
    values: dict[str, Value] = {}
    for name, section in found.items():
        if not isinstance(section, dict) or not isinstance(section.get(_SECTION), dict):
            raise ParametersError(f"{path}: section {name} has no {_SECTION}: in it")
        values.update(_flat(section[_SECTION]))
    if not found:
        there = ", ".join(str(name) for name in sections) or "nothing"
        raise ParametersError(
            f"{path} has no parameters for the node: found {there}, expected a section /**: or"
            f" {node}: with {_SECTION}: in it"
        )
    return values


def _flat(tree: dict[Any, Any], prefix: str = "") -> dict[str, Value]:
    flat: dict[str, Value] = {}
    for name, value in tree.items():
        if isinstance(value, dict):
            flat.update(_flat(value, f"{prefix}{name}."))
        else:
            flat[f"{prefix}{name}"] = value
    return flat


# --- What is wrong with values


def wheel_names(value: object) -> list[str]:
    """Return the names in the parameter `wheels`.

    Raises ParametersError if it is no list of different names that topics and parameters can have.
    """
    table = GENERAL[0]
    example = f"for example {table.name}: [front_left, front_right]"
    if value is None or value == []:
        raise ParametersError(f"parameter {table.name} is missing: name the wheels, {example}")
    problem = table.problem(value)
    if problem is not None:
        raise ParametersError(f"{problem}; {example}")
    assert isinstance(value, list)
    groups = {p.name.split(".")[0] for p in GENERAL} | {_GONE_PREFIX.rstrip(".")}
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
    if any(name.startswith(_GONE_PREFIX) for name in values):
        found.append(
            f"parameters {_GONE_PREFIX}* are not used any more: topics have the quality of service that"
            " docs/node.md says"
        )
    for name in values:
        if name in (*known, *_FOREIGN) or name.startswith(_GONE_PREFIX):
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


# --- From values to settings


def settings_from(values: Mapping[str, object]) -> NodeSettings:
    """Turn parameters into settings; defaults for those that are missing or None.

    Files that parameters name are read; an effects file is run.

    Raises
    ------
    ParametersError
        With a sentence for each parameter that is missing or wrong, and where a file cannot be used.
    """
    wrong = problems(values)
    if wrong:
        raise ParametersError("; ".join(wrong))
    wheels = wheel_names(values["wheels"])
    v: dict[str, Any] = {p.name: p.default for p in parameters_for(wheels)}
    v.update({name: value for name, value in values.items() if value is not None})
    inputs = {name: settings_of(WheelInputs, v, f"{name}.") for name in wheels}
    try:
        given = settings_of(Given, v)
        onboard = _onboard(given, inputs)
        covariates_of(onboard.effects)  # refuses effects of what no stream tells
    except SmallwheelError as error:
        raise ParametersError(str(error)) from error
    for name, wheel in inputs.items():
        if wheel.sinkage_source == "Range" and wheel.range_height is None:
            raise ParametersError(
                f"parameter {name}.range_height is missing: sinkage_source Range needs what the"
                " sensor shows on hard ground, in m"
            )
        inputs[name] = replace(wheel, load_sign=wheel.load_sign or given.load_sign)
    return NodeSettings(**vars(given), onboard=onboard, inputs=inputs)


def _onboard(given: Given, inputs: Mapping[str, WheelInputs]) -> OnboardSettings:
    start, effects = _start(given)
    known = given.soil
    names = ("k", "n", "m", "cohesion", "friction_angle", "shear_displacement")
    start = replace(start, **{n: v for n in names if (v := getattr(known, n)) is not None})
    prior = SoilPrior.from_soil(start, known.log_reference_pressure_std, known.n_std, known.m_std)
    strength = Strength(
        Quantity(start.cohesion, known.cohesion_std),
        Quantity(start.friction_angle, known.friction_angle_std),
        Quantity(start.shear_displacement, known.shear_displacement_std),
    )
    static = _static_loads(given, inputs)
    estimator = replace(given.estimator, sinkage_std=given.noise.sinkage)
    if static:
        # What is wrong with a load that nobody measures stays wrong as long as slope and curve do:
        # like another soil at each spot, it does not average out over measurements at one place.
        scatter = math.hypot(estimator.soil_scatter, given.static_std)
        estimator = replace(estimator, soil_scatter=scatter, loads_measured=False)
    rolling = {name: wheel for name, wheel in inputs.items() if wheel.contact == ROLLING}
    # The body of a small vehicle is above its wheels.
    usual_height = 1.2 * sum(wheel.diameter for wheel in rolling.values()) / max(len(rolling), 1)
    velocity: VelocitySource = "none" if given.odometry_from_wheels else "odometry"
    return OnboardSettings(
        wheels=tuple(
            Wheel(n, w.diameter, w.width, w.contact, w.lateral_position, w.longitudinal_position)
            for n, w in inputs.items()
        ),
        prior=prior,
        strength=strength,
        estimator=estimator,
        noise=given.noise,
        timing=given.timing,
        effects=effects,
        without_sinkage=frozenset(n for n, wheel in inputs.items() if not wheel.sinkage_topic),
        with_drawbar_pull=frozenset(n for n, wheel in rolling.items() if wheel.drawbar_pull_topic),
        with_torque=frozenset(n for n, w in rolling.items() if w.torque_source == "effort"),
        with_imu=bool(given.imu_topic),
        static_loads=static,
        velocity="topic" if given.velocity_topic else velocity,
        standstill_speed=given.standstill_speed,
        reference_slip=given.reference_slip,
        velocity_lateral_position=given.velocity_lateral_position,
        maximum_speed=given.maximum_speed,
        mass=given.vehicle_mass or 0.0,
        gravity_height=given.gravity_height or usual_height,
        mobility_rate=given.mobility_rate,
        twist=given.twist if given.twist_publish else None,
        soil_told=bool(given.soil_name or given.model_file or known.k is not None),
    )


def _start(given: Given) -> tuple[Soil, tuple[Effect, ...]]:
    """The soil that the estimate starts from, and effects: of the model file, or of the library."""
    name = given.soil_name
    if not given.model_file:
        if given.effects_file:
            raise ParametersError(
                "parameter effects_file is given without model_file: an effect needs its numbers"
            )
        try:
            return soil(name or "dry_sand"), ()
        except SoilError as error:
            raise ParametersError(f"parameter soil.name: {error}") from None
    effects = load(Path(given.effects_file).expanduser()) if given.effects_file else None
    model = read_model(Path(given.model_file).expanduser(), effects).model
    if model.geometry != "contact_integral":
        raise ParametersError(
            f"{given.model_file}: geometry is {model.geometry}, expected contact_integral: the estimate"
            " on board solves the contact exactly; fit the model again without the closed form"
        )
    found = {kind.name: kind for kind in model.soils}
    if name is None and len(found) == 1:
        return model.soils[0], tuple(model.effects)
    if name not in found:
        asked = f"has no soil '{name}'" if name else "has several soils"
        raise ParametersError(
            f"{given.model_file} {asked}, parameter soil.name says which."
            f" {nearest(name or '', list(found))}"
        )
    return found[name], tuple(model.effects)


def _static_loads(given: Given, inputs: Mapping[str, WheelInputs]) -> dict[str, Quantity]:
    """Loads that nobody measures, N: the weight split over the wheels."""
    if given.load_source != "static":
        return {}
    if given.load_mass is None:
        raise ParametersError(
            "parameter load.mass is missing: load.source static needs the vehicle's mass in kg"
        )
    shares = {name: wheel.load_share for name, wheel in inputs.items()}
    told = [share for share in shares.values() if share is not None]
    if told and (len(told) < len(shares) or not math.isclose(sum(told), 1.0, abs_tol=0.01)):
        raise ParametersError(
            f"parameters load_share: {len(told)} of {len(shares)} wheels have one, with a sum of"
            f" {sum(told):g}: give all of them, with a sum of 1, or none"
        )
    weight = given.load_mass * GRAVITY
    loads = {name: weight * (share or 1.0 / len(shares)) for name, share in shares.items()}
    return {name: Quantity(load, given.static_std * load) for name, load in loads.items()}
