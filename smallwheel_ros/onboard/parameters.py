# SPDX-License-Identifier: Apache-2.0
"""Reading of parameter files, and conversion of parameters to settings; the same for node and replay."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from smallwheel_ros.common.errors import SmallwheelError, guess, nearest
from smallwheel_ros.common.node_parameter import ALL, WHEEL, Value, filled
from smallwheel_ros.common.plain_yaml import PlainYamlError, read_yaml
from smallwheel_ros.effects.registry import load
from smallwheel_ros.measurements.display import setting_words, words
from smallwheel_ros.model.mixture import mixed, rivals_text
from smallwheel_ros.model.model import CalibratedModel, Model
from smallwheel_ros.model.model_file import read_model
from smallwheel_ros.onboard.declared import (
    GROUPS,
    OF_ALL,
    PARAMETERS,
    DriveParameters,
    Parameters,
    WheelParameters,
    parameters_for,
)
from smallwheel_ros.onboard.prior import EstimatorSettings, SoilPrior, covariates_of
from smallwheel_ros.onboard.settings import NodeSettings, OnboardSettings, Steered
from smallwheel_ros.onboard.strength import any_strength, strength_of
from smallwheel_ros.physics.conditions import ROLLING, Conditions
from smallwheel_ros.physics.soil import Soil, SoilError, soil
from smallwheel_ros.physics.wheel import Quantity, Wheel

NODE_NAME = "mobility_estimator"
_SECTION = "ros__parameters"
# Where an axle is, in wheelbases ahead of the middle.
_AXLES = (("front", 0.5), ("middle", 0.0), ("rear", -0.5))
_TAPE = 0.02  # m: both ends of a tape along a vehicle are off by a centimetre
# Declared by rclpy in every node.
_FOREIGN = ("use_sim_time", "start_type_description_service")
# Relative standard deviation of a load that is not measured, by uneven ground and turns.
_STATIC_STD = 0.3


class ParametersError(SmallwheelError):
    """Parameters from which nothing can be configured; one line for each that is wrong."""


# --- From a file to values


def read_parameters(path: Path | str, node: str = NODE_NAME) -> dict[str, Value]:
    """Read the parameters that a ROS parameter file gives a node.

    Sections `/**` and those of the node count, in any namespace; of two values the later one wins.

    Parameters
    ----------
    path
        The file, YAML.
    node
        The node's name, without a namespace.

    Returns
    -------
    dict
        Values by full name of the parameter, such as `vehicle.mass`, not checked.

    Raises
    ------
    ParametersError
        If the file cannot be read, is not YAML, or has no parameters of this node.
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
    """Return the wheel names in a value of the parameter `wheels`.

    Raises ParametersError unless it is a list of different names that topics and parameters can have.
    """
    table = PARAMETERS["wheels"]
    example = f"for example {table.name}: [front_left, front_right]"
    if value is None or value == []:
        raise ParametersError(f"parameter {table.name} is missing: name the wheels, {example}")
    problem = table.problem(value)
    if problem is not None:
        raise ParametersError(f"{problem}; {example}")
    assert isinstance(value, list)
    for i, name in enumerate(value):
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
            reason = "expected letters, digits and _, a letter first"
        elif name in GROUPS:
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
    """Report parameters that do not exist.

    Parameters
    ----------
    values
        Values as given, by full name of the parameter.
    wheels
        Names of the wheels; each has parameters that begin with its name.

    Returns
    -------
    list of str
        A sentence for each such parameter, with what may have been meant.
    """
    known = [p.name for p in parameters_for(wheels)]
    found = []
    for name in values:
        if name in (*known, *_FOREIGN):
            continue
        question = guess(name, known).rstrip()
        mend = (
            f": {question}"
            if question
            else " (`smallwheel init --template` prints those there are)"
        )
        found.append(f"parameter {name} is unknown and not used{mend}")
    return found


def problems(values: Mapping[str, object]) -> list[str]:
    """Return a sentence for each parameter that is missing or has a wrong value.

    A wrong value of `all_wheels` is reported once, and not for each wheel that inherits it. Unknown
    parameters are ignored. values: by full name of the parameter; None counts as missing.
    """
    try:
        wheels = wheel_names(values.get("wheels"))
    except ParametersError as error:
        return [str(error)]
    values = for_each_wheel(values)
    found = {p.name: p.problem(values.get(p.name)) for p in parameters_for(wheels)}
    inherited = for_each_wheel(
        {name: values.get(name) for name in ("wheels", *(row.name for row in OF_ALL))}
    )
    for row in OF_ALL:
        for own in (row.name.replace(ALL, wheel) for wheel in wheels):
            if found[row.name] and values.get(own) == inherited.get(own):
                found[own] = None
    return [problem for problem in found.values() if problem is not None]


def for_each_wheel(values: Mapping[str, object]) -> dict[str, object]:
    """Return parameters in which each wheel has inherited the values of `all_wheels` that it lacks.

    `<wheel>` in a text is replaced by the wheel's name. Values are unchanged if the wheels have no
    usable names.
    """
    found = dict(values)
    try:
        wheels = wheel_names(values.get("wheels"))
    except ParametersError:
        return found
    for row in OF_ALL:
        said = values.get(row.name)
        for wheel in wheels if said is not None else ():
            own = row.name.replace(ALL, wheel)
            if values.get(own) is None:
                found[own] = said.replace(WHEEL, wheel) if isinstance(said, str) else said
    return found


def places_of(values: Mapping[str, Any]) -> dict[str, float]:
    """Compute positions of wheels from vehicle.track, vehicle.wheelbase and the wheels' names.

    Parameters
    ----------
    values
        Parameters by full name, `wheels` included; sizes that are not positive numbers are skipped, since
        `problems` reports them.

    Returns
    -------
    dict
        Positions (m) by full name of the parameter, such as `front_left.lateral_position`, for wheels whose
        names contain left, right, front, middle or rear as words.
    """
    track, base = (_length(values.get(f"vehicle.{name}")) for name in ("track", "wheelbase"))
    behind = 0.5 if values.get("vehicle.base_at") == "rear_axle" else 0.0
    found = {}
    for wheel in values["wheels"]:
        words = wheel.lower().split("_")
        aside = [way for word, way in (("left", 0.5), ("right", -0.5)) if word in words]
        ahead = [way for word, way in _AXLES if word in words]
        if track is not None and len(aside) == 1:
            found[f"{wheel}.lateral_position"] = track * aside[0]
        if base is not None and len(ahead) == 1:
            found[f"{wheel}.longitudinal_position"] = base * (ahead[0] + behind)
    return found


def _length(value: object) -> float | None:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if number and 0.0 < value < math.inf else None  # type: ignore[arg-type, operator]


def elsewhere(places: Mapping[str, Any], values: Mapping[str, Any]) -> list[str]:
    """Report wheels whose given position differs by over 2 cm from that by track and wheelbase.

    Parameters
    ----------
    places
        Positions (m) by full name of the parameter, such as `front_left.lateral_position`.
    values
        Parameters by full name; `wheels`, `vehicle.track`, `vehicle.wheelbase` (m) and `vehicle.base_at` are
        read.

    Returns
    -------
    list of str
        A sentence for each such position.
    """
    found = []
    for name, by_size in places_of(values).items():
        own = places.get(name)
        if own is not None and abs(own - by_size) > _TAPE:
            size = "vehicle.track" if "lateral" in name else "vehicle.wheelbase"
            found.append(f"{name} is {own:g}, but {size} ({values[size]:g}) says {by_size:g}")
    return found


# --- From values to settings


def settings_from(
    values: Mapping[str, object], described: Mapping[str, Value] | None = None
) -> NodeSettings:
    """Check parameters and turn them into settings.

    The value of a wheel's parameter is, in this order of precedence, its own, that of `all_wheels`, that of
    the robot's description, the one computed from track and wheelbase, or the default. Files that parameters
    name are read; an effects file is run.

    Parameters
    ----------
    values
        Values as given, by full name of the parameter; one that is missing or None has its default.
    described
        Values of missing parameters from the robot's description (`robot_description.fill_silent`).

    Returns
    -------
    NodeSettings
        The settings.

    Raises
    ------
    ParametersError
        With a sentence for each parameter that is missing or wrong, and each file that cannot be used.
    """
    given = {name: value for name, value in for_each_wheel(values).items() if value is not None}
    described = described or {}
    wrong = problems({**described, **given}) or [
        f"parameter {text}: expected the same place, or only one of the two"
        for text in elsewhere(given, given)
    ]
    if wrong:
        raise ParametersError("; ".join(wrong))
    names = wheel_names(values["wheels"])
    known = {p.name: p for p in parameters_for(names)}
    v: dict[str, Any] = {name: p.default for name, p in known.items()}
    for name, value in {**places_of(given), **described, **given}.items():
        v[name] = known[name].taken(value) if name in known else value
    try:
        parameters = filled(Parameters, v)
        onboard = _onboard(parameters)
        covariates_of(onboard.effects)  # refuses effects that read columns without a stream
    except SmallwheelError as error:
        raise ParametersError(str(error)) from error
    return NodeSettings(**_fields(parameters, Parameters), onboard=onboard)


def idle_remaps(settings: Parameters) -> dict[str, str]:
    """Return warnings for remaps that would have no effect, since a parameter names another topic.

    They are by the topic's default name, such as `odom`; whether there is such a remap is not checked.
    """
    found = {}
    for name in (
        "odom_topic",
        "joint_states_topic",
        "terrain_classes_topic",
        "robot_description_topic",
    ):
        default, topic = str(PARAMETERS[name].default), getattr(settings, name)
        if topic.strip("/") != default:
            found[default] = f"a remap of {default} finds nothing: parameter {name} is {topic!r}"
    return found


def _fields(given: object, of: type) -> dict[str, Any]:
    return {one.name: getattr(given, one.name) for one in fields(of)}


def _onboard(given: Parameters) -> OnboardSettings:
    """Return the pipeline's settings that follow from the parameters and from the files that they name."""
    of = given.inputs
    wheels = tuple(_wheel(name, own) for name, own in of.items())
    calibrated, model, soil, note = _start(given, wheels)
    told = bool(given.soil.name or given.model_file)
    strength, measured = strength_of(calibrated, soil) if told else (any_strength(), False)
    rolling = [wheel.name for wheel in wheels if wheel.contact == ROLLING]
    static = _static_loads(given)
    by_topic = bool(given.velocity_topic)
    return OnboardSettings(
        **_fields(given, DriveParameters),
        wheels=wheels,
        prior=SoilPrior.from_soil(soil, model.geometry),
        strength=strength,
        estimator=_estimator(given, static),
        effects=model.effects,
        without_sinkage=frozenset(name for name, own in of.items() if not own.sinkage_topic),
        with_drawbar_pull=frozenset(name for name in rolling if of[name].drawbar_pull_topic),
        with_torque=frozenset(name for name in rolling if of[name].torque_per_effort > 0.0),
        with_imu=bool(given.imu_topic),
        static_loads=static,
        steered=_steered({name: of[name] for name in rolling}),
        velocity="topic" if by_topic else "none" if given.odometry_from_wheels else "odometry",
        soil_told=told,
        strength_measured=measured,
        model_note=note,
    )


def _wheel(name: str, own: WheelParameters) -> Wheel:
    return Wheel(
        name,
        own.diameter,
        own.width,
        own.contact,
        own.lateral_position,
        own.longitudinal_position,
    )


def _steered(rolling: Mapping[str, WheelParameters]) -> dict[str, Steered]:
    """Geometry of the steered wheels, by name. Raises ParametersError for a joint that cannot steer them."""
    turned = {own.joint: name for name, own in rolling.items()}
    by_joint: dict[str, list[str]] = {}
    for name, own in rolling.items():
        if own.steering_joint in turned:
            raise ParametersError(
                f"parameter {name}.steering_joint is {own.steering_joint!r}, which turns wheel"
                f" {turned[own.steering_joint]}: expected a joint of its own"
            )
        if own.steering_joint:
            by_joint.setdefault(own.steering_joint, []).append(name)
    found = {}
    for joint, names in by_joint.items():
        reach = _linkage(joint, names, rolling) if len(names) > 1 else 0.0
        for name in names:
            found[name] = Steered(rolling[name].steering_arm, reach)
    return found


def _linkage(joint: str, names: list[str], rolling: Mapping[str, WheelParameters]) -> float:
    """Distance (m) of an axle with one central angle ahead of the line on which the turning centre lies.

    That line is through the wheels that are not steered, or half way between two steered axles. names: the
    wheels that share the joint.
    """
    places = {name: rolling[name].longitudinal_position for name in names}
    if len(names) > 2 or abs(max(places.values()) - min(places.values())) > _TAPE:
        raise ParametersError(
            f"parameters steering_joint of {', '.join(names)} are all {joint!r}: expected two wheels of one"
            " axle (a linkage), or a joint for each; a vehicle that is steered in its middle (articulated)"
            " is not estimated"
        )
    axle = sum(places.values()) / len(places)
    others = {name: own.longitudinal_position for name, own in rolling.items() if name not in names}
    fixed = [place for name, place in others.items() if not rolling[name].steering_joint]
    pivot = sum(fixed) / len(fixed) if fixed else 0.0
    if not fixed and others:
        pivot = 0.5 * (axle + sum(others.values()) / len(others))
    if abs(axle - pivot) <= _TAPE:
        raise ParametersError(
            f"parameters steering_joint of {' and '.join(names)} are both {joint!r}, a linkage: expected"
            f" longitudinal_position of its axle and of the others (they are {axle:g} and {pivot:g} m)"
        )
    return axle - pivot


def _estimator(given: Parameters, static: Mapping[str, Quantity]) -> EstimatorSettings:
    told = EstimatorSettings(given.noise.sinkage, given.sinkage_zero_std)
    if not static:
        return told
    # What is wrong with a load that is not measured stays wrong as long as slope and curve do: like
    # another soil at each spot, it does not average out over measurements at one place.
    scatter = math.hypot(told.soil_scatter, _STATIC_STD)
    return EstimatorSettings(told.sinkage_std, told.sinkage_zero_std, scatter, loads_measured=False)


def _start(given: Parameters, wheels: Sequence[Wheel]) -> tuple[CalibratedModel, Model, Soil, str]:
    """Return calibrated model, the model that the estimate runs with, the soil to start from, and a note.

    They are those of the model file, or else of the library of soils.
    """
    name, file = given.soil.name, given.model_file
    if not file:
        if given.effects_file:
            raise ParametersError(
                "parameter effects_file is given without model_file: an effect needs its numbers"
            )
        try:
            kind = soil(name or "dry_sand")
        except SoilError as error:
            raise ParametersError(f"parameter soil.name: {error}") from None
        only = Model(kind)
        return CalibratedModel(only), only, kind, ""
    effects = load(Path(given.effects_file).expanduser()) if given.effects_file else None
    calibrated = read_model(Path(file).expanduser(), effects)
    model, note = mixed(calibrated), _model_note(file, calibrated, wheels, given.gravity)
    _refuse_what_cannot_be_honoured(file, model)
    found = {kind.name: kind for kind in model.soils}
    if name is None and len(found) == 1:
        return calibrated, model, model.soils[0], note
    if name not in found:
        asked = f"has no soil '{name}'" if name else "has several soils"
        raise ParametersError(
            f"{file} {asked}, parameter soil.name says which: {nearest(name or '', list(found))}"
        )
    return calibrated, model, found[name], note


def _refuse_what_cannot_be_honoured(file: str, model: Model) -> None:
    """Raise ParametersError for a model with a law that is not used on board, where results would differ."""
    if model.thrust_form != "stress_integral":
        raise ParametersError(
            f"{file}: thrust_form is {model.thrust_form}, expected stress_integral: on board pull and"
            " torque are those of the stresses along the contact; fit the model again without it"
        )
    shifts = [effect.id for effect in model.effects if "exponent_shift" in effect.acts]
    if model.geometry == "closed_form" and shifts:
        raise ParametersError(
            f"{file}: geometry is closed_form, which needs n < 3, and effect {shifts[0]} changes n: write"
            " geometry: contact_integral, and fit the model again"
        )


def _model_note(
    file: str, calibrated: CalibratedModel, wheels: Sequence[Wheel], gravity: float
) -> str:
    """Remark in words on rivals whose mean is used, and on wheels and gravity beyond those measured."""
    said = []
    if calibrated.rivals:
        said.append(
            f"{file}: its data could not tell these models apart: {rivals_text(calibrated)}; the estimate "
            "runs with their mean, and its deviations do not include what they differ by"
        )
    sizes = Conditions.of(
        [1.0] * len(wheels),
        [w.diameter for w in wheels],
        [w.width for w in wheels],
        gravity=gravity,
    )
    if calibrated.measured.beyond("gravity", sizes).any():
        low, high = calibrated.measured.settings["gravity"]
        under = f"{low:g}" if low == high else f"{low:g} to {high:g}"
        said.append(
            f"{file}: measured was under a gravity of {under} m/s^2, and parameter gravity is {gravity:g}:"
            " its numbers are extrapolated"
        )
    for name in ("diameter", "width"):
        beyond = calibrated.measured.beyond(name, sizes)
        if beyond.any():
            low, high = calibrated.measured.ranges[name]
            which = ", ".join(
                w.name for w, is_beyond in zip(wheels, beyond, strict=True) if is_beyond
            )
            said.append(
                f"{file}: measured was a {name} of {low:g} to {high:g} m, and that of {which} is beyond: its "
                "numbers are extrapolated"
            )
    spans = [
        f"{words(name)} {setting_words(name, calibrated.measured.ranges[name])}"
        for name in ("load", "slip")
        if name in calibrated.measured.ranges
    ]
    if spans:
        measured = " and ".join(spans)
        said.append(
            f"{file}: measured was {measured}: beyond that its numbers are extrapolated, and their "
            "deviations do not include it"
        )
    return "; ".join(said)


def _static_loads(given: Parameters) -> dict[str, Quantity]:
    """Loads that are not measured, N: the weight split over the wheels."""
    if given.load.source != "static":
        return {}
    if given.vehicle.mass is None:
        raise ParametersError(
            "parameter vehicle.mass is missing: load.source static needs the vehicle's mass in kg"
        )
    shares = {name: own.load_share for name, own in given.inputs.items()}
    told = [share for share in shares.values() if share is not None]
    if told and (len(told) < len(shares) or not math.isclose(sum(told), 1.0, abs_tol=0.01)):
        raise ParametersError(
            f"parameters load_share: {len(told)} of {len(shares)} wheels have one, with a sum of"
            f" {sum(told):g}: give all of them, with a sum of 1, or none"
        )
    weight = given.vehicle.mass * given.gravity
    loads = {name: weight * (share or 1.0 / len(shares)) for name, share in shares.items()}
    return {name: Quantity(load, _STATIC_STD * load) for name, load in loads.items()}
