# SPDX-License-Identifier: Apache-2.0
"""The soil that the wheels came to last, the one behind its border, and those met before."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.identifiability import SoilEstimate, Variety, seen_as
from smallwheel_ros.estimator.law_filter import LawFilter
from smallwheel_ros.estimator.law_model import LAW, WHEELS, LawModel
from smallwheel_ros.estimator.saved_state import SoilRecord
from smallwheel_ros.estimator.segment import Segment
from smallwheel_ros.estimator.sensor_watch import SensorWatch
from smallwheel_ros.estimator.settings import REMEMBERED, EstimatorSettings, SoilPrior
from smallwheel_ros.estimator.soil_change import ChangeTest, Shift, Waiting
from smallwheel_ros.estimator.wheel_track import WheelTrack
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE

Array = NDArray[np.float64]

_SETTLED = 10  # segments of a soil after which it is worth remembering, and segments wait


@dataclass(frozen=True)
class KnownSoil:
    """A soil that was met: mean and covariance of (ln z_ref, n, m). number: in order of meeting."""

    state: tuple[Array, Array]
    variety: Variety
    number: int


class Reported:
    """Reports the soil at the sinkage and the diameter of the settings, the prior's covariance too."""

    def __init__(self, prior: SoilPrior, settings: EstimatorSettings) -> None:
        self._at = sinkage, diameter = settings.reference_sinkage, settings.reference_diameter
        self._turn = np.eye(3)  # of (ln pressure, n, m)
        self._turn[0, 1] = math.log(sinkage / REFERENCE_SINKAGE)
        self._turn[0, 2] = math.log(diameter / REFERENCE_DIAMETER)
        self._prior = seen_as(self._turn, prior.law[1])
        self._last: tuple[tuple[Array, Array], float, Array, Array] | None = None

    def turned(self, covariance: Array) -> Array:
        """Covariance of another quantity with (ln pressure, n, m), as reported."""
        found: Array = self._turn @ covariance
        return found

    def estimate(self, law: tuple[Array, Array], missed: float, **found: Any) -> SoilEstimate:
        """The soil of a law: mean and covariance as in `SoilPrior.law`.

        missed: variance of ln k besides. found: what else a `SoilEstimate` says.
        """
        if self._last is None or self._last[0] is not law or self._last[1] != missed:
            more = np.diag([missed, 0.0, 0.0])
            turned = self._turn @ law[0], seen_as(self._turn, law[1] + more)
            self._last = law, missed, *turned
        _, _, mean, covariance = self._last
        pressure, n, m = mean.tolist()
        sinkage, diameter = self._at
        k = math.exp(pressure - n * math.log(sinkage) - m * math.log(diameter))
        return SoilEstimate(k, n, m, pressure, covariance, self._prior, *self._at, **found)


class Soils:
    """Uses segments for the soil that they are of.

    Attributes
    ----------
    law
        The filter; None before the first wheel.
    number
        Of the soil that a wheel came to last, counted as soils are met.
    test
        Holds segments back, and looks for another soil.
    variety, changes, accepted
        Of the segments used; soil changes found; readings used.
    """

    def __init__(
        self,
        prior: SoilPrior,
        settings: EstimatorSettings,
        effects: Sequence[Effect],
        sensors: SensorWatch,
    ) -> None:
        self._prior, self._settings, self._effects = prior, settings, tuple(effects)
        self._sensors = sensors
        self.test = ChangeTest(settings.scatter_length)
        self._border = -math.inf  # m along the vehicle's path: what is behind is the old soil
        self._old: tuple[LawFilter, Variety] | None = None  # of the soil behind the border
        self._remembered: list[KnownSoil] = []
        self.law: LawFilter | None = None
        self.number = self._met = 0
        self.variety = Variety()
        self.changes = self.accepted = 0

    def new_law(self, reference: tuple[float, float, float]) -> LawFilter:
        """Return a filter at the prior. reference: see `LawModel`."""
        model = LawModel(self._prior, self._settings, self._effects, reference)
        return LawFilter(model, self._prior, self._settings)

    def add_wheel(self) -> int:
        """Give a wheel a place in the state."""
        assert self.law is not None
        if self._old is not None:
            self._old[0].add_wheel()
        return self.law.add_wheel()

    def resume(self, record: SoilRecord, variety: Variety, accepted: int) -> None:
        """Go on from a saved soil."""
        self.law = self.new_law(record.reference)
        self.law.resume(record.mean, record.covariance, _SETTLED)
        self.variety, self.accepted = variety, accepted
        self._sensors.resume(self.law)

    def record(self) -> SoilRecord | None:
        """What to save; None before anything was learnt."""
        law = self.law
        if law is None or not law.used:
            return None
        covariance = law.covariance[:WHEELS, :WHEELS]
        symmetric = 0.5 * (covariance + covariance.T)
        return SoilRecord(law.model.reference, law.mean[:WHEELS].copy(), symmetric)

    def is_behind(self, wheel: WheelTrack) -> bool:
        """Whether a wheel is on the old soil still."""
        return wheel.at < self._border

    def _is_clear(self, segment: Segment) -> bool:
        """Whether a segment is of the newest soil alone, and no part of it behind the border."""
        return segment.place >= self._border + self._settings.scatter_length

    def under(self, wheel: WheelTrack | None) -> tuple[LawFilter | None, Variety]:
        """The filter of the soil under a wheel, None before any, and the soil's excitation range.

        wheel: None: of the soil that a wheel came to last.
        """
        if self._old is not None and wheel is not None and self.is_behind(wheel):
            return self._old
        return self.law, self.variety

    def turn_back(self) -> None:
        """The vehicle drives the other way: who came last comes first, and places count from there."""
        law = self.law
        if law is not None:
            for one in self.test.ready(math.inf):
                self._absorb(one, law)
        self._border, self._old = -math.inf, None

    def take(self, segment: Segment) -> None:
        """A segment has closed: it waits, may show another soil, and then is used."""
        law = self.law
        if law is None or not self._is_clear(segment):
            return
        about = law.linearised(segment)
        if segment.contact != ROLLING:
            # A rig presses into one place: there is no border on the way down.
            self._absorb(Waiting(segment, about), law)
            return
        self.test.waiting.append(Waiting(segment, about))
        shift = self.test.find(law) if segment.position.leads else None
        if shift is not None:
            self._change(shift, law)
            return
        settled = law.used >= _SETTLED
        for one in self.test.ready(segment.distance if settled else math.inf):
            self._absorb(one, law)

    def _absorb(self, one: Waiting, law: LawFilter) -> None:
        segment = one.segment
        before = law.innovation(segment, one.about)
        law.absorb(segment)
        self._sensors.judge(segment, before.value / math.sqrt(before.variance))
        self._sensors.follow(law)
        self.accepted += segment.count
        self.variety = self.variety.with_wheel(segment.diameter, segment.load / segment.width)

    def _change(self, shift: Shift, law: LawFilter) -> None:
        """Close the old soil, and go on with the prior or with a soil that is remembered.

        Segments nearer to the border than a length may lie on both soils: they are used for neither.
        """
        waiting = list(self.test.waiting)
        self.test.waiting.clear()
        for one in waiting:
            if one.segment.place < shift.place - self._settings.scatter_length:
                self._absorb(one, law)
        new = [one for one in waiting if one.segment.place >= shift.place]
        self._old = deepcopy(law), self.variety
        if law.used >= _SETTLED:
            state = law.mean[:LAW].copy(), law.covariance[:LAW, :LAW].copy()
            met = KnownSoil(state, self.variety, self.number)
            self._remembered = [*self._remembered, met][-REMEMBERED:]
        known = self._like(new, law)
        newest = max(one.segment.distance for one in waiting)
        law.reopen(None if known is None else known.state, shift.size, newest)
        self.variety = Variety() if known is None else known.variety
        self._met += known is None
        self.number = self._met if known is None else known.number
        self._border = shift.place
        self.changes += 1
        for one in new:
            if self._is_clear(one.segment):
                self._absorb(one, law)

    def _like(self, new: Sequence[Waiting], law: LawFilter) -> KnownSoil | None:
        """Return the remembered soil that these segments are more likely of than of the prior."""
        segments = [one.segment for one in new]
        best, found = law.log_likelihood(None, segments), None
        for known in self._remembered:
            likelihood = law.log_likelihood(known.state, segments)
            if likelihood > best:
                best, found = likelihood, known
        return found
