"""The search for one law: tangent, refits in the model, description length.

The score of a law is n/2 ln det S of its errors plus the nats that it takes to describe it: ln of
the number of forms and of places, 1/2 ln n for each of its numbers (Rissanen 1978). Laws within
`TIE` of the best are tied; of these the draft has the fewest drivers, then the shortest description.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.candidate import FAILURES
from smallwheel_ros.fitting.constants import TIE
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.parameters import ParameterVector
from smallwheel_ros.learn.grammar import Term
from smallwheel_ros.learn.law import SOUGHT, Law, Link, Place, part_for
from smallwheel_ros.learn.tangent import Tangent, Yardstick, without_lack_of_fit

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_CONSTANT = Term(())
_WINDOW = 4.0 * TIE  # nats: what a tangent says is further behind is not refitted
_STRONG = 3.0  # ln factor: a tangent's strength beyond it is not believed as a start


@dataclass(frozen=True)
class Effort:
    """How many laws are refitted.

    first: from the base's tangent. again, forms: places searched on in each round, and forms of each
    that are refitted. pairs: laws that get a second term. anew: laws that are fitted anew when the
    scatter is; the others are only judged anew.
    """

    first: int
    again: tuple[int, ...]
    forms: int
    pairs: int
    anew: int


WHOLE, FOLD = Effort(24, (8, 4), 5, 4, 12), Effort(12, (4, 1), 4, 2, 6)


@dataclass(frozen=True)
class Grid:
    """Every term, with its values at each point.

    sinkage: of the base model, m, shape (points,). values: shape (points, terms).
    """

    terms: tuple[Term, ...]
    places: tuple[Place, ...]
    sinkage: Array
    values: Array

    @cached_property
    def cost(self) -> Array:
        """Nats of each term, shape (terms,)."""
        return np.array([t.cost for t in self.terms])

    @cached_property
    def _before_depth(self) -> Index:
        return np.flatnonzero([bool(t.factors) and not t.of_depth for t in self.terms])

    def allowed(self, place: Place) -> Index:
        """The terms that make sense at a place: a constant, and what follows the depth, at R only."""
        return np.arange(len(self.terms)) if place.stage == "R" else self._before_depth

    def place_cost(self, place: Place) -> float:
        """Nats that it takes to say where."""
        return float(np.log(len(self.places))) + place.nats


@dataclass(frozen=True)
class Candidate:
    """A fitted law. cost: nats of its description. score: these and those of its errors."""

    law: Law
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
    """The base and the laws, the best first. base_score: of the base by the same yardstick."""

    base: Fit
    base_score: float
    laws: tuple[Candidate, ...]

    @property
    def gain(self) -> float:
        """Nats by which the best law shortens the description."""
        return self.base_score - self.laws[0].score if self.laws else 0.0

    @property
    def tied(self) -> tuple[Candidate, ...]:
        """Laws that do as well as the best."""
        return tuple(c for c in self.laws if c.score < self.laws[0].score + TIE)

    @property
    def draft(self) -> Candidate | None:
        """Of the tied laws one of fewest drivers, of these the shortest."""
        if not self.laws:
            return None
        return min(self.tied, key=lambda c: (c.law.weight, round(c.cost, 6), c.score))


class Search:
    """Searches one set of points. base: the model without the law, fitted to them."""

    def __init__(self, fitter: Fitter, base: Fit, grid: Grid) -> None:
        self.fitter, self.base, self.grid = fitter, base, grid
        self.row = fitter.points.row
        self.yardstick = Yardstick(fitter, base)
        self.scatter = without_lack_of_fit(base.scatter)
        self.known: dict[tuple[object, ...], Candidate] = {}

    @property
    def observed(self) -> Array:
        """What was measured, shape (values,)."""
        return self.fitter.points.value

    def slope(self, fit: Fit, place: Place) -> Array:
        """Slope of the predictions by the place's ln factor or shift, shape (values,)."""
        step = 1.0 if place.stage == "R" else 1e-4  # resistance is linear in it
        probe = part_for(Law(place, "exponential", (_CONSTANT,)), {"a1": 0.0}, [1.0])
        vector = fit.vector.with_parts([*fit.vector.parts, replace(probe, id="probe")])
        thetas = np.vstack([np.append(fit.theta, 0.0), np.append(fit.theta, step)])
        without, moved = self.fitter.predictor.many(vector, thetas)
        return np.asarray((moved - without) / step)

    def columns(self, slope: Array, terms: Index) -> Array:
        """What a unit of each term moves the values by, shape (values, terms)."""
        return np.asarray(slope[:, None] * self.grid.values[np.ix_(self.row, terms)])

    def run(self, effort: Effort) -> Found:
        """Search, refit, search again about the best, and try a second term."""
        self._from_base(effort)
        for places in effort.again:
            if not self.known:
                break
            self._remeasure(effort.anew)
            for candidate in self._best_of_each(places):
                self._about(candidate, effort.forms)
        if self.known:
            self._remeasure(effort.anew)
            self._two_terms(effort.pairs)
        laws = sorted(self.known.values(), key=lambda c: c.score)
        base = self.fitter.fit(self.base.vector, self.base.theta, self.scatter, turns=0)
        return Found(base, self.yardstick.score(self.observed - base.predicted), tuple(laws))

    def _from_base(self, effort: Effort) -> None:
        """The best terms of each place and set of drivers at the tangent of the base."""
        white = self.yardstick.white(self.observed - self.base.predicted)
        tangent = Tangent(self.yardstick, white, self.base.slopes)
        pool: list[tuple[float, Place, int, float]] = []
        for place in self.grid.places:
            terms = self.grid.allowed(place)
            gains, strength = tangent.gains(self.columns(self.base_slopes[place.name], terms))
            worth = gains[:, 0] - self.grid.cost[terms] - self.grid.place_cost(place)
            seen: set[frozenset[str]] = set()
            for j in np.argsort(-worth, kind="stable")[:250]:
                term = self.grid.terms[terms[j]]
                if term.drivers not in seen:
                    seen.add(term.drivers)
                    pool.append((worth[j], place, int(terms[j]), strength[j, 0]))
        pool.sort(key=lambda entry: -entry[0])
        chosen = pool[: effort.first]
        for place in self.grid.places:  # each has its chance: a tangent may mislead
            mine = [entry for entry in pool if entry[1] is place]
            chosen += [entry for entry in mine[:1] if entry not in chosen]
        for _, place, j, strength_of in chosen:
            self._consider(place, "exponential", (j,), [strength_of], self.base)

    def _consider(
        self,
        place: Place,
        link: Link,
        chosen: tuple[int, ...],
        strengths: Sequence[float],
        near: Fit,
        cost: float | None = None,
    ) -> None:
        """Fit a law in the model and keep it where it is the best of its kind.

        chosen: its terms. strengths: where they start. cost: of the terms, the first one's where None.
        """
        law = Law(place, link, tuple(self.grid.terms[j] for j in chosen))
        sizes = [self._size(place, j) for j in chosen]
        limit = _STRONG if place.stage != "R" else np.inf
        numbers = {f"a{i}": float(np.clip(a, -limit * s, limit * s))
                   for i, (a, s) in enumerate(zip(strengths, sizes, strict=True), 1)}  # fmt: skip
        numbers |= {f"c{i}": t.constant for i, t in enumerate(law.terms, 1) if t.free}
        part = part_for(law, numbers, sizes)
        vector = self.base.vector.with_parts([*self.base.vector.parts, part])
        of_part = {p.name for p in part.parameters}
        known = {
            n: v for n, v in zip(near.vector.names, near.theta, strict=True) if n not in of_part
        }
        start = np.array([known.get(p.name, p.start) for p in vector.free])
        cost = float(self.grid.cost[chosen[0]]) if cost is None else cost
        self._keep(law, vector, start, cost + self.grid.place_cost(place))

    def _keep(self, law: Law, vector: ParameterVector, start: Array, cost: float) -> None:
        try:
            with np.errstate(all="ignore"):  # a law may ask for a soil that there is not
                fit = self.fitter.fit(vector, start, self.scatter, turns=0)
        except FAILURES:
            return
        score = self.yardstick.score(self.observed - fit.predicted) + cost
        if np.isfinite(score) and (law.key not in self.known or score < self.known[law.key].score):
            self.known[law.key] = Candidate(law, fit, cost, score)

    def _size(self, place: Place, j: int) -> float:
        """Strength at which a term changes the model by a factor e, or as much in newtons."""
        h = self.grid.values[self.row, j]
        if place.stage != "R":
            return 1.0 / max(float(np.sqrt(np.mean(h**2))), 1e-12)
        moved = self.base_slopes[place.name] * h
        resisting = moved != 0.0
        if not resisting.any():
            return 1.0
        usual = float(np.median(np.abs(self.observed[resisting])))
        return usual / float(np.sqrt(np.mean(moved[resisting] ** 2)))

    @cached_property
    def base_slopes(self) -> Mapping[str, Array]:
        """By place, the slope of the base's predictions by its ln factor or shift."""
        return {p.name: self.slope(self.base, p) for p in self.grid.places}

    def _remeasure(self, anew: int) -> None:
        """Estimate the scatter with the best law in the model, and judge all by that."""
        ordered = sorted(self.known.values(), key=lambda c: c.score)
        best = ordered[0].fit
        fit = self.fitter.fit(best.vector, best.theta, self.scatter, turns=2)
        self.scatter = without_lack_of_fit(fit.scatter)
        self.yardstick = Yardstick(self.fitter, fit)
        self.known = {}
        for i, old in enumerate(ordered):
            if i < anew:
                self._keep(old.law, old.fit.vector, old.fit.theta, old.cost)
            else:
                score = self.yardstick.score(self.observed - old.fit.predicted) + old.cost
                self.known[old.law.key] = replace(old, score=score)

    def _best_of_each(self, count: int) -> list[Candidate]:
        """The best laws, one of each place and set of drivers."""
        seen, found = set(), []
        for c in sorted(self.known.values(), key=lambda c: c.score):
            key = c.law.place.name, frozenset(c.law.drivers)
            if key not in seen:
                seen.add(key)
                found.append(c)
        return found[:count]

    def _without(self, candidate: Candidate, link: Link) -> tuple[Tangent, Array]:
        """The tangent at a law with the law itself taken out, and the slope by a unit of its sum."""
        fit, law = candidate.fit, candidate.law
        slope = self.slope(fit, law.place)
        eta = self._eta(candidate)
        factor = law.factor(eta)
        if law.place.shifts:
            change = eta
        elif link == "exponential":
            change = np.log(factor)
        else:
            change, slope = factor - 1.0, slope / factor
        error = self.yardstick.white(self.observed - fit.predicted + slope * change)
        base = [j for j, p in enumerate(fit.vector.free) if p.owner != SOUGHT]
        return Tangent(self.yardstick, error, fit.slopes[:, base]), slope

    def _eta(self, candidate: Candidate) -> Array:
        law, numbers = candidate.law, candidate.numbers
        conditions = self.fitter.points.conditions
        return law.eta(numbers, conditions, self.grid.sinkage)[self.row]

    def _about(self, candidate: Candidate, forms: int) -> None:
        """Search the grammar again at a law's own place and tangent, and refit the best forms."""
        place = candidate.law.place
        terms = self.grid.allowed(place)
        best = min(c.score for c in self.known.values())
        for link in place.links:
            tangent, slope = self._without(candidate, link)
            gains, strength = tangent.gains(self.columns(slope, terms))
            worth = gains[:, 0] - self.grid.cost[terms]
            seen: set[tuple[tuple[str, str], ...]] = set()
            for j in np.argsort(-worth, kind="stable"):
                term = self.grid.terms[terms[j]]
                if term.kind in seen:
                    continue
                seen.add(term.kind)
                expected = float(tangent.nats[0]) - worth[j] + self.grid.place_cost(place)
                if len(seen) > forms or expected > best + _WINDOW:
                    break
                self._consider(place, link, (int(terms[j]),), [strength[j, 0]], candidate.fit)

    def _two_terms(self, count: int) -> None:
        """Two terms of one driver at one place, kept where that is `TIE` shorter than any one.

        Another driver would be another law: that is learnt when the first is in the model.
        """
        best = min(c.score for c in self.known.values())
        ordered = sorted(self.known.values(), key=lambda c: c.score)
        one_term = dict(self.known)
        places: dict[tuple[str, tuple[str, ...]], Candidate] = {}
        for c in ordered:
            if len(c.law.terms[0].factors) == 1:
                places.setdefault((c.law.place.name, c.law.drivers), c)
        for candidate in list(places.values())[:count]:
            for link in candidate.law.place.links:
                self._second(candidate, link)
        two = {k: c for k, c in self.known.items() if k not in one_term and c.score < best - TIE}
        self.known = one_term | two

    def _second(self, candidate: Candidate, link: Link, most: int = 3) -> None:
        """Refit the best pairs of terms of a law's driver at its place."""
        law = candidate.law
        tangent, slope = self._without(candidate, link)
        mine = np.array([j for j in self.grid.allowed(law.place)
                         if self.grid.terms[j].drivers == law.terms[0].drivers
                         and len(self.grid.terms[j].factors) == 1], dtype=np.intp)  # fmt: skip
        forms = len({self.grid.terms[j].kind for j in mine})
        half = 0.5 * np.log(self.yardstick.count)
        more = np.log(forms) + half * np.array([1 + self.grid.terms[j].free for j in mine])
        gains, strength = tangent.pair_gains(self.columns(slope, mine))
        cost = self.grid.cost[mine][:, None] + more[None, :]
        worth = gains - cost
        seen: set[frozenset[tuple[tuple[str, str], ...]]] = set()
        for at in np.argsort(-worth, axis=None, kind="stable"):
            i, j = divmod(int(at), mine.size)
            pair = int(mine[i]), int(mine[j])
            kind = frozenset(self.grid.terms[t].kind for t in pair)
            if len(kind) < 2 or kind in seen:
                continue
            seen.add(kind)
            self._consider(law.place, link, pair, [strength[i, j], strength[j, i]], candidate.fit,
                           float(cost[i, j]))  # fmt: skip
            if len(seen) >= most:
                break
