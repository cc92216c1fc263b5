# SPDX-License-Identifier: Apache-2.0
"""What users may give to a public function, and what the library makes of it.

Numbers may be given as people type them on a command line: `60`, `20:140:10`, `0.1,0.2`, `17 cm`, `30%`.
Each is read as a cell of a table is, its unit as that of a header.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smallwheel_ros.common.errors import SmallwheelError, nearest
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.registry import Registry, default_registry
from smallwheel_ros.measurements.cells import TWO_WAYS, read_numbers
from smallwheel_ros.measurements.columns import (
    COLUMNS,
    OTHER,
    UnitsError,
    shown_unit,
    spelled,
    to_base,
    unit_of,
)
from smallwheel_ros.measurements.headers import near_miss
from smallwheel_ros.physics.soil import Soil, soil

# What a command's `--help` does not need is imported by the functions that do.
if TYPE_CHECKING:
    import pandas as pd

    from smallwheel_ros.compare.contenders import Contender
    from smallwheel_ros.diagnosis.apply import Added
    from smallwheel_ros.diagnosis.pipeline import Diagnosis
    from smallwheel_ros.fitting import FitResult
    from smallwheel_ros.lab.lab import LabFit
    from smallwheel_ros.measurements.table import Measurements, ShearTests
    from smallwheel_ros.model.model import Model
    from smallwheel_ros.model.model_file import CalibratedModel

    # The kinds of arguments; `commands.from_signature` makes an option of each.
    Data: TypeAlias = Measurements | str | PathLike[str] | pd.DataFrame
    Tests: TypeAlias = Data | ShearTests | Sequence[Data | ShearTests]
    Headers: TypeAlias = Mapping[str, str]
    Sheets: TypeAlias = str | int | Sequence[str | int]
    WithModel: TypeAlias = FitResult | LabFit | Diagnosis | Added
    AnyModel: TypeAlias = Model | Soil | WithModel | str | PathLike[str]
    Models: TypeAlias = AnyModel | Iterable[AnyModel] | Mapping[str, AnyModel]
    AnyEffect: TypeAlias = Effect | type[Effect] | str
    Effects: TypeAlias = AnyEffect | Iterable[AnyEffect]
    OwnEffects: TypeAlias = Registry | str | PathLike[str]
    Ids: TypeAlias = str | Collection[str]
    Levels: TypeAlias = Mapping[str, Sequence[float]]
    Setting: TypeAlias = float | str | Sequence[float] | ArrayLike

Array = NDArray[np.float64]

_MODELS = "a Model, a model file, a soil or a result that has a model"
_MOST = 100_000
_EXPECTED = "a number, start:stop:step or a list a,b,c"
# A number as a cell may have it, and what stands behind it.
_NUMBER = re.compile(
    r"\s*([-+\u2212\u2012\u2013]?[0-9]*(?:[ '\u2019\u00a0\u202f][0-9]{3}(?![0-9]))*[0-9.,]*"
    r"(?:(?<=[0-9.,])[eE][-+]?[0-9]+)?)(.*)",
    re.DOTALL,
)


class ArgumentError(SmallwheelError):
    """An argument of a public function that is of another kind than it takes."""


class RangeError(SmallwheelError):
    """A number or range that cannot be read."""


def kind(value: object) -> str:
    """What was given, by the name of its type."""
    return "nothing" if value is None else type(value).__name__


def registry_of(own: OwnEffects | None) -> Registry:
    """All effects, with those of your own. Raises ArgumentError, EffectError."""
    if own is None:
        return default_registry()
    if isinstance(own, Registry):
        return own
    if isinstance(own, (str, PathLike)):
        return default_registry().with_file(Path(own))
    raise ArgumentError(
        f"effects: found {kind(own)}, expected a Python file or what sw.effects.load returns"
    )


def ids_of(without: Ids, known: Registry) -> tuple[str, ...]:
    """Ids of effects, `unknown` among them. Raises EffectError for one that does not exist."""
    names = (without,) if isinstance(without, str) else tuple(without)
    for name in names:
        if name != "unknown":
            known.family(name)
    return names


def model_of(given: AnyModel, known: Registry | None = None) -> CalibratedModel:
    """The model that was given, with what is known of its uncertainty. known: effects of a model file.

    Raises ArgumentError, ModelFileError.
    """
    from smallwheel_ros.model.model import Model
    from smallwheel_ros.model.model_file import CalibratedModel, as_calibrated, read_model

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
    raise ArgumentError(f"model: found {kind(given)}, expected {_MODELS}")


def effects_of(given: Effects, measurements: Measurements) -> list[Effect]:
    """Effects to start a fit from: what only scales is set from the data where it is not given."""
    listed: list[Any] = (
        [given] if isinstance(given, (str, Effect, type)) else _listed("effects", given)
    )
    known, made = default_registry(), []
    for one in listed:
        if isinstance(one, str) and one.endswith(".py"):
            before, known = set(known), known.with_file(one)
            theirs = set(known) - before
            if not theirs & {str(other).partition("/")[0] for other in listed}:
                listed += sorted(theirs)  # no law of the file is named: all are meant
    for one in listed:
        if isinstance(one, str) and not one.endswith(".py"):
            id, _, form = one.partition("/")
            one = known.form(id, form or None)
        if isinstance(one, type) and issubclass(one, Effect):
            made.append(one.suited_to(measurements.conditions))
        elif isinstance(one, Effect):
            made.append(one)
        elif not isinstance(one, str):
            raise ArgumentError(f"effects: found {kind(one)}, expected ids or classes of effects")
    return made


def _listed(name: str, given: Any) -> list[Any]:
    try:
        return list(given)
    except TypeError:
        raise ArgumentError(f"{name}: found {kind(given)}, expected one or several") from None


def contenders_of(models: Models, known: Registry) -> list[Contender]:
    """One contender for each model, each under a name of its own."""
    from smallwheel_ros.compare.contenders import STANDARD, Contender
    from smallwheel_ros.model.model import Model

    if isinstance(models, Mapping):
        named = [(str(name), model) for name, model in models.items()]
    else:
        single = isinstance(models, (str, PathLike, Model, Soil)) or hasattr(models, "model")
        listed = [models] if single else _listed("models", models)
        named = [("", model) for model in listed]
    found: list[Contender] = []
    for name, given in named:
        read_one, taken = model_of(given, known), [*STANDARD, *(c.name for c in found)]
        of_library = isinstance(given, str) and given in soil
        file = str(given) if isinstance(given, (str, PathLike)) and not of_library else ""
        name = name or (str(given) if of_library else Path(file).stem) or "model"
        if name in taken:
            name = file if file and file not in taken else f"{name}_{len(taken) + 1}"
        effects = ", ".join(effect.id for effect in read_one.effects) or "no effects"
        source = f"model file {file}" if file else "soil of the library" if of_library else "model"
        about = f"{source}: {read_one.geometry}, {effects}"
        digest = str(read_one.provenance.get("sha256", ""))
        found.append(Contender(name, about, read_one.model, file, digest))
    return found


def check_setting(name: str) -> None:
    """Raise ArgumentError for a setting that is one slip of the keyboard from a known one."""
    near = None if name in COLUMNS else near_miss(name)
    if near is not None:
        raise ArgumentError(f"setting: found '{name}', which is nearly '{near}'")


class Typed(NamedTuple):
    """What was typed for a setting: values in SI units, shape (values,), and how they were read.

    said: of a mass that was taken as its weight, or a decimal comma; "" of anything else.
    """

    values: Array
    said: str = ""


def levels_of(name: str, value: Setting) -> Typed:
    """Values of a setting in SI units."""
    if isinstance(value, str):
        return typed(name, value, unit_of(name) or None)
    try:
        levels = np.atleast_1d(np.asarray(value, dtype=float)).ravel()
    except (TypeError, ValueError):
        raise ArgumentError(f"{name}: found {value!r}, expected a number or several") from None
    if not levels.size:
        raise ArgumentError(f"{name}: found no value, expected a number or several")
    return Typed(levels)


def typed(name: str, text: str, unit: str | None, *, several: bool = True) -> Typed:
    """Values in the SI unit named (None: in SI whatever the unit).

    `a`, `a,b,c`, `start:stop:step` (stop included) or `low..high` (with the middle), a unit behind it
    where it is not SI. A comma separates values. It is a decimal mark where it can be nothing else: in one
    value (several: false), beside semicolons, and where no such list can be meant. Raises RangeError naming
    the option.
    """
    text = text.strip()
    if not several or ";" in text or "," not in text:
        return _reading(name, text, unit, ";")
    listed = None
    with suppress(RangeError):
        listed = _reading(name, text, unit, ",")
        if _is_list(name, text, listed.values):
            return listed
    with suppress(RangeError):
        decimal = _reading(name, text, unit, ";")
        if _allowed(name, decimal.values):
            return decimal
    return listed or _reading(name, text, unit, ",")  # which says what is wrong


def _is_list(name: str, text: str, values: Array) -> bool:
    """Whether a text with commas can be a list: nobody writes 0,05 for 0 and 5."""
    return _allowed(name, values) and re.search(r",0[0-9]", text) is None


def _allowed(name: str, values: Array) -> bool:
    return not bool(COLUMNS.get(name, OTHER).bad(values).any())


def _reading(name: str, text: str, unit: str | None, separator: str) -> Typed:
    """Values as `typed` has them. separator: of values; where it is no comma, commas are decimal marks."""
    pieces = [re.split(r"(:|\.\.)", piece) for piece in text.split(separator)]
    ends = [_NUMBER.fullmatch(end) for piece in pieces for end in piece[::2]]
    numbers, units = zip(
        *((end[1], end[2].strip()) for end in ends if end is not None), strict=True
    )
    if "" in numbers or not {*units} <= {"", units[-1]}:
        raise RangeError(f"{name}: found '{text}', expected {_EXPECTED}")
    (read,) = read_numbers([numbers], False)
    if TWO_WAYS in read.faults.values():
        raise RangeError(
            f"{name}: found '{text}', which {TWO_WAYS.partition(':')[0]}: write a decimal point, and no "
            "mark of thousands"
        )
    if read.blank.any() or read.faults:
        raise RangeError(f"{name}: found '{text}', expected {_EXPECTED}")
    if not np.all(np.isfinite(read.values)):
        raise RangeError(f"{name}: found '{text}', expected finite numbers")
    rest = iter(read.values.tolist())
    values = np.concatenate([_expanded(name, piece, [next(rest) for _ in piece[::2]])
                             for piece in pieces])  # fmt: skip
    given, weight = spelled(units[-1], unit) or units[-1], ""
    if given.endswith("*g_0"):
        weight = ", the weight of that mass"
    try:
        values = to_base(values, given, unit) if given else values
    except UnitsError as error:
        raise RangeError(f"{name}: {error}") from error
    comma = ", a decimal comma" if read.comma else ""
    if not (weight or comma):
        return Typed(values)
    shown = " to ".join(dict.fromkeys(f"{v:.4g}" for v in (values.min(), values.max())))
    return Typed(values, f"'{text}' -> {name} {shown} {shown_unit(unit)}".rstrip() + weight + comma)


def _expanded(name: str, piece: Sequence[str], ends: Sequence[float]) -> Array:
    """Values of a number, of start:stop:step, or of low..high. piece: as it was split at its marks."""
    text = "".join(piece)
    if len(ends) == 1:
        return np.array(ends)
    if ".." in piece:
        if len(ends) != 2 or ends[0] > ends[1]:
            raise RangeError(f"{name}: the range '{text}' is empty; expected low..high")
        return np.array([ends[0], 0.5 * (ends[0] + ends[1]), ends[1]])
    if len(ends) != 3:
        raise RangeError(f"{name}: found '{text}', a range is start:stop:step")
    start, stop, step = ends
    if step <= 0 or stop < start:
        raise RangeError(f"{name}: the range '{text}' is empty; start <= stop and step > 0")
    count = int((stop - start) / step + 1e-9) + 1
    if count > _MOST:
        raise RangeError(f"{name}: the range '{text}' has {count} values, at most {_MOST}")
    return np.asarray(start + step * np.arange(count))
