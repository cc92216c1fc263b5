# SPDX-License-Identifier: Apache-2.0
"""The alarm that physics is missing: what the estimator's errors follow, tested as it drives.

A filter can hide a missing effect: it bends k and n, or takes each slippery place for another soil.
So this test does not look at what the filter makes of the measurements. It keeps the measurements
of the last metres, outliers included, as medians over short pieces of way, and asks of the change
from each piece to the next of one wheel: does ln sinkage change as n and m say, or also as slip,
speed or load do? Changes, since soil drifts and ends: a border between soils is one great change
that nothing explains, which Student's t distribution allows for, while an effect comes back
wherever its cause does.

The statistic of an effect is that of a score test, as in `diagnosis`: twice the gain in log
likelihood when its column joins those of n and m, the largest over the forms of its family. Forms
differ little over a drive; the name is that of the family.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.registry import families
from smallwheel_ros.estimator.nearby_sinkage import NearbySinkage
from smallwheel_ros.estimator.robust_regression import RobustFit, robust_fit
from smallwheel_ros.estimator.segment import Segment
from smallwheel_ros.estimator.segment_changes import Changes, SegmentChanges
from smallwheel_ros.estimator.wheel_sinkage import NO_SINKAGE
from smallwheel_ros.physics.soil import Soil

Array = NDArray[np.float64]

WINDOW = 40.0  # m of way that the test looks back on
EVERY = 2.0  # m between tests
_ENOUGH = 60  # changes from piece to piece
_RAISE, _CLEAR = 30.0, 12.0  # of the statistic
_IN_A_ROW = 2  # tests over `_RAISE`
_APART = 12.0  # between the best effect and one that is no rival
_LEFT = 0.5  # least share of a column that n and m cannot imitate
_LEAST_CHANGE = 0.3  # of a column, in standard deviations of a change (root mean square)
_KNOWN = 0.5  # least share of the changes for which a covariate is known
_STEP = 0.02  # of n and m


@dataclass(frozen=True)
class EffectScore:
    """One family in one test.

    form, strength: its best form, and the first parameter of that by the linear fit. statistic:
    twice the gain in log likelihood. follows: the first of its drivers, 'load' where none.
    reason: why it could not be tested, else "". spread: standard deviation of what it adds to ln
    sinkage from place to place.
    """

    effect: str
    form: str
    statistic: float
    strength: float
    follows: str
    reason: str
    spread: float = 0.0


@dataclass(frozen=True)
class MissingEffect:
    """What the model misses, as far as the last metres tell.

    Attributes
    ----------
    effect
        Id of the effect that explains it best.
    rivals
        Ids that explain it nearly as well: this drive cannot tell them apart.
    follows
        What the errors follow: 'slip', 'speed', 'load'.
    statistic
        Evidence: twice the gain in log likelihood.
    distance
        Travel (m) at which it was raised.
    message
        The same for people.
    log_modulus_std
        How far the missing effect takes ln k from place to place: what every prediction is uncertain
        by until the effect is in the model.
    """

    effect: str
    rivals: tuple[str, ...]
    follows: str
    statistic: float
    distance: float
    message: str
    log_modulus_std: float


class _Trial(NamedTuple):
    """A form at its start. strength: how far its first parameter is from where it vanishes."""

    effect: Effect
    strength: float
    neutral: float
    bounds: tuple[float, float]
    follows: str

    def untested(self, reason: str) -> EffectScore:
        return EffectScore(self.effect.id, self.effect.form, 0.0, 0.0, self.follows, reason)


class MissingEffectWatch:
    """Watches for effects that the model has not.

    effects: of the model. length: m, of a segment.
    """

    def __init__(self, effects: Sequence[Effect], length: float) -> None:
        self._effects = tuple(effects)
        present = {effect.id for effect in effects}
        self._trials = [
            _trial(form)
            for name, forms in families().items()
            for form in forms
            if name not in present
            and "sinkage" in form.channels
            and form.parameters()
            # A constant fault of an instrument hardly shows in changes from piece to piece.
            and form.kind == "soil"
            # One that is made from another form differs from it in the forces only.
            and not any(issubclass(form, other) for other in forms if other is not form)
        ]
        self._pieces = SegmentChanges(length, WINDOW)
        self._next: float | None = None
        self._over = 0
        self.scores: tuple[EffectScore, ...] = ()
        self.alarm: MissingEffect | None = None
        # Variance of ln k to be allowed for while an effect is suspected that the model has not.
        self.missed_variance = 0.0

    def add(self, segment: Segment) -> bool:
        """Take a segment of a rolling wheel; True when a test is due."""
        self._pieces.add(segment)
        if self._next is None:
            self._next = segment.distance + EVERY
        return segment.distance >= self._next

    def test(self, soil: Soil, law: tuple[float, float, float], distance: float) -> None:
        """Test every family about a soil with this k, n and m; see `alarm` and `scores`."""
        self._next = distance + EVERY
        changes = self._pieces.changes()
        if changes is None or changes.later.size < _ENOUGH:
            return
        try:
            k, n, m = law
            soil = replace(soil, k=k, n=n, m=m)
            self.scores = _scores(soil, self._effects, self._trials, changes)
        except NO_SINKAGE:
            return  # a soil in which the wheels have no sinkage: nothing to compare
        best = self.scores[0]
        if best.statistic >= _RAISE:
            self._over += 1
        else:
            self._over = 0
        if self._over >= _IN_A_ROW:
            since = distance if self.alarm is None else self.alarm.distance
            self.alarm = _describe(self.scores, since, n)
        elif best.statistic < _CLEAR:
            self.alarm = None
        self.missed_variance = 0.0 if self.alarm is None else self.alarm.log_modulus_std**2


def _describe(scores: Sequence[EffectScore], distance: float, n: float) -> MissingEffect:
    best = scores[0]
    rivals = tuple(
        s.effect for s in scores[1:] if not s.reason and s.statistic > best.statistic - _APART
    )
    name = " or ".join((best.effect, *rivals))
    return MissingEffect(
        best.effect,
        rivals,
        best.follows,
        best.statistic,
        distance,
        f"the model misses something that follows {best.follows}: {name} fits (evidence "
        f"{best.statistic:.0f}, raised from {_RAISE:.0f}); record a drive and run `smallwheel "
        f"diagnose`, or add the effect to the model file",
        best.spread * (n + 0.5),
    )


def _scores(
    soil: Soil, effects: Sequence[Effect], trials: Sequence[_Trial], changes: Changes
) -> tuple[EffectScore, ...]:
    """Score every family, the best first."""
    covariates = {}
    usable = np.ones(changes.later.size, dtype=bool)
    for name, column in changes.wheels.covariates.items():
        known_here = np.isfinite(column)
        both = known_here[changes.later] & known_here[changes.earlier]
        # Not known where a wheel stands: those pieces are left out, not the covariate.
        if both.mean() > _KNOWN:
            covariates[name] = np.where(known_here, column, np.median(column[known_here]))
            usable &= both
    conditions = replace(changes.wheels, covariates=covariates)
    nearby = NearbySinkage(soil, effects, conditions)
    load_varies = _size(changes.of(np.log(conditions.load))) > _LEAST_CHANGE
    plain = nearby.log_sinkage(soil)
    missed = changes.of(changes.log_sinkage - plain)
    others = (replace(soil, n=soil.n + _STEP), replace(soil, m=soil.m + _STEP))
    slopes = [changes.of(nearby.log_sinkage(law) - plain) / _STEP for law in others]
    for column in (missed, *slopes):
        usable &= np.isfinite(column)
    missed, changes = missed[usable], changes.where(usable)
    slopes = [column[usable] for column in slopes]
    known = np.array([column for column in slopes if _size(column) > 1e-3])
    known = known.reshape(-1, missed.size)
    base = robust_fit(missed, known.T)
    imitated = np.linalg.qr(known.T)[0]
    best: dict[str, EffectScore] = {}
    for trial in trials:
        effect = trial.effect
        absent = [name for name in effect.needs if name not in conditions]
        if absent:
            score = trial.untested(f"{absent[0]} is not known")
        elif not (effect.needs or load_varies):
            score = trial.untested("load hardly varied")
        else:
            added = (nearby.log_sinkage(soil, effect) - plain) / trial.strength
            score = _score(trial, base, missed, known, imitated, changes.of(added))
            told = added[~np.isnan(added)]  # NaN where the soil gives no sinkage
            size = float(told.std() if told.size else 0.0) * abs(score.strength - trial.neutral)
            score = replace(score, spread=size if math.isfinite(size) else 0.0)
        if effect.id not in best or score.statistic > best[effect.id].statistic:
            best[effect.id] = score
    return tuple(sorted(best.values(), key=lambda s: -s.statistic))


def _size(column: Array) -> float:
    """Root mean square of an array of shape (pairs,)."""
    return math.sqrt(float(column @ column) / column.size)


def _trial(form: type[Effect]) -> _Trial:
    first = form.parameters()[0]
    neutral = 0.0 if first.neutral is None else first.neutral
    at = first.start if first.start != neutral else neutral + 0.1 * (first.bounds[1] - neutral)
    follows = (*form.drivers, "load")[0]
    return _Trial(form(**{first.name: at}), at - neutral, neutral, first.bounds, follows)


def _score(
    trial: _Trial, base: RobustFit, missed: Array, known: Array, imitated: Array, column: Array
) -> EffectScore:
    """Add a form's column to those of n and m.

    known: these, shape (columns, rows). imitated: orthonormal columns that span them.
    """
    if not np.isfinite(column).all():
        return trial.untested("it has no sinkage in this soil")
    size = _size(column)
    if size * abs(trial.strength) < _LEAST_CHANGE:
        return trial.untested(f"{trial.follows} hardly varied")
    if known.size:
        rest = column - imitated @ (imitated.T @ column)
        if _size(rest) < _LEFT * size:
            return trial.untested("n and m would do the same")
    fit = robust_fit(missed, np.vstack([known, column]).T, np.append(base.coefficients, 0.0))
    found = trial.neutral + float(fit.coefficients[-1])
    low, high = trial.bounds
    gain = 2.0 * (fit.log_likelihood - base.log_likelihood)
    if not low <= found <= high or not math.isfinite(gain):
        return trial.untested("its strength would be outside of its bounds")
    return replace(trial.untested(""), statistic=max(gain, 0.0), strength=found)
