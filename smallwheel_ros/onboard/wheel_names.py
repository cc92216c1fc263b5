# SPDX-License-Identifier: Apache-2.0
"""How names of wheels, joints and topics are understood, and how wheels are named.

A name shows the place of a wheel in full words, or in letters: FL, lf, L, R, F. A letter with two
meanings (R: rear, right) has the one that is compatible with its neighbours.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from difflib import SequenceMatcher

ALONG, ACROSS = ("front", "middle", "rear"), ("left", "right")
PLACES = (*ALONG, *ACROSS)  # in the order in which a name has them
_WORDS = {
    "front": "front", "middle": "middle", "rear": "rear", "left": "left", "right": "right",
    "back": "rear", "hind": "rear", "re": "rear", "mid": "middle", "centre": "middle",
    "center": "middle", "lt": "left", "rt": "right", "f": "front", "b": "rear", "m": "middle",
    "l": "left",
}  # fmt: skip
_LETTERS = {"f": "front", "m": "middle", "c": "middle", "b": "rear", "r": "rear"}
_SIDES = {"l": "left", "r": "right"}
# Two letters, a place along the vehicle and one across it, in either order: lr is left and rear.
_PAIRS = {
    pair: (along, across)
    for a, along in _LETTERS.items()
    for b, across in _SIDES.items()
    for pair in (a + b, b + a)
} | {"lr": ("rear", "left"), "rl": ("rear", "left")}
# Words that names have without anything between them: frontleft, leftwheel.
_JOINED = re.compile(
    r"(front|middle|rear|back|hind|left|right|wheel|drive|joint|motor|steering|steer|link)"
)
_OF = {
    1: ("wheel",),
    2: ("left", "right"),
    3: ("front", "rear_left", "rear_right"),
    4: ("front_left", "front_right", "rear_left", "rear_right"),
    6: ("front_left", "front_right", "middle_left", "middle_right", "rear_left", "rear_right"),
}
_FAIR = 0.5
_ROW = 0.15  # of the distance between the foremost and the rearmost wheel: less is one row, on rockers too
_MIDDLE = 0.1  # of the widest track: a wheel nearer to the middle is on no side
_THICK = 0.01  # m: less beside the middle is none


def usual_names(count: int) -> list[str]:
    """Names for a number of wheels."""
    return list(_OF.get(count, [f"wheel_{i}" for i in range(1, count + 1)]))


def words_of(name: str) -> set[str]:
    """Words of a name; short forms of places are spelled out, R alone is rear and right."""
    return _read(name)[0]


def place_of(name: str) -> set[str]:
    """Words of a name that show a wheel's place; an R that may be rear or right is left out."""
    words, open_ = _read(name)
    return (words - {"rear", "right"} if open_ else words) & {*PLACES}


def _read(name: str) -> tuple[set[str], bool]:
    """Words of a name, and whether it has an R that may be rear or right."""
    spaced = re.sub(r"([a-z])([A-Z])", r"\1_\2", name)
    spaced = re.sub(r"([A-Z])([A-Z][a-z])", r"\1_\2", spaced).lower()
    tokens = []
    for token in re.findall(r"[a-z]+|\d+", spaced):
        parts = [part for part in _JOINED.split(token) if part]
        # Letters that are left beside such a word are those of a longer word.
        tokens += parts if all(map(_JOINED.fullmatch, parts)) else [token]
    found = {_WORDS.get(token, token) for token in tokens if token not in {"r", *_PAIRS}}
    for token in tokens:
        if token in _PAIRS:  # fr_left: the front
            along, across = _PAIRS[token]
            found.add(along)
            found.update(set() if found & {*ACROSS} else {across})
    letters = tokens.count("r")
    if letters == 0:
        return found, False
    if letters > 1:
        return found | {"rear", "right"}, False
    in_row, on_side = bool(found & {*ALONG}), bool(found & {*ACROSS})
    if in_row != on_side:
        return found | {"right" if in_row else "rear"}, False
    return found | {"rear", "right"}, True


def best_match(wheel: str, kind: str, names: Iterable[str]) -> str | None:
    """Choose the name most similar to that of a wheel's input; None if none is, or two equally.

    Parameters
    ----------
    wheel
        The wheel's name.
    kind
        What the input is, such as `sinkage`; empty for an input of the vehicle.
    names
        Topics or joints to choose from.
    """
    scored = sorted(((_likeness(wheel, kind, name), name) for name in names), reverse=True)
    if not scored or scored[0][0] < _FAIR:
        return None
    if len(scored) > 1 and scored[1][0] == scored[0][0]:
        return None  # nothing tells the two apart
    return scored[0][1]


def only_or_best_match(name: str, names: Sequence[str]) -> str | None:
    """Choose the only one of some names, or the one most similar to an input of the vehicle.

    Parameters
    ----------
    name
        Name of the input, such as `odom`.
    names
        Topics to choose from.
    """
    return names[0] if len(names) == 1 else best_match(name, "", names)


def _likeness(wheel: str, kind: str, name: str) -> float:
    """How much a topic's or joint's name looks like that of a wheel's input; 0 to 1."""
    wanted, there = words_of(wheel), words_of(name)
    places, others = wanted & {*PLACES}, there & {*PLACES}
    if others - places and places - others:
        return 0.0  # the place of another wheel
    share = len(wanted & there) / max(len(wanted), 1)
    letters = SequenceMatcher(None, f"{wheel}/{kind}", name.strip("/")).ratio()
    return 0.7 * share + 0.3 * letters


def wheels_named_by(
    names: Sequence[str], where: Mapping[str, tuple[float, float]] | None = None
) -> dict[str, str]:
    """Name each wheel after its topic or joint; each of these belongs to another wheel.

    A wheel is named by its place: as its topic's or joint's name shows it or, if names show less, as in
    `where`; otherwise by the words in which the names differ.

    Parameters
    ----------
    names
        Topics or joints.
    where
        Place of each topic's or joint's wheel, m: x ahead and y to the left.
    """
    words = _words_of_all(names)
    found = {name: "_".join(p for p in PLACES if p in words[name]) for name in names}
    placed = called_by_place(where) if where else None
    unclear = not all(found.values()) or len({*found.values()}) < len(names)
    if placed is not None and (
        unclear or all({*placed[name].split("_")} >= words[name] & {*PLACES} for name in names)
    ):
        found = placed
    elif unclear:
        common = set.intersection(*words.values()) if len(names) > 1 else {*words[names[0]]}
        found = {name: "_".join(sorted(words[name] - common)) for name in names}
    if len({*found.values()}) < len(names) or not all(found.values()):
        found = dict(zip(names, usual_names(len(names)), strict=True))
    called = {
        name: wheel if wheel[0].isalpha() else f"wheel_{wheel}" for name, wheel in found.items()
    }
    return {called[name]: name for name in sorted(names, key=lambda n: _order(called[n]))}


def _words_of_all(names: Sequence[str]) -> dict[str, set[str]]:
    """Words of names that occur together: R is right next to an L, rear next to an F."""
    words = {name: words_of(name) for name in names}
    places = {name: place_of(name) for name in names}
    for name in names:
        if not _read(name)[1]:
            continue
        others = [places[other] for other in names if other != name]
        fore = not any(other == {"left"} for other in others) and any("front" in o for o in others)
        words[name].discard("right" if fore else "rear")
    return words


def called_by_place(where: Mapping[str, tuple[float, float]]) -> dict[str, str] | None:
    """Name wheels after their places; None if that does not give each a name of its own.

    Parameters
    ----------
    where
        Places by any identifier: x ahead and y to the left, m.
    """
    ahead = sorted(x for x, _ in where.values())
    wide = max(_THICK, *(abs(y) for _, y in where.values()))
    apart = _ROW * (ahead[-1] - ahead[0]) + 1e-6
    begins = [x for x, before in zip(ahead, [-1e9, *ahead], strict=False) if x - before > apart]
    rows = {1: ("",), 2: ("front", "rear"), 3: ALONG}.get(len(begins))
    if rows is None:
        return None
    found = {}
    for name, (x, y) in where.items():
        row = rows[::-1][sum(x >= begin for begin in begins) - 1]
        side = "" if abs(y) < _MIDDLE * wide else "left" if y > 0.0 else "right"
        found[name] = "_".join(filter(None, (row, side)))
    return found if all(found.values()) and len({*found.values()}) == len(found) else None


def _order(wheel: str) -> tuple[int, ...]:
    """Front before rear, left before right."""
    words = wheel.split("_")
    return tuple(PLACES.index(word) if word in PLACES else len(PLACES) for word in words)
