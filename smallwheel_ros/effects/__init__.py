# SPDX-License-Identifier: Apache-2.0
"""Physical effects that a model may lack, with a class for each form; `base` describes how they act.

    effects["slip_sinkage"], effects.slip_sinkage, effects.SlipSinkage    the default form, a class
    list(effects), "hardpan" in effects                                   the ids that exist
    effects.load("mine.py")                                               also those of a file, which it runs

Adding a class to a file of this folder, or a file, adds an effect. No file may have the name of an effect.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from types import ModuleType

from smallwheel_ros.effects.base import Effect, EffectError, Parameter, constant, parameter
from smallwheel_ros.effects.registry import (
    Registry,
    covariate,
    default_registry,
    effect,
    families,
    load,
)

__all__ = [
    "Effect",
    "EffectError",
    "Parameter",
    "Registry",
    "constant",
    "covariate",
    "effect",
    "families",
    "load",
    "parameter",
]


class _Effects(ModuleType):
    """The package as a mapping from ids to effects."""

    def __getitem__(self, id: str) -> type[Effect]:
        return default_registry()[id]

    def __iter__(self) -> Iterator[str]:
        return iter(default_registry())

    def __len__(self) -> int:
        return len(default_registry())

    def __contains__(self, id: object) -> bool:
        return id in default_registry()

    def __dir__(self) -> list[str]:
        return sorted({*__all__, *self})

    def __getattr__(self, name: str) -> type[Effect]:
        if not name.startswith("_"):
            for id, form in default_registry().items():
                if name in (id, "".join(part.capitalize() for part in id.split("_"))):
                    return form
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


sys.modules[__name__].__class__ = _Effects
