"""Which effects there are: the files of this folder, installed entry points, and files you name."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import pkgutil
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib.metadata import entry_points
from pathlib import Path
from types import MappingProxyType, ModuleType

from smallwheel_ros import effects as package
from smallwheel_ros.effects.base import Effect, EffectError
from smallwheel_ros.effects.covariate import covariate
from smallwheel_ros.soil import nearest

Families = Mapping[str, tuple[type[Effect], ...]]

ENTRY_POINT_GROUP = "smallwheel_ros.effects"
_COVARIATE = "covariate:"


def _classes(module: ModuleType) -> list[type[Effect]]:
    """The effects that a module defines itself, in the order of its text."""
    own = (value for value in vars(module).values() if inspect.isclass(value))
    return [
        value
        for value in own
        if issubclass(value, Effect) and value.__module__ == module.__name__ and value.id
    ]


def _group(classes: Sequence[type[Effect]]) -> dict[str, tuple[type[Effect], ...]]:
    grouped: dict[str, dict[str, type[Effect]]] = {}
    for effect_class in classes:
        grouped.setdefault(effect_class.id, {})[effect_class.form] = effect_class
    return {family: tuple(forms.values()) for family, forms in grouped.items()}


@lru_cache(maxsize=1)
def built_in() -> Families:
    """The families of this package and of installed entry points, by id, forms in order."""
    classes: list[type[Effect]] = []
    for info in sorted(pkgutil.iter_modules(package.__path__), key=lambda m: m.name):
        if info.name not in ("base", "registry"):
            classes += _classes(importlib.import_module(f"{package.__name__}.{info.name}"))
    for point in entry_points(group=ENTRY_POINT_GROUP):
        loaded = point.load()
        if isinstance(loaded, ModuleType):
            classes += _classes(loaded)
        elif inspect.isclass(loaded) and issubclass(loaded, Effect):
            classes.append(loaded)
    return MappingProxyType(_group(classes))


def load_effects(path: str | Path) -> Families:
    """The effects of a user's Python file. This runs the file: name only files that you trust.

    Raises EffectError where the file is missing, does not run, or defines no effect.
    """
    file = Path(path)
    if not file.is_file():
        raise EffectError(f"{file}: no such file; expected a Python file that defines an effect")
    spec = importlib.util.spec_from_file_location(f"smallwheel_user_{file.stem}", file)
    if spec is None or spec.loader is None:
        raise EffectError(f"{file}: not a Python file; its name must end in .py")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise EffectError(f"{file}: does not run: {type(error).__name__}: {error}") from error
    found = _classes(module)
    if not found:
        raise EffectError(
            f"{file}: defines no effect; expected a class that derives from Effect and has an id"
        )
    return _group(found)


def families(user: Families | None = None) -> dict[str, tuple[type[Effect], ...]]:
    """Every family of effects by id; a user's family of the same id comes instead of ours."""
    return {**built_in(), **(user or {})}


def forms(family: str, user: Families | None = None) -> tuple[type[Effect], ...]:
    """The forms of one family, `covariate:NAME` included; an unknown one raises EffectError."""
    known = families(user)
    if family in known:
        return known[family]
    if family.startswith(_COVARIATE) and len(family) > len(_COVARIATE):
        return covariate(family[len(_COVARIATE) :])
    listing = nearest(family, [*known, f"{_COVARIATE}NAME"])
    raise EffectError(f"no effect '{family}': {listing}")


def effect_class(
    family: str, form: str | None = None, user: Families | None = None
) -> type[Effect]:
    """One form of a family, the first where none is named."""
    available = forms(family, user)
    if form is None:
        return available[0]
    for candidate in available:
        if candidate.form == form:
            return candidate
    names = nearest(form, [c.form for c in available])
    raise EffectError(f"effect '{family}' has no form '{form}': {names}")
