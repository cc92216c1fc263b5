# SPDX-License-Identifier: Apache-2.0
"""Settings of a replay: the node's parameter file, and the robot description in the bag."""

from __future__ import annotations

from collections.abc import Mapping

from smallwheel_ros.bag_files import reason
from smallwheel_ros.bags import BagReader
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.onboard.parameter_files import read_parameters
from smallwheel_ros.onboard.parameters import (
    ParametersError,
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
from smallwheel_ros.replay.inputs import in_bag
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
