# SPDX-License-Identifier: Apache-2.0
"""A smooth of one setting without a name, by hand: polynomials, scale, and what it does at each stage.

Tests `curves.py`.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from smallwheel_ros.diagnosis.curves import (
    STAGES,
    CurveSpan,
    curve_part,
    curve_shown,
    distinct,
    spans_of,
)
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.measurements.display import ADDED
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions

SPAN = CurveSpan("moisture", middle=0.3, half=0.2)
DRIVEN = CurveSpan("slip", middle=0.0, half=0.5, side=1)
SETTINGS = np.array([0.1, 0.2, 0.3, 0.5])  # -1, -0.5, 0 and 1 of the span


def curve(stage: str, span: CurveSpan, size: float = 1.0, **numbers: float) -> Effect:
    degrees = [int(name[1:]) for name in numbers]
    part = curve_part("unknown", stage, span, min(degrees), len(degrees), size)
    assert [p.field for p in part.parameters] == list(numbers)
    return part.build(numbers)


def ratio(effect: Effect, quantity: str, at: Conditions) -> np.ndarray:
    with_it, without = (
        getattr(predict(m, at), quantity) for m in (Model("dry_sand") + effect, Model("dry_sand"))
    )
    return np.asarray(with_it / without)


def conditions(**covariates: object) -> Conditions:
    return Conditions.of(60.0, 0.2, 0.1, **covariates)  # type: ignore[arg-type]


def test_the_terms_are_legendre_polynomials_of_the_setting() -> None:
    at = conditions(moisture=SETTINGS)
    for numbers, by_hand in (
        ({"c0": 0.2}, [0.2, 0.2, 0.2, 0.2]),
        ({"c1": 0.2}, [-0.2, -0.1, 0.0, 0.2]),
        ({"c1": 0.2, "c2": 0.1}, [-0.2 + 0.1, -0.1 - 0.0125, -0.05, 0.2 + 0.1]),
        ({"c1": 0.0, "c2": 0.0, "c3": 0.4}, [-0.4, 0.4 * 0.4375, 0.0, 0.4]),
    ):
        found = ratio(curve("sinkage", SPAN, **numbers), "true_sinkage", at)
        assert np.log(found) == pytest.approx(by_hand, abs=1e-9)


def test_a_curve_of_slip_does_nothing_without_slip_and_only_on_its_side() -> None:
    at = conditions(slip=np.array([-0.5, 0.0, 0.25, 0.5]))
    found = np.log(ratio(curve("sinkage", DRIVEN, c1=0.2), "true_sinkage", at))
    assert found == pytest.approx([0.0, 0.0, 0.2, 0.4])  # from P1(-1) on
    found = np.log(
        ratio(curve("sinkage", CurveSpan("slip", 0.0, 0.5, -1), c1=0.2), "true_sinkage", at)
    )
    assert found == pytest.approx([0.4, 0.0, 0.0, 0.0])


def test_beyond_what_was_met_a_curve_goes_on_by_a_fifth_and_no_further() -> None:
    assert SPAN.scaled(np.array([0.0, 0.52, 9.0, np.nan])) == pytest.approx([-1.2, 1.1, 1.2, 0.0])
    assert DRIVEN.scaled(np.array([-1.0, 0.0, 0.55, 1.0])) == pytest.approx([0.0, 0.0, 1.1, 1.2])
    far = ratio(curve("sinkage", SPAN, c0=99.0), "true_sinkage", conditions(moisture=SETTINGS))
    assert np.log(far) == pytest.approx(5.0)


def test_each_stage_changes_what_it_says() -> None:
    at, size, c = conditions(moisture=SETTINGS), 2.5, 0.2
    plain = predict(Model("dry_sand"), at)
    made = {
        stage: predict(Model("dry_sand") + curve(stage, SPAN, size, c0=c), at) for stage in STAGES
    }
    factor = np.exp(c)
    assert made["sinkage"].true_sinkage == pytest.approx(factor * plain.true_sinkage)
    shown = made["shown sinkage"]
    assert shown.sinkage == pytest.approx(factor * plain.sinkage)
    assert shown.true_sinkage == pytest.approx(plain.sinkage)
    assert made["height"].sinkage == pytest.approx(plain.sinkage + size * c)
    assert made["resistance"].resistance == pytest.approx(factor * plain.resistance)
    assert made["drag"].resistance == pytest.approx(plain.resistance + 0.25 * 60.0 * c)
    assert made["force"].resistance == pytest.approx(plain.resistance + 0.25 * size * c)
    # As much stiffer soil, and a pressure as much larger at every depth, are one.
    stiffer = predict(Model("dry_sand") + curve("stiffness", SPAN, c0=c), at)
    assert stiffer.sinkage == pytest.approx(plain.sinkage * factor ** (-1.0 / 1.3), rel=0.02)
    assert made["pressure"].sinkage == pytest.approx(stiffer.sinkage, rel=1e-4)


def test_one_that_has_a_value_at_which_it_does_nothing_has_a_curve_on_each_side() -> None:
    assert spans_of("moisture", np.array([0.1, 0.5])) == [SPAN]
    both = spans_of("slip", np.array([-0.2, 0.0, 0.6]))
    assert both == [CurveSpan("slip", 0.0, 0.6, 1), CurveSpan("slip", 0.0, 0.2, -1)]
    assert spans_of("slip", np.array([-0.01, 0.6])) == [CurveSpan("slip", 0.0, 0.6, 1)]
    assert spans_of("pass_number", np.array([1.0, 4.0])) == [CurveSpan("pass_number", 1.0, 3.0, 1)]


def test_a_curve_has_as_many_terms_as_settings_were_met() -> None:
    assert distinct(np.array([0.1, 0.1, 0.3, 0.3004, 0.5]), SPAN) == 2
    assert (
        distinct(np.array([-0.2, 0.0, 0.25, 0.25, 0.5]), DRIVEN) == 2
    )  # at its anchor it says nothing


@pytest.mark.parametrize(
    ("stage", "unit", "size", "by_hand"),
    [
        ("drag", "1", 1.0, {0.0: 0.0, 0.25: 0.01, 0.5: 0.02}),
        ("force", "N", 40.0, {0.0: 0.0, 0.25: 0.4, 0.5: 0.8}),
        ("height", "m", 0.012, {0.0: 0.0, 0.25: 0.00048, 0.5: 0.00096}),
    ],
)
def test_what_is_added_is_shown_in_its_unit_and_what_multiplies_as_a_factor(
    stage: str, unit: str, size: float, by_hand: dict[float, float]
) -> None:
    """A coefficient of 0.04 over slips up to 0.5, with a deviation of a quarter of it."""
    part = curve_part("unknown:slip@x", stage, DRIVEN, 1, 1, size)
    vector = SimpleNamespace(places=lambda _: np.array([0]))
    fit = SimpleNamespace(vector=vector, theta=np.array([0.04]), covariance=np.array([[1e-4]]))
    slips = np.array([0.0, 0.2, 0.5])
    shown = curve_shown(part, stage, DRIVEN, slips, fit)  # type: ignore[arg-type]
    assert "factor" not in shown
    assert shown["unit"] == unit
    values = np.interp([*by_hand], shown["x"], shown["added"])
    assert values == pytest.approx([*by_hand.values()], abs=1e-12)
    assert shown["high"] - shown["added"] == pytest.approx(0.49 * shown["added"], abs=1e-12)
    # At the far end it is what the model adds to a wheel there.
    at = conditions(slip=np.array([0.5]))
    effect = curve(stage, DRIVEN, size, c1=0.04)
    named = "sinkage" if stage == "height" else "resistance"
    with_it, without = (
        getattr(predict(m, at), named) for m in (Model("dry_sand") + effect, Model("dry_sand"))
    )
    whole = 60.0 if stage == "drag" else 1.0
    assert whole * shown["added"][-1] == pytest.approx(float((with_it - without)[0]), rel=1e-6)
    factor = curve_shown(part, "sinkage", DRIVEN, slips, fit)  # type: ignore[arg-type]
    assert {*factor} == {"setting", "stage", "x", "factor", "low", "high"}
    assert factor["factor"][-1] == pytest.approx(np.exp(0.08))


def test_every_stage_that_adds_has_words() -> None:
    assert {name for name, stage in STAGES.items() if stage.adds} == set(ADDED)
