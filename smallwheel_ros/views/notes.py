# SPDX-License-Identifier: Apache-2.0
"""Notes of a fit for people: notes of one kind are one line with a list."""

from __future__ import annotations

import re
from collections.abc import Iterable

from smallwheel_ros.measurements.display import sentence

_ABOUT = re.compile(r"(?P<name>[\w:]+\.\w+) (?P<is>is .+)", re.DOTALL)
_TIED = re.compile(r"(?P<name>\S+ and \S+) are tied \((?P<how>[^)]*)\): (?P<rest>.+)", re.DOTALL)


def grouped(notes: Iterable[str]) -> list[str]:
    """The notes as sentences, without repetitions, ordered by the first note of each kind."""
    kinds: dict[tuple[str, str], list[str]] = {}
    for note in dict.fromkeys(map(str, notes)):
        if about := _ABOUT.fullmatch(note):
            kinds.setdefault(("is", about["is"]), []).append(about["name"])
        elif tied := _TIED.fullmatch(note):
            kinds.setdefault(("tied", tied["rest"]), []).append(f"{tied['name']} ({tied['how']})")
        else:
            kinds.setdefault(("", note), [])
    return [_line(kind, rest, names) for (kind, rest), names in kinds.items()]


def _line(kind: str, rest: str, names: list[str]) -> str:
    if kind == "is":
        said = rest if len(names) == 1 else f"are {rest.removeprefix('is ')}"
        line = f"{_listed(names)} {said}"
    elif kind == "tied":
        line = f"Tied are {'; '.join(names)}: {rest}"
    else:
        return sentence(rest)
    return line if line.endswith((".", "!")) else f"{line}."


def _listed(names: list[str]) -> str:
    """`a, b and c`: names as they stand in a file."""
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last
