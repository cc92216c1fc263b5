"""Held-out error: each run is predicted by a fit that never saw it.

`one_step` takes one Gauss-Newton step away from the fit of everything (exact for a linear model):
for the ranking. `refitted` fits anew: for the figures that are reported of each step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.compare.scores import score
from smallwheel_ros.diagnosis.workbench import Explanation, Workbench
from smallwheel_ros.fitting.jacobian import Predictor
from smallwheel_ros.fitting.mixed import Padding, RunEffects
from smallwheel_ros.fitting.observations import Observations
from smallwheel_ros.fitting.solve import Weights, solve

Array = NDArray[np.float64]

_FOLDS = 10
_WEIGHINGS = 3
_MUCH = 1.5  # growth of a variance that makes weighing again worth while


@dataclass(frozen=True)
class Errors:
    """Held-out measured less predicted, shape (observations,), and noise variance of each."""

    error: Array
    variance: Array
    run: NDArray[np.intp]
    channel: NDArray[np.intp]
    channels: tuple[str, ...]

    def rmse(self) -> dict[str, float]:
        """By channel, m or N."""
        return {
            name: float(np.sqrt(np.mean(self.error[self.channel == c] ** 2)))
            for c, name in enumerate(self.channels)
        }

    def rmse_std(self) -> dict[str, float | None]:
        """Standard error of the rmse by channel, by bootstrap over runs; None with under 3 runs."""
        found: dict[str, float | None] = {}
        for c, name in enumerate(self.channels):
            mask = self.channel == c
            scored = score(self.error[mask], self.run[mask])
            found[name] = None if scored is None else scored.rmse_std
        return found

    def bias(self) -> dict[str, float]:
        """By channel, mean of measured less predicted, m or N."""
        return {
            name: float(np.mean(self.error[self.channel == c]))
            for c, name in enumerate(self.channels)
        }

    def standardised(self) -> float:
        """Root mean square of error over noise, all channels."""
        return float(np.sqrt(np.mean(self.error**2 / self.variance)))

    def by_run(self) -> Array:
        """Sum of squared errors over noise variance, of each run."""
        codes = np.unique(self.run, return_inverse=True)[1].reshape(-1)
        return np.asarray(np.bincount(codes, self.error**2 / self.variance), dtype=float)


def _folds(run: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    codes = np.unique(run, return_inverse=True)[1].reshape(-1)
    runs = int(codes.max()) + 1
    dealt = np.random.default_rng(5).permutation(np.arange(runs) % min(count, runs))
    return np.asarray(dealt[codes])


def one_step(workbench: Workbench, explanation: Explanation) -> Errors:
    """Leave one run out, by one Gauss-Newton step from the fit of all runs."""
    design, residual = explanation.design, explanation.residual
    weights = Weights(workbench.effects, explanation.fit.scatter.tau)
    a, b = weights.by_run(design, residual[:, None])
    total = a.sum(axis=0) + explanation.precision
    left = np.array(residual)
    pad = workbench.effects.padding
    for g in range(pad.index.shape[0]):
        rows = pad.index[g][pad.real[g]]
        away = np.linalg.solve(total - a[g] + 1e-12 * np.diag(np.diag(total)), b[g][:, 0])
        left[rows] += design[rows] @ away
    return _errors(workbench, left)


def _errors(workbench: Workbench, error: Array) -> Errors:
    observations, effects = workbench.observations, workbench.effects
    crude = effects.scatter(effects.least)  # of a law, whatever repeats say
    return Errors(
        error,
        effects.variance + crude,
        observations.run,
        observations.channel,
        observations.channels,
    )


def refitted(workbench: Workbench, explanation: Explanation) -> Errors:
    """Held-out errors of fits that were made without each tenth of the runs.

    Where the model misses something, its error is no noise, and a row that is measured well must not
    count for more than the others: what the error has beyond noise is added to every row alike.
    """
    observations, effects = workbench.observations, workbench.effects
    fold = _folds(observations.run, _FOLDS)
    error = np.full(len(observations), np.nan)
    variance = effects.variance
    start, residual = explanation.theta, explanation.residual
    predictor, tau = Predictor(observations, explanation.layout), explanation.fit.scatter.tau
    for _ in range(_WEIGHINGS):
        variance = effects.variance + _beyond_noise(effects, tau, observations, residual)
        if np.all(variance <= _MUCH * effects.variance):
            break
        whole = RunEffects(variance, effects.loadings, effects.names, effects.padding)
        found = solve(predictor, observations.value, Weights(whole, tau), start)
        start, residual = found.theta, observations.value - found.predicted
    for number in range(int(fold.max()) + 1):
        out = fold == number
        part = observations.take(~out)
        kept = RunEffects(
            variance[~out], effects.loadings[~out], effects.names, Padding.of(part.run)
        )
        found = solve(
            Predictor(part, explanation.layout), part.value, Weights(kept, tau), start, steps=8
        )
        held = observations.take(out)
        error[out] = held.value - Predictor(held, explanation.layout)(found.theta)
    return _errors(workbench, error)


def _beyond_noise(
    effects: RunEffects, tau: Array, observations: Observations, residual: Array
) -> Array:
    """Mean square of each channel's residual beyond noise and the runs' scatter, for each row."""
    known = effects.variance + effects.scatter(tau)
    count = np.maximum(np.bincount(observations.channel), 1)
    more = np.bincount(observations.channel, residual**2 - known) / count
    return np.asarray(np.maximum(more, 0.0)[observations.channel])


def noise_floor(workbench: Workbench, explanation: Explanation) -> dict[str, float]:
    """Error of the true model for a row of a new run: noise and the runs' scatter, by channel, m or N.

    What repeats of one run differ by is less: a new run meets the soil a little firmer or softer.
    """
    effects, fit = workbench.effects, explanation.fit
    variance = fit.scatter.scale**2 * (effects.variance + effects.scatter(fit.scatter.tau))
    observations = workbench.observations
    return {
        name: float(np.sqrt(np.mean(variance[observations.channel == c])))
        for c, name in enumerate(observations.channels)
    }


def better(before: Errors, after: Errors) -> tuple[float, float]:
    """How much better the second predicts: relative fall of the error, and gain over its own error.

    The fall is that of the channel that gains most, or of the standardised error of all. The gain is the
    fall of the squared standardised error over its standard error, where runs are the units.
    """
    first, second = before.rmse(), after.rmse()
    falls = [1.0 - second[c] / first[c] for c in first if first[c] > 0]
    falls.append(1.0 - after.standardised() / max(before.standardised(), 1e-300))
    gain = before.by_run() - after.by_run()
    spread = float(np.std(gain, ddof=1) * np.sqrt(gain.size)) if gain.size > 1 else np.inf
    return max(falls), float(gain.sum()) / max(spread, 1e-300)
