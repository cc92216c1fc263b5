# SPDX-License-Identifier: Apache-2.0
"""Message types: this package's, those of ROS 2 Jazzy, and those that a bag defines.

There is one copy of the package's own ``.msg`` files in the source, in ``msg/``, from which rosidl
generates the message classes. Every kind of installation puts them into ``smallwheel_ros/definitions``
too (a folder of that name must not be called ``msg``: it would collide with the generated module), so
that bags can be written and read on machines without ROS.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

from rosbags.convert.converter import migrate_bytes
from rosbags.interfaces import Connection, MessageDefinitionFormat, Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from smallwheel_ros.common.errors import SmallwheelError, reason

_Fields = dict[str, tuple[Any, Any]]  # by type: its constants, and its fields with their kinds
_PACKAGE = "smallwheel_ros"
_IDL_SEPARATOR = "=" * 80 + "\n"
# Fields that older definitions of a type lack, and that readers can do without.
_NEWER = {("sensor_msgs/msg/Range", "variance")}
# Of grid_map_msgs, which are no common interface: older bags do not define their types.
_GRID_MAP = {
    "grid_map_msgs/msg/GridMapInfo": "float64 resolution\nfloat64 length_x\nfloat64 length_y\n"
    "geometry_msgs/Pose pose\n",
    "grid_map_msgs/msg/GridMap": "std_msgs/Header header\ngrid_map_msgs/GridMapInfo info\n"
    "string[] layers\nstring[] basic_layers\nstd_msgs/Float32MultiArray[] data\n"
    "uint16 outer_start_index\nuint16 inner_start_index\n",
}
# Jazzy has the same messages of ROS 1 under another name.
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
    """Return the message types of ROS 2 Jazzy together with grid_map's and this package's own."""
    store = get_typestore(Stores.ROS2_JAZZY)
    own: _Fields = {}
    for name, text in (_GRID_MAP | message_definitions()).items():
        own.update(get_types_from_msg(text, name))
    store.register(own)
    return store


def message_type(name: str) -> Callable[..., Any]:
    """Return the class of a message, such as ``geometry_msgs/msg/WrenchStamped``.

    Its fields are keyword arguments, all of them required. Raises SmallwheelError if neither ROS 2
    Jazzy nor this package has a message of that name.
    """
    try:
        return typestore().types[name]
    except KeyError:
        raise SmallwheelError(
            f"message type {name!r} is unknown: expected one of ROS 2 Jazzy's common interfaces"
            " or of smallwheel_ros, written like 'nav_msgs/msg/Odometry'"
        ) from None


def plain_fields(name: str) -> dict[str, str]:
    """Return the types of a message's fields by name, without fields that are messages or arrays.

    The argument is the message's type, such as ``smallwheel_ros/msg/SoilEstimate``.
    """
    fields = typestore().fielddefs[name][1]
    return {field: str(kind[1][0]) for field, kind in fields if kind[0] == Nodetype.BASE}


class DefinitionError(SmallwheelError):
    """A bag's definition of a message type is unusable, or differs from the known one."""


class Definitions:
    """The message types of one bag.

    Parameters
    ----------
    ros2
        Whether it is a bag of ROS 2; otherwise it is one of ROS 1.
    """

    def __init__(self, ros2: bool) -> None:
        self.ros2 = ros2
        # Types that a bag of ROS 1 does not define are those of ROS 1, whose headers have a sequence number.
        self._standard = typestore() if ros2 else get_typestore(Stores.ROS1_NOETIC)
        self._stores: dict[str, Typestore] = {}

    def is_known(self, topic: Connection) -> bool:
        """Whether a topic's type is defined in the bag, or known here."""
        return bool(topic.msgdef.data) or topic.msgtype in self._standard.fielddefs

    def decoder(self, topic: Connection, *, as_here: bool = False) -> Callable[[bytes], Any]:
        """Return a function that decodes the messages of a topic.

        Parameters
        ----------
        topic
            Connection of rosbags, with the bag's own definition of the type.
        as_here
            Whether the type must have all fields that this package knows of it; it may have others besides.

        Returns
        -------
        callable
            From the bytes of a message to the message.

        Raises
        ------
        DefinitionError
            If the bag's definition cannot be read or is not known, or with `as_here` if the type is unknown
            here, or lacks a field or has it with another type.
        """
        kind, store = topic.msgtype, self._store(topic)
        if as_here and kind not in typestore().fielddefs:
            raise DefinitionError("only the bag knows the type, expected one that is known here")
        problem = next(_differences(kind, store, ""), "") if as_here else ""
        if problem:
            raise DefinitionError(f"the bag defines it otherwise than here: {problem}")
        decode = store.deserialize_cdr if self.ros2 else store.deserialize_ros1
        return partial(decode, typename=kind)

    def in_ros2(
        self, topic: Connection
    ) -> tuple[str, Typestore, Callable[[bytes], bytes | memoryview]]:
        """Return a topic's type in ROS 2, the type store that knows it, and a converter of bytes to CDR.

        Raises DefinitionError for a type that is not known; types of ROS 1 must be known to ROS 2 Jazzy or
        this package.
        """
        kind, store = topic.msgtype, self._store(topic)
        if self.ros2:
            return kind, store, bytes
        name, target = _RENAMED.get(kind, kind), typestore()
        if name not in target.fielddefs:
            raise DefinitionError("ROS 2 Jazzy has no such type")
        convert = partial(migrate_bytes, store, target, kind, name, {}, src_is2=False, dst_is2=True)
        return name, target, convert

    def _store(self, topic: Connection) -> Typestore:
        """Return the type store for a topic: the standard one, or one with the bag's own definition."""
        kind, known = topic.msgtype, self._standard.fielddefs
        if kind not in self._stores:
            if not topic.msgdef.data:
                if kind not in known:
                    raise DefinitionError("its definition is neither in the bag nor known here")
                return self._standard
            try:
                found = _parsed(topic)
                used = _used(kind, {**known, **found}, {})
                same = all(known.get(name) == fields for name, fields in used.items())
                store = self._standard if same else get_typestore(Stores.EMPTY)
                if not same:
                    store.register(used)
            except Exception as error:  # whatever the parser makes of a wrong text
                if not self.ros2 and kind in known:
                    return self._standard
                words = f"its definition cannot be understood ({reason(error)[:100]})"
                raise DefinitionError(words) from error
            self._stores[kind] = store
        return self._stores[kind]


def _parsed(topic: Connection) -> _Fields:
    """Return the types in a definition; raises whatever rosbags raises for one that is wrong."""
    text = topic.msgdef.data
    if topic.msgdef.format != MessageDefinitionFormat.IDL:
        return dict(get_types_from_msg(text, topic.msgtype))
    found: _Fields = {}
    parts = [part.partition("\n")[2] for part in text.split(_IDL_SEPARATOR)[1:]]
    for part in parts or [text]:
        found.update(get_types_from_idl(part))
    return found


def _used(kind: str, types: _Fields, found: _Fields) -> _Fields:
    """Return a type and those of the messages in it. Raises KeyError for one that is not known."""
    if kind not in found:
        found[kind] = types[kind]
        for _, described in types[kind][1]:
            node, of = _element(described)
            if node == Nodetype.NAME:
                _used(str(of), types, found)
    return found


def _element(described: Any) -> tuple[Any, Any]:
    """Return the type of a field, or of the array in it: kind of node, and element."""
    node, of = described
    return of[0] if node in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (node, of)


def _differences(kind: str, store: Typestore, path: str) -> Iterator[str]:
    """Yield a clause on each field of a type known here that a store lacks or has with another type."""
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
    """A field's type as it is written in definitions."""
    inner, what = _element(described)
    text = str(what if inner == Nodetype.NAME else what[0])
    if described[0] == Nodetype.SEQUENCE:
        return f"{text}[]"
    return f"{text}[{described[1][1]}]" if described[0] == Nodetype.ARRAY else text
