"""Is the estimator as sure as it may be, and as good as a fit of all data at once?

The truth is a numerical contact integral of its own (`simulate.truth`), with soils drawn from the
prior, soil that drifts and scatters along the way, and loads that vary as on uneven ground.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import block_diag, solve_triangular
from scipy.optimize import least_squares
from scipy.stats import chi2

from smallwheel_ros.estimator.soil_estimator import (
    EstimatorSettings,
    SinkageMeasurement,
    SoilEstimator,
    SoilPrior,
)
from smallwheel_ros.physics.contact import contact_sinkage
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.simulate.truth import static_sinkage

Array = NDArray[np.float64]

SAND = soil("dry_sand")
STD = np.array([0.7, 0.3, 0.4])  # of ln pressure, n and m, as in `SoilPrior.from_soil`
ONE_SIZE = ((0.25, 0.10),) * 4
TWO_SIZES = ((0.25, 0.10),) * 2 + ((0.40, 0.12),) * 2


@dataclass(frozen=True)
class Plan:
    """A kind of drive. varied: amplitude of ln load over the way."""

    wheels: tuple[tuple[float, float], ...] = ONE_SIZE
    stops: int = 120  # places on the way, 0.05 m apart, at which each wheel is measured
    varied: float = 0.25
    load_noise: float = 0.012
    drift: float = 0.02  # process noise of ln pressure, 1/sqrt(m)


@dataclass(frozen=True)
class Sample:
    """Measurements in order, and the soil (ln pressure, n, m) at the end."""

    plan: Plan
    measurements: list[SinkageMeasurement]
    truth: Array


def walk(rng: np.random.Generator, steps: int, std: float, keep: float) -> Array:
    """A stationary random process with this standard deviation and correlation of neighbours."""
    values = std * rng.standard_normal(steps)
    for i in range(1, steps):
        values[i] = keep * values[i - 1] + math.sqrt(1.0 - keep * keep) * values[i]
    return values


def sample(plan: Plan, seed: int) -> Sample:
    """Simulate; a soil that does not carry the wheels, or none at all, is drawn again."""
    rng = np.random.default_rng([seed, 77])
    step, stops = 0.05, plan.stops
    length = 2.0 * (STD[0] / plan.drift) ** 2 if plan.drift else math.inf
    way = step * np.arange(stops)
    while True:
        keep = math.exp(-step / length)
        off = [
            walk(rng, stops, std, keep) if plan.drift else std * rng.standard_normal()
            for std in STD
        ]
        pressure, n, m = (
            mean + part + np.zeros(stops)
            for mean, part in zip((SAND.log_reference_pressure, SAND.n, SAND.m), off, strict=True)
        )
        if n.min() < 0.05:
            continue
        table = []
        for diameter, width in plan.wheels:
            scatter = walk(rng, stops, 0.06, math.exp(-step / 0.2))
            phase = rng.uniform(0, 2 * np.pi, 2)
            swing = np.sin(2 * np.pi * way / 2.3 + phase[0]) + np.sin(
                2 * np.pi * way / 7 + phase[1]
            )
            load = 55.0 * np.exp(0.7 * plan.varied * swing)
            modulus = np.exp(pressure + scatter - n * math.log(0.01) + m * math.log(diameter / 0.2))
            z = static_sinkage(
                lambda depth, K=modulus, n=n: K[:, None] * depth ** n[:, None],
                load,
                np.full(stops, diameter),
                np.full(stops, width),
            )
            shown = z + np.hypot(5e-4, 0.03 * z) * rng.standard_normal(stops)
            weighed = load * (1.0 + plan.load_noise * rng.standard_normal(stops))
            table.append((shown, weighed))
        deepest = max(
            float(np.max(shown / plan.wheels[j][0])) for j, (shown, _) in enumerate(table)
        )
        if deepest < 0.45:
            break
    measurements = [
        SinkageMeasurement(
            0.1 * i + 0.01 * j,
            f"wheel {j}",
            max(float(shown[i]), 1e-4),
            float(np.hypot(5e-4, 0.03 * shown[i]) ** 2),
            float(weighed[i]),
            float((plan.load_noise * weighed[i]) ** 2),
            *plan.wheels[j],
            float(way[i]),
        )
        for i in range(stops)
        for j, (shown, weighed) in enumerate(table)
    ]
    return Sample(plan, measurements, np.array([pressure[-1], n[-1], m[-1]]))


def filtered(given: Sample) -> tuple[Array, Array, Array]:
    """Estimate (3,), covariance (3, 3), and the normalised innovations squared."""
    settings = EstimatorSettings(process_noise=given.plan.drift)
    e = SoilEstimator(SoilPrior.from_soil(SAND), settings)
    results = [e.update(one) for one in given.measurements]
    estimate = e.estimate()
    return (
        np.array([estimate.log_reference_pressure, estimate.n, estimate.m]),
        estimate.log_covariance,
        np.array([r.normalised_innovation_squared for r in results], dtype=float),
    )


def fitted(given: Sample) -> Array:
    """Maximum a posteriori fit of all measurements at once, soil without drift: the limit."""
    rows = given.measurements
    load, diameter, width, measured, way = (
        np.array([getattr(one, name) for one in rows])
        for name in ("load", "diameter", "width", "sinkage", "distance")
    )
    instrument = np.array([one.variance for one in rows])
    weighing = np.array([one.load_variance for one in rows]) / load**2
    order = np.argsort([one.wheel for one in rows], kind="stable")
    wheels = np.split(order, len(given.plan.wheels))
    prior = np.array([SAND.log_reference_pressure, SAND.n, SAND.m])

    def expected(law: Array) -> tuple[Array, Array]:
        pressure, n, m = law
        n = float(np.clip(n, 0.02, 2.9))
        modulus = np.exp(pressure - n * math.log(0.01) + m * np.log(diameter / 0.2))
        found = contact_sinkage(load, diameter, width, modulus, np.full(load.size, n))
        return found.sinkage, found.sinkage * found.slope_load

    law = prior
    for _ in range(6):
        slope = expected(law)[1]
        blocks = []
        for rows_of in wheels:
            apart = np.abs(way[rows_of][:, None] - way[rows_of][None, :])
            common = 0.06**2 * np.exp(-apart / 0.2) + np.diag(weighing[rows_of])
            blocks.append(
                common * np.outer(slope[rows_of], slope[rows_of]) + np.diag(instrument[rows_of])
            )
        root = np.linalg.cholesky(block_diag(*blocks))

        def residuals(x: Array, root: Array = root) -> Array:
            miss = (measured - expected(x)[0])[order]
            return np.concatenate([solve_triangular(root, miss, lower=True), (x - prior) / STD])

        law = least_squares(residuals, law, method="lm").x
    return law


def consistency(plan: Plan, drives: int) -> tuple[float, float, float]:
    """Average NEES over its expectation 3, average NIS, and the standard error of that by drives."""
    nees, nis = [], []
    for seed in range(drives):
        given = sample(plan, seed)
        mean, covariance, innovations = filtered(given)
        error = mean - given.truth
        nees.append(error @ np.linalg.solve(covariance, error))
        nis.append(np.mean(innovations))
    error = float(np.std(nis)) / math.sqrt(drives)
    return float(np.mean(nees)) / 3.0, float(np.mean(nis)), error


def band(freedom: int, confidence: float) -> tuple[float, float]:
    """Where the average of chi-squares with one degree of freedom each lies so often."""
    tail = 0.5 * (1.0 - confidence)
    return tuple(chi2.ppf([tail, 1.0 - tail], freedom) / freedom)


def errors(plan: Plan, drives: int) -> tuple[Array, Array]:
    """Errors of filter and fit in ln effective modulus, n and m; shapes (drives, 3)."""
    by = []
    for seed in range(drives):
        given = sample(replace(plan, drift=0.0), seed)
        both = []
        for found in (filtered(given)[0], fitted(given)):
            off = found - given.truth
            # ln of k D^m at the first wheel's diameter, from ln of the pressure at 10 mm
            across = math.log(plan.wheels[0][0] / 0.2)
            both.append([off[0] - off[1] * math.log(0.01) + off[2] * across, off[1], off[2]])
        by.append(both)
    found = np.array(by)
    return found[:, 0], found[:, 1]


KINDS = {
    "one size": Plan(),
    "one size, one load": Plan(varied=0.0, load_noise=0.03),
    "two sizes": Plan(wheels=TWO_SIZES),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_few_drives_are_about_consistent(kind: str) -> None:
    nees, nis, _ = consistency(KINDS[kind], 12)
    low, high = band(3 * 12, 0.999)
    assert low < nees < high
    assert nis == pytest.approx(1.0, abs=0.08)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_errors_and_innovations_are_as_large_as_the_filter_says(kind: str) -> None:
    drives = 1000
    nees, nis, error = consistency(KINDS[kind], drives)
    print(f"{kind}: NEES/3 {nees:.3f}, NIS {nis:.4f} +- {error:.4f}")
    low, high = band(3 * drives, 0.95)
    assert low < nees < high
    # The innovations of one drive have an n in common, which scales them all where n stays open:
    # the band comes from the drives' own spread, not from independent chi-squares.
    assert abs(nis - 1.0) < 1.96 * error


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["one size", "two sizes"])
def test_filter_is_as_good_as_a_fit_of_everything(kind: str) -> None:
    filter_errors, fit_errors = errors(KINDS[kind], 200)
    ratio = np.sqrt(np.mean(filter_errors**2, axis=0) / np.mean(fit_errors**2, axis=0))
    print(f"{kind}: error over the fit's, effective modulus, n, m: {np.round(ratio, 3)}")
    assert ratio[0] < 1.1
    assert ratio[1] < 1.1
    if kind == "two sizes":
        assert ratio[2] < 1.1
