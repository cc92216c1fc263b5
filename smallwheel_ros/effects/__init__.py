# SPDX-License-Identifier: Apache-2.0
"""Physical effects that a model may lack, a class for each form; see `base` for how they act.

    effects["slip_sinkage"], effects.slip_sinkage, effects.SlipSinkage    the default form, a class
    list(effects), "hardpan" in effects                                   which there are
    effects.load("mine.py")                                               with those of a file, which is run

Adding a class to a file of this folder, or a file, adds an effect.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

from smallwheel_ros.effects.base import Effect, EffectError, Parameter, constant, parameter

if TYPE_CHECKING:
    from smallwheel_ros.effects.registry import Registry, covariate, effect, families, load

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


def _registry() -> Any:
    return import_module("smallwheel_ros.effects.registry")


class _Effects(ModuleType):
    """The package as a mapping from ids to effects; the registry is imported when it is asked."""

    def __getitem__(self, id: str) -> type[Effect]:
        return _registry().default_registry()[id]  # type: ignore[no-any-return]

    def __iter__(self) -> Iterator[str]:
        return iter(_registry().default_registry())

    def __len__(self) -> int:
        return len(_registry().default_registry())

    def __contains__(self, id: object) -> bool:
        return id in _registry().default_registry()

    def __dir__(self) -> list[str]:
        return sorted({*__all__, *self})

    def __setattr__(self, name: str, value: Any) -> None:
        # Importing a file of this folder would put the file where the effect of that name belongs.
        if not isinstance(value, ModuleType):
            super().__setattr__(name, value)

    def __getattr__(self, name: str) -> Any:
        if name in __all__:
            return getattr(_registry(), name)
        if f"{__name__}.{name}" in sys.modules and name in ("base", "registry"):
            return sys.modules[f"{__name__}.{name}"]
        if not name.startswith("_"):
            for id, form in _registry().default_registry().items():
                if name in (id, "".join(part.capitalize() for part in id.split("_"))):
                    return form
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


sys.modules[__name__].__class__ = _Effects
