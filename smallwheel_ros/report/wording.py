# SPDX-License-Identifier: Apache-2.0
"""Text as a reader writes it: names of the program in words, commands as code, powers of ten."""

from __future__ import annotations

import re
from functools import lru_cache
from html import escape

from smallwheel_ros.effects.registry import default_registry
from smallwheel_ros.measurements.columns import COLUMNS
from smallwheel_ros.measurements.display import words
from smallwheel_ros.model.model_file import SOIL_PARAMETERS
from smallwheel_ros.physics.plates import LAWS

_LAW_NAMES: dict[str, str] = {law.id: law.name for law in LAWS}
# What stands in quotes is to be written as it is (a column's header), and so is a command.
_LEFT_AS_IT_IS = re.compile(r"(`[^`]*`|'[^'\s]*')")
_COMMAND = re.compile(r"`([^`]+)`")
_OWNED = re.compile(r"(?<![\w./])([A-Za-z][\w-]*)\.([a-z]\w*)(?![\w(/]|\.\w)")
_POWER = re.compile(r"(?<![\w.])(-?\d+(?:\.\d+)?)e([+-]\d+)(?!\w)")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def in_words(text: str) -> str:
    """Columns, effects, forms, parameters and laws in words: `rig_sand.cohesion` is cohesion of rig_sand.

    Names that are not the program's stay, and so does what stands in quotes or is a command.
    """
    parts = _LEFT_AS_IT_IS.split(text)
    return "".join(part if i % 2 else _plain(part) for i, part in enumerate(parts))


def inline(text: str) -> str:
    """The text as HTML: escaped, in words, `commands` as code, 1.6e+07 as 1.6·10⁷."""
    parts = _COMMAND.split(text)
    return "".join(
        f"<code>{escape(part)}</code>"
        if i % 2
        else escape(powers(in_words(part)).replace(" -> ", " → "))
        for i, part in enumerate(parts)
    )


def powers(text: str) -> str:
    """Numbers with an exponent as people write them: 1.6e+07 is 1.6·10⁷."""
    return _POWER.sub(lambda n: f"{n[1]}·10{str(int(n[2])).translate(_RAISED)}", text)


def _plain(text: str) -> str:
    ids, names = _known()

    def parameter(found: re.Match[str]) -> str:
        owner, name = found.groups()
        known = owner in ids or name in SOIL_PARAMETERS
        return f"{name} of {owner}" if known else found[0]

    text = _OWNED.sub(parameter, text)
    return names.sub(lambda found: _LAW_NAMES.get(found[0]) or words(found[0]), text)


@lru_cache(maxsize=1)
def _known() -> tuple[frozenset[str], re.Pattern[str]]:
    """Ids of effects; a pattern of the program's names that are written with an underscore."""
    registry = default_registry()
    forms = [form for id in registry for form in registry.family(id)]
    ids = frozenset(form.id for form in forms)
    every = {*COLUMNS, *SOIL_PARAMETERS, *ids, *(form.form for form in forms)}
    compound = {*_LAW_NAMES, *(name for name in every if "_" in name)}
    names = sorted(compound, key=len, reverse=True)
    return ids, re.compile(rf"(?<![\w./])(?:{'|'.join(map(re.escape, names))})(?![\w/]|\.\w)")
