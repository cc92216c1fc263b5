"""Message types as a bag defines them: understood within limits, and compared with those known here.

rosbags makes Python code of definitions. One that contains itself, or that has a billion fields, would
keep it busy for ever, so definitions are measured before.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from smallwheel_ros.bag_files import reason
from smallwheel_ros.bags.library import Fields, Nodetype, Typestore, parsed, store_with, typestore
from smallwheel_ros.errors import SmallwheelError

_MOST_CHARACTERS = (
    128 << 10
)  # of a definition with all that it refers to; MoveIt's largest has 60 kB
_MOST_IN_BAG = 2 << 20  # of all definitions: some seconds' work
_MOST_FIELDS = 100_000  # of a message, those of the messages in it counted each time
_DEEPEST = 50  # messages in messages
# Fields that older definitions of a type lack, and that whoever reads it can do without.
_NEWER = {("sensor_msgs/msg/Range", "variance")}


class DefinitionError(SmallwheelError):
    """A bag's definition of a message type cannot be used, or is another one than here."""


class Definitions:
    """Turns the definitions of one bag into what makes messages of bytes."""

    def __init__(self) -> None:
        self._left = _MOST_IN_BAG

    def store(self, kind: str, encoding: str, text: str) -> Typestore:
        """Return a store that knows a type; what its definition does not bring is as known here.

        Raises
        ------
        DefinitionError
            If it cannot be understood, refers to what nobody knows, or is beyond all measure.
        """
        known: Fields = dict(typestore().fielddefs)
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
            found = parsed(kind, encoding, text)
        except Exception as error:  # whatever the parser makes of a wrong text
            first = reason(error).partition("\n")[0][:100]
            raise DefinitionError(f"its definition cannot be understood ({first})") from error
        sizes: dict[str, int] = {}
        _measure(kind, {**known, **found}, (), sizes)
        try:
            return store_with({name: found.get(name) or known[name] for name in sizes})
        except Exception as error:
            raise DefinitionError(f"its definition cannot be used ({reason(error)})") from error


def _measure(kind: str, types: Fields, above: tuple[str, ...], sizes: dict[str, int]) -> int:
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


def check_same(kind: str, store: Typestore) -> None:
    """Raise DefinitionError unless a type has all fields that it has here, of the same types.

    It may have others besides.
    """
    for problem in _differences(kind, store, ""):
        raise DefinitionError(f"the bag defines it otherwise than here: {problem}")


def _differences(kind: str, store: Typestore, path: str) -> Iterator[str]:
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
