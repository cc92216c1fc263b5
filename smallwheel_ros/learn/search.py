# SPDX-License-Identifier: Apache-2.0
"""The search for one law: tangent, refits in the model, description length.

The score of a law is n/2 ln det S of its errors plus the nats that it takes to describe it: ln of
the number of forms and of places, 1/2 ln n for each of its numbers (Rissanen 1978). Laws within
`TIE` of the best are tied; of these the draft has the fewest drivers, then the shortest formula.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.candidate import FAILURES
from smallwheel_ros.fitting.constants import TIE
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.parameters import ParameterVector
from smallwheel_ros.learn.candidate import Candidate, Found
from smallwheel_ros.learn.grammar import Term
from smallwheel_ros.learn.grid import Grid, Index
from smallwheel_ros.learn.law import CONSTANT, SOUGHT, Law, Link, Place, part_for
from smallwheel_ros.learn.proposal import Proposal, both, first_of_each, start
from smallwheel_ros.learn.tangent import Tangent, Yardstick, without_lack_of_fit

Array = NDArray[np.float64]

_LOOKED_THROUGH = 250  # terms of a place, for the best of each set of drivers
_SECONDS = 3  # second terms that are fitted for a law
_WINDOW = 4.0 * TIE  # nats: what a tangent says is further behind is not refitted


@dataclass(frozen=True)
class Effort:
    """How many laws are refitted.

    first: from the base's tangent. again, forms: places searched on in each round, and forms of each
    that are refitted. seconds: laws that get a second term. anew: laws that are fitted anew when the
    scatter is; the others are only judged anew.
    """

    first: int
    again: tuple[int, ...]
    forms: int
    seconds: int
    anew: int


WHOLE, FOLD = Effort(24, (8, 4), 5, 10, 12), Effort(12, (4, 1), 4, 4, 6)


class Search:
    """Searches one set of points. base: the model without the law, fitted to them."""

    def __init__(self, fitter: Fitter, base: Fit, grid: Grid) -> None:
        self.fitter, self.base, self.grid = fitter, base, grid
        self.observed = fitter.points.value
        self.yardstick = Yardstick(fitter, base)
        self._row = fitter.points.row
        self._scatter = without_lack_of_fit(base.scatter)
        self._known: dict[tuple[object, ...], Candidate] = {}

    def run(self, effort: Effort) -> Found:
        """Search, refit, search again about the best, and try a second term."""
        chosen = self._from_base(effort.first)
        self._fit(chosen, len(chosen))
        for places in effort.again:
            self._judge_anew(0)
            for candidate in self._best_of_each(places):
                for link in candidate.law.place.links:
                    self._fit(self._about(candidate, link), effort.forms)
        self._judge_anew(effort.anew)
        self._two_terms(effort.seconds)
        base = self.fitter.fit(self.base.vector, self.base.theta, self._scatter, turns=0)
        score = self.yardstick.score(self.observed - base.predicted)
        return Found(base, score, tuple(self._ordered()))

    # --- What a tangent proposes

    def slope(self, fit: Fit, place: Place) -> Array:
        """Slope of the predictions by the place's ln factor or shift, shape (values,)."""
        step = 1.0 if place.stage == "R" else 1e-4  # what is added in newtons is linear
        probe = part_for(Law(place, "exponential", (CONSTANT,)), {"a1": 0.0}, [1.0])
        vector = fit.vector.with_parts([*fit.vector.parts, replace(probe, id="probe")])
        thetas = np.vstack([np.append(fit.theta, 0.0), np.append(fit.theta, step)])
        without, moved = self.fitter.predictor.many(vector, thetas)
        return np.asarray((moved - without) / step)

    @cached_property
    def base_slopes(self) -> Mapping[str, Array]:
        """By place, the slope of the base's predictions by its ln factor or shift."""
        return {p.name: self.slope(self.base, p) for p in self.grid.places}

    def values(self, terms: Index) -> Array:
        """Values of terms at each point, shape (points, terms)."""
        return np.asarray(self.grid.values[np.ix_(self.yardstick.rows, terms)])

    def _ranked(
        self, tangent: Tangent, slope: Array, terms: Index, place: Place, link: Link, near: Fit
    ) -> Iterator[Proposal]:
        """Laws of one of these terms, the shortest first. slope: by the sum of the law's terms."""
        gains, strength = tangent.gains(slope, self.values(terms))
        cost = self.grid.cost[terms] + self.grid.place_cost(place)
        expected = tangent.nats[0] - gains[:, 0] + cost
        for i in np.argsort(expected, kind="stable"):
            law = Law(place, link, (self.grid.terms[terms[i]],))
            numbers = start(law, 1, float(strength[i, 0]))
            yield Proposal(law, numbers, float(cost[i]), float(expected[i]), near)

    def _from_base(self, count: int) -> list[Proposal]:
        """The best of each place and set of drivers at the base's tangent."""
        white = self.yardstick.white(self.observed - self.base.predicted)
        tangent = Tangent(self.yardstick, white, self.base.slopes)
        best: list[Proposal] = []
        for place in self.grid.places:
            slope = self.base_slopes[place.name]
            ranked = self._ranked(
                tangent, slope, self.grid.allowed(place), place, "exponential", self.base
            )
            looked_through = itertools.islice(ranked, _LOOKED_THROUGH)
            best += first_of_each(looked_through, lambda p: p.law.terms[0].drivers)
        best.sort(key=lambda p: p.expected)
        # Each place has its chance: a tangent may mislead.
        own = {id(p) for p in first_of_each(best, lambda p: p.law.place)}
        return [p for i, p in enumerate(best) if i < count or id(p) in own]

    def _about(self, candidate: Candidate, link: Link) -> Iterator[Proposal]:
        """Laws of one term at a candidate's place and tangent, the best of each kind."""
        place, (error, slope, base) = candidate.law.place, self._without(candidate, link)
        tangent = Tangent(self.yardstick, error, base)
        ranked = self._ranked(tangent, slope, self.grid.allowed(place), place, link, candidate.fit)
        return first_of_each(ranked, lambda p: p.law.terms[0].kind)

    def _without(self, candidate: Candidate, link: Link) -> tuple[Array, Array, Array]:
        """Whitened errors at a candidate with its law taken out: another is to explain what it does.

        With them the slope by the sum of a law's terms, and those by the base's own parameters.
        """
        fit = candidate.fit
        slope, total = self._under(candidate, link)
        error = self.yardstick.white(self.observed - fit.predicted + slope * total)
        base = [j for j, p in enumerate(fit.vector.free) if p.owner != SOUGHT]
        return error, slope, fit.slopes[:, base]

    def _second(self, candidate: Candidate) -> Iterator[Proposal]:
        """The candidate with one more term of its driver, the best of each kind."""
        law, fit = candidate.law, candidate.fit
        slope, _ = self._under(candidate, law.link)
        error = self.yardstick.white(self.observed - fit.predicted)
        tangent = Tangent(self.yardstick, error, fit.slopes)
        own, kinds = self._of_driver(law)
        others = np.array([i for i in own if self.grid.terms[i].kind != law.terms[0].kind], np.intp)
        for p in self._ranked(tangent, slope, others, law.place, law.link, fit):
            cost = candidate.cost + self._cost_of_second(p, kinds)
            yield both(law, candidate.numbers, p, cost, p.expected - p.cost + cost)

    def _two_sided(self, candidate: Candidate) -> list[Proposal]:
        """A term of the candidate's driver on each side of zero, in every pair of shapes.

        Driving and braking are different mechanisms: what one side asks for need not be among the best
        laws of the whole range.
        """
        law, fit = candidate.law, candidate.fit
        own, kinds = self._of_driver(law)
        below, above = (
            np.array([i for i in own if self.grid.terms[i].side == side], np.intp)
            for side in (-1, 1)
        )
        if not below.size:
            return []
        error, slope, base = self._without(candidate, law.link)
        tangent = Tangent(self.yardstick, error, base)
        pairs = []
        ranked = self._ranked(tangent, slope, below, law.place, law.link, fit)
        for one in first_of_each(ranked, lambda p: p.law.terms[0].kind):
            moved = slope * self._at_values(one.law.terms[0])
            beside = Tangent(self.yardstick, error, np.column_stack([base, moved]))
            others = self._ranked(beside, slope, above, law.place, law.link, fit)
            for other in first_of_each(others, lambda p: p.law.terms[0].kind):
                cost = one.cost + self._cost_of_second(other, kinds)
                expected = other.expected - other.cost + cost
                pairs.append(both(one.law, one.numbers, other, cost, expected))
        return sorted(pairs, key=lambda p: p.expected)

    def _of_driver(self, law: Law) -> tuple[list[int], int]:
        """The terms that can be added to a law of one driver, and how many kinds there are."""
        drivers = law.terms[0].drivers
        own = [i for i, t in enumerate(self.grid.terms) if t.drivers == drivers and not t.alone]
        return own, len({self.grid.terms[i].kind for i in own})

    def _cost_of_second(self, proposal: Proposal, kinds: int) -> float:
        """Nats that a second term of the same place and driver takes. kinds: to choose from."""
        half = 0.5 * float(np.log(self.yardstick.count))
        return float(np.log(kinds)) + half * proposal.law.terms[0].numbers

    def _under(self, candidate: Candidate, link: Link) -> tuple[Array, Array]:
        """Slope of a law's predictions by the sum of its terms, and that sum, under a link."""
        fit, law = candidate.fit, candidate.law
        slope = self.slope(fit, law.place)
        conditions, sinkage = self.fitter.points.conditions, self.grid.sinkage
        change = law.change(candidate.numbers, lambda driver: driver.values(conditions, sinkage))
        change = np.broadcast_to(change, sinkage.shape)[self._row]
        if law.place.added:
            return slope, change
        return (slope / change, change - 1.0) if link == "linear" else (slope, np.log(change))

    # --- Fits in the model

    def _fit(self, proposals: Iterable[Proposal], count: int) -> None:
        """Fit the first of these laws in the model, and keep each that is the best of its kind."""
        best = min((c.score for c in self._known.values()), default=np.inf)
        for p in itertools.islice(proposals, count):
            if p.expected > best + _WINDOW:
                break
            sizes = [self._size(p.law.place, term) for term in p.law.terms]
            part = part_for(p.law, p.numbers, sizes)
            vector = self.base.vector.with_parts([*self.base.vector.parts, part])
            start = vector.begun_at(p.near.vector, p.near.theta)
            start[vector.places(SOUGHT)] = part.start
            self._keep(p.law, vector, start, p.cost)

    def _keep(self, law: Law, vector: ParameterVector, start: Array, cost: float) -> None:
        try:
            with np.errstate(all="ignore"):  # a law may ask for a soil that there is not
                fit = self.fitter.fit(vector, start, self._scatter, turns=0)
        except FAILURES:
            return
        score = self.yardstick.score(self.observed - fit.predicted) + cost
        if np.isfinite(score) and (
            law.key not in self._known or score < self._known[law.key].score
        ):
            self._known[law.key] = Candidate(law, fit, cost, score)

    def _judge_anew(self, anew: int) -> None:
        """Estimate the scatter with the best law in the model, and judge all by that."""
        ordered = self._ordered()
        if not ordered:
            return
        best = ordered[0].fit
        fit = self.fitter.fit(best.vector, best.theta, self._scatter, turns=2)
        self._scatter = without_lack_of_fit(fit.scatter)
        self.yardstick = Yardstick(self.fitter, fit)
        self._known = {}
        for old in ordered[:anew]:
            self._keep(old.law, old.fit.vector, old.fit.theta, old.cost)
        for old in ordered[anew:]:
            score = self.yardstick.score(self.observed - old.fit.predicted) + old.cost
            self._known[old.law.key] = replace(old, score=score)

    def _two_terms(self, count: int) -> None:
        """Give the best laws a second term of their driver; kept where that is `TIE` shorter.

        Another driver would be another law: that is learnt when the first is in the model.
        """
        one_term = self._ordered()
        ours = [c for c in one_term if len((t := c.law.terms[0]).factors) == 1 and not t.alone]
        for candidate in ours[:count]:
            self._fit(self._second(candidate), _SECONDS)
        apart = first_of_each(ours, lambda c: (c.law.place, c.law.link, c.law.terms[0].drivers))
        for candidate in itertools.islice(apart, count):
            self._fit(self._two_sided(candidate), _SECONDS)
        self._known = {
            key: c for key, c in self._known.items()
            if len(c.law.terms) == 1 or c.score < one_term[0].score - TIE
        }  # fmt: skip

    def _ordered(self) -> list[Candidate]:
        return sorted(self._known.values(), key=lambda c: c.score)

    def _best_of_each(self, count: int) -> list[Candidate]:
        """The best laws, one of each place and set of drivers."""
        each = first_of_each(self._ordered(), lambda c: (c.law.place, frozenset(c.law.drivers)))
        return list(itertools.islice(each, count))

    def _at_values(self, term: Term) -> Array:
        """A term at each value, shape (values,)."""
        return term.at(self.fitter.points.conditions, self.grid.sinkage)[self._row]

    def _size(self, place: Place, term: Term) -> float:
        """Strength at which a term moves what it moves by as much as was measured."""
        moved = np.abs(self.base_slopes[place.name] * self._at_values(term) / self.observed)
        usual = float(np.sqrt(np.mean(moved[moved > 0.0] ** 2))) if moved.any() else 1.0
        return 1.0 / max(usual, 1e-12)
