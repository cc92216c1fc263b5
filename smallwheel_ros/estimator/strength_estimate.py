"""The estimated strength in the terms of the field, and what the pulls so far have determined."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.physics.wheel import Quantity, Strength

Array = NDArray[np.float64]

_DETERMINED = 0.5  # as in `identifiability`: posterior over prior standard deviation
_SAME_LOAD = 1.3
_SAME_SLIP = 0.1  # apart
# The forms of the shear curve (`traction.thrust`, and shear stress integrated along the arc) are not
# one another: after each is fitted to the other's thrust at slips to 0.5, they differ by 3 % (rms)
# in thrust, and by 30 % in what they call shear displacement.
_FORM_LIMIT, _FORM_SHEAR = 0.03, 0.3
_NAMES = ("cohesion", "friction_angle", "shear_displacement", "other_resistance")


@dataclass(frozen=True)
class PullVariety:
    """Load (N) and |slip| of the accepted pulls, smallest and largest; area (m^2) of the newest."""

    loads: tuple[float, float] | None = None
    slips: tuple[float, float] | None = None
    area: float = 0.0

    def with_pull(self, load: float, slip: float, area: float) -> PullVariety:
        """Widen by one pull."""
        if self.loads is None or self.slips is None:
            return PullVariety((load, load), (slip, slip), area)
        return PullVariety(
            (min(self.loads[0], load), max(self.loads[1], load)),
            (min(self.slips[0], slip), max(self.slips[1], slip)),
            area,
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
        too much), as a share of the load; its deviation is that at the estimated n.
    other_by_n
        What that share changes by where the law's n is 1 more than estimated: pulls determine both
        resistances together.
    covariance
        Of (cohesion, friction angle, shear displacement, other resistance), shape (4, 4), for
        predictions by the library's own form of the thrust; not correlated with the law's.
    scatter
        Standard deviation of the thrust from spot to spot, as a share of it.
    accepted
        Drawbar pulls that it rests on.
    remaining
        Posterior over prior standard deviation of each, and of `thrust`: the most that the soil holds
        under the load of the newest pull.
    status
        In words, what is not determined and why; empty when everything is.
    """

    strength: Strength
    other_resistance: Quantity
    covariance: Array
    other_by_n: float
    scatter: float
    accepted: int
    remaining: Mapping[str, float]
    status: tuple[str, ...]

    @property
    def spot_covariance(self) -> Array:
        """Covariance with the scatter: of the thrust of one wheel at one spot; shape (4, 4)."""
        cohesion, angle = self.strength.cohesion.value, self.strength.friction_angle.value
        return self.covariance + _of_factor(cohesion, angle, self.scatter)

    @property
    def verdicts(self) -> dict[str, str]:
        """For each number in words whether the pulls have determined it, and how far."""
        return {
            name: ("determined" if left <= _DETERMINED else "not determined")
            + f": {100.0 * left:.0f} % of the prior's standard deviation is left"
            for name, left in self.remaining.items()
        }


def _of_factor(cohesion: float, friction_angle: float, deviation: float) -> Array:
    """Covariance where the thrust is uncertain by a factor: cohesion and tangent by the same."""
    by_factor = np.array([cohesion, 0.5 * math.sin(2.0 * friction_angle), 0.0, 0.0])
    return np.asarray(deviation**2 * np.outer(by_factor, by_factor))


def strength_estimate(
    mean: Array,
    covariance: Array,
    prior: Array,
    other_by_n: float,
    scatter: float,
    variety: PullVariety,
    accepted: int,
) -> StrengthEstimate:
    """Put (cohesion, friction angle, ln kappa, other share) into the terms of the field.

    mean: shape (4,). covariance, prior: (4, 4).
    """
    # What the pulls determine is often a sum in which a negative cohesion would do: the most likely
    # strength without one (Simon 2010, Kalman filtering with state constraints, by projection).
    for place in (0, 1):
        if mean[place] < 0.0:
            mean = mean - covariance[:, place] / covariance[place, place] * mean[place]
            mean[place] = 0.0
    mean[:2] = np.maximum(mean[:2], 0.0)
    kappa = math.exp(mean[2])
    scale = np.array([1.0, 1.0, kappa, 1.0])
    now = 0.5 * (covariance + covariance.T) * np.outer(scale, scale)
    now += _of_factor(float(mean[0]), float(mean[1]), _FORM_LIMIT)
    stds = np.sqrt(np.diag(now)).tolist()
    stds[2] = math.hypot(stds[2], _FORM_SHEAR * kappa)
    values = [float(mean[0]), float(mean[1]), kappa, float(mean[3])]
    cohesion, friction, shear, other = (
        Quantity(value, std) for value, std in zip(values, stds, strict=True)
    )
    remaining = dict(
        zip(_NAMES, np.sqrt(np.diag(covariance) / np.diag(prior)).tolist(), strict=True)
    )
    if variety.loads is None:
        remaining["thrust"] = 1.0
    else:
        limit = np.array(
            [variety.area, variety.loads[1] * (1.0 + math.tan(friction.value) ** 2), 0.0, 0.0]
        )
        remaining["thrust"] = math.sqrt(
            max(float(limit @ covariance @ limit), 0.0) / float(limit @ prior @ limit)
        )
    return StrengthEstimate(
        Strength(cohesion, friction, shear),
        other,
        now,
        other_by_n,
        scatter,
        accepted,
        remaining,
        _in_words(remaining, variety, accepted),
    )


def _in_words(
    remaining: Mapping[str, float], variety: PullVariety, accepted: int
) -> tuple[str, ...]:
    if variety.loads is None or variety.slips is None:
        return ("thrust is not determined: no drawbar pull has fitted yet",)
    (w_low, w_high), (i_low, i_high) = variety.loads, variety.slips
    so_far = f"{accepted} drawbar pulls so far do not suffice"
    slip_varied = i_high - i_low > _SAME_SLIP
    one_slip = f"slip hardly varied ({i_low:.2f} to {i_high:.2f})"
    thrust, cohesion, friction, shear, other = (
        remaining[name] <= _DETERMINED for name in ("thrust", *_NAMES)
    )
    words = []
    if not thrust:
        words.append(
            f"thrust's limit is not determined{f' yet: {so_far}' if slip_varied else f': {one_slip}'}"
        )
    elif not (cohesion and friction):
        why = f"load hardly varied ({w_low:.3g} to {w_high:.3g} N)"
        if w_high > _SAME_LOAD * w_low:
            why = so_far
        words.append(f"cohesion and friction angle are not determined apart from each other: {why}")
    if not shear:
        words.append(
            f"shear displacement is not determined{f' yet: {so_far}' if slip_varied else f': {one_slip}'}"
        )
    if not other:
        words.append(
            "resistance beside the law's is not determined apart from thrust: it needs pulls near "
            "slip 0 as well as at high slip"
        )
    return tuple(words)
