# SPDX-License-Identifier: Apache-2.0
"""The alarm that the model lacks an effect, by a test during the drive of what changes in sinkage follow.

A filter can hide a missing effect: it bends k and n, or takes each slippery place for another soil.
The test therefore does not use the filter's results. It keeps the stretches of the last metres and looks at
the change from each one to the next of the same wheel: does ln sinkage change as n and m predict, or also
with slip, speed or load? It uses changes because soil drifts and ends: a border between soils is one large
change that nothing explains, which Student's t distribution allows for, while an effect returns wherever its
cause does.

The statistic of an effect is twice the gain in log likelihood when its column (the change of ln sinkage by
the effect at unit strength) is fitted together with those of n and m; of an effect with several forms, the
largest one counts. Forms differ little over a drive, so only the effect is named.

Tests are due every 2 m of path, at the end of a stretch, with the law from before it: they do not depend on
where blocks are cut.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.registry import families
from smallwheel_ros.model.nearby_sinkage import NearbySinkage
from smallwheel_ros.onboard.prior import SoilPrior
from smallwheel_ros.physics.conditions import ROLLING, Conditions
from smallwheel_ros.physics.sinkage import Geometry
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.tables import Array

from .stretches import Stretches

WINDOW = 40.0  # m of path whose stretches are tested
EVERY = 2.0  # m between tests
_ENOUGH = 60  # least number of changes from stretch to stretch
_RAISE, _CLEAR = 30.0, 12.0  # statistic at which the alarm is raised, and below which it is cleared
_IN_A_ROW = 2  # successive tests over `_RAISE` that raise the alarm
_APART = 12.0  # statistic of the best effect less that of another, from which on that is no rival
_LEFT = 0.5  # least share of a column that n and m cannot imitate
_LEAST_CHANGE = 0.3  # root mean square of a column, in standard deviations of a change, at least
_KNOWN = 0.5  # least share of the changes for which a covariate is known
_STEP = 0.02  # of n and m, for numerical derivatives
_LEAST_SINKAGE = 2e-4  # m: the logarithm of less is noise
_SCATTER = 0.04  # of ln sinkage from stretch to stretch, besides the instrument's noise
_FREEDOM = 4.0  # of Student's t distribution: tails as heavy as borders between soils make them
_ITERATIONS = 40
_SETTLED = 1e-3  # of twice the log likelihood
# Errors raised for a soil in which a wheel has no sinkage, or by an effect that fails.
_NO_SINKAGE = (ArithmeticError, ValueError, np.linalg.LinAlgError, SmallwheelError)


@dataclass(frozen=True)
class EffectScore:
    """Result of one test for one effect.

    Attributes
    ----------
    effect, form
        Id of the effect, and its form that fits best.
    statistic
        Twice the gain in log likelihood; 0 if it could not be tested.
    strength
        First parameter of the form by a linear fit, in its unit; 0 if it could not be tested.
    follows
        The first variable that the form depends on, such as 'slip'; 'load' if there is none.
    reason
        Why the effect could not be tested, in words; empty if it was.
    spread
        Standard deviation of what the effect adds to ln sinkage over the stretches.
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
    """An effect that the model lacks, as the last metres show it.

    Attributes
    ----------
    effect
        Id of the effect that explains the changes of sinkage best.
    rivals
        Ids of effects that explain them nearly as well: this drive cannot separate them.
    follows
        The variable that sinkage changes with: 'slip', 'speed', 'load'.
    statistic
        Evidence: twice the gain in log likelihood by the best effect.
    distance
        Path of the vehicle at which the alarm was raised, m.
    message
        The alarm in words.
    log_modulus_std
        Standard deviation of ln k from place to place due to the missing effect, by which every prediction is
        uncertain until the effect is in the model.
    """

    effect: str
    rivals: tuple[str, ...]
    follows: str
    statistic: float
    distance: float
    message: str
    log_modulus_std: float


class _Trial(NamedTuple):
    """A form of an effect that is tested, with its first parameter at the value where a fit starts.

    Attributes
    ----------
    effect
        The form with that value.
    strength
        That value less `neutral`.
    neutral
        Value of the parameter at which the form has no effect.
    bounds
        Least and largest value of the parameter.
    follows
        As in `EffectScore`.
    """

    effect: Effect
    strength: float
    neutral: float
    bounds: tuple[float, float]
    follows: str

    def untested(self, reason: str) -> EffectScore:
        """Return the result of a form that cannot be tested for this reason."""
        return EffectScore(self.effect.id, self.effect.form, 0.0, 0.0, self.follows, reason)


class MissingEffectWatch:
    """Watches for effects that the model lacks.

    Parameters
    ----------
    effects
        Effects of the model.
    wheels
        All wheels.
    length
        Length of a stretch, m.
    prior
        Prior of the soil, whose strength, name and geometry the tests use.

    Attributes
    ----------
    alarm
        The effect that is missing; None while there is no alarm.
    scores
        Results of the newest test, one for each effect that the model lacks, the best first.
    missed_variance
        Variance of ln k to be added to predictions while there is an alarm; 0 otherwise.
    """

    def __init__(
        self, effects: Sequence[Effect], wheels: tuple[Wheel, ...], length: float, prior: SoilPrior
    ) -> None:
        self._effects, self._soil, self._geometry = tuple(effects), prior.soil, prior.geometry
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
        self._pieces = StretchChanges(wheels, length, WINDOW)
        self._rolls = np.array([wheel.contact == ROLLING for wheel in wheels])
        self._next: float | None = None
        self._over = 0
        self.scores: tuple[EffectScore, ...] = ()
        self.alarm: MissingEffect | None = None
        self.missed_variance = 0.0

    def take(self, rows: Stretches, law: Callable[[], tuple[float, float, float]]) -> None:
        """Add stretches that are ready together, and test whenever 2 m have been driven since the last test.

        Parameters
        ----------
        rows
            The stretches; those of wheels that do not roll are left out.
        law
            Function that returns k (Pa/m^(n+m)), n and m as they were before these stretches.
        """
        rows = rows.take(self._rolls[rows.wheel])
        if not len(rows):
            return
        self._pieces.add(rows)
        distance = float(rows.distance[-1])
        if self._next is None:
            self._next = distance + EVERY
        if distance >= self._next:
            self._test(law(), distance)

    def _test(self, law: tuple[float, float, float], distance: float) -> None:
        """Test every effect for a soil with this k, n and m, and raise or clear the alarm."""
        self._next = distance + EVERY
        changes = self._pieces.changes()
        if changes is None or changes.later.size < _ENOUGH:
            return
        try:
            k, n, m = law
            soil = replace(self._soil, k=k, n=n, m=m)
            self.scores = _scores(soil, self._effects, self._trials, changes, self._geometry)
        except _NO_SINKAGE:
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
    """Make the alarm from the results of a test, the best first. distance: where it was raised, m."""
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
    soil: Soil,
    effects: Sequence[Effect],
    trials: Sequence[_Trial],
    changes: Changes,
    geometry: Geometry,
) -> tuple[EffectScore, ...]:
    """Test every effect by its best form; the best effect first."""
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
    nearby = NearbySinkage(soil, effects, conditions, geometry)
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
    """Root mean square of a column of shape (pairs,)."""
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
    """Test a form by fitting its column together with those of n and m.

    base: fit of the latter alone. missed: changes that the law does not predict, over their deviations,
    (pairs,). known: columns of n and m, (columns, pairs). imitated: orthonormal columns that span them,
    (pairs, columns). column: of the form at unit strength, (pairs,).
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


# ---- what is tested


class Changes(NamedTuple):
    """Stretches, and the pairs of neighbours among them whose changes are tested.

    Attributes
    ----------
    log_sinkage
        ln of the measured sinkage in m, shape (stretches,).
    wheels
        Loads, sizes, slip and speed of the stretches; slip and speed are NaN if unknown.
    later, earlier
        Indices of the two stretches of each pair, shape (pairs,).
    deviation
        Standard deviation of the change of ln sinkage in each pair, up to a common factor, shape (pairs,).
    """

    log_sinkage: Array
    wheels: Conditions
    later: NDArray[np.intp]
    earlier: NDArray[np.intp]
    deviation: Array

    def of(self, column: Array) -> Array:
        """Compute the changes of a column from stretch to stretch, over their deviations.

        Parameters
        ----------
        column
            A value of each stretch, shape (stretches,).

        Returns
        -------
        ndarray
            Shape (pairs,).
        """
        return (column[self.later] - column[self.earlier]) / self.deviation

    def where(self, usable: NDArray[np.bool_]) -> Changes:
        """Select pairs by a mask of shape (pairs,)."""
        later, earlier, deviation = self.later[usable], self.earlier[usable], self.deviation[usable]
        return self._replace(later=later, earlier=earlier, deviation=deviation)


class StretchChanges:
    """Keeps the newest stretches of each wheel, and pairs those that follow each other.

    Parameters
    ----------
    wheels
        All wheels.
    length
        Length of a stretch, m; stretches that are four lengths or more apart are not paired.
    window
        Length of the vehicle's path, before each wheel's newest stretch, over which stretches are kept, m.
    """

    def __init__(self, wheels: tuple[Wheel, ...], length: float, window: float) -> None:
        self._wheels, self._length, self._window = wheels, length, window
        self._kept: list[Stretches] = []
        self._order: dict[int, None] = {}  # of the wheels, as they came

    def add(self, rows: Stretches) -> None:
        """Add stretches; those with less than 0.2 mm of sinkage are left out, as its logarithm is noise."""
        rows = rows.take(rows.sinkage >= _LEAST_SINKAGE)
        if len(rows):
            self._kept.append(rows)
            self._order.update(dict.fromkeys(np.unique(rows.wheel).tolist()))

    def changes(self) -> Changes | None:
        """Return the stretches that are kept, with their pairs; None while there are no pairs."""
        if not self._kept:
            return None
        rows = Stretches.joined(self._kept)
        each = [rows.take(rows.wheel == wheel) for wheel in self._order]
        rows = Stretches.joined(
            [one.take(one.distance[-1] - one.distance <= self._window) for one in each]
        )
        self._kept = [rows]
        # Over a gap the soil may be any other.
        near = np.abs(np.diff(rows.distance)) < 4.0 * self._length
        earlier = np.flatnonzero((np.diff(rows.wheel) == 0) & near)
        if not earlier.size:
            return None
        later = earlier + 1
        diameter, width = (
            np.array([getattr(wheel, name) for wheel in self._wheels])[rows.wheel]
            for name in ("diameter", "width")
        )
        rolling = np.broadcast_to(np.array(ROLLING), rows.sinkage.shape)
        covariates = {"slip": rows.slip, "speed": rows.speed}
        wheels = Conditions(rows.load, diameter, width, rolling, None, covariates)
        variance = rows.variance / rows.sinkage**2
        deviation = np.sqrt(variance[later] + variance[earlier] + _SCATTER**2)
        return Changes(np.log(rows.sinkage), wheels, later, earlier, deviation)


class RobustFit(NamedTuple):
    """Result of `robust_fit`.

    Attributes
    ----------
    coefficients
        Coefficient of each column, shape (columns,).
    scale
        Scale of the errors' Student's t distribution, in the unit of y.
    log_likelihood
        Log likelihood of the errors, up to a constant.
    """

    coefficients: Array
    scale: float
    log_likelihood: float


def robust_fit(y: Array, columns: Array, start: Array | None = None) -> RobustFit:
    """Fit y by a linear combination of columns; errors have a Student's t distribution of fitted scale.

    By iterated weighted least squares, which is expectation maximisation for Student's t (Lange,
    Little and Taylor 1989), with 4 degrees of freedom.

    Parameters
    ----------
    y
        Values to be fitted, shape (rows,).
    columns
        Shape (rows, columns).
    start
        Coefficients to start from, shape (columns,); None: 0.

    Returns
    -------
    RobustFit
        Coefficients, scale and log likelihood.

    Raises
    ------
    LinAlgError
        If the columns are not independent.
    """
    rows = y.size
    across = np.ascontiguousarray(columns.T)  # row by row for each column: fewer, longer loops
    coefficients: Array = np.zeros(columns.shape[1]) if start is None else start
    errors: Array = y - coefficients @ across
    squares = errors * errors
    square = max(float(np.median(squares)) / 0.455, 1e-20)
    before = -math.inf
    for _ in range(_ITERATIONS):
        ratio = squares / (_FREEDOM * square)
        log_likelihood = -0.5 * (
            rows * math.log(square) + (_FREEDOM + 1.0) * float(np.log1p(ratio).sum())
        )
        if log_likelihood - before < 0.5 * _SETTLED:
            break
        before = log_likelihood
        weight = (1.0 + 1.0 / _FREEDOM) / (1.0 + ratio)
        weighted = across * weight
        coefficients = np.asarray(np.linalg.solve(weighted @ across.T, weighted @ y))
        errors = y - coefficients @ across
        squares = errors * errors
        square = max(float(weight @ squares) / rows, 1e-20)
    return RobustFit(coefficients, math.sqrt(square), log_likelihood)
