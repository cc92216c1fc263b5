# SPDX-License-Identifier: Apache-2.0
"""What a wheel can do in the soil as it is estimated: sinkage, resistance, thrust, drawbar pull.

Each with its standard deviation, propagated to first order from what is uncertain: the soil's law
and strength, load and slip.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from smallwheel_ros.estimator.path_steps import RollingContact, Sample
from smallwheel_ros.estimator.reading import Reading, UpdateResult
from smallwheel_ros.estimator.soil_estimator import SoilEstimator
from smallwheel_ros.estimator.strength_filter import OTHER, WheelStep
from smallwheel_ros.estimator.traction import TractionEstimator
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.onboard.wheel_on_soil import (
    REFERENCE_SLIP,
    MobilityError,
    WheelOnSoil,
    mean_contacts,
    wheels_on_soil,
)
from smallwheel_ros.physics import stresses
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.stresses import ShearLaw
from smallwheel_ros.physics.wheel import Quantity

_HARDLY_TRAVELS = 0.95  # slip over which energy per metre means nothing
# Sinkages among which the best one is looked for, over the diameter, in steps of 9 % to near the axle.
_SINKAGES = np.geomspace(2e-3, 0.45, 64)
_LEAST_STD = 0.15  # N: resolution of any pull
# Of a thrust about what law and grip say, over the thrust. Means of repeated trials on a rig differ by
# 0.3 N of a limit of 12 N (Pavlov 2022, 27 trials at 9 slips); stretches of 0.1 m by somewhat more.
SCATTER = 0.05
# What the law of stresses is off by in a margin, over the load: where a balance has told of these wheels, and
# where none has. Held-out pulls of tables of single wheels: 0.03; 0.03 to 0.07 of wheels that were left out.
_FITTED, _UNFITTED = 0.03, 0.05


@dataclass(frozen=True)
class WheelForces:
    """Sinkage (m) and forces (N) of a wheel.

    rolling_resistance_coefficient: compaction and other resistance over load, 1. drawbar_pull: thrust less
    the resistance of the same stresses (`physics.stresses`) and the other resistance.
    probability_drawbar_pull_positive: 0 .. 1. Thrust, drawbar pull and its probability are None where slip
    is unknown, and for a pressed wheel, which shears no soil.

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


class Mobility:
    """What the wheels of a vehicle can do on soil and strength as they are believed now."""

    def __init__(
        self, settings: OnboardSettings, estimator: SoilEstimator, traction: TractionEstimator
    ) -> None:
        self._settings, self._estimator, self._traction = settings, estimator, traction

    def sinkage(
        self, reading: Reading, load: Quantity, update: UpdateResult | None
    ) -> Quantity | None:
        """Sinkage (m) as predicted without this measurement; None where sunk to the axle.

        update: what became of the measurement. Raises EstimatorError where the model has no sinkage.
        """
        if (
            update is not None
            and update.predicted_sinkage is not None
            and update.predicted_variance is not None
        ):
            return Quantity(update.predicted_sinkage, math.sqrt(update.predicted_variance))
        wheel = reading.wheel
        prediction = self._estimator.predict(
            load.value,
            wheel.diameter,
            wheel.width,
            slip=None if reading.slip is None else reading.slip.value,
            speed=reading.speed,
            contact=wheel.contact,
            load_std=load.standard_deviation,
            wheel=wheel.name,
        )
        if prediction.sunk_to_axle:
            return None
        return Quantity(prediction.sinkage, prediction.standard_deviation)

    def forces(self, reading: Reading, shown: Quantity) -> WheelForces | None:
        """Forces of a wheel under the load (N) that is shown; None where it is sunk to its axle.

        Raises MobilityError if they are not finite.
        """
        on, reference = self._now_and_at_reference([(reading, shown)])[0]
        if on is None:
            return None
        return wheel_forces(
            on,
            self._traction,
            reading.slip,
            time=reading.time,
            torque=reading.torque,
            reference=reference,
            reference_slip=self._settings.reference_slip,
        )

    def margins(self, readings: Sequence[tuple[Reading, Quantity]]) -> list[Quantity | None]:
        """Margins of rolling wheels under the loads (N) that are shown; None: sunk to the axle now."""
        return [
            None
            if on is None
            else wheel_margin(reference, self._traction, self._settings.reference_slip)
            for on, reference in self._now_and_at_reference(readings)
        ]

    def mean_contacts(
        self, samples: Mapping[str, Sequence[Sample]]
    ) -> Mapping[str, RollingContact]:
        """Mean contacts of wheels over a step of the path, by name."""
        effects = self._settings.effects
        return mean_contacts(
            samples,
            scatter=self._settings.estimator.soil_scatter,
            effects=effects,
            strength=self._traction.estimate().strength if effects else None,
        )

    def _now_and_at_reference(
        self, readings: Sequence[tuple[Reading, Quantity]]
    ) -> list[tuple[WheelOnSoil | None, WheelOnSoil | None]]:
        """Wheels as they are now, and at the reference slip: the same, where no effect reads the slip."""
        effects, reference = self._settings.effects, Quantity(self._settings.reference_slip, 0.0)
        samples = [
            Sample(reading, self._estimator.local(reading.wheel.name), shown)
            for reading, shown in readings
        ]
        if effects:
            samples += [
                one._replace(reading=one.reading._replace(slip=reference)) for one in samples
            ]
        found = wheels_on_soil(
            samples,
            missed=self._estimator.missed_variance,
            scatter=self._settings.estimator.soil_scatter,
            effects=effects,
            strength=self._traction.estimate().strength if effects else None,
        )
        return list(zip(found[: len(readings)], found[-len(readings) :], strict=True))


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
        state = traction.now.kalman
        beyond, unsure = load * float(state.x[OTHER]), load * math.sqrt(state.P[OTHER, OTHER])
        if slip is not None:
            thrust, pull, energy = _pulls(on, traction, slip, time, torque)
        margin = wheel_margin(reference, traction, reference_slip)
    more, whole = unsure**2, on.compaction + on.other + beyond
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
                f" {on.load.value:g} N with n = {on.exponent:g} and ln of reference pressure"
                f" {on.log_pressure:g}"
            )


def _pulls(
    on: WheelOnSoil,
    traction: TractionEstimator,
    slip: Quantity,
    time: float,
    torque: float | None,
) -> tuple[Quantity, Quantity, Quantity | None]:
    """Thrust, drawbar pull, energy per metre at the present slip; a torque is fused with both forces."""
    strength = traction.now
    step, averaged = traction.wheel(on.wheel.name, on.contact, slip.value, time)
    push, pull, _ = strength.forces(step)
    # The error of a mean over a step is in the filter's state.
    own_slip = 0.0 if averaged else (push.by_slip * slip.standard_deviation) ** 2
    noise = (SCATTER * push.value) ** 2 + own_slip + _LEAST_STD**2
    told = None if torque is None else strength.torque(step, torque, noise)
    found = []
    for force, by_other in ((push, 0.0), (pull, -1.0)):
        value, spread = force.value, strength.spread(push, force.row) + noise
        if told is not None:
            value, spread = told.corrected(value, spread, force.row)
        by_law = on.variance(force.by_sinkage, 0.0, by_other, force.by_log_load)
        found.append(Quantity(value, math.sqrt(max(spread + by_law, _LEAST_STD**2))))
    thrust, energy, ratio = found[0], None, _rim_over_travel(slip.value)
    if ratio is not None:
        over = ratio[1] * slip.standard_deviation * thrust.value
        deviation = math.hypot(ratio[0] * thrust.standard_deviation, over)
        energy = Quantity(ratio[0] * thrust.value, deviation)
    return thrust, found[1], energy


def wheel_margin(on: WheelOnSoil | None, traction: TractionEstimator, slip: float) -> Quantity:
    """Pull over load at a slip, which never falls on stiffer ground. on: None: sunk to its axle there.

    A wheel that hardly sinks has a short contact, on which soil is hardly sheared: by the law hard ground
    would hold next to nothing. Nobody has measured that, so ground is taken to hold as much as any softer
    one would: at the sinkage of the largest pull, where that is more than the wheel's own.
    """
    if on is None:
        return Quantity(-1.0, 0.0)  # nothing can be held
    strength = traction.reserve
    order, load, contact = strength.order[on.wheel.name], on.load.value, on.contact
    # Near its largest value a pull hardly changes: load to 5 % and n to 0.05 will do.
    about = math.exp(round(math.log(contact.load), 1)), round(contact.exponent, 1)
    size = contact.diameter, contact.width
    best = _best_sinkage(*size, slip, *about, contact.thrust_factor, strength.soil(order))
    step = WheelStep(order, contact._replace(sinkage=max(on.sinkage, best)), slip)
    push, pull, _ = strength.forces(step, exact_slip=True)
    by_law = on.variance(pull.by_sinkage, 0.0, -1.0, pull.by_log_load - pull.value)
    law = (_FITTED if strength.mass > 0.0 else _UNFITTED) * load
    spread = strength.spread(push, pull.row) + by_law + law**2
    return Quantity(pull.value / load, math.sqrt(max(spread, _LEAST_STD**2)) / load)


@lru_cache(maxsize=256)
def _best_sinkage(
    diameter: float,
    width: float,
    slip: float,
    load: float,
    exponent: float,
    factor: float,
    soil: ShearLaw,
) -> float:
    """Sinkage (m) at which a wheel pulls most under a load (N). factor: of effects on thrust.

    It stays the same until something tells of the strength.
    """
    depths = _SINKAGES * diameter
    made = stresses.wheel_forces(load, depths, diameter, width, slip, exponent, soil)
    return float(depths[np.argmax(factor * made.thrust - made.resistance)])


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
