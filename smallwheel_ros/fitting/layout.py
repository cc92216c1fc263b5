"""Which parameters of a model a set of measurements can be fitted with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.fitting.observations import FittingError, Observations
from smallwheel_ros.fitting.parameters import (
    CORRECTION_PRIOR,
    CORRECTIONS,
    SOIL_FIELDS,
    THRUST_FIELDS,
    Array,
    Field,
    Layout,
    Slot,
    SoilPrior,
    replace_model,
    soil_from,
    soil_vector,
)
from smallwheel_ros.model import Geometry, Model
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.physics.traction import ThrustForm

_STEP = 1e-5  # of a finite difference: the model is exact to about 1e-12


def soils_of(observations: Observations, known: Mapping[str, Soil] | None = None) -> list[Soil]:
    """One soil for each that the rows name, to start from; a known one as it is."""
    names = ["soil"]
    if observations.conditions.soil is not None:
        names = [str(name) for name in np.unique(observations.conditions.soil)]
    known = known or {}
    return [known.get(name) or Soil(name, 1e6, 0.9, 0.0) for name in names]


def _slot(owner: int, field: Field, start: float) -> Slot:
    low, high = field.bounds
    scale = 100.0 if field.name == "cohesion" else 1.0
    value = float(np.clip(start, low, high))
    return Slot(owner, False, field.name, value, field.bounds, _STEP * scale, field.unit)


def effect_slots(effects: Sequence[Effect]) -> list[Slot]:
    """The parameters of the effects, each started where the effect stands."""
    slots = []
    for i, effect in enumerate(effects):
        values = dict(effect.values())
        for p in effect.parameters():
            scale = max(min(p.bounds[1] - p.bounds[0], 10.0 * abs(p.start) or np.inf), 1e-6)
            slots.append(Slot(i, True, p.name, values[p.name], p.bounds, _STEP * scale, p.unit))
    return slots


def _diameters(observations: Observations, soil: str) -> Array:
    conditions = observations.conditions
    rows = np.unique(observations.row)
    if conditions.soil is not None:
        rows = rows[conditions.soil[rows] == soil]
    return np.unique(conditions.diameter[rows])


def one_diameter(observations: Observations, soil: str) -> bool:
    """Whether all wheels in that soil are of one size (to 2 %): m is then not determined."""
    sizes = _diameters(observations, soil)
    return bool(sizes.size < 2 or sizes[-1] <= 1.02 * sizes[0])


def make_layout(
    observations: Observations,
    effects: Sequence[Effect] = (),
    geometry: Geometry = "contact_integral",
    *,
    soils: Sequence[Soil] | None = None,
    priors: Mapping[str, SoilPrior] | None = None,
    thrust_form: ThrustForm = "integrated",
    fixed_m: float | None = None,
    corrections: bool = False,
) -> Layout:
    """The layout of a fit: m is held where a soil was met by wheels of one diameter only.

    soils: to start from (by name); a soil of the table that is not there starts from a middling
    one.
    priors: soils known from elsewhere; the others get weak priors. fixed_m: m of every soil, held.
    corrections: let the law of thrust be somewhat wrong (`parameters.CORRECTIONS`).
    Raises FittingError where two effects have the same id.
    """
    ids = [effect.id for effect in effects]
    twice = [name for name in ids if ids.count(name) > 1]
    if twice:
        raise FittingError(f"effect '{twice[0]}' is given twice: name it once")
    priors = dict(priors or {})
    known = {s.name: s for s in soils or ()} | {name: p.soil for name, p in priors.items()}
    start = soils_of(observations, known)
    if fixed_m is not None:
        start = [soil_from(s, {"m": fixed_m}) for s in start]
    slots: list[Slot] = []
    centres: list[float] = []
    blocks: list[Array] = []
    for i, soil in enumerate(start):
        values = soil_vector(soil)
        prior = priors.get(soil.name)
        fields = list(SOIL_FIELDS)
        if fixed_m is not None or one_diameter(observations, soil.name):
            fields = [f for f in fields if f.name != "m"]
        slots += [_slot(i, f, values[f.name]) for f in fields]
        if prior is None:
            centres += [f.prior[0] for f in fields]
            blocks.append(np.diag([1.0 / f.prior[1] ** 2 for f in fields]).astype(float))
        else:
            centres += [values[f.name] for f in fields]
            kept = [k for k, f in enumerate(SOIL_FIELDS) if f in fields]
            blocks.append(
                np.asarray(np.linalg.inv(prior.covariance[np.ix_(kept, kept)]), dtype=float)
            )
        if "drawbar_pull" in observations.channels:
            slots += [_slot(i, f, values[f.name]) for f in THRUST_FIELDS]
            centres += [f.prior[0] for f in THRUST_FIELDS]
            blocks.append(np.diag([1.0 / f.prior[1] ** 2 for f in THRUST_FIELDS]))
    if corrections and "drawbar_pull" in observations.channels:
        slots += [Slot(-1, False, n, 0.0, (-2.0, 2.0), _STEP, "1") for n in CORRECTIONS]
        centres += [0.0] * len(CORRECTIONS)
        blocks.append(np.eye(len(CORRECTIONS)) / CORRECTION_PRIOR**2)
    added = effect_slots(effects)
    slots += added
    centres += [s.start for s in added]
    # The bounds hold an effect's parameter; this only keeps the equations solvable.
    blocks += [np.array([[1e-4 / (s.bounds[1] - s.bounds[0]) ** 2]]) for s in added]
    precision = np.zeros((len(slots), len(slots)))
    at = 0
    for block in blocks:
        size = block.shape[0]
        precision[at : at + size, at : at + size] = block
        at += size
    model = replace_model(Model(start, geometry, (), thrust_form), start, effects)
    return Layout(
        model,
        tuple(slots),
        np.array([s.bounds[0] for s in slots]),
        np.array([s.bounds[1] for s in slots]),
        np.array(centres),
        precision,
    )
