"""Sinkage, resistance and thrust of one wheel with their derivatives by all that is uncertain.

Without effects the derivatives are worked out by hand, in plain floats, since this runs for every
measurement; with effects they are differences of the model itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.estimator.point_sinkage import point_sinkage
from smallwheel_ros.model import Model, Prediction, predict
from smallwheel_ros.physics.conditions import PRESSED, ROLLING, Conditions
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.physics.wheel import Strength, Wheel

Array = NDArray[np.float64]


# The quantities that are uncertain, in the order of gradients and covariances.
UNCERTAIN = (
    "log_reference_pressure",
    "n",
    "m",
    "load",
    "slip",
    "cohesion",
    "friction_angle",
    "shear_displacement",
)
_COUNT, _SLIP = len(UNCERTAIN), UNCERTAIN.index("slip")

# The slip at which pulls are compared: what a driver accepts on a slope before turning back. With
# the 20 % at which wheels are often compared on a bench, small wheels hold hardly any slope.
REFERENCE_SLIP = 0.4


@dataclass(frozen=True)
class ForceGradients:
    """Sinkage (m), compaction resistance, other resistance, thrust, pull (N), and derivatives.

    The pull is the drawbar pull at the reference slip, whatever the slip is now. value: shape (5,).
    gradient: shape (5, 8), by `UNCERTAIN`.
    """

    value: Array
    gradient: Array


def force_gradients(
    wheel: Wheel,
    soil: SoilEstimate,
    strength: Strength,
    load: float,
    slip: float | None,
    *,
    reference_slip: float = REFERENCE_SLIP,
    effects: Sequence[Effect] = (),
    speed: float | None = None,
) -> ForceGradients | None:
    """Forces of a wheel and their derivatives; None where it is sunk to its axle.

    Without slip thrust is 0; for a pressed wheel thrust and pull are. Where the wheel would sink to
    its axle at the reference slip only, the pull is minus the load: nothing can be held there.
    Arguments as in `mobility.wheel_forces`, which checks them.

    Raises
    ------
    ModelError
        If an effect lacks its covariate.
    """
    if effects:
        return _numerical(wheel, soil, strength, load, slip, reference_slip, effects, speed)
    return _analytical(wheel, soil, strength, load, slip, reference_slip)


def _analytical(
    wheel: Wheel,
    soil: SoilEstimate,
    strength: Strength,
    load: float,
    slip: float | None,
    reference_slip: float,
) -> ForceGradients | None:
    n, log_depth = soil.n, math.log(soil.reference_sinkage)
    log_size = math.log(wheel.diameter / soil.reference_diameter)
    log_modulus = soil.log_reference_pressure - n * log_depth + soil.m * log_size
    # A pressed wheel meets the soil on both sides: each carries half.
    carried = 0.5 * load if wheel.contact == PRESSED else load
    point = point_sinkage(carried, wheel.diameter, wheel.width, log_modulus, n)
    if point.sunk_to_axle:
        return None
    sinkage = math.exp(point.log_sinkage)
    gradient = np.zeros((5, _COUNT))
    log_sinkage = np.zeros(_COUNT)  # gradient of ln z
    log_sinkage[:4] = (
        -point.slope_load,
        point.slope_exponent + point.slope_load * log_depth,
        -point.slope_load * log_size,
        point.slope_load / load,
    )
    gradient[0] = sinkage * log_sinkage
    compaction = push = pull = 0.0
    if wheel.contact == ROLLING:
        compaction = wheel.width * math.exp(log_modulus + (n + 1.0) * point.log_sinkage) / (n + 1.0)
        log_compaction = (n + 1.0) * log_sinkage
        log_compaction[0] += 1.0
        log_compaction[1] += point.log_sinkage - log_depth - 1.0 / (n + 1.0)
        log_compaction[2] += log_size
        gradient[1] = compaction * log_compaction
        if slip is not None:
            push, gradient[3] = _thrust(wheel, strength, load, slip, sinkage, gradient[0])
        held, gradient[4] = _thrust(wheel, strength, load, reference_slip, sinkage, gradient[0])
        pull = held - compaction
        gradient[4] -= gradient[1]
        gradient[4, _SLIP] = 0.0  # the reference is exact
    return ForceGradients(np.array([sinkage, compaction, 0.0, push, pull]), gradient)


def _thrust(
    wheel: Wheel,
    strength: Strength,
    load: float,
    slip: float,
    sinkage: float,
    by_sinkage: Array,
) -> tuple[float, Array]:
    """Thrust in the integrated form of `traction.thrust`, and its gradient."""
    cohesion, kappa = strength.cohesion.value, strength.shear_displacement.value
    tangent = math.tan(strength.friction_angle.value)
    depth = 2.0 * sinkage / wheel.diameter  # over the radius
    length = 0.5 * wheel.diameter * math.acos(1.0 - depth)
    length_slope = 1.0 / math.sqrt(depth * (2.0 - depth))  # dl/dz
    limit = wheel.width * length * cohesion + load * tangent
    x = abs(slip) * length / kappa
    if x > 1e-4:
        rising = -math.expm1(-x)
        share = 1.0 - rising / x
        share_slope = (rising / x - (1.0 - rising)) / x
    else:
        share, share_slope = x / 2.0 - x**2 / 6.0, 0.5 - x / 3.0
    sign = math.copysign(1.0, slip)
    by_length = wheel.width * cohesion * share + limit * share_slope * abs(slip) / kappa
    gradient = (sign * by_length * length_slope) * by_sinkage
    gradient[3] += sign * tangent * share
    gradient[4] += limit * share_slope * length / kappa  # even in slip: no sign
    gradient[5] += sign * wheel.width * length * share
    gradient[6] += sign * load * (1.0 + tangent**2) * share
    gradient[7] -= sign * limit * share_slope * x / kappa
    return sign * limit * share, gradient


def _numerical(
    wheel: Wheel,
    soil: SoilEstimate,
    strength: Strength,
    load: float,
    slip: float | None,
    reference_slip: float,
    effects: Sequence[Effect],
    speed: float | None,
) -> ForceGradients | None:
    centre = np.array(
        [
            soil.log_reference_pressure,
            soil.n,
            soil.m,
            load,
            0.0 if slip is None else slip,
            strength.cohesion.value,
            strength.friction_angle.value,
            strength.shear_displacement.value,
        ]
    )
    # Central differences: the cube root of the rounding error is about the best step.
    step = 1e-5 * np.maximum(np.abs(centre), (1.0, 1.0, 1.0, 0.0, 0.1, 100.0, 0.1, 0.0))
    rows = np.concatenate([centre[None], centre + np.diag(step), centre - np.diag(step)])
    rows[:, _SLIP] = np.clip(rows[:, _SLIP], -1.0, 1.0)
    rows[:, 5:] = np.maximum(rows[:, 5:], 0.0)
    soils = _soils(rows, soil)
    slips = None if slip is None else rows[:, _SLIP]
    now = _predicted(wheel, soils, rows[:, 3], slips, effects, speed)
    if now.immobilised[0]:
        return None
    rolling = wheel.contact == ROLLING
    nothing: Array = np.zeros(len(rows))
    push = now.thrust if now.thrust is not None and rolling else nothing
    pull = nothing
    if rolling:
        held_slip = np.full(len(rows), reference_slip)
        held = _predicted(wheel, soils, rows[:, 3], held_slip, effects, speed)
        assert held.thrust is not None
        sunk = held.immobilised[0]
        pull = -rows[:, 3] if sunk else held.thrust - held.resistance
    compaction = now.compaction_resistance
    table = np.stack([now.sinkage, compaction, now.resistance - compaction, push, pull])
    up, down = slice(1, _COUNT + 1), slice(_COUNT + 1, None)
    # Where the clip to the domain has shortened a step, the difference is over what is left.
    width = np.diagonal(rows[up] - rows[down])
    return ForceGradients(table[:, 0], (table[:, up] - table[:, down]) / width)


def _soils(rows: Array, soil: SoilEstimate) -> list[Soil]:
    """One soil for each row of what is uncertain."""
    depth, size = math.log(soil.reference_sinkage), math.log(soil.reference_diameter)
    return [
        Soil(str(i), math.exp(p - n * depth - m * size), n, m, *strength)
        for i, (p, n, m, _, _, *strength) in enumerate(rows.tolist())
    ]


def _predicted(
    wheel: Wheel,
    soils: Sequence[Soil],
    load: Array,
    slip: Array | None,
    effects: Sequence[Effect],
    speed: float | None,
) -> Prediction:
    covariates = {} if slip is None else {"slip": slip}
    if speed is not None:
        covariates["speed"] = np.full(len(soils), speed)
    conditions = Conditions.of(
        load,
        wheel.diameter,
        wheel.width,
        contact=wheel.contact,
        soil=[soil.name for soil in soils],
        **covariates,
    )
    return predict(Model(soils, effects=effects), conditions)
