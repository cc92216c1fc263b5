# SPDX-License-Identifier: Apache-2.0
"""Strength and grip while driving: samples of wheels become steps of the path, steps measurements.

    traction = TractionEstimator(strength, wheels, mass=24.0)
    traction.add(sample)                  # each sample of a rolling wheel whose slip is known
    push = traction.now.thrust(...)       # what it pulls here; `margin` is for what it could

Two filters run where both the balance of the vehicle and torques or pulls are measured. The one of all
measurements is the better one for the present pull. The one of the balance alone is the better one for
the reserve: torque and pull of single wheels, whose laws are not exact, would bend strength.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.saved_state import check_covariance
from smallwheel_ros.estimator.strength_estimate import (
    Excitation,
    StrengthEstimate,
    strength_estimate,
)
from smallwheel_ros.estimator.traction_filter import CELL, TractionFilter
from smallwheel_ros.estimator.traction_samples import RollingContact, WheelStep
from smallwheel_ros.estimator.traction_state import STRENGTH
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

Array = NDArray[np.float64]

GRAVITY = 9.80665  # m/s^2
# Of the specific force's mean over a step: 0.05 m/s^2 of acceleration, as much of a pitch that shakes.
_FORCE_STD = 0.07
_LONGEST_STEP = 1.0  # s: wheels that spin on one spot
_SOURCES = {"balance", "torque", "pull"}
_MOST_STEPS = 10**12


class TractionSample(NamedTuple):
    """What is known of a rolling wheel at one time (s), `distance` (m) along the vehicle's path.

    specific_force: m/s^2, of the vehicle along its travel: what its wheels pull per mass. torque:
    N m, of the wheel. pull: N. None where not measured.
    """

    wheel: str
    time: float
    distance: float
    contact: RollingContact
    slip: float
    forward: bool = True
    specific_force: float | None = None
    torque: float | None = None
    pull: Quantity | None = None


@dataclass
class _Step:
    """Samples of a step of the path, by wheel."""

    time: float
    distance: float
    samples: dict[str, list[TractionSample]] = field(default_factory=dict)


class TractionEstimator:
    """Refines strength and grip. wheels: of the vehicle that roll; mass: kg, 0: not known.

    Attributes
    ----------
    now, reserve
        The filter for the present pull, and the one for what could be pulled at another slip.
    steps
        That have told of the strength.
    """

    def __init__(self, strength: Strength, wheels: Sequence[Wheel], mass: float = 0.0) -> None:
        self._strength, self._wheels, self._mass = strength, tuple(wheels), mass
        self.reset()

    def reset(self) -> None:
        """Forget everything that was measured."""
        self.now = TractionFilter(self._strength, self._wheels, self._mass)
        self.reserve = self.now
        self._step: _Step | None = None
        self._end = 0.0  # time (s) of the last step
        self._slips: dict[str, float] = {}
        self._soil = 0
        self._soils: dict[int, tuple[tuple[Array, Array], ...]] = {}  # strengths by number
        self.steps = 0
        self.sources: set[str] = set()
        self.excitation = Excitation()

    def add(self, sample: TractionSample, soil: int = 0) -> None:
        """Use a sample; one that holds something else than numbers is left out.

        soil: number of the soil that a wheel came to last.
        """
        force, pull = sample.specific_force or 0.0, sample.pull or Quantity(0.0, 0.0)
        numbers = (sample.slip, force, sample.torque or 0.0, pull.value, pull.standard_deviation)
        if not all(map(math.isfinite, numbers)):
            return
        if soil != self._soil:
            self._change(soil)
        step = self._step
        if step is not None and (
            sample.distance - step.distance >= CELL or sample.time - step.time >= _LONGEST_STEP
        ):
            self._take(step, sample.distance)
            step = None
        if step is None:
            step = self._step = _Step(sample.time, sample.distance)
        step.samples.setdefault(sample.wheel, []).append(sample)

    def _change(self, soil: int) -> None:
        """Go on on another soil, with what is remembered of it."""
        filters = [self.now] if self.reserve is self.now else [self.now, self.reserve]
        self._soils[self._soil] = tuple(one.strength for one in filters)
        known = self._soils.get(soil)
        for i, one in enumerate(filters):
            one.strength = known[i] if known is not None and len(known) > i else None
        if known is None:
            self.excitation = Excitation()
        self._soil, self._step = soil, None

    def _take(self, step: _Step, distance: float) -> None:
        wheels = [_mean(self.now.order[name], rows) for name, rows in step.samples.items()]
        rows = [row for found in step.samples.values() for row in found]
        forces = [row.specific_force for row in rows if row.specific_force is not None]
        balance = None
        if self._mass > 0.0 and len(wheels) == len(self._wheels) and len(forces) == len(rows):
            balance = Quantity(float(np.mean(forces)), _FORCE_STD)
        single = any(w.torque is not None or w.pull is not None for w in wheels)
        if single and balance is not None and self.reserve is self.now:
            self.reserve = TractionFilter(self._strength, self._wheels, self._mass)
            self.reserve.kalman.x = self.now.kalman.x.copy()
            self.reserve.kalman.P = self.now.kalman.P.copy()
        self.now.move(distance - step.distance, rows[-1].forward)
        self.now.update(wheels, balance)
        if self.reserve is not self.now:
            self.reserve.move(distance - step.distance, rows[-1].forward)
            alone = [w._replace(torque=None, pull=None) for w in wheels]
            self.reserve.update(alone, balance)
        self._slips = {self._wheels[w.order].name: w.slip for w in wheels}
        self._end = rows[-1].time
        if single or balance is not None:
            self.steps += 1
            for wheel in wheels:
                self.excitation = self.excitation.widened(wheel.contact.load, abs(wheel.slip))
            self.sources |= {"balance"} if balance is not None else set()
            self.sources |= {"torque"} if any(w.torque is not None for w in wheels) else set()
            self.sources |= {"pull"} if any(w.pull is not None for w in wheels) else set()

    def wheel(
        self, name: str, contact: RollingContact, slip: float, time: float
    ) -> tuple[WheelStep, bool]:
        """A wheel as it is now, and whether its slip is the mean over the step that is just over.

        One measured slip is off by 0.03, which would be several newtons; the mean's error is in the
        filter's state.
        """
        averaged = name in self._slips and time - self._end <= _LONGEST_STEP
        now = self._slips[name] if averaged else slip
        return WheelStep(self.now.order[name], contact, now), averaged

    def estimate(self) -> StrengthEstimate:
        """Strength as it is believed now, from the filter of the reserve."""
        mean, covariance = self.reserve.strength
        prior = np.diag(np.square(self.reserve.prior_deviations))
        return strength_estimate(
            mean, covariance, prior, self.excitation, self.steps, frozenset(self.sources)
        )

    def record(self) -> dict[str, Any] | None:
        """What to save; None before anything was measured."""
        if not self.steps:
            return None
        mean, covariance = self.reserve.strength
        return {
            "prior": [self.reserve.prior_mean.tolist(), self.reserve.prior_deviations.tolist()],
            "mean": mean.tolist(),
            "covariance": covariance.tolist(),
            "steps": self.steps,
            "sources": sorted(self.sources),
            "loads": list(self.excitation.load),
            "slips": list(self.excitation.slip),
        }

    def restore(self, record: Any) -> None:
        """Begin anew from what was saved, None: from the prior.

        Raises ValueError, and changes nothing, where that is no strength of this prior.
        """
        if record is None:
            self.reset()
            return
        try:
            prior = np.array(record["prior"], dtype=float)
            mean = np.array(record["mean"], dtype=float)
            covariance = np.array(record["covariance"], dtype=float)
            told = _told(record)
        except (TypeError, KeyError, ValueError, OverflowError) as error:
            raise ValueError(f"no strength ({error})") from None
        expected = np.array([self.now.prior_mean, self.now.prior_deviations])
        if prior.shape != expected.shape or not np.allclose(prior, expected, rtol=1e-9):
            raise ValueError("saved under another prior of the soil's strength")
        try:
            if mean.shape != (STRENGTH,):
                raise ValueError("its mean is not four numbers")
            if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
                raise ValueError("a number is not finite")
            check_covariance(covariance, STRENGTH)
        except (ValueError, np.linalg.LinAlgError) as error:
            raise ValueError(f"no whole strength ({error})") from None
        self.reset()
        self.now.strength = mean, covariance
        self.steps, self.sources, self.excitation = told


def _told(record: Mapping[str, Any]) -> tuple[int, set[str], Excitation]:
    """Steps, sources and excitation that a saved strength rests on.

    Raises KeyError, TypeError or ValueError where they are not whole.
    """
    steps, sources = int(record["steps"]), set(record["sources"])
    (least_load, most_load), (least_slip, most_slip) = record["loads"], record["slips"]
    whole = (
        0 < steps <= _MOST_STEPS
        and sources <= _SOURCES
        and 0.0 < least_load <= most_load < math.inf
        and 0.0 <= least_slip <= most_slip <= 1.0
    )
    if not whole:
        raise ValueError("what it rests on is not whole")
    return steps, sources, Excitation((least_load, most_load), (least_slip, most_slip))


def _mean(order: int, rows: Sequence[TractionSample]) -> WheelStep:
    """Means of a wheel over a step; what resistances are off by, they have in common."""
    torques = [row.torque for row in rows if row.torque is not None]
    pulls = [row.pull for row in rows if row.pull is not None]
    load, sinkage, held, deviation, factor, slip = np.mean(
        [
            (
                row.contact.load,
                row.contact.sinkage,
                row.contact.resistance.value,
                row.contact.resistance.standard_deviation,
                row.contact.thrust_factor,
                row.slip,
            )
            for row in rows
        ],
        axis=0,
    ).tolist()
    pull = None
    if pulls:
        value, noise = np.mean([(p.value, p.standard_deviation**2) for p in pulls], axis=0)
        pull = Quantity(float(value), math.sqrt(noise / len(pulls)))
    contact = rows[0].contact._replace(
        load=load, sinkage=sinkage, resistance=Quantity(held, deviation), thrust_factor=factor
    )
    torque = float(np.mean(torques)) if torques else None
    return WheelStep(order, contact, slip, torque, pull)
