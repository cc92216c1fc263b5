# SPDX-License-Identifier: Apache-2.0
"""Numbers as people type them on a command line: `60`, `20:140:10`, `0.1,0.2`, `17 cm`."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.measurements.units import UnitsError, to_base

Array = NDArray[np.float64]

_MOST = 100_000
_EXPECTED = "a number, start:stop:step or a list a,b,c"
_NUMBERS = re.compile(r"^[-+0-9.eE:,]+")


class RangeError(SmallwheelError):
    """A number or range that cannot be read."""


def parse_range(name: str, text: str, unit: str | None) -> Array:
    """Values in the SI unit named (None: in SI whatever the unit), shape (values,).

    `a`, `a,b,c` or `start:stop:step` (stop included), a unit behind it where it is not SI. Raises
    RangeError naming the option.
    """
    text = text.strip()
    match = _NUMBERS.match(text)
    if match is None:
        raise RangeError(f"{name}: found '{text}', expected {_EXPECTED}")
    given = text[match.end() :].strip()
    try:
        values = np.concatenate([_piece(name, p) for p in match.group().split(",")])
    except ValueError:
        raise RangeError(f"{name}: found '{match.group()}', expected {_EXPECTED}") from None
    try:
        return to_base(values, given, unit) if given else values
    except UnitsError as error:
        raise RangeError(f"{name}: {error}") from error


def _piece(name: str, piece: str) -> Array:
    parts = [float(p) for p in piece.split(":")]
    if not np.all(np.isfinite(parts)):
        raise RangeError(f"{name}: found '{piece}', expected finite numbers")
    if len(parts) == 1:
        return np.array(parts)
    if len(parts) != 3:
        raise RangeError(f"{name}: found '{piece}', a range is start:stop:step")
    start, stop, step = parts
    if step <= 0 or stop < start:
        raise RangeError(f"{name}: the range '{piece}' is empty; start <= stop and step > 0")
    count = int((stop - start) / step + 1e-9) + 1
    if count > _MOST:
        raise RangeError(f"{name}: the range '{piece}' has {count} values, at most {_MOST}")
    return np.asarray(start + step * np.arange(count))
