# SPDX-License-Identifier: Apache-2.0
"""Names of wheels, and how much the name of a topic or joint looks like that of a wheel's input."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from difflib import SequenceMatcher

_SHORT = {
    "f": ("front",), "r": ("rear", "right"), "l": ("left",), "b": ("rear",), "m": ("middle",),
    "fl": ("front", "left"), "fr": ("front", "right"), "lf": ("front", "left"),
    "rf": ("front", "right"), "rl": ("rear", "left"), "rr": ("rear", "right"),
    "bl": ("rear", "left"), "br": ("rear", "right"), "lr": ("rear", "left"),
    "ml": ("middle", "left"), "mr": ("middle", "right"), "back": ("rear",), "hind": ("rear",),
    "mid": ("middle",), "centre": ("middle",), "center": ("middle",),
}  # fmt: skip
_PLACES = ("front", "middle", "rear", "left", "right")  # in the order in which a name has them
_OF = {
    1: ("wheel",),
    2: ("left", "right"),
    3: ("front", "rear_left", "rear_right"),
    4: ("front_left", "front_right", "rear_left", "rear_right"),
    6: ("front_left", "front_right", "middle_left", "middle_right", "rear_left", "rear_right"),
}
_FAIR = 0.5


def usual_names(count: int) -> list[str]:
    """Names of so many wheels."""
    return list(_OF.get(count, [f"wheel_{i}" for i in range(1, count + 1)]))


def words_of(name: str) -> set[str]:
    """Words of a name; short forms of places are spelled out."""
    found: set[str] = set()
    for word in re.findall(r"[a-z]+|\d+", re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower()):
        found.update(_SHORT.get(word, (word,)))
    return found


def best_match(wheel: str, kind: str, names: Iterable[str]) -> str | None:
    """The name that looks most like that of a wheel's input; None where none does, or two alike."""
    scored = sorted(((_likeness(wheel, kind, name), name) for name in names), reverse=True)
    if not scored or scored[0][0] < _FAIR:
        return None
    if len(scored) > 1 and scored[1][0] == scored[0][0]:
        return None  # nothing tells the two apart
    return scored[0][1]


def only_or_best_match(name: str, names: Sequence[str]) -> str | None:
    """The only one of these names, or the one that looks most like an input of the vehicle."""
    return names[0] if len(names) == 1 else best_match(name, "", names)


def _likeness(wheel: str, kind: str, name: str) -> float:
    """How much a topic's or joint's name looks like that of a wheel's input; 0 to 1."""
    wanted, there = words_of(wheel), words_of(name)
    places, others = wanted & {*_PLACES}, there & {*_PLACES}
    if others - places and places - others:
        return 0.0  # the place of another wheel
    share = len(wanted & there) / max(len(wanted), 1)
    letters = SequenceMatcher(None, f"{wheel}/{kind}", name.strip("/")).ratio()
    return 0.7 * share + 0.3 * letters


def wheels_named_by(names: Sequence[str]) -> dict[str, str]:
    """By wheel, the one of these topics or joints that is of it: each is of another wheel.

    A wheel is called by its place where the names tell it, else by the words that tell them apart.
    """
    words = {name: words_of(name) for name in names}
    found = {name: "_".join(p for p in _PLACES if p in words[name]) for name in names}
    if not all(found.values()) or len({*found.values()}) < len(names):
        common = set.intersection(*words.values()) if len(names) > 1 else {*words[names[0]]}
        found = {name: "_".join(sorted(words[name] - common)) for name in names}
    if len({*found.values()}) < len(names) or not all(found.values()):
        found = dict(zip(names, usual_names(len(names)), strict=True))
    called = {
        name: wheel if wheel[0].isalpha() else f"wheel_{wheel}" for name, wheel in found.items()
    }
    return {called[name]: name for name in sorted(names, key=lambda n: _order(called[n]))}


def _order(wheel: str) -> tuple[int, ...]:
    """Front before rear, left before right."""
    words = wheel.split("_")
    return tuple(_PLACES.index(word) if word in _PLACES else len(_PLACES) for word in words)
