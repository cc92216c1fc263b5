"""Fit a model of wheel and soil to measurements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.fitting.calibrate import calibrate
from smallwheel_ros.fitting.layout import make_layout
from smallwheel_ros.fitting.observations import FittingError, observe, run_codes
from smallwheel_ros.fitting.parameters import SoilPrior
from smallwheel_ros.fitting.result import FitResult, FittedParameter, result_of
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model import Geometry
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.physics.traction import ThrustForm

__all__ = ["FitResult", "FittedParameter", "FittingError", "SoilPrior", "fit_model", "run_codes"]


def fit_model(
    measurements: Measurements,
    effects: Sequence[Effect] = (),
    geometry: Geometry = "contact_integral",
    *,
    soils: Sequence[Soil] | None = None,
    priors: Mapping[str, SoilPrior] | None = None,
    thrust_form: ThrustForm = "integrated",
    fixed_m: float | None = None,
) -> FitResult:
    """Fit soils and effects to all channels at once, weighted and robustly.

    The noise is sigma^2 = absolute^2 + (relative * level)^2 by channel, from repeats where there
    are any; runs differ by a random effect on ln k (and each channel's own). One soil for each that
    the rows name.

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
        Where nothing usable was measured.
    """
    observations = observe(measurements)
    layout = make_layout(
        observations,
        effects,
        geometry,
        soils=soils,
        priors=priors,
        thrust_form=thrust_form,
        fixed_m=fixed_m,
    )
    return result_of(calibrate(observations, layout))
