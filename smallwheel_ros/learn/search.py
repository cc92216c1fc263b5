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

_LOOKED_THROUGH = 250  # best terms of a place, of which the best of each set of drivers is kept
_SECONDS = 3  # second terms that are fitted for a law
_WINDOW = 4.0 * TIE  # nats: a law expected to be worse than the best by more is not fitted


@dataclass(frozen=True)
class TermGrid:
    """All terms of the grammar, evaluated at the points of a table.

    Attributes
    ----------
    drivers, terms, places
        Drivers that vary, all terms of them, and the places where these channels can show a law.
    sinkage
        Sinkage predicted by the model without the law, m, shape (points,).
    values
        Values of each term, SI, shape (points, terms).
    notes
        Sentences on why some settings are not drivers.
    """

    drivers: tuple[Driver, ...]
    terms: tuple[Term, ...]
    places: tuple[Place, ...]
    sinkage: Array
    values: Array
    notes: tuple[str, ...]

    @classmethod
    def of(cls, points: Points, base: Model) -> TermGrid:
        """Evaluate all terms of the grammar at the points of a table.

        Parameters
        ----------
        points
            The points of the fit.
        base
            The fitted model without the law, which predicts the sinkage.
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
        """Indices of the terms allowed at a place; the constant, and terms of the depth, only at stage R."""
        return np.arange(len(self.terms)) if place.stage == "R" else self._before_depth


@dataclass(frozen=True)
class LawCandidate:
    """A law that was fitted in the model.

    Attributes
    ----------
    law
        The law; its `terms` have the constants from before the fit (`numbers` has the fitted ones).
    fit
        Fit of the model with the law.
    cost
        Length of the law's description, nats.
    score
        `cost` plus n/2 ln det S of the fit's errors (`Yardstick.score`), nats: the lower, the better.
    """

    law: LearntLaw
    fit: Fit
    cost: float
    score: float

    @property
    def numbers(self) -> dict[str, float]:
        """Its fitted strengths and constants by name, SI units."""
        places = self.fit.vector.places(SOUGHT)
        return {self.fit.vector.free[j].field: float(self.fit.theta[j]) for j in places}


@dataclass(frozen=True)
class Found:
    """Result of one search.

    Attributes
    ----------
    base
        Fit of the model without a law.
    tied
        Laws within `TIE` nats of the best, which comes first; empty if no law has a better score than none.
    """

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
    """A law that has not been fitted yet, with the score that linearised predictions give it.

    Attributes
    ----------
    law
        The law.
    numbers
        Strengths and constants from which its fit starts, by name, SI units.
    cost
        Length of its description, nats.
    expected
        Its score (`LawCandidate.score`) by predictions that are linearised about `near`, nats.
    near
        The fit about which they are linearised.
    """

    law: LearntLaw
    numbers: Mapping[str, float]
    cost: float
    expected: float
    near: Fit


@dataclass(frozen=True)
class Site:
    """A place in the model and a fit whose predictions are linearised there, to rank all terms at once.

    Attributes
    ----------
    place, link
        Where the terms act, and how their sum becomes the change.
    near
        The fit about which predictions are linearised.
    slope
        Derivative of the predictions with respect to the sum of the terms, shape (values,).
    tangent
        Errors of that fit, from which the gain of each term follows.
    """

    place: Place
    link: Link
    near: Fit
    slope: Array
    tangent: Tangent


@dataclass(frozen=True)
class Effort:
    """Numbers of laws that the steps of a search fit (`LawSearch.run`).

    Attributes
    ----------
    first
        Laws that are fitted first: those with the best score expected from predictions linearised about the
        model without a law, and the best at each place.
    again
        One number for each further round, in which all terms are ranked again: by predictions linearised
        about the fits of so many of the best laws, one for each place and set of drivers.
    forms
        Laws that are fitted for each of these fits and each link (`LearntLaw.link`).
    seconds
        The best laws of one term, which are fitted again with a second term of the same driver.
    anew
        The best laws that are refitted after the last round, with the scatter then estimated; the others only
        get a new score.
    """

    first: int
    again: tuple[int, ...]
    forms: int
    seconds: int
    anew: int


WHOLE, FOLD = Effort(24, (8, 4), 5, 10, 12), Effort(12, (4, 1), 4, 4, 6)


def first_of_each(items: Iterable[T], key: Callable[[T], Hashable]) -> Iterator[T]:
    """Yield the first item of each kind, in order.

    Parameters
    ----------
    items
        Items of several kinds.
    key
        Returns the kind of an item.
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
    """Search for one law that a model lacks at one set of points.

    Parameters
    ----------
    fitter
        Fitter of the points.
    base
        Fit of the model without the law to these points.
    grid
        All terms of the grammar, evaluated at these points.
    """

    def __init__(self, fitter: Fitter, base: Fit, grid: TermGrid) -> None:
        self.fitter, self.base, self.grid = fitter, base, grid
        self.observed = fitter.points.value
        self.yardstick = Yardstick(fitter, base)
        self._row = fitter.points.row
        self._scatter = without_lack_of_fit(base.scatter)
        self._known: dict[Hashable, LawCandidate] = {}

    def run(self, effort: Effort) -> Found:
        """Rank and fit laws, linearise again about the best, try second terms; return the tied laws."""
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
        """Derivative of the predictions with respect to ln of the place's factor, or to what is added there.

        Shape (values,), in the unit of each value per unit of the place's strength.

        Parameters
        ----------
        fit
            The fit about which it is taken.
        place
            The place in the model where the factor or shift acts.
        """
        step = 1.0 if place.stage == "R" else 1e-4  # what is added in newtons is linear
        probe = part_for(LearntLaw(place, "exponential", (CONSTANT,)), {"a1": 0.0}, [1.0])
        vector = replace(fit.vector, parts=(*fit.vector.parts, replace(probe, id="probe")))
        thetas = np.vstack([np.append(fit.theta, 0.0), np.append(fit.theta, step)])
        without, moved = self.fitter.predictor.many(vector, thetas)
        return np.asarray((moved - without) / step)

    @cached_property
    def base_slopes(self) -> Mapping[str, Array]:
        """`slope` of the fit without a law, by name of the place."""
        return {p.name: self.slope(self.base, p) for p in self.grid.places}

    def values(self, terms: Index) -> Array:
        """Values at each fitted point of the terms with these indices, shape (points, terms)."""
        return np.asarray(self.grid.values[np.ix_(self.yardstick.rows, terms)])

    def _ranked(self, site: Site, terms: Index) -> Iterator[LawProposal]:
        """Yield a law for each of these terms at the site, the best expected score first."""
        gains, strength = site.tangent.gains(site.slope, self.values(terms))
        cost = self.grid.cost[terms] + (np.log(len(self.grid.places)) + site.place.nats)
        expected = site.tangent.nats[0] - gains[:, 0] + cost
        for i in np.argsort(expected, kind="stable"):
            term = self.grid.terms[terms[i]]
            numbers = {"a1": float(strength[i, 0])} | ({"c1": term.constant} if term.free else {})
            law = LearntLaw(site.place, site.link, (term,))
            yield LawProposal(law, numbers, float(cost[i]), float(expected[i]), site.near)

    def _from_base(self, count: int) -> list[LawProposal]:
        """The laws with the best expected scores about the base: one for each place and set of drivers.

        count: number of laws; the best law of each place is added to them.
        """
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
        """Linearise about a candidate's fit.

        kept: whether its law stays in the model and another is added; else the law is taken out of the errors
        and another is to explain what it explains.
        """
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
        """Yield the candidate's law with one more term of its driver, the best expected score first."""
        law, own = candidate.law, self._of_driver(candidate.law)
        others = own[[self.grid.terms[i].kind != law.terms[0].kind for i in own]]
        ranked = self._ranked(self._site(candidate, law.link, kept=True), others)
        return (self._joined(candidate, p, own) for p in ranked)

    def _two_sided(self, candidate: LawCandidate) -> list[LawProposal]:
        """Laws of two terms of the candidate's driver, one for each side of zero, in every pair of shapes.

        Driving and braking are different mechanisms: the right shape of one side need not be among the best
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
        """Indices of the terms that can be added to a law of one driver."""
        drivers = law.terms[0].drivers
        own = [i for i, t in enumerate(self.grid.terms) if t.drivers == drivers and not t.alone]
        return np.array(own, dtype=np.intp)

    def _joined(
        self, first: LawCandidate | LawProposal, second: LawProposal, own: Index
    ) -> LawProposal:
        """The first law with the term of the second added. own: indices of the terms that could be added."""
        (term,) = second.law.terms
        kinds = len({self.grid.terms[i].kind for i in own})
        half = 0.5 * float(np.log(self.yardstick.count))
        cost = first.cost + (float(np.log(kinds)) + half * term.numbers)
        law = replace(first.law, terms=(*first.law.terms, term))
        numbers = {**first.numbers, **{f"{n[0]}2": v for n, v in second.numbers.items()}}
        return LawProposal(law, numbers, cost, second.expected - second.cost + cost, second.near)

    # --- Fits in the model

    def _fit(self, proposals: Iterable[LawProposal], count: int) -> None:
        """Fit the first `count` of these laws in the model, and keep the best fit of each `LearntLaw.key`.

        Proposals come with the best expected score first: it stops at one that is over `_WINDOW` nats worse
        than the best fit.
        """
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
        """Estimate the scatter with the best law in the model, and score all laws by it.

        anew: number of laws that are fitted again.
        """
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
        """Try the best laws with a second term of their driver; keep those that score better by `TIE` nats.

        A term of another driver would be another law, which is learnt when the first is in the model.
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
        """The term at each measured value, shape (values,)."""
        return term.at(self.fitter.points.conditions, self.grid.sinkage)[self._row]

    def _size(self, place: Place, term: Term) -> float:
        """Strength at which a term changes predictions by about the size of the measured values."""
        moved = np.abs(self.base_slopes[place.name] * self._at_values(term) / self.observed)
        usual = float(np.sqrt(np.mean(moved[moved > 0.0] ** 2))) if moved.any() else 1.0
        return 1.0 / max(usual, 1e-12)
