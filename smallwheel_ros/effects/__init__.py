"""Physical effects that a model may lack, one file each; see `base` for how they act.

The default form of each family is here under its name: `from smallwheel_ros.effects import
SlipSinkage`; `families()` has all of them, and adding a file to this folder adds an effect.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from smallwheel_ros.effects.base import Effect, EffectError, Parameter, constant, parameter

if TYPE_CHECKING:
    from smallwheel_ros.effects.registry import Registry, covariate, effect, families

__all__ = [
    "Effect",
    "EffectError",
    "Parameter",
    "Registry",
    "constant",
    "covariate",
    "effect",
    "families",
    "parameter",
]


def __getattr__(name: str) -> Any:  # found by looking through the folder: no list to keep
    registry = import_module("smallwheel_ros.effects.registry")
    if name in ("Registry", "covariate", "effect", "families"):
        return getattr(registry, name)
    if not name.startswith("_"):
        for id, forms in registry.families().items():
            if name == "".join(part.capitalize() for part in id.split("_")):
                return forms[0]
    raise AttributeError(f"module 'smallwheel_ros.effects' has no attribute '{name}'")
