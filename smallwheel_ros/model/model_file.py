# SPDX-License-Identifier: Apache-2.0
"""Reader and writer of model files.

A model file is YAML for people: soils, geometry rule, effects with their parameters, the joint
covariance of what was fitted, and its provenance. It holds only numbers and names, and reading one
never runs code: an effect that is not installed must be passed to the reader.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError, nearest
from smallwheel_ros.common.files import write_bytes
from smallwheel_ros.common.plain_yaml import PlainYamlError, read_yaml, write_yaml
from smallwheel_ros.common.result import Writer
from smallwheel_ros.effects.base import Effect, EffectError
from smallwheel_ros.effects.registry import Registry, default_registry
from smallwheel_ros.model.derived import derived_numbers
from smallwheel_ros.model.measured import ForceLaw, Measured, RunScatter, Tied
from smallwheel_ros.model.model import CalibratedModel, Model, ModelError
from smallwheel_ros.physics.sinkage import Geometry
from smallwheel_ros.physics.soil import SOIL_NUMBERS, Soil, SoilError
from smallwheel_ros.physics.traction import ThrustForm

Array = NDArray[np.float64]

VERSION = 1
_MODEL = ("geometry", "thrust_form", "soils", "effects", "covariance", "measured", "provenance")
_TOP = ("smallwheel_model", *_MODEL, "rivals")
# Names of a soil's parameters in a covariance, as in `fitting.parameters.soil_numbers`.
SOIL_PARAMETERS = (
    "log_reference_pressure", "n", "m", "cohesion", "friction_angle", "log_shear_displacement",
    "rolling_share", "rim_friction", "pressure_peak",
)  # fmt: skip
_SOIL_UNITS = ("Pa/m^(n+m)", "1", "1", "Pa", "rad", "m", "1", "1", "1")
_HEAD = """\
# A model of wheel and soil for smallwheel. Units are SI; angles in rad.
# k in Pa/m^(n+m): pressure p = k z^n D^m. cohesion in Pa, shear_displacement in m.
# covariance: of the parameters named, where a soil's first is ln of the pressure (Pa) at 10 mm of
# sinkage under a wheel of 0.2 m. Take it out after editing values by hand.
"""


class ModelFileError(SmallwheelError):
    """A model file that cannot be read."""


def as_calibrated(model: Model) -> CalibratedModel:
    """Return a calibrated model unchanged, and a plain one as a calibrated model of unknown uncertainty."""
    return model if isinstance(model, CalibratedModel) else CalibratedModel(model)


def write_model(path: str | Path, model: Model) -> None:
    """Write a model file, whole or not at all.

    Parameters
    ----------
    path
        File to write; an existing one is replaced.
    model
        The model; its uncertainty, rivals and provenance are written if it has them.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    write_bytes(path, text(model).encode())


def writers(model: Model) -> dict[str, Writer]:
    """Functions that take a path and write the model there, by the file's suffix, for `Model.save`."""
    return dict.fromkeys((".yaml", ".yml"), lambda path: write_model(path, model))


def text(model: Model) -> str:
    """The content of a model file: YAML under a comment that explains it."""
    return _HEAD + write_yaml(document(model))


def rows(model: Model) -> list[dict[str, Any]]:
    """List the numbers of a model's soils and parameters of its effects, for a table.

    Returns
    -------
    list of dict
        `of` (soil or effect), `parameter`, `value`, `std` (None if unknown) and `unit`, values and deviations
        in that unit. Soils have k and the shear deformation modulus themselves, not their ln.
    """
    calibrated, units = as_calibrated(model), dict(zip(SOIL_NUMBERS, _SOIL_UNITS, strict=True))
    known = {name: calibrated.standard_deviation(name) for name in calibrated.names}
    for soil in model.soils:
        for one in derived_numbers(soil, calibrated.names, calibrated.covariance):
            known[f"{soil.name}.{one.name}"] = one.std
    found = [(s.name, n, float(getattr(s, n)), units[n]) for s in model.soils for n in SOIL_NUMBERS]
    found += [
        (effect.id, p.name, float(getattr(effect, p.name)), p.unit)
        for effect in model.effects
        for p in effect.parameters()
    ]
    return [
        {
            "of": owner,
            "parameter": name,
            "value": value,
            "std": known.get(f"{owner}.{name}"),
            "unit": unit,
        }
        for owner, name, value, unit in found
    ]


def document(model: Model) -> dict[str, Any]:
    """The content of a model file as dicts, lists, numbers and texts."""
    calibrated = as_calibrated(model)
    plain = {"smallwheel_model": VERSION, **_plain(calibrated)}
    if calibrated.rivals:
        plain["rivals"] = [
            {"probability": float(share), **_plain(rival)} for share, rival in calibrated.rivals
        ]
    return plain


def _plain(model: CalibratedModel) -> dict[str, Any]:
    """The part of a model file that rivals have, too: one model without its rivals."""
    plain: dict[str, Any] = {
        "geometry": model.geometry,
        "thrust_form": model.thrust_form,
        "soils": [
            {"name": s.name, **{n: float(getattr(s, n)) for n in SOIL_NUMBERS}, "source": s.source}
            for s in model.soils
        ],
        "effects": [_effect_entry(e, model) for e in model.effects],
    }
    if model.names:
        plain["covariance"] = {
            "names": list(model.names),
            "matrix": [[float(v) for v in row] for row in model.covariance],
        }
    if model.measured != Measured():
        plain["measured"] = model.measured.plain()
    if model.provenance:
        plain["provenance"] = dict(model.provenance)
    return plain


def _constants(effect: Effect | type[Effect]) -> tuple[str, ...]:
    """Names of an effect's fields that are not fitted, such as the reference value of a column."""
    return tuple(known.name for known in effect.constants())


def _effect_entry(effect: Effect, calibrated: CalibratedModel) -> dict[str, Any]:
    entry: dict[str, Any] = {"id": effect.id, "form": effect.form, "parameters": {}}
    for known in effect.parameters():
        entry["parameters"][known.name] = {
            "value": float(getattr(effect, known.name)),
            "standard_deviation": calibrated.standard_deviation(f"{effect.id}.{known.name}"),
            "unit": known.unit,
        }
    if _constants(effect):
        entry["constants"] = {name: float(getattr(effect, name)) for name in _constants(effect)}
    return entry


def parameter_names(soils: Sequence[Soil], effects: Sequence[Effect]) -> tuple[str, ...]:
    """Return the names that a covariance may have: `SOIL.n`, `EFFECT.a` and so on for each parameter.

    Parameters
    ----------
    soils, effects
        Soils and effects of a model; the names are in their order, those of soils first.
    """
    of_soils = (f"{soil.name}.{name}" for soil in soils for name in SOIL_PARAMETERS)
    of_effects = (f"{effect.id}.{p.name}" for effect in effects for p in effect.parameters())
    return (*of_soils, *of_effects)


class _Entry:
    """A value of a parsed file, with the file and the key (such as `soils[0].k`), which every error names."""

    def __init__(self, file: Path, key: str, value: Any) -> None:
        self.file = file
        self.key = key
        self.value = value

    def get(self, name: str, default: Any = None) -> _Entry:
        """The entry of a mapping under a name; if there is no such name, one with the default as value."""
        key = f"{self.key}.{name}" if self.key else name
        return _Entry(self.file, key, self.value.get(name, default))

    def wrong(self, why: object) -> ModelFileError:
        """An error to raise, which names file and key and states the reason."""
        where = f"{self.key}: " if self.key else ""
        return ModelFileError(f"{self.file}: {where}{why}")

    def unlike(self, expected: str, found: object = None) -> ModelFileError:
        """An error to raise where something else was expected. found: text to show in place of the value."""
        shown = "nothing" if self.value is None else repr(self.value if found is None else found)
        return self.wrong(f"found {shown[:80]}, expected {expected}")

    def mapping(self, *known: str) -> dict[str, Any]:
        """The value as a mapping. Raises ModelFileError if it is none, or has a key other than these."""
        if not isinstance(self.value, dict):
            raise self.unlike("a mapping of keys and values")
        for name in self.value:
            if name not in known:
                raise self.get(str(name)).wrong(f"unknown key; {nearest(str(name), list(known))}")
        return self.value

    def listing(self) -> list[_Entry]:
        if not isinstance(self.value, list):
            raise self.unlike("a list")
        return [_Entry(self.file, f"{self.key}[{i}]", v) for i, v in enumerate(self.value)]

    def number(self) -> float:
        value = self.value
        if isinstance(value, (int, float)) and not isinstance(value, bool) and np.isfinite(value):
            return float(value)
        raise self.unlike("a finite number")

    def text(self) -> str:
        if not isinstance(self.value, str):
            raise self.unlike("a text")
        return self.value

    def choice(self, choices: Sequence[str | bool]) -> Any:
        if self.value not in choices:
            raise self.unlike("one of " + ", ".join(map(str, choices)))
        return self.value


def _check_once(entries: Sequence[_Entry], what: str, names: Sequence[str]) -> None:
    """Raise ModelFileError for a name that occurs twice. what: such as "soil"; names: of the entries."""
    for at, name in enumerate(names):
        if name in names[:at]:
            raise entries[at].wrong(f"{what} '{name}' is there twice")


def _soil(entry: _Entry) -> Soil:
    found = entry.mapping("name", "source", *SOIL_NUMBERS)
    for name, expected in (("name", "a name"), ("k", "a number"), ("n", "a number")):
        if name not in found:
            raise entry.get(name).unlike(expected)
    numbers = {name: entry.get(name).number() for name in SOIL_NUMBERS if name in found}
    try:
        return Soil(str(found["name"]), source=str(found.get("source", "")), **numbers)
    except SoilError as error:
        raise entry.wrong(error) from error


def _effect(entry: _Entry, known: Registry) -> Effect:
    found = entry.mapping("id", "form", "parameters", "constants")
    if not isinstance(found.get("id"), str):
        raise entry.get("id").unlike("the id of an effect")
    try:
        kind = known.form(found["id"], found.get("form"))
    except EffectError as error:
        words = f"{error}. An effect of your own is given with --effects FILE"
        raise entry.wrong(words) from error
    units = {p.name: p.unit for p in kind.parameters()}
    parameters, constants = (
        _Entry(entry.file, f"{entry.key}.{name}", found.get(name) or {})
        for name in ("parameters", "constants")
    )
    stored = parameters.mapping(*units)
    values: dict[str, float] = {}
    for name, unit in units.items():
        one = parameters.get(name)
        if name not in stored:
            raise one.unlike("its value")
        if isinstance(one.value, dict):
            one.mapping("value", "standard_deviation", "unit")
            if one.value.get("unit", unit) != unit:
                raise one.get("unit").unlike(f"'{unit}'")
            one = one.get("value")
        values[name] = one.number()
    for name in constants.mapping(*_constants(kind)):
        values[name] = constants.get(name).number()
    try:
        return kind(**values)
    except EffectError as error:
        raise entry.wrong(error) from error


def _covariance(entry: _Entry, known: Sequence[str]) -> tuple[tuple[str, ...], Array]:
    """Read names of parameters, and their covariance, shape (names, names); both empty where there is none.

    known: names that may occur. Raises ModelFileError for others, and for a matrix that is no covariance.
    """
    if entry.value is None:
        return (), np.zeros((0, 0))
    entry.mapping("names", "matrix")
    of_names, of_matrix = entry.get("names"), entry.get("matrix")
    names = tuple(str(one.value) for one in of_names.listing())
    for name in names:
        _Entry(entry.file, of_names.key, name).choice(known)
        if names.count(name) > 1:
            raise of_names.wrong(f"found '{name}' twice, expected it once")
    rows = of_matrix.listing()
    shape = f"{len(names)} rows of {len(names)} numbers"
    if len(rows) != len(names):
        raise of_matrix.unlike(shape, f"{len(rows)} rows")
    matrix = np.empty((len(names), len(names)))
    for i, row in enumerate(rows):
        if len(row.listing()) != len(names):
            raise row.unlike(shape, f"{len(row.value)} numbers")
        matrix[i] = [_Entry(entry.file, row.key, value).number() for value in row.value]
    if not _is_covariance(matrix):
        expected = "symmetric, variances and eigenvalues at least 0"
        raise of_matrix.unlike(expected, "no covariance")
    return names, matrix


def _is_covariance(matrix: Array) -> bool:
    """Whether a square matrix is symmetric and positive semidefinite to within rounding (1e-9)."""
    variances = np.diag(matrix)
    if (variances < 0).any():
        return False
    deviations = np.sqrt(variances)
    largest = np.outer(deviations, deviations)  # of a covariance, by Cauchy and Schwarz
    with np.errstate(over="ignore"):  # what overflows is no covariance either
        asymmetry = np.abs(matrix - matrix.T)
    if (asymmetry > 1e-9 * largest).any():
        return False
    if (np.abs(matrix) > (1 + 1e-9) * largest).any():
        return False
    correlation = np.divide(matrix, largest, out=np.zeros_like(matrix), where=largest > 0)
    return bool(np.linalg.eigvalsh(correlation).min(initial=0.0) >= -1e-9)


def read_model(path: str | Path, effects: Registry | None = None) -> CalibratedModel:
    """Read a model file.

    Parameters
    ----------
    path
        The file, YAML.
    effects
        Effects that it may name; those of the package and of installed packages if not given.

    Returns
    -------
    CalibratedModel
        With the rivals of the file; without uncertainty (no `names`) where the file has no covariance.

    Raises
    ------
    ModelFileError
        If it cannot be used; the message names file, key, what was found and what was expected.
    """
    file, registry = Path(path), effects or default_registry()
    try:
        parsed = read_yaml(file)
    except PlainYamlError as error:
        raise ModelFileError(f"{file}: {error}") from error
    top = _Entry(file, "", parsed)
    if not isinstance(parsed, dict) or "smallwheel_model" not in parsed:
        raise top.wrong(
            "not a model file: it has no key smallwheel_model; `smallwheel fit` writes one"
        )
    if parsed["smallwheel_model"] != VERSION:
        raise top.get("smallwheel_model").unlike(f"version {VERSION}")
    top.mapping(*_TOP)
    rivals = []
    listed = _Entry(file, "rivals", parsed.get("rivals") or [])
    for entry in listed.listing():
        entry.mapping("probability", *_MODEL)
        share = entry.get("probability")
        if not 0.0 < share.number() <= 1.0:
            raise share.unlike("a probability, over 0 and up to 1")
        rivals.append((share.number(), _model(entry, registry)))
    base = _model(top, registry)
    try:
        return base.changed(rivals=tuple(rivals))
    except ModelError as error:
        raise listed.wrong(error) from error


def _model(top: _Entry, registry: Registry) -> CalibratedModel:
    """Read one model of a file, or one of its rivals, with its uncertainty; without rivals."""
    file = top.file
    entries = top.get("soils").listing()
    if not entries:
        raise top.get("soils").unlike("at least one soil")
    soils = [_soil(entry) for entry in entries]
    _check_once(entries, "soil", [one.name for one in soils])
    entries = _Entry(file, top.get("effects").key, top.value.get("effects") or []).listing()
    acting = [_effect(entry, registry) for entry in entries]
    _check_once(entries, "effect", [one.id for one in acting])
    geometry = top.get("geometry", "contact_integral").choice(get_args(Geometry))
    thrust_form = top.get("thrust_form", "stress_integral").choice(get_args(ThrustForm))
    names, covariance = _covariance(top.get("covariance"), parameter_names(soils, acting))
    provenance = top.value.get("provenance") or {}
    if not isinstance(provenance, dict):
        raise top.get("provenance").unlike("a mapping of keys and values")
    model = Model(soils, geometry, acting, thrust_form)
    return CalibratedModel(model, names, covariance, provenance, _measured(top.get("measured")))


def _measured(entry: _Entry) -> Measured:
    """Read the section `measured`; empty where the file has none, as files written before 0.4."""
    if entry.value is None:
        return Measured()
    entry.mapping(*(one.name for one in fields(Measured)))

    def each(name: str) -> dict[str, _Entry]:
        part = _Entry(entry.file, f"{entry.key}.{name}", entry.value.get(name) or {})
        return {key: part.get(key) for key in (part.mapping(*part.value) if part.value else ())}

    def listed(name: str) -> list[_Entry]:
        return _Entry(entry.file, f"{entry.key}.{name}", entry.value.get(name) or []).listing()

    def numbers(one: _Entry, count: int) -> list[float]:
        found = [value.number() for value in one.listing()]
        if len(found) != count:
            raise one.unlike(f"{count} numbers")
        return found

    def group(one: _Entry, kind: type[Any]) -> Any:
        known = fields(kind)
        one.mapping(*(f.name for f in known))
        given = {f.name: one.get(f.name) if f.default is MISSING else one.get(f.name, f.default)
                 for f in known}  # fmt: skip
        return kind(**{f.name: given[f.name].text() if f.type == "str" else given[f.name].number()
                       for f in known})  # fmt: skip

    ranges = {name: tuple(numbers(one, 2)) for name, one in each("ranges").items()}
    return Measured(
        ranges,  # type: ignore[arg-type]  # pairs
        tuple(tuple(numbers(one, 3)) for one in listed("wheels")),  # type: ignore[misc]  # of three
        entry.get("stiffness", 0.0).number(),
        {name: group(one, RunScatter) for name, one in each("runs").items()},
        {name: group(one, ForceLaw) for name, one in each("forces").items()},
        tuple(group(one, Tied) for one in listed("tied")),
        entry.get("unexplained", False).choice((False, True)),
    )
