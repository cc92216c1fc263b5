# SPDX-License-Identifier: Apache-2.0
"""What an effect says of itself: drivers, side, where it never acts, the next step to take.

Tests `base.py`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from effect_forms import FORMS, ROLLING, named
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples

from smallwheel_ros.effects.base import STAGES, Array, Effect, EffectError, WheelState, parameter
from smallwheel_ros.effects.registry import covariate, effect_class, families, load_effects
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import soil

SAND = soil("dry_sand")
SETTINGS = ("load", "diameter", "width")
USERS = """
from dataclasses import dataclass
import numpy as np
from smallwheel_ros.effects import Effect, parameter

@dataclass(frozen=True)
class Mine(Effect):
    id = "mine"
    summary = "Heavy wheels meet firmer soil."
    formula = "k = k0 (W / 60 N)^a"
    source = "ours"
    {line}
    a: float = parameter(0.1, (-1.0, 1.0), "growth")

    def modulus_factor(self, conditions):
        return (conditions.load / 60.0) ** self.a
"""


@pytest.mark.parametrize("form", FORMS, ids=named)
class TestEveryForm:
    def test_says_what_to_do_next(self, form: type[Effect]) -> None:
        assert form.next_step.endswith(".")
        assert form.next_step[0].isupper()

    def test_its_drivers_are_settings_that_it_reads(self, form: type[Effect]) -> None:
        assert set(form.drivers) <= {*form.needs, *SETTINGS}
        assert not form.needs or form.drivers
        assert form.side == 0 or form.drivers

    def test_acts_where_all_is_varied(self, form: type[Effect]) -> None:
        assert form.never_acts(ROLLING) == ""

    def test_acts_nowhere_without_its_columns(self, form: type[Effect]) -> None:
        bare = Conditions.of(60.0, 0.2, 0.1)
        expected = f"the data has no column '{form.needs[0]}'" if form.needs else ""
        assert form.never_acts(bare) == expected

    def test_does_nothing_where_it_says_so(self, form: type[Effect]) -> None:
        """Rows on the other side of its first driver, by the prediction itself."""
        if not form.side:
            return
        other = dict(ROLLING.covariates)
        driver = form.drivers[0]
        other[driver] = -form.side * np.abs(other[driver])
        if driver == "grouser_height":
            other[driver] = np.zeros(3)
        rows = Conditions.of(ROLLING.load, ROLLING.diameter, ROLLING.width, **other)
        assert form.never_acts(rows) != ""
        with_it, without = predict(Model(SAND) + form(), rows), predict(Model(SAND), rows)
        assert with_it.sinkage == pytest.approx(without.sinkage, rel=1e-14)
        assert with_it.drawbar_pull == pytest.approx(without.drawbar_pull, rel=1e-14)

    @given(data=st.data())
    @settings(max_examples=examples(12))
    def test_is_finite_at_any_strength(self, form: type[Effect], data: st.DataObject) -> None:
        strengths = {
            p.name: data.draw(st.floats(*p.bounds, allow_subnormal=False), label=p.name)
            for p in form.parameters()
        }
        made = replace(form.suited_to(ROLLING), **strengths)
        predicted = predict(Model(SAND) + made, ROLLING)
        for name in ("sinkage", "resistance", "drawbar_pull", "true_sinkage", "true_resistance"):
            assert np.isfinite(getattr(predicted, name)).all(), name


@pytest.mark.parametrize(
    ("id", "covariates", "reason"),
    [
        ("slip_sinkage", {"slip": [0.02, -0.5]}, "no row has a driven wheel that slips (slip over"),
        ("slip_sinkage", {"slip": [0.03, -0.5]}, ""),
        ("slip_sinkage", {"slip": [0.0, -0.5]}, "no row has slip over 0"),
        ("skid_sinkage", {"slip": [-0.02, 0.5]}, "no row has a wheel that skids (slip under -0.02"),
        ("skid_sinkage", {"slip": [-0.03, 0.5]}, ""),
        ("multipass", {"pass_number": [1, 1]}, "no row is of a second pass"),
        ("multipass", {"pass_number": [1, 2]}, ""),
        ("slip_angle_sinkage", {"slip_angle": [0.0, 0.0]}, "no row has a slip angle"),
        ("slip_angle_sinkage", {"slip_angle": [0.0, -0.1]}, ""),
        ("slip_resistance", {"slip": [0.0, 0.0]}, "no row has slip"),
        ("slip_resistance", {"slip": [0.0, -0.1]}, ""),
        ("slope", {"slope": [0.0, 0.0]}, "no row is on a slope"),
        ("grouser", {"slip": 0.4, "grouser_height": [0.0, 0.0]}, "no row has grouser_height over"),
        ("grouser", {"slip": 0.0, "grouser_height": [0.0, 0.01]}, "no row has a driven wheel that"),
        ("grouser", {"slip": 0.4, "grouser_height": [0.0, 0.01]}, ""),
        ("penetration_rate", {"speed": [np.nan, np.nan]}, "column 'speed' is blank in every row"),
    ],
)
def test_where_an_effect_never_acts(
    id: str, covariates: dict[str, list[float]], reason: str
) -> None:
    rows = Conditions.of([60.0, 60.0], 0.2, 0.1, **covariates)
    found = families()[id][0].never_acts(rows)
    assert found.startswith(reason)
    assert bool(found) == bool(reason)


def test_a_form_that_acts_on_rolling_wheels_looks_at_those_only() -> None:
    rows = Conditions.of(
        60.0, 0.2, 0.1, contact=["rolling", "pressed"], slip=[0.0, 0.5], speed=[np.nan, 0.1]
    )
    assert families()["slip_sinkage"][0].never_acts(rows) == "no row has slip over 0"
    # The law of rate acts on pressed wheels, too.
    assert families()["penetration_rate"][0].never_acts(rows) == ""
    pressed = Conditions.of(60.0, 0.2, 0.1, contact="pressed", slip=0.5)
    for id in ("slip_sinkage", "bulldozing", "resistance_gain"):
        found = families()[id][0].never_acts(pressed)
        assert found == "it acts on rolling wheels, and no row is of one"
    assert families()["sinkage_gain"][0].never_acts(pressed) == ""


def test_what_the_families_follow() -> None:
    drivers = {id: forms[0].drivers for id, forms in families().items()}
    assert drivers["load_dependent_modulus"] == ("load",)
    assert drivers["width_dependent_modulus"] == ("width",)
    assert drivers["slip_sinkage"] == ("slip",)
    assert drivers["rig_friction"] == ("load",)
    assert drivers["sinkage_gain"] == ()
    assert effect_class("slip_sinkage", "fading_quadratic").drivers == ("slip", "slip_angle")
    assert all(form.drivers == ("air temperature",) for form in covariate("air temperature"))
    sides = {form.id: form.side for form in FORMS if form.side}
    assert sides == {"slip_sinkage": 1, "skid_sinkage": -1, "grouser": 1}


def test_drivers_are_needs_unless_stated() -> None:
    @dataclass(frozen=True)
    class _Base(Effect):
        id = "base"
        needs = ("slip",)

    @dataclass(frozen=True)
    class _Stated(_Base):
        drivers = ("load",)

    class _More(_Stated):
        needs = ("slip", "speed")  # type: ignore[assignment]

    assert (_Base.drivers, _Stated.drivers, _More.drivers) == (("slip",), ("load",), ("load",))


def test_a_users_effect_with_drivers(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(USERS.format(line='drivers = ("load",)'))
    (form,) = load_effects(path)["mine"]
    assert (form.drivers, form.kind, form.side, form.next_step) == (("load",), "soil", 0, "")
    assert form.never_acts(Conditions.of(60.0, 0.2, 0.1)) == ""


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('drivers = ("load")', r"drivers is 'load', expected a tuple of columns, like"),
        ('needs = ("slip")', r"needs is 'slip', expected a tuple of columns, like"),
        ('drivers = ("speed",)', r"drivers names 'speed', expected load, diameter, width or a col"),
        ('kind = "sensor"', r"kind is 'sensor', expected 'soil' or 'instrument'"),
        ("side = 2", r"side is 2, expected -1, 0 or 1"),
    ],
)
def test_a_users_effect_that_says_what_cannot_be(tmp_path: Path, line: str, message: str) -> None:
    path = tmp_path / "mine.py"
    path.write_text(USERS.format(line=line))
    with pytest.raises(EffectError, match=f"mine.py: class Mine: {message}"):
        load_effects(path)


def test_stages_are_called_in_the_order_of_stages() -> None:
    called: list[str] = []

    def noting(stage: str):  # type: ignore[no-untyped-def]
        def act(self: Effect, *arguments: Array | Conditions | WheelState) -> object:
            called.append(stage)
            return getattr(Effect, stage)(self, *arguments)

        return act

    base = dataclass(frozen=True)(
        type("Base", (Effect,), {"id": "all", "__annotations__": {"a": float}, "a": parameter(
            0.0, (0.0, 1.0), "any")} | {stage: noting(stage) for stage in STAGES})
    )  # fmt: skip
    predict(Model(SAND) + base(), ROLLING)
    order = list(dict.fromkeys(called))
    # The resistance is added up after the sinkage is known; each is shown at the end.
    assert order == list(STAGES)
