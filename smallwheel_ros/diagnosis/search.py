# SPDX-License-Identifier: Apache-2.0
"""The posterior over which effects are missing: models of up to three competitors, by their evidence.

    P(S) proportional to Z(S) * product over S of (prior odds)

with S a set of competitors and Z(S) the evidence of the model that has them. Each law is refitted alone.
Larger models are found by linearised evidence, refitted, and extended while they lie within `WINDOW` of the
best.

At a fit with covariance S = V + J P^-1 J' of the errors e, a competitor with column C (change of the
predictions by its prior's deviation) has

    ln Z1 - ln Z0 = 1/2 e' S^-1 C (I + C' S^-1 C)^-1 C' S^-1 e - 1/2 ln |I + C' S^-1 C|

with no more than the usual scatter, since a missing effect inflates it. The same computation on data drawn
from the null model gives the distribution of the statistic "is anything missing" (`Screen`).
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.competitors import Competitor, Field, changed
from smallwheel_ros.fitting.constants import (
    EXPECTED_EFFECTS,
    FIRST_REFITS,
    HIDE,
    MENTIONED,
    MOST_EFFECTS,
    PARENTS,
    REFITS,
    REPLICATES,
    SPREAD,
    TESTABLE,
    WINDOW,
)
from smallwheel_ros.fitting.fit import FAILURES, Fit, Fitter

Array = NDArray[np.float64]
Key = frozenset[tuple[str, str]]  # family and form of each competitor

_NUDGE = 0.1  # of a curve's prior deviation: its columns are slopes at none
_FORMS = 2  # of a family, refitted among the extensions of one model
# Of anything missing over nothing: a Poisson number of effects, of which so many are expected.
_PRIOR_ODDS = float(np.expm1(EXPECTED_EFFECTS))
_REST = 4.0  # nats: a larger model that is so far behind the best is not extended further


@dataclass(frozen=True)
class ScoreColumn:
    """Change of the predictions by one competitor: C of the score test (formula: module's docstring).

    Attributes
    ----------
    competitor
        Effect, instrument fault or curve that the model may lack.
    shift
        Change of each prediction, m, N or N m, shape (values, columns): one column for an effect, one for
        each coefficient of a curve. It is scaled to a parameter that is one standard deviation of its prior
        away from having no influence, or as far as the prior's centre if that is farther; a contact rule has
        no parameter, and its change is not scaled.
    start
        Values of the competitor's parameters at which `shift` was computed, and from which its fit starts,
        shape (its parameters,); 0 for a curve.
    """

    competitor: Competitor
    shift: Array
    start: Array


def columns_of(fitter: Fitter, fit: Fit, competitor: Competitor) -> list[ScoreColumn]:
    """Compute how a competitor would change the predictions of a fit, by finite differences.

    Parameters
    ----------
    fitter
        Holds the measured points and their noise.
    fit
        The fit that is tested.
    competitor
        Effect, instrument fault or curve that the model may lack.

    Returns
    -------
    list of ScoreColumn
        For an effect, one for each of up to two values of its main parameter, since its influence need not be
        linear; for a curve or a contact rule, one. Those with values that are not finite are left out.
    """
    listed, start = competitor.part.parameters, competitor.part.start
    vector, effect = changed(fit.vector, competitor), competitor.effect
    # A rule of contact has no numbers.
    starts: Array = start[None, :]
    scale: Array = np.ones(1)
    if effect is None:  # a curve
        starts = np.diag([_NUDGE * p.prior.deviation for p in listed])
        scale = np.full(len(listed), 1.0 / _NUDGE)
    elif competitor.geometry is None:
        known = effect.parameters()  # the first at whose neutral value it is absent
        main = next((i for i, p in enumerate(known) if p.neutral is not None), 0)
        prior = listed[main].prior
        absent = start[main] if competitor.replaces else 0.0
        if prior.low < 0.0 or competitor.replaces:
            sizes = (absent - 0.5 * prior.deviation, absent + 0.5 * prior.deviation)
        else:
            usual = prior.centre if prior.centre > 0.0 else prior.deviation
            sizes = (0.25 * usual, usual)
        starts = np.tile(start, (len(sizes), 1))
        starts[:, main] = np.clip(sizes, prior.low, prior.high)
        starts = starts[np.abs(starts[:, main] - absent) > 1e-12]
        scale = max(prior.deviation, abs(prior.centre - absent)) / (starts[:, main] - absent)
    base = np.delete(vector.begun_at(fit.vector, fit.theta), vector.places(competitor.part.id))
    thetas = np.hstack([np.tile(base, (len(starts), 1)), starts])
    try:
        moved = fitter.predictor.many(vector, thetas) - fit.predicted
    except FAILURES:
        return []
    shifts = (moved * scale[:, None]).T
    if effect is None:
        found = [ScoreColumn(competitor, shifts, np.zeros(len(listed)))]
    else:
        found = [ScoreColumn(competitor, shifts[:, [i]], at) for i, at in enumerate(starts)]
    return [column for column in found if np.isfinite(column.shift).all()]


class Screen:
    """Score test at one fit: evidence for each candidate from predictions linearised there, without a refit.

    Standard deviations of the scatter are those of the fit, but at most their prior medians: a missing
    effect inflates the scatter that is fitted, which would then hide that effect and others.

    Parameters
    ----------
    fitter
        Holds the measured points and their noise.
    fit
        The fit that is tested.
    columns
        Change of the predictions by each candidate, as `columns_of` returns it.
    """

    def __init__(self, fitter: Fitter, fit: Fit, columns: Sequence[ScoreColumn]) -> None:
        self.fitter, self.fit, self.columns = fitter, fit, list(columns)
        model = fitter.variance
        self._kernels = model.kernels(fit.stiffness, fit.scatter.log_length)
        usual = np.minimum(fit.scatter.log_deviation, model.log_median)
        self._s = model.total(usual, self._kernels, fit.taken_up)
        stacked = np.hstack([np.zeros((len(fitter.points), 0)), *(c.shift for c in columns)])
        self._white = self._s.whiten(stacked)
        ends = np.cumsum([0] + [c.shift.shape[1] for c in columns])
        self._places = [np.arange(a, b) for a, b in itertools.pairwise(ends)]

    def testability(self) -> list[float]:
        """Squared change of the predictions by each entry of `columns`, in variances (dimensionless).

        For an entry with several columns, the largest.
        """
        size = np.sum(self._white**2, axis=0)
        return [float(size[place].max()) for place in self._places]

    def cosines(self) -> tuple[list[str], Array]:
        """Return how alike families act on this data once the base is refitted.

        Returns
        -------
        families, cosines : list of str, ndarray
            Families whose best column is a single one, and absolute cosines between their changes of the
            predictions, shape (families, families), 0 to 1.
        """
        best: dict[str, tuple[float, int]] = {}
        for i, (column, size) in enumerate(zip(self.columns, self.testability(), strict=True)):
            family = column.competitor.family
            if family not in best or size > best[family][0]:
                best[family] = size, i
        chosen = {f: self._places[i][0] for f, (_, i) in best.items() if self._places[i].size == 1}
        white = self._white[:, np.array([*chosen.values()], dtype=np.intp)]
        unit = white / np.maximum(np.linalg.norm(white, axis=0), 1e-150)
        return list(chosen), np.abs(unit.T @ unit)

    def gains(self, errors: Array) -> Array:
        """Return ln evidence of each entry of `columns` over none, nats, shape (entries, data sets).

        `errors` are measured minus predicted values of each data set, shape (values, data sets).
        """
        w, found = self._s.whiten(errors), []
        for place in self._places:
            size, turned = np.linalg.eigh(self._white[:, place].T @ self._white[:, place])
            pulled = (self._white[:, place] @ turned).T @ w
            each = pulled**2 / (1.0 + size)[:, None] - np.log1p(size)[:, None]
            found.append(0.5 * each.sum(axis=0))
        return np.array(found).reshape(len(self._places), w.shape[1])

    def tested(self, seed: int) -> tuple[float, dict[str, float]]:
        """Simulate p-values: that nothing is missing, and of each family against the largest of all.

        The statistic of a family is its evidence over that of no effect, averaged over its forms and
        columns.

        Parameters
        ----------
        seed
            Seed of the data sets drawn from the fit.

        Returns
        -------
        p, p_values : float, dict
            p-value of all families together, and by family; (1, empty) if there are no columns.
        """
        if not self.columns:
            return 1.0, {}
        points, model = self.fitter.points, self.fitter.variance
        capped = np.minimum(self.fit.scatter.log_deviation, model.log_median + HIDE * SPREAD)
        noise = np.random.default_rng(seed).normal(size=(len(points), REPLICATES))
        drawn = model.total(capped, self._kernels).root @ noise
        gains = self.gains(np.column_stack([points.value - self.fit.predicted, drawn]))
        count = Counter(column.competitor.key for column in self.columns)
        families: dict[str, Array] = {}
        for column, gain in zip(self.columns, gains, strict=True):
            c = column.competitor
            mass = gain + np.log(c.share / count[c.key])
            families[c.family] = np.logaddexp(families.get(c.family, -np.inf), mass)
        masses = np.array(list(families.values()))
        missing, largest = np.logaddexp.reduce(masses), np.max(masses[:, 1:], axis=0)
        as_bad = np.sum(largest >= masses[:, :1], axis=1), np.sum(missing[1:] >= missing[0])
        of_each, p = ((1 + n) / (1 + REPLICATES) for n in as_bad)
        return float(p), dict(zip(families, of_each.tolist(), strict=True))


@dataclass(frozen=True)
class Candidate(Fit):
    """A fitted model with some competitors in it.

    Attributes
    ----------
    competitors
        The competitors that it has.
    weight
        ln of evidence times prior odds, nats.
    """

    competitors: tuple[Competitor, ...] = ()
    weight: float = -np.inf

    @classmethod
    def of(cls, fit: Fit, competitors: Sequence[Competitor] = ()) -> Candidate:
        """Make a candidate from a fit and the competitors that it contains.

        Parameters
        ----------
        fit
            The fit, with its evidence.
        competitors
            Competitors that its model contains.
        """
        odds = sum(float(np.log(c.share)) for c in competitors)
        known = {name: getattr(fit, name) for name in Fit.__dataclass_fields__}
        return cls(**known, competitors=tuple(competitors), weight=fit.evidence + odds)

    @cached_property
    def key(self) -> Key:
        """Keys of its competitors, which identify the model among all others."""
        return frozenset(c.key for c in self.competitors)

    @cached_property
    def families(self) -> frozenset[str]:
        """Families of its competitors."""
        return frozenset(c.family for c in self.competitors)


def refit(
    fitter: Fitter,
    near: Candidate,
    put_in: Competitor | None = None,
    start: Array | None = None,
    out: Competitor | None = None,
    turns: int = 4,
) -> Candidate | None:
    """Fit a model starting from another one, with a competitor added, removed, or exchanged.

    Parameters
    ----------
    fitter
        Holds the measured points and their noise.
    near
        The model to start from.
    put_in
        Competitor to add; none if not given.
    start
        Parameters of `put_in` to start from, shape (its parameters,); its own start if not given.
    out
        Competitor to remove; none if not given.
    turns
        Largest number of times that parameters and variance components are fitted in turn.

    Returns
    -------
    Candidate or None
        None where it cannot be fitted.
    """
    vector, competitors = near.vector, near.competitors
    if out is not None:
        parts = tuple(part for part in vector.parts if part.id != out.part.id)
        vector = replace(vector, parts=parts)
        competitors = tuple(c for c in competitors if c.key != out.key)
    if put_in is not None:
        vector, competitors = changed(vector, put_in), (*competitors, put_in)
    theta = vector.begun_at(near.vector, near.theta)
    if put_in is not None:
        theta[vector.places(put_in.part.id)] = put_in.part.start if start is None else start
    # A missing effect inflates the scatter, under which no effect is needed: start without.
    usual, scatter = fitter.variance.start.log_deviation, fitter.variance.suited(near.scatter)
    scatter = replace(scatter, log_deviation=np.minimum(scatter.log_deviation, usual))
    try:
        at = near if vector is near.vector else fitter.at(vector, theta)
        fit = fitter.fit(replace(at, scatter=scatter), turns=turns)
    except FAILURES:
        return None
    return Candidate.of(fit, competitors)


@dataclass
class Search:
    """Every model that was fitted, and the test of whether anything is missing.

    Attributes
    ----------
    fitter
        Holds the measured points and their noise.
    field
        The competitors, without those that the design cannot show.
    screen
        Linearised evidence at the base model.
    p_drawn
        Simulated probability of as much evidence for a missing effect if none is missing.
    p_values
        p-value of each family, against the largest statistic of all families.
    models
        The fitted models by their `Candidate.key`.
    """

    fitter: Fitter
    field: Field
    screen: Screen
    p_drawn: float
    p_values: dict[str, float]
    models: dict[Key, Candidate]

    @property
    def ordered(self) -> list[Candidate]:
        """All fitted models, the most probable first."""
        return sorted(self.models.values(), key=lambda m: -m.weight)

    @property
    def none(self) -> Candidate:
        """The base model."""
        return self.models[frozenset()]

    def mixture(
        self, named: Collection[str], rivals: Collection[str], tied: Collection[str] = ()
    ) -> list[tuple[float, Candidate]]:
        """Return the models among which the data cannot decide, with their probabilities, for predictions.

        These are the fitted models that contain all named effects, and no curves. Those with a probability
        under `MENTIONED` are left out, except the most probable one with each rival.

        Parameters
        ----------
        named
            Families that are named as missing.
        rivals
            Families of which one is missing, where the data cannot tell which.
        tied
            Settings that were varied together. For each soil effect whose first driver is one of them (other
            than load), models with and without it are given equal prior odds here: the data cannot decide,
            and predictions differ where these settings vary apart. If nothing is named, models with these
            effects are fitted first, and added to `models`.

        Returns
        -------
        list of (float, Candidate)
            Probability and model; the probabilities sum to 1. Empty if no model has all named effects.
        """
        even = {c.family for c in self.field.competitors
                if c.kind == "soil" and {*tied} & {*c.drivers[:1]} - {"load"}}  # fmt: skip
        wanted = {*named} & {c.family for m in self.models.values() for c in m.competitors}
        for c in self.field.competitors if tied and not wanted else ():
            if c.family in even:
                self.made(self.none, c)
        models = [m for m in self.ordered if wanted <= m.families
                  and all(c.kind != "unknown" for c in m.competitors)]  # fmt: skip
        if not models:
            return []
        forms = Counter(c.family for c in self.field.competitors)
        odds = [sum(-np.log(c.share * forms[c.family]) for c in m.competitors if c.family in even)
                for m in models]  # fmt: skip
        weights = np.array([m.weight for m in models]) + odds
        shares = np.exp(weights - weights.max())
        shares /= shares.sum()
        best = {next((m.key for m in models if name in m.families), None) for name in rivals}
        kept = [(float(p), m) for p, m in zip(shares, models, strict=True)
                if p >= MENTIONED or m.key in best]  # fmt: skip
        total = sum(p for p, _ in kept)
        return [(p / total, m) for p, m in kept]

    def all_alone(self, family: str, within: float = np.inf) -> list[Candidate]:
        """Return the fitted models with one family alone, in its different forms, the best first.

        Parameters
        ----------
        family
            Id of the effect, which all its forms share.
        within
            Largest distance from the best of them in ln evidence times prior odds, nats.
        """
        found = [m for m in self.ordered if m.families == {family} and len(m.competitors) == 1]
        return [m for m in found if m.weight > found[0].weight - within]

    @property
    def probabilities(self) -> dict[Key, float]:
        """Posterior probability of each model, by its key."""
        weights = np.array([m.weight for m in self.models.values()])
        shares = np.exp(weights - weights.max())
        return dict(zip(self.models, (shares / shares.sum()).tolist(), strict=True))

    @property
    def p(self) -> float:
        """Probability of data as odd as this if nothing were missing: the smaller of two bounds.

        `p_drawn` takes the scatter that the base model needs as true, however unusual it is. The other bound
        takes scatter to be as its prior says, as soils and rigs have it: if data multiplies the odds that
        something is missing by B, the probability of such data is at most 1 / B (Markov's inequality for the
        likelihood ratio: Good 1950).
        """
        none = self.probabilities[self.none.key]
        bound = _PRIOR_ODDS * none / max(1.0 - none, 1e-12)
        return max(min(self.p_drawn, bound), 1.0 / (1.0 + REPLICATES))

    def made(
        self,
        near: Candidate,
        put_in: Competitor | None = None,
        start: Array | None = None,
        out: Competitor | None = None,
    ) -> Candidate | None:
        """Return the model that differs from another one by a competitor added, removed or exchanged.

        It is fitted, and kept in `models`, unless it is there already.

        Parameters
        ----------
        near
            The model to start from.
        put_in
            Competitor to add; none if not given.
        start
            Parameters of `put_in` to start from, shape (its parameters,); its own start if not given.
        out
            Competitor to remove; none if not given.

        Returns
        -------
        Candidate or None
            None if the fit fails. With `out`, a model is not fitted if either competitor is a contact rule:
            None unless it is in `models`.
        """
        taken, given = (set() if c is None else {c.key} for c in (out, put_in))
        key = near.key - taken | given
        rules = out is not None and any(c is not None and c.geometry for c in (out, put_in))
        if key not in self.models and not rules:  # a rule of contact has no number to take out
            model = refit(self.fitter, near, put_in, start, out)
            if model is not None and np.isfinite(model.weight):
                self.models[key] = model
        return self.models.get(key)


def search(
    fitter: Fitter, base: Fit, field: Field, *, seed: int = 0, most: int = MOST_EFFECTS
) -> Search:
    """Find the models that explain the data best: the base model with up to `most` competitors added.

    Parameters
    ----------
    fitter
        Holds the measured points and their noise.
    base
        Converged fit of the base model.
    field
        The competitors.
    seed
        Seed of the random numbers of the score test.
    most
        Largest number of competitors in a model; 0 computes only the p-values of the score test.

    Returns
    -------
    Search
        The base model and all models that were fitted.
    """
    columns = [column for c in field.competitors for column in columns_of(fitter, base, c)]
    screen = Screen(fitter, base, columns)
    field, screen = _testable(screen, field)
    none = Candidate.of(base)
    found = Search(fitter, field, screen, *screen.tested(seed), {none.key: none})
    for size in range(1, most + 1 if screen.columns else 0):
        if not _extend(found, size):
            break
        _reduce(found)
    return found


def _reduce(found: Search) -> None:
    """Refit the best models without each of their competitors, since the last one added may explain it all.

    At a base far from the truth (an exponent that imitates a zero) an effect looks small until another one
    has freed the base.
    """
    best = [m for m in found.ordered if m.weight > found.ordered[0].weight - WINDOW][:PARENTS]
    for model in best:
        for competitor in model.competitors if len(model.competitors) > 1 else ():
            found.made(model, out=competitor)


def _testable(screen: Screen, field: Field) -> tuple[Field, Screen]:
    """Leave out families that no data of this design could show, and forms that act like another one."""
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
        family: "the base model imitates it: with these settings no plausible strength of it would show"
        for family, size in power.items()
        if size < TESTABLE
    }
    kept: list[tuple[Competitor, Array]] = []
    for c in field.competitors:
        mine = [column.shift for column in screen.columns if column.competitor is c]
        if not mine or c.family in blind:
            continue
        shift = np.hstack(mine)
        twins = [o for k, o in kept if k.family == c.family and o.shape == shift.shape]
        if not any(np.allclose(shift, other) for other in twins):
            kept.append((c, shift))
    field = field.only([c for c, _ in kept], blind)
    known = {c.key: c for c in field.competitors}
    columns = [
        replace(c, competitor=known[c.competitor.key])
        for c in screen.columns
        if c.competitor.key in known
    ]
    return field, Screen(screen.fitter, screen.fit, columns)


def _extend(found: Search, size: int) -> bool:
    """Refit the most promising extensions of the best models with one competitor less than `size`.

    Returns whether any comes close enough to the best model to be extended further.
    """
    parents = [m for m in found.ordered if len(m.competitors) == size - 1]
    parents = [m for m in parents if m.weight > parents[0].weight - WINDOW][:PARENTS]
    best, reached = found.ordered[0].weight, -np.inf
    most, forms = (FIRST_REFITS, _FORMS + 1) if size == 1 else (REFITS, _FORMS)
    base, points, columns = found.none.predicted, found.fitter.points, found.screen.columns
    for parent in parents:
        here = found.screen
        if size > 1:  # the columns of the other families, as the same shares of its predictions
            ratio = parent.predicted / np.where(np.abs(base) > 1e-12, base, np.inf)
            ratio[np.isin(points.channel, [points.channels.index(n) for n in points.forces])] = 1.0
            ratio = np.where(np.isfinite(ratio) & (ratio > 0), ratio, 1.0)[:, None]
            others = [c for c in columns if c.competitor.family not in parent.families]
            others = [replace(c, shift=c.shift * ratio) for c in others]
            here = Screen(found.fitter, parent, others)
        gain = here.gains((points.value - parent.predicted)[:, None])[:, 0]
        gain = gain + np.log([c.competitor.share for c in here.columns])
        promising: dict[tuple[str, str], ScoreColumn] = {}
        for column in (here.columns[i] for i in np.argsort(-gain)):
            key = column.competitor.key
            if key not in promising and sum(family == key[0] for family, _ in promising) < forms:
                promising[key] = column
        ordered = list(promising.values())
        tried, rest = ordered[:most], ordered[most:] if size == 1 else []
        for column in rest:  # each law once: a base that is far off imitates what it would need
            known = {other.competitor.family for other in tried}
            if column.competitor.kind != "unknown" and column.competitor.family not in known:
                tried.append(column)
        for column in tried:
            made = found.made(parent, column.competitor, column.start)
            reached = reached if made is None else max(reached, made.weight)
    return bool(reached > best - _REST)
