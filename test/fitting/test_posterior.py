# SPDX-License-Identifier: Apache-2.0
"""How well a fit knows its numbers: more measured is never less known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import smallwheel_ros as sw
from smallwheel_ros.fitting import Problem
from smallwheel_ros.fitting.posterior import sandwich
from smallwheel_ros.fitting.problem import base_of
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.model.model_file import as_calibrated
from smallwheel_ros.simulate import RigSettings, simulate_rig


@given(seed=st.integers(0, 10**6), rows=st.integers(4, 12))
def test_weights_by_the_true_variance_are_generalised_least_squares(seed: int, rows: int) -> None:
    rng = np.random.default_rng(seed)
    slopes, half = rng.normal(size=(rows, 3)), rng.normal(size=(rows, rows))
    variance = half @ half.T + np.eye(rows)
    precision = np.diag(rng.uniform(0.1, 1.0, 3))
    known = np.linalg.inv(slopes.T @ np.linalg.solve(variance, slopes) + precision)
    found = sandwich(slopes, np.linalg.solve(variance, slopes), variance, precision)
    assert found == pytest.approx(known, rel=1e-8, abs=1e-10)


@given(seed=st.integers(0, 10**6))
def test_other_weights_know_no_more_and_nothing_is_less_known_than_before(seed: int) -> None:
    rng = np.random.default_rng(seed)
    slopes, half = rng.normal(size=(8, 3)), rng.normal(size=(2, 8, 8))
    variance, other = half @ half.transpose(0, 2, 1) + 0.1 * np.eye(8)
    precision = np.diag(rng.uniform(0.1, 1.0, 3))
    best = np.linalg.inv(slopes.T @ np.linalg.solve(variance, slopes) + precision)
    found = sandwich(slopes, np.linalg.solve(other, slopes), variance, precision)
    before = 1.0 / np.diag(precision)
    assert (np.diag(found) <= before * (1 + 1e-9)).all()
    assert (np.diag(found) >= np.minimum(np.diag(best), before) * (1 - 1e-9)).all()


def test_pull_scatters_by_what_is_read_and_its_lack_of_fit_counts_once(
    pulled: Measurements,
) -> None:
    twice = pulled.take(np.repeat(np.arange(len(pulled)), 2))
    twice = replace(twice, run=np.array([f"{run}{i % 2}" for i, run in enumerate(twice.run)]))
    fitter = Problem.of(twice).fitter
    told = dict(zip(fitter.true_variance.names, fitter.true_variance.log_median, strict=True))
    points = fitter.points
    for name in points.forces:
        mine = points.of_channel(name)
        read = float(np.sqrt(np.mean((points.value[mine] / fitter.level[mine]) ** 2)))
        assert np.exp(told[f"own:{name}"]) == pytest.approx(0.03 * read)
        assert f"law:{name}" in told
        assert f"fit:{name}" not in told
    assert "fit:sinkage" in told


@pytest.mark.parametrize("repeated", [False, True])
def test_what_the_law_is_off_by_is_half_of_what_runs_differ_by_where_nothing_was_repeated(
    pulled: Measurements, repeated: bool
) -> None:
    alone = replace(pulled, channels={"sinkage": pulled.channels["sinkage"]})
    if repeated:
        alone = alone.take(np.repeat(np.arange(len(alone)), 2))
        alone = replace(alone, run=np.array([f"{run}{i % 2}" for i, run in enumerate(alone.run)]))
    problem = Problem.of(alone)
    scatter = problem.fitter.true_scatter(problem.fit).deviations
    said = problem.result().measured.runs["sinkage"]
    if repeated:
        assert (said.run, said.law) == (scatter["own:sinkage"], scatter["fit:sinkage"])
    else:
        assert said.run == pytest.approx(said.law)
        assert said.run**2 + said.law**2 == pytest.approx(scatter["own:sinkage"] ** 2)


def test_a_fit_that_begins_with_several_models_says_what_it_leaves_out(
    pulled: Measurements,
) -> None:
    parts = [sw.Model("dry_sand"), sw.Model("dry_sand") + sw.effects.slip_sinkage(a=0.8)]
    both = as_calibrated(parts[0]).changed(rivals=tuple((0.5, as_calibrated(one)) for one in parts))
    found = Problem.of(pulled, base_of(both, pulled)).result()
    assert "several that its data could not tell apart" in found.notes[0]
    assert "no effect (0.50), slip sinkage (0.50)" in found.notes[0]
    plain = Problem.of(pulled, base_of(as_calibrated(parts[0]), pulled)).result()
    assert not any("tell apart: no effect" in note for note in plain.notes)


@pytest.fixture(scope="module")
def pulled() -> Measurements:
    channels = ("sinkage", "resistance", "drawbar_pull", "torque")
    return sw.read(simulate_rig(RigSettings(seed=4, runs=16, channels=channels)).table)


@pytest.mark.parametrize("dropped", ["drawbar_pull", "torque"])
def test_n_and_sinkage_are_known_as_well_with_pull_and_torque(
    pulled: Measurements, dropped: str
) -> None:
    bare = {n: v for n, v in pulled.channels.items() if n in ("sinkage", "resistance")}
    some = {n: v for n, v in pulled.channels.items() if n != dropped}
    at = {"load": 100.0, "diameter": 0.2, "width": 0.1, "slip": 0.3}
    fits = [
        sw.fit(replace(pulled, channels=channels)) for channels in (bare, some, pulled.channels)
    ]
    (first, *more) = [(fit["n"].std, sw.predict(fit.model, **at).rows()[0]["sinkage_std"])
                      for fit in fits]  # fmt: skip
    for (
        n_std,
        sinkage_std,
    ) in more:  # components of the scatter are sought to 0.01 nats, 6 % of a deviation
        assert n_std <= 1.08 * first[0]
        assert sinkage_std <= 1.08 * first[1]
