"""Sinkage, resistance and thrust of one wheel with their derivatives by all that is uncertain.

Without effects the derivatives are worked out by hand, in plain floats, since this runs for every
measurement and NumPy's cost per call is far above the arithmetic's; with effects they are
differences of the model itself.
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
from smallwheel_ros.physics.point_thrust import point_contact_length, point_thrust
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.physics.wheel import Strength, Wheel

Array = NDArray[np.float64]
Gradient = Sequence[float]  # eight derivatives, by `UNCERTAIN`

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
_NOTHING: Gradient = (0.0,) * _COUNT

# The slip at which pulls are compared: what a driver accepts on a slope before turning back. With
# the 20 % at which wheels are often compared on a bench, small wheels hold hardly any slope.
REFERENCE_SLIP = 0.4


@dataclass(frozen=True)
class ForceGradients:
    """Sinkage (m), compaction resistance, other resistance, thrust, pull (N), and derivatives.

    The pull is the drawbar pull at the reference slip, whatever the slip is now. gradient: for each
    of the five values its derivatives by `UNCERTAIN`.
    """

    value: tuple[float, float, float, float, float]
    gradient: tuple[Gradient, Gradient, Gradient, Gradient, Gradient]


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
    # Gradient of ln z; strength and slip do not change the sinkage.
    by_pressure, by_size = -point.slope_load, -point.slope_load * log_size
    by_n = point.slope_exponent + point.slope_load * log_depth
    by_load = point.slope_load / load
    by_sinkage = (
        sinkage * by_pressure,
        sinkage * by_n,
        sinkage * by_size,
        sinkage * by_load,
        *_NOTHING[4:],
    )
    if wheel.contact != ROLLING:
        rest = (_NOTHING, _NOTHING, _NOTHING, _NOTHING)
        return ForceGradients((sinkage, 0.0, 0.0, 0.0, 0.0), (by_sinkage, *rest))
    power = n + 1.0
    compaction = wheel.width * math.exp(log_modulus + power * point.log_sinkage) / power
    by_compaction = (
        compaction * (power * by_pressure + 1.0),
        compaction * (power * by_n + (point.log_sinkage - log_depth - 1.0 / power)),
        compaction * (power * by_size + log_size),
        compaction * (power * by_load),
        *_NOTHING[4:],
    )
    push, by_push = 0.0, _NOTHING
    if slip is not None:
        push, by_push = _thrust(wheel, strength, load, slip, sinkage, by_sinkage)
    held, by_held = _thrust(wheel, strength, load, reference_slip, sinkage, by_sinkage)
    by_pull = [one - other for one, other in zip(by_held, by_compaction, strict=True)]
    by_pull[_SLIP] = 0.0  # the reference is exact
    return ForceGradients(
        (sinkage, compaction, 0.0, push, held - compaction),
        (by_sinkage, by_compaction, _NOTHING, by_push, by_pull),
    )


def _thrust(
    wheel: Wheel,
    strength: Strength,
    load: float,
    slip: float,
    sinkage: float,
    by_sinkage: Gradient,
) -> tuple[float, Gradient]:
    """Thrust in the integrated form of `traction.thrust`, and its gradient."""
    kappa = strength.shear_displacement.value
    length, length_slope = point_contact_length(sinkage, wheel.diameter)
    push = point_thrust(
        load,
        slip,
        length,
        wheel.width,
        strength.cohesion.value,
        strength.friction_angle.value,
        kappa,
    )
    by_depth = push.by_length * length_slope
    by_pressure, by_n, by_size, by_load, *_ = by_sinkage
    return push.value, (
        by_depth * by_pressure,
        by_depth * by_n,
        by_depth * by_size,
        by_depth * by_load + push.by_load,
        push.by_slip,
        push.by_cohesion,
        push.by_friction,
        push.by_log_shear / kappa,
    )


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
        pull = -rows[:, 3] if sunk else held.thrust - held.true_resistance
    compaction = now.compaction_resistance
    table = np.stack([now.sinkage, compaction, now.true_resistance - compaction, push, pull])
    up, down = slice(1, _COUNT + 1), slice(_COUNT + 1, None)
    # Where the clip to the domain has shortened a step, the difference is over what is left.
    width = np.diagonal(rows[up] - rows[down])
    gradient = ((table[:, up] - table[:, down]) / width).tolist()
    return ForceGradients(tuple(table[:, 0].tolist()), tuple(gradient))


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
