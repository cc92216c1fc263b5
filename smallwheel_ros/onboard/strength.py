# SPDX-License-Identifier: Apache-2.0
"""The initial strength on board: that of a model file, of a soil of the library, or of any ground.

Its means are those of the bench's predictions, so that both give the same pull. Its deviations are
those of the fit plus those of a field, or, if nothing was measured, the spread of published values.
"""

from __future__ import annotations

import math

import numpy as np

from smallwheel_ros.fitting.parameters import STRENGTH_PARAMETERS
from smallwheel_ros.model.model import CalibratedModel
from smallwheel_ros.physics.soil import Soil, usual_strength
from smallwheel_ros.physics.wheel import Quantity, Strength

# What the soil of a field differs by from its own sample in a laboratory, from place to place: friction
# angles of sand by 5 to 15 % (Cherubini 1997, as Phoon and Kulhawy 1999, fig. 5), drained cohesions by 10 to
# 50 % (Probabilistic Model Code of the JCSS, 3.7, indicative deviations from point to point): the middles.
_FIELD_FRICTION, _FIELD_COHESION = 0.1, 0.3
# Names in a model's covariance of c, phi, ln K, eta and mu.
_FITTED = ("cohesion", "friction_angle", "log_shear_displacement", "rolling_share", "rim_friction")


def strength_of(model: CalibratedModel, soil: Soil) -> tuple[Strength, bool]:
    """Return the strength with which the estimate starts on a soil of a model file.

    It is the fitted one, with deviations widened by the scatter of a field, or, if the friction angle was not
    fitted, the usual one of such a soil.

    Parameters
    ----------
    model
        The model, with the covariance of its parameters.
    soil
        One of its soils.

    Returns
    -------
    strength : Strength
        Means, standard deviations and correlations, SI.
    measured : bool
        Whether it was measured, that is, whether the friction angle was fitted.
    """
    usual = _with_or_without_lugs(usual_strength(soil))
    measured = [name for name in _FITTED if f"{soil.name}.{name}" in model.names]
    if "friction_angle" not in measured:
        return usual, False
    before = (
        usual.cohesion.standard_deviation, usual.friction_angle.standard_deviation,
        usual.shear_displacement.standard_deviation / soil.shear_displacement,
        usual.rolling_share.standard_deviation, usual.rim_friction.standard_deviation,
    )  # fmt: skip
    covariance = np.diag(np.square(before))
    places = [_FITTED.index(name) for name in measured]
    at = [model.names.index(f"{soil.name}.{name}") for name in measured]
    covariance[np.ix_(places, places)] = model.covariance[np.ix_(at, at)]
    deviations = np.sqrt(np.diag(covariance))
    safe = np.where(deviations > 0.0, deviations, 1.0)
    c, phi, log_shear, eta, mu = deviations.tolist()
    found = Strength(
        Quantity(soil.cohesion, c),
        Quantity(soil.friction_angle, phi),
        Quantity(soil.shear_displacement, soil.shear_displacement * log_shear),
        Quantity(soil.rolling_share, eta),
        Quantity(soil.rim_friction, mu),
        usual.pressure_peak,
        covariance / np.outer(safe, safe) + np.diag(np.where(deviations > 0.0, 0.0, 1.0)),
    )
    field = {"friction_angle": _FIELD_FRICTION * soil.friction_angle}
    if "cohesion" in measured:
        field["cohesion"] = _FIELD_COHESION * soil.cohesion
    return found.wider(**field), True


def any_strength() -> Strength:
    """Return the strength of ground of which nothing is known: the prior of a fit."""
    c, phi, log_shear = (
        STRENGTH_PARAMETERS[name][1]
        for name in ("cohesion", "friction_angle", "log_shear_displacement")
    )
    shear = math.exp(log_shear.centre)
    return _with_or_without_lugs(
        Strength(
            Quantity(c.centre, c.deviation),
            Quantity(phi.centre, phi.deviation),
            Quantity(shear, shear * log_shear.deviation),
        )
    )


def _with_or_without_lugs(strength: Strength) -> Strength:
    """Widen the rim friction mu up to 1, that between lugs, as it is not known if a wheel has lugs."""
    return strength.wider(rim_friction=1.0 - strength.rim_friction.value)
