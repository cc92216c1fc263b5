# SPDX-License-Identifier: Apache-2.0
"""Model files: the one reader and the one writer of them.

A model file is YAML for people: soils, geometry rule, effects with their parameters, the joint
covariance of what was fitted, and where it all came from. It holds numbers and names only; reading
one never runs code, so an effect that is not installed must be given beforehand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError, nearest
from smallwheel_ros.common.files import write_bytes
from smallwheel_ros.common.plain_yaml import PlainYamlError, read_yaml, write_yaml
from smallwheel_ros.effects.base import Effect, EffectError
from smallwheel_ros.effects.registry import Registry, default_registry
from smallwheel_ros.model.model import CalibratedModel as CalibratedModel
from smallwheel_ros.model.model import Geometry, Model
from smallwheel_ros.physics.soil import SOIL_NUMBERS, Soil, SoilError
from smallwheel_ros.physics.traction import ThrustForm

Array = NDArray[np.float64]

VERSION = 1
_TOP = (
    "smallwheel_model",
    "geometry",
    "thrust_form",
    "soils",
    "effects",
    "covariance",
    "provenance",
)
# What a covariance names of a soil; see `uncertainty` for what each means.
SOIL_PARAMETERS = (
    "log_reference_pressure",
    "n",
    "m",
    "cohesion",
    "friction_angle",
    "log_shear_displacement",
    "rolling_share",
    "rim_friction",
    "pressure_peak",
)
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
    """The model itself, or where nothing is said of its uncertainty, with that."""
    return model if isinstance(model, CalibratedModel) else CalibratedModel(model)


def write_model(path: str | Path, model: Model) -> None:
    """Write a model file, whole or not at all. Raises OutputError where that is not possible."""
    write_bytes(path, model_text(model).encode())


def model_text(model: Model) -> str:
    """What a model file holds, for people."""
    return _HEAD + write_yaml(model_document(model))


def model_rows(model: Model) -> list[dict[str, Any]]:
    """Numbers of soils and effects, and the standard deviations of those that were fitted."""
    calibrated, units = as_calibrated(model), dict(zip(SOIL_NUMBERS, _SOIL_UNITS, strict=True))
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
            "std": calibrated.standard_deviation(f"{owner}.{name}"),
            "unit": unit,
        }
        for owner, name, value, unit in found
    ]


def model_document(model: Model) -> dict[str, Any]:
    """The model as plain values."""
    calibrated = as_calibrated(model)
    document: dict[str, Any] = {
        "smallwheel_model": VERSION,
        "geometry": model.geometry,
        "thrust_form": model.thrust_form,
        "soils": [
            {"name": s.name, **{n: float(getattr(s, n)) for n in SOIL_NUMBERS}, "source": s.source}
            for s in model.soils
        ],
        "effects": [_effect_entry(e, calibrated) for e in model.effects],
    }
    if calibrated.names:
        document["covariance"] = {
            "names": list(calibrated.names),
            "matrix": [[float(v) for v in row] for row in calibrated.covariance],
        }
    if calibrated.provenance:
        document["provenance"] = dict(calibrated.provenance)
    return document


def _constants(effect: Effect | type[Effect]) -> tuple[str, ...]:
    """Fields of an effect that are not fitted: where a column is centred, and the like."""
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
    """Name what a covariance can speak of: each parameter of each soil and effect."""
    of_soils = (f"{soil.name}.{name}" for soil in soils for name in SOIL_PARAMETERS)
    of_effects = (f"{effect.id}.{p.name}" for effect in effects for p in effect.parameters())
    return (*of_soils, *of_effects)


class _Reader:
    """Takes a parsed document apart; every complaint names file and key."""

    def __init__(self, path: Path, effects: Registry) -> None:
        self.path = path
        self.effects = effects

    def fail(self, key: str, found: object, expected: str) -> ModelFileError:
        shown = "nothing" if found is None else repr(found)
        return ModelFileError(f"{self.path}: {key}: found {shown[:80]}, expected {expected}")

    def mapping(self, key: str, value: object) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise self.fail(key, value, "a mapping of keys and values")
        return value

    def listing(self, key: str, value: object) -> list[Any]:
        if not isinstance(value, list):
            raise self.fail(key, value, "a list")
        return value

    def number(self, key: str, value: object) -> float:
        if isinstance(value, (int, float)) and not isinstance(value, bool) and np.isfinite(value):
            return float(value)
        raise self.fail(key, value, "a finite number")

    def choice(self, key: str, value: object, choices: tuple[str, ...]) -> str:
        if value not in choices:
            raise self.fail(key, value, "one of " + ", ".join(choices))
        return str(value)

    def only(self, key: str, entry: Mapping[str, Any], known: tuple[str, ...]) -> None:
        for name in entry:
            if name not in known:
                where = f"{key}.{name}" if key else str(name)
                listing = nearest(str(name), list(known))
                raise ModelFileError(f"{self.path}: {where}: unknown key; {listing}")

    def soil(self, key: str, value: object) -> Soil:
        entry = self.mapping(key, value)
        self.only(key, entry, ("name", "source", *SOIL_NUMBERS))
        for name in ("name", "k", "n"):
            if name not in entry:
                raise self.fail(f"{key}.{name}", None, "a name" if name == "name" else "a number")
        numbers = {n: self.number(f"{key}.{n}", entry[n]) for n in SOIL_NUMBERS if n in entry}
        try:
            return Soil(str(entry["name"]), source=str(entry.get("source", "")), **numbers)
        except SoilError as error:
            raise ModelFileError(f"{self.path}: {key}: {error}") from error

    def effect(self, key: str, value: object) -> Effect:
        entry = self.mapping(key, value)
        self.only(key, entry, ("id", "form", "parameters", "constants"))
        if not isinstance(entry.get("id"), str):
            raise self.fail(f"{key}.id", entry.get("id"), "the id of an effect")
        try:
            kind = self.effects.form(entry["id"], entry.get("form"))
        except EffectError as error:
            raise ModelFileError(
                f"{self.path}: {key}: {error}. An effect of your own is given with --effects FILE"
            ) from error
        values: dict[str, float] = {}
        parameters = self.mapping(f"{key}.parameters", entry.get("parameters") or {})
        known = {p.name: p for p in kind.parameters()}
        self.only(f"{key}.parameters", parameters, tuple(known))
        for name in known:
            if name not in parameters:
                raise self.fail(f"{key}.parameters.{name}", None, "its value")
        for name, stored in parameters.items():
            where = f"{key}.parameters.{name}"
            if not isinstance(stored, dict):
                values[name] = self.number(where, stored)
                continue
            self.only(where, stored, ("value", "standard_deviation", "unit"))
            if stored.get("unit", known[name].unit) != known[name].unit:
                raise self.fail(f"{where}.unit", stored["unit"], f"'{known[name].unit}'")
            values[name] = self.number(f"{where}.value", stored.get("value"))
        constants = self.mapping(f"{key}.constants", entry.get("constants") or {})
        self.only(f"{key}.constants", constants, _constants(kind))
        for name, stored in constants.items():
            values[name] = self.number(f"{key}.constants.{name}", stored)
        try:
            return kind(**values)
        except EffectError as error:
            raise ModelFileError(f"{self.path}: {key}: {error}") from error

    def covariance(self, value: object, known: tuple[str, ...]) -> tuple[tuple[str, ...], Array]:
        entry = self.mapping("covariance", value)
        self.only("covariance", entry, ("names", "matrix"))
        names = tuple(str(n) for n in self.listing("covariance.names", entry.get("names")))
        for name in names:
            self.choice("covariance.names", name, known)
            if names.count(name) > 1:
                raise ModelFileError(
                    f"{self.path}: covariance.names: found '{name}' twice, expected it once"
                )
        rows = self.listing("covariance.matrix", entry.get("matrix"))
        shape = f"{len(names)} rows of {len(names)} numbers"
        if len(rows) != len(names):
            raise self.fail("covariance.matrix", f"{len(rows)} rows", shape)
        matrix = np.empty((len(names), len(names)))
        for i, row in enumerate(rows):
            key = f"covariance.matrix[{i}]"
            if len(self.listing(key, row)) != len(names):
                raise self.fail(key, f"{len(row)} numbers", shape)
            matrix[i] = [self.number(key, v) for v in row]
        if not _is_covariance(matrix):
            expected = "symmetric, variances and eigenvalues at least 0"
            raise self.fail("covariance.matrix", "no covariance", expected)
        return names, matrix


def _is_covariance(matrix: Array) -> bool:
    """Whether a matrix is symmetric and positive semidefinite, but for rounding (1e-9)."""
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

    effects: all that it may name; those of the package and of installed ones if not given.
    Raises ModelFileError naming file, key, what was found and what was expected.
    """
    file = Path(path)
    reader = _Reader(file, effects or default_registry())
    try:
        document = read_yaml(file)
    except PlainYamlError as error:
        raise ModelFileError(f"{file}: {error}") from error
    if not isinstance(document, dict) or "smallwheel_model" not in document:
        raise ModelFileError(f"{file}: not a model file: it has no key smallwheel_model")
    if document["smallwheel_model"] != VERSION:
        raise reader.fail("smallwheel_model", document["smallwheel_model"], f"version {VERSION}")
    reader.only("", document, _TOP)
    soils = [
        reader.soil(f"soils[{i}]", entry)
        for i, entry in enumerate(reader.listing("soils", document.get("soils")))
    ]
    if not soils:
        raise reader.fail("soils", [], "at least one soil")
    for at, kind in enumerate(soils):
        if any(other.name == kind.name for other in soils[:at]):
            raise ModelFileError(f"{file}: soils[{at}]: soil '{kind.name}' is there twice")
    acting = [
        reader.effect(f"effects[{i}]", entry)
        for i, entry in enumerate(reader.listing("effects", document.get("effects") or []))
    ]
    for at, one in enumerate(acting):
        if any(other.id == one.id for other in acting[:at]):
            raise ModelFileError(f"{file}: effects[{at}]: effect '{one.id}' is there twice")
    geometry: Geometry = reader.choice(  # type: ignore[assignment]  # checked against its values
        "geometry", document.get("geometry", "contact_integral"), get_args(Geometry)
    )
    thrust_form: ThrustForm = reader.choice(  # type: ignore[assignment]
        "thrust_form", document.get("thrust_form", "stress_integral"), get_args(ThrustForm)
    )
    names: tuple[str, ...] = ()
    covariance: Array = np.zeros((0, 0))
    if document.get("covariance") is not None:
        names, covariance = reader.covariance(
            document["covariance"], parameter_names(soils, acting)
        )
    provenance = reader.mapping("provenance", document.get("provenance") or {})
    model = Model(soils, geometry, acting, thrust_form)
    return CalibratedModel(model, names, covariance, provenance)
