# SPDX-License-Identifier: Apache-2.0
"""What a wheel can do in the soil as it is estimated: sinkage, resistance, thrust, drawbar pull.

Each with its standard deviation, propagated to first order from what is uncertain: the soil's law
and strength, load and slip.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from smallwheel_ros.estimator.traction import TractionEstimator
from smallwheel_ros.estimator.traction_filter import TractionFilter
from smallwheel_ros.estimator.traction_samples import WheelStep
from smallwheel_ros.estimator.traction_state import OTHER
from smallwheel_ros.onboard.wheel_on_soil import (
    REFERENCE_SLIP,
    Array,
    MobilityError,
    WheelOnSoil,
)
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.point_thrust import point_contact_length
from smallwheel_ros.physics.wheel import Quantity

_HARDLY_TRAVELS = 0.95  # slip over which energy per metre means nothing
_LENGTHS = np.geomspace(1e-3, 0.5 * math.pi, 128).astype(np.float64)  # of the diameter; to the axle
_LEAST_STD = 0.15  # N: resolution of any pull
# Of a thrust about what law and grip say, over the thrust. Means of repeated trials on a rig differ by
# 0.3 N of a limit of 12 N (Pavlov 2022, 27 trials at 9 slips); stretches of 0.1 m by somewhat more.
SCATTER = 0.05
# Of the thrust at the reference slip, where strength was told near slip 0.1: other forms of the shear
# curve; and where no balance has told it, also what single wheels have of their own.
_FORM, _FORM_OF_WHEELS = 0.08, 0.15


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


def wheel_forces(
    on: WheelOnSoil,
    traction: TractionEstimator,
    slip: Quantity | None,
    *,
    time: float = 0.0,
    torque: float | None = None,
    reference: WheelOnSoil | None,
    reference_slip: float = REFERENCE_SLIP,
) -> WheelForces:
    """Forces of a wheel on the estimated soil.

    slip: None when unknown. time: s. torque: N m at the wheel, where it is measured. reference: the
    wheel as it is at the reference slip, which is `on` where no effect reads the slip; None where it
    is sunk to its axle there.

    Raises MobilityError if the forces are not finite.
    """
    load = on.load.value
    thrust = pull = energy = margin = None
    beyond = unsure = 0.0  # N, resistance that the law does not give
    if on.wheel.contact == ROLLING:  # a pressed wheel does not shear the soil along a path
        beyond, unsure = traction.now.other_resistance(on.contact)
        if slip is not None:
            thrust, pull, energy = _pulls(on, traction, slip, beyond, time, torque)
        margin = Quantity(-1.0, 0.0)  # nothing can be held
        if reference is not None:
            margin = _margin(reference, traction.reserve, reference_slip)
    more, whole = unsure**2, on.contact.resistance.value + beyond
    of_other = on.variance(by_other=1.0, by_log_load=beyond) + more
    # Over the load, whose own deviation counts in both.
    of_ratio = on.variance(0.0, 1.0, 1.0, beyond - whole) + more
    forces = WheelForces(
        sinkage=Quantity(on.sinkage, math.sqrt(on.variance(by_sinkage=1.0))),
        compaction_resistance=Quantity(on.compaction, math.sqrt(on.variance(by_compaction=1.0))),
        other_resistance=Quantity(on.other + beyond, math.sqrt(of_other)),
        rolling_resistance_coefficient=Quantity(whole / load, math.sqrt(of_ratio) / load),
        thrust=thrust,
        drawbar_pull=pull,
        probability_drawbar_pull_positive=None if pull is None else probability_positive(pull),
        margin=margin,
        energy_per_metre=energy,
    )
    _check_finite(forces, on)
    return forces


def _check_finite(forces: WheelForces, on: WheelOnSoil) -> None:
    for value in vars(forces).values():
        if isinstance(value, Quantity) and not math.isfinite(
            value.value + value.standard_deviation
        ):
            raise MobilityError(
                f"wheel {on.wheel.name}: the model gives no finite forces for a load of"
                f" {on.load.value:g} N with n = {on.soil.n:g} and ln of reference pressure"
                f" {on.soil.log_reference_pressure:g}"
            )


def _pulls(
    on: WheelOnSoil,
    traction: TractionEstimator,
    slip: Quantity,
    beyond: float,
    time: float,
    torque: float | None,
) -> tuple[Quantity, Quantity, Quantity | None]:
    """Thrust, drawbar pull, energy per metre at the present slip; a torque is fused with the thrust.

    beyond: resistance (N) that the law does not give.
    """
    strength = traction.now
    step, averaged = traction.wheel(on.wheel.name, on.contact, slip.value, time)
    push = strength.thrust(step)
    # The error of a mean over a step is in the filter's state.
    own_slip = 0.0 if averaged else (push.by_slip * slip.standard_deviation) ** 2
    noise = (SCATTER * push.value) ** 2 + own_slip + _LEAST_STD**2
    net, net_row = strength.net(push, on.contact)
    thrust, spread = push.value, strength.spread(push, push.row) + noise
    net_spread = strength.spread(push, net_row) + noise
    if torque is not None:
        told = strength.torque(step, torque, noise)
        thrust, spread = told.corrected(thrust, spread, push.row)
        net, net_spread = told.corrected(net, net_spread, net_row)
    # The law's error of the resistance is in the filter's state.
    by_law = on.beyond_resistance(push.by_sinkage, push.by_log_load - beyond)
    pull = Quantity(net, math.sqrt(max(net_spread + by_law, _LEAST_STD**2)))
    by_law = on.variance(push.by_sinkage, by_log_load=push.by_log_load)
    deviation = math.sqrt(spread + by_law)
    energy = None
    ratio = _rim_over_travel(slip.value)
    if ratio is not None:
        over = ratio[1] * slip.standard_deviation * thrust
        energy = Quantity(ratio[0] * thrust, math.hypot(ratio[0] * deviation, over))
    return Quantity(thrust, deviation), pull, energy


def _margin(on: WheelOnSoil, strength: TractionFilter, slip: float) -> Quantity:
    """Net traction over load at the reference slip, which falls neither on harder ground.

    In the model as it stands a harder soil has a shorter contact, which mobilises less thrust, so that
    hard ground would hold nothing. Below the length at which the net traction is largest, thrust stays
    what it is there, while resistance goes on falling.
    """
    load = on.load.value
    step = WheelStep(strength.order[on.wheel.name], on.contact, slip)
    length, by_depth = point_contact_length(on.sinkage, on.wheel.diameter)
    best = _best_length(on, length, strength, slip)
    contact = (length, by_depth) if length > best else (best, 0.0)
    push = strength.thrust(step, contact, exact_slip=True)
    net, row = strength.net(push, on.contact)
    by_law = on.beyond_resistance(push.by_sinkage, push.by_log_load - net)
    form = _FORM if strength.mass > 0.0 else _FORM_OF_WHEELS
    spread = strength.spread(push, row) + by_law + (form * push.value) ** 2
    return Quantity(net / load, math.sqrt(max(spread, _LEAST_STD**2)) / load)


def _best_length(on: WheelOnSoil, length: float, strength: TractionFilter, slip: float) -> float:
    """Contact length (m) of the stiffness at which H - R is largest under this load.

    length: of the contact as it is, m.

    Under one load compaction resistance is nearly in proportion to the length of the contact,
    R/W = l / (D (n + 1) I) with the contact integral I, and rises a little faster where the wheel is
    deep. H rises with l ever more slowly. So the margin never falls on stiffer ground.
    """
    wheel, shear = on.wheel, strength.kalman.x[:OTHER].tolist()
    lengths, cohesion, friction = _held(wheel.diameter, wheel.width, slip, *shear)
    pull = cohesion + on.load.value * friction - on.compaction / length * lengths
    return float(lengths[np.argmax(pull)])


@lru_cache(maxsize=256)
def _held(
    diameter: float,
    width: float,
    slip: float,
    cohesion: float,
    friction_angle: float,
    log_shear: float,
) -> tuple[Array, Array, Array]:
    """Contact lengths (m), what cohesion holds on them at a slip (N), and friction over load.

    They stay the same until something tells of the strength.
    """
    lengths = _LENGTHS * diameter
    x = slip * lengths / math.exp(log_shear)
    mobilised = 1.0 + np.expm1(-x) / x
    held = width * lengths * max(cohesion, 0.0) * mobilised
    return lengths, held, math.tan(friction_angle) * mobilised


def _rim_over_travel(slip: float) -> tuple[float, float] | None:
    """Rim speed over travel speed and its slope by slip; None where it is not to be told."""
    if slip > _HARDLY_TRAVELS:
        return None
    return (1.0 / (1.0 - slip), 1.0 / (1.0 - slip) ** 2) if slip >= 0 else (1.0 + slip, 1.0)


def probability_positive(quantity: Quantity) -> float:
    """Probability that a normally distributed quantity is above zero."""
    if quantity.standard_deviation == 0.0:
        return float(quantity.value > 0.0)
    return 0.5 * math.erfc(-quantity.value / quantity.standard_deviation / math.sqrt(2.0))
