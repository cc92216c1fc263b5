# SPDX-License-Identifier: Apache-2.0
"""Arguments by which users give a model or effects, and their conversion."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol, TypeAlias

from smallwheel_ros.arguments import Ids, Kind, names_of, understand
from smallwheel_ros.common.errors import ArgumentError, kind_of, nearest
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.registry import Registry, default_registry, load_effects
from smallwheel_ros.physics.soil import Soil, soil

# A table can be read, and `--help` shown, without models.
if TYPE_CHECKING:
    from smallwheel_ros.model.model import CalibratedModel, Model
    from smallwheel_ros.physics.conditions import Conditions


class HasModel(Protocol):
    """A result of `fit`, `add` or `diagnose`, with its model: None where the data was too little for one."""

    @property
    def model(self) -> CalibratedModel | None:
        """The model, with its uncertainty."""


def _file_or_name(given: str) -> str | Path:
    """The path of a model file, or the text itself, as a soil's name, where there is no such file."""
    if not Path(given).is_file():
        return given
    if given in soil:
        understand(f"--model {given} is the file of that name, not the soil of the library")
    return Path(given)


_Model: TypeAlias = "Model | Soil | HasModel | str | PathLike[str]"
_Effect: TypeAlias = "Effect | type[Effect] | str"

AnyModel = Annotated["_Model", Kind("FILE|SOIL", read=_file_or_name)]
Models = Annotated[
    "_Model | Iterable[_Model] | Mapping[str, _Model]",
    Kind("FILE|SOIL", several=True, names=("--model",),
         read=lambda given: [_file_or_name(one) for one in given]),
]  # fmt: skip
AnyEffect = Annotated["_Effect", Kind(unnamed=True)]
Effects = Annotated["_Effect | Iterable[_Effect]", Kind("A,B", read=names_of)]
OwnEffects = Annotated["Registry | str | PathLike[str]", Kind("FILE", type=Path)]


def registry_of(own: OwnEffects | None) -> Registry:
    """The registry of all effects, with the user's own.

    Parameters
    ----------
    own
        A registry, which is returned unchanged, or a Python file with effects, which is run and adds them to
        the built-in and installed ones; None for these alone.

    Raises
    ------
    ArgumentError
        If it is neither.
    EffectError
        If the file is missing, does not run, or defines no usable effect.
    """
    if own is None:
        return default_registry()
    if isinstance(own, Registry):
        return own
    if isinstance(own, (str, PathLike)):
        return default_registry().with_file(Path(own))
    raise ArgumentError(
        f"effects: found {kind_of(own)}, expected a Python file or what sw.effects.load returns"
    )


def ids_of(without: Ids, known: Registry) -> tuple[str, ...]:
    """Check the ids of effects that a diagnosis is to leave out, and return them as a tuple.

    Parameters
    ----------
    without
        One id, or several; `unknown`, the diagnosis's verdict of an effect that is not in the library, is
        allowed, too.
    known
        Effects that exist.

    Raises
    ------
    EffectError
        For an effect that does not exist.
    """
    names = (without,) if isinstance(without, str) else tuple(without)
    for name in names:
        if name != "unknown":
            known.family(name)
    return names


def model_of(given: AnyModel, known: Registry | None = None) -> CalibratedModel:
    """Turn an argument that stands for a model into a calibrated model.

    Parameters
    ----------
    given
        A model, a soil, the name of a soil of the library, a model file, or a result that has a model. A name
        that is both a soil's and a file's is the soil's; a `Path` is always a file.
    known
        Effects that a model file may name; those of the package and of installed packages if not given.

    Returns
    -------
    CalibratedModel
        With the uncertainty that the file or result states; with an unknown one (no `names`) for a plain
        model or a soil.

    Raises
    ------
    ArgumentError, ModelFileError
        If it is none of these (a result whose model is None included), or the file cannot be used.
    """
    from smallwheel_ros.model.model import CalibratedModel, Model
    from smallwheel_ros.model.model_file import as_calibrated, read_model

    of_result = getattr(given, "model", None)
    if isinstance(of_result, CalibratedModel):
        return of_result
    if isinstance(given, Model):
        return as_calibrated(given)
    if isinstance(given, Soil) or (isinstance(given, str) and given in soil):
        return CalibratedModel(Model(given))
    if isinstance(given, str) and not Path(given).suffix and not Path(given).exists():
        raise ArgumentError(
            f"model: '{given}' is neither a file nor a soil: {nearest(given, list(soil))}"
        )
    if isinstance(given, (str, PathLike)):
        return read_model(Path(given), known)
    raise ArgumentError(
        f"model: found {kind_of(given)}, expected a Model, a model file, a soil or a result that has a model"
    )


def effects_of(
    given: Effects, conditions: Conditions, known: Registry | None = None
) -> list[Effect]:
    """Turn an argument that stands for effects into the effects from which a fit starts.

    Parameters
    ----------
    given
        Ids, effects, classes of effects or Python files with them; one or several.
    conditions
        Conditions of the measurements, from which a constant that only scales an effect, such as a reference
        speed, is set (`Effect.suited_to`), unless the user gave the effect as an instance.
    known
        Effects that an id may name; those of the package and of installed packages if not given.

    Returns
    -------
    list of Effect
        One for each id, class or instance given. Ids may be those of effects in a Python file that is given;
        if none of them is, all effects of the file are returned, each in its first form.

    Raises
    ------
    ArgumentError
        If an entry is none of these.
    EffectError
        If there is no such effect, or a file cannot be used.
    """
    listed: list[Any] = (
        [given] if isinstance(given, (str, Effect, type)) else list_of("effects", given)
    )
    known, made = known or default_registry(), []
    for one in listed:
        if isinstance(one, str) and one.endswith(".py"):
            theirs = load_effects(one)
            known = known.with_families(theirs, one)
            if not set(theirs) & {str(other).partition("/")[0] for other in listed}:
                listed += [f"{id}/{forms[0].form}" for id, forms in sorted(theirs.items())]
    for one in listed:
        if isinstance(one, str) and not one.endswith(".py"):
            id, _, form = one.partition("/")
            one = known.form(id, form or None)
        if isinstance(one, type) and issubclass(one, Effect):
            made.append(one.suited_to(conditions))
        elif isinstance(one, Effect):
            made.append(one)
        elif not isinstance(one, str):
            raise ArgumentError(
                f"effects: found {kind_of(one)}, expected ids or classes of effects"
            )
    return made


def list_of(name: str, given: Any) -> list[Any]:
    """Return the items of an argument as a list.

    Parameters
    ----------
    name
        Name of the argument, for the error message.
    given
        Anything that can be iterated over; a string gives its characters, a mapping its keys.

    Raises
    ------
    ArgumentError
        If it cannot be iterated over, such as a single number.
    """
    try:
        return list(given)
    except TypeError:
        raise ArgumentError(f"{name}: found {kind_of(given)}, expected one or several") from None
