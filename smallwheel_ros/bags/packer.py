"""Messages as bytes, from their values in the order of their definition.

rosbags serialises an object one field after the other. For a type with dozens of numbers, of which
there is a message for each estimate, `struct` with the layout worked out once takes a third of the time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from struct import Struct, calcsize
from typing import Any, NamedTuple

from smallwheel_ros.bags.library import NUMBER_CODES, Nodetype, typestore
from smallwheel_ros.errors import SmallwheelError

_TEXT = "text"
_WIDEST = 8  # bytes of the widest number
_HEAD = b"\0\1\0\0"  # of CDR: little-endian


class _Field(NamedTuple):
    code: str  # of `struct`, or `_TEXT`
    times: int
    is_array: bool


def _fields(kind: str) -> Iterator[_Field]:
    """Give the fields of a message, those of the messages in it in their places."""
    described: Any  # (kind of field, of what), see rosbags.interfaces.typing
    for name, described in typestore().fielddefs[kind][1]:
        (node, of), times, is_array = described, 1, described[0] == Nodetype.ARRAY
        if is_array:
            (node, of), times = of
        if node == Nodetype.NAME and not is_array:
            yield from _fields(of)
        elif node == Nodetype.BASE and of[0] == "string" and not is_array:
            yield _Field(_TEXT, 1, False)
        elif node == Nodetype.BASE and of[0] in NUMBER_CODES:
            yield _Field(NUMBER_CODES[of[0]], times, is_array)
        else:
            raise SmallwheelError(
                f"{kind}.{name} cannot be packed: expected text, or one of {', '.join(NUMBER_CODES)}"
                " or an array of fixed length of them"
            )


def _layouts(codes: Sequence[str]) -> tuple[Struct, ...]:
    """Lay out numbers, each at a multiple of its size, that begin 0, 1, .. 7 bytes after one of 8."""
    layouts = []
    for at in range(_WIDEST):
        layout = "<"
        for code in codes:
            size = calcsize(f"<{code}")
            gap = -at % size
            layout += f"{gap}x{code}"
            at += gap + size
        layouts.append(Struct(layout))
    return tuple(layouts)


@cache
def packer(kind: str) -> Callable[[Sequence[Any]], bytes]:
    """Return what turns the values of a message into the bytes (CDR) that rosbags makes of it.

    Values are in the order of the definition, those of a message in it in their places; an array is
    one value, of numpy. Whoever packs gets `struct.error` for a number too many, too few or outside
    of its type.

    Raises
    ------
    SmallwheelError
        If the type has other fields than numbers, texts, and arrays of fixed length of numbers.
    """
    fields = list(_fields(kind))
    arrays = [at for at, field in enumerate(fields) if field.is_array][::-1]
    # Numbers that follow each other are packed at once, with the length of the text after them.
    runs: list[list[str]] = [[]]
    for field in fields:
        if field.code == _TEXT:
            runs[-1].append("I")
            runs.append([])
        else:
            runs[-1] += [field.code] * field.times
    *before_text, last = [(len(run), _layouts(run)) for run in runs]

    def pack(given: Sequence[Any]) -> bytes:
        values = list(given)
        for place in arrays:
            values[place : place + 1] = values[place].tolist()
        parts, taken, at = [_HEAD], 0, 0
        for length, layouts in before_text:
            text = values[taken + length - 1].encode() + b"\0"
            numbers = values[taken : taken + length - 1]
            parts.append(layouts[at % _WIDEST].pack(*numbers, len(text)))
            parts.append(text)
            at += len(parts[-2]) + len(text)
            taken += length
        parts.append(last[1][at % _WIDEST].pack(*values[taken:]))
        return b"".join(parts)

    return pack
