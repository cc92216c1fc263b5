# SPDX-License-Identifier: Apache-2.0
"""The search for one law: all terms of the grammar, their gains at the tangent, refits, description length.

The score of a law is n/2 ln det S of its errors plus the nats that it takes to describe it: ln of
the number of forms and of places, 1/2 ln n for each of its numbers (Rissanen 1978). Laws within
`TIE` of the best are tied; the draft is the one with the fewest drivers, then the shortest formula.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.constants import TIE
from smallwheel_ros.fitting.fit import FAILURES, Fit, Fitter
from smallwheel_ros.fitting.parameters import ParameterVector
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.learn.grammar import Driver, Term, drivers_of, terms_of
from smallwheel_ros.learn.law import CONSTANT, SOUGHT, LearntLaw, Link, Place, part_for, places_for
from smallwheel_ros.learn.tangent import Tangent, Yardstick, without_lack_of_fit
from smallwheel_ros.model.model import Model, predict

Array = NDArray[np.float64]
Index = NDArray[np.intp]
T = TypeVar("T")

_LOOKED_THROUGH = 250  # terms of a place, for the best of each set of drivers
_SECONDS = 3  # second terms that are fitted for a law
_WINDOW = 4.0 * TIE  # nats: what a tangent says is further behind is not refitted


@dataclass(frozen=True)
class TermGrid:
    """All terms of the grammar, evaluated at the points of a table.

    Attributes
    ----------
    sinkage
        Sinkage by the base model, m, shape (points,).
    values
        Values of each term, shape (points, terms).
    notes
        Why some settings are not drivers.
    """

    drivers: tuple[Driver, ...]
    terms: tuple[Term, ...]
    places: tuple[Place, ...]
    sinkage: Array
    values: Array
    notes: tuple[str, ...]

    @classmethod
    def of(cls, points: Points, base: Model) -> TermGrid:
        """Evaluate the grammar at points.

        Parameters
        ----------
        points
            The points of the fit.
        base
            The model without the law.
        """
        depth = predict(base, points.conditions).true_sinkage
        drivers, notes = drivers_of(points, depth)
        terms = terms_of(drivers, np.unique(points.setting).size)
        values = np.column_stack([term.at(points.conditions, depth) for term in terms])
        places = places_for(points.channels)
        return cls(tuple(drivers), tuple(terms), places, depth, values, tuple(notes))

    @cached_property
    def cost(self) -> Array:
        """Nats of each term, shape (terms,)."""
        return np.array([t.cost for t in self.terms])

    @cached_property
    def _before_depth(self) -> Index:
        return np.flatnonzero([bool(t.factors) and not t.of_depth for t in self.terms])

    def allowed(self, place: Place) -> Index:
        """The terms allowed at a place; a constant, and terms of the depth, only at R."""
        return np.arange(len(self.terms)) if place.stage == "R" else self._before_depth


@dataclass(frozen=True)
class LawCandidate:
    """A fitted law; `cost` is the nats of its description, `score` adds those of its errors."""

    law: LearntLaw
    fit: Fit
    cost: float
    score: float

    @property
    def numbers(self) -> dict[str, float]:
        """Its strengths and constants."""
        places = self.fit.vector.places(SOUGHT)
        return {self.fit.vector.free[j].field: float(self.fit.theta[j]) for j in places}


@dataclass(frozen=True)
class Found:
    """The fit of the base model, and the tied laws, best first; no laws if none shortens the description."""

    base: Fit
    tied: tuple[LawCandidate, ...]

    @property
    def draft(self) -> LawCandidate | None:
        """The tied law with the fewest drivers, and of these the shortest formula.

        Its place does not count here: the score by which laws are tied includes how rare a place is.
        """

        def simplest(c: LawCandidate) -> tuple[float, ...]:
            return c.law.weight, round(c.cost - c.law.place.nats, 6), c.score

        return min(self.tied, key=simplest, default=None)


@dataclass(frozen=True)
class LawProposal:
    """A law suggested by the tangent, not yet fitted.

    Attributes
    ----------
    law
        The law.
    numbers
        Numbers from which its fit starts, by name, SI units.
    cost
        Nats of its description.
    expected
        Its score by the tangent, nats.
    near
        The fit at which the tangent is taken.
    """

    law: LearntLaw
    numbers: Mapping[str, float]
    cost: float
    expected: float
    near: Fit


@dataclass(frozen=True)
class Site:
    """A place, a link and the tangent of a fit, by which terms are searched for.

    Attributes
    ----------
    place, link
        Where the terms act, and how they form the change.
    near
        The fit at which the tangent is taken.
    slope
        Derivative of the predictions with respect to the sum of the terms, shape (values,).
    tangent
        The tangent.
    """

    place: Place
    link: Link
    near: Fit
    slope: Array
    tangent: Tangent


@dataclass(frozen=True)
class Effort:
    """How many laws are refitted.

    Attributes
    ----------
    first
        Number of laws that are refitted first, from the base's tangent.
    again, forms
        Number of places that each round searches further, and of forms that are refitted at each.
    seconds
        Number of laws that get a second term.
    anew
        Number of laws that are refitted once the scatter is estimated; the others only get a new score.
    """

    first: int
    again: tuple[int, ...]
    forms: int
    seconds: int
    anew: int


WHOLE, FOLD = Effort(24, (8, 4), 5, 10, 12), Effort(12, (4, 1), 4, 4, 6)


def first_of_each(items: Iterable[T], key: Callable[[T], Hashable]) -> Iterator[T]:
    """The first item of each kind, in their order.

    Parameters
    ----------
    items
        Items of several kinds.
    key
        Gives an item's kind.
    """
    seen: set[Hashable] = set()
    for item in items:
        kind = key(item)
        if kind not in seen:
            seen.add(kind)
            yield item


def _kind(proposal: LawProposal) -> Hashable:
    return proposal.law.terms[0].kind


class LawSearch:
    """Searches one set of points for a law.

    Parameters
    ----------
    fitter
        Fitter of the points.
    base
        The model without the law, fitted to them.
    grid
        The grammar at these points.
    """

    def __init__(self, fitter: Fitter, base: Fit, grid: TermGrid) -> None:
        self.fitter, self.base, self.grid = fitter, base, grid
        self.observed = fitter.points.value
        self.yardstick = Yardstick(fitter, base)
        self._row = fitter.points.row
        self._scatter = without_lack_of_fit(base.scatter)
        self._known: dict[Hashable, LawCandidate] = {}

    def run(self, effort: Effort) -> Found:
        """Search, refit, search again around the best laws, and try a second term."""
        chosen = self._from_base(effort.first)
        self._fit(chosen, len(chosen))
        for places in effort.again:
            self._judge_anew(0)
            each = first_of_each(self._ordered(), lambda c: (c.law.place, frozenset(c.law.drivers)))
            for candidate in itertools.islice(each, places):
                for link in candidate.law.place.links:
                    site = self._site(candidate, link)
                    ranked = self._ranked(site, self.grid.allowed(site.place))
                    self._fit(first_of_each(ranked, _kind), effort.forms)
        self._judge_anew(effort.anew)
        self._two_terms(effort.seconds)
        base = self.fitter.fit(replace(self.base, scatter=self._scatter), turns=0)
        plain, laws = self.yardstick.score(self.observed - base.predicted), self._ordered()
        gains = bool(laws) and laws[0].score < plain
        return Found(base, tuple(c for c in laws if gains and c.score < laws[0].score + TIE))

    # --- What a tangent proposes

    def slope(self, fit: Fit, place: Place) -> Array:
        """Derivative of the predictions with respect to the place's ln factor or shift, shape (values,).

        Parameters
        ----------
        fit
            The fit at which it is taken.
        place
            The place in the model.
        """
        step = 1.0 if place.stage == "R" else 1e-4  # what is added in newtons is linear
        probe = part_for(LearntLaw(place, "exponential", (CONSTANT,)), {"a1": 0.0}, [1.0])
        vector = replace(fit.vector, parts=(*fit.vector.parts, replace(probe, id="probe")))
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

    def _ranked(self, site: Site, terms: Index) -> Iterator[LawProposal]:
        """Laws of one of these terms, the shortest first."""
        gains, strength = site.tangent.gains(site.slope, self.values(terms))
        cost = self.grid.cost[terms] + (np.log(len(self.grid.places)) + site.place.nats)
        expected = site.tangent.nats[0] - gains[:, 0] + cost
        for i in np.argsort(expected, kind="stable"):
            term = self.grid.terms[terms[i]]
            numbers = {"a1": float(strength[i, 0])} | ({"c1": term.constant} if term.free else {})
            law = LearntLaw(site.place, site.link, (term,))
            yield LawProposal(law, numbers, float(cost[i]), float(expected[i]), site.near)

    def _from_base(self, count: int) -> list[LawProposal]:
        """The best of each place and set of drivers at the base's tangent."""
        white = self.yardstick.white(self.observed - self.base.predicted)
        tangent = Tangent(self.yardstick, white, self.base.slopes)
        best: list[LawProposal] = []
        for place in self.grid.places:
            site = Site(place, "exponential", self.base, self.base_slopes[place.name], tangent)
            ranked = itertools.islice(self._ranked(site, self.grid.allowed(place)), _LOOKED_THROUGH)
            best += first_of_each(ranked, lambda p: p.law.terms[0].drivers)
        best.sort(key=lambda p: p.expected)
        # Each place has its chance: a tangent may mislead.
        own = {id(p) for p in first_of_each(best, lambda p: p.law.place)}
        return [p for i, p in enumerate(best) if i < count or id(p) in own]

    def _site(self, candidate: LawCandidate, link: Link, *, kept: bool = False) -> Site:
        """About a candidate, its law taken out: another is to explain what it does. kept: left in."""
        fit, law = candidate.fit, candidate.law
        slope, sinkage = self.slope(fit, law.place), self.grid.sinkage
        conditions = self.fitter.points.conditions
        change = law.change(candidate.numbers, lambda driver: driver.values(conditions, sinkage))
        total = change = np.broadcast_to(change, sinkage.shape)[self._row]
        if not law.place.added and link == "linear":
            slope, total = slope / change, change - 1.0
        elif not law.place.added:
            total = np.log(change)
        error, slopes = self.observed - fit.predicted, fit.slopes
        if not kept:
            error = error + slope * total
            slopes = slopes[:, [p.owner != SOUGHT for p in fit.vector.free]]
        tangent = Tangent(self.yardstick, self.yardstick.white(error), slopes)
        return Site(law.place, link, fit, slope, tangent)

    def _second(self, candidate: LawCandidate) -> Iterator[LawProposal]:
        """The candidate with one more term of its driver, the shortest law first."""
        law, own = candidate.law, self._of_driver(candidate.law)
        others = own[[self.grid.terms[i].kind != law.terms[0].kind for i in own]]
        ranked = self._ranked(self._site(candidate, law.link, kept=True), others)
        return (self._joined(candidate, p, own) for p in ranked)

    def _two_sided(self, candidate: LawCandidate) -> list[LawProposal]:
        """A term of the candidate's driver on each side of zero, in every pair of shapes.

        Driving and braking are different mechanisms: what one side asks for need not be among the best
        laws of the whole range.
        """
        own = self._of_driver(candidate.law)
        side = np.array([self.grid.terms[i].side for i in own])
        if not np.any(side < 0):
            return []
        site = self._site(candidate, candidate.law.link)
        pairs = []
        for one in first_of_each(self._ranked(site, own[side < 0]), _kind):
            moved = site.slope * self._at_values(one.law.terms[0])
            beside = replace(site, tangent=site.tangent.beside(moved))
            others = first_of_each(self._ranked(beside, own[side > 0]), _kind)
            pairs += [self._joined(one, other, own) for other in others]
        return sorted(pairs, key=lambda p: p.expected)

    def _of_driver(self, law: LearntLaw) -> Index:
        """The terms that can be added to a law of one driver."""
        drivers = law.terms[0].drivers
        own = [i for i, t in enumerate(self.grid.terms) if t.drivers == drivers and not t.alone]
        return np.array(own, dtype=np.intp)

    def _joined(
        self, first: LawCandidate | LawProposal, second: LawProposal, own: Index
    ) -> LawProposal:
        """A law with a second term, of the same place, driver and tangent. own: terms to choose from."""
        (term,) = second.law.terms
        kinds = len({self.grid.terms[i].kind for i in own})
        half = 0.5 * float(np.log(self.yardstick.count))
        cost = first.cost + (float(np.log(kinds)) + half * term.numbers)
        law = replace(first.law, terms=(*first.law.terms, term))
        numbers = {**first.numbers, **{f"{n[0]}2": v for n, v in second.numbers.items()}}
        return LawProposal(law, numbers, cost, second.expected - second.cost + cost, second.near)

    # --- Fits in the model

    def _fit(self, proposals: Iterable[LawProposal], count: int) -> None:
        """Fit the first of these laws in the model, and keep each that is the best of its kind."""
        best = min((c.score for c in self._known.values()), default=np.inf)
        for p in itertools.islice(proposals, count):
            if p.expected > best + _WINDOW:
                break
            sizes = [self._size(p.law.place, term) for term in p.law.terms]
            part = part_for(p.law, p.numbers, sizes)
            vector = replace(self.base.vector, parts=(*self.base.vector.parts, part))
            start = vector.begun_at(p.near.vector, p.near.theta)
            start[vector.places(SOUGHT)] = part.start
            self._keep(p.law, vector, start, p.cost)

    def _keep(self, law: LearntLaw, vector: ParameterVector, start: Array, cost: float) -> None:
        try:
            with np.errstate(all="ignore"):  # a law may ask for a soil that there is not
                fit = self.fitter.fit(self.fitter.at(vector, start, self._scatter), turns=0)
        except FAILURES:
            return
        score = self.yardstick.score(self.observed - fit.predicted) + cost
        known = self._known.get(law.key)
        if np.isfinite(score) and (known is None or score < known.score):
            self._known[law.key] = LawCandidate(law, fit, cost, score)

    def _judge_anew(self, anew: int) -> None:
        """Estimate the scatter with the best law in the model, and judge all by that."""
        ordered = self._ordered()
        if not ordered:
            return
        best = ordered[0].fit
        fit = self.fitter.fit(replace(best, scatter=self._scatter), turns=2)
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

    def _ordered(self) -> list[LawCandidate]:
        return sorted(self._known.values(), key=lambda c: c.score)

    def _at_values(self, term: Term) -> Array:
        """A term at each value, shape (values,)."""
        return term.at(self.fitter.points.conditions, self.grid.sinkage)[self._row]

    def _size(self, place: Place, term: Term) -> float:
        """Strength at which a term moves what it moves by as much as was measured."""
        moved = np.abs(self.base_slopes[place.name] * self._at_values(term) / self.observed)
        usual = float(np.sqrt(np.mean(moved[moved > 0.0] ** 2))) if moved.any() else 1.0
        return 1.0 / max(usual, 1e-12)
