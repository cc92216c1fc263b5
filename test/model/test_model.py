# SPDX-License-Identifier: Apache-2.0
"""Models composed of effects, and what any model must do.

Tests `stages.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples
from scipy.integrate import quad

from smallwheel_ros.effects import soil as hardpan
from smallwheel_ros.effects.base import Array, Effect, EffectError
from smallwheel_ros.effects.registry import effect, known_physics
from smallwheel_ros.model.model import CalibratedModel, Model, ModelError, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.contact import contact_load, contact_sinkage
from smallwheel_ros.physics.sinkage import closed_form_sinkage, plate_sinkage
from smallwheel_ros.physics.soil import SOILS, Soil, soil

SAND = soil("dry_sand")

SOIL = st.builds(
    Soil,
    st.just("any"),
    k=st.floats(1e4, 1e7),
    n=st.floats(0.2, 1.8),
    m=st.floats(-0.8, 0.8),
    cohesion=st.floats(0, 5e3),
    friction_angle=st.floats(0.2, 0.8),
    shear_displacement=st.floats(0.003, 0.05),
)
WHEEL = {"load": st.floats(1.0, 1e3), "d": st.floats(0.05, 0.6), "b": st.floats(0.02, 0.3)}


@given(any_soil=SOIL, **WHEEL)
@settings(max_examples=examples(100))
def test_sinkage_grows_with_load_and_falls_with_modulus_and_width(
    any_soil: Soil, load: float, d: float, b: float
) -> None:
    at = Conditions.of(
        [load, 1.1 * load, load, load], d, [b, b, 1.1 * b, b], soil=["a"] * 3 + ["b"]
    )
    stiffer = replace(any_soil, name="b", k=1.1 * any_soil.k)
    for geometry in ("contact_integral", "closed_form"):
        model = Model([replace(any_soil, name="a"), stiffer], geometry)  # type: ignore[arg-type]
        z = predict(model, at).sinkage
        assert z[1] > z[0]
        assert z[2] < z[0]
        assert z[3] < z[0]


@given(any_soil=SOIL, scale=st.floats(0.1, 10), **WHEEL)
@settings(max_examples=examples(100))
def test_another_unit_of_force_changes_nothing(
    any_soil: Soil, scale: float, load: float, d: float, b: float
) -> None:
    other = replace(any_soil, k=scale * any_soil.k, cohesion=scale * any_soil.cohesion)
    here = predict(Model(any_soil), Conditions.of(load, d, b, slip=0.2))
    there = predict(Model(other), Conditions.of(scale * load, d, b, slip=0.2))
    assert there.sinkage == pytest.approx(here.sinkage, rel=1e-9)
    assert there.resistance == pytest.approx(scale * here.resistance, rel=1e-9)
    assert there.drawbar_pull == pytest.approx(
        scale * here.drawbar_pull, rel=1e-8, abs=1e-9 * scale * load
    )


@given(any_soil=SOIL, scale=st.floats(0.1, 10), **WHEEL)
@settings(max_examples=examples(100))
def test_another_unit_of_length_changes_nothing(
    any_soil: Soil, scale: float, load: float, d: float, b: float
) -> None:
    """A wheel `scale` times larger; k in Pa/m^(n+m) changes as its unit says."""
    other = replace(
        any_soil,
        k=any_soil.k * scale ** -(2 + any_soil.n + any_soil.m),
        cohesion=any_soil.cohesion * scale**-2,
        shear_displacement=any_soil.shear_displacement * scale,
    )
    here = predict(Model(any_soil), Conditions.of(load, d, b, slip=0.2))
    there = predict(Model(other), Conditions.of(load, scale * d, scale * b, slip=0.2))
    assert there.sinkage == pytest.approx(scale * here.sinkage, rel=1e-9)
    assert there.resistance == pytest.approx(here.resistance, rel=1e-9)
    assert there.thrust == pytest.approx(here.thrust, rel=1e-9)


def test_every_contact_has_its_own_law() -> None:
    at = Conditions.of(60, 0.2, [0.1, 0.1, np.nan], contact=["rolling", "pressed", "plate"])
    predicted = predict(Model(SAND), at)
    modulus = SAND.k * 0.2**SAND.m
    assert predicted.sinkage[0] == contact_sinkage(60, 0.2, 0.1, modulus, 0.8).sinkage
    # soil on both sides of the lowest point: each carries half
    assert 2 * contact_load(predicted.sinkage[1], 0.2, 0.1, modulus, 0.8) == pytest.approx(60)
    assert predicted.sinkage[2] == plate_sinkage(60, 0.2, modulus, 0.8)
    assert (predicted.resistance[1:] == 0).all()
    assert predicted.thrust is None
    assert predicted.drawbar_pull is None


def test_closed_form_is_the_papers() -> None:
    modulus = SAND.k * 0.17**SAND.m
    predicted = predict(Model(SAND, "closed_form"), Conditions.of(65, 0.17, 0.085))
    assert predicted.sinkage == closed_form_sinkage(65, 0.17, 0.085, modulus, 0.8)
    assert predicted.sinkage == pytest.approx(11.9e-3, abs=5e-5)


def test_each_row_has_its_soil() -> None:
    names = ["moist_earth", "dry_sand", "moist_earth"]
    soils = [SOILS[name] for name in ("dry_sand", "calcium_silicate", "moist_earth")]
    together = predict(Model(soils), Conditions.of(30, 0.2, 0.1, soil=names)).sinkage
    alone = [predict(Model(SOILS[n]), Conditions.of(30, 0.2, 0.1)).sinkage[0] for n in names]
    assert together == pytest.approx(alone, rel=1e-14)


def test_effects_act_in_the_order_in_which_they_were_added() -> None:
    half = effect("sinkage_gain", g=-0.5)
    zero = effect("sinkage_offset", offset=0.01)
    at = Conditions.of(60, 0.2, 0.1)
    z = predict(Model(SAND), at).sinkage
    assert predict(Model(SAND) + half + zero, at).sinkage == pytest.approx(z / 2 + 0.01)
    assert predict(Model(SAND) + zero + half, at).sinkage == pytest.approx((z + 0.01) / 2)


def test_sunk_to_the_axle_is_a_status() -> None:
    predicted = predict(Model(soil("calcium_silicate")), Conditions.of([5, 500], 0.2, 0.1))
    assert predicted.immobilised.tolist() == [False, True]
    deeper = Model(SAND) + effect("slip_sinkage", a=8.0)
    at = Conditions.of(60, 0.2, 0.1, slip=[0.0, 0.5])
    assert predict(deeper, at).immobilised.tolist() == [False, True]
    plate = Conditions.of(5000, 0.05, 0.1, contact="plate")
    assert not predict(Model(soil("calcium_silicate")), plate).immobilised.any()  # has no axle


def test_pressed_wheel_does_not_dig() -> None:
    model = Model(SAND) + effect("slip_sinkage", a=2.0)
    at = Conditions.of(60, 0.2, 0.1, contact="pressed", slip=0.5)
    assert predict(model, at).sinkage == predict(Model(SAND), at).sinkage


@dataclass(frozen=True)
class _Failing(Effect):
    id = "failing"

    def modulus_factor(self, conditions: Conditions) -> Array:
        raise ZeroDivisionError("division by zero")


@dataclass(frozen=True)
class _Vanishing(Effect):
    id = "vanishing"

    def wheel_diameter(self, diameter: Array, conditions: Conditions) -> Array:
        return diameter - 0.24


@dataclass(frozen=True)
class _Steeper(Effect):
    id = "steeper"
    needs = ("slip",)

    def exponent_shift(self, conditions: Conditions) -> Array:
        return conditions["slip"]


@dataclass(frozen=True)
class _Crooked(Effect):
    id = "crooked"

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage[1:]


class TestRefusals:
    def test_missing_column(self) -> None:
        with pytest.raises(
            ModelError, match=r"'slip_sinkage' needs the column 'slip'\. The columns are"
        ):
            predict(Model(SAND) + effect("slip_sinkage"), Conditions.of(60, 0.2, 0.1, speed=0.1))

    def test_blank_in_a_rolling_row(self) -> None:
        at = Conditions.of(60, 0.2, 0.1, slip=[0.1, np.nan])
        with pytest.raises(ModelError, match="needs 'slip', which is blank in row 2"):
            predict(Model(SAND) + effect("slip_sinkage"), at)
        with pytest.raises(ModelError, match="slip is blank in row 2"):
            predict(Model(SAND), at)

    def test_form_that_these_rows_forbid(self) -> None:
        model = Model(SAND) + effect("covariate:x", "power", p=1.0)
        with pytest.raises(ModelError, match=r"'x', row 2 has -1; take form 'exponential'"):
            predict(model, Conditions.of(60, 0.2, 0.1, x=[1.0, -1.0]))

    def test_vertical_ground(self) -> None:
        with pytest.raises(ModelError, match=r"slope in row 1 is 1\.6 rad, expected between"):
            predict(Model(SAND), Conditions.of(60, 0.2, 0.1, slope=1.6))

    def test_wheel_that_is_no_more(self) -> None:
        with pytest.raises(EffectError, match=r"diameter -0\.04 in row 1"):
            predict(Model(SAND) + _Vanishing(), Conditions.of(60, 0.2, 0.1))

    def test_failing_effect_is_named(self) -> None:
        with pytest.raises(EffectError, match="'failing' failed in modulus_factor: ZeroDivision"):
            predict(Model(SAND) + _Failing(), Conditions.of(60, 0.2, 0.1))

    def test_effect_of_the_wrong_shape(self) -> None:
        with pytest.raises(
            EffectError, match=r"'crooked': sinkage gave values of shape \(2,\), exp"
        ):
            predict(Model(SAND) + _Crooked(), Conditions.of([60, 70, 80], 0.2, 0.1))

    def test_rows_of_an_unknown_soil(self) -> None:
        model = Model([SOILS["dry_sand"], SOILS["moist_earth"]])
        with pytest.raises(ModelError, match="no soil 'dry_sant': did you mean 'dry_sand'"):
            predict(model, Conditions.of(60, 0.2, 0.1, soil="dry_sant"))
        with pytest.raises(ModelError, match=r"several soils \(dry_sand, moist_earth\)"):
            predict(model, Conditions.of(60, 0.2, 0.1))

    def test_unknown_choices(self) -> None:
        with pytest.raises(ModelError, match="no geometry 'closed': did you mean 'closed_form'"):
            Model(SAND, "closed")  # type: ignore[arg-type]
        with pytest.raises(ModelError, match="no thrust form 'simple'"):
            Model(SAND, thrust_form="simple")  # type: ignore[arg-type]
        with pytest.raises(ModelError, match="at least one soil"):
            Model([])

    def test_closed_form_beyond_its_domain(self) -> None:
        model = Model(replace(SAND, n=2.5), "closed_form")
        model += _Steeper()
        with pytest.raises(ModelError, match=r"closed form needs n < 3, row 2 has n = 3\.4"):
            predict(model, Conditions.of(60, 0.2, 0.1, slip=[0.1, 0.9]))


DEPTH_LAW = hardpan.Exponential(c=40.0)  # pressure exp(40 z) times that of the power law


def pressure(z: float, d: float) -> float:
    return float(SAND.k * d**SAND.m * z**SAND.n * np.exp(40.0 * z))


def borne_by(z: float, d: float, b: float) -> float:
    """Load (N) on one side of the lowest point, by adaptive quadrature over the arc."""
    r, entry = 0.5 * d, float(np.arccos(1.0 - 2.0 * z / d))
    return float(b * r * quad(
        lambda t: pressure(max(r * (np.cos(t) - np.cos(entry)), 0.0), d) * np.cos(t),
        0.0, entry, epsabs=0.0, epsrel=1e-10,
    )[0])  # fmt: skip


def test_where_pressure_is_no_power_of_depth_each_contact_carries_its_load() -> None:
    at = Conditions.of(60.0, 0.2, [0.1, 0.1, np.nan], contact=["rolling", "pressed", "plate"])
    rolling, pressed, plate = predict(Model(SAND) + DEPTH_LAW, at).sinkage
    assert borne_by(rolling, 0.2, 0.1) == pytest.approx(60.0, rel=1e-4)
    assert 2.0 * borne_by(pressed, 0.2, 0.1) == pytest.approx(60.0, rel=1e-4)
    assert np.pi * 0.1**2 * pressure(plate, 0.2) == pytest.approx(60.0, rel=1e-6)
    alone = predict(Model(SAND) + DEPTH_LAW, Conditions.of(60.0, 0.2, np.nan, contact="plate"))
    assert alone.sinkage[0] == pytest.approx(plate)


def test_the_resistance_is_then_the_work_of_that_pressure() -> None:
    found = predict(Model(SAND) + DEPTH_LAW, Conditions.of(60.0, 0.2, 0.1))
    work = quad(lambda z: pressure(z, 0.2), 0.0, found.sinkage[0], epsabs=0.0, epsrel=1e-10)[0]
    assert found.compaction_resistance[0] == pytest.approx(0.1 * work, rel=1e-4)


def test_the_forces_of_a_pull_balance() -> None:
    """Pull is thrust less its own resistance; what the effects add is taken off once."""
    at = Conditions.of(60.0, 0.2, 0.1, slip=[0.0, 0.2, 0.6])
    dragged = Model(SAND) + effect("bulldozing")
    for form in ("stress_integral", "wong_reece", "integrated", "exponential"):
        for model in (Model(SAND, thrust_form=form), replace(dragged, thrust_form=form)):  # type: ignore[arg-type]
            found = predict(model, at)
            assert found.thrust is not None
            assert found.drawbar_pull == pytest.approx(found.thrust - found.rolling_resistance)
    plain, more = predict(Model(SAND), at), predict(dragged, at)
    added = more.true_resistance - more.compaction_resistance
    assert (added > 0.01).all()
    assert plain.drawbar_pull is not None
    assert plain.drawbar_pull - more.drawbar_pull == pytest.approx(added)


@pytest.mark.parametrize("slip", [0.1, 0.5])
def test_in_the_law_of_wong_and_reece_pressure_and_shear_carry_the_load_together(
    slip: float,
) -> None:
    model = Model(SAND, thrust_form="wong_reece")
    found = predict(model, Conditions.of(60.0, 0.2, 0.1, slip=slip))
    r, z = 0.1, float(found.sinkage[0])
    entry = float(np.arccos(1.0 - z / r))
    top = (0.4 + 0.3 * slip) * entry

    def stresses(t: float) -> tuple[float, float]:
        equal = t if t > top else entry - t / top * (entry - top)
        normal = SAND.k * 0.2**SAND.m * max(r * (np.cos(equal) - np.cos(entry)), 0.0) ** SAND.n
        moved = r * ((entry - t) - (1.0 - slip) * (np.sin(entry) - np.sin(t)))
        strong = SAND.cohesion + normal * np.tan(SAND.friction_angle)
        return normal, strong * (1.0 - np.exp(-moved / SAND.shear_displacement))

    def total(part: Callable[[float, float, float], float]) -> float:
        return float(0.1 * r * quad(
            lambda t: part(t, *stresses(t)), 0.0, entry, points=[top], epsabs=0.0, epsrel=1e-9
        )[0])  # fmt: skip

    up = total(lambda t, normal, shear: normal * np.cos(t) + shear * np.sin(t))
    assert up == pytest.approx(60.0, rel=2e-3)
    pull = total(lambda t, normal, shear: shear * np.cos(t) - normal * np.sin(t))
    assert found.drawbar_pull is not None
    assert found.torque is not None
    assert found.drawbar_pull[0] == pytest.approx(pull, rel=5e-3)
    assert found.torque[0] == pytest.approx(r * total(lambda t, normal, shear: shear), rel=5e-3)


@pytest.mark.parametrize(
    ("model", "at", "words"),
    [
        (Model([SAND, SOILS["moist_earth"]]), {}, "has several soils .* and the rows name none"),
        (Model([SAND, SOILS["moist_earth"]]), {"soil": "dry_sandy"}, "no soil 'dry_sandy'.*dry_sand"),
        (
            Model(replace(SAND, n=2.9), "closed_form") + hardpan.PenetrationSpeed(mu=0.4),
            {"speed": 0.1}, "needs n < 3, row 1 has n = 3.1",
        ),
        (Model(SAND) + "slip_sinkage", {}, "'slip_sinkage' needs the column 'slip'"),
        (Model(SAND) + "slip_sinkage", {"slip": [0.1, np.nan]}, "'slip', which is blank in row 2"),
        (Model(SAND), {"slip": [0.1, np.nan]}, "slip is blank in row 2"),
    ],
)  # fmt: skip
def test_what_cannot_be_predicted_is_named(model: Model, at: dict[str, Any], words: str) -> None:
    with pytest.raises(ModelError, match=words):
        predict(model, Conditions.of([60.0, 60.0], 0.2, 0.1, **at))


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"geometry": "closed"}, "no geometry 'closed'.*closed_form"),
        ({"thrust_form": "integral"}, "no thrust form 'integral'"),
        ({"soils": []}, "at least one soil"),
        ({"soils": [0.8]}, "found float, expected a soil or its name"),
    ],
)
def test_what_is_no_model_is_named(parts: dict[str, Any], words: str) -> None:
    with pytest.raises(ModelError, match=words):
        Model(**{"soils": SAND} | parts)


def test_a_fitted_model_knows_what_is_known_of_it_and_is_changed_in_parts() -> None:
    covariance = np.array([[0.04, 0.01], [0.01, 0.25]])
    fitted = CalibratedModel(
        Model(SAND), ("dry_sand.n", "dry_sand.m"), covariance, {"data": "a.csv"},
        rivals=[(1.0, CalibratedModel(Model("moist_earth")))],
    )  # fmt: skip
    assert fitted.standard_deviation("dry_sand.n") == pytest.approx(0.2)
    assert fitted.standard_deviation("dry_sand.m") == pytest.approx(0.5)
    assert fitted.standard_deviation("dry_sand.cohesion") is None
    assert fitted.model == Model(SAND)
    more = fitted + "slip_sinkage"
    assert [one.id for one in more.effects] == ["slip_sinkage"]
    assert more.names == fitted.names
    assert more.covariance is fitted.covariance
    assert more.provenance == {"data": "a.csv"}
    assert more.rivals == ()  # they were rivals of another model
    assert fitted.changed(names=()).rivals == fitted.rivals
    assert CalibratedModel(Model(SAND)).covariance.shape == (0, 0)


@pytest.mark.parametrize("shares", [(0.6,), (0.6, 0.3), (0.6, 0.6), (np.nan, 0.4)])
def test_rivals_whose_probabilities_do_not_sum_to_one_are_refused(
    shares: tuple[float, ...],
) -> None:
    rival = CalibratedModel(Model("moist_earth"))
    with pytest.raises(ModelError, match="sum to"):
        CalibratedModel(Model(SAND), rivals=[(share, rival) for share in shares])


@pytest.mark.parametrize("shares", [(0.33, 0.33, 0.33), (0.667, 0.334), (1.0,)])
def test_probabilities_that_were_rounded_are_made_whole(shares: tuple[float, ...]) -> None:
    rival = CalibratedModel(Model("moist_earth"))
    made = CalibratedModel(Model(SAND), rivals=[(share, rival) for share in shares])
    kept = [share for share, _ in made.rivals]
    assert sum(kept) == pytest.approx(1.0, abs=1e-12)
    assert kept == pytest.approx(shares, rel=0.011)


def test_known_physics_acts_where_its_columns_are() -> None:
    plain = Model(SAND) + "slip_sinkage"
    assert [one.id for one in plain.acting(Conditions.of(60.0, 0.2, 0.1, slip=0.2))] == [
        "slip_sinkage"
    ]
    for form in known_physics():
        there = Conditions.of(60.0, 0.2, 0.1, slip=0.2, **dict.fromkeys(form.needs, 0.01))
        names = [one.id for one in plain.acting(there)]
        assert names == [form.id, "slip_sinkage"]
        own = Model(SAND) + form()
        assert [one.id for one in own.acting(there)] == [form.id]  # once


def test_the_headline_names_soils_rule_and_effects() -> None:
    model = Model(["dry_sand", "moist_earth"], "closed_form") + "slip_sinkage" + "bulldozing"
    assert (
        model.headline() == "dry_sand, moist_earth, closed form, with slip sinkage and bulldozing"
    )
    assert Model(SAND).headline() == "dry_sand, contact integral"
