"""Fit a model of wheel and soil to measurements: points, variance components, posterior."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.fitting.fit import Fit, Fitter, levels_from, make_fitter
from smallwheel_ros.fitting.noise import outlier_rows, repeats_of
from smallwheel_ros.fitting.parameters import ParameterVector, SoilPrior, part_of
from smallwheel_ros.fitting.points import FittingError, Points, points_of
from smallwheel_ros.fitting.result import FitResult, FittedParameter, result_of
from smallwheel_ros.fitting.soils import parameter_vector
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model import Geometry
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.physics.traction import ThrustForm

__all__ = [
    "FitResult",
    "FittedParameter",
    "FittingError",
    "SoilPrior",
    "fit_model",
    "fit_points",
    "result_of",
    "usable_points",
]

_LEVELS = 2  # times that the levels are taken from the fit itself


def usable_points(measurements: Measurements) -> tuple[Points, NDArray[np.intp]]:
    """The points of a table without gross outliers, and the rows that were left out as such.

    Raises FittingError where nothing usable was measured.
    """
    points = points_of(measurements)
    outliers = outlier_rows(points)
    if outliers.size:
        points = points_of(measurements, outliers)
    return points, outliers


def fit_points(
    points: Points, vector: ParameterVector, start: NDArray[np.float64] | None = None
) -> tuple[Fitter, Fit]:
    """Fit one model, with the levels of the noise from its own predictions. start: theta.

    Raises FittingError where there are too few values.
    """
    fitter, fit = make_fitter(points, vector, start)
    for _ in range(_LEVELS):
        level = levels_from(points, fit.predicted)
        fitter = Fitter(points, level, repeats_of(points, level))
        fit = fitter.fit(vector, fit.theta, fit.scatter)
    return fitter, fit


def fit_model(
    measurements: Measurements,
    effects: Sequence[Effect] = (),
    geometry: Geometry = "contact_integral",
    *,
    soils: Sequence[Soil] = (),
    priors: Mapping[str, SoilPrior] | None = None,
    thrust_form: ThrustForm = "integrated",
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
        Law of thrust, for drawbar_pull.
    fixed_m
        m of every soil, held (0 is the law of Bernstein and Goriatchkin); None fits it.

    Raises
    ------
    FittingError
        Where nothing usable was measured, or an effect is given twice.
    """
    points, outliers = usable_points(measurements)
    vector = parameter_vector(
        points,
        (),
        geometry,
        parts=[part_of(effect) for effect in effects],
        soils=soils,
        priors=priors,
        thrust_form=thrust_form,
        fixed_m=fixed_m,
    )
    fitter, fit = fit_points(points, vector)
    return result_of(fitter, fit, outliers)
