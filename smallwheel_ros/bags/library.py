"""What rosbags does for this package; the only module that imports it, since its interface moves.

Message types, their bytes, and the bag formats themselves.
"""

from __future__ import annotations

import bz2
import contextlib
import sys
from collections.abc import Callable, Iterable
from functools import cache, partial
from typing import Any, BinaryIO, NamedTuple

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from rosbags.convert.converter import is_same_wireformat, migrate_bytes
from rosbags.highlevel import AnyReader
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
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.interfaces import message_definitions

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

__all__ = [
    "NUMBER_CODES",
    "AnyReader",
    "Channel",
    "Codec",
    "Connection",
    "Nodetype",
    "StoragePlugin",
    "Typestore",
    "Writer",
    "connection_qos",
    "decompressed",
    "latched",
    "message_type",
    "parse_qos",
    "types_from",
    "typestore",
    "unpack_zstd",
]

NUMBER_CODES = {  # of `struct`, by the types of definitions
    "bool": "?",
    "byte": "b",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}

_PIECE = 1 << 14  # bytes that are decompressed at once
_IDL_SEPARATOR = "=" * 80 + "\n"
# Jazzy has the same messages under another name.
_RENAMED = {"rosgraph_msgs/msg/Log": "rcl_interfaces/msg/Log"}


@cache
def typestore() -> Typestore:
    """Return the message types of ROS 2 Jazzy together with this package's own."""
    store = get_typestore(Stores.ROS2_JAZZY)
    own = {}
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


def types_from(definitions: Iterable[tuple[str, str, str]]) -> Typestore:
    """Return the types in definitions: (type, ``ros2msg``, ``ros2idl`` or ``ros1``, text) each.

    A definition that cannot be understood is left out: its topic is then one of unknown type.
    Types that a definition refers to and does not bring are those of ROS 2 Jazzy.
    """
    store = get_typestore(Stores.EMPTY)
    found = dict(typestore().fielddefs)
    for name, encoding, text in definitions:
        try:
            if encoding == "ros2idl":
                parts = [part.partition("\n")[2] for part in text.split(_IDL_SEPARATOR)[1:]]
                for part in parts or [text]:
                    found.update(get_types_from_idl(part))
            elif text:
                found.update(get_types_from_msg(text, name))
        except Exception:  # whatever the parser makes of a damaged text
            continue
    store.register(found)
    return store


class Channel(NamedTuple):
    """A topic as a bag is to hold it: its type with the store that knows it, and QoS."""

    topic: str
    type: str
    store: Typestore
    qos: tuple[Qos, ...] = ()


class Codec:
    """Makes messages of bytes and bytes of another bag, by a bag's own definitions or known ones.

    Parameters
    ----------
    store
        The types that the bag defines.
    ros2
        False for the bytes of ROS 1.
    """

    def __init__(self, store: Typestore, ros2: bool) -> None:
        self.store, self.ros2 = store, ros2
        self._target: Typestore | None = None

    def store_of(self, kind: str) -> Typestore | None:
        """Return the store that knows a type; None where neither bag nor this package does."""
        # A type store is consulted by rosbags only when no topic of the bag has a definition.
        for store in (self.store, typestore()):
            if kind in store.fielddefs:
                return store
        return None

    def decoder(self, kind: str) -> Callable[[bytes], Any] | None:
        """Return what makes a message of bytes; None for an unknown type."""
        store = self.store_of(kind)
        if store is None:
            return None
        decode = store.deserialize_cdr if self.ros2 else store.deserialize_ros1
        return partial(decode, typename=kind)

    def as_channel(
        self, topic: str, kind: str, qos: Iterable[Qos] = ()
    ) -> tuple[Channel, Callable[[bytes], bytes | memoryview]] | None:
        """Return how a topic goes into a ROS 2 bag, and what its bytes become; None: unknown."""
        store = self.store_of(kind)
        if store is None:
            return None
        try:
            store.generate_msgdef(kind, ros_version=2)
            store.hash_rihs01(kind)
        except Exception:  # it refers to a type that nobody knows
            return None
        if self.ros2:
            return Channel(topic, kind, store, tuple(qos)), lambda data: data
        target, name = self._ros2_target(kind, store), _RENAMED.get(kind, kind)
        if is_same_wireformat(store, target, kind, name):
            return Channel(topic, name, target, tuple(qos)), lambda data: target.ros1_to_cdr(
                data, name
            )
        cache: dict[str, object] = {}
        return Channel(topic, name, target, tuple(qos)), lambda data: migrate_bytes(
            store, target, kind, name, cache, data, src_is2=False, dst_is2=True
        )

    def _ros2_target(self, kind: str, store: Typestore) -> Typestore:
        """Types as ROS 2 has them; those that only the ROS 1 bag knows are taken over."""
        if self._target is None:
            self._target = get_typestore(Stores.EMPTY)
            self._target.register(dict(typestore().fielddefs))
        name = _RENAMED.get(kind, kind)
        if name not in self._target.fielddefs:
            text, _ = store.generate_msgdef(kind, ros_version=2)
            types = get_types_from_msg(text, name)
            known = self._target.fielddefs
            self._target.register({n: t for n, t in types.items() if n not in known})
        return self._target


def connection_qos(connection: Connection) -> list[Qos]:
    """Return the QoS that a topic was recorded with; a latched one of ROS 1 is transient local."""
    ext = connection.ext
    if isinstance(ext, ConnectionExtRosbag1):
        return [latched()] if ext.latching else []
    return list(ext.offered_qos_profiles)


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


def decompressed(data: bytes, method: str) -> bytes:
    """Return what can be decompressed of data that may be cut off or damaged.

    Raises ValueError for an unknown method.
    """
    if method in ("", "none"):
        return data
    makers: dict[str, Callable[[], Any]] = {
        "zstd": zstd.ZstdDecompressor,
        "lz4": LZ4FrameDecompressor,
        "bz2": bz2.BZ2Decompressor,
    }
    if method not in makers:
        raise ValueError(f"compression {method!r} is not known here")
    decompressor = makers[method]()
    parts = []
    # In small pieces: what comes before the damage is good.
    with contextlib.suppress(Exception):
        for at in range(0, len(data), _PIECE):
            if decompressor.eof:
                break
            parts.append(decompressor.decompress(data[at : at + _PIECE]))
    return b"".join(parts)


def unpack_zstd(source: BinaryIO, target: BinaryIO) -> None:
    """Decompress a file to wherever it ends.

    Raises EOFError where it ends too early, and whatever the library raises for damaged data;
    what could be decompressed is in `target` then.
    """
    decompressor = zstd.ZstdDecompressor()
    while block := source.read(_PIECE):
        while block:
            target.write(decompressor.decompress(block))
            block = b""
            if decompressor.eof:
                block = decompressor.unused_data
                decompressor = zstd.ZstdDecompressor()
                block = block or source.read(_PIECE)
                if not block:
                    return
    raise EOFError("it ends too early")
