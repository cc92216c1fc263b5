# SPDX-License-Identifier: Apache-2.0
"""The margin of any ground: what the prior says, what drives tell of it, and what a step costs."""

from __future__ import annotations

import time
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from rows_of_drives import drive, give, rover, static_rover

from smallwheel_ros.costmap.cost import CostRules
from smallwheel_ros.drive.messages import margin_before_driving
from smallwheel_ros.onboard.declared import REFERENCE_SLIP
from smallwheel_ros.physics.wheel import GRAVITY
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Estimates
from smallwheel_ros.pipeline.warning.hazard import Instants
from smallwheel_ros.pipeline.warning.margin import (
    GRIP,
    RESISTANCE,
    SOFTNESS,
    AnyGround,
    GroundMargin,
    Margins,
    risk_ahead,
    scatter_ahead,
)

SIDE = np.array([0.3, -0.3, 0.3, -0.3])
START = 1_700_000_000_000_000_000


def law(slip: float, grip: float, softness: float, resistance: float) -> float:
    return float(grip * -np.expm1(-slip / softness) - resistance)


def driven(
    grip: float, softness: float, resistance: float, steps: int = 60, seed: int = 0
) -> GroundMargin:
    """Steps at pulls from 0 to what slip 0.5 gives."""
    rng, ground = np.random.default_rng(seed), GroundMargin(REFERENCE_SLIP)
    for slip in rng.uniform(0.0, 0.5, steps):
        pull = law(slip, grip, softness, resistance) + 0.01 * rng.standard_normal()
        ground.update(float(slip + 0.03 * rng.standard_normal()), 0.04, pull, 1.0)
    return ground


def instants(
    seconds: int = 60, slip: float = 0.05, pull: float = 0.0, speed: float = 0.8
) -> Instants:
    n = 10 * seconds
    rng = np.random.default_rng(1)
    rim = np.full((n, 4), speed / (1.0 - slip)) + 0.01 * rng.standard_normal((n, 4))
    ground = np.full((n, 4), speed)
    felt = GRAVITY * pull + 0.1 * rng.standard_normal(n)
    stamp = START + 100_000_000 * np.arange(1, n + 1)
    ground_std, along = 0.02 + 0.0 * ground, speed + 0.02 * rng.standard_normal(n)
    return Instants(
        stamp, rim, ground, ground_std, along, *np.zeros((1, n)), felt, *np.zeros((2, n))
    )


def test_before_any_drive_it_is_the_prior() -> None:
    ground = GroundMargin(REFERENCE_SLIP)
    low, middle, high = ground.quantiles()
    assert middle == pytest.approx(0.31, abs=0.02)  # WARNING: 0.31 [0.00, 1.27]
    assert low == pytest.approx(0.0, abs=0.02)
    assert high == pytest.approx(1.27, abs=0.12)
    assert np.median(ground.grip) == pytest.approx(GRIP[0], rel=1e-2)
    assert np.median(ground.softness) == pytest.approx(SOFTNESS[0], rel=1e-2)
    assert np.median(ground.resistance) == pytest.approx(RESISTANCE[0], rel=1e-2)


@pytest.mark.parametrize(
    ("grip", "softness", "resistance"), [(0.12, 0.08, 0.03), (0.4, 0.2, 0.08), (0.8, 0.06, 0.03)]
)
def test_a_drive_that_pulls_tells_the_margin(
    grip: float, softness: float, resistance: float
) -> None:
    low, middle, high = driven(grip, softness, resistance).quantiles()
    true = law(0.4, grip, softness, resistance)
    assert low <= true <= high
    assert high - low < 0.6 * 1.27
    assert middle == pytest.approx(true, abs=0.35 * true + 0.03)


def test_what_the_vehicle_does_bounds_the_margin_from_below() -> None:
    ground = GroundMargin(REFERENCE_SLIP)
    before = ground.quantiles()[0]
    for _ in range(10):
        ground.update(0.04, 0.04, 0.35, 1.0)
    assert before < 0.02
    assert ground.quantiles()[0] > 0.25


def test_a_steady_drive_on_firm_ground_is_no_risk_and_ice_on_a_slope_is() -> None:
    made = AnyGround(SIDE, REFERENCE_SLIP).take(instants())
    assert made is not None
    assert np.nanmean(made.risk) < 0.05
    steep = AnyGround(SIDE, REFERENCE_SLIP).take(instants(slip=0.45, pull=0.12))
    assert steep is not None
    assert steep.risk[-1] > 3.0 * made.risk[-1]
    assert steep.risk[-1] > 0.1


def test_ground_behind_is_forgotten() -> None:
    ground = driven(0.12, 0.08, 0.03)
    known = ground.quantiles()
    ground.forget(1.0)
    assert np.allclose(ground.quantiles(), known, atol=0.05)
    ground.forget(200.0)
    assert np.allclose(ground.quantiles(), GroundMargin(REFERENCE_SLIP).quantiles(), atol=1e-6)


def test_each_metre_that_was_got_over_lowers_the_risk_of_the_next_one_and_leaves_the_margin_here() -> (
    None
):
    ground, risks = GroundMargin(REFERENCE_SLIP), []
    here = ground.quantiles()
    for _ in range(10):
        risks.append(float(risk_ahead(0.1, *ground.ahead())))
        ground.cross(1.0, 0.1)
    assert all(after < before for before, after in pairwise(risks))
    assert risks[-1] < 0.5 * risks[0]
    assert np.array_equal(ground.quantiles(), here)
    # What was asked for little proves little, and a way is forgotten as slips are.
    level = GroundMargin(REFERENCE_SLIP)
    level.cross(10.0, 0.0)
    assert float(risk_ahead(0.3, *level.ahead())) > float(risk_ahead(0.3, *ground.ahead()))
    ground.forget(200.0)
    assert ground.ahead() == pytest.approx(GroundMargin(REFERENCE_SLIP).ahead(), abs=1e-3)


@pytest.mark.parametrize(("slip", "crossed"), [(0.2, True), (0.65, True), (0.75, False)])
def test_a_metre_on_which_the_vehicle_makes_no_way_is_none_that_was_crossed(
    slip: float, crossed: bool
) -> None:
    stage = AnyGround(SIDE, REFERENCE_SLIP)
    stage.take(instants(10, slip=slip, pull=0.1))
    assert stage.ground.crossed.any() == crossed


def test_the_risk_is_what_a_cell_of_the_map_costs_that_asks_for_as_much() -> None:
    """Both of them ask up to the slip with which the vehicle makes no way."""
    made = AnyGround(SIDE, REFERENCE_SLIP).take(instants(slip=0.45, pull=0.12))
    assert made is not None
    median, lower_std, beyond = made.median[-1], made.lower_std[-1], made.beyond[-1]
    spread = np.hypot(lower_std, scatter_ahead(median))
    cost = CostRules().cost(median + beyond - made.asked[-1], spread)
    assert cost == pytest.approx(100.0 * made.risk[-1], abs=0.5)
    assert beyond > 0.0


@pytest.mark.parametrize("column", ["felt", "speed", "rim"])
def test_where_nothing_is_known_the_risk_is_unknown(column: str) -> None:
    rows = instants(10)
    nothing = np.full(getattr(rows, column).shape, np.nan)
    made = AnyGround(SIDE, REFERENCE_SLIP).take(Instants(**{**rows.__dict__, column: nothing}))
    assert made is not None
    assert np.isnan(made.risk).all()
    assert np.isfinite(made.margin).all()


def test_turns_on_the_spot_and_standstills_teach_nothing() -> None:
    rows = instants(10)
    stage = AnyGround(SIDE, REFERENCE_SLIP)
    stage.take(Instants(**{**rows.__dict__, "rim": rows.rim * np.array([-1.0, 1.0, -1.0, 1.0])}))
    stage.take(Instants(**{**rows.__dict__, "rim": 0.0 * rows.rim, "stamp": rows.stamp + 10**10}))
    assert stage.steps == 0


def test_backwards_is_as_forwards_but_for_the_tilt() -> None:
    ahead, rows = (
        AnyGround(SIDE, REFERENCE_SLIP).take(instants(slip=0.2, pull=0.1)),
        instants(slip=0.2, pull=0.1),
    )
    back = Instants(**{**rows.__dict__, "rim": -rows.rim, "speed": -rows.speed, "felt": -rows.felt})
    made = AnyGround(SIDE, REFERENCE_SLIP).take(back)
    assert ahead is not None
    assert made is not None
    assert made.margin[-1] == pytest.approx(ahead.margin[-1], abs=0.03)


@hypothesis_settings(max_examples=10)
@given(st.lists(st.integers(1, 199), max_size=8))
def test_margins_do_not_depend_on_where_blocks_are_cut(edges: list[int]) -> None:
    rows = instants(20, slip=0.2, pull=0.1)
    whole = AnyGround(SIDE, REFERENCE_SLIP).take(rows)
    stage = AnyGround(SIDE, REFERENCE_SLIP)
    ends = [0, *sorted(set(edges)), len(rows)]
    parts = [stage.take(rows.take(slice(a, b))) for a, b in pairwise(ends)]
    made = Margins.joined([part for part in parts if part is not None])
    assert whole is not None
    for name in ("stamp", "margin", "margin_std", "low", "high", "median", "asked", "risk"):
        assert np.array_equal(getattr(made, name), getattr(whole, name), equal_nan=True)


def test_a_step_costs_under_two_milliseconds() -> None:
    ground, costs = GroundMargin(REFERENCE_SLIP), []
    for _ in range(30):
        begin = time.process_time()
        ground.update(0.1, 0.05, 0.05, 1.0)
        ground.forget(0.5)
        ground.quantiles()
        ground.moments()
        ground.cross(0.5, 0.05)
        risk_ahead(0.1, *ground.ahead())
        costs.append(time.process_time() - begin)
    assert min(costs) < 2e-3  # the smallest: others on this machine only make it slower


@pytest.mark.parametrize("soil", [True, False])
def test_the_margin_is_that_at_the_reference_slip_and_the_most_is_not(soil: bool) -> None:
    shown = []
    for slip in (0.05, 0.2, 0.4, 0.9):
        vehicle = (rover if soil else static_rover)(reference_slip=slip)
        pipeline = Pipeline(vehicle.onboard)
        give(pipeline.streams, drive(soil=soil))
        found = Estimates.joined([turn.estimates for turn in pipeline.turns(last=True)])
        before = margin_before_driving(vehicle.onboard)
        assert before is not None
        most = found.margin_median[-1] + found.margin_beyond[-1]
        shown.append((float(found.margin[-1]), before.value, float(most)))
    for less, more in pairwise(shown):
        assert more[0] > less[0] + 0.01
    # What stops the vehicle is the slip with which it makes no way, whatever margins are compared at.
    for one in (1, 2):
        assert [each[one] for each in shown[:3]] == pytest.approx([shown[0][one]] * 3, abs=0.02)
        assert shown[3][one] > shown[0][one]
