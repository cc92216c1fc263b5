# SPDX-License-Identifier: Apache-2.0
"""Reads a reference file (README.md says its form). Needs nothing but Python."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
_VALUES, _DATA = "Certified values", "Data"


class Value(NamedTuple):
    """A certified value, and its standard deviation where it has one; decimal text as in the file."""

    value: str
    deviation: str | None
    unit: str


@dataclass(frozen=True)
class Reference:
    """One problem. head: by key. certified: by name. columns, rows: the data, as text."""

    name: str
    head: Mapping[str, str]
    certified: Mapping[str, Value]
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def names() -> list[str]:
    """Names of all problems: what stands here with a head."""
    return sorted(
        p.stem for p in HERE.glob("*.txt") if p.read_text(encoding="utf-8").startswith("Name:")
    )


def read_reference(name: str) -> Reference:
    """Read test/references/NAME.txt. Raises ValueError that says in which part something is amiss."""
    text = (HERE / f"{name}.txt").read_text(encoding="utf-8")
    parts = text.split("\n\n")
    if len(parts) != 3 or parts[1].split("\n")[0] != _VALUES or parts[2].split("\n")[0] != _DATA:
        raise ValueError(
            f"{name}.txt: found {len(parts)} parts, expected three with a blank line between: head, "
            f"'{_VALUES}', '{_DATA}'"
        )
    head: dict[str, str] = {}
    for line in parts[0].splitlines():
        if line.startswith(" "):
            head[next(reversed(head))] += f" {line.strip()}"
        else:
            key, colon, said = line.partition(": ")
            if not colon:
                raise ValueError(f"{name}.txt: '{line}' in the head, expected KEY: TEXT")
            head[key] = said
    certified = {}
    for row in csv.DictReader(parts[1].splitlines()[1:]):
        spread = row["standard deviation"]
        certified[row["name"]] = Value(row["value"], None if spread == "-" else spread, row["unit"])
    columns, *rows = csv.reader(parts[2].splitlines()[1:])
    return Reference(name, head, certified, tuple(columns), tuple(map(tuple, rows)))
