"""A few fields of many messages, straight from their bytes.

Where something is in a serialised message depends only on its definition and on the lengths of its
strings and sequences, and those hardly ever change: a topic has its frame and its joints. So a
message is deserialised by rosbags, and its layout is written down; where a later one has the same
strings and as many elements, its numbers are read at the same places. Anything else is given to
rosbags, so bytes that rosbags refuses are refused here.

Serialisation of ROS 2: behind four bytes that tell the byte order, each number is at a multiple of
its own size (XCDR version 1: OMG DDS-XTypes 1.3, 7.4.3). That of ROS 1 has no gaps.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any, NamedTuple

from smallwheel_ros.bags.library import NUMBER_CODES, Nodetype, Typestore
from smallwheel_ros.errors import SmallwheelError

Fields = tuple[Any, ...]

_HEAD = 4  # bytes before the fields of a ROS 2 message
_PADDING = 3  # so many bytes may follow them
_NOTHING = "structure_needs_at_least_one_member"  # a byte in messages without fields, not in ROS 1
_MOST = 64  # layouts: where each message of a topic has another one, rosbags reads them


class FieldError(SmallwheelError):
    """A bag defines a type without a field that is asked for, or with another one of that name."""


class _Layout(NamedTuple):
    """Where the fields are in messages of one size.

    shape: gives lengths and strings of a message, which are to be as `expected`.
    numbers: gives those that are asked for, in the message's order.
    constants: what else is asked for. pick: puts numbers and constants in the order of the fields.
    """

    shape: Callable[[bytes], Fields]
    expected: Fields
    numbers: Callable[[bytes], Fields]
    constants: Fields
    pick: Callable[[Fields], Fields]


class FieldReader:
    """Reads some fields of the messages of one type in one bag.

    Parameters
    ----------
    store, kind
        The type, and what knows it as the bag defines it.
    ros2
        False for the bytes of ROS 1.
    names
        Two or more fields, such as ``header.stamp.sec``: numbers, strings, or arrays of them.
    values_of
        Gives them of a deserialised message, in the same order. For a field that the bag's
        definition lacks it may give a number, the same for each message.
    """

    def __init__(
        self,
        store: Typestore,
        kind: str,
        ros2: bool,
        names: Sequence[str],
        values_of: Callable[[Any], Fields],
    ) -> None:
        self._store, self._kind, self._ros2 = store, kind, ros2
        self._decode = store.deserialize_cdr if ros2 else store.deserialize_ros1
        self._names, self._values_of = tuple(names), values_of
        self._layouts: dict[int, list[_Layout]] = {}  # by size of the message
        self._written = 0

    def __call__(self, data: bytes) -> Fields:
        """Return the fields of one message; arrays are sequences of some kind.

        Raises FieldError, or what rosbags raises for bytes that are no such message.
        """
        for layout in self._layouts.get(len(data), ()):
            if layout.shape(data) == layout.expected:
                return layout.pick(layout.numbers(data) + layout.constants)
        message = self._decode(data, self._kind)
        try:
            values = self._values_of(message)
        except AttributeError as error:
            raise FieldError(str(error)) from error
        if self._written < _MOST:
            self._written += 1
            fields = dict(zip(self._names, values, strict=True))
            written = _Writer(self._store, self._ros2, data, fields).layout(self._kind, message)
            if written is not None:
                self._layouts.setdefault(len(data), []).append(written)
        return values


class _Writer:
    """Writes down the layout of one message; fields: what is asked for, by its names."""

    def __init__(self, store: Typestore, ros2: bool, data: bytes, fields: dict[str, Any]) -> None:
        self._store, self._ros2, self._data, self._fields = store, ros2, data, fields
        self._order = "<" if not ros2 or data[1] else ">"
        self._end = 0  # of what is written down, bytes
        self._shape = self._numbers = ""  # as `struct` has it
        self._expected: list[Any] = []
        self._places: dict[str, int | slice] = {}  # of fields among the numbers
        self._count = 0  # of the numbers
        if ros2:
            self._expect("s", 1, _HEAD, bytes(data[:_HEAD]))

    def layout(self, kind: str, message: Any) -> _Layout | None:
        """Return the layout of a message; None where it does not fit its own bytes."""
        self._message(kind, message, "")
        rest = len(self._data) - self._end
        if not 0 <= rest <= (_PADDING if self._ros2 else 0):
            return None
        self._skip(rest)
        # Strings are the same in each message of this layout, since they are expected.
        constants = [name for name in self._fields if name not in self._places]
        places = self._places | {name: self._count + i for i, name in enumerate(constants)}
        made = _Layout(
            struct.Struct(self._order + self._shape).unpack,
            tuple(self._expected),
            struct.Struct(self._order + self._numbers).unpack,
            tuple(self._fields[name] for name in constants),
            itemgetter(*(places[name] for name in self._fields)),
        )
        return made if made.shape(self._data) == made.expected else None

    def _message(self, kind: str, message: Any, path: str) -> None:
        for name, (node, what) in self._store.get_msgdef(kind).fields:
            if self._ros2 or name != _NOTHING:
                self._field(node, what, getattr(message, name), path + name)

    def _field(self, node: Nodetype, what: Any, value: Any, path: str) -> None:
        if node == Nodetype.NAME:
            if path in self._fields:
                raise FieldError(f"{path} is neither a number nor a string")
            self._message(what, value, f"{path}.")
        elif node == Nodetype.BASE and what[0] == "string":
            text = value.encode() + self._ros2 * b"\0"
            self._expect("I", 4, 1, len(text))
            self._expect("s", 1, len(text), text)
        elif node == Nodetype.BASE:
            self._take(what[0], 1, path, self._count)
        else:
            (item, what), _ = what
            if node == Nodetype.SEQUENCE:
                self._expect("I", 4, 1, len(value))
            if item == Nodetype.BASE and what[0] != "string":
                self._take(what[0], len(value), path, slice(self._count, self._count + len(value)))
            else:
                for element in value:
                    self._field(item, what, element, path)

    def _take(self, kind: str, count: int, path: str, place: int | slice) -> None:
        """Note numbers of one kind; place: among all numbers, if these are asked for."""
        code = NUMBER_CODES[kind]
        gap, size = self._step(struct.calcsize(f"<{code}"), count)
        self._shape += f"{gap + size}x"
        if path in self._fields:
            self._places[path] = place
            self._count += count
            self._numbers += f"{gap}x{count}{code}"
        else:
            self._numbers += f"{gap + size}x"

    def _expect(self, code: str, size: int, count: int, value: Any) -> None:
        """Note a length or a string, which another message of this layout has too."""
        gap, size = self._step(size, count)
        self._shape += f"{gap}x{count}{code}"
        self._numbers += f"{gap + size}x"
        self._expected.append(value)

    def _skip(self, size: int) -> None:
        self._shape += f"{size}x"
        self._numbers += f"{size}x"

    def _step(self, size: int, count: int) -> tuple[int, int]:
        """Go on behind numbers; return the bytes left out before them, and theirs."""
        gap = (_HEAD - self._end) % size if self._ros2 and count else 0
        self._end += gap + size * count
        return gap, size * count
