# SPDX-License-Identifier: Apache-2.0
"""What the certifying scripts share: digits, numbers, and the certified values in a file.

Nothing here or in the other scripts of this folder but the test knows the package that is tested.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mpmath
from mpmath import mp
from reference_file import HERE

WORKED = 50  # digits that are worked with
SHOWN = 30  # digits that are written: what is left is room for rounding
mp.dps = WORKED

Number = mpmath.mpf


class Certified(NamedTuple):
    """One line of the certified values. deviation: None where the value has none."""

    name: str
    value: Number
    deviation: Number | None
    unit: str


def number(text: str | int) -> Number:
    """A decimal number as it stands: 0.1 is no binary number."""
    return mp.mpf(text)


def shown(value: Number | None) -> str:
    """A number with the digits of the files."""
    return "-" if value is None else str(mp.nstr(value, SHOWN, min_fixed=-3, max_fixed=6))


def write(name: str, certified: Sequence[Certified]) -> None:
    """Put certified values into test/references/NAME.txt; its head and its data stay."""
    path = HERE / f"{name}.txt"
    head, _, data = path.read_text(encoding="utf-8").split("\n\n")
    lines = ["Certified values", "name,value,standard deviation,unit"]
    lines += [f"{c.name},{shown(c.value)},{shown(c.deviation)},{c.unit}" for c in certified]
    path.write_text("\n\n".join([head, "\n".join(lines), data]), encoding="utf-8")
    print(f"{name}: {len(certified)} values", flush=True)
