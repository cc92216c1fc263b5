# SPDX-License-Identifier: Apache-2.0
"""From a fit to a model file and back: what is known of a soil becomes what is believed beforehand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.fitting.parameters import EffectPart, part_of
from smallwheel_ros.fitting.prior import SOIL_PARAMETERS, Prior, SoilPrior
from smallwheel_ros.fitting.problem import Base
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model.model import Model
from smallwheel_ros.model.model_file import CalibratedModel
from smallwheel_ros.physics.soil import Soil

Array = NDArray[np.float64]

# A soil is never met again exactly as it was: no prior is tighter than this (standard deviations).
_LEAST = np.array([0.10, 0.05, 0.05])


def _matched(model: Model, measurements: Measurements) -> dict[str, Soil]:
    """The model's soils under the names that the rows use.

    One soil in the model and one in the rows are the same soil, whatever they are called.
    """
    named = measurements.conditions.soil
    wanted = ["soil"] if named is None else sorted({str(name) for name in named})
    known = {s.name: s for s in model.soils}
    if len(wanted) == 1 and len(known) == 1:
        only = next(iter(known.values()))
        return {wanted[0]: replace(only, name=wanted[0])}
    return {name: known[name] for name in wanted if name in known}


def _fitted_to(known: CalibratedModel, measurements: Measurements) -> bool:
    """Whether the model was fitted to this very data: the same evidence must not count twice."""
    return known.provenance.get("sha256") == measurements.sha256


def soil_priors(known: CalibratedModel, measurements: Measurements) -> dict[str, SoilPrior]:
    """What a model file says of the soils of these rows, as a belief beforehand.

    Empty where the model was fitted to this very data, or the file states no deviations.
    """
    if not known.names or _fitted_to(known, measurements):
        return {}
    fields = list(SOIL_PARAMETERS)
    priors = {}
    for name, soil in _matched(known.model, measurements).items():
        original = soil.name if any(s.name == soil.name for s in known.model.soils) else None
        source = original or known.model.soils[0].name
        covariance = np.diag([prior.deviation**2 for _, prior in SOIL_PARAMETERS.values()])
        at = {
            f: known.names.index(f"{source}.{f}") for f in fields if f"{source}.{f}" in known.names
        }
        for i, a in enumerate(fields):
            for j, b in enumerate(fields):
                if a in at and b in at:
                    covariance[i, j] = known.covariance[at[a], at[b]]
        priors[name] = SoilPrior(soil, covariance + np.diag(_LEAST**2))
    return priors


def base_of(known: CalibratedModel, measurements: Measurements, *, free: bool = False) -> Base:
    """A model file as the model to fit to these rows.

    Soils and effects are refitted within the file's covariance, where it has one and was not made
    from this data. An effect's number of which it says nothing stays as it is; free: it is fitted.
    """
    model = known.model
    return Base(
        geometry=model.geometry,
        thrust_form=model.thrust_form,
        soils=tuple(_matched(model, measurements).values()),
        priors=soil_priors(known, measurements),
        parts=tuple(_part(effect, known, measurements, free) for effect in model.effects),
    )


def _part(
    effect: Effect, known: CalibratedModel, measurements: Measurements, unknown_free: bool
) -> EffectPart:
    """An effect whose numbers are within the deviations that the file states.

    A number without one stays where it is, as near as a fit can hold it, or is free.
    """
    priors, values = {}, dict(effect.values())
    for p in effect.parameters():
        std = known.standard_deviation(f"{effect.id}.{p.name}")
        wide = p.bounds[1] - p.bounds[0]
        free = _fitted_to(known, measurements) or (unknown_free and std is None)
        deviation = wide if free else max(std or 0.0, 1e-4 * wide)
        priors[p.name] = Prior(float(values[p.name]), deviation, *p.bounds)
    return part_of(effect, priors)
