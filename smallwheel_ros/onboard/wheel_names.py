# SPDX-License-Identifier: Apache-2.0
"""Reading of the names of wheels, joints and topics, and naming of wheels.

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
_ROW = 0.15  # of the distance from the foremost to the rearmost wheel: nearer ones are in one row
_MIDDLE = 0.1  # of the widest track: a wheel nearer to the middle is on no side
_THICK = 0.01  # m: a wheel nearer to the middle is on no side, however narrow the vehicle is


def usual_names(count: int) -> list[str]:
    """Return usual names for a number of wheels, such as front_left, or wheel_1 and so on."""
    return list(_OF.get(count, [f"wheel_{i}" for i in range(1, count + 1)]))


def words_of(name: str) -> set[str]:
    """Return the words of a name in lower case; short forms of places are spelled out.

    An R that may be rear or right is both.
    """
    return _read(name)[0]


def place_of(name: str) -> set[str]:
    """Return those words of a name that show a wheel's place: front, middle, rear, left, right.

    An R that may be rear or right is left out.
    """
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
    """Choose the topic or joint whose name is most similar to that of an input.

    Parameters
    ----------
    wheel
        Name of the wheel, or of an input of the vehicle.
    kind
        What the wheel's input measures, such as `sinkage`; empty for an input of the vehicle.
    names
        Topics or joints to choose from.

    Returns
    -------
    str or None
        One of the names; None if none is similar, or two are equally so.
    """
    scored = sorted(((_likeness(wheel, kind, name), name) for name in names), reverse=True)
    if not scored or scored[0][0] < _FAIR:
        return None
    if len(scored) > 1 and scored[1][0] == scored[0][0]:
        return None  # nothing tells the two apart
    return scored[0][1]


def only_or_best_match(name: str, names: Sequence[str]) -> str | None:
    """Choose a topic for an input of the vehicle: the only one, or the one most similar by name.

    Parameters
    ----------
    name
        Name of the input, such as `odom`.
    names
        Topics to choose from.

    Returns
    -------
    str or None
        One of the names; None if none of several is similar, or two are equally so.
    """
    return names[0] if len(names) == 1 else best_match(name, "", names)


def _likeness(wheel: str, kind: str, name: str) -> float:
    """Similarity, 0 to 1, of a topic's or joint's name to that of an input; arguments as in `best_match`."""
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
    """Name wheels, given a topic or joint of each.

    A wheel is named by its place, such as `front_left`, as shown by the name of its topic or joint, or by
    its position if the names do not show the places of all wheels; otherwise by the words in which the names
    differ, or by numbers.

    Parameters
    ----------
    names
        Topics or joints, one for each wheel.
    where
        Position of the wheel of each topic or joint, m: x ahead and y to the left; None if unknown.

    Returns
    -------
    dict
        Topic or joint by the wheel's name, front before rear and left before right.
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
    """Words of several names; an unclear R is right, or rear if others show front and none left alone."""
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
    """Name wheels after their positions.

    Parameters
    ----------
    where
        Positions by any identifier of the wheels: x ahead and y to the left, m.

    Returns
    -------
    dict or None
        Names such as `front_left`, by the same identifiers; None if two wheels would have one name, or a
        wheel none.
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
    """Key by which wheels' names are sorted: front before rear, left before right."""
    words = wheel.split("_")
    return tuple(PLACES.index(word) if word in PLACES else len(PLACES) for word in words)
