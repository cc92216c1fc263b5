"""Weighted least squares under a mixed model: Levenberg-Marquardt within bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.jacobian import Predictor
from smallwheel_ros.fitting.mixed import (
    Moments,
    RunEffects,
    Scatter,
    fit_scatter,
    moments,
    profile,
    woodbury,
)

Array = NDArray[np.float64]

_STEPS = 25
_SMALL = 1e-4  # change of -2 log likelihood at which a fit has come to rest


@dataclass(frozen=True)
class Solution:
    """A fit. theta: (parameters,). predicted, slopes: at theta, (observations[, parameters]).

    information: X'V^-1X + prior, at scale 1. objective: y'V^-1y + prior. frozen: parameters held at a bound.
    """

    theta: Array
    predicted: Array
    slopes: Array
    information: Array
    objective: float
    frozen: NDArray[np.bool_]
    converged: bool


class Weights:
    """V^-1 of a mixed model at given scatter, applied through the sums of each run."""

    def __init__(self, effects: RunEffects, tau: Array) -> None:
        self.effects = effects
        self.tau = tau
        u = effects.loadings
        self._w = woodbury(effects.products(u, u), tau, 0.0)[0]

    def by_run(self, x: Array, y: Array) -> tuple[Array, Array]:
        """X' V^-1 X and X' V^-1 y of each run, shapes (runs, p, p) and (runs, p, responses)."""
        e = self.effects
        ux, uy = e.products(e.loadings, x), e.products(e.loadings, y)
        back = np.swapaxes(ux, 1, 2) @ self._w
        return e.products(x, x) - back @ ux, e.products(x, y) - back @ uy

    def form(self, x: Array) -> Array:
        """X' V^-1 X for X of shape (observations, columns)."""
        e = self.effects
        ux = e.products(e.loadings, x)
        plain = x.T @ (x / e.variance[:, None])
        flat = ux.reshape(-1, x.shape[1])
        return np.asarray(plain - flat.T @ (self._w @ ux).reshape(flat.shape))


def solve(
    predictor: Predictor, observed: Array, weights: Weights, start: Array, steps: int = _STEPS
) -> Solution:
    """Minimise (y - f)' V^-1 (y - f) + prior within the bounds, from `start`."""
    layout = predictor.layout
    low, high = layout.low, layout.high
    theta = np.clip(start, low, high)
    predicted, slopes = predictor.with_slopes(theta)
    damping, settled = 1e-3, False

    def total(theta: Array, form: Array) -> float:
        away = theta - layout.centre
        return float(form[-1, -1] + away @ layout.precision @ away)

    form = weights.form(np.column_stack([slopes, observed - predicted]))
    value = total(theta, form)
    frozen: NDArray[np.bool_] = np.zeros(theta.size, dtype=bool)
    for _ in range(steps):
        hessian = form[:-1, :-1] + layout.precision
        gradient = form[:-1, -1] - layout.precision @ (theta - layout.centre)
        frozen = ((theta <= low) & (gradient < 0)) | ((theta >= high) & (gradient > 0))
        free = ~frozen
        if not free.any():
            settled = True
            break
        moved = False
        for _ in range(12):
            block = hessian[np.ix_(free, free)]
            step = np.zeros(theta.size)
            step[free] = np.linalg.solve(
                block + (damping * np.diag(block) + 1e-12) * np.eye(block.shape[0]), gradient[free]
            )
            trial = np.clip(theta + step, low, high)
            if not np.all(np.isfinite(trial)):
                damping *= 6.0
                continue
            # Slopes with it at once: nearly every step is taken.
            trial_predicted, trial_slopes = predictor.with_slopes(trial)
            trial_form = weights.form(np.column_stack([trial_slopes, observed - trial_predicted]))
            trial_value = total(trial, trial_form)
            if np.isfinite(trial_value) and trial_value <= value + 1e-9:
                moved = True
                break
            damping *= 6.0
        if not moved:
            settled = True
            break
        gain = value - trial_value
        theta, value, form = trial, trial_value, trial_form
        predicted, slopes = trial_predicted, trial_slopes
        damping = max(damping / 8.0, 1e-9)
        if gain < _SMALL:
            settled = True
            break
    gradient = form[:-1, -1] - layout.precision @ (theta - layout.centre)
    frozen = ((theta <= low) & (gradient < 0)) | ((theta >= high) & (gradient > 0))
    return Solution(
        theta,
        predicted,
        slopes,
        form[:-1, :-1] + layout.precision,
        value,
        frozen,
        settled,
    )


@dataclass(frozen=True)
class MixedFit:
    """A fit with the runs' scatter fitted too."""

    solution: Solution
    scatter: Scatter
    moments: Moments  # at the solution: design = slopes, response = residual + slopes theta
    minus_two_log_likelihood: float  # maximum likelihood, not restricted: comparable between models


def solve_mixed(
    predictor: Predictor,
    observed: Array,
    effects: RunEffects,
    typical: Array,
    start: Array,
    tau: Array,
    *,
    scale: float | None = None,
    rounds: int = 2,
) -> MixedFit:
    """Alternate between the parameters at a given scatter and the scatter at given parameters."""
    layout = predictor.layout
    solution = solve(predictor, observed, Weights(effects, tau), start)
    for turn in range(rounds):
        free = ~solution.frozen
        design = solution.slopes[:, free]
        away = solution.theta - layout.centre
        # The prior counts as so many more observations; about the solution everything is linear.
        precision = layout.precision[np.ix_(free, free)]
        residual = observed - solution.predicted
        m = moments(effects, design, residual)
        pull = layout.precision[np.ix_(free, np.ones(free.size, dtype=bool))] @ away
        prior = float(away @ layout.precision @ away)
        shifted = replace(m, xy=m.xy - pull, yy=m.yy + prior)
        scatter = fit_scatter(shifted, precision, typical, scale, tau if turn else None)
        value = float(profile(shifted, precision, scatter.tau, scale, False)[0])
        if turn == rounds - 1:
            break
        moved = np.max(
            np.abs(np.log((scatter.tau + 1e-3 * typical) / (tau + 1e-3 * typical))), initial=0.0
        )
        tau = scatter.tau
        if moved < 0.05:
            break
        solution = solve(predictor, observed, Weights(effects, tau), solution.theta, steps=6)
    return MixedFit(solution, scatter, m, value)
