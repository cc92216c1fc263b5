"""What the drawbar pull of one wheel would be in a soil: thrust less resistance, with slopes.

The soil's law enters as in `sinkage_observation`, its strength as cohesion, friction angle and ln of
the shear displacement.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.sinkage_observation import (
    LOG_REFERENCE_SINKAGE,
    Observation,
    Observed,
    observation,
    resistance_observation,
)
from smallwheel_ros.model import Model, predict
from smallwheel_ros.physics.conditions import ROLLING, Conditions
from smallwheel_ros.physics.point_thrust import point_contact_length, point_thrust
from smallwheel_ros.physics.soil import Soil

Array = NDArray[np.float64]
Three = tuple[float, float, float]

_STEP = 1e-4  # of s, n, ln load, slip, friction angle and ln kappa in central differences
_COHESION_STEP = 10.0  # Pa; thrust is linear in it


class Forces(NamedTuple):
    """Thrust and resistance (N) of a wheel, with slopes.

    by_law, resistance_by_law: by s, n and ln load, by n only as far as n changes the sinkage.
    by_exponent: of the resistance by n at one sinkage. by_strength: of the thrust by cohesion,
    friction angle and ln kappa. by_slip: of thrust less resistance.
    """

    thrust: float
    resistance: float
    by_law: Three
    resistance_by_law: Three
    by_exponent: float
    by_strength: Three
    by_slip: float
    sunk_to_axle: bool


class ForceObservation(Protocol):
    """A rolling wheel at a slip; `diameter_log` and `wheel` as in `Observation`."""

    diameter_log: float
    wheel: Three

    def __call__(self, log_pressure: float, exponent: float, strength: Three) -> Forces:
        """Forces in a soil. Raises ArithmeticError or ValueError where there are none."""


class _Plain:
    """A wheel without effects."""

    def __init__(self, load: float, diameter: float, width: float, slip: float) -> None:
        self.sinkage = observation((), load, diameter, width, ROLLING, None, None)
        self.resistance = resistance_observation((), load, diameter, width, None, None)
        self.diameter_log, self.wheel = self.sinkage.diameter_log, self.sinkage.wheel
        self.slip = slip

    def __call__(self, log_pressure: float, exponent: float, strength: Three) -> Forces:
        load, diameter, width = self.wheel
        z = self.sinkage(log_pressure, exponent)
        held = self.resistance(log_pressure, exponent)
        length, length_slope = point_contact_length(z.value, diameter)
        cohesion, friction_angle, log_shear = strength
        push = point_thrust(
            load, self.slip, length, width, cohesion, friction_angle, math.exp(log_shear)
        )
        by_sinkage = push.by_length * length_slope
        through_sinkage = held.by_pressure / z.by_pressure * z.by_exponent
        return Forces(
            push.value,
            held.value,
            (
                by_sinkage * z.by_pressure,
                by_sinkage * z.by_exponent,
                by_sinkage * z.by_load + push.by_load * load,
            ),
            (held.by_pressure, through_sinkage, held.by_load),
            held.by_exponent - through_sinkage,
            (push.by_cohesion, push.by_friction, push.by_log_shear),
            push.by_slip,
            z.sunk_to_axle,
        )


class _WithEffects:
    """Any effects at all, by `model.predict` and central differences: a hundred times slower."""

    def __init__(
        self,
        effects: Sequence[Effect],
        load: float,
        diameter: float,
        width: float,
        slip: float,
        speed: float | None,
    ) -> None:
        plain = resistance_observation(effects, load, diameter, width, slip, speed)
        self.diameter_log, self.wheel = plain.diameter_log, plain.wheel
        self.effects = tuple(effects)
        # Up and down by each of: s, n, ln load, cohesion, friction angle, ln kappa, slip.
        self._steps = np.zeros((15, 7))
        for i in range(7):
            self._steps[1 + 2 * i : 3 + 2 * i, i] = _STEP, -_STEP
        self._steps[7:9, 3] = _COHESION_STEP, 0.0
        slips = np.clip(slip + self._steps[:, 6], -1.0, 1.0)
        self._width = self._steps[1::2] - self._steps[2::2]
        self._width[6, 6] = slips[13] - slips[14]
        covariates = {"slip": slips}
        if speed is not None:
            covariates["speed"] = np.full(15, speed)
        self._conditions = Conditions.of(
            load * np.exp(self._steps[:, 2]),
            diameter,
            width,
            soil=[str(i) for i in range(15)],
            **covariates,
        )

    def __call__(self, log_pressure: float, exponent: float, strength: Three) -> Forces:
        # The model has no strength under 0, the estimate's straight lines go on there.
        cohesion, friction_angle, log_shear = strength
        least, flat = max(cohesion, 0.0), max(friction_angle, _STEP)
        centre = np.array([log_pressure, exponent, 0.0, least, flat, log_shear, 0.0])
        soils = [
            Soil(
                str(i),
                math.exp(s - n * LOG_REFERENCE_SINKAGE),
                n,
                0.0,
                c,
                phi,
                math.exp(log_kappa),
            )
            for i, (s, n, _, c, phi, log_kappa, _) in enumerate((centre + self._steps).tolist())
        ]
        predicted = predict(Model(soils, effects=self.effects), self._conditions)
        assert predicted.thrust is not None  # there is slip
        over = np.diagonal(self._width)
        push, held, z = (
            ((value[1::2] - value[2::2]) / over).tolist()
            for value in (predicted.thrust, predicted.true_resistance, predicted.true_sinkage)
        )
        through_sinkage = held[0] / z[0] * z[1]
        return Forces(
            float(predicted.thrust[0])
            + push[3] * (cohesion - least)
            + push[4] * (friction_angle - flat),
            float(predicted.true_resistance[0]),
            (push[0], push[1], push[2]),
            (held[0], through_sinkage, held[2]),
            held[1] - through_sinkage,
            (push[3], push[4], push[5]),
            push[6] - held[6],
            bool(predicted.immobilised[0]),
        )


def force_observation(
    effects: Sequence[Effect],
    load: float,
    diameter: float,
    width: float,
    slip: float,
    speed: float | None,
) -> ForceObservation:
    """Describe thrust and resistance of a rolling wheel (N, m, 1, m/s)."""
    if not effects:
        return _Plain(load, diameter, width, slip)
    return _WithEffects(effects, load, diameter, width, slip, speed)


class PullOnLaw(Observation):
    """The drawbar pull as an `Observation` of the sinkage, for a strength that is held.

    n at one sinkage is left out: what it does to the resistance `strength` keeps apart.
    other: resistance that the law does not give, share of the load.
    law: where it was asked for last.
    """

    def __init__(self, forces: ForceObservation, strength: Three, other: float) -> None:
        self._forces, self._strength, self._other = forces, strength, other
        self.diameter_log, self.wheel = forces.diameter_log, forces.wheel
        self.law = (0.0, 0.0)

    def __call__(self, log_pressure: float, exponent: float) -> Observed:
        """See `Observation`."""
        self.law = log_pressure, exponent
        seen = self._forces(log_pressure, exponent, self._strength)
        by_pressure, by_exponent, by_load = (
            push - held for push, held in zip(seen.by_law, seen.resistance_by_law, strict=True)
        )
        other = self._other * self.wheel[0]
        return Observed(
            seen.thrust - seen.resistance - other,
            by_pressure,
            by_exponent,
            by_load - other,
            seen.sunk_to_axle,
        )
