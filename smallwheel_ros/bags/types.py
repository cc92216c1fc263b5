# SPDX-License-Identifier: Apache-2.0
"""The message types that this package knows, and qualities of service, as rosbags has them.

There is one copy of the package's own ``.msg`` files in the source, in ``msg/``, from which rosidl
generates the message classes. Every kind of installation puts them into ``smallwheel_ros/definitions``
too (a folder of that name must not be called ``msg``: it would collide with the generated module), so
that bags can be written and read on machines without ROS.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from rosbags.interfaces import (
    Nodetype,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from smallwheel_ros.common.errors import SmallwheelError

Fields = dict[str, tuple[Any, Any]]  # of types: constants, and names and kinds of fields
_PACKAGE = "smallwheel_ros"
_LONGEST_QOS = 100_000  # characters, of some hundred publishers
_NEVER = QosTime(2147483647, 4294967295)
# Of a topic whose last message is given to those who come late.
LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _NEVER,
    _NEVER,
    QosLiveliness.AUTOMATIC,
    _NEVER,
    False,
)


def message_directory() -> Path:
    """Return the folder with the ``.msg`` files: of the installation, or of the checkout.

    Raises SmallwheelError if neither exists, which means that the installation is incomplete.
    """
    module = Path(__file__)
    # With symlinked installs (colcon --symlink-install, make) this file is a link next to the
    # installed definitions; the checkout is where it leads to.
    candidates = (module.parents[1] / "definitions", module.resolve().parents[2] / "msg")
    for folder in candidates:
        if any(folder.glob("*.msg")):
            return folder
    places = " nor in ".join(str(folder) for folder in candidates)
    raise SmallwheelError(
        f"no message definitions (*.msg) in {places}: this installation of {_PACKAGE} is"
        " incomplete, install it again"
    )


def message_definitions() -> dict[str, str]:
    """Return the text of each message definition by its name, ``smallwheel_ros/msg/WheelSinkage``."""
    files = sorted(message_directory().glob("*.msg"))
    return {f"{_PACKAGE}/msg/{file.stem}": file.read_text(encoding="utf-8") for file in files}


@cache
def typestore() -> Typestore:
    """Return the message types of ROS 2 Jazzy together with this package's own."""
    store = get_typestore(Stores.ROS2_JAZZY)
    own: Fields = {}
    for name, text in message_definitions().items():
        own.update(get_types_from_msg(text, name))
    store.register(own)
    return store


def store_with(types: Fields) -> Typestore:
    """Return what makes messages of bytes, for these types."""
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store


def message_type(name: str) -> Callable[..., Any]:
    """Return the class of a message, such as ``geometry_msgs/msg/WrenchStamped``.

    Its fields are keyword arguments, all of them required.

    Raises
    ------
    SmallwheelError
        If neither ROS 2 Jazzy nor this package has a message of that name.
    """
    try:
        return typestore().types[name]
    except KeyError:
        raise SmallwheelError(
            f"message type {name!r} is unknown: expected one of ROS 2 Jazzy's common interfaces"
            " or of smallwheel_ros, written like 'nav_msgs/msg/Odometry'"
        ) from None


def plain_fields(name: str) -> dict[str, str]:
    """Return names and types of a message's fields that are no message and no array."""
    fields = typestore().fielddefs[name][1]
    return {field: str(kind[1][0]) for field, kind in fields if kind[0] == Nodetype.BASE}


def qos_of(text: str) -> tuple[Qos, ...]:
    """Return the qualities of service in a bag's text (YAML); none where it is damaged.

    References (&) in it are not followed: a few lines can make any number of values.
    """
    try:
        return tuple(parse_qos(text)) if "&" not in text and len(text) < _LONGEST_QOS else ()
    except Exception:  # the messages are worth having without it
        return ()
