"""What the estimator does with one measurement: order, refusals, counts, predictions."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from smallwheel_ros.effects.registry import families
from smallwheel_ros.effects.slip_sinkage import Exponential
from smallwheel_ros.estimator.point_sinkage import point_sinkage
from smallwheel_ros.estimator.sinkage_observation import observation
from smallwheel_ros.estimator.soil_estimator import (
    EstimatorError,
    EstimatorSettings,
    Outcome,
    SinkageMeasurement,
    SoilEstimator,
    SoilPrior,
)
from smallwheel_ros.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.contact import contact_load, contact_sinkage
from smallwheel_ros.physics.soil import SOILS, Soil, soil

GOOD = SinkageMeasurement(
    time=1.0,
    wheel="left",
    sinkage=0.012,
    variance=1e-6,
    load=60.0,
    load_variance=1.0,
    diameter=0.2,
    width=0.1,
    distance=5.0,
)


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
def test_observation_is_the_model(effect_class: type | None, contact: str) -> None:
    """With any effect: what the filter expects is what `model.predict` says, slopes included."""
    effects = () if effect_class is None else (effect_class(),)
    slip, speed = 0.2, 0.15
    one = Soil("one", 1.6e6, 0.8, 0.39)
    wheel = {"load": 70.0, "diameter": 0.25, "width": 0.08}
    observe = observation(effects, *wheel.values(), contact, slip, speed)
    conditions = Conditions.of(**wheel, contact=contact, slip=slip, speed=speed)

    def shown(s: float, n: float) -> float:
        k = math.exp(s - n * math.log(0.01) - 0.39 * observe.diameter_log - 0.39 * math.log(0.2))
        return float(predict(Model(replace(one, k=k, n=n), effects=effects), conditions).sinkage[0])

    s = one.log_reference_pressure + 0.39 * observe.diameter_log
    got = observe(s, one.n)
    step = 1e-4
    assert got.value == pytest.approx(shown(s, one.n), rel=1e-8)
    by_pressure = (shown(s + step, one.n) - shown(s - step, one.n)) / (2 * step)
    by_exponent = (shown(s, one.n + step) - shown(s, one.n - step)) / (2 * step)
    assert got.by_pressure == pytest.approx(by_pressure, rel=1e-5)
    assert got.by_exponent == pytest.approx(by_exponent, rel=1e-4, abs=1e-8)
    assert not got.sunk_to_axle


# ---- Refusals


@pytest.mark.parametrize(
    ("change", "reason", "words"),
    [
        ({"sinkage": math.nan}, "not_finite", "sinkage is nan"),
        ({"load": math.inf}, "not_finite", "load is inf"),
        ({"load_variance": math.nan}, "not_finite", "load_variance"),
        ({"time": math.nan}, "not_finite", "time"),
        ({"distance": -math.inf}, "not_finite", "distance"),
        ({"diameter": math.inf}, "not_finite", "diameter"),
        ({"load": 0.0}, "load_not_positive", "load is 0 N"),
        ({"load": -5.0}, "load_not_positive", "load is -5 N"),
        ({"diameter": 0.0}, "geometry_not_positive", "diameter 0 m"),
        ({"width": -0.1}, "geometry_not_positive", "width -0.1 m"),
        ({"load_variance": -1.0}, "load_variance_negative", "-1 N^2"),
        ({"sinkage": -0.001}, "sinkage_negative", "-0.001 m"),
        ({"sinkage": 0.11}, "sunk_to_axle", "half of the diameter"),
        ({"contact": "hovering"}, "unknown_contact", "hovering"),
    ],
)
def test_bad_measurements_are_refused_and_counted(
    change: dict[str, float], reason: str, words: str
) -> None:
    e = estimator()
    for first in (False, True):
        if first:
            assert e.update(GOOD).outcome is Outcome.ACCEPTED
        before = snapshot(e)
        result = e.update(replace(GOOD, **({"time": 2.0} | change)))
        assert (result.outcome, result.reason) == (Outcome.REFUSED, reason)
        assert words in result.message
        assert "left" in result.message
        assert result.predicted_sinkage is None
        assert result.normalised_innovation_squared is None
        for was, now in zip(before, snapshot(e), strict=True):
            np.testing.assert_array_equal(was, now)
    assert e.estimate().refused == {reason: 2}
    assert e.update(replace(GOOD, time=3.0)).outcome is Outcome.ACCEPTED


def test_order_is_kept_for_each_wheel() -> None:
    e = estimator()
    e.update(GOOD)
    assert e.update(GOOD).reason == "time_backwards"
    assert e.update(replace(GOOD, time=0.5)).reason == "time_backwards"
    assert e.update(replace(GOOD, time=2.0, distance=4.9)).reason == "distance_backwards"
    # Another wheel has a clock of its own, and may be a little behind in distance.
    other = replace(GOOD, wheel="right", time=0.9, distance=4.99)
    assert e.update(other).outcome is Outcome.ACCEPTED
    assert e.estimate().distance == 5.0


def test_wheels_without_end_are_refused() -> None:
    e = estimator()
    reasons = [e.update(replace(GOOD, wheel=str(i))).reason for i in range(70)]
    assert reasons.count("too_many_wheels") == 6


def test_effects_need_their_covariates() -> None:
    prior = SoilPrior.from_soil(soil("dry_sand"))
    e = SoilEstimator(prior, effects=(Exponential(a=1.5),))
    assert e.update(GOOD).reason == "covariate_missing"
    assert e.update(replace(GOOD, slip=math.nan)).reason == "not_finite"
    result = e.update(replace(GOOD, slip=0.3))
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


@pytest.mark.parametrize("variance", [0.0, -1.0, math.nan, math.inf])
def test_an_unknown_variance_is_the_settings(variance: float) -> None:
    known = estimator(sinkage_std=0.002).update(replace(GOOD, variance=0.002**2))
    assert estimator(sinkage_std=0.002).update(replace(GOOD, variance=variance)) == known


# ---- Results and predictions


def test_result_adds_up() -> None:
    e = estimator()
    result = e.update(GOOD)
    assert result.message == ""
    assert result.reason == "accepted"
    assert result.innovation == pytest.approx(0.012 - result.predicted_sinkage)
    assert result.innovation_variance == pytest.approx(result.predicted_variance + 1e-6)
    prior = SoilPrior.from_soil(soil("dry_sand"))
    model = Model(prior.soil)
    conditions = Conditions.of(load=60.0, diameter=0.2, width=0.1)
    assert result.predicted_sinkage == pytest.approx(predict(model, conditions).sinkage[0])


def test_gate_names_what_did_not_fit() -> None:
    e = estimator()
    for i in range(20):
        e.update(replace(GOOD, time=float(i)))
    before = snapshot(e)
    result = e.update(replace(GOOD, time=30.0, sinkage=0.04))
    assert (result.outcome, result.reason) == (Outcome.OUTLIER, "gate")
    assert "40.00 mm measured" in result.message
    assert result.normalised_innovation_squared > 10.8
    for was, now in zip(before, snapshot(e), strict=True):
        np.testing.assert_array_equal(was, now)
    assert e.outliers == 1


def test_one_spot_is_one_surprise() -> None:
    """A stuck sensor on a parked vehicle is not another soil; the same at five spots is."""
    e = estimator()
    for i in range(20):
        e.update(replace(GOOD, time=float(i)))
    for i in range(100):
        assert e.update(replace(GOOD, time=30.0 + i, sinkage=0.05)).outcome is Outcome.OUTLIER
    reasons = [
        e.update(replace(GOOD, time=200.0 + i, sinkage=0.05, distance=5.2 + 0.11 * i)).reason
        for i in range(5)
    ]
    assert reasons == ["gate"] * 3 + ["soil_changed", "accepted"]


def test_predict_takes_the_spot_of_a_known_wheel() -> None:
    e = estimator()
    fresh = e.predict(60.0, 0.2, 0.1)
    for i in range(200):
        e.update(replace(GOOD, time=float(i), load_variance=0.0))
    there, elsewhere = e.predict(60.0, 0.2, 0.1, wheel="left"), e.predict(60.0, 0.2, 0.1)
    assert there.sinkage == pytest.approx(0.012, abs=2e-4)
    assert there.standard_deviation < 1.2e-4
    # Another spot of this soil: uncertain by the scatter here and there, on top.
    assert elsewhere.standard_deviation > 0.06 * 0.012 / 1.3
    assert elsewhere.standard_deviation < 0.3 * fresh.standard_deviation
    assert e.predict(60.0, 0.2, 0.1, wheel="unheard of") == elsewhere
    wide = e.predict(60.0, 0.2, 0.1, load_variance=36.0)
    assert wide.standard_deviation > elsewhere.standard_deviation
    assert e.predict(60.0, 0.2, 0.1, contact="pressed").sinkage < elsewhere.sinkage
    assert e.predict(6000.0, 0.2, 0.1).sunk_to_axle
    with pytest.raises(EstimatorError, match="load is -1 N"):
        e.predict(-1.0, 0.2, 0.1)


def test_uncertainty_grows_with_travel_only_and_ends_at_the_prior() -> None:
    e = estimator()
    prior = e.estimate().log_covariance
    for i in range(50):
        e.update(replace(GOOD, time=float(i)))
    known = e.estimate().log_covariance[0, 0]
    e.update(replace(GOOD, time=1e6, sinkage=0.05))  # an outlier, long after, at the same place
    assert e.estimate().log_covariance[0, 0] == known
    previous = known
    for i, distance in enumerate((6.0, 20.0, 200.0, 2e4, 1e7)):
        e.update(replace(GOOD, time=2e6 + i, sinkage=0.099, variance=1e-8, distance=distance))
        now = e.estimate().log_covariance[0, 0]
        assert now > previous
        previous = now
        if e.estimate().soil_changes or i == 3:
            break
    assert previous <= prior[0, 0] * (1 + 1e-9)


def test_two_updates_without_travel_are_two_measurements() -> None:
    """Several wheels at one instant: as exact as one after the other (a trap of other filters)."""
    one, two = estimator(), estimator()
    for i in range(30):
        one.update(replace(GOOD, time=float(i), distance=5.0 + i, wheel="a"))
        two.update(replace(GOOD, time=float(i), distance=5.0 + i, wheel="a"))
        two.update(replace(GOOD, time=float(i), distance=5.0 + i, wheel="b"))
    variance = [e.estimate().log_covariance[0, 0] for e in (one, two)]
    assert 0.4 < variance[1] / variance[0] < 1.0


def test_reset_is_a_new_start() -> None:
    e = estimator()
    fresh = e.estimate()
    for i in range(30):
        e.update(replace(GOOD, time=float(i), distance=5.0 + i, wheel=str(i % 3)))
    e.update(replace(GOOD, load=-1.0))
    e.reset()
    again = e.estimate()
    assert again.status == fresh.status
    assert again.refused == {}
    assert again.accepted == again.outliers == 0
    np.testing.assert_array_equal(again.covariance, fresh.covariance)
    assert e.update(replace(GOOD, time=-3.0, distance=0.0)) == estimator().update(
        replace(GOOD, time=-3.0, distance=0.0)
    )


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
    for i in range(30):
        for e in (near, far):
            e.update(replace(GOOD, time=float(i), distance=5.0 + i))
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
    assert e.update(replace(GOOD, load=30.0, sinkage=sinkage)).outcome is Outcome.ACCEPTED


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
        ("surprises_to_reopen", 0),
        ("reference_diameter", 0.0),
        ("sinkage_std", math.nan),
    ):
        with pytest.raises(EstimatorError, match=name):
            EstimatorSettings(**{name: value})
