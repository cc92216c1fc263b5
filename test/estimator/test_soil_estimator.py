# SPDX-License-Identifier: Apache-2.0
"""What the estimator does with one measurement: order, refusals, counts, predictions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from wheel_drives import READING, STEP, changed, follow, rolled, varied

from smallwheel_ros.effects.registry import families
from smallwheel_ros.effects.slip import Exponential
from smallwheel_ros.estimator.soil_estimator import (
    EstimatorError,
    EstimatorSettings,
    Outcome,
    SoilEstimator,
    SoilPrior,
)
from smallwheel_ros.estimator.wheel_sinkage import Law, LoadedWheel, point_sinkage, wheel_sinkage
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.contact import contact_load, contact_sinkage
from smallwheel_ros.physics.soil import SOILS, Soil, soil
from smallwheel_ros.physics.wheel import Quantity, Wheel

GOOD = READING
GIVEN = {"load", "diameter", "width", "slip", "speed"}  # what a measurement says of a wheel
EFFECTS = [form for forms in families().values() for form in forms]
USABLE = [form for form in EFFECTS if not set(form().needs) - GIVEN]
UNUSABLE = [form for form in EFFECTS if form not in USABLE]


def estimator(**settings: float) -> SoilEstimator:
    return SoilEstimator(SoilPrior.from_soil(soil("dry_sand")), EstimatorSettings(**settings))


def snapshot(e: SoilEstimator) -> tuple[np.ndarray, np.ndarray]:
    estimate = e.estimate()
    return estimate.log_covariance, np.array([estimate.k, estimate.n, estimate.m])


# ---- The sinkage of one wheel


def test_point_sinkage_is_the_contact_integral() -> None:
    rng = np.random.default_rng(0)
    rows = 4000
    n, d = rng.uniform(0.05, 2.9, rows), rng.uniform(0.05, 1.5, rows)
    b, modulus = rng.uniform(0.02, 0.5, rows), 10 ** rng.uniform(3, 8, rows)
    ratio = 10 ** rng.uniform(-5, np.log10(0.65), rows)
    load = contact_load(np.minimum(ratio, 0.5) * d, d, b, modulus, n)
    load *= np.where(ratio > 0.5, 2 * ratio, 1.0)
    expected = contact_sinkage(load, d, b, modulus, n)
    each = zip(load, d, b, np.log(modulus), n, strict=True)
    points = [point_sinkage(*map(float, row)) for row in each]
    log_z, slope_load, slope_exponent, sunk = (np.array(c) for c in zip(*points, strict=True))
    assert (sunk == expected.sunk_to_axle).all()
    assert 0 < sunk.sum() < rows
    np.testing.assert_allclose(np.exp(log_z), expected.sinkage, rtol=1e-10)
    shallow = ratio < 0.4  # nearer to the axle both stop where slopes are good to 1e-6 only
    np.testing.assert_allclose(slope_load[shallow], expected.slope_load[shallow], rtol=1e-7)
    np.testing.assert_allclose(slope_exponent[shallow], expected.slope_exponent[shallow], atol=1e-6)
    np.testing.assert_allclose(slope_load[~sunk], expected.slope_load[~sunk], rtol=1e-4)


@pytest.mark.parametrize("contact", ["rolling", "pressed"])
@pytest.mark.parametrize("effect_class", [None, *USABLE], ids=str)
def test_wheel_sinkage_is_the_model(effect_class: type | None, contact: str) -> None:
    """With any effect: what the filter expects is what `model.predict` says, slopes included."""
    effects = () if effect_class is None else (effect_class(),)
    wheel = LoadedWheel(70.0, 0.25, 0.08, contact, slip=0.2, speed=0.15)
    law = Law(math.log(1.6e6), 0.8, 0.39)

    def shown(numbers: np.ndarray) -> float:
        log_modulus, n, m, log_load = numbers.tolist()
        conditions = Conditions.of(
            math.exp(log_load), wheel.diameter, wheel.width, contact=contact, slip=0.2, speed=0.15
        )
        one = Soil("one", math.exp(log_modulus - m * math.log(0.2)), n, m)
        return float(predict(Model(one, effects=effects), conditions).sinkage[0])

    got = wheel_sinkage(law, wheel, effects)
    at = np.array([*law, math.log(wheel.load)])
    assert got.value == pytest.approx(shown(at), rel=1e-8)
    for slope, step in zip(got.slopes, 1e-4 * np.eye(4), strict=True):
        either = shown(at + step) - shown(at - step)
        assert slope == pytest.approx(either / 2e-4, rel=1e-4, abs=1e-8)
    assert not got.sunk_to_axle


# ---- Refusals


@pytest.mark.parametrize(
    ("change", "reason", "words"),
    [
        ({"sinkage": math.nan}, "not_finite", "sinkage is nan"),
        ({"load": math.inf}, "not_finite", "load is inf"),
        ({"load_std": math.nan}, "not_finite", "deviation of load"),
        ({"time": math.nan}, "not_finite", "stamp"),
        ({"distance": -math.inf}, "not_finite", "distance"),
        ({"diameter": math.inf}, "not_finite", "diameter"),
        ({"load": 0.0}, "load_not_positive", "load is 0 N"),
        ({"load": -5.0}, "load_not_positive", "load is -5 N"),
        ({"diameter": 0.0}, "geometry_not_positive", "diameter 0 m"),
        ({"width": -0.1}, "geometry_not_positive", "width -0.1 m"),
        ({"load_std": -1.0}, "load_variance_negative", "-1 N"),
        ({"path": math.nan}, "not_finite", "path is nan"),
        ({"pitch": math.inf}, "not_finite", "pitch is inf"),
        ({"sinkage": -0.11}, "sinkage_negative", "minus half of the diameter"),
        ({"sinkage": 0.11}, "sunk_to_axle", "half of the diameter"),
        ({"contact": "hovering"}, "unknown_contact", "hovering"),
    ],
)
def test_bad_measurements_are_refused(change: dict[str, float], reason: str, words: str) -> None:
    e = estimator()
    for first in (False, True):
        if first:
            assert e.update(GOOD).outcome is Outcome.ACCEPTED
        before = snapshot(e)
        result = e.update(changed(GOOD, **({"time": 2.0} | change)))
        assert (result.outcome, result.reason) == (Outcome.REFUSED, reason)
        assert words in result.message
        assert "left" in result.message
        assert result.predicted_sinkage is None
        assert result.normalised_innovation_squared is None
        for was, now in zip(before, snapshot(e), strict=True):
            np.testing.assert_array_equal(was, now)
    assert e.update(changed(GOOD, time=3.0)).outcome is Outcome.ACCEPTED


def test_order_is_kept_for_each_wheel() -> None:
    e = estimator()
    e.update(GOOD)
    assert e.update(GOOD).reason == "time_backwards"
    assert e.update(changed(GOOD, time=0.5)).reason == "time_backwards"
    assert e.update(changed(GOOD, time=2.0, distance=4.9)).reason == "distance_backwards"
    # Another wheel has a clock of its own, and may be a little behind in distance.
    other = changed(GOOD, wheel="right", time=0.9, distance=4.99)
    assert e.update(other).outcome is Outcome.ACCEPTED
    assert e.estimate().distance == 5.0


def test_wheels_without_end_are_refused() -> None:
    e = estimator()
    reasons = [e.update(changed(GOOD, wheel=str(i))).reason for i in range(70)]
    assert reasons.count("too_many_wheels") == 6


def test_effects_need_their_covariates() -> None:
    prior = SoilPrior.from_soil(soil("dry_sand"))
    e = SoilEstimator(prior, effects=(Exponential(a=1.5),))
    assert e.update(GOOD).reason == "covariate_missing"
    assert e.update(changed(GOOD, slip=math.nan)).reason == "not_finite"
    result = e.update(changed(GOOD, slip=0.3))
    assert result.outcome is Outcome.ACCEPTED
    plain = estimator().update(GOOD)
    assert result.predicted_sinkage == pytest.approx(plain.predicted_sinkage * math.exp(0.45))
    with pytest.raises(EstimatorError, match=r"expected|needs slip"):
        e.predict(60.0, 0.2, 0.1)


@pytest.mark.parametrize("form", UNUSABLE, ids=str)
def test_effects_of_what_the_estimator_is_not_given_are_refused(form: type) -> None:
    prior = SoilPrior.from_soil(soil("dry_sand"))
    with pytest.raises(EstimatorError, match="which the estimator is not given"):
        SoilEstimator(prior, effects=(form(),))


@pytest.mark.parametrize("deviation", [0.0, -1.0, 1.0, math.nan, math.inf])
def test_what_a_sensor_says_of_its_noise_changes_nothing(deviation: float) -> None:
    """The noise is learnt from the readings."""
    readings = rolled(varied(80), 1)
    other = [changed(one, sinkage=Quantity(one.measured[1], deviation)) for one in readings]
    for was, now in zip(
        snapshot(follow(estimator(), readings)),
        snapshot(follow(estimator(), other)),
        strict=True,
    ):
        np.testing.assert_array_equal(was, now)


# ---- Results and predictions


def test_result_adds_up() -> None:
    result = estimator().update(GOOD)
    assert (result.message, result.reason) == ("", "accepted")
    assert result.innovation == pytest.approx(0.012 - result.predicted_sinkage)
    # Expected is the prior's sinkage; what the sensor may show is less sure than the sinkage.
    assert result.innovation_variance > result.predicted_variance
    square = result.innovation**2 / result.innovation_variance
    assert result.normalised_innovation_squared == pytest.approx(square)
    prior = SoilPrior.from_soil(soil("dry_sand"))
    conditions = Conditions.of(load=60.0, diameter=0.2, width=0.1)
    expected = predict(Model(prior.soil), conditions).sinkage[0]
    assert result.predicted_sinkage == pytest.approx(expected)


def test_the_soil_is_learnt_stretch_by_stretch() -> None:
    e = estimator()
    fresh = snapshot(e)
    readings = rolled(varied(200), 1)
    # Up to the first 0.2 m of its path a wheel has taught nothing.
    follow(e, readings[:8])
    for was, now in zip(fresh, snapshot(e), strict=True):
        np.testing.assert_allclose(was, now, rtol=1e-9, atol=1e-12)
    assert e.accepted == 0
    e.update(readings[8])
    assert e.accepted == 8
    assert snapshot(e)[0][0, 0] < 0.5 * fresh[0][0, 0]
    # The first ten are used at once, the others wait for 0.6 m: the soil may end on them.
    used = []
    for one in readings[9:]:
        e.update(one)
        used.append(e.accepted + e.outliers)
    assert used[70] >= 9 * 8
    assert used[100] == used[72]
    assert 200 - 6 * 8 <= used[-1] <= 200 - 4 * 8


def test_a_wheel_that_stands_teaches_nothing_more() -> None:
    e = follow(estimator(), rolled(varied(100), 1))
    before, accepted = snapshot(e), e.accepted
    last = changed(GOOD, time=20.0, distance=STEP * 99)
    for i in range(3000):
        e.update(changed(last, time=20.0 + 0.1 * i, sinkage=0.05))
    for was, now in zip(before, snapshot(e), strict=True):
        np.testing.assert_array_equal(was, now)
    assert e.accepted == accepted
    assert e.soil_changes == 0


def test_turning_on_the_spot_is_travel_of_the_wheel() -> None:
    """The vehicle stays where it is, its wheels do not (R5)."""
    standing, turning = estimator(), estimator()
    for i in range(200):
        one = changed(GOOD, time=0.1 * i, sinkage=0.012 + 1e-4 * (i % 3), distance=5.0)
        standing.update(one)
        turning.update(changed(one, path=0.026 * i))
    assert standing.accepted == 0
    assert turning.accepted == 24 * 8 - 8 * 8  # eight stretches wait
    assert turning.estimate().distance == 5.0


def test_firm_ground_is_not_biased_by_readings_below_zero() -> None:
    """True 0.5 mm under 1 mm of noise (R6): every third reading is negative, and all count."""
    firm = {"factor": 21.0, "noise": 1e-3}
    e = estimator(sinkage_zero_std=2e-4)
    readings = rolled(varied(2000), 4, **firm)
    true = float(
        np.mean([one.measured[1] for one in rolled(varied(2000), 4, factor=21.0, noise=0.0)])
    )
    assert 3e-4 < true < 7e-4
    assert sum(one.measured[1] < 0.0 for one in readings) > 400
    outcomes = [e.update(one).outcome for one in readings]
    assert Outcome.REFUSED not in outcomes
    predicted = e.predict(60.0, 0.2, 0.1)
    assert predicted.sinkage == pytest.approx(true, abs=1.5e-4)
    assert abs(predicted.sinkage - true) < 3.0 * predicted.standard_deviation


def test_gate_names_what_did_not_fit_and_it_is_left_out() -> None:
    readings = rolled(varied(160), 2)
    wild = changed(readings[100], sinkage=0.06)
    with_it, without = estimator(), estimator()
    follow(with_it, readings[:100])
    result = with_it.update(wild)
    assert (result.outcome, result.reason) == (Outcome.OUTLIER, "gate")
    assert "sinkage 60.0 mm, expected" in result.message
    assert result.normalised_innovation_squared > 10.8
    follow(with_it, readings[101:])
    follow(without, readings)
    assert with_it.outliers == without.outliers + 1
    shift = with_it.estimate().log_reference_pressure - without.estimate().log_reference_pressure
    assert abs(shift) < 0.02


def test_predict_knows_the_wheels_rut_and_the_place() -> None:
    e = estimator()
    fresh = e.predict(60.0, 0.2, 0.1)
    follow(e, rolled(varied(400), 3))
    known = e.predict(60.0, 0.2, 0.1)
    assert known.standard_deviation < 0.4 * fresh.standard_deviation
    # Never surer than the soil is alike from place to place.
    assert known.standard_deviation > 0.03 * known.sinkage
    assert e.predict(60.0, 0.2, 0.1, wheel="unheard of") == known
    wide = e.predict(60.0, 0.2, 0.1, load_std=6.0)
    assert wide.standard_deviation > known.standard_deviation
    assert e.predict(60.0, 0.2, 0.1, contact="pressed").sinkage < known.sinkage
    assert e.predict(6000.0, 0.2, 0.1).sunk_to_axle
    with pytest.raises(EstimatorError, match="load is -1 N"):
        e.predict(-1.0, 0.2, 0.1)


def test_a_wheel_in_a_rut_may_sink_otherwise_and_is_less_sure() -> None:
    front = Wheel("front", 0.2, 0.1, longitudinal_position=0.3)
    rear = Wheel("rear", 0.2, 0.1, longitudinal_position=-0.3)
    prior = SoilPrior.from_soil(soil("dry_sand"))
    e = SoilEstimator(prior, wheels=(front, rear))
    readings = rolled(varied(200), 3, one=changed(GOOD, wheel="front"))
    follow(e, readings)
    e.update(changed(readings[-1], wheel="rear"))
    first, follower = (e.predict(60.0, 0.2, 0.1, wheel=name) for name in ("front", "rear"))
    assert follower.standard_deviation > 2.0 * first.standard_deviation


def test_two_wheels_know_more_than_one() -> None:
    known = {"sinkage_zero_std": 0.0, "load_scale_std": 0.0, "delay_std": 0.0}
    one, two = estimator(**known), estimator(**known)
    left = rolled(varied(200), 5)
    right = rolled(varied(200, seed=1), 6, one=changed(GOOD, wheel="right"))
    follow(one, left)
    for pair in zip(left, right, strict=True):
        follow(two, pair)
    variance = [e.estimate().log_covariance[1, 1] for e in (one, two)]
    assert 0.3 < variance[1] / variance[0] < 0.95


def test_reset_is_a_new_start() -> None:
    e = estimator()
    fresh = e.estimate()
    follow(e, rolled(varied(100), 1))
    e.update(changed(GOOD, load=-1.0))
    e.reset()
    again = e.estimate()
    assert again.status == fresh.status
    assert again.accepted == again.outliers == 0
    np.testing.assert_array_equal(again.covariance, fresh.covariance)
    early = changed(GOOD, time=-3.0, distance=0.0)
    assert e.update(early) == estimator().update(early)
    assert e.findings == ()


# ---- Estimates, priors and settings


def test_estimate_before_any_measurement_is_the_prior() -> None:
    prior = SoilPrior.from_soil(soil("dry_sand"), 0.5, 0.2, 0.3)
    estimate = SoilEstimator(prior).estimate()
    sand = soil("dry_sand")
    assert estimate.k == pytest.approx(sand.k)
    assert (estimate.n, estimate.m) == pytest.approx((sand.n, sand.m))
    np.testing.assert_allclose(
        estimate.log_covariance, np.diag([0.25, 0.04, 0.09]), rtol=1e-9, atol=1e-12
    )
    assert not any(estimate.identifiable)
    assert estimate.status == ("no measurement yet: soil and uncertainty are the prior's",)
    # Linearised at the estimate: k = exp(L - n ln z - m ln D)
    jacobian = sand.k * np.array([1.0, -np.log(0.01), -np.log(0.2)])
    variance = jacobian @ estimate.log_covariance @ jacobian
    assert estimate.covariance[0, 0] == pytest.approx(variance)
    modulus, std = estimate.effective_modulus(0.35)
    assert modulus == pytest.approx(sand.k * 0.35**sand.m)
    by_hand = np.array([1.0, -np.log(0.01), np.log(0.35 / 0.2)])
    assert std == pytest.approx(modulus * np.sqrt(by_hand @ estimate.log_covariance @ by_hand))


def test_reference_is_where_the_pressure_is_reported() -> None:
    prior = SoilPrior.from_soil(soil("dry_sand"))
    near = SoilEstimator(prior)
    far = SoilEstimator(prior, EstimatorSettings(reference_sinkage=0.03, reference_diameter=0.5))
    for e in (near, far):
        follow(e, rolled(varied(100), 1))
    a, b = near.estimate(), far.estimate()
    assert (b.reference_sinkage, b.reference_diameter) == (0.03, 0.5)
    assert b.reference_pressure == pytest.approx(b.k * 0.03**b.n * 0.5**b.m)
    assert (a.k, a.n, a.m) == pytest.approx((b.k, b.n, b.m), rel=1e-9)
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-7)
    for diameter in (0.1, 0.6):
        assert a.effective_modulus(diameter) == pytest.approx(b.effective_modulus(diameter))


@pytest.mark.parametrize("name", list(SOILS))
def test_every_soil_of_the_library_makes_a_prior(name: str) -> None:
    e = SoilEstimator(SoilPrior.from_soil(soil(name)))
    sinkage = min(e.predict(30.0, 0.2, 0.1).sinkage, 0.09)
    assert e.update(changed(GOOD, load=30.0, sinkage=sinkage)).outcome is Outcome.ACCEPTED


def test_wrong_priors_and_settings_are_refused_by_name() -> None:
    sand = soil("dry_sand")
    with pytest.raises(EstimatorError, match=r"dry_sand.*n_std is 0"):
        SoilPrior.from_soil(sand, n_std=0.0)
    with pytest.raises(EstimatorError, match="log_reference_pressure_std is nan"):
        SoilPrior.from_soil(sand, math.nan)
    for name, value in (
        ("process_noise", -1.0),
        ("soil_scatter", 0.0),
        ("scatter_length", math.inf),
        ("gate_probability", 1.0),
        ("sinkage_zero_std", -0.001),
        ("pass_std", 2.0),
        ("load_scale_std", math.nan),
        ("slip_sinkage_std", 11.0),
        ("delay_std", -1.0),
        ("pitch_std", math.inf),
        ("reference_diameter", 0.0),
        ("sinkage_std", math.nan),
    ):
        with pytest.raises(EstimatorError, match=name):
            EstimatorSettings(**{name: value})
