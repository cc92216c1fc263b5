"""The soils of a table as parameters: one for each that the rows name, with what is known of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.fitting.parameters import (
    SOIL_PARAMETERS,
    STRENGTH_PARAMETERS,
    Array,
    EffectPart,
    FreeParameter,
    ParameterVector,
    SoilPrior,
    soil_from,
    soil_numbers,
)
from smallwheel_ros.fitting.points import FittingError, Points
from smallwheel_ros.model import Geometry
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.physics.traction import ThrustForm

_ONE_SIZE = 1.02  # wheels that differ by less are of one diameter: m is then not determined


def soil_names(points: Points) -> list[str]:
    """Names of the soils of these points; `soil` where the rows name none."""
    if points.conditions.soil is None:
        return ["soil"]
    return [str(name) for name in np.unique(points.conditions.soil)]


def one_diameter(points: Points, soil: str) -> bool:
    """Whether all bodies in that soil are of one size."""
    rows = np.unique(points.row)
    if points.conditions.soil is not None:
        rows = rows[points.conditions.soil[rows] == soil]
    sizes = points.conditions.diameter[rows]
    return sizes.size == 0 or bool(sizes.max() <= _ONE_SIZE * sizes.min())


def parameter_vector(
    points: Points,
    effects: Sequence[Effect] = (),
    geometry: Geometry = "contact_integral",
    *,
    parts: Sequence[EffectPart] = (),
    soils: Sequence[Soil] = (),
    priors: Mapping[str, SoilPrior] | None = None,
    thrust_form: ThrustForm = "integrated",
    fixed_m: float | None = None,
) -> ParameterVector:
    """The free parameters of a fit to these points.

    effects: in the model as they are. parts: effects whose numbers are fitted. soils: where to start,
    by name. priors: soils known from elsewhere. fixed_m: m of every soil, held (0: Bernstein and
    Goriatchkin). m is held too where a soil was met by bodies of one diameter only.
    Raises FittingError where an effect is given twice.
    """
    ids = [*(e.id for e in effects), *(p.id for p in parts if not p.replaces)]
    twice = [name for name in ids if ids.count(name) > 1]
    if twice:
        raise FittingError(f"effect '{twice[0]}' is given twice: name it once")
    known = dict(priors or {})
    given = {s.name: s for s in soils} | {name: p.soil for name, p in known.items()}
    # Without drawbar pull the strength matters where an effect reads it (bulldozing); elsewhere it
    # has no influence, and its posterior is its prior.
    strength = {
        name: known
        for name, known in STRENGTH_PARAMETERS.items()
        if "drawbar_pull" in points.channels
        or ("resistance" in points.channels and name != "log_shear_displacement")
    }
    start: list[Soil] = []
    free: list[FreeParameter] = []
    blocks: list[Array] = []
    for i, name in enumerate(soil_names(points)):
        soil = given.get(name) or Soil(name, 1e6, 0.9, 0.0)
        if fixed_m is not None:
            soil = soil_from(soil, {"m": fixed_m})
        start.append(soil)
        fields = dict(SOIL_PARAMETERS)
        if fixed_m is not None or one_diameter(points, name):
            del fields["m"]
        numbers = soil_numbers(soil)
        prior = known.get(name)
        if prior is None:
            blocks.append(np.diag([p.deviation**-2 for _, p in fields.values()]))
        else:
            kept = [list(SOIL_PARAMETERS).index(f) for f in fields]
            blocks.append(np.asarray(np.linalg.inv(prior.covariance[np.ix_(kept, kept)]), float))
            covered = dict(zip(fields, np.sqrt(np.diag(prior.covariance))[kept], strict=True))
            fields = {
                f: (unit, replace(p, centre=numbers[f], deviation=float(covered[f])))
                for f, (unit, p) in fields.items()
            }
        if strength:
            fields |= strength
            blocks.append(np.diag([p.deviation**-2 for _, p in strength.values()]))
        for field, (unit, p) in fields.items():
            value = numbers[field] if name in given else p.centre
            value = float(np.clip(value, p.low, p.high))
            free.append(FreeParameter(name, i, False, field, value, unit, p))
    precision = np.zeros((len(free), len(free)))
    at = 0
    for block in blocks:
        precision[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    vector = ParameterVector(
        tuple(start), geometry, thrust_form, tuple(effects), (), tuple(free), precision
    )
    return vector.with_parts(parts)
