"""The models that a comparison sets side by side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects.width_dependent_modulus import Bekker
from smallwheel_ros.fitting.parameters import ParameterVector, part_of
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.fitting.soils import one_diameter, parameter_vector, soil_names
from smallwheel_ros.model import Model
from smallwheel_ros.physics.conditions import PLATE

# Names of the standard contenders; the fit of the last tells what a true model would leave.
STANDARD = ("bekker", "meirion_griffith_spenko", "contact_integral")


@dataclass(frozen=True)
class Contender:
    """A model to compare: one that is fitted to the data, or one that stands as it is.

    vector: gives the free parameters of a fit to some points; None for a model that stands. file,
    fitted_to: where a standing model came from, and the SHA-256 of the data that it was fitted to,
    "" if unknown.
    """

    name: str
    description: str
    vector: Callable[[Points], ParameterVector] | None = None
    model: Model | None = None
    file: str = ""
    fitted_to: str = ""


def standard_contenders(points: Points) -> list[Contender]:
    """Bekker's law, that of Meirion-Griffith & Spenko and the contact integral."""
    widths = _widths(points)

    def bekker(training: Points) -> ParameterVector:
        # Over several widths K = kc/b + kphi: its share of kc is a parameter of the effect.
        parts = [part_of(Bekker())] if widths > 1 else []
        return parameter_vector(training, (), "closed_form", parts=parts, fixed_m=0.0)

    def meirion_griffith_spenko(training: Points) -> ParameterVector:
        return parameter_vector(training, (), "closed_form")

    def contact_integral(training: Points) -> ParameterVector:
        return parameter_vector(training, (), "contact_integral")

    if widths > 1:
        modulus = f"kc and kphi of K = kc/b + kphi fitted over {widths} widths"
    else:
        modulus = "with one width only K = kc/b + kphi is determined, not kc and kphi"
    exponent = same = ""
    if all(one_diameter(points, soil) for soil in soil_names(points)):
        exponent = "; with one diameter only k D^m is determined, not m"
        same = ", and the law is that of bekker" if widths == 1 else ""
    return [
        Contender(
            STANDARD[0],
            f"Bekker 1956, closed form (eq. 7), P = K z^n without diameter; {modulus}",
            bekker,
        ),
        Contender(
            STANDARD[1],
            "Meirion-Griffith & Spenko 2011, closed form (eq. 10), P = k z^n D^m" + exponent + same,
            meirion_griffith_spenko,
        ),
        Contender(
            STANDARD[2],
            "P = k z^n D^m with the exact contact integral in place of eq. 10" + exponent,
            contact_integral,
        ),
    ]


def _widths(points: Points) -> int:
    """How many widths the wheels have; plates have none."""
    wheel = points.conditions.contact != PLATE
    return int(np.unique(np.round(points.conditions.width[wheel], 4)).size)
