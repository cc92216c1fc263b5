# SPDX-License-Identifier: Apache-2.0
"""Each effect's law by numbers worked out by hand, and what holds for all of them.

Tests `column_laws.py`, `grousers.py`, `slip.py` and `soil.py`.
"""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from effect_forms import FORMS, ROLLING, named

import smallwheel_ros.effects
from smallwheel_ros.effects.base import STAGES, Effect, EffectError, WheelState
from smallwheel_ros.effects.registry import effect, families
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import soil

CONTRACT = {
    "slip_sinkage", "skid_sinkage", "slip_angle_sinkage", "bulldozing", "penetration_rate",
    "load_dependent_modulus", "width_dependent_modulus", "multipass", "elastic_rebound", "grouser",
    "hardpan", "moisture", "slope", "contact_geometry", "sinkage_offset",
    "sinkage_gain", "load_offset", "load_gain", "resistance_offset", "resistance_gain",
    "rig_friction", "slip_resistance",
}  # fmt: skip
SAND = soil("dry_sand")


def acting(form: type[Effect]) -> Effect:
    """The form on the data, at a strength that shows."""
    made = form.suited_to(ROLLING)
    return replace(made, **{p.name: p.start for p in form.parameters() if p.start != p.neutral})


def example(id: str, form: str | None = None, **values: float) -> Effect:
    return effect(id, form, **values)


def one_row(**covariates: float) -> Conditions:
    return Conditions.of(60.0, 0.2, 0.1, **covariates)


def test_the_contract_has_its_ids() -> None:
    assert set(families()) >= CONTRACT
    assert all(form.id == id for id, forms in families().items() for form in forms)


@pytest.mark.parametrize("form", FORMS, ids=named)
class TestEveryForm:
    def test_describes_itself(self, form: type[Effect]) -> None:
        assert form.summary.endswith(".")
        assert form.formula
        assert form.source
        assert form.form
        assert form.stage in (*STAGES, "geometry")
        assert set(form.channels) <= {"sinkage", "resistance", "drawbar_pull", "torque"}
        for known in form.parameters():
            low, high = known.bounds
            assert low <= known.start <= high
            assert known.description
            assert known.unit
            if known.neutral is not None:
                assert low <= known.neutral <= high
                assert known.start != known.neutral
            if known.published is not None:
                assert low <= known.published[0] < known.published[1] <= high

    def test_touches_its_channels_and_no_other(self, form: type[Effect]) -> None:
        geometry = "closed_form" if form.geometry else "contact_integral"
        base = predict(Model(SAND, geometry), without(form))
        changed = predict(Model(SAND, geometry) + acting(form), ROLLING)
        pairs = {
            "sinkage": (base.sinkage, changed.sinkage),
            "resistance": (base.resistance, changed.resistance),
            "drawbar_pull": (base.drawbar_pull, changed.drawbar_pull),
            "torque": (base.torque, changed.torque),
        }
        for channel, (before, after) in pairs.items():
            assert before is not None
            assert after is not None
            differs = bool((np.abs(after / before - 1) > 1e-6).any())
            assert differs == (channel in form.channels), channel

    def test_vanishes_at_its_neutral_point(self, form: type[Effect]) -> None:
        neutral = {p.name: p.neutral for p in form.parameters() if p.neutral is not None}
        if not neutral:
            assert form.known_physics or form.geometry
            return
        base = predict(Model(SAND), ROLLING)
        model = Model(SAND) + replace(form.suited_to(ROLLING), **neutral)
        same = predict(model, ROLLING)
        assert same.sinkage == pytest.approx(base.sinkage, rel=1e-9)
        assert same.resistance == pytest.approx(base.resistance, rel=1e-8)
        assert same.thrust == pytest.approx(base.thrust, rel=1e-9)

    def test_is_finite_over_its_bounds(self, form: type[Effect]) -> None:
        made = acting(form)
        for known in form.parameters():
            for value in known.bounds:
                model = Model(SAND) + replace(made, **{known.name: value})
                predicted = predict(model, ROLLING)
                assert np.isfinite(predicted.sinkage).all()
                assert np.isfinite(predicted.resistance).all()

    def test_leaves_a_body_at_rest_alone_where_it_is_not_told(self, form: type[Effect]) -> None:
        """Blank covariates of a pressed wheel or a plate do nothing, and poison nothing."""
        blank = {name: [0.1, np.nan, np.nan] for name in ROLLING.covariates}
        mixed = Conditions.of(
            60.0, 0.2, [0.1, 0.1, np.nan], contact=["rolling", "pressed", "plate"], **blank
        )
        predicted = predict(Model(SAND) + acting(form), mixed)
        base = predict(Model(SAND), mixed)
        for values in (predicted.sinkage, predicted.resistance, predicted.drawbar_pull):
            assert np.isfinite(values).all()
        assert (predicted.resistance[1:] == 0).all()
        # only laws that read no further column, of pressure, of the load, or of the instrument
        if form.needs and "exponent_shift" not in form.acts:
            assert predicted.sinkage[1:] == pytest.approx(base.sinkage[1:], rel=1e-12)

    def test_reaches_other_processes(self, form: type[Effect]) -> None:
        made = acting(form)
        again = pickle.loads(pickle.dumps(made))
        assert again == made
        assert again.id == form.id

    def test_refuses_numbers_outside_its_bounds(self, form: type[Effect]) -> None:
        for known in (*form.parameters(), *form.constants()):
            for wrong in (known.bounds[1] + 1.0 + abs(known.bounds[1]), float("nan")):
                with pytest.raises(EffectError, match=f"'{form.id}': {known.name} is"):
                    form(**{known.name: wrong})


def without(form: type[Effect]) -> Conditions:
    """The rows; for gravity, which is applied by itself, without what makes it act."""
    if not form.known_physics:
        return ROLLING
    kept = {k: v for k, v in ROLLING.covariates.items() if k not in form.needs}
    return Conditions.of(ROLLING.load, ROLLING.diameter, ROLLING.width, **kept)


# z over z0 where slip is 0.4, or -0.4, or the slip angle 0.3
@pytest.mark.parametrize(
    ("made", "at", "factor"),
    [
        (example("slip_sinkage", a=2.0), {"slip": 0.4}, np.exp(0.8)),
        (example("slip_sinkage", "quadratic", s=2.0, q=0.5), {"slip": 0.4}, 1.56),
        (example("slip_sinkage", a=2.0), {"slip": -0.4}, 1.0),
        (example("skid_sinkage", "quadratic", s=5.0, q=1.0), {"slip": -0.4}, 1.8),
        (example("skid_sinkage", s=5.0), {"slip": 0.4}, 1.0),
        (example("slip_angle_sinkage", a=2.0), {"slip_angle": -np.pi / 3}, 2.0),
        (example("slip_angle_sinkage", "power", a=0.5, p=2.0), {"slip_angle": -1.0}, 3.0),
        (example("multipass", p=0.5), {"pass_number": 4}, 2.0),
    ],
    ids=lambda v: named(type(v)) if isinstance(v, Effect) else None,
)
def test_laws_of_sinkage(made: Effect, at: dict[str, float], factor: float) -> None:
    conditions = one_row(**at)
    ratio = (
        predict(Model(SAND) + made, conditions).sinkage / predict(Model(SAND), conditions).sinkage
    )
    assert ratio == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize(
    ("made", "at", "factor"),
    [
        (example("penetration_rate", mu=0.5, v0=0.1), {"speed": 0.4}, 2.0),
        (example("penetration_rate", mu=0.5, v0=0.1), {"speed": -0.4}, 2.0),
        (example("penetration_rate", mu=0.5, v0=0.1), {"speed": 0.0}, 0.1),  # as at 1 mm/s
        (example("load_dependent_modulus", g=0.5, w0=15.0), {}, 2.0),
        (example("width_dependent_modulus", "bekker", a=0.25, b0=0.3), {}, 1.5),
        (example("multipass", "hardening", p=0.5), {"pass_number": 4}, 2.0),
        (
            example("moisture", a=-1.0, reference=0.1, scale=0.05),
            {"moisture": 0.2},
            np.exp(-2.0),
        ),
        (example("moisture", "power", p=-0.5, reference=0.1), {"moisture": 0.4}, 0.5),
        (example("covariate:temperature", a=0.5, scale=10.0), {"temperature": 20.0}, np.e),
    ],
    ids=lambda v: named(type(v)) if isinstance(v, Effect) else None,
)
def test_laws_of_modulus(made: Effect, at: dict[str, float], factor: float) -> None:
    changed = Model(replace(SAND, k=SAND.k * factor))
    predicted = predict(Model(SAND) + made, one_row(**at))
    expected = predict(changed, one_row(**at))
    assert predicted.sinkage == pytest.approx(expected.sinkage, rel=1e-10)
    assert predicted.resistance == pytest.approx(expected.resistance, rel=1e-10)


def test_entry_speed_law_is_its_formula() -> None:
    # p = k z^n D^m (v sqrt(z/D) / v0)^mu is a soil of another k, n and m
    mu, v0, v = 0.2, 0.03, 0.3
    made = example("penetration_rate", "penetration_speed", mu=mu, v0=v0)
    other = replace(SAND, k=SAND.k * (v / v0) ** mu, n=SAND.n + mu / 2, m=SAND.m - mu / 2)
    predicted = predict(Model(SAND) + made, one_row(speed=v))
    assert predicted.sinkage == pytest.approx(predict(Model(other), one_row()).sinkage, rel=1e-12)


@pytest.mark.parametrize(("form", "newtons"), [("rankine", 4.7)])
def test_bulldozing_at_the_scale_of_a_small_wheel(form: str, newtons: float) -> None:
    """The project's reference figures: D 0.2, b 0.1, z 20 mm, phi 33 deg, c 0.5 kPa."""
    numbers = (84.0, 0.2, 0.1, 0.02, 1e5, 0.8, 500.0, np.radians(33.0))
    state = WheelState(*(np.array([v]) for v in numbers))
    made = example("bulldozing", form, scale=1.0)
    assert made.added_resistance(state, one_row()) == pytest.approx(newtons, rel=0.06)


def test_bulldozing_is_invisible_in_sinkage() -> None:
    base = predict(Model(SAND), one_row())
    pushed = predict(Model(SAND) + example("bulldozing", scale=2.0), one_row())
    assert (pushed.sinkage == base.sinkage).all()
    assert (pushed.compaction_resistance == base.compaction_resistance).all()
    assert (pushed.resistance > base.resistance).all()


@pytest.mark.parametrize("form", ["rankine"])
def test_bulldozing_follows_the_models_soil(form: str) -> None:
    made = example("bulldozing", form)

    def pushed(**strength: float) -> float:
        predicted = predict(Model(replace(SAND, **strength)) + made, one_row())
        return float((predicted.resistance - predicted.compaction_resistance)[0])

    depth = float(predict(Model(SAND), one_row()).sinkage[0])
    more = pushed(cohesion=2000.0) - pushed(cohesion=0.0)
    phi = SAND.friction_angle
    slope = {"rankine": 2 * np.tan(np.pi / 4 + phi / 2)}
    assert more == pytest.approx(0.1 * 2000.0 * depth * slope[form], rel=1e-9)
    assert pushed(friction_angle=0.7) > pushed(friction_angle=0.5)


def test_soil_that_is_dug_away_costs_no_compaction() -> None:
    base, dug = predict(Model(SAND), one_row(slip=0.5)), None
    dug = predict(
        Model(SAND) + example("slip_sinkage", "partly_dug_quadratic", c=0.0), one_row(slip=0.5)
    )
    assert dug.sinkage > 1.3 * base.sinkage
    assert dug.compaction_resistance == pytest.approx(base.compaction_resistance, rel=1e-12)
    compacted = predict(Model(SAND) + example("slip_sinkage"), one_row(slip=0.5))
    assert compacted.compaction_resistance > 1.3 * base.compaction_resistance


def test_rebound_is_pressure_over_stiffness() -> None:
    made = example("elastic_rebound", compliance=1e-7)
    z = predict(Model(SAND), one_row()).sinkage
    shown = predict(Model(SAND) + made, one_row()).sinkage
    assert z - shown == pytest.approx(1e-7 * 60.0 / (0.1 * np.sqrt(0.2 * z)), rel=1e-12)


def test_grousers() -> None:
    at = one_row(slip=0.5, grouser_height=0.01)
    z = predict(Model(SAND), at).sinkage
    digging = predict(Model(SAND) + example("grouser", a=1.0), at).sinkage
    assert digging - z == pytest.approx(0.005)
    reece = predict(Model(SAND) + example("grouser", "lug_digging", a=1.0), at).sinkage
    assert reece - z == pytest.approx(0.010)


@pytest.mark.parametrize(
    ("cohesion", "degrees", "growth"),
    [
        (2e3, 0.0, 2 * 0.1),
        (0.0, 30.0, 0.64 * 0.1 * np.arctan(10.0)),
        (0.0, 0.0, 0.0),
    ],
    ids=["cohesion", "friction", "none"],
)
def test_grousers_raise_cohesion_and_friction_by_bekkers_shares(
    cohesion: float, degrees: float, growth: float
) -> None:
    """h/b is 0.1; the thrust of a soil without strength is and stays 0."""
    model = Model(replace(SAND, cohesion=cohesion, friction_angle=np.radians(degrees)))
    at = one_row(slip=0.5, grouser_height=0.01)
    pull = predict(model + example("grouser", "traction", a=1.5), at).thrust
    assert pull == pytest.approx(predict(model, at).thrust * (1.0 + 1.5 * growth), rel=1e-12)


@pytest.mark.parametrize(
    ("made", "law"),
    [
        (example("hardpan", c=25.0), lambda z: -np.log(1 - 25 * z) / (25 * z)),
        (example("hardpan", "two_layer", s=4.0, h=0.02), lambda z: 1 + 4 * z**2 / (z**2 + 4e-4)),
        (example("hardpan", "exponential", c=25.0), lambda z: np.exp(25 * z)),
    ],
    ids=["preston_thomas", "two_layer", "exponential"],
)
def test_a_hard_layer_carries_the_load_and_costs_its_work(made: Effect, law) -> None:  # type: ignore[no-untyped-def]
    from scipy.integrate import quad

    predicted = predict(Model(SAND) + made, one_row())
    z, modulus = float(predicted.sinkage[0]), SAND.k * 0.2**SAND.m
    cos0 = 1 - z / 0.1

    def carried(u: float) -> float:  # theta = theta0 (1 - u^3)
        theta0 = np.arccos(cos0)
        theta = theta0 * (1 - u**3)
        depth = 0.1 * (np.cos(theta) - cos0)
        return float(modulus * depth**SAND.n * law(depth) * np.cos(theta) * theta0 * 3 * u**2)

    assert 0.1 * 0.1 * quad(carried, 1e-9, 1, epsrel=1e-11)[0] == pytest.approx(60.0, rel=1e-7)
    work = quad(lambda s: modulus * s**SAND.n * law(s), 1e-12, z, epsrel=1e-11)[0]
    assert predicted.compaction_resistance == pytest.approx(0.1 * work, rel=1e-7)


def test_gravity_is_applied_wherever_there_is_a_slope() -> None:
    flat = predict(Model(SAND), Conditions.of(60.0 * np.cos(0.3), 0.2, 0.1))
    uphill = predict(Model(SAND), one_row(slope=0.3))
    assert uphill.sinkage == pytest.approx(flat.sinkage, rel=1e-13)
    assert uphill.resistance - flat.resistance == pytest.approx(60.0 * np.sin(0.3), rel=1e-12)
    named_too = predict(Model(SAND) + example("slope"), one_row(slope=0.3))
    assert named_too.resistance == pytest.approx(uphill.resistance, rel=1e-15)  # not twice


def test_contact_geometry_is_a_rule_of_the_model() -> None:
    model = Model(SAND, "closed_form") + example("contact_geometry")
    assert model == Model(SAND)


def test_offset_is_the_instruments() -> None:
    made = example("sinkage_offset", offset=-0.002)
    shown, true = predict(Model(SAND) + made, one_row()), predict(Model(SAND), one_row())
    assert shown.sinkage - true.sinkage == pytest.approx(-0.002)
    assert (shown.resistance == true.resistance).all()


def test_default_forms_have_names_of_their_own() -> None:
    from smallwheel_ros.effects import Bulldozing, SlipSinkage

    assert SlipSinkage is families()["slip_sinkage"][0]
    assert Bulldozing is families()["bulldozing"][0]
    for id in CONTRACT:
        name = "".join(part.capitalize() for part in id.split("_"))
        assert getattr(smallwheel_ros.effects, name).id == id
    with pytest.raises(AttributeError, match="NoSuchEffect"):
        _ = smallwheel_ros.effects.NoSuchEffect
