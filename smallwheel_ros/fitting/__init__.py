# SPDX-License-Identifier: Apache-2.0
"""Fit a model of wheel and soil to measurements: points, variance components, posterior."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.fitting.parameters import SoilPrior, part_of
from smallwheel_ros.fitting.points import FittingError
from smallwheel_ros.fitting.problem import Base, Problem
from smallwheel_ros.fitting.result import FitResult, FittedParameter
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model.model import Geometry
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.physics.traction import ThrustForm

__all__ = [
    "Base",
    "FitResult",
    "FittedParameter",
    "FittingError",
    "Problem",
    "SoilPrior",
    "fit_model",
]


def fit_model(
    measurements: Measurements,
    effects: Sequence[Effect] = (),
    geometry: Geometry = "contact_integral",
    *,
    soils: Sequence[Soil] = (),
    priors: Mapping[str, SoilPrior] | None = None,
    thrust_form: ThrustForm = "stress_integral",
    fixed_m: float | None = None,
) -> FitResult:
    """Fit soils and effects to all channels at once.

    Parameters
    ----------
    measurements
        The table. Its rows need not be complete: a channel that a row did not measure is left out.
    effects
        To fit with the soils; each starts at the values that it carries.
    geometry
        How load and sinkage belong together.
    soils
        Where to start, by name; a parameter that the data cannot determine (m, with one diameter)
        keeps its value from there.
    priors
        Soils known from elsewhere (from an indentation test, say) with their covariance.
    thrust_form
        Law of drawbar_pull and torque.
    fixed_m
        m of every soil, held (0 is the law of Bernstein and Goriatchkin); None fits it.

    Raises
    ------
    FittingError
        Where nothing usable was measured, or an effect is given twice.
    """
    parts = tuple(part_of(effect) for effect in effects)
    base = Base((), geometry, thrust_form, tuple(soils), dict(priors or {}), parts, fixed_m)
    return Problem.of(measurements, base).result()
