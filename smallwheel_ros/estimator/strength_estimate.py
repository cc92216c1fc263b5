# SPDX-License-Identifier: Apache-2.0
"""The estimated strength in the terms of the field, and what has determined it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.identifiability import DETERMINED
from smallwheel_ros.physics.wheel import Quantity, Strength

Array = NDArray[np.float64]

_SAME_LOAD = 1.3
_SAME_SLIP = 0.1  # apart
# After one form of the shear curve is fitted to the other's thrust at slips to 0.5 (stress along the
# arc, and over the contact as a whole), they differ by 30 % in what they call shear displacement.
FORM_SHEAR = 0.3
_NAMES = ("cohesion", "friction_angle", "shear_displacement", "other_resistance")


class Excitation(NamedTuple):
    """Smallest and largest load (N) and |slip| of what was measured; the load is inf before it."""

    load: tuple[float, float] = (math.inf, 0.0)
    slip: tuple[float, float] = (1.0, 0.0)

    def widened(self, load: float, slip: float) -> Excitation:
        """Widen by one wheel."""
        return Excitation(
            (min(self.load[0], load), max(self.load[1], load)),
            (min(self.slip[0], slip), max(self.slip[1], slip)),
        )


@dataclass(frozen=True)
class StrengthEstimate:
    """The soil's strength as it is believed now; SI units, every number finite.

    Attributes
    ----------
    strength
        Cohesion, friction angle and shear displacement, with their standard deviations. That of the
        shear displacement has in it that other forms of the shear curve mean something else by it.
    other_resistance
        Resistance that the law does not give (bulldozing, bearings; less than 0 where the law gives
        too much), as a share of the load.
    covariance
        Of (cohesion, friction angle, ln shear displacement, other resistance), shape (4, 4).
    steps
        Steps of the path that it rests on; 0: it is the configured one.
    sources
        Of balance, torque and pull, those that have told of it.
    remaining
        Posterior over prior standard deviation of each, and of `thrust`: the most that the soil holds
        under the load of a wheel.
    status
        In words, what is not determined and why; empty when everything is.
    """

    strength: Strength
    other_resistance: Quantity
    covariance: Array
    steps: int
    sources: frozenset[str]
    remaining: Mapping[str, float]
    status: tuple[str, ...]

    @property
    def verdicts(self) -> dict[str, str]:
        """For each number in words whether it is determined, and how far."""
        return {
            name: ("determined" if left <= DETERMINED else "not determined")
            + f": {100.0 * left:.0f} % of the prior's standard deviation is left"
            for name, left in self.remaining.items()
        }


def strength_estimate(
    mean: Array,
    covariance: Array,
    prior: Array,
    excitation: Excitation,
    steps: int,
    sources: frozenset[str],
) -> StrengthEstimate:
    """Put (cohesion, friction angle, ln shear displacement, other share) into the field's terms.

    mean: shape (4,). covariance, prior: (4, 4).
    """
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    shear = math.exp(mean[2])
    remaining = dict(zip(_NAMES, (deviations / np.sqrt(np.diag(prior))).tolist(), strict=True))
    # The most that is held under a load, c A + W tan(phi): nearly all of it is friction.
    remaining["thrust"] = remaining["friction_angle"]
    return StrengthEstimate(
        Strength(
            Quantity(max(float(mean[0]), 0.0), float(deviations[0])),
            Quantity(float(mean[1]), float(deviations[1])),
            Quantity(shear, shear * math.hypot(float(deviations[2]), FORM_SHEAR)),
        ),
        Quantity(float(mean[3]), float(deviations[3])),
        covariance,
        steps,
        sources,
        remaining,
        _in_words(remaining, excitation, steps),
    )


def _in_words(
    remaining: Mapping[str, float], excitation: Excitation, steps: int
) -> tuple[str, ...]:
    if not steps:
        return (
            "thrust is not determined: no balance, torque or drawbar pull was measured; the strength "
            "is the configured one",
        )
    (lightest, heaviest), (least, most) = excitation.load, excitation.slip
    so_far = f"{steps} steps of the path so far do not suffice"
    words = []
    slip_varied = most - least > _SAME_SLIP
    why = so_far if slip_varied else f"slip hardly varied ({least:.2f} to {most:.2f})"
    if remaining["friction_angle"] > DETERMINED:
        words.append(f"friction angle is not determined: {why}")
    if remaining["cohesion"] > DETERMINED:
        apart = so_far
        if heaviest <= _SAME_LOAD * lightest:
            apart = f"load hardly varied ({lightest:.3g} to {heaviest:.3g} N)"
        words.append(f"cohesion is not determined apart from the friction angle: {apart}")
    if remaining["shear_displacement"] > DETERMINED:
        words.append(f"shear displacement is not determined: {why}")
    return tuple(words)
