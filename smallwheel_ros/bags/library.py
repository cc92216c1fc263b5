"""What rosbags does for this package; the only module that imports it, since its interface moves.

Message types and their bytes, the writer of bags, and the reader of bags of ROS 1.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from rosbags.convert.converter import is_same_wireformat, migrate_bytes
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag1,
    Nodetype,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.interfaces import message_definitions

__all__ = [
    "Connection",
    "Fields",
    "Nodetype",
    "Qos",
    "Ros1Reader",
    "Ros2Reader",
    "StoragePlugin",
    "Typestore",
    "Writer",
    "is_same_wireformat",
    "latched",
    "message_type",
    "migrate_bytes",
    "offered_qos",
    "parsed",
    "parsed_qos",
    "plain_qos",
    "store_with",
    "typestore",
]

Fields = dict[str, tuple[Any, Any]]  # of types: constants, and names and kinds of fields
_LONGEST_QOS = 100_000  # characters, of some hundred publishers
_IDL_SEPARATOR = "=" * 80 + "\n"


@cache
def typestore() -> Typestore:
    """Return the message types of ROS 2 Jazzy together with this package's own."""
    store = get_typestore(Stores.ROS2_JAZZY)
    own: Fields = {}
    for name, text in message_definitions().items():
        own.update(get_types_from_msg(text, name))
    store.register(own)
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


def parsed(kind: str, encoding: str, text: str) -> Fields:
    """Return the types in a definition; raises whatever rosbags raises for one that is wrong."""
    if encoding != "ros2idl":
        return dict(get_types_from_msg(text, kind))
    found: Fields = {}
    parts = [part.partition("\n")[2] for part in text.split(_IDL_SEPARATOR)[1:]]
    for part in parts or [text]:
        found.update(get_types_from_idl(part))
    return found


def store_with(types: Fields) -> Typestore:
    """Return what makes messages of bytes, for these types."""
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store


def plain_qos(text: str) -> bool:
    """Whether a text can be read as qualities of service: YAML without references, not too long."""
    return "&" not in text and len(text) < _LONGEST_QOS


def parsed_qos(text: str) -> tuple[Qos, ...]:
    """Return the qualities of service in a bag's text; none where it is damaged."""
    try:
        return tuple(parse_qos(text)) if plain_qos(text) else ()
    except Exception:  # the messages are worth having without it
        return ()


def offered_qos(connection: Connection) -> tuple[Qos, ...]:
    """Return how a topic was offered; a latched one of ROS 1 keeps its last message."""
    if isinstance(connection.ext, ConnectionExtRosbag1):
        return (latched(),) if connection.ext.latching else ()
    return tuple(connection.ext.offered_qos_profiles)


def latched() -> Qos:
    """QoS of a topic whose last message is given to those who come late."""
    never = QosTime(2147483647, 4294967295)
    return Qos(
        QosHistory.KEEP_LAST,
        1,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        never,
        never,
        QosLiveliness.AUTOMATIC,
        never,
        False,
    )
