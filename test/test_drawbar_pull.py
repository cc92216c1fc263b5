"""Drawbar pull as a measurement: what it tells of the soil's strength, and what it must not touch.

The truth is the simulator's: shear stress integrated along the arc, which is another form of the
thrust than the library's.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drawbar_drives import SAND, PullPlan, drive_on, pull_drive, true_pulls
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from random_examples import examples

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.bulldozing import Rankine
from smallwheel_ros.effects.slip_sinkage import Exponential
from smallwheel_ros.estimator.drawbar_observation import force_observation
from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.estimator.soil_estimator import (
    EstimatorError,
    Outcome,
    SinkageMeasurement,
    SoilEstimator,
    SoilPrior,
)
from smallwheel_ros.model import Model, predict
from smallwheel_ros.onboard.mobility import WheelForces, wheel_forces
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.point_thrust import point_contact_length, point_thrust
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.physics.traction import contact_length, thrust
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel
from smallwheel_ros.simulate.truth import TruthSoil

Array = NDArray[np.float64]

PRIOR = SoilPrior.from_soil(SAND)
WHEEL = Wheel("wheel 0", 0.25, 0.10)
GOOD = SinkageMeasurement(
    1.0,
    "left",
    0.012,
    1e-6,
    60.0,
    1.0,
    0.25,
    0.1,
    5.0,
    slip=0.2,
    drawbar_pull=4.0,
    drawbar_pull_variance=0.3,
)


def driven(rows: list[SinkageMeasurement], prior: SoilPrior = PRIOR) -> SoilEstimator:
    e = SoilEstimator(prior)
    for row in rows:
        e.update(row)
    return e


def without_pull(rows: list[SinkageMeasurement]) -> list[SinkageMeasurement]:
    return [replace(row, drawbar_pull=None) for row in rows]


def forces(
    estimate: SoilEstimate, load: float, slip: float, prior: SoilPrior = PRIOR
) -> WheelForces:
    strength = prior.strength_or_usual
    found = wheel_forces(WHEEL, estimate, strength, Quantity(load, 0.0), Quantity(slip, 0.0))
    assert found is not None
    return found


def off(
    estimate: SoilEstimate, truth: TruthSoil, slips: tuple[float, float], prior: SoilPrior = PRIOR
) -> tuple[Array, Array]:
    """Predicted less true pulls (N) over what was driven, and deviations without the scatter."""
    if estimate.strength is not None:
        estimate = replace(estimate, strength=replace(estimate.strength, scatter=0.0))
    table = [
        (forces(estimate, w, i, prior).drawbar_pull, pull)
        for w, i, pull in zip(*(a.tolist() for a in true_pulls(truth, slips)), strict=True)
    ]
    errors = np.array([made.value - pull for made, pull in table])
    return errors, np.array([made.standard_deviation for made, _ in table])


# ---- The forces of one wheel


def test_point_thrust_is_the_thrust_with_its_slopes() -> None:
    rng = np.random.default_rng(3)
    for _ in range(300):
        slip = float(rng.choice([rng.uniform(-1, 1), 1e-6, -1e-6]))
        z, d = rng.uniform(1e-4, 0.12), 0.25
        length, by_z = point_contact_length(z, d)
        assert length == pytest.approx(float(contact_length(z, d)), rel=1e-12)
        step = 1e-7
        rise = contact_length(z + step, d) - contact_length(z - step, d)
        assert by_z == pytest.approx(float(rise) / (2 * step), rel=1e-4)
        x = np.array([rng.uniform(5, 90), slip, length, rng.uniform(0, 2e3), 0.5, 0.012])

        def at(x: Array) -> float:
            w, i, at_length, c, phi, kappa = x.tolist()
            return point_thrust(w, i, at_length, 0.1, c, phi, kappa).value

        got = point_thrust(x[0], x[1], x[2], 0.1, *x[3:])
        whole = thrust(x[0], slip, z, d, 0.1, *x[3:])
        assert got.value == pytest.approx(float(whole), rel=1e-10)
        slopes = (
            got.by_load,
            got.by_slip,
            got.by_length,
            got.by_cohesion,
            got.by_friction,
            got.by_log_shear / x[5],
        )
        if abs(slip) < 1e-5:
            continue  # the step would cross slip 0
        for place, slope in enumerate(slopes):
            h = np.zeros(6)
            h[place] = 1e-6 * max(x[place], 1e-2)
            numeric = (at(x + h) - at(x - h)) / (2.0 * h[place])
            assert slope == pytest.approx(numeric, rel=2e-4, abs=1e-6 * abs(got.limit))


@pytest.mark.parametrize("effects", [(), (Exponential(a=0.7),), (Rankine(),)], ids=str)
def test_observed_forces_are_the_models(effects: tuple[Effect, ...]) -> None:
    observe = force_observation(effects, 70.0, 0.25, 0.08, 0.2, 0.15)

    def model(s: float, n: float, c: float, phi: float, log_kappa: float) -> tuple[float, ...]:
        law = Soil("one", math.exp(s - n * math.log(0.01)), n, 0.0, c, phi, math.exp(log_kappa))
        found = predict(
            Model(law, effects=effects), Conditions.of(70.0, 0.25, 0.08, slip=0.2, speed=0.15)
        )
        return float(found.thrust[0]), float(found.resistance[0]), float(found.sinkage[0])

    x = np.array([10.2, 0.8, 400.0, 0.5, math.log(0.012)])
    got = observe(x[0], x[1], (x[2], x[3], x[4]))
    assert (got.thrust, got.resistance) == pytest.approx(model(*x)[:2], rel=1e-8)

    def slopes(place: int, step: float) -> Array:
        h = np.zeros(5)
        h[place] = step
        return (np.array(model(*(x + h))) - np.array(model(*(x - h)))) / (2 * step)

    by_s, by_n = slopes(0, 1e-4), slopes(1, 1e-4)
    assert got.by_law[0] == pytest.approx(by_s[0], rel=1e-3)
    assert got.resistance_by_law[0] == pytest.approx(by_s[1], rel=1e-3)
    # By n in two parts: what it changes through the sinkage, and at one sinkage.
    through = by_s[1] / by_s[2] * by_n[2]
    assert got.resistance_by_law[1] == pytest.approx(through, rel=1e-3)
    assert got.by_exponent == pytest.approx(by_n[1] - through, rel=1e-3)
    for place, slope in zip((2, 3, 4), got.by_strength, strict=True):
        numeric = slopes(place, 1.0 if place == 2 else 1e-4)[0]
        assert slope == pytest.approx(numeric, rel=1e-3)
    # Under no cohesion the straight line goes on.
    none, below = (observe(x[0], x[1], (c, x[3], x[4])).thrust for c in (0.0, -400.0))
    assert none - below == pytest.approx(got.thrust - none, rel=1e-6)


# ---- What pulls tell


def consistency(seeds: range, plan: PullPlan) -> dict[str, float]:
    """Mean of NEES/3 of (cohesion, friction angle, ln kappa), NIS; errors of predicted pulls."""
    nees, nis, before, after, squared = [], [], [], [], []
    for seed in seeds:
        truth, rows = pull_drive(seed, plan)
        e = SoilEstimator(PRIOR)
        results = [e.update(row).drawbar_pull for row in rows]
        nis += [r.normalised_innovation_squared for r in results if r is not None]
        estimate = e.estimate()
        found = estimate.strength
        given = found.strength.cohesion, found.strength.friction_angle
        kappa = found.strength.shear_displacement
        covariance = found.covariance[:3, :3] / np.outer(*[(1.0, 1.0, kappa.value)] * 2)
        covariance[2, 2] = (kappa.standard_deviation / kappa.value) ** 2
        error = np.array(
            [
                given[0].value - truth.cohesion,
                given[1].value - truth.friction_angle,
                math.log(kappa.value / truth.shear_deformation),
            ]
        )
        nees.append(error @ np.linalg.solve(covariance, error) / 3.0)
        errors, stds = off(estimate, truth, plan.slips)
        after.append(errors)
        squared.append((errors / stds) ** 2)
        before.append(off(replace(estimate, strength=None), truth, plan.slips)[0])
    return {
        "nees": float(np.mean(nees)),
        "nis": float(np.mean(nis)),
        "before": float(np.sqrt(np.mean(np.square(before)))),
        "after": float(np.sqrt(np.mean(np.square(after)))),
        "z": float(np.sqrt(np.mean(squared))),
    }


PLANS = {
    "varied slip": PullPlan(),
    "little slip": PullPlan(slips=(0.05, 0.25)),
    "noisy slip": PullPlan(slip_std=0.03),
    "two sizes": PullPlan(wheels=((0.25, 0.10),) * 2 + ((0.40, 0.12),) * 2),
}


def test_strength_comes_out_within_its_uncertainty() -> None:
    found = consistency(range(6), PullPlan())
    assert found["nees"] < 2.1  # chi-square of 18: 99.5 % are under 2.06 of the mean
    # Under 1: what may be wrong with the sensors is allowed for too.
    assert 0.7 < found["nis"] < 1.2
    assert found["after"] < 0.25 * found["before"]
    assert found["z"] < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", PLANS)
def test_strength_and_pulls_over_many_drives(kind: str) -> None:
    found = consistency(range(60), PLANS[kind])
    print(kind, {name: round(value, 3) for name, value in found.items()})
    # Under 1 is allowed: forms of the thrust differ from drive to drive less than is stated.
    assert 0.3 < found["nees"] < 1.5
    assert 0.7 < found["nis"] < 1.15
    assert found["after"] < 0.33 * found["before"]
    assert found["z"] < 1.3


def test_pulls_leave_the_law_as_it_is() -> None:
    """Not even a strength that is configured 30 % wrong pulls k: the law does not hear of pulls."""
    truth, rows = pull_drive(3)
    given = replace(SAND, cohesion=0.7 * truth.cohesion, friction_angle=0.7 * truth.friction_angle)
    wrong = SoilPrior.from_soil(given)
    alone, with_pulls = (driven(r, wrong).estimate() for r in (without_pull(rows), rows))
    assert alone.strength is None
    assert with_pulls.strength is not None
    assert (alone.k, alone.n, alone.m) == (with_pulls.k, with_pulls.n, with_pulls.m)
    np.testing.assert_array_equal(alone.log_covariance, with_pulls.log_covariance)
    assert alone.soil_changes == with_pulls.soil_changes == 0
    errors, _ = off(with_pulls, truth, (-0.1, 0.5))
    before, _ = off(alone, truth, (-0.1, 0.5), wrong)
    assert np.sqrt(np.mean(errors**2)) < 0.25 * np.sqrt(np.mean(before**2))


def test_strength_far_from_a_sure_prior_is_found_all_the_same() -> None:
    """Configured as exact and wrong: a run of pulls that do not fit opens the strength again."""
    rng = np.random.default_rng(8)
    truth = TruthSoil("firm", 1.7e6, 0.85, 0.35, 3000.0, 0.62, 0.008)
    rows = drive_on(truth, rng)
    exact = Strength(Quantity(0.0, 0.0), Quantity(0.3, 0.01), Quantity(0.02, 0.0))
    e = driven(rows, replace(PRIOR, strength=exact))
    errors, _ = off(e.estimate(), truth, (-0.1, 0.5))
    assert e.drawbar_pull_outliers >= 5
    assert e.soil_changes == 0
    assert np.sqrt(np.mean(errors**2)) < 3.0


def test_repeats_at_one_spot_count_for_one() -> None:
    def left(count: int) -> float:
        e = SoilEstimator(PRIOR)
        for i in range(count):
            e.update(replace(GOOD, time=1.0 + 0.01 * i, drawbar_pull_variance=1e-4))
        return e.estimate().strength.remaining["thrust"]

    # Four times as many would halve the rest, if each counted.
    assert left(1000) == pytest.approx(left(250), rel=0.02)


def test_forces_with_measured_strength_carry_its_uncertainty() -> None:
    """Deviations are those of small changes of everything that is uncertain, by differences."""
    estimate = driven(pull_drive(1)[1]).estimate()
    told = estimate.strength
    load, slip = Quantity(60.0, 1.5), Quantity(0.3, 0.02)
    made = wheel_forces(WHEEL, estimate, told.strength, load, slip, scatter=0.05)

    def at(x: Array) -> Array:
        pressure, n, m, w, i, c, phi, kappa, share = x.tolist()
        strength = Strength(*(Quantity(v, 0.0) for v in (c, phi, kappa)))
        share += told.other_by_n * (n - estimate.n)
        moved = replace(told, strength=strength, other_resistance=Quantity(share, 0.0))
        law = replace(estimate, log_reference_pressure=pressure, n=n, m=m, strength=moved)
        f = wheel_forces(WHEEL, law, strength, Quantity(w, 0.0), Quantity(i, 0.0))
        return np.array(
            [f.thrust.value, f.other_resistance.value, f.drawbar_pull.value, f.margin.value]
        )

    numbers = told.strength
    centre = np.array(
        [
            estimate.log_reference_pressure,
            estimate.n,
            estimate.m,
            load.value,
            slip.value,
            numbers.cohesion.value,
            numbers.friction_angle.value,
            numbers.shear_displacement.value,
            told.other_resistance.value,
        ]
    )
    covariance = np.zeros((9, 9))
    covariance[:3, :3] = estimate.log_covariance
    covariance[0, 0] += 0.05**2
    covariance[3, 3], covariance[4, 4] = 1.5**2, 0.02**2
    covariance[5:, 5:] = told.spot_covariance
    steps = np.array([1e-4, 1e-4, 1e-4, 1e-3, 1e-4, 1.0, 1e-4, 1e-6, 1e-4])
    jacobian = np.array([(at(centre + h) - at(centre - h)) for h in np.diag(steps)]).T / (2 * steps)
    expected = np.sqrt(np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian))
    quantities = made.thrust, made.other_resistance, made.drawbar_pull, made.margin
    got = [q.standard_deviation for q in quantities]
    np.testing.assert_allclose(got, expected, rtol=1e-3)
    np.testing.assert_allclose([q.value for q in quantities], at(centre), rtol=1e-9, atol=1e-9)
    by_parts = made.thrust.value - made.compaction_resistance.value - made.other_resistance.value
    assert made.drawbar_pull.value == pytest.approx(by_parts)


def test_scatter_of_the_thrust_is_learnt() -> None:
    def learnt(scatter: float) -> float:
        plan = PullPlan(scatter=scatter, stops=200)
        return float(
            np.mean([driven(pull_drive(i, plan)[1]).estimate().strength.scatter for i in range(3)])
        )

    assert learnt(0.3) == pytest.approx(0.3, rel=0.35)
    assert learnt(0.02) == pytest.approx(0.1, abs=0.02)  # no soil is assumed to be better


# ---- Words


def test_words_say_what_is_not_determined() -> None:
    e = SoilEstimator(PRIOR)
    e.update(replace(GOOD, drawbar_pull=math.nan))
    (words,) = e.estimate().strength_status
    assert words == "thrust is not determined: no drawbar pull was measured"
    _, rows = pull_drive(0, PullPlan(stops=40, slips=(0.2, 0.22), varied=0.0))
    words = "; ".join(driven(rows).estimate().strength.status)
    assert "slip hardly varied (0." in words
    _, rows = pull_drive(0, PullPlan(stops=200, varied=0.02))
    told = driven(rows).estimate().strength
    assert any("load hardly varied" in line for line in told.status)
    assert told.verdicts["thrust"].startswith("determined")
    assert told.verdicts["cohesion"].startswith("not determined")


# ---- Bad values


@pytest.mark.parametrize(
    ("change", "reason", "words"),
    [
        ({"drawbar_pull": math.nan}, "drawbar_pull_not_finite", "is nan"),
        ({"drawbar_pull": math.inf}, "drawbar_pull_not_finite", "is inf"),
        ({"drawbar_pull_variance": -1.0}, "drawbar_pull_variance_not_positive", "-1 N^2"),
        ({"drawbar_pull_variance": math.nan}, "drawbar_pull_variance_not_positive", "nan"),
        ({"slip": None}, "drawbar_pull_without_slip", "slip is None"),
        ({"slip": math.nan}, "drawbar_pull_without_slip", "slip is nan"),
        ({"slip": 1.5}, "drawbar_pull_without_slip", "slip is 1.5"),
        ({"slip_variance": -0.1}, "drawbar_pull_slip_variance", "-0.1"),
    ],
)
def test_pull_that_cannot_be_used_leaves_the_sinkage(
    change: dict[str, float | None], reason: str, words: str
) -> None:
    e = SoilEstimator(PRIOR)
    result = e.update(replace(GOOD, **change))
    assert result.outcome is Outcome.ACCEPTED
    assert result.drawbar_pull.outcome is Outcome.REFUSED
    assert result.drawbar_pull.reason == reason
    assert words in result.drawbar_pull.message
    assert e.refused == {reason: 1}


def test_pull_of_a_wheel_that_stands_or_is_pressed_is_not_used() -> None:
    e = SoilEstimator(PRIOR)
    assert e.update(GOOD).drawbar_pull.outcome is Outcome.ACCEPTED
    standing = e.update(
        replace(GOOD, time=2.0, slip=None)
    )  # the slip of its rut is not of its pull
    assert standing.drawbar_pull.reason == "drawbar_pull_without_slip"
    pressed = e.update(replace(GOOD, time=3.0, contact="pressed", sinkage=0.008))
    assert pressed.drawbar_pull is None


def test_gross_pull_is_an_outlier_of_its_own() -> None:
    e = driven(pull_drive(0)[1])
    before = e.estimate()
    count = e.drawbar_pull_outliers
    gross = replace(GOOD, wheel="wheel 0", time=1e3, distance=6.0, drawbar_pull=60.0)
    result = e.update(replace(gross, sinkage=e.predict(60.0, 0.25, 0.1).sinkage))
    assert result.outcome is Outcome.ACCEPTED
    assert result.drawbar_pull.reason == "gate"
    assert "drawbar pull 60.0 N, expected" in result.drawbar_pull.message
    assert e.drawbar_pull_outliers == count + 1
    after = e.estimate().strength.strength
    assert after.friction_angle.value == pytest.approx(
        before.strength.strength.friction_angle.value, abs=1e-3
    )


@settings(max_examples=examples(60))
@given(
    st.lists(
        st.tuples(
            st.floats(allow_nan=True),
            st.floats(allow_nan=True),
            st.none() | st.floats(-1.1, 1.1),
            st.floats(0.0, 1e3),
        ),
        min_size=1,
        max_size=30,
    )
)
def test_no_pull_breaks_the_estimate(rows: list[tuple[float, float, float | None, float]]) -> None:
    e = SoilEstimator(PRIOR)
    for i, (pull, variance, slip, way) in enumerate(rows):
        given = replace(GOOD, time=float(i), slip=slip, distance=1e3 * i + way)
        result = e.update(replace(given, drawbar_pull=pull, drawbar_pull_variance=variance))
        assert result.outcome is Outcome.ACCEPTED
        told = e.estimate().strength
        if told is None:
            continue
        quantities = (
            told.strength.cohesion,
            told.strength.friction_angle,
            told.strength.shear_displacement,
            told.other_resistance,
        )
        assert all(math.isfinite(q.value) and q.standard_deviation > 0 for q in quantities)
        assert min(q.value for q in quantities[:3]) >= 0
        std = np.sqrt(np.diag(told.covariance))
        assert np.linalg.eigvalsh(told.covariance / np.outer(std, std)).min() > -1e-9


# ---- Saved


def test_a_restart_goes_on_with_the_strength(tmp_path: Path) -> None:
    path = tmp_path / "soil.json"
    _, rows = pull_drive(2)
    first = driven(rows)
    first.save(path)
    again = SoilEstimator(PRIOR)
    again.restore(path)
    before, after = first.estimate().strength, again.estimate().strength
    np.testing.assert_allclose(after.covariance, before.covariance, rtol=1e-9)
    assert after.strength.friction_angle.value == pytest.approx(
        before.strength.friction_angle.value, rel=1e-12
    )
    assert (after.accepted, after.status) == (before.accepted, before.status)
    driven_on = [again.update(row).drawbar_pull for row in rows[:40]]
    assert [r.outcome for r in driven_on].count(Outcome.ACCEPTED) >= 38
    other = SoilEstimator(replace(PRIOR, strength=Strength(*[Quantity(0.4, 0.1)] * 3)))
    with pytest.raises(EstimatorError, match="another prior of the soil's strength"):
        other.restore(path)
    assert other.accepted == 0


def test_a_saved_strength_is_checked_and_an_older_file_has_none(tmp_path: Path) -> None:
    path = tmp_path / "soil.json"
    driven(pull_drive(2, PullPlan(stops=20))[1]).save(path)
    whole = json.loads(path.read_text())
    older = {name: value for name, value in whole.items() if name != "strength"}
    path.write_text(json.dumps(older))
    e = SoilEstimator(PRIOR)
    e.restore(path)
    assert e.accepted > 0
    assert e.estimate().strength is None
    for name, value in (
        ("covariance", np.diag([1.0, 1.0, 1.0, -1.0]).tolist()),
        ("deviation", [0.0, math.inf, 0.0, 0.0]),
        ("mean", [1.0]),
        ("slips", [0.5, 0.1]),
        ("accepted", 0),
        ("scattered", [1.0, -1.0, 60.0]),
        ("exponent", "n"),
    ):
        path.write_text(json.dumps(whole | {"strength": whole["strength"] | {name: value}}))
        with pytest.raises(EstimatorError, match="not a whole saved soil"):
            SoilEstimator(PRIOR).restore(path)


@pytest.mark.parametrize("name", ["cohesion", "friction_angle", "shear_displacement"])
def test_prior_strength_is_checked(name: str) -> None:
    for bad in (Quantity(-1.0, 0.1), Quantity(math.nan, 0.1), Quantity(0.1, -0.1)):
        with pytest.raises(EstimatorError, match=name):
            replace(PRIOR, strength=replace(PRIOR.strength_or_usual, **{name: bad}))
