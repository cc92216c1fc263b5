from __future__ import annotations

import numpy as np
import pytest

from smallwheel_ros.fitting.mixed import Padding, RunEffects, fit_scatter, moments, profile
from smallwheel_ros.fitting.solve import Weights

Array = np.ndarray


def example(seed: int, runs: int = 30) -> tuple[RunEffects, Array, np.random.Generator]:
    rng = np.random.default_rng(seed)
    run = np.repeat(np.arange(runs), rng.integers(1, 6, runs))
    rng.shuffle(run)
    variance = rng.uniform(0.5, 2.0, run.size) ** 2
    loadings = rng.normal(1.0, 0.2, (run.size, 2))
    effects = RunEffects(variance, loadings, ("ln k", "resistance"), Padding.of(run))
    return effects, run, rng


def dense(effects: RunEffects, run: Array, tau: Array) -> Array:
    same = run[:, None] == run[None, :]
    u = effects.loadings * tau
    return np.diag(effects.variance) + same * (u @ u.T)


def test_the_sums_of_runs_give_what_the_whole_matrix_gives() -> None:
    effects, run, rng = example(1)
    tau = np.array([0.7, 0.4])
    v = dense(effects, run, tau)
    x, y = rng.normal(size=(run.size, 3)), rng.normal(size=run.size)
    inverse = np.linalg.inv(v)
    np.testing.assert_allclose(Weights(effects, tau).form(x), x.T @ inverse @ x, rtol=1e-10)
    xx, xy, yy, log_det = moments(effects, x, y).at(tau)
    np.testing.assert_allclose(xx, x.T @ inverse @ x, rtol=1e-10)
    np.testing.assert_allclose(xy, x.T @ inverse @ y, rtol=1e-9)
    assert yy == pytest.approx(y @ inverse @ y)
    assert log_det == pytest.approx(np.linalg.slogdet(v)[1])


def test_many_scatters_at_once_are_the_same_as_one_by_one() -> None:
    effects, run, rng = example(2)
    m = moments(effects, rng.normal(size=(run.size, 2)), rng.normal(size=run.size))
    grid = np.array([[0.0, 0.0], [0.3, 0.1], [1.0, 0.5]])
    together = profile(m, 1e-6 * np.eye(2), grid, None, True)[0]
    single = [float(profile(m, 1e-6 * np.eye(2), tau, None, True)[0]) for tau in grid]
    np.testing.assert_allclose(together, single, rtol=1e-12)


def test_scatter_of_runs_is_found() -> None:
    found = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        run = np.repeat(np.arange(40), 4)
        effects = RunEffects(np.full(160, 0.03**2), np.ones((160, 1)), ("ln k",), Padding.of(run))
        y = rng.normal(0.0, 0.08, 40)[run] + rng.normal(0.0, 0.03, 160)
        m = moments(effects, np.ones((160, 1)), y)
        scatter = fit_scatter(m, np.zeros((1, 1)), np.array([0.015]))
        found.append(scatter.tau[0])
        assert scatter.scale == pytest.approx(1.0, abs=0.2)
    assert np.mean(found) == pytest.approx(0.08, rel=0.1)


def test_no_scatter_is_found_where_there_is_none() -> None:
    rng = np.random.default_rng(5)
    run = np.repeat(np.arange(40), 4)
    effects = RunEffects(np.full(160, 1e-4), np.ones((160, 1)), ("ln k",), Padding.of(run))
    m = moments(effects, np.ones((160, 1)), rng.normal(0.0, 0.01, 160))
    assert fit_scatter(m, np.zeros((1, 1)), np.array([0.005])).tau[0] < 0.005
