# SPDX-License-Identifier: Apache-2.0
"""The soil's strength as reported: its parameters, which of them are determined, and why others are not."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from smallwheel_ros.physics.wheel import Quantity
from smallwheel_ros.pipeline.soil.identifiability import DETERMINED
from smallwheel_ros.pipeline.tables import Array, Flags

from .filter import FORM_SHEAR, STRENGTH
from .forces import COHESION, FRICTION, OTHER, SHEAR, Believed
from .steps import Excitation
from .two_filters import Strengths

# Share of the prior's deviation of friction up to which thrust is determined: the data then give as much
# information about it as the prior. Another soil begins with a larger share, so that it has to be measured.
_HELD = math.sqrt(0.5)
_SAME_LOAD, _SAME_SLIP = 1.3, 0.1  # largest over smallest, largest less smallest, that hardly vary
_NAMES = ("cohesion", "friction_angle", "shear_displacement", "other_resistance")
_LIMITS = {"thrust": _HELD}
_NEEDS = {
    "balance": "vehicle.mass is not given; it would give friction and the reserve on slopes",
    "slope": "not yet: it needs load and slip of all wheels, and a slope (imu_topic, or odom with pitch)",
    "torque": "<wheel>.torque_per_effort is not given; it would give what each wheel pulls at this moment",
}


@dataclass(frozen=True)
class StrengthEstimate:
    """The present estimate of the soil's strength; every number is finite.

    Attributes
    ----------
    cohesion, friction_angle, shear_displacement
        Value and standard deviation, Pa, rad, m; the deviation of the last includes the difference between
        forms of the shear curve.
    other_resistance
        Motion resistance that is not in the law, over load, 1.
    steps
        Number of steps of the path used; 0: the strength is the configured one.
    sources
        Which measurements were used: 'balance' (of the vehicle's forces), 'torque', 'pull'.
    remaining
        Ratio of posterior to prior standard deviation, 1, by the names of the four parameters and 'thrust'.
    status
        Sentences that say what is not determined, and why; empty if everything is.
    """

    cohesion: Quantity
    friction_angle: Quantity
    shear_displacement: Quantity
    other_resistance: Quantity
    steps: int
    sources: frozenset[str]
    remaining: Mapping[str, float]
    status: tuple[str, ...]

    @property
    def determined(self) -> bool:
        """Whether thrust is determined: at most half of the friction angle's prior variance is left."""
        return self.remaining["thrust"] <= _HELD

    @property
    def verdicts(self) -> dict[str, str]:
        """Whether each number of `remaining` is determined, with its ratio in per cent, in words, by name."""
        return {
            name: ("determined" if left <= _LIMITS.get(name, DETERMINED) else "not determined")
            + f": {100.0 * left:.0f} % of the prior's standard deviation is left"
            for name, left in self.remaining.items()
        }


def strength_of(strengths: Strengths) -> StrengthEstimate:
    """Return the newest estimate of the strength, by the filter for the margin.

    Parameters
    ----------
    strengths
        Estimator of the strength.
    """
    believed = strengths.believed.newest[1]
    mean = believed.x[:STRENGTH]
    deviation = _deviations(believed)
    remaining = dict(zip(_NAMES, (deviation / strengths.reserve.prior_std).tolist(), strict=True))
    # The largest thrust under a load is c A + W tan(phi): nearly all of it is friction.
    remaining["thrust"] = remaining["friction_angle"]
    return StrengthEstimate(
        **constants_of(believed),
        other_resistance=Quantity(float(mean[OTHER]), float(deviation[OTHER])),
        steps=strengths.steps,
        sources=frozenset(strengths.sources),
        remaining=remaining,
        status=_in_words(remaining, strengths.excitation, strengths.steps),
    )


def constants_of(believed: Believed) -> dict[str, Quantity]:
    """Return the parameters of strength in a filter's state, with standard deviations.

    Parameters
    ----------
    believed
        State of the filter.

    Returns
    -------
    dict of Quantity
        'cohesion' (Pa, at least 0), 'friction_angle' (rad), 'shear_displacement' (m).
    """
    mean, deviation = believed.x, _deviations(believed)
    shear = math.exp(float(mean[SHEAR]))
    return {
        "cohesion": Quantity(max(float(mean[COHESION]), 0.0), float(deviation[COHESION])),
        "friction_angle": Quantity(float(mean[FRICTION]), float(deviation[FRICTION])),
        "shear_displacement": Quantity(
            shear, shear * math.hypot(float(deviation[SHEAR]), FORM_SHEAR)
        ),
    }


def _deviations(believed: Believed) -> Array:
    """Standard deviations of the state's first four numbers: c, phi, ln K, rho."""
    return np.asarray(np.sqrt(np.maximum(np.diag(believed.P)[:STRENGTH], 0.0)))


def is_determined(P: Array, prior_std: Array) -> Flags:
    """Whether a strength is determined: at most half of the friction angle's prior variance is left.

    The friction angle counts, since friction is the largest part of the thrust.

    Parameters
    ----------
    P
        Covariances of the filter's state, shape (rows, size, size).
    prior_std
        Standard deviations of (c, phi, ln K, rho) before any measurement, shape (4,).

    Returns
    -------
    ndarray
        Mask of shape (rows,).
    """
    return np.asarray(P[:, FRICTION, FRICTION] <= (_HELD * prior_std[FRICTION]) ** 2)


def is_told(P: Array, prior_std: Array) -> Flags:
    """Whether measurements have narrowed the friction angle: its deviation is below that of the prior.

    Parameters
    ----------
    P
        Covariances of the filter's state, shape (rows, size, size).
    prior_std
        Standard deviations of (c, phi, ln K, rho) before any measurement, shape (4,).

    Returns
    -------
    ndarray
        Mask of shape (rows,).
    """
    return np.asarray(P[:, FRICTION, FRICTION] < prior_std[FRICTION] ** 2)


def lacking(sources: frozenset[str], mass: float, *, torque: bool) -> dict[str, str]:
    """List which of balance and torque are not in use as sources of strength, with what each needs.

    Parameters
    ----------
    sources
        Sources in use: 'balance', 'torque', 'pull'.
    mass
        Mass of the vehicle, kg; 0 if not given.
    torque
        Whether torques are configured, even if none has been used yet.

    Returns
    -------
    dict of str
        Sentences by source, of 'balance' and 'torque' those that are lacking. A torque that is configured is
        not lacking.
    """
    found = {}
    if "balance" not in sources:
        found["balance"] = _NEEDS["slope" if mass else "balance"]
    if "torque" not in sources and not torque:
        found["torque"] = _NEEDS["torque"]
    return found


def _in_words(
    remaining: Mapping[str, float], excitation: Excitation, steps: int
) -> tuple[str, ...]:
    if not steps:
        return (
            "thrust is not determined: no balance, torque or drawbar pull was measured; the strength "
            "is the configured one",
        )
    (lightest, heaviest), (least, most) = excitation.load, excitation.slip
    words = []
    so_far = why = f"{steps} steps of the path so far do not suffice"
    nothing = excitation == Excitation()
    if nothing:
        so_far = why = "nothing was measured on the present soil yet"
    elif most - least <= _SAME_SLIP:
        why = f"slip hardly varied ({least:.2f} to {most:.2f})"
    if remaining["friction_angle"] > DETERMINED:
        words.append(f"friction angle is not determined: {why}")
    if remaining["cohesion"] > DETERMINED:
        apart = so_far
        if not nothing and heaviest <= _SAME_LOAD * lightest:
            apart = f"load hardly varied ({lightest:.3g} to {heaviest:.3g} N)"
        words.append(f"cohesion is not determined apart from the friction angle: {apart}")
    if remaining["shear_displacement"] > DETERMINED:
        words.append(f"shear displacement is not determined: {why}")
    return tuple(words)
