"""The fit itself: parameters, noise, runs' scatter and outliers, in turns until they agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.jacobian import Predictor
from smallwheel_ros.fitting.mixed import Padding, RunEffects, woodbury
from smallwheel_ros.fitting.noise import Noise, estimate_noise, reference_level
from smallwheel_ros.fitting.observations import FittingError, Observations
from smallwheel_ros.fitting.parameters import Layout
from smallwheel_ros.fitting.solve import MixedFit, Weights, solve, solve_mixed
from smallwheel_ros.physics.conditions import ROLLING

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

OUTLIER = 4.5  # standard deviations
_MOST_OUTLIERS = 0.10  # share above which it is the model that is wrong, not the rows


@dataclass(frozen=True)
class Calibration:
    """A fitted layout with all that was needed; arrays of shape (observations,) as in `Observations`.

    kept: what is no outlier. fit: made on the kept observations only.
    """

    observations: Observations
    layout: Layout
    noise: Noise
    effects: RunEffects  # of the kept observations
    typical: Array
    kept: Mask
    fit: MixedFit

    @property
    def kept_observations(self) -> Observations:
        """What was fitted: all but the outliers."""
        return self.observations.take(self.kept)


def run_effects(
    observations: Observations, layout: Layout, noise: Noise, predicted: Array, slopes: Array
) -> tuple[RunEffects, Array]:
    """Random effects of a run that this data can have, and of each the tau that equals the noise."""
    share = np.clip(noise.level / np.maximum(np.abs(predicted), 1e-12), 0.2, 5.0)
    if "drawbar_pull" in observations.channels:
        share = np.where(observations.of_channel("drawbar_pull"), 1.0, share)
    firmness = [
        j
        for j, slot in enumerate(layout.slots)
        if not slot.of_effect and slot.field == "log_reference_pressure"
    ]
    columns = {"ln k": slopes[:, firmness].sum(axis=1) * share}
    repeats = ~observations.swept
    repeated = (
        np.bincount((observations.run * 8 + observations.channel)[repeats]).max(initial=0) > 1
    )
    for c, name in enumerate(observations.channels):
        size = noise.level
        if name == "drawbar_pull":  # of the load: its law is crude whatever repeats say
            size = observations.conditions.load[observations.row]
        if name == "drawbar_pull" or (len(observations.channels) > 1 and repeated):
            own = (observations.channel == c) & (repeats | (name == "drawbar_pull"))
            columns[name] = np.where(own, size, 0.0)
    loadings = np.column_stack(list(columns.values()))
    # In a long curve a run's effect would only bend the model to what it misses.
    loadings[observations.curves] = 0.0
    padding = Padding.of(observations.run)
    runs = padding.index.shape[0]
    weight = np.sum(loadings**2 / noise.variance[:, None], axis=0)
    typical = np.sqrt(runs / np.maximum(weight, 1e2))
    return RunEffects(noise.variance, loadings, tuple(columns), padding), typical


def _kept_part(noise: Noise, kept: Mask) -> Noise:
    return Noise(noise.channels, noise.level[kept], noise.variance[kept])


def robust_noise(
    observations: Observations, predicted: Array, parameters: int, kept: Mask | None = None
) -> Noise:
    """Noise of each channel, estimated without what deviates grossly from its own run."""
    level = reference_level(observations, predicted)
    residual = observations.value - predicted
    if observations.swept.any():
        residual = _less_its_run(observations, residual, level)
    used = np.ones(len(observations), dtype=bool) if kept is None else kept.copy()
    noise = estimate_noise(observations, residual, level, used, parameters)
    key = observations.run * len(observations.channels) + observations.channel
    _, group = np.unique(key, return_inverse=True)
    group = group.reshape(-1)
    count = np.bincount(group)
    middle = np.array([np.median(residual[group == g]) for g in range(count.size)])
    apart = np.where(count[group] > 2, residual - middle[group], 0.0)
    for _ in range(5):
        wild = np.abs(apart) > OUTLIER * np.sqrt(noise.variance)
        again = used & ~wild
        if wild.mean() > _MOST_OUTLIERS:
            break
        better = estimate_noise(observations, residual, level, again, parameters)
        if np.allclose(better.variance, noise.variance, rtol=1e-3):
            break
        noise = better
    return noise


def _less_its_run(observations: Observations, residual: Array, level: Array) -> Array:
    """Residuals of swept runs less what is no noise: their run's own share, and what follows a setting.

    A firmer soil moves a whole run; and while an effect is missing, the error follows its driver.
    """
    left = residual.copy()
    rolling = observations.conditions.contact[observations.row] == ROLLING
    for channel in range(len(observations.channels)):
        rows = np.flatnonzero(observations.swept & (observations.channel == channel))
        if rows.size == 0:
            continue
        run = np.unique(observations.run[rows], return_inverse=True)[1].reshape(-1)
        share = residual[rows] / level[rows]
        middle = np.array([np.median(share[run == g]) for g in range(run.max() + 1)])
        share = share - middle[run]
        roll = rolling[rows]
        if roll.any():
            design = _within_runs(observations, rows[roll], run[roll])
            if design.shape[1] and rows[roll].size > 3 * design.shape[1]:
                share[roll] -= design @ np.linalg.lstsq(design, share[roll], rcond=None)[0]
        left[rows] = level[rows] * share
    return left


def _within_runs(
    observations: Observations, rows: NDArray[np.intp], run: NDArray[np.intp]
) -> Array:
    """Settings and their squares and cubes, less their mean in each run."""
    conditions = observations.conditions
    columns = [conditions.load, conditions.diameter, conditions.width]
    columns += list(conditions.covariates.values())
    count = np.maximum(np.bincount(run), 1)
    found = []
    for column in columns:
        x = column[observations.row[rows]]
        if np.ptp(x) <= 1e-6 * np.max(np.abs(x), initial=0.0):
            continue
        x = (x - x.mean()) / x.std()
        for power in (1, 2, 3):
            y = x**power
            y = y - (np.bincount(run, y, minlength=count.size) / count)[run]
            if np.std(y) > 1e-3:
                found.append(y)
    return np.asarray(np.column_stack(found)) if found else np.zeros((rows.size, 0))


def conditional_residuals(effects: RunEffects, tau: Array, residual: Array) -> Array:
    """Residuals less what is special about each run (its best linear unbiased prediction), over sigma."""
    u = effects.loadings
    w = woodbury(effects.products(u, u), tau, 0.0)[0]
    special = np.einsum("gqr,gr->gq", w, effects.products(u, residual[:, None])[:, :, 0])
    pad = effects.padding
    group = np.zeros(residual.size, dtype=np.intp)
    rows = np.broadcast_to(np.arange(pad.index.shape[0])[:, None], pad.index.shape)
    group[pad.index[pad.real]] = rows[pad.real]
    left = residual - np.einsum("nq,nq->n", u, special[group])
    return np.asarray(left / np.sqrt(effects.variance))


def calibrate(
    observations: Observations,
    layout: Layout,
    *,
    start: Array | None = None,
    noise: Noise | None = None,
    kept: Mask | None = None,
    look_for_outliers: bool = True,
) -> Calibration:
    """Fit the layout. noise, kept: taken as given where they are, else estimated with the fit.

    Raises FittingError where there are fewer observations than free parameters need.
    """
    if len(observations) < 2:
        raise FittingError("one measurement cannot be fitted: measure at least a few loads")
    theta = layout.start if start is None else start
    everything = Predictor(observations, layout)
    if start is None:
        theta = _first_guess(observations, layout, everything)
    kept = np.ones(len(observations), dtype=bool) if kept is None else kept
    tau: Array | None = None
    given = noise
    for turn in range(6):
        predicted, slopes = everything.with_slopes(theta)
        # A curve's misfit is no noise: once, from the first fit, must do.
        if given is None and turn < (1 if observations.curves.any() else 3):
            noise = robust_noise(observations, predicted, layout.low.size, kept)
        assert noise is not None
        part = observations.take(kept)
        effects, typical = run_effects(
            part, layout, _kept_part(noise, kept), predicted[kept], slopes[kept]
        )
        tau = typical if tau is None or tau.size != typical.size else tau
        fit = solve_mixed(Predictor(part, layout), part.value, effects, typical, theta, tau)
        theta, tau = fit.solution.theta, fit.scatter.tau
        if look_for_outliers:
            flagged = _worst_of_each_run(part, effects, fit)
            if flagged.any() and 1.0 - kept.mean() + flagged.sum() / kept.size <= _MOST_OUTLIERS:
                kept = kept.copy()
                kept[np.flatnonzero(kept)[flagged]] = False
                continue
        if turn >= 1:
            break
    assert noise is not None
    return Calibration(observations, layout, noise, effects, typical, kept, fit)


def _worst_of_each_run(part: Observations, effects: RunEffects, fit: MixedFit) -> Mask:
    """A gross error pulls its whole run: only the worst of a run is called an outlier at a time."""
    residual = part.value - fit.solution.predicted
    scaled = conditional_residuals(effects, fit.scatter.tau, residual)
    size = np.abs(scaled) / max(1.0, min(fit.scatter.scale, 1.5))
    worst = np.zeros(part.run.max() + 1)
    np.maximum.at(worst, part.run, size)
    return np.asarray((size > OUTLIER) & (size >= worst[part.run]))


def _first_guess(observations: Observations, layout: Layout, predictor: Predictor) -> Array:
    """A fit with 10 % noise on everything, from a pressure that fits the median roughly."""
    size = np.abs(observations.value)
    floor = np.array(
        [
            0.2 * np.median(size[observations.channel == c])
            for c in range(3)
            if (observations.channel == c).any()
        ]
    )
    codes = np.unique(observations.channel, return_inverse=True)[1].reshape(-1)
    variance = (0.1 * np.hypot(size, floor[codes]) + 1e-9) ** 2
    padding = Padding.of(observations.run)
    effects = RunEffects(variance, np.zeros((len(observations), 1)), ("none",), padding)
    weights = Weights(effects, np.zeros(1))
    best, answer = np.inf, layout.start
    for shift in (-2.0, 0.0, 2.0):
        theta = layout.start
        for j, slot in enumerate(layout.slots):
            if slot.field == "log_reference_pressure":
                theta[j] = np.clip(layout.centre[j] + shift, layout.low[j], layout.high[j])
        found = solve(predictor, observations.value, weights, theta)
        if found.objective < best - 1e-6:
            best, answer = found.objective, found.theta
    return answer
