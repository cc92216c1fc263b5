# SPDX-License-Identifier: Apache-2.0
"""Message types: those that this package knows, and those that a bag defines.

There is one copy of the package's own ``.msg`` files in the source, in ``msg/``, from which rosidl
generates the message classes. Every kind of installation puts them into ``smallwheel_ros/definitions``
too (a folder of that name must not be called ``msg``: it would collide with the generated module), so
that bags can be written and read on machines without ROS.

rosbags makes Python code of a bag's definitions. One that contains itself, or that has a billion
fields, would keep it busy for ever, so definitions are measured before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.convert.converter import migrate_bytes
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
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from smallwheel_ros.common.errors import SmallwheelError, reason

_Fields = dict[str, tuple[Any, Any]]  # of types: constants, and names and kinds of fields
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
# Characters of a definition with all that it refers to; MoveIt's largest has 60 kB.
_MOST_CHARACTERS = 128 << 10
_MOST_IN_BAG = 2 << 20  # of all definitions: some seconds' work
_MOST_FIELDS = 100_000  # of a message, those of the messages in it counted each time
_DEEPEST = 50  # messages in messages
# Encodings of definitions that can be read; without one the types known here are meant.
_ENCODINGS = ("ros2msg", "ros2idl", "omgidl", "")
_IDL_SEPARATOR = "=" * 80 + "\n"
# Fields that older definitions of a type lack, and that whoever reads it can do without.
_NEWER = {("sensor_msgs/msg/Range", "variance")}
# Jazzy has the same messages under another name.
_RENAMED = {"rosgraph_msgs/msg/Log": "rcl_interfaces/msg/Log"}


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
    own: _Fields = {}
    for name, text in message_definitions().items():
        own.update(get_types_from_msg(text, name))
    store.register(own)
    return store


def _store_with(types: _Fields) -> Typestore:
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


class BagTopic(NamedTuple):
    """One topic of a bag, or of one of its files.

    Attributes
    ----------
    readable
        False when nobody knows its message definition.
    encoding, definition
        ``ros2msg``, ``ros2idl``, or another that nobody here can read, and the text of the type's
        definition; empty where the bag has none.
    qos
        How it was offered, as rosbags has it.
    """

    name: str
    type: str
    message_count: int = 0
    readable: bool = False
    encoding: str = ""
    definition: str = ""
    qos: tuple[Any, ...] = ()


class Channel(NamedTuple):
    """A topic as a bag is to hold it: its type with the store that knows it, and QoS."""

    topic: str
    type: str
    store: Typestore
    qos: tuple[Qos, ...] = ()


class DefinitionError(SmallwheelError):
    """A bag's definition of a message type cannot be used, or is another one than here."""


class Definitions:
    """Knows the types of one bag. ros2: False for a bag of ROS 1."""

    def __init__(self, ros2: bool) -> None:
        self.ros2 = ros2
        self._left = _MOST_IN_BAG
        self._stores: dict[str, Typestore | DefinitionError] = {}

    def is_known(self, topic: BagTopic) -> bool:
        """Whether a topic's type is defined in the bag, or known here."""
        known = bool(topic.definition) or topic.type in typestore().fielddefs
        return known and topic.encoding in _ENCODINGS

    def decoder(self, topic: BagTopic, *, as_here: bool = False) -> Callable[[bytes], Any]:
        """Return what makes a message of a topic's bytes.

        as_here: the type must have the fields that it has here; it may have others besides.

        Raises
        ------
        DefinitionError
            If nobody knows the type, its definition is beyond all measure, or another than here.
        """
        kind, store = topic.type, self._store(topic)
        if as_here and kind not in typestore().fielddefs:
            raise DefinitionError("only the bag knows the type, expected one that is known here")
        problem = next(_differences(kind, store, ""), "") if as_here else ""
        if problem:
            raise DefinitionError(f"the bag defines it otherwise than here: {problem}")
        decode = store.deserialize_cdr if self.ros2 else store.deserialize_ros1
        return partial(decode, typename=kind)

    def in_ros2(self, topic: BagTopic) -> tuple[Channel, Callable[[bytes], bytes | memoryview]]:
        """Return a topic as a bag of ROS 2 is to hold it, and what its bytes become there.

        Raises DefinitionError.
        """
        kind, store = topic.type, self._store(topic)
        if self.ros2:
            return Channel(topic.name, kind, store, topic.qos), bytes
        name, known = _RENAMED.get(kind, kind), typestore().fielddefs
        target = typestore()
        if name not in known:  # types that only the bag knows are taken over
            text, _ = store.generate_msgdef(kind, ros_version=2)
            target = _store_with({**get_types_from_msg(text, name), **known})
        cache: dict[str, Any] = {}

        def convert(data: bytes) -> memoryview:
            return migrate_bytes(
                store, target, kind, name, cache, data, src_is2=False, dst_is2=True
            )

        return Channel(topic.name, name, target, topic.qos), convert

    def _store(self, topic: BagTopic) -> Typestore:
        """Return what knows a topic's type. Raises DefinitionError."""
        found = self._stores.get(topic.type)
        if found is None:
            try:
                found = self._read(topic.type, topic.encoding, topic.definition)
            except DefinitionError as error:
                found = error
            self._stores[topic.type] = found
        if isinstance(found, DefinitionError):
            raise found
        return found

    def _read(self, kind: str, encoding: str, text: str) -> Typestore:
        """Read a definition; what it does not bring is as known here."""
        known: _Fields = dict(typestore().fielddefs)
        if encoding not in _ENCODINGS:
            raise DefinitionError(f"it is encoded as {encoding}, not as in ROS 2")
        if not text:
            if kind not in known:
                raise DefinitionError("its definition is neither in the bag nor known here")
            return typestore()
        if len(text) > min(_MOST_CHARACTERS, self._left):
            raise DefinitionError(
                f"its definition has {len(text)} characters; expected at most {_MOST_CHARACTERS},"
                f" and {_MOST_IN_BAG} in all definitions of a bag"
            )
        self._left -= len(text)
        try:
            found = _parsed(kind, encoding, text)
        except Exception as error:  # whatever the parser makes of a wrong text
            words = f"its definition cannot be understood ({reason(error)[:100]})"
            raise DefinitionError(words) from error
        sizes: dict[str, int] = {}
        _measure(kind, {**known, **found}, (), sizes)
        if all(known.get(name) == found.get(name, known.get(name)) for name in sizes):
            return typestore()
        try:
            return _store_with({name: found.get(name) or known[name] for name in sizes})
        except Exception as error:
            raise DefinitionError(f"its definition cannot be used ({reason(error)})") from error


def _parsed(kind: str, encoding: str, text: str) -> _Fields:
    """Return the types in a definition; raises whatever rosbags raises for one that is wrong."""
    if encoding in ("ros2msg", ""):
        return dict(get_types_from_msg(text, kind))
    found: _Fields = {}
    parts = [part.partition("\n")[2] for part in text.split(_IDL_SEPARATOR)[1:]]
    for part in parts or [text]:
        found.update(get_types_from_idl(part))
    return found


def _measure(kind: str, types: _Fields, above: tuple[str, ...], sizes: dict[str, int]) -> int:
    """Return the number of fields of a type; `sizes` gets that of each type in it, too."""
    if kind in above:
        raise DefinitionError(f"its definition contains itself ({kind})")
    if kind not in types:
        raise DefinitionError(f"its definition refers to {kind}, which nobody knows")
    if len(above) > _DEEPEST:
        raise DefinitionError(f"its definition is more than {_DEEPEST} messages deep")
    if kind not in sizes:
        total = 0
        for name, described in types[kind][1]:
            node, of, times = _element(described)
            size = 1
            if node == Nodetype.NAME:
                size = _measure(of, types, (*above, kind), sizes)
                if size == 0 and described[0] != Nodetype.NAME:
                    raise DefinitionError(f"{kind}.{name} is an array of messages without fields")
            elif described[0] == Nodetype.ARRAY and of[0] != "string":
                times = 1  # numbers are read at once
            total += size * times
            if total > _MOST_FIELDS:
                raise DefinitionError(f"its definition has more than {_MOST_FIELDS} fields")
        sizes[kind] = total
    return sizes[kind]


def _element(described: Any) -> tuple[Any, Any, int]:
    """Return what a field is made of, and how many times: (kind of node, of what, times)."""
    node, of = described
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        (inner, what), times = of
        return inner, what, times if node == Nodetype.ARRAY else 1
    return node, of, 1


def _differences(kind: str, store: Typestore, path: str) -> Iterator[str]:
    """Say which fields of a type, as it is here, a store lacks or has otherwise."""
    theirs = dict(store.fielddefs[kind][1])
    for name, described in typestore().fielddefs[kind][1]:
        if name not in theirs:
            if (kind, name) not in _NEWER:
                yield f"{path}{name} is missing"
        elif theirs[name] != described:
            there, here = _words(theirs[name]), _words(described)
            yield f"{path}{name} is {there}, expected {here}"
        elif described[0] == Nodetype.NAME:
            yield from _differences(str(described[1]), store, f"{path}{name}.")


def _words(described: Any) -> str:
    """A field's type as definitions have it."""
    inner, what, times = _element(described)
    text = str(what if inner == Nodetype.NAME else what[0])
    if described[0] == Nodetype.SEQUENCE:
        return f"{text}[]"
    return f"{text}[{times}]" if described[0] == Nodetype.ARRAY else text
