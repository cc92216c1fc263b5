"""Messages packed from their values: the bytes are those that rosbags makes."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.bags import message_type, packer, typestore
from smallwheel_ros.errors import SmallwheelError

_RANGES = {"uint8": (0, 2**8), "int32": (-(2**31), 2**31), "uint32": (0, 2**32)}
_RANGES["uint64"] = (0, 2**64)
_KINDS = (
    "smallwheel_ros/msg/MobilityEstimate",
    "smallwheel_ros/msg/SoilEstimate",
    "nav_msgs/msg/Odometry",  # two texts, messages in messages, arrays that end it
    "std_msgs/msg/String",  # ends with a text
    "geometry_msgs/msg/Point",  # no text at all
)


def some_value(draw: Any, kind: str) -> Any:
    if kind == "string":
        return draw(st.text(st.characters(exclude_categories=["Cs"]), max_size=20))
    if kind == "bool":
        return draw(st.booleans())
    if kind == "float64":
        return draw(st.floats(allow_nan=False))
    low, end = _RANGES[kind]
    return draw(st.integers(low, end - 1))


def some_message(draw: Any, kind: str) -> tuple[Any, list[Any]]:
    """A message as rosbags has it, and its values in the order of the definition."""
    fields, values = {}, []
    for name, (node, described) in typestore().fielddefs[kind][1]:
        if node.name == "NAME":
            fields[name], more = some_message(draw, described)
            values += more
            continue
        if node.name == "ARRAY":
            (_, (element, _)), length = described
            fields[name] = np.array([some_value(draw, element) for _ in range(length)])
        else:
            fields[name] = some_value(draw, described[0])
        values.append(fields[name])
    return message_type(kind)(**fields), values


@pytest.mark.parametrize("kind", _KINDS)
@given(data=st.data())
def test_bytes_are_those_of_rosbags(kind: str, data: st.DataObject) -> None:
    message, values = some_message(data.draw, kind)
    assert packer(kind)(values) == bytes(typestore().serialize_cdr(message, kind))


def test_values_that_do_not_fit_the_definition_are_refused() -> None:
    pack = packer("geometry_msgs/msg/Point")
    for values in ((1.0, 2.0), (1.0, 2.0, 3.0, 4.0), (1.0, 2.0, "far")):
        with pytest.raises(struct.error):
            pack(values)
    with pytest.raises(struct.error):
        packer("std_msgs/msg/UInt8")([256])


@pytest.mark.parametrize(
    "kind", ["sensor_msgs/msg/JointState", "sensor_msgs/msg/MultiDOFJointState"]
)
def test_a_type_of_changing_length_is_refused_by_name(kind: str) -> None:
    with pytest.raises(SmallwheelError, match=rf"{kind}\.\w+ cannot be packed"):
        packer(kind)
