"""Makes messages of a bag's bytes, and bytes of ROS 2 of those of ROS 1."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

from smallwheel_ros.bags.definitions import DefinitionError, Definitions, check_same
from smallwheel_ros.bags.library import (
    Qos,
    Typestore,
    is_same_wireformat,
    migrate_bytes,
    parsed,
    store_with,
    typestore,
)
from smallwheel_ros.bags.storage import Channel as StoredChannel
from smallwheel_ros.bags.storage import Key

Convert = Callable[[bytes], bytes | memoryview]
# Encodings of definitions that can be read; without one the types known here are meant.
_ENCODINGS = ("ros2msg", "ros2idl", "omgidl", "")
# Jazzy has the same messages under another name.
_RENAMED = {"rosgraph_msgs/msg/Log": "rcl_interfaces/msg/Log"}


class Channel(NamedTuple):
    """A topic as a bag is to hold it: its type with the store that knows it, and QoS."""

    topic: str
    type: str
    store: Typestore
    qos: tuple[Qos, ...] = ()


class Codec:
    """Knows the types of one bag.

    channels: its topics. ros2: False for the bytes of ROS 1.
    """

    def __init__(self, channels: Mapping[Key, StoredChannel], ros2: bool) -> None:
        self._channels, self.ros2 = channels, ros2
        self._definitions = Definitions()
        self._stores: dict[str, Typestore | DefinitionError] = {}

    def is_known(self, key: Key) -> bool:
        """Whether a topic's type is defined in the bag, or known here."""
        channel = self._channels[key]
        known = bool(channel.definition) or key[1] in typestore().fielddefs
        return known and channel.encoding in _ENCODINGS

    def store(self, key: Key) -> Typestore:
        """Return what knows the type of a topic. Raises DefinitionError."""
        kind = key[1]
        if kind not in self._stores:
            # Of topics of one type the first one with a definition speaks for all.
            same = [c for (_, other), c in self._channels.items() if other == kind]
            channel = next((c for c in same if c.definition), same[0])
            try:
                if channel.encoding not in _ENCODINGS:
                    raise DefinitionError(f"it is encoded as {channel.encoding}, not as in ROS 2")
                encoding = "ros2idl" if channel.encoding == "omgidl" else channel.encoding
                self._stores[kind] = self._definitions.store(kind, encoding, channel.definition)
            except DefinitionError as error:
                self._stores[kind] = error
        found = self._stores[kind]
        if isinstance(found, DefinitionError):
            raise found
        return found

    def decoder(self, key: Key, *, as_here: bool = False) -> Callable[[bytes], Any]:
        """Return what makes a message of a topic's bytes.

        as_here: the type must have the fields that it has here.

        Raises
        ------
        DefinitionError
            If nobody knows the type, or the bag defines it otherwise.
        """
        store = self.store(key)
        if as_here:
            check_same(key[1], store)
        decode = store.deserialize_cdr if self.ros2 else store.deserialize_ros1
        return partial(decode, typename=key[1])

    def as_channel(self, key: Key) -> tuple[Channel, Convert]:
        """Return how a topic goes into a bag of ROS 2, and what its bytes become there.

        Raises DefinitionError.
        """
        topic, kind = key
        store, qos = self.store(key), self._channels[key].qos
        if self.ros2:
            return Channel(topic, kind, store, qos), _unchanged
        name = _RENAMED.get(kind, kind)
        target = _ros2_store(kind, name, store)
        channel = Channel(topic, name, target, qos)
        if is_same_wireformat(store, target, kind, name):
            return channel, partial(target.ros1_to_cdr, typename=name)
        return channel, partial(_migrated, store, target, kind, name, {})


def _unchanged(data: bytes) -> bytes:
    return data


def _migrated(
    store: Typestore, target: Typestore, kind: str, name: str, cache: dict[str, object], data: bytes
) -> memoryview:
    return migrate_bytes(store, target, kind, name, cache, data, src_is2=False, dst_is2=True)


def _ros2_store(kind: str, name: str, store: Typestore) -> Typestore:
    """Types as ROS 2 has them; those that only the bag of ROS 1 knows are taken over."""
    known = typestore().fielddefs
    if name in known:
        return typestore()
    text, _ = store.generate_msgdef(kind, ros_version=2)
    return store_with({**parsed(name, "ros2msg", text), **known})
