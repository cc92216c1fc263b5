"""The models that a comparison sets side by side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects.width_dependent_modulus import Bekker
from smallwheel_ros.fitting import SoilPrior, fit_model
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model import Model
from smallwheel_ros.physics.conditions import PLATE
from smallwheel_ros.physics.soil import Soil


@dataclass(frozen=True)
class Contender:
    """A model to compare: one that is fitted to the data, or one that stands as it is.

    fit: makes the model from measurements; None for a model that stands. file, fitted_to: where a
    standing model came from, and the SHA-256 of the data that it was fitted to, "" if unknown.
    """

    name: str
    description: str
    fit: Callable[[Measurements], Model] | None = None
    model: Model | None = None
    file: str = ""
    fitted_to: str = ""


def _bekker(measurements: Measurements) -> Model:
    # Bekker's law knows no diameter: m is held at 0 by a prior without any width there, and is as
    # loose as in any other fit elsewhere.
    covariance = np.diag([9.0, 0.36, 1e-12])
    names = [str(name) or "soil" for name in np.unique(measurements.soil)]
    known = {
        name: SoilPrior(Soil(name, 1e6, 0.9).with_parameters(10.5, 0.9, 0.0), covariance)
        for name in names
    }
    effects = [Bekker()] if _widths(measurements) > 1 else []
    return fit_model(measurements, effects, "closed_form", priors=known).model


def _proposed(measurements: Measurements) -> Model:
    return fit_model(measurements, geometry="closed_form").model


def _contact_integral(measurements: Measurements) -> Model:
    return fit_model(measurements, geometry="contact_integral").model


def _widths(measurements: Measurements) -> int:
    """How many widths the wheels have; plates have none."""
    wheel = measurements.conditions.contact != PLATE
    return int(np.unique(np.round(measurements.conditions.width[wheel], 4)).size)


def standard_contenders(measurements: Measurements) -> list[Contender]:
    """Bekker's and the paper's closed forms and the contact integral, each fitted to the data."""
    widths = _widths(measurements)
    if widths > 1:
        modulus = f"kc and kphi of K = kc/b + kphi fitted over {widths} widths"
    else:
        modulus = "with one width only K = kc/b + kphi is determined, not kc and kphi"
    sizes = np.unique(np.round(measurements.conditions.diameter, 6)).size
    exponent = "" if sizes > 1 else "; with one diameter only k D^m is determined, not m"
    same = "" if sizes > 1 else ", and the curve is the one of bekker"
    return [
        Contender(
            "bekker",
            f"Bekker 1956, closed form (eq. 7), P = K z^n without diameter; {modulus}",
            _bekker,
        ),
        Contender(
            "proposed",
            "Meirion-Griffith and Spenko 2011, closed form (eq. 10), P = k z^n D^m"
            + exponent
            + same,
            _proposed,
        ),
        Contender(
            "contact_integral",
            "P = k z^n D^m with the exact contact integral in place of eq. 10" + exponent,
            _contact_integral,
        ),
    ]
