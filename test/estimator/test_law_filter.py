# SPDX-License-Identifier: Apache-2.0
"""The soil's law and the sensors' faults in one state: h with its Jacobian, and the filters on it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from test_segment import segments
from wheel_drives import N as TRUE_N
from wheel_drives import rolled, varied

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.slip import Exponential
from smallwheel_ros.estimator.law_model import (
    DELAY,
    LAW,
    LOAD_SCALE,
    LOAD_ZERO,
    PASS,
    PITCH,
    SIDE,
    SLIP,
    WHEELS,
    ZERO,
    LawModel,
    M,
    N,
    Shown,
    U,
)
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior
from smallwheel_ros.estimator.soil_filter import LawFilter, Member
from smallwheel_ros.estimator.stretches import Position, Segment
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.simulate.truth import static_sinkage

Array = NDArray[np.float64]

PRIOR = SoilPrior.from_soil(soil("dry_sand"))
REFERENCE = (60.0, 0.25, 0.1)
SEGMENT = Segment(
    wheel="left",
    distance=5.0,
    place=5.0,
    sinkage=0.012,
    variance=3e-8,
    load=80.0,
    log_load_variance=1e-5,
    load_rate=0.4,
    slip=0.2,
    speed=0.3,
    pitch=0.08,
    diameter=0.4,
    width=0.12,
    contact="rolling",
    count=8,
    position=Position(0, passes=1.0, side=-1.0),
)
LEADING = replace(SEGMENT, position=Position(0))


def model(effects: tuple[Effect, ...] = (), **settings: float) -> LawModel:
    made = LawModel(PRIOR, EstimatorSettings(**settings), effects, REFERENCE)
    made.mean = np.append(made.mean, [0.0, 0.0])  # of a wheel
    return made


def state(made: LawModel) -> Array:
    """A state with every fault in it."""
    x = made.mean.copy()
    x[[U, N, M]] += 0.2, -0.1, 0.15
    x[[PASS, SIDE, LOAD_SCALE, SLIP, DELAY, PITCH]] = 0.2, 0.1, 0.05, 0.8, 0.1, 0.01
    x[ZERO], x[WHEELS], x[WHEELS + 1] = 8e-4, -3e-4, 0.04
    return x


def law_filter(**settings: float) -> LawFilter:
    made = EstimatorSettings(**settings)
    law = LawFilter(LawModel(PRIOR, made, (), REFERENCE), PRIOR, made)
    law.add_wheel()
    return law


def sound(law: LawFilter) -> None:
    assert np.isfinite(law.mean).all()
    np.testing.assert_allclose(law.covariance, law.covariance.T, rtol=1e-9, atol=1e-18)
    std = np.sqrt(np.diag(law.covariance))
    assert np.linalg.eigvalsh(law.covariance / np.outer(std, std)).min() > 0.0
    _, covariance = law.law
    assert np.linalg.eigvalsh(covariance).min() > 0.0


# ---- What sensors show


@pytest.mark.parametrize("effects", [(), (Exponential(a=0.7),)], ids=["plain", "slip sinkage"])
def test_the_row_of_h_is_its_slope(effects: tuple[Effect, ...]) -> None:
    made = model(effects)
    x = state(made)
    got = made.h(x, SEGMENT)
    steps = np.full(len(x), 1e-4)
    steps[[PITCH, ZERO, WHEELS]] = 1e-6
    for i, step in enumerate(steps):
        h = np.zeros(len(x))
        h[i] = step
        up, down = (made.h(x + sign * h, SEGMENT).value for sign in (1, -1))
        assert got.row[i] == pytest.approx((up - down) / (2 * step), rel=2e-3, abs=1e-7), i
    heavier = replace(SEGMENT, load=SEGMENT.load * math.exp(1e-4))
    slope = (made.h(x, heavier).value - got.value) / 1e-4
    assert got.by_load == pytest.approx(slope, rel=1e-3)


def test_h_is_the_contact_integral_with_each_fault() -> None:
    made = model()
    x = state(made)
    clean = x.copy()
    clean[[PASS, SIDE, LOAD_SCALE, LOAD_ZERO, SLIP, DELAY, PITCH, ZERO, WHEELS, WHEELS + 1]] = 0.0
    pressure, n, m = made.law(made.soil(clean)[0])[0]

    def static(load: float) -> float:
        modulus = math.exp(pressure - n * math.log(0.01) + m * math.log(0.4 / 0.2))
        one = np.ones(1)
        z = static_sinkage(lambda depth: modulus * depth**n, load * one, 0.4 * one, 0.12 * one)
        return float(z[0])

    def shown(**faults: float) -> float:
        y = clean.copy()
        for name, value in faults.items():
            y[globals()[name]] = value
        return float(made.h(y, SEGMENT).value)

    assert shown() == pytest.approx(static(80.0), rel=1e-6)
    assert shown(PASS=0.2) == pytest.approx(static(80.0) * math.exp(0.2))
    assert shown(LOAD_SCALE=0.05) == pytest.approx(static(80.0 * math.exp(-0.05)), rel=1e-6)
    assert shown(SIDE=0.1) == pytest.approx(static(80.0 * math.exp(0.1)), rel=1e-6)
    assert shown(LOAD_ZERO=0.1) == pytest.approx(static(80.0 - 0.1 * REFERENCE[0]), rel=1e-6)
    assert shown(SLIP=0.8) == pytest.approx(static(80.0) * (1.0 + 0.8 * 0.2))
    # The load rises: what is shown is that of a lighter wheel.
    assert shown(DELAY=0.1) == pytest.approx(static(80.0 * math.exp(-0.1 * 0.4)), rel=1e-6)
    assert shown(PITCH=0.01) == pytest.approx(static(80.0) + 0.01 * 0.08)


def test_an_effect_of_the_model_takes_the_place_of_the_fault() -> None:
    assert model().soil_covariance[SLIP, SLIP] == 1.0
    assert model((Exponential(a=0.7),)).soil_covariance[SLIP, SLIP] < 1e-12


def test_the_shown_state_and_the_soils_are_inverses() -> None:
    made = model()
    x = state(made)
    y, jacobian = made.soil(x)
    np.testing.assert_allclose(made.shown(y), x, atol=1e-12)
    # With a zero that is 0 what is shown is the soil's.
    clean = x.copy()
    clean[ZERO] = 0.0
    np.testing.assert_allclose(made.soil(clean)[0], clean, atol=1e-15)
    for i in range(len(x)):
        h = np.zeros(len(x))
        h[i] = 1e-7
        slope = (made.soil(x + h)[0] - made.soil(x - h)[0]) / 2e-7
        np.testing.assert_allclose(jacobian[:, i], slope, rtol=1e-5, atol=1e-6)
    # A zero larger than all that is shown leaves a wheel that sinks.
    x[ZERO] = 0.05
    assert math.exp(made.soil(x)[0][U]) > 0.0


def test_prior_is_that_of_the_field() -> None:
    made = model()
    law, jacobian = made.law(made.mean)
    np.testing.assert_allclose(law, [PRIOR.log_reference_pressure, PRIOR.n, PRIOR.m])
    covariance = jacobian[:, :LAW] @ made.soil_covariance[:LAW, :LAW] @ jacobian[:, :LAW].T
    np.testing.assert_allclose(covariance, np.diag([0.49, 0.09, 0.16]), atol=1e-9)


# ---- The filters


def test_travel_ends_at_the_prior_and_leaves_the_faults() -> None:
    law = law_filter()
    for one in segments(rolled(varied(400), 1)):
        law.absorb(one)
    known = law.law[1].diagonal()
    faults = law.covariance[ZERO, ZERO]
    previous = known
    for i, travelled in enumerate((5.0, 50.0, 1e3, 1e6)):
        # A segment that says nothing, further along the way.
        law.absorb(replace(SEGMENT, distance=20.0 + travelled, variance=1e6))
        now = law.law[1].diagonal()
        assert (now >= previous * (1.0 - 1e-9)).all(), i
        previous = now
    assert previous[0] == pytest.approx(0.49, rel=0.2)
    assert known[0] < 0.2 * previous[0]
    assert law.covariance[ZERO, ZERO] < 1.5 * faults
    sound(law)


def test_without_process_noise_a_soil_is_one_for_ever() -> None:
    law = law_filter(process_noise=0.0)
    for one in segments(rolled(varied(400), 1)):
        law.absorb(one)
    known = law.law[1].diagonal()
    law.absorb(replace(SEGMENT, distance=1e7, variance=1e6))
    np.testing.assert_allclose(law.law[1].diagonal(), known, rtol=1e-2)


def test_repeats_of_a_deviation_count_as_one() -> None:
    """Texture of the soil is alike from segment to segment: their mean is not as sure as of dice."""
    law = law_filter()
    for i in range(30):
        law.absorb(replace(SEGMENT, distance=0.2 * i))
    _, counts, base = law.scatter.noise(SEGMENT, Shown(0.012, np.zeros(1), 0.009))
    assert counts - base > 1.2 * (0.009**2 * law.scatter.soil) > 0.0


@pytest.mark.parametrize("scatter", [0.03, 0.15])
def test_scatter_of_the_soil_is_learnt(scatter: float) -> None:
    rng = np.random.default_rng(3)
    law = law_filter()
    texture = 0.0
    for i in range(300):
        keep = math.exp(-1.0)
        texture = keep * texture + math.sqrt(1 - keep**2) * scatter * float(rng.standard_normal())
        load = 60.0 * math.exp(0.4 * math.sin(0.5 * i))
        expected = law.model.h(law.model.mean, replace(LEADING, load=load, slip=0.0)).value
        shown = expected * math.exp(-0.75 * math.sqrt(law.scatter.share) * texture)
        law.absorb(replace(LEADING, load=load, slip=0.0, distance=0.2 * i, sinkage=shown))
    assert math.sqrt(law.scatter.soil) == pytest.approx(scatter, rel=0.4)


def test_zero_that_is_told_limits_n_and_one_that_is_known_does_not() -> None:
    deviation = {}
    for zero in (2e-3, 1e-4):
        law = law_filter(sinkage_zero_std=zero)
        for one in segments(rolled(varied(1500), 2)):
            law.absorb(one)
        mean, covariance = law.law
        deviation[zero] = math.sqrt(covariance[1, 1])
        assert abs(mean[1] - TRUE_N) < 3.0 * deviation[zero]
    assert deviation[1e-4] < 0.6 * deviation[2e-3]


def test_another_soil_begins_with_the_prior_and_keeps_the_faults() -> None:
    law = law_filter()
    for one in segments(rolled(varied(800), 2)):
        law.absorb(one)
    faults = law.covariance[PASS:, PASS:].copy()
    law.reopen(None, 0.5, 20.0)
    assert law.used == 0
    np.testing.assert_allclose(law.mean[:LAW], law.model.mean[:LAW], atol=1e-9)
    np.testing.assert_allclose(law.covariance[PASS:, PASS:], faults, rtol=0.5, atol=1e-12)
    sound(law)


def test_a_wild_segment_moves_the_law_little() -> None:
    laws = [law_filter(), law_filter()]
    for law, wild in zip(laws, (0.012, 0.06), strict=True):
        rows = segments(rolled(varied(800), 2))
        rows[60] = replace(rows[60], sinkage=rows[60].sinkage + wild - 0.012)
        for one in rows:
            law.absorb(one)
    off = np.abs(laws[0].law[0] - laws[1].law[0])
    assert (off < 0.5 * np.sqrt(laws[0].law[1].diagonal())).all()


def soak(updates: int) -> None:
    """Segments as a drive makes them, very exact and very coarse in turn, on two sizes of wheel."""
    rng = np.random.default_rng(7)
    law = law_filter()
    places = [LEADING, replace(SEGMENT, position=replace(SEGMENT.position, index=law.add_wheel()))]
    prior = law.model.soil_covariance.diagonal()
    for i in range(updates):
        load = 60.0 * math.exp(0.4 * float(rng.standard_normal()))
        one = replace(
            places[i % 2],
            distance=0.0 if (i // 500) % 5 == 4 else 0.1 * i,
            load=load,
            slip=float(rng.uniform(-0.1, 0.5)),
            pitch=float(0.1 * rng.standard_normal()),
            diameter=0.25 if i % 2 else 0.4,
            variance=(1e-6 if i % 1000 < 20 else 3e-4) ** 2,
            sinkage=0.012 * (load / 60.0) ** 0.8 * math.exp(0.1 * float(rng.standard_normal())),
        )
        law.absorb(one)
        if i % 100 == 0:
            sound(law)
            assert (law.covariance.diagonal()[PASS:ZERO] <= 4.0 * prior[PASS:ZERO]).all()
    sound(law)


def test_covariance_is_sound_over_many_updates() -> None:
    soak(600)


@pytest.mark.slow
@pytest.mark.xfail(
    strict=True,
    reason="the error in newtons that all load cells share drifts apart in exact and in open filters: after"
    " 2 km its variance is over 4 times the prior's, after 11 km 75 times; it gets too wide, not too sure",
)
def test_covariance_is_sound_over_many_more_updates() -> None:
    """20 km of two wheels."""
    soak(200_000)


def test_a_segment_that_cannot_be_used_leaves_the_filter_as_it_was(monkeypatch) -> None:
    law = law_filter()
    for i in range(20):
        law.absorb(replace(SEGMENT, distance=0.2 * i))
    mean, covariance, scatter, used = law.mean, law.covariance, law.scatter.soil, law.used
    update, updates = Member.update, []

    def second_time_bad(self: Member, *given: object) -> object:
        updates.append(given)
        if len(updates) == 2:
            raise ArithmeticError("no law")
        return update(self, *given)

    monkeypatch.setattr(Member, "update", second_time_bad)
    with pytest.raises(ArithmeticError, match="no law"):
        law.absorb(replace(SEGMENT, distance=6.0))
    monkeypatch.setattr(Member, "update", update)
    np.testing.assert_allclose(law.mean, mean, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(law.covariance, covariance, rtol=1e-12, atol=1e-18)
    assert (law.scatter.soil, law.used) == (scatter, used)
    law.absorb(replace(SEGMENT, distance=6.0))
    assert law.used == used + 1


def test_before_sixteen_stretches_nothing_is_determined() -> None:
    """F9: linearised far from the truth, two parameters were 4 deviations off in the first 2 m."""
    made, seen = law_filter(), []
    for one in segments(rolled(varied(300), 2)):
        made.absorb(one)
        seen.append(made.settled)
    assert seen == [i >= 15 for i in range(len(seen))]
