# SPDX-License-Identifier: Apache-2.0
"""The registry of effects: those of this folder, of installed packages, and of files given by the user.

There is no list: a class added to a file of this folder is discovered. Loading a user's file runs it, so it
is loaded only if the user names it; a model file cannot cause that.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import pkgutil
import sys
import traceback
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import lru_cache
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from smallwheel_ros.common.errors import nearest
from smallwheel_ros.effects import column_laws
from smallwheel_ros.effects.base import Effect, EffectError

Forms = tuple[type[Effect], ...]
Families = Mapping[str, Forms]
Kind = TypeVar("Kind")

PACKAGE = "smallwheel_ros.effects"  # this package; also the group of entry points of other packages

# The laws that any column may drive, and the prefixes of their ids.
_COLUMN_LAWS = [
    law
    for name, law in vars(column_laws).items()
    if isinstance(law, type) and issubclass(law, column_laws.ColumnLaw) and not name.startswith("_")
    if law.prefix and not law.id
]
_PREFIXES = tuple(dict.fromkeys(law.prefix for law in _COLUMN_LAWS))
DRIFTS = tuple(law.prefix for law in _COLUMN_LAWS if law.kind == "instrument")


def _rebuild(id: str, form: str, values: dict[str, float]) -> Effect:
    return next(cls for cls in of_column(id) if cls.form == form)(**values)


class _OfColumn(Effect):
    """Base of the classes that `of_column` makes, so that their instances can be pickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (self.id, self.form, {f.name: getattr(self, f.name) for f in fields(self)})


def is_of_column(id: str) -> bool:
    """Whether an id is `PREFIX:NAME` of a law that any column may drive, such as `covariate:NAME`."""
    return id.partition(":")[0] in _PREFIXES and ":" in id


@lru_cache(maxsize=256)
def of_column(id: str) -> Forms:
    """The forms of the effect `PREFIX:COLUMN`, which that column of the data drives, the default form first.

    Empty for an unknown prefix. Raises EffectError without the name of a column.
    """
    prefix, _, name = id.partition(":")
    if not name:
        raise EffectError(
            f"'{prefix}:' names no column: write {prefix}:NAME, like {prefix}:moisture"
        )
    own = {"id": id, "needs": (name,), "drivers": (name,), "__module__": __name__}
    return tuple(
        type(law.__name__, (law, _OfColumn), own | {
            "form": law.form,
            "summary": law.summary.format(name),
            "next_step": law.next_step.format(name),
        })
        for law in _COLUMN_LAWS
        if law.prefix == prefix
    )  # fmt: skip


def covariate(name: str) -> Forms:
    """Two forms of the effect `covariate:NAME`, k that depends on a column: exponential and power law."""
    return of_column(f"covariate:{name}")


@dataclass(frozen=True)
class Registry(Mapping[str, type[Effect]]):
    """The known effects, as a mapping from ids to classes of the default form: `registry["slip_sinkage"]`.

    Effects of columns (`covariate:NAME`, drifts) are not listed, but can be looked up.

    Attributes
    ----------
    families
        All forms of each effect by its id, in the order of ids; the default form of each comes first.
    """

    families: Families = field(default_factory=dict)

    def __getitem__(self, id: str) -> type[Effect]:
        return self.form(id)

    def __iter__(self) -> Iterator[str]:
        return iter(self.families)

    def __len__(self) -> int:
        return len(self.families)

    def __contains__(self, id: object) -> bool:
        return id in self.families

    def __repr__(self) -> str:
        return f"<effects: {', '.join(self)}>"

    def family(self, id: str) -> Forms:
        """The forms of one effect, the default first; `covariate:NAME` and drifts work for any column.

        Raises EffectError, which names similar ids, if there is no such effect.
        """
        if is_of_column(id):
            return of_column(id)
        if id not in self.families:
            names = [*self.families, *(f"{prefix}:NAME" for prefix in _PREFIXES)]
            raise EffectError(f"no effect '{id}': {nearest(id, names)}")
        return self.families[id]

    def form(self, id: str, form: str | None = None) -> type[Effect]:
        """The class of one form of an effect.

        Parameters
        ----------
        id
            Id of the effect.
        form
            Name of the form; None for the default one.

        Raises
        ------
        EffectError
            If there is no such effect or form.
        """
        known = {cls.form: cls for cls in self.family(id)}
        if form is not None and form not in known:
            raise EffectError(f"effect '{id}' has no form '{form}': {nearest(form, list(known))}")
        return next(iter(known.values())) if form is None else known[form]

    def effect(self, id: str, form: str | None = None, **values: float) -> Effect:
        """Make an effect from its id, form and numbers.

        Parameters
        ----------
        id
            Id of the effect.
        form
            Name of the form; None for the default one.
        values
            Parameters and constants by name, SI units; those not given have their defaults.

        Raises
        ------
        EffectError
            If there is no such effect, form or number, or a number is outside its bounds.
        """
        cls = self.form(id, form)
        names = [f.name for f in fields(cls)]
        for name in (name for name in values if name not in names):
            raise EffectError(
                f"effect '{id}', form '{cls.form}', has no parameter '{name}': "
                f"{nearest(name, names) if names else 'it has none'}"
            )
        return cls(**values)

    def with_file(self, path: str | Path) -> Registry:
        """A registry with the effects of a Python file as well. Runs the file; raises as `load_effects`."""
        return self.with_families(load_effects(path), str(path))

    def with_families(self, user: Families, origin: str = "user's effects") -> Registry:
        """Return a registry with more effects; forms of an id that exists already are appended to its forms.

        Parameters
        ----------
        user
            Forms by id, as from `load_effects`.
        origin
            Where they come from, such as the file, for messages.

        Raises
        ------
        EffectError
            If a class is not a usable effect, or its id has a form of that name already.
        """
        known = dict(self.families)
        for forms in user.values():
            _add(known, forms, origin)
        return Registry(dict(sorted(known.items())))


# --- Where effects come from


@lru_cache(maxsize=1)
def _built_in() -> Families:
    known: dict[str, Forms] = {}
    for info in pkgutil.iter_modules([str(Path(__file__).parent)]):
        module = importlib.import_module(f"{PACKAGE}.{info.name}")
        _add(known, _classes_in(module, Effect), module.__name__)
    return known


@lru_cache(maxsize=1)
def known_physics() -> Forms:
    """Default forms of this package's effects that a model always applies if their columns are present."""
    return tuple(forms[0] for forms in _built_in().values() if forms[0].known_physics)


@lru_cache(maxsize=1)
def default_registry() -> Registry:
    """Effects of this package and of installed ones (entry points in `smallwheel_ros.effects`).

    Raises EffectError where an entry point cannot be loaded; it names the package.
    """
    known = dict(_built_in())
    for point in sorted(entry_points(group=PACKAGE), key=lambda p: (p.name, p.value)):
        origin = f"entry point '{point.name}' ({point.value})"
        if point.dist is not None:
            origin += f" of package {point.dist.name}"
        try:
            loaded = point.load()
        except Exception as error:  # somebody else's package may raise anything at all
            raise EffectError(f"{origin}: {type(error).__name__}: {error}") from error
        if isinstance(loaded, ModuleType):
            _add(known, _some(_classes_in(loaded, Effect), origin), origin)
        elif isinstance(loaded, type) and issubclass(loaded, Effect):
            _add(known, [loaded], origin)
        else:
            raise EffectError(f"{origin}: expected a class derived from Effect, or a module")
    return Registry(dict(sorted(known.items())))


def load(path: str | Path) -> Registry:
    """All effects, with those of a Python file; runs the file, so name only one that you trust.

    Raises EffectError where the file is missing, does not run, or defines no usable effect.
    """
    return default_registry().with_file(path)


def load_effects(path: str | Path) -> Families:
    """Load the effects of a Python file, by id; runs the file, so name only one that you trust.

    Raises EffectError where the file is missing, does not run, or defines no usable effect.
    """
    found: dict[str, Forms] = {}
    _add(found, _some(_classes_in(_run(Path(path)), Effect), str(path)), str(path))
    return found


def load_classes(path: Path, base: type[Kind], what: str) -> list[type[Kind]]:
    """Run a user's Python file, and return its dataclasses that derive from a base class.

    Name only files that you trust.

    Parameters
    ----------
    path
        The file, which is run.
    base
        The base class.
    what
        What such a class is called in messages: "effect", "law".

    Returns
    -------
    list of type
        In the order of the file; effects only if they have an id. Never empty.

    Raises
    ------
    EffectError
        If the file is missing, does not run, or has no usable class.
    """
    found = _some(_classes_in(_run(path, what), base), str(path), what, base.__name__)
    for made in found:
        _check_class(made, f"{path}: class {made.__name__}")
    return found


def _classes_in(module: ModuleType, base: type[Kind]) -> list[type[Kind]]:
    """Public classes of that base that a module defines itself, in its order; effects only with an id."""
    return [
        value
        for name, value in vars(module).items()
        if isinstance(value, type) and issubclass(value, base) and not name.startswith("_")
        if value.__module__ == module.__name__ and getattr(value, "id", True)
    ]


def _some(
    found: list[type[Kind]], origin: str, what: str = "effect", base: str = "Effect and has an id"
) -> list[type[Kind]]:
    if not found:
        raise EffectError(f"{origin}: defines no {what}, expected a class that derives from {base}")
    return found


def _run(path: Path, what: str = "effect") -> ModuleType:
    if not path.is_file():
        raise EffectError(f"{path}: no such file of {what}s")
    name = f"smallwheel_ros_user_{what}s_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise EffectError(f"{path}: expected a Python file, *.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up there
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # a user's file may raise anything at all
        del sys.modules[name]
        line = line_in(error, path)
        raise EffectError(f"{path}{line}: {type(error).__name__}: {error}") from error
    return module


def line_in(error: Exception, path: Path) -> str:
    """The line of a file at which an exception was raised, as `, line 7`, to append to the file's name.

    Parameters
    ----------
    error
        The exception, with its traceback.
    path
        The file.

    Returns
    -------
    str
        The innermost line in that file, or the line of a SyntaxError in it; empty if there is none.
    """
    file = os.path.abspath(path)  # as the import system has it
    if isinstance(error, SyntaxError) and error.filename == file:
        return f", line {error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    numbers = [frame.lineno for frame in frames if frame.filename == file]
    return f", line {numbers[-1]}" if numbers else ""


def _add(known: dict[str, Forms], forms: Iterable[type[Effect]], origin: str) -> None:
    """Check forms and add them to `known` in place. origin: where they come from, for messages."""
    for form in forms:
        where = f"{origin}: class {form.__name__}"
        _check_class(form, where)
        wrong = _wrong(form)
        if wrong:
            raise EffectError(f"{where}{wrong}")
        try:
            form()
        except EffectError as error:
            raise EffectError(f"{where}: {error}") from None
        family = known.get(form.id, ())
        if any(other.form == form.form for other in family):
            raise EffectError(
                f"{origin}: effect '{form.id}' has a form '{form.form}' already; "
                "give the class another name, or a 'form' of its own"
            )
        known[form.id] = (*family, form)


def _check_class(made: type, where: str) -> None:
    if "__dataclass_params__" not in vars(made) or not is_dataclass(made):
        raise EffectError(f"{where} lacks the line '@dataclass(frozen=True)' above it")
    strange = [f.name for f in fields(made) if not {"parameter", "constant"} & f.metadata.keys()]
    if strange:
        raise EffectError(
            f"{where}: '{strange[0]}' is neither a parameter(...) nor a constant(...)"
        )


def _wrong(form: type[Effect]) -> str:
    """What is wrong with the class attributes of an effect, for a message after its name; "" if nothing."""
    if is_of_column(form.id):
        return f": ids like '{form.id}' are made for columns"
    for name in ("needs", "drivers"):
        value = getattr(form, name)
        if not isinstance(value, tuple):
            return f": {name} is {value!r}, expected a tuple of columns, like ('slip',)"
    foreign = set(form.drivers) - {*form.needs, "load", "diameter", "width"}
    if foreign:
        return (
            f": drivers names '{min(foreign)}', expected load, diameter, width or a column "
            "that is in needs, too"
        )
    if form.kind not in ("soil", "instrument"):
        return f": kind is {form.kind!r}, expected 'soil' or 'instrument'"
    if form.side not in (-1, 0, 1):
        return f": side is {form.side!r}, expected -1, 0 or 1"
    if not form.stage:
        return (
            " overrides no stage, so it does nothing; expected one of the methods of "
            "Effect, like modulus_factor or sinkage"
        )
    return ""


# --- By name


def families(user: Families | None = None) -> Families:
    """All forms of each effect by its id, a tuple with the default form first.

    user: further forms by id (`load_effects`), which are included.
    """
    return default_registry().with_families(user or {}).families


def effect_class(
    family: str, form: str | None = None, user: Families | None = None
) -> type[Effect]:
    """Return the class of one form of an effect.

    Parameters
    ----------
    family
        The effect's id.
    form
        Name of the form; None for the default one.
    user
        The user's own forms by id (`load_effects`), in addition to those that are known.

    Raises
    ------
    EffectError
        If there is no such effect or form.
    """
    return default_registry().with_families(user or {}).form(family, form)


def as_effect(given: Effect | type[Effect] | str) -> Effect:
    """Return an effect unchanged, or make one from its class, its id or `id/form`, with default numbers.

    Raises EffectError where it is none of these, or there is no such effect.
    """
    if isinstance(given, Effect):
        return given
    if isinstance(given, type) and issubclass(given, Effect):
        return given()
    if not isinstance(given, str):
        raise EffectError(
            f"found {type(given).__name__}, expected an effect, its class or its id, like "
            "'slip_sinkage'"
        )
    id, _, form = given.partition("/")
    return effect(id, form or None)


def effect(id: str, form: str | None = None, **values: float) -> Effect:
    """Make an effect from its id: `effect("slip_sinkage", a=1.2)`.

    Parameters
    ----------
    id
        Id of the effect.
    form
        Name of the form; None for the default one.
    values
        Parameters and constants by name, SI units; those not given have their defaults.

    Raises
    ------
    EffectError
        If there is no such effect, form or number, or a number is outside its bounds.
    """
    return default_registry().effect(id, form, **values)
