# SPDX-License-Identifier: Apache-2.0
"""The soil that the wheels came to last, the one behind its border, and those met before.

Is this another soil? Judged on the mean of several segments, abrupt or gradual: where the soil ends, all
that comes after it is off by one and the same factor of k. Segments wait for 0.6 m before they are used for
the soil. With each that comes, those of leading wheels (no other runs ahead of them) that are furthest along
the way are compared with the law, for each border that there may be: the shift of ln k that explains them
best, over its standard deviation,

    shift = sum(nu / by / v) / sum(1 / v),   v = var(nu by segment alone) / by^2
    variance = alike(rows) / sum(1 / v) + H P H / by^2

alike: how much more the mean of neighbours varies than that of independent ones, by the exponential
correlation over the segment's length.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.identifiability import SoilEstimate, Variety, seen_as
from smallwheel_ros.estimator.law_model import LAW, WHEELS, Innovation, LawModel, Shown
from smallwheel_ros.estimator.saved_state import SoilRecord
from smallwheel_ros.estimator.sensor_watch import SensorWatch
from smallwheel_ros.estimator.settings import REMEMBERED, EstimatorSettings, SoilPrior
from smallwheel_ros.estimator.soil_filter import LawFilter
from smallwheel_ros.estimator.stretches import Segment, WheelTrack
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE

Array = NDArray[np.float64]

WAIT = 3.0  # segment lengths that a segment waits: the rows that are looked at
_MOST = 8  # segments of a wheel that wait: one that turns on the spot travels, the vehicle does not
_TESTED = 20  # segments of a soil before another is looked for
_LEAST_SHIFT = math.log(1.25)  # of ln k: less is the soil's own drift
# 24 tests a metre with four wheels: one false alarm in 1000 m at 4.75 for sums of many rows, whose
# errors are near normal; one row alone has the tails of single places.
_LEAST_SIGMA, _ONE_ROW = 4.75, 1.5
_SHARE = 0.3  # of the shift that each wheel shows: else it is that wheel or its sensor
_WILD = 5.0  # deviations to which an innovation is cut
_SETTLED = 10  # segments of a soil after which it is worth remembering, and segments wait


@dataclass(frozen=True)
class Waiting:
    """A segment that waits, and what it should show, as linearised when it came."""

    segment: Segment
    about: tuple[Array, Shown]


@dataclass(frozen=True)
class Shift:
    """A change of ln k from `place` (m along the vehicle's path) on, and how sure it is."""

    place: float
    size: float
    sigma: float


class ChangeTest:
    """Holds segments back, and finds a change among them. length: m, of a segment."""

    def __init__(self, length: float) -> None:
        self._length = length
        self.waiting: deque[Waiting] = deque()

    def drop_stuck(self, wheel: str) -> None:
        """Forget the waiting segments of a sensor that turns out to be stuck."""
        self.waiting = deque(one for one in self.waiting if one.segment.wheel != wheel)

    def ready(self, distance: float) -> list[Waiting]:
        """Take out what has waited long enough at this travel (m)."""
        found = []
        counts = Counter(one.segment.wheel for one in self.waiting)
        while self.waiting:
            first = self.waiting[0].segment
            waited = first.distance < distance - WAIT * self._length
            if not waited and counts[first.wheel] <= _MOST:
                break
            counts[first.wheel] -= 1
            found.append(self.waiting.popleft())
        return found

    def find(self, law: LawFilter) -> Shift | None:
        """Look for a border: everything ahead of it is off by one factor of k."""
        if law.used < _TESTED:
            return None
        rows = sorted(
            (one for one in self.waiting if one.segment.position.leads),
            key=lambda one: -one.segment.place,
        )
        best: Shift | None = None
        total = weights = state = 0.0
        wheels: dict[str, list[float]] = {}
        for one in rows:
            found = law.innovation(one.segment, one.about)
            if not found.by_load > 0.0:
                return best
            shift = -_cut(found) / found.by_load
            weight = found.by_load**2 / (found.variance - found.state_variance)
            total += weight * shift
            weights += weight
            state = max(state, found.state_variance / found.by_load**2)
            wheels.setdefault(one.segment.wheel, []).append(shift)
            most = max(map(len, wheels.values()))
            size = total / weights
            sigma = abs(size) / math.sqrt(_alike(most) / weights + state)
            if abs(size) < _LEAST_SHIFT or sigma < _LEAST_SIGMA + (_ONE_ROW if most == 1 else 0.0):
                continue
            if self._agree(wheels, size) and (best is None or sigma > best.sigma):
                best = Shift(one.segment.place, size, sigma)
        return best

    def _agree(self, wheels: dict[str, list[float]], size: float) -> bool:
        """Whether every wheel that is ahead of the border shows it; two at least, where there are."""
        leading = {one.segment.wheel for one in self.waiting if one.segment.position.leads}
        if len(wheels) < min(2, len(leading)):
            return False
        return all(sum(shifts) / len(shifts) / size > _SHARE for shifts in wheels.values())


def _cut(found: Innovation) -> float:
    most = _WILD * math.sqrt(found.variance)
    return min(max(found.value, -most), most)


def _alike(lengths: int) -> float:
    """Variance of the mean over so many lengths, over that of independent single lengths."""

    def mean_variance(u: float) -> float:
        return 2.0 / u**2 * (u - 1.0 + math.exp(-u))

    return lengths * mean_variance(float(lengths)) / mean_variance(1.0)


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
        self._old = law.twin(), self.variety
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
