"""Held-out error: each run is predicted by a fit that never saw it.

`one_step` takes one Gauss-Newton step away from the fit of everything (exact for a linear model): for
the ranking. `refitted` fits anew: for the figures that are reported of each step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.score import simulate
from smallwheel_ros.diagnosis.workbench import Explanation, Workbench
from smallwheel_ros.fitting.jacobian import Predictor
from smallwheel_ros.fitting.mixed import Padding, RunEffects
from smallwheel_ros.fitting.solve import Weights, solve
from smallwheel_ros.scores import score

Array = NDArray[np.float64]

_FOLDS = 10


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
        return np.bincount(codes, self.error**2 / self.variance)


def _folds(run: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    codes = np.unique(run, return_inverse=True)[1].reshape(-1)
    runs = int(codes.max()) + 1
    dealt = np.random.default_rng(5).permutation(np.arange(runs) % min(count, runs))
    return np.asarray(dealt[codes])


def one_step(workbench: Workbench, explanation: Explanation) -> Errors:
    """Leave one run out, by one Gauss-Newton step from the fit of all runs."""
    error = _one_step(workbench, explanation, explanation.residual[:, None])[:, 0]
    return _errors(workbench, error)


def _one_step(workbench: Workbench, explanation: Explanation, residuals: Array) -> Array:
    """For residuals of shape (observations, draws)."""
    effects, tau = workbench.effects, explanation.fit.scatter.tau
    design = explanation.design
    weights = Weights(effects, tau)
    a, b = weights.by_run(design, residuals)
    total = a.sum(axis=0) + explanation.precision
    left = np.array(residuals)
    pad = effects.padding
    for g in range(pad.index.shape[0]):
        rows = pad.index[g][pad.real[g]]
        away = np.linalg.solve(total - a[g] + 1e-12 * np.diag(np.diag(total)), b[g])
        left[rows] += design[rows] @ away
    return left


def _errors(workbench: Workbench, error: Array) -> Errors:
    observations = workbench.observations
    return Errors(
        error,
        workbench.effects.variance,
        observations.run,
        observations.channel,
        observations.channels,
    )


def refitted(workbench: Workbench, explanation: Explanation) -> Errors:
    """Held-out errors of fits that were made without each tenth of the runs."""
    observations, effects = workbench.observations, workbench.effects
    fold = _folds(observations.run, _FOLDS)
    error = np.full(len(observations), np.nan)
    for number in range(int(fold.max()) + 1):
        out = fold == number
        part = observations.take(~out)
        kept = RunEffects(
            effects.variance[~out], effects.loadings[~out], effects.names, Padding.of(part.run)
        )
        weights = Weights(kept, explanation.fit.scatter.tau)
        found = solve(
            Predictor(part, explanation.layout), part.value, weights, explanation.theta, steps=8
        )
        held = observations.take(out)
        error[out] = held.value - Predictor(held, explanation.layout)(found.theta)
    return _errors(workbench, error)


def noise_floor(
    workbench: Workbench, explanation: Explanation, seed: int, draws: int = 60
) -> dict[str, float]:
    """Held-out error of data that the explanation itself would make, with its runs' scatter."""
    generator = np.random.default_rng([seed, 11])
    tau = explanation.fit.scatter.tau
    simulated = simulate(workbench.effects, tau, draws, generator)
    # Simulated residuals still have in them what a fit would take out: one_step does that first.
    error = _one_step(workbench, explanation, _fitted(workbench, explanation, simulated))
    error *= explanation.fit.scatter.scale
    observations = workbench.observations
    return {
        name: float(np.sqrt(np.mean(error[observations.channel == c] ** 2)))
        for c, name in enumerate(observations.channels)
    }


def _fitted(workbench: Workbench, explanation: Explanation, draws: Array) -> Array:
    """Residuals of the linear fit to each draw."""
    design = explanation.design
    weights = Weights(workbench.effects, explanation.fit.scatter.tau)
    a, b = weights.by_run(design, draws)
    solved = np.linalg.solve(a.sum(axis=0) + explanation.precision, b.sum(axis=0))
    return np.asarray(draws - design @ solved)


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
