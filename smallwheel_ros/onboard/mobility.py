"""What a wheel can do in the soil as it is estimated: sinkage, resistance, thrust, drawbar pull.

Each with its standard deviation, propagated to first order from what is uncertain: the soil's law
and strength, load and slip.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, Protocol

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.estimator.law_covariance import LawCovariance
from smallwheel_ros.onboard.force_gradients import (
    REFERENCE_SLIP,
    UNCERTAIN,
    ForceGradients,
    Gradient,
    force_gradients,
)
from smallwheel_ros.onboard.measured_strength import MeasuredSpread, with_other_resistance
from smallwheel_ros.physics.conditions import PRESSED, ROLLING
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

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
    strength
        As configured; used where no drawbar pull tells a better one (`SoilEstimate.strength`).
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
        strength if soil.strength is None else soil.strength.strength,
        load.value,
        None if slip is None else slip.value,
        reference_slip=reference_slip,
        effects=effects,
        speed=speed,
    )
    if forces is None:
        return None
    spread: Spread
    if soil.strength is None:
        spread = _Spread.of(soil, strength, load, slip, scatter)
    else:
        forces = with_other_resistance(forces, soil.strength, wheel, load.value)
        spread = MeasuredSpread.of(soil, soil.strength, load, slip, scatter)
    # A sum is finite only where everything in it is.
    if not math.isfinite(sum(forces.value) + sum(map(sum, forces.gradient))):
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
        spread,
        rolling,
    )


class Spread(Protocol):
    """How uncertain everything is that forces are differentiated by."""

    def quantity(self, value: float, gradient: Gradient) -> Quantity:
        """Put a value together with its standard deviation, to first order."""


class _Spread(NamedTuple):
    """How uncertain everything in `UNCERTAIN` is.

    law: of ln pressure, n and m. single: variances of the others, which depend on nothing.
    """

    law: LawCovariance
    single: tuple[float, float, float, float, float]

    @classmethod
    def of(
        cls,
        soil: SoilEstimate,
        strength: Strength,
        load: Quantity,
        slip: Quantity | None,
        scatter: float,
    ) -> _Spread:
        law = soil.law_covariance
        return cls(
            LawCovariance(law.pp + scatter**2, *law[1:]),
            (
                load.standard_deviation**2,
                0.0 if slip is None else slip.standard_deviation**2,
                strength.cohesion.standard_deviation**2,
                strength.friction_angle.standard_deviation**2,
                strength.shear_displacement.standard_deviation**2,
            ),
        )

    def quantity(self, value: float, gradient: Gradient) -> Quantity:
        """Put a value together with its standard deviation, to first order."""
        p, n, m, load, slip, cohesion, angle, kappa = gradient
        by_load, by_slip, by_cohesion, by_angle, by_kappa = self.single
        variance = (
            self.law.variance((p, n, m))
            + load * load * by_load
            + slip * slip * by_slip
            + cohesion * cohesion * by_cohesion
            + angle * angle * by_angle
            + kappa * kappa * by_kappa
        )
        # Rounding can leave a variance that is zero a little below it.
        return Quantity(value, math.sqrt(max(variance, 0.0)))


def _quantities(
    forces: ForceGradients, load: float, slip: float | None, spread: Spread, rolling: bool
) -> WheelForces:
    """Put values and deviations together; slip is None where there is no traction to tell of."""
    sinkage, compaction, other, thrust, pull = forces.value
    by_sinkage, by_compaction, by_other, by_thrust, by_pull = forces.gradient
    resistance, by_resistance = compaction, by_compaction
    rest = Quantity(0.0, 0.0)
    if any(by_other):  # only with effects
        resistance, by_resistance = compaction + other, _sum(by_compaction, by_other)
        rest = spread.quantity(other, by_other)
    by_coefficient = [slope / load for slope in by_resistance]
    by_coefficient[_LOAD] -= resistance / load**2
    push = net = energy = margin = None
    if slip is not None:
        push = spread.quantity(thrust, by_thrust)
        net = spread.quantity(thrust - resistance, _sum(by_thrust, by_resistance, -1.0))
        ratio, by_ratio = _rim_over_travel(slip)
        if ratio > 0.0:
            by_energy = [ratio * slope for slope in by_thrust]
            by_energy[_SLIP] += by_ratio * thrust
            energy = spread.quantity(ratio * thrust, by_energy)
    if rolling:
        by_margin = [slope / load for slope in by_pull]
        by_margin[_LOAD] -= pull / load**2
        margin = spread.quantity(pull / load, by_margin)
    return WheelForces(
        sinkage=spread.quantity(sinkage, by_sinkage),
        compaction_resistance=spread.quantity(compaction, by_compaction),
        other_resistance=rest,
        rolling_resistance_coefficient=spread.quantity(resistance / load, by_coefficient),
        thrust=push,
        drawbar_pull=net,
        probability_drawbar_pull_positive=None if net is None else probability_positive(net),
        margin=margin,
        energy_per_metre=energy,
    )


def _sum(one: Gradient, other: Gradient, factor: float = 1.0) -> list[float]:
    return [a + factor * b for a, b in zip(one, other, strict=True)]


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
