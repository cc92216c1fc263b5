# SPDX-License-Identifier: Apache-2.0
"""What a replay goes by: the node's parameter file, the robot description in the bag, or the bag alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from smallwheel_ros.bags import BagReader
from smallwheel_ros.bags.files import reason
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.init.from_bag import rover_of_bag
from smallwheel_ros.init.rover import InitError
from smallwheel_ros.onboard.parameters import (
    ParametersError,
    read_parameters,
    settings_from,
    unknown_parameters,
    wheel_names,
)
from smallwheel_ros.onboard.robot_description import (
    DESCRIPTION_TYPE,
    fill_silent,
    needs_description,
    silent_parameters,
)
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.replay.inputs import in_bag, read_remaps
from smallwheel_ros.replay.spec import ReplaySpec

_DEFAULT_TOPIC = "robot_description"


def check_parameters(spec: ReplaySpec) -> list[str]:
    """Check the parameter file as far as that is possible without the bag.

    Returns what in it nobody knows.

    Raises
    ------
    ParametersError
        If it cannot be read, or a parameter is wrong or is missing and can come from no bag.
    """
    values = read_parameters(spec.config)
    if not (_topic(values) and needs_description(values)):
        settings_from(values)
    return unknown_parameters(values, wheel_names(values.get("wheels")))


def read_settings(spec: ReplaySpec, reader: BagReader) -> tuple[NodeSettings, list[str]]:
    """Read the parameter file, and what it does not give from the bag's robot description.

    Returns settings and notes: what in the file nobody knows, and what came of the description.

    Raises
    ------
    ParametersError
        If the file cannot be read, or a parameter is missing or wrong.
    """
    values: dict[str, object] = dict(read_parameters(spec.config))
    found: dict[str, float | int] = {}
    notes: list[str] = []
    if _topic(values) and silent_parameters(values):
        found, notes = _described(in_bag(_topic(values), spec.remaps), reader, values)
    try:
        settings = settings_from(values | found)
    except ParametersError as error:
        raise ParametersError("; ".join([str(error), *notes])) from None
    if spec.rate is not None:
        settings = replace(settings, onboard=replace(settings.onboard, mobility_rate=spec.rate))
    return settings, unknown_parameters(values, wheel_names(values["wheels"])) + notes


def _topic(values: Mapping[str, object]) -> str:
    topic = values.get("robot_description_topic", _DEFAULT_TOPIC)
    return topic if isinstance(topic, str) else ""  # another type is found when all is checked


def _described(
    topic: str, reader: BagReader, values: Mapping[str, object]
) -> tuple[dict[str, float | int], list[str]]:
    """Return what the bag's first robot description fills, and what is to be said of that."""
    if (topic, DESCRIPTION_TYPE) not in {t[:2] for t in reader.topics if t.message_count}:
        needed = needs_description(values)
        return {}, [f"no robot description: {topic} is not in the bag"] if needed else []
    try:
        decode = reader.decoder(topic, DESCRIPTION_TYPE)
        raw = next(raw for raw in reader.raw_messages({topic}) if raw.type == DESCRIPTION_TYPE)
    except (SmallwheelError, StopIteration) as error:
        return {}, [f"{topic} cannot be read: {error or 'its messages are lost'}"]
    try:
        text = decode(raw.data).data
    except Exception as error:  # damaged bytes make rosbags raise as it likes
        return {}, [f"{topic} cannot be deserialised ({reason(error)})"]
    try:
        filled = fill_silent(text, values)
    except SmallwheelError as error:
        return {}, [f"robot description {topic}: {error}"]
    return filled.values, [f"from the bag's {topic}: {filled.text}", *filled.lacking]


_NAME = "rover.yaml"


def with_assumed_config(like: ReplaySpec) -> ReplaySpec:
    """The replay with what its bag tells as the parameter file, which is put into its folder.

    Remaps that are given win. Raises BagError, or InitError where the bag does not tell enough, or
    another parameter file is in the folder.
    """
    rover = rover_of_bag(like.bag)
    if rover.missing:
        raise InitError(
            f"{like.bag}: no parameter file was given, and the bag does not tell "
            f"{', '.join(rover.missing)}: `smallwheel init {like.bag} -o {_NAME}` writes one; fill in what "
            f"is marked, and give it with --config {_NAME}"
        )
    path, text = like.folder / _NAME, rover.parameter_file()
    if path.exists() and path.read_text(encoding="utf-8", errors="replace") != text:
        raise InitError(f"{path} is not what the bag tells: give it with --config, or remove it")
    try:
        like.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InitError(f"folder {like.folder} cannot be used: {error.strerror or error}") from None
    rover.save(path)
    remaps: Mapping[str, str] = read_remaps(f"{a}:={b}" for a, b in rover.remaps.items())
    said = f"no parameter file was given: {path} is what the bag tells ({', '.join(rover.wheels)})"
    return replace(like, config=path, remaps={**remaps, **like.remaps}, notes=(said, *rover.notes))
