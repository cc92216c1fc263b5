# SPDX-License-Identifier: Apache-2.0
"""Columns of numbers from serialised messages, many at once.

ROS messages are serialised as CDR: numbers are aligned to multiples of their size, strings and lists follow
their lengths. Messages of one topic whose strings and lengths are all equal have each number at the same
byte, and are read as one group. Padding may hold anything, and numbers may be little- or big-endian.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.pipeline.tables import Array

Place = tuple[int, str, int]  # first byte, NumPy's type of a number, count of numbers
_SIZES = {"bool": 1, "byte": 1, "char": 1, "float32": 4, "float64": 8}
_SIZES |= {f"{u}int{bits}": bits // 8 for u in ("", "u") for bits in (8, 16, 32, 64)}
_DTYPES = {"bool": "u1", "byte": "u1", "char": "u1", "float32": "f4", "float64": "f8"}
_DTYPES |= {
    f"{u}int{b}": f"{'u' if u else 'i'}{b // 8}" for u in ("", "u") for b in (8, 16, 32, 64)
}
_ORDERS = {b"\x00\x00": "big", b"\x00\x01": "little"}  # of plain CDR (DDS-XTypes 7.6.2.1.2)


class MessageLayout:
    """Positions of the numbers in the bytes of a serialised message.

    Parameters
    ----------
    types
        Store of the definitions of message types (`bags.types.typestore`).
    kind
        Type of the message, such as `sensor_msgs/msg/Imu`.
    raw
        The message as serialised.

    Attributes
    ----------
    places
        First byte, NumPy's type and count of each number or array of numbers, by its path, such as
        `wrench.force.z`.
    strings
        Texts of the message by path, in a list; of a single string it has one element.
    fixed
        Mask of the bytes that must be equal in a message of the same layout: those of lengths and strings,
        and of the header that gives the byte order.

    Raises
    ------
    ValueError
        If the bytes are not a message of the type.
    """

    def __init__(self, types: Any, kind: str, raw: bytes) -> None:
        if raw[:2] not in _ORDERS:
            raise ValueError(f"{len(raw)} bytes that begin with {raw[:4].hex()} are no CDR")
        self._order: Literal["big", "little"] = "big" if raw[1] == 0 else "little"
        self._types, self.raw, self._at = types, raw, 4  # after the encapsulation's header
        self.places: dict[str, Place] = {}
        self.strings: dict[str, list[str]] = {}
        self.fixed = np.zeros(
            len(raw), dtype=bool
        )  # bytes that say where the others are, and of strings
        self.fixed[:2] = True
        self._message("", kind)
        self._fixed = np.flatnonzero(self.fixed)
        self._like = np.frombuffer(raw, np.uint8)[self._fixed]

    def same(self, table: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Tell which messages have all lengths and strings in common with this one.

        Parameters
        ----------
        table
            Bytes of messages of the same size as this one, shape (messages, size).

        Returns
        -------
        ndarray
            Shape (messages,), bool.
        """
        return np.asarray((table[:, self._fixed] == self._like).all(axis=1))

    def _take(self, size: int, *, fixed: bool) -> bytes:
        begin = self._at
        self._at += size
        if self._at > len(self.raw):
            raise ValueError(f"{len(self.raw)} bytes, expected at least {self._at}")
        self.fixed[begin : self._at] = fixed
        return self.raw[begin : self._at]

    def _align(self, size: int) -> None:
        self._at += (4 - self._at) % size

    def _length(self) -> int:
        self._align(4)
        return int.from_bytes(self._take(4, fixed=True), self._order)

    def _message(self, path: str, kind: str) -> None:
        for name, field in self._types.fielddefs[kind][1]:
            self._field(f"{path}.{name}" if path else name, field)

    def _field(self, path: str, field: Any) -> None:
        node, what = field
        if node.name == "NAME":
            self._message(path, what)
        elif node.name == "BASE":
            self._base(path, what[0], 1)
        else:
            element, _ = what
            count = what[1] if node.name == "ARRAY" else self._length()
            if element[0].name == "BASE":
                self._base(path, element[1][0], count)
            else:
                for i in range(count):
                    self._message(f"{path}.{i}", element[1])

    def _base(self, path: str, kind: str, count: int) -> None:
        if kind in ("string", "wstring"):
            found = []
            for _ in range(count):
                found.append(self._take(self._length(), fixed=True)[:-1].decode(errors="replace"))
            self.strings[path] = found
        elif count:
            size = _SIZES[kind]
            self._align(size)
            order = ">" if self._order == "big" else "<"
            self.places[path] = self._at, f"{order}{_DTYPES[kind]}", count
            self._take(size * count, fixed=False)


class MessageNumbers(Mapping[str, Array]):
    """The numbers in messages of one layout, by path, read on demand.

    Values have shape (messages, count): float for floating-point numbers, int64 for all others.

    Parameters
    ----------
    layout
        The layout that all messages have.
    table
        Bytes of the messages, shape (messages, size).
    """

    def __init__(self, layout: MessageLayout, table: NDArray[np.uint8]) -> None:
        self._layout, self._table = layout, table

    def __getitem__(self, path: str) -> Array:
        at, kind, count = self._layout.places[path]
        part = self._table[:, at : at + np.dtype(kind).itemsize * count]
        whole = float if kind[1] == "f" else np.int64
        return np.ascontiguousarray(part).view(kind).astype(whole)

    def __iter__(self) -> Iterator[str]:
        return iter(self._layout.places)

    def __len__(self) -> int:
        return len(self._layout.places)


class Decoder:
    """Reads messages of one topic into columns.

    Parameters
    ----------
    types
        Store of the definitions of message types (`bags.types.typestore`).
    kind
        Type of the messages, such as `sensor_msgs/msg/Imu`.

    Attributes
    ----------
    problems
        Number of unreadable messages, by reason.
    """

    def __init__(self, types: Any, kind: str) -> None:
        self._types, self._kind = types, kind
        self._layouts: dict[int, MessageLayout] = {}
        self.problems: Counter[str] = Counter()

    def columns(
        self, raws: Sequence[bytes]
    ) -> list[tuple[NDArray[np.int64], MessageLayout, MessageNumbers]]:
        """Read messages in groups of the same layout.

        Parameters
        ----------
        raws
            Serialised messages.

        Returns
        -------
        list of (ndarray, MessageLayout, MessageNumbers)
            Of each group: indices into `raws`, rising; layout; and numbers, in the order of the indices.
            Unreadable messages are in no group, and are counted in `problems`.
        """
        sizes = np.array([len(raw) for raw in raws])
        groups = []
        for size in sorted({len(raw) for raw in raws}):
            index = np.flatnonzero(sizes == size)
            every = np.frombuffer(b"".join(raws[i] for i in index), np.uint8)
            table: NDArray[np.uint8] = every.reshape(index.size, size)
            while index.size:
                layout = self._layouts.get(size)
                same = np.zeros(index.size, dtype=bool) if layout is None else layout.same(table)
                if layout is None or not same[0]:
                    try:
                        layout = MessageLayout(self._types, self._kind, bytes(table[0]))
                    except ValueError as error:
                        self.problems[str(error)] += 1
                        index, table = index[1:], table[1:]
                        continue
                    self._layouts[size] = layout
                    same = layout.same(table)
                groups.append((index[same], layout, MessageNumbers(layout, table[same])))
                index, table = index[~same], table[~same]
        return groups


def frame_of(raw: bytes) -> str:
    """The frame_id of a serialised message (CDR) that begins with a header; empty if it has none."""
    order: Literal["big", "little"] = "little" if raw[1:2] == b"\x01" else "big"
    length = int.from_bytes(raw[12:16], order)  # after encapsulation and stamp
    return raw[16 : 16 + length].partition(b"\0")[0].decode(errors="replace")
