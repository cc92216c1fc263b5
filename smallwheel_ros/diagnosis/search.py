# SPDX-License-Identifier: Apache-2.0
"""The posterior over which effects are missing: models of up to four competitors, by their evidence.

    P(S) proportional to Z(S) * product over S of (prior odds)

Models are found by linearised evidence (`screen`), refitted, and extended while they lie within
`WINDOW` of the best.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.competitors import Competitor, Field, changed
from smallwheel_ros.diagnosis.screen import Column, Screen, columns_of
from smallwheel_ros.fitting.constants import (
    EXPECTED_EFFECTS,
    FIRST_REFITS,
    MOST_EFFECTS,
    PARENTS,
    REFITS,
    REPLICATES,
    TESTABLE,
    WINDOW,
)
from smallwheel_ros.fitting.fit import FAILURES, Fit, Fitter

Array = NDArray[np.float64]
Key = tuple[tuple[str, str], ...]

_FORMS = 2  # of a family, refitted among the extensions of one model
# Of anything missing over nothing: a Poisson number of effects, of which so many are expected.
_PRIOR_ODDS = float(np.expm1(EXPECTED_EFFECTS))
_REST = 4.0  # nats: a larger model that is so far behind the best is not extended further


@dataclass(frozen=True)
class CandidateFit:
    """A fitted model with some competitors. weight: ln of evidence times prior odds."""

    competitors: tuple[Competitor, ...]
    fit: Fit
    weight: float

    @property
    def key(self) -> Key:
        """What tells the model from others."""
        return tuple(sorted(c.key for c in self.competitors))

    def key_with(self, put_in: Competitor | None, out: Competitor | None = None) -> Key:
        """The key of the model with one competitor more, or less, or another in its place."""
        kept = [c.key for c in self.competitors if out is None or c.key != out.key]
        return tuple(sorted([*kept, *([] if put_in is None else [put_in.key])]))

    @property
    def families(self) -> frozenset[str]:
        """Families of its competitors."""
        return frozenset(c.family for c in self.competitors)


def refit(
    fitter: Fitter,
    model: CandidateFit,
    put_in: Competitor | None = None,
    start: Array | None = None,
    out: Competitor | None = None,
    turns: int = 4,
) -> CandidateFit | None:
    """A model fitted from where it was, with one competitor more, or less, or another in its place.

    start: of the new competitor's numbers. None where it cannot be fitted.
    """
    near, vector = model.fit, model.fit.vector
    competitors = [c for c in model.competitors if out is None or c.key != out.key]
    if out is not None:
        vector = vector.with_parts([part for part in vector.parts if part.id != out.part.id])
    if put_in is not None:
        competitors.append(put_in)
        vector = changed(vector, put_in)
    theta = vector.begun_at(near.vector, near.theta)
    if put_in is not None:
        theta[vector.places(put_in.part.id)] = put_in.part.start if start is None else start
    # A missing effect inflates the scatter, under which no effect is needed: start without.
    usual, scatter = fitter.variance.start.log_deviation, fitter.variance.suited(near.scatter)
    scatter = replace(scatter, log_deviation=np.minimum(scatter.log_deviation, usual))
    try:
        fit = fitter.fit(vector, theta, scatter, turns=turns)
    except FAILURES:
        return None
    odds = sum(float(np.log(c.share)) for c in competitors)
    return CandidateFit(tuple(competitors), fit, fit.evidence + odds)


@dataclass
class Search:
    """Every model that was refitted, and the test of whether anything is missing.

    field: who competed; what the design cannot show was taken out. p_drawn: chance of so large a mass of
    missing effects if none is, by simulation. p_values: by family, against the largest of all families.
    screen: at the base.
    """

    fitter: Fitter
    field: Field
    screen: Screen
    models: dict[Key, CandidateFit]
    p_drawn: float
    p_values: dict[str, float]

    @cached_property
    def ordered(self) -> list[CandidateFit]:
        """Models, the most probable first."""
        return sorted(self.models.values(), key=lambda m: -m.weight)

    @property
    def none(self) -> CandidateFit:
        """The base model."""
        return self.models[()]

    def all_alone(self, family: str, within: float = np.inf) -> list[CandidateFit]:
        """The family alone in its forms that were refitted, the best first, within some nats of it."""
        found = [m for m in self.ordered if m.families == {family} and len(m.competitors) == 1]
        return [m for m in found if m.weight > found[0].weight - within]

    def alone(self, family: str) -> CandidateFit | None:
        """The family alone, in its best form; None where it was not refitted."""
        return next(iter(self.all_alone(family)), None)

    @cached_property
    def probabilities(self) -> dict[Key, float]:
        """Posterior probability of each model."""
        weights = np.array([m.weight for m in self.models.values()])
        shares = np.exp(weights - weights.max())
        return dict(zip(self.models, (shares / shares.sum()).tolist(), strict=True))

    @property
    def p(self) -> float:
        """Chance of such data if nothing were missing: the smaller of two bounds.

        `p_drawn` holds for the scatter that the base model needs, however unusual. Where scatter is as
        soils and rigs have it (its prior), data with odds of something missing over none, posterior over
        prior, of B come up with probability 1 / B at most (Markov's inequality for the likelihood
        ratio: Good 1950). What is left of the two is how much unusual scatter one believes.
        """
        none = self.probabilities[()]
        bound = _PRIOR_ODDS * none / max(1.0 - none, 1e-12)
        return max(min(self.p_drawn, bound), 1.0 / (1.0 + REPLICATES))

    def add(self, model: CandidateFit | None) -> None:
        """Keep a further model."""
        if model is not None and np.isfinite(model.weight):
            self.models[model.key] = model
            self.__dict__.pop("ordered", None)
            self.__dict__.pop("probabilities", None)


def search(
    fitter: Fitter, base: Fit, field: Field, *, seed: int = 0, most: int = MOST_EFFECTS
) -> Search:
    """Search the models that explain the data. most: effects of the largest; with 0 only p is found."""
    screen = Screen(fitter, base, columns_of(fitter, base, field.competitors))
    field, screen = _testable(screen, field)
    none = CandidateFit((), base, base.evidence)
    found = Search(fitter, field, screen, {(): none}, *_tested(screen, seed))
    for size in range(1, most + 1 if screen.columns else 0):
        if not _extend(found, size):
            break
    return found


def _tested(screen: Screen, seed: int) -> tuple[float, dict[str, float]]:
    """p of "is anything missing", and of each family against the largest of all, by simulation."""
    if not screen.columns:
        return 1.0, {}
    errors = (screen.fitter.points.value - screen.fit.predicted)[:, None]
    drawn = np.hstack([errors, screen.draws(REPLICATES, seed)])
    families = screen.by_family(drawn)
    masses = np.array(list(families.values()))
    missing = np.logaddexp.reduce(masses)
    largest = np.max(masses[:, 1:], axis=0)

    def p_value(null: Array, seen: float) -> float:
        return float((1 + np.sum(null >= seen)) / (1 + REPLICATES))

    of_family = {name: p_value(largest, float(mass[0])) for name, mass in families.items()}
    return p_value(missing[1:], float(missing[0])), of_family


def _testable(screen: Screen, field: Field) -> tuple[Field, Screen]:
    """Without the families that no data of this design could show."""
    power: dict[str, float] = {}
    for column, size in zip(screen.columns, screen.testability(), strict=True):
        family = column.competitor.family
        power[family] = max(power.get(family, 0.0), size)
    blind = {
        c.family: "its law gives no finite prediction on this data, or fails"
        for c in field.competitors
        if c.family not in power
    }
    blind |= {
        family: "the base model imitates it: with these settings no strength that is likely would show"
        for family, size in power.items()
        if size < TESTABLE
    }
    seen = [c for c in field.competitors if c.family not in blind]
    field = field.only(_different(screen.columns, seen), blind)
    kept = {c.key: c for c in field.competitors}
    columns = [
        replace(c, competitor=kept[c.competitor.key])
        for c in screen.columns
        if c.competitor.key in kept
    ]
    return field, Screen(screen.fitter, screen.fit, columns)


def _different(columns: list[Column], competitors: list[Competitor]) -> list[Competitor]:
    """Without forms that do the same as an earlier one of their family on this data."""
    shifts: dict[tuple[str, str], list[Array]] = {}
    for column in columns:
        shifts.setdefault(column.competitor.key, []).append(column.shift)
    kept: list[Competitor] = []
    for c in competitors:
        mine = shifts.get(c.key, [])
        twin = any(
            len(other) == len(mine) and all(np.allclose(a, b) for a, b in zip(mine, other, strict=True))
            for k in kept if k.family == c.family and (other := shifts.get(k.key))
        )  # fmt: skip
        if mine and not twin:
            kept.append(c)
    return kept


def _extend(found: Search, size: int) -> bool:
    """Refit the most promising extensions of the best models of the size before."""
    parents = [m for m in found.ordered if len(m.competitors) == size - 1]
    parents = [m for m in parents if m.weight > parents[0].weight - WINDOW][:PARENTS]
    best = found.ordered[0].weight
    reached = -np.inf
    for parent in parents:
        here = found.screen if size == 1 else _screen_at(found, parent)
        none, each = here.evidence((found.fitter.points.value - parent.fit.predicted)[:, None])
        gain = each[:, 0] - none[0] + np.log([c.competitor.share for c in here.columns])
        most, forms = (FIRST_REFITS, _FORMS + 1) if size == 1 else (REFITS, _FORMS)
        for column in _promising(here.columns, gain, most, forms):
            if parent.key_with(column.competitor) in found.models:
                continue
            made = refit(found.fitter, parent, column.competitor, column.start)
            found.add(made)
            if made is not None:
                reached = max(reached, made.weight)
    return bool(reached > best - _REST)


def _promising(columns: list[Column], gain: Array, most: int, forms: int) -> list[Column]:
    chosen: dict[tuple[str, str], Column] = {}
    for i in np.argsort(-gain):
        column = columns[int(i)]
        key = column.competitor.key
        if key in chosen or sum(k[0] == key[0] for k in chosen) >= forms:
            continue
        chosen[key] = column
        if len(chosen) >= most:
            break
    return list(chosen.values())


def _screen_at(found: Search, parent: CandidateFit) -> Screen:
    """The columns of the other families at a larger model: as the same shares of its predictions."""
    base = found.none.fit.predicted
    ratio = parent.fit.predicted / np.where(np.abs(base) > 1e-12, base, np.inf)
    points = found.fitter.points
    for name in points.forces:
        ratio = np.where(points.of_channel(name), 1.0, ratio)
    ratio = np.where(np.isfinite(ratio) & (ratio > 0), ratio, 1.0)
    others = [c for c in found.screen.columns if c.competitor.family not in parent.families]
    shifted = [replace(c, shift=c.shift * ratio[:, None]) for c in others]
    return Screen(found.fitter, parent.fit, shifted)


def exchanged(
    found: Search, model: CandidateFit, out: Competitor | None, put_in: Competitor | None
) -> CandidateFit | None:
    """The model with one competitor in the place of another; None stands for none. It is kept."""
    key = model.key_with(put_in, out)
    if key not in found.models:
        if any(c is not None and c.geometry is not None for c in (out, put_in)):
            return None
        found.add(refit(found.fitter, model, put_in, out=out))
    return found.models.get(key)
