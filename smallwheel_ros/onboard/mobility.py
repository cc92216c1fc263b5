"""What a wheel can do in the soil as it is estimated: sinkage, resistance, thrust, drawbar pull.

Each with its standard deviation, propagated to first order from what is uncertain: the soil's law
and strength, load and slip.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.onboard.force_gradients import (
    REFERENCE_SLIP,
    UNCERTAIN,
    ForceGradients,
    force_gradients,
)
from smallwheel_ros.physics.conditions import PRESSED, ROLLING
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

Array = NDArray[np.float64]

_LOAD, _SLIP = UNCERTAIN.index("load"), UNCERTAIN.index("slip")
_HARDLY_TRAVELS = 0.95  # slip over which energy per metre means nothing


class MobilityError(SmallwheelError):
    """A wheel, a load or a slip that mobility cannot be worked out for."""


class Status(IntEnum):
    """The most serious of the conditions that apply; numbered as in MobilityEstimate.msg."""

    OK = 0
    PRIOR_ONLY = 1
    SLIP_UNKNOWN = 2
    REJECTED = 3
    LOAD_MISSING = 4
    SUNK_TO_AXLE = 5


@dataclass(frozen=True)
class WheelForces:
    """Sinkage (m) and forces (N) of a wheel.

    rolling_resistance_coefficient: resistance over load, 1. probability_drawbar_pull_positive:
    0 .. 1. Thrust, drawbar pull and its probability are None where slip is unknown, and for a
    pressed wheel, which shears no soil.

    margin: drawbar pull over load at the reference slip, 1: the tangent of the steepest slope on
    which this wheel carries its share; None for a pressed wheel. energy_per_metre: what the wheel
    puts into the soil per metre of travel, J/m: thrust times rim speed over travel speed; None
    where thrust is, and where the wheel hardly travels (slip over 0.95).
    """

    sinkage: Quantity
    compaction_resistance: Quantity
    other_resistance: Quantity
    rolling_resistance_coefficient: Quantity
    thrust: Quantity | None
    drawbar_pull: Quantity | None
    probability_drawbar_pull_positive: float | None
    margin: Quantity | None = None
    energy_per_metre: Quantity | None = None

    @property
    def steepest_slope(self) -> Quantity | None:
        """The slope that is held at the reference slip, rad; negative: not even level ground."""
        if self.margin is None:
            return None
        value, deviation = self.margin.value, self.margin.standard_deviation
        return Quantity(math.atan(value), deviation / (1.0 + value**2))


@dataclass(frozen=True)
class MobilityEstimate:
    """One wheel at one instant: what was measured, and what the model predicts; SI units.

    stamp: ns. status_text: all conditions that apply, in words. sinkage_predicted is from the soil
    as estimated before this sinkage was used, the forces are from after; both are None where load
    is missing or the wheel is sunk to its axle. digging_in: slip and sinkage grow while the wheel
    travels slower and slower.
    """

    wheel: str
    stamp: int
    status: Status
    status_text: str
    load: Quantity | None
    slip: Quantity | None
    sinkage_measured: Quantity | None
    sinkage_predicted: Quantity | None
    forces: WheelForces | None
    digging_in: bool = False


def wheel_forces(
    wheel: Wheel,
    soil: SoilEstimate,
    strength: Strength,
    load: Quantity,
    slip: Quantity | None,
    *,
    scatter: float = 0.0,
    reference_slip: float = REFERENCE_SLIP,
    effects: Sequence[Effect] = (),
    speed: float | None = None,
) -> WheelForces | None:
    """Sinkage and forces of a wheel in the estimated soil; None where it is sunk to its axle.

    Parameters
    ----------
    load, slip
        N; -1 .. 1, None when unknown.
    scatter
        Standard deviation of ln k from spot to spot, on top of that of the estimate.
    reference_slip
        Slip at which the margin is worked out, 1.
    effects, speed
        Effects of the model, and the travel speed (m/s) for those that read it.

    Raises
    ------
    MobilityError
        If load or slip is outside its domain, the wheel's contact is not known here, or the
        forces are not finite.
    ModelError
        If an effect lacks its covariate.
    """
    if not (math.isfinite(load.value) and load.value > 0):
        raise MobilityError(f"wheel {wheel.name}: load is {load.value!r} N, expected more than 0")
    if slip is not None and not abs(slip.value) <= 1:
        raise MobilityError(f"wheel {wheel.name}: slip is {slip.value!r}, expected -1 to 1")
    if wheel.contact not in (ROLLING, PRESSED):
        raise MobilityError(
            f"wheel {wheel.name}: contact is {wheel.contact!r}, expected {ROLLING} or {PRESSED}"
        )
    forces = force_gradients(
        wheel,
        soil,
        strength,
        load.value,
        None if slip is None else slip.value,
        reference_slip=reference_slip,
        effects=effects,
        speed=speed,
    )
    if forces is None:
        return None
    covariance = _covariance(soil, strength, load, slip, scatter)
    if not (np.isfinite(forces.value).all() and np.isfinite(forces.gradient).all()):
        raise MobilityError(
            f"wheel {wheel.name}: the model gives no finite forces for a load of {load.value:g} N"
            f" with n = {soil.n:g} and ln of reference pressure {soil.log_reference_pressure:g}"
        )
    # A wheel that is pushed straight down does not shear the soil along a path.
    rolling = wheel.contact == ROLLING
    return _quantities(
        forces,
        load.value,
        slip.value if slip is not None and rolling else None,
        covariance,
        rolling,
    )


def _covariance(
    soil: SoilEstimate, strength: Strength, load: Quantity, slip: Quantity | None, scatter: float
) -> Array:
    """Covariance of what is uncertain, in the order of `UNCERTAIN`."""
    covariance = np.zeros((len(UNCERTAIN), len(UNCERTAIN)))
    covariance[:3, :3] = soil.log_covariance
    covariance[0, 0] += scatter**2
    single = (load, slip, strength.cohesion, strength.friction_angle, strength.shear_displacement)
    for i, quantity in enumerate(single, start=3):
        covariance[i, i] = 0.0 if quantity is None else quantity.standard_deviation**2
    return covariance


def _quantities(
    forces: ForceGradients, load: float, slip: float | None, covariance: Array, rolling: bool
) -> WheelForces:
    """Put values and deviations together; slip is None where there is no traction to tell of."""
    sinkage, compaction, other, thrust, pull = forces.value.tolist()
    by_sinkage, by_compaction, by_other, by_thrust, by_pull = forces.gradient
    resistance, by_resistance = compaction + other, by_compaction + by_other
    by_coefficient, by_margin = by_resistance / load, by_pull / load
    by_coefficient[_LOAD] -= resistance / load**2
    by_margin[_LOAD] -= pull / load**2
    ratio, by_ratio = _rim_over_travel(slip)
    by_energy = ratio * by_thrust
    by_energy[_SLIP] += by_ratio * thrust
    gradients = np.stack(
        [
            by_sinkage,
            by_compaction,
            by_other,
            by_coefficient,
            by_thrust,
            by_thrust - by_resistance,
            by_margin,
            by_energy,
        ]
    )
    # Rounding can leave a variance that is zero a little below it.
    variance = np.maximum(np.einsum("ij,ij->i", gradients @ covariance, gradients), 0.0)
    values = (
        sinkage,
        compaction,
        other,
        resistance / load,
        thrust,
        thrust - resistance,
        pull / load,
        ratio * thrust,
    )
    depth, compacting, rest, coefficient, push, net, margin, energy = (
        Quantity(value, deviation)
        for value, deviation in zip(values, np.sqrt(variance).tolist(), strict=True)
    )
    traction = slip is not None
    return WheelForces(
        sinkage=depth,
        compaction_resistance=compacting,
        other_resistance=rest,
        rolling_resistance_coefficient=coefficient,
        thrust=push if traction else None,
        drawbar_pull=net if traction else None,
        probability_drawbar_pull_positive=probability_positive(net) if traction else None,
        margin=margin if rolling else None,
        energy_per_metre=energy if traction and ratio > 0.0 else None,
    )


def _rim_over_travel(slip: float | None) -> tuple[float, float]:
    """Rim speed over travel speed and its derivative by slip; zeros where it is not to be told."""
    if slip is None or slip > _HARDLY_TRAVELS:
        return 0.0, 0.0
    return (1.0 / (1.0 - slip), 1.0 / (1.0 - slip) ** 2) if slip >= 0 else (1.0 + slip, 1.0)


def probability_positive(quantity: Quantity) -> float:
    """Probability that a normally distributed quantity is above zero."""
    if quantity.standard_deviation == 0.0:
        return float(quantity.value > 0.0)
    return 0.5 * math.erfc(-quantity.value / quantity.standard_deviation / math.sqrt(2.0))
