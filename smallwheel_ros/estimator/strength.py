"""The soil's strength as estimated from drawbar pull: a filter beside that of the law.

State: cohesion, friction angle, ln of the shear displacement, and a resistance that the law does not
give (share of the load). They are common to all measurements, and drift with distance like the law.

Thrust also scatters from spot to spot, by how much is learnt. Here that is noise, as large as makes
all measurements at one spot count for one. A state for each wheel's spot, as the law has, would leave
only the differences within a spot to tell how thrust goes with slip, and those of the slip are mostly
its noise.

Why not in the filter of the law? Drawbar pull is a difference of two forces of which no model is
good to a few per cent (on the public rig of the README the compaction resistance is 0.2 of the load
too much near zero slip). In one filter the error of either would be taken for n, and so for k. Here
sinkage comes in with its uncertainty, and what is wrong with the law's resistance goes into the
fourth number. What pulls determine is that and the law's resistance together: where the law's n
changes, the fourth number makes up for it. The law stays what sinkage and resistance make it.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.drawbar_observation import ForceObservation, Forces, PullOnLaw, Three
from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.estimator.saved_strength import StrengthRecord
from smallwheel_ros.estimator.settings import (
    EstimatorError,
    EstimatorSettings,
    SoilPrior,
    usual_strength,
)
from smallwheel_ros.estimator.sinkage_observation import Observed
from smallwheel_ros.estimator.soil_filter import SoilFilter
from smallwheel_ros.estimator.strength_estimate import (
    PullVariety,
    StrengthEstimate,
    strength_estimate,
)
from smallwheel_ros.physics.point_thrust import point_contact_length
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE

Array = NDArray[np.float64]
Reason = Literal["accepted", "gate", "out_of_range"]

_, _FRICTION, _SHEAR, _OTHER = range(4)
# Along one prepared rut the rig's pull varies by 1.2 N (median of 27 trials) of a limit of 12 N.
# The least, and what is believed before any pull, as a share of the thrust.
_SCATTER, _MOST_SCATTER = 0.1, 0.5
_SCATTER_KNOWN = 20  # spots that this counts for, at a thrust of 0.2 of the load
_OTHER_STD = 0.1  # share of the load; the rig's is -0.2
# A strength that is configured as exact has to stay a strength that a filter can hold.
_LEAST_STD = (1.0, 1e-4, 1e-3)  # Pa, rad, ln kappa
_STEEPEST = 1.5  # rad
_SHEAR_LIMITS = (math.log(1e-4), 0.0)  # ln kappa: 0.1 mm to 1 m
_MANY = 10  # pulls, after which there is a strength to compare with
_LEAST_WAY = 1e-4  # m: a wheel that spins on one spot
_PASSES = 8
# Pulls that do not fit, at different places, before the strength is taken for another one.
_SURPRISES = 5
_SETTLED = 1e-2  # of the noise's standard deviation
_WIDENING, _MOST_WIDENINGS = 4.0, 3


class Pull(NamedTuple):
    """A measured drawbar pull (N) of a rolling wheel.

    noise: its variance, N^2. slip_noise: variance of the slip. load_noise: of ln load. sinkage: m,
    measured at the same time.
    """

    forces: ForceObservation
    measured: float
    noise: float
    slip: float
    slip_noise: float
    load_noise: float
    sinkage: float


class Taken(NamedTuple):
    """What became of a pull: expected (N) and variance (N^2) before it, with its noise."""

    reason: Reason
    expected: float
    variance: float
    chi_square: float


class StrengthState:
    """What is believed of the strength of one soil."""

    def __init__(self, prior: SoilPrior, settings: EstimatorSettings) -> None:
        strength = prior.strength_or_usual
        given = strength.cohesion, strength.friction_angle, strength.shear_displacement
        cohesion, friction_angle, shear = (q.value for q in given)
        shear = min(max(shear, 2e-4), 0.5)
        self._mean = np.array([cohesion, friction_angle, math.log(shear), 0.0])
        spreads = [q.standard_deviation for q in given]
        spreads[_SHEAR] /= shear
        stds = [max(std, least) for std, least in zip(spreads, _LEAST_STD, strict=True)]
        self._prior = np.diag(np.square([*stds, _OTHER_STD]))
        usual = usual_strength(prior.soil)
        self._usual_variance = np.square(
            [
                usual.cohesion.standard_deviation,
                usual.friction_angle.standard_deviation,
                usual.shear_displacement.standard_deviation / usual.shear_displacement.value,
                _OTHER_STD,
            ]
        )
        noise, spread = settings.process_noise, prior.log_reference_pressure_std
        self._length = 2.0 * (spread / noise) ** 2 if noise > 0 else math.inf
        self._settings = settings
        self._at = math.inf  # m, to where it has drifted; begins with the first pull
        self._filter = SoilFilter(self._prior, self._length)
        self._measured_at: dict[str, float] = {}
        # The n that the fourth number belongs to, and what it falls by where n rises by 1.
        self._exponent, self._by_exponent = prior.n, 0.0
        self._surprised_at: dict[str, float] = {}
        self._surprises = self._widenings = 0
        self.accepted = 0
        self.variety = PullVariety()
        # Sums over spots: squares of what is off for scatter, and of the thrust (N^2).
        self._scattered, self._load = (0.0, 0.0), 0.0

    def take(
        self, pull: Pull, wheel: str, law: SoilEstimate, distance: float, gate: float
    ) -> Taken:
        """Update by a pull if it fits (chi-square within the gate).

        law: of the soil under the wheel. Raises ArithmeticError or ValueError, with nothing changed,
        where the numbers cannot be computed with.
        """
        cohesion, friction, shear, other = self._now.tolist()
        observe = PullOnLaw(pull.forces, (cohesion, friction, shear), other)
        point, of_law = self._on_law(observe, law, pull.load_noise)
        if not math.isfinite(point.value + of_law):
            raise ArithmeticError("its uncertainty has no bounds")
        self._travel(distance)
        self._follow(pull.forces, observe.law)
        taken = self._update(pull, observe.law, of_law, self._count(wheel, distance), gate)
        if taken.reason == "accepted":
            self._fits(pull)
            self._measured_at[wheel] = distance
        else:
            self._surprise(wheel, distance)
        return taken

    def _on_law(
        self, observe: PullOnLaw, law: SoilEstimate, load_noise: float
    ) -> tuple[Observed, float]:
        """What a pull would be on a law, and its variance by the law, the place and the load (N^2)."""
        deeper = math.log(REFERENCE_SINKAGE / law.reference_sinkage)
        larger = observe.diameter_log + math.log(REFERENCE_DIAMETER / law.reference_diameter)
        pressure = law.log_reference_pressure + law.n * deeper + law.m * larger
        seen = observe(pressure, law.n)
        row = (
            seen.by_pressure,
            seen.by_exponent + seen.by_pressure * deeper,
            seen.by_pressure * larger,
        )
        variance = law.law_covariance.variance(row)
        variance += (seen.by_pressure * self._settings.soil_scatter) ** 2
        return seen, variance + seen.by_load**2 * load_noise

    @property
    def _now(self) -> Array:
        return self._mean + self._filter.deviation

    def _travel(self, distance: float) -> None:
        if distance > self._at:
            self._filter.travel(distance - self._at)
        self._at = distance if self._at == math.inf else max(distance, self._at)

    def _count(self, wheel: str, distance: float) -> float:
        """How many measurements of a wheel stand for one spot, by its way since the last one."""
        way = distance - self._measured_at.get(wheel, -math.inf)
        return max(1.0, 2.0 * self._settings.scatter_length / max(way, _LEAST_WAY))

    def _follow(self, forces: ForceObservation, law: tuple[float, float]) -> None:
        """Hold the sum of the law's resistance and the other one while the law's n changes."""
        self._by_exponent = forces(*law, _three(self._now)).by_exponent / forces.wheel[0]
        deviation, covariance, prior = self._filter.state
        deviation = deviation.copy()
        deviation[_OTHER] -= self._by_exponent * (law[1] - self._exponent)
        self._filter.state = deviation, covariance, prior
        self._exponent = law[1]

    def _update(
        self, pull: Pull, law: tuple[float, float], of_law: float, count: float, gate: float
    ) -> Taken:
        """Linearise at the most likely strength (see `iterated_update`), and update if it fits.

        law: ln pressure and n at the wheel's spot. of_law: variance of the pull from the law. count:
        measurements that stand for one spot.
        """
        mean, covariance, load = self._now, self._filter.covariance, pull.forces.wheel[0]

        def at(x: Array) -> tuple[float, Array, Forces]:
            seen = pull.forces(*law, _three(x))
            value = seen.thrust - seen.resistance - float(x[_OTHER]) * load
            return value, np.array([*seen.by_strength, -load]), seen

        expected, row, predicted = at(mean)
        # Of the thrust as predicted: with the thrust that is being estimated, a low measurement would
        # seem the more exact one.
        scatter = (self._scatter(load) * predicted.thrust) ** 2
        single = pull.noise + of_law + predicted.by_slip**2 * pull.slip_noise + scatter
        noise = single + (count - 1.0) * scatter
        variance = float(row @ covariance @ row) + single
        straight = expected
        reason: Reason = "accepted"
        for _ in range(_PASSES):
            by, before = covariance @ row, straight
            x = mean + by * ((pull.measured - straight) / (float(row @ by) + noise))
            if not _in_range(x):
                reason = "out_of_range"
                break
            value, row, _ = at(x)
            straight = value + float(row @ (mean - x))
            if abs(straight - before) < _SETTLED * math.sqrt(noise):
                break
        chi_square = (pull.measured - straight) ** 2 / (float(row @ covariance @ row) + single)
        if not math.isfinite(chi_square + variance):
            raise ArithmeticError("its uncertainty has no bounds")
        if reason == "accepted" and chi_square > gate:
            reason = "gate"
        if reason == "accepted" and not self._filter.update(
            pull.measured - straight, row.tolist(), noise
        ):
            raise ArithmeticError("the update would leave the covariance unsound")
        if self.accepted >= _MANY:
            square, thrust = self._scattered
            first = min((pull.measured - expected) ** 2, gate * variance)  # it may be an outlier
            self._scattered = (
                square + (first - variance + scatter) / count,
                thrust + predicted.thrust**2 / count,
            )
        return Taken(reason, expected, variance, chi_square)

    def _scatter(self, load: float) -> float:
        """Standard deviation of the thrust from spot to spot, as a share of it."""
        known = _SCATTER_KNOWN * (0.2 * load) ** 2
        share = (self._scattered[0] + known * _SCATTER**2) / (self._scattered[1] + known)
        return min(math.sqrt(max(share, _SCATTER**2)), _MOST_SCATTER)

    def _fits(self, pull: Pull) -> None:
        self._surprised_at.clear()
        self._surprises = 0
        self.accepted += 1
        load, diameter, width = pull.forces.wheel
        self._load = load
        length = point_contact_length(max(pull.sinkage, 1e-5), diameter)[0]
        self.variety = self.variety.with_pull(load, abs(pull.slip), width * length)

    def _surprise(self, wheel: str, distance: float) -> None:
        """Count a pull that does not fit; a run of them at different spots is another strength."""
        last = self._surprised_at.get(wheel)
        if last is not None and distance - last < 0.5 * self._settings.scatter_length:
            return
        self._surprised_at[wheel] = distance
        self._surprises += 1
        if self._surprises < _SURPRISES:
            return
        # Where hardly any fitted, the prior is not as sure as it says: then as open as the strength
        # of a kind of soil is, at least.
        known = self.accepted >= _MANY
        self._widenings = 0 if known else min(self._widenings + 1, _MOST_WIDENINGS)
        covariance = self._prior
        if self._widenings:
            open_ = np.maximum(np.diag(covariance), self._usual_variance)
            covariance = _WIDENING**self._widenings * np.diag(open_)
        self._restart(covariance)

    def _restart(self, covariance: Array) -> None:
        """Begin at the prior's mean with this covariance."""
        self._filter = SoilFilter(covariance, self._length)
        self._surprised_at.clear()
        self._surprises = self.accepted = 0
        self.variety, self._scattered = PullVariety(), (0.0, 0.0)

    def record(self) -> StrengthRecord:
        """What to save."""
        return StrengthRecord(
            self._mean.copy(),
            self._prior.copy(),
            self._filter.deviation.copy(),
            self._filter.covariance.copy(),
            (self._exponent, self._by_exponent),
            (*self._scattered, self._load),
            self.variety,
            self.accepted,
        )

    @classmethod
    def restored(
        cls, path: str | Path, saved: StrengthRecord, prior: SoilPrior, settings: EstimatorSettings
    ) -> StrengthState:
        """Go on from what was saved; raises EstimatorError where that was under another prior."""
        strength = cls(prior, settings)
        if not strength.record().made_with(saved):
            raise EstimatorError(
                f"{path}: saved under another prior of the soil's strength; restore the old setting, "
                "or delete the file to begin with the prior"
            )
        strength._filter.resume(saved.covariance, saved.deviation, strength._prior)
        strength._exponent, strength._by_exponent = saved.exponent
        *scattered, strength._load = saved.scattered
        strength._scattered = scattered[0], scattered[1]
        strength.variety, strength.accepted = saved.variety, saved.accepted
        return strength

    def estimate(self, exponent: float) -> StrengthEstimate:
        """Return the strength as it is believed now. exponent: the law's n."""
        mean = self._now
        mean[_OTHER] -= self._by_exponent * (exponent - self._exponent)
        return strength_estimate(
            mean,
            self._filter.covariance,
            self._prior,
            -self._by_exponent,
            self._scatter(self._load) if self._load else _SCATTER,
            self.variety,
            self.accepted,
        )


def _three(x: Array) -> Three:
    return float(x[0]), float(x[1]), float(x[2])


def _in_range(x: Array) -> bool:
    low, high = _SHEAR_LIMITS
    return abs(x[_FRICTION]) < _STEEPEST and low < x[_SHEAR] < high and bool(np.isfinite(x).all())
