# SPDX-License-Identifier: Apache-2.0
"""Strength and grip while driving: steps of the path become measurements.

    traction = TractionEstimator(strength, wheels, mass=24.0)
    traction.take(step)                   # each step of the path, see `path_steps`
    forces = traction.now.forces(...)     # what it pulls here; `margin` is for what it could

Two filters run where both the balance of the vehicle and torques or pulls are measured. The one of all
measurements is the better one for the present pull. The one of the balance alone is the better one for
the reserve: torque and pull of single wheels, whose laws are not exact, would bend strength.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.identifiability import DETERMINED
from smallwheel_ros.estimator.path_steps import PathStep, RollingContact
from smallwheel_ros.estimator.settings import REMEMBERED
from smallwheel_ros.estimator.slip_tests import SlipTest, slip_tests
from smallwheel_ros.estimator.strength_filter import (
    FORM_SHEAR,
    LEVEL_STD,
    TractionFilter,
    WheelStep,
)
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

Array = NDArray[np.float64]

GRAVITY = 9.80665  # m/s^2
# Correlation of the strengths of two soils that one vehicle crosses: half of the variance is the site's.
_ONE_SITE = math.sqrt(0.5)
_DRAG = 0.2  # of the load on a wheel that is only dragged along
_RECENT = 2.0  # s: a step that ended longer ago says nothing of now
_SAME_LOAD = 1.3
_SAME_SLIP = 0.1  # apart
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


class TractionEstimator:
    """Refines strength and grip. wheels: of the vehicle; mass: kg, 0: not known.

    Attributes
    ----------
    now, reserve
        The filter for the present pull, and the one for what could be pulled at another slip.
    steps
        That have told of the strength.
    """

    def __init__(self, strength: Strength, wheels: Sequence[Wheel], mass: float = 0.0) -> None:
        self._strength, self._mass = strength, mass
        self._wheels = tuple(wheel for wheel in wheels if wheel.contact == ROLLING)
        self.reset()

    def reset(self) -> None:
        """Forget everything that was measured."""
        self.now = TractionFilter(self._strength, self._wheels, self._mass)
        self.reserve = self.now
        self._end = -math.inf  # time (s) of the last step
        self._slips: dict[str, float] = {}
        self._soil = 0
        self._soils: dict[int, tuple[tuple[Array, Array], ...]] = {}  # strengths by number
        self.steps = 0
        self._told = Quantity(0.0, LEVEL_STD)  # zero of the imu, as it was told last
        self.sources: set[str] = set()
        self.excitation = Excitation()
        self._lately: list[WheelStep] = []  # what each wheel did in the newest step of all of them

    def take(self, step: PathStep, soil: int = 0) -> None:
        """Use a step. soil: number of the soil that a wheel came to last."""
        if soil != self._soil:
            self._change(soil)
        wheels = [
            WheelStep(
                self.now.order[name],
                mean.contact,
                mean.slip.value,
                mean.torque,
                mean.pull,
                mean.doubt,
            )
            for name, mean in step.wheels.items()
            if mean.contact is not None
        ]
        if not wheels:
            return
        if len(wheels) == len(self._wheels):
            self._lately = wheels
        balance = None
        if self._mass > 0.0 and len(wheels) == len(self._wheels):
            balance = step.force
        single = any(w.torque is not None or w.pull is not None for w in wheels)
        if single and balance is not None and self.reserve is self.now:
            self.reserve = TractionFilter(self._strength, self._wheels, self._mass)
            self.reserve.kalman.x = self.now.kalman.x.copy()
            self.reserve.kalman.P = self.now.kalman.P.copy()
        slip_std = max(mean.slip.standard_deviation for mean in step.wheels.values())
        self.now.move(step.length, step.forward, slip_std)
        self.now.update(wheels, balance)
        if self.reserve is not self.now:
            self.reserve.move(step.length, step.forward, slip_std)
            alone = [w._replace(torque=None, pull=None) for w in wheels]
            self.reserve.update(alone, balance)
        self._slips = {self._wheels[w.order].name: w.slip for w in wheels}
        self._end = step.time
        if single or balance is not None:
            self.steps += 1
            for wheel in wheels:
                self.excitation = self.excitation.widened(wheel.contact.load, abs(wheel.slip))
            self.sources |= {"balance"} if balance is not None else set()
            self.sources |= {"torque"} if any(w.torque is not None for w in wheels) else set()
            self.sources |= {"pull"} if any(w.pull is not None for w in wheels) else set()

    @property
    def _filters(self) -> list[TractionFilter]:
        """The filter of all that is measured, and that of the balance alone where there are both."""
        return [self.now] if self.reserve is self.now else [self.now, self.reserve]

    def level(self, zero: Quantity) -> None:
        """Use what turns and ways back have shown of the zero of the imu (m/s^2) up to now.

        What is new in it since the last time is one measurement more, or, where it has wandered, less.
        """
        before, self._told = self._told, zero
        more = zero.standard_deviation**-2 - before.standard_deviation**-2
        for one in self._filters:
            if more <= 0.0:
                one.widen_level(zero.standard_deviation**2 - before.standard_deviation**2)
            else:
                weighted = zero.value / zero.standard_deviation**2
                weighted -= before.value / before.standard_deviation**2
                one.use_level(Quantity(weighted / more, more**-0.5))

    def unlisted(self, share: float) -> None:
        """A share of the weight is on wheels that nobody lists: what they drag is not known."""
        for one in self._filters:
            one.widen_level((_DRAG * share * GRAVITY) ** 2)

    def _change(self, soil: int) -> None:
        """Go on on another soil, with what is known of it, or else by what the last one tells."""
        filters = self._filters
        self._soils.pop(self._soil, None)
        self._soils[self._soil] = tuple(one.strength for one in filters)
        self._soils = dict(list(self._soils.items())[-REMEMBERED:])
        known = self._soils.get(soil)
        for i, one in enumerate(filters):
            if known is not None and len(known) > i:
                one.strength = known[i]
            else:
                one.hand_over(_ONE_SITE)
        if known is None:
            self.excitation = Excitation()
        self._soil = soil

    def wheel(
        self, name: str, contact: RollingContact, slip: float, time: float
    ) -> tuple[WheelStep, bool]:
        """A wheel as it is now, and whether its slip is the mean over the step that is just over.

        One measured slip is off by 0.03, which would be several newtons; the mean's error is in the
        filter's state.
        """
        averaged = name in self._slips and time - self._end <= _RECENT
        now = self._slips[name] if averaged else slip
        return WheelStep(self.now.order[name], contact, now), averaged

    def estimate(self) -> StrengthEstimate:
        """Strength as it is believed now, from the filter of the reserve."""
        mean, covariance = self.reserve.strength
        prior = np.diag(np.square(self.reserve.prior_deviations))
        return strength_estimate(
            mean, covariance, prior, self.excitation, self.steps, frozenset(self.sources)
        )

    def slip_tests(self, reference_slip: float) -> Iterator[list[SlipTest]]:
        """Give, one after the other, what each slip test would tell of what is not determined."""
        steps = self._lately
        if not steps or not self.steps:
            return iter(())
        if self.reserve is not self.now:
            steps = [one._replace(torque=None, pull=None) for one in steps]
        balance = "balance" in self.sources
        return slip_tests(
            self.reserve, self._wheels, steps, with_balance=balance, reference_slip=reference_slip
        )

    @property
    def _prior(self) -> list[list[float]]:
        """Means and deviations of a strength that nobody has measured, to know it by."""
        return [self.now.prior_mean.tolist(), self.now.prior_deviations.tolist()]

    def record(self) -> dict[str, Any] | None:
        """What to save; None before anything was measured."""
        if not self.steps:
            return None
        mean, covariance = self.reserve.strength
        return {
            "prior": self._prior,
            "mean": mean.tolist(),
            "covariance": covariance.tolist(),
            "steps": self.steps,
            "sources": sorted(self.sources),
            # None: on the newest soil nothing was measured yet.
            "excitation": None
            if self.excitation == Excitation()
            else [list(bounds) for bounds in self.excitation],
        }

    def restore(self, record: Any) -> None:
        """Begin anew from a `record`, None: from the prior.

        Raises ValueError, and changes nothing, where it is of another prior.
        """
        if record is None:
            self.reset()
            return
        if not np.allclose(record["prior"], self._prior, rtol=1e-9):
            raise ValueError("saved under another prior of the soil's strength")
        self.reset()
        self.now.strength = np.array(record["mean"]), np.array(record["covariance"])
        self.steps, self.sources = record["steps"], set(record["sources"])
        if record["excitation"] is not None:
            load, slip = record["excitation"]
            self.excitation = Excitation(tuple(load), tuple(slip))


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
