# SPDX-License-Identifier: Apache-2.0
"""Fields of settings that are options of `smallwheel simulate`: each says its text and its range."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple, get_type_hints

from smallwheel_ros.simulate.truth import check_range


class Option(NamedTuple):
    """What makes an option of a field of settings.

    within: its lowest and highest value, and their unit. words: what `click.option` cannot take from
    the field's default.
    """

    text: str | None = None
    within: tuple[Any, ...] = ()
    words: Mapping[str, Any] = MappingProxyType({})


Seed = Annotated[int, Option("Same seed, same data.", (0, 2**63 - 1))]
Strength = Annotated[float, Option("Factor on the size of the hidden effects.", (0.0, 10.0))]
FRACTION = {"metavar": "FRACTION"}


def options_of(settings: type) -> dict[str, Option]:
    """Return the options among the fields of settings, by name."""
    hints = get_type_hints(settings, include_extras=True)
    found = {name: getattr(hint, "__metadata__", (None,))[0] for name, hint in hints.items()}
    return {name: option for name, option in found.items() if isinstance(option, Option)}


def check_ranges(settings: Any) -> None:
    """Raise `SimulationError` for the first setting that is outside its range."""
    for name, option in options_of(type(settings)).items():
        if option.within:
            check_range(name.replace("_", " "), getattr(settings, name), *option.within)
