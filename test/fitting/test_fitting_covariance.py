# SPDX-License-Identifier: Apache-2.0
"""Deviations of fitted numbers: right size, right units, and not moved by what should not move them.

Tests `noise.py` and `variance.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from fitted import fit_model
from plain_rig import PlainRig, PlainSoil, joined
from scipy.stats import binom

from smallwheel_ros.effects.base import Array, parameter
from smallwheel_ros.effects.registry import effect
from smallwheel_ros.effects.slip import BySlip
from smallwheel_ros.fitting import Base, FitResult, Problem
from smallwheel_ros.fitting.fit import FittingError, inverse
from smallwheel_ros.fitting.parameters import part_of
from smallwheel_ros.fitting.posterior import posterior_covariance
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.physics.conditions import Conditions

GROWTH = 1.5


@dataclass(frozen=True)
class Linear(BySlip):
    """The rig's own law, of one number."""

    id = "slip_sinkage"
    form = "linear"
    summary = formula = "z = z0 (1 + s i)"
    source = "this test"

    s: float = parameter(2.0, (0.0, 20.0), "growth of sinkage with slip", published=(0.3, 12.0))

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return np.asarray(sinkage * (1.0 + self.s * self.slip(conditions)))


RIG = PlainRig(slip_growth=GROWTH)
RUNS = [{"load": w, "slip": i} for w in (20.0, 40.0, 80.0, 120.0) for i in (0.0, 0.2, 0.4)]


def fitted(measured: Measurements, *more: str) -> FitResult:
    return fit_model(measured, [Linear(), *(effect(name) for name in more)])


def numbers(fit: FitResult) -> dict[str, tuple[float, float]]:
    return {p.full_name: (p.value, p.std) for p in fit.parameters if p.std is not None}


# (a) parameters of very different size


def test_a_tiny_parameter_does_not_shrink_the_deviations_of_the_others() -> None:
    """elastic_rebound's compliance is 1e-8 m/Pa beside numbers of about 1."""
    measured = RIG.measure(RUNS, 4)
    alone, beside = numbers(fitted(measured)), numbers(fitted(measured, "elastic_rebound"))
    for name, (_, std) in alone.items():
        assert beside[name][1] > 0.9 * std


def test_deviations_agree_with_those_of_scaled_parameters() -> None:
    """Brute force: slopes by central differences, each number in units of its prior's deviation."""
    measured = RIG.measure(RUNS, 4)
    z, at = measured.channels["sinkage"], measured.conditions
    z -= 1e-7 * at.load / (at.width * np.sqrt(at.diameter * z))  # so that no bound is met
    points = Problem.of(measured).points
    parts = (part_of(Linear()), part_of(effect("elastic_rebound")))
    problem = Problem(points, Base(parts=parts))
    fitter, fit = problem.fitter, problem.fit
    vector = fit.vector
    scale = vector.scale
    assert scale.max() / scale.min() > 1e6
    steps = 1e-3 * scale
    inside = (fit.theta - steps > vector.bounds[0]) & (fit.theta + steps < vector.bounds[1])
    assert inside.all()
    slopes = np.column_stack(
        [
            (fitter.predictor(vector, fit.theta + h) - fitter.predictor(vector, fit.theta - h))
            / 2e-3
            for h in np.diag(steps)
        ]
    )
    stiff = slopes[:, [n.endswith("log_reference_pressure") for n in vector.names]] / 3.0
    noise = fitter.variance.covariance(fit.scatter, stiff[:, 0])
    prior = vector.precision(fit.theta) * np.outer(scale, scale)
    scaled = np.linalg.inv(slopes.T @ noise.solve(slopes) + prior)
    expected = np.sqrt(np.diag(scaled)) * scale
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance)), expected, rtol=0.02)
    # What is reported adds what the components' own uncertainty brings, and never takes away.
    reported = np.sqrt(np.diag(posterior_covariance(fitter, fit, fit.scatter)))
    assert np.all(reported > 0.9 * expected)
    assert np.all(reported < 2.0 * expected)


@pytest.mark.parametrize("sizes", [(1.0, 1.0, 1.0), (1.0, 1e-8, 1e6), (1e-150, 1.0, 1e100)])
def test_the_inverse_does_not_depend_on_the_units(sizes: tuple[float, ...]) -> None:
    unit = np.array([[1.0, 0.6, -0.3], [0.6, 1.0, 0.2], [-0.3, 0.2, 1.0]])
    matrix = unit / np.outer(sizes, sizes)
    expected = np.linalg.inv(unit) * np.outer(sizes, sizes)
    np.testing.assert_allclose(inverse(matrix), expected, rtol=1e-10)


def test_what_has_no_information_is_refused_and_not_inverted() -> None:
    with pytest.raises(FittingError, match="no influence"):
        inverse(np.diag([1.0, 0.0]))
    with pytest.raises(FittingError, match="told apart"):
        inverse(np.ones((2, 2)))


# (b) declared standard deviations


@pytest.mark.parametrize("factor", [3.0, 1.0 / 3.0])
def test_wrong_declared_deviations_hardly_matter_beside_repeats(factor: float) -> None:
    right, wrong = (fitted(RIG.measure(RUNS, 6, declared=f)) for f in (1.0, factor))
    for (value, std), (other, other_std) in zip(
        numbers(right).values(), numbers(wrong).values(), strict=True
    ):
        assert abs(value - other) < 0.1 * std
        assert other_std == pytest.approx(std, rel=0.1)
    assert wrong.run_scatter["ln k"] == pytest.approx(right.run_scatter["ln k"], rel=0.1)
    assert wrong.noise["sinkage"].absolute == pytest.approx(
        right.noise["sinkage"].absolute, rel=0.2
    )


@pytest.mark.parametrize("factor", [3.0, 1.0 / 3.0])
def test_wrong_declared_deviations_do_not_pass_for_scatter_of_the_soil(factor: float) -> None:
    """Without repeats, medians over a few tables: true scatter 0.05 of ln k."""
    runs = RUNS * 3
    scatter, deviations = [], []
    for seed in range(5):
        fits = [fitted(RIG.measure(runs, seed, rows=1, declared=f)) for f in (1.0, factor)]
        scatter.append([fit.run_scatter["ln k"] for fit in fits])
        deviations.append([numbers(fit)["slip_sinkage.s"][1] for fit in fits])
    right, wrong = np.median(scatter, axis=0)
    assert 0.03 < right < 0.07
    assert wrong == pytest.approx(right, rel=0.25)
    narrow, other = np.median(deviations, axis=0)
    assert 0.6 < other / narrow < 1.8


# (c) coverage of the intervals


def repeated(seed: int) -> Measurements:
    return RIG.measure(RUNS, seed)


def declared_high(seed: int) -> Measurements:
    return RIG.measure(RUNS, seed, rows=1, declared=3.0)


def declared_low(seed: int) -> Measurements:
    return RIG.measure(RUNS, seed, rows=1, declared=1.0 / 3.0)


LOAM = PlainRig(PlainSoil(k=300e3, n=1.0), slip_growth=GROWTH)
FOUR = [
    {"load": 20.0, "slip": 0.0},
    {"load": 50.0, "slip": 0.3},
    {"load": 80.0, "slip": 0.1},
    {"load": 120.0, "slip": 0.5},
]


def two_soils(seed: int) -> Measurements:
    """Four runs in each: fewer than the soils and the effect have numbers, but for the priors."""
    return joined(
        RIG.measure(FOUR, seed, name="sand"), LOAM.measure(FOUR, seed + 50_000, name="loam")
    )


TRUTHS = {"soil": RIG.soil, "sand": RIG.soil, "loam": LOAM.soil}
CASES: list[Callable[[int], Measurements]] = [repeated, declared_high, declared_low, two_soils]


def counted(case: Callable[[int], Measurements], seeds: range) -> dict[str, tuple[int, float]]:
    """By parameter, in how many tables its 95 % interval holds the truth, and how wide it is.

    Width: mean stated deviation over the rms error.
    """
    off: dict[str, list[float]] = {}
    stated: dict[str, list[float]] = {}
    for seed in seeds:
        for p in fitted(case(seed)).parameters:
            if p.status == "held":
                continue
            truth = GROWTH if p.owner == "slip_sinkage" else getattr(TRUTHS[p.owner], p.name)
            assert p.std is not None
            off.setdefault(p.full_name, []).append(p.value - truth)
            stated.setdefault(p.full_name, []).append(p.std)
    found = {}
    for name, errors in off.items():
        inside = np.abs(errors) < 1.96 * np.array(stated[name])
        width = float(np.mean(stated[name]) / np.sqrt(np.mean(np.square(errors))))
        found[name] = int(inside.sum()), width
    return found


def fewest(tables: int, intervals: int) -> int:
    """How many must hold the truth, so that chance breaks one of so many 1 time in 1000."""
    return int(binom.ppf(1e-3 / intervals, tables, 0.95))


@pytest.mark.parametrize("case", CASES)
def test_intervals_hold_the_truth(case: Callable[[int], Measurements]) -> None:
    found = counted(case, range(12))
    assert {"slip_sinkage.s"} < set(found)
    for count, _ in found.values():
        assert count >= fewest(12, len(found))


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_intervals_hold_the_truth_in_200_tables(case: Callable[[int], Measurements]) -> None:
    """At least as often as they say; twice as wide as the errors at most."""
    for count, width in counted(case, range(1000, 1200)).values():
        assert count >= fewest(200, 5)
        assert width < 2.0


# (d) weights


def test_noisy_sinkage_is_not_fitted_low() -> None:
    """Weights that follow each measured value favour the low ones: 1.9 % at 15 % of noise."""
    rig = PlainRig(noise=0.15, soil_scatter=0.0, channels=("sinkage",))
    runs = [{"load": w, "diameter": d} for w in np.geomspace(15, 120, 20) for d in (0.15, 0.25)]
    load, diameter = (np.array([run[name] for run in runs]) for name in ("load", "diameter"))
    true = rig.soil.sinkage(load, diameter, np.full(load.size, 0.1), np.ones(load.size))
    shares = []
    for seed in range(12):
        measured = rig.measure(runs, seed, rows=1)
        fit = fit_model(measured).predict(measured.conditions).sinkage
        # less the noise that was drawn, whose mean is none: what is left is the fit's own doing
        shares.append(np.mean((fit - measured.channels["sinkage"]) / true))
    error = float(np.std(shares, ddof=1) / np.sqrt(len(shares)))
    assert error < 0.002
    assert abs(np.mean(shares)) < 0.005
