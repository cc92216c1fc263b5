# SPDX-License-Identifier: Apache-2.0
"""Ranges, tables of predictions, and the soil that is chosen from a model."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect, WheelState
from smallwheel_ros.effects.registry import effect
from smallwheel_ros.measurements.cells import read_numbers
from smallwheel_ros.measurements.columns import COLUMNS, OTHER
from smallwheel_ros.measurements.typed import RangeError, typed
from smallwheel_ros.model.model import CalibratedModel, Model, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import SOILS, Soil, soil, usual_strength
from smallwheel_ros.prediction.prediction import PredictionError, on_one_soil, predict_table

Array = NDArray[np.float64]


@pytest.mark.parametrize(
    ("text", "unit", "values"),
    [
        ("60", "N", [60]),
        ("20:140:40", "N", [20, 60, 100, 140]),
        ("0.1:0.35:0.1", "1", [0.1, 0.2, 0.3]),
        ("0.1,0.2", "1", [0.1, 0.2]),
        ("1:3:1, 10".replace(" ", ""), "N", [1, 2, 3, 10]),
        ("17 cm", "m", [0.17]),
        ("85mm", "m", [0.085]),
        ("1e-1", "m", [0.1]),
        ("0.06 kN", "N", [60]),
        ("10,20 deg", "rad", [np.pi / 18, np.pi / 9]),
        ("-0.3:0.3:0.3", "1", [-0.3, 0, 0.3]),
        ("20 degC", None, [293.15]),
        ("0..60%", "1", [0.0, 0.3, 0.6]),
        ("0:60:20%", "1", [0.0, 0.2, 0.4, 0.6]),
        ("10%,20%", "1", [0.1, 0.2]),
        ("10 °,20 °", "rad", [np.pi / 18, np.pi / 9]),
        ("\u22125 N", "N", [-5]),
        ("1 234 N", "N", [1234]),
        ("5 kgf", "N", [49.03325]),
    ],
)
def test_ranges(text: str, unit: str | None, values: list[float]) -> None:
    assert typed("--load", text, unit).values == pytest.approx(values)


@pytest.mark.parametrize(
    ("name", "text", "values"),
    [
        ("slip", "0,2", [0.2]),  # a slip of 2 there is not
        ("slip", "0,05", [0.05]),  # nobody writes 0 and 05
        ("slip", "0,1:0,5:0,2", [0.1, 0.3, 0.5]),
        ("slip", "0,1..0,5", [0.1, 0.3, 0.5]),
        ("slip", "0,1;0,3", [0.1, 0.3]),
        ("diameter", "0,17", [0.17]),  # nor a diameter of 0
        ("load", "1,250;2,5", [1.25, 2.5]),
        ("speed", "1.234,5;0,5 mm/s", [1.2345, 0.0005]),
    ],
)
def test_a_comma_is_a_decimal_mark_where_it_can_be_nothing_else(
    name: str, text: str, values: list[float]
) -> None:
    read = typed(name, text, COLUMNS[name].unit)
    assert read.values == pytest.approx(values)
    assert f"'{text}' -> {name}" in read.said
    assert read.said.endswith("a decimal comma")


@pytest.mark.parametrize(
    ("name", "text", "values"),
    [
        ("slip", "0,1", [0, 1]),
        ("load", "20,60", [20, 60]),
        ("load", "1,250", [1, 250]),
        ("diameter", "170,200", [170, 200]),  # refused by who takes it, as a list
        ("heat", "0,2", [0, 2]),
    ],
)
def test_any_other_comma_makes_a_list(name: str, text: str, values: list[float]) -> None:
    read = typed(name, text, COLUMNS.get(name, OTHER).unit or None)
    assert read.values == pytest.approx(values)
    assert read.said == ""


_VALUE = st.floats(-900, 900).map(lambda value: float(f"{value:.5g}"))


@given(st.lists(_VALUE, min_size=1, max_size=4))
def test_a_typed_number_is_read_as_a_cell_of_a_table(values: list[float]) -> None:
    """Points or commas, in per cent or not: what a column of the same texts would be."""
    points = [repr(value) for value in values]
    commas = [text.replace(".", ",") for text in points]
    assert typed("--x", ",".join(points), None).values == pytest.approx(values)
    (column,) = read_numbers([points], False)
    assert column.values == pytest.approx(values)
    assert typed("--x", "%,".join(points) + "%", "1").values == pytest.approx(
        [value / 100 for value in values]
    )
    for texts, expected in ((commas[:1], values[:1]), (commas + commas, values + values)):
        (column,) = read_numbers([texts], False)
        if column.faults:  # 1,234 may be a thousand
            with pytest.raises(RangeError, match="two ways"):
                typed("--x", ";".join(texts), None, several=False)
        else:
            read = typed("--x", ";".join(texts), None, several=len(texts) > 1)
            assert read.values == pytest.approx(expected)


@given(
    st.text(alphabet="0123456789.,;:%eE+- kgNm'", max_size=12), st.sampled_from(["1", "N", None])
)
def test_whatever_is_typed_is_finite_numbers_or_refused(text: str, unit: str | None) -> None:
    for several in (True, False):
        with suppress(RangeError):
            read = typed("--x", text, unit, several=several)
            assert read.values.size
            assert np.isfinite(read.values).all()


@pytest.mark.parametrize("text", ["5 kg", "5000 g", "5kg", "0.005 t"])
def test_a_mass_is_its_weight_and_that_is_said(text: str) -> None:
    read = typed("load", text, "N")
    assert read.values == pytest.approx([49.03325])
    assert read.said == f"'{text}' -> load 49.03 N, the weight of that mass"
    assert typed("ballast", text, None).values == pytest.approx([5.0])  # not a force
    assert typed("ballast", text, None).said == ""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "--load: found '', expected a number"),
        ("many", "--load: found 'many'"),
        ("1:2", "a range is start:stop:step"),
        ("1:2:0", "the range '1:2:0' is empty"),
        ("5:2:1", "the range '5:2:1' is empty"),
        ("1:1e9:1", "1000000000 values, at most 100000"),
        ("1,,2", "--load: found '1,,2'"),
        ("1e999", "expected finite numbers"),
        ("20 V", "--load: unit 'V' is .*, expected a force"),
        ("20 newtonn", "--load: unknown unit 'newtonn'"),
        ("10%,20", "--load: found '10%,20'"),
        ("30%", "--load: unit '%' is a pure number, expected a force"),
        ("5..2", "the range '5..2' is empty"),
        ("1..2..3", "the range '1..2..3' is empty"),
        ("1,250;1,500", "can be read in two ways"),
        ("1.5.2", "--load: found '1.5.2', expected a number"),
        (";", "--load: found ';', expected a number"),
    ],
)
def test_texts_that_are_no_range(text: str, message: str) -> None:
    with pytest.raises(RangeError, match=message):
        typed("--load", text, "N")


def test_table_is_the_models_prediction() -> None:
    model = Model(soil("dry_sand")) + effect("slip_sinkage", a=1.0)
    settings = {
        "load": np.array([20.0, 60.0]),
        "diameter": np.array([0.2]),
        "width": np.array([0.1]),
        "slip": np.array([0.1, 0.3, 0.5]),
    }
    table = predict_table(CalibratedModel(model), settings)
    assert table.varied == ("load", "slip")
    rows = table.rows()
    assert [(r["load"], r["slip"]) for r in rows] == [
        (20, 0.1), (20, 0.3), (20, 0.5), (60, 0.1), (60, 0.3), (60, 0.5),
    ]  # fmt: skip
    alone = predict(model, Conditions.of(60, 0.2, 0.1, slip=0.3))
    assert rows[4]["sinkage"] == alone.sinkage[0]
    assert rows[4]["drawbar_pull"] == pytest.approx(alone.drawbar_pull[0], rel=1e-12)  # type: ignore[index]
    assert rows[4]["status"] == "ok"
    assert "sinkage_std" not in rows[4]
    assert rows[4]["torque"] == pytest.approx(alone.torque[0], rel=1e-12)  # type: ignore[index]


def test_a_sunk_wheel_has_no_numbers() -> None:
    settings = {
        "load": np.array([5.0, 500.0]),
        "diameter": np.array([0.2]),
        "width": np.array([0.1]),
    }
    calibrated = CalibratedModel(
        Model(soil("calcium_silicate")), ("calcium_silicate.n",), np.array([[1e-4]])
    )
    rows = predict_table(calibrated, settings).rows()
    assert rows[0]["sinkage"] > 0
    assert rows[0]["sinkage_std"] > 0
    assert rows[1]["status"] == "immobilised: sunk to the axle"
    assert rows[1]["sinkage"] is None
    assert rows[1]["sinkage_std"] is None


def test_one_of_several_soils() -> None:
    names = ("dry_sand.n", "moist_earth.n", "slip_sinkage.a")
    model = Model([soil("dry_sand"), soil("moist_earth")]) + effect("slip_sinkage", a=1.0)
    covariance = np.diag([1.0, 2.0, 3.0])
    both = CalibratedModel(model, names, covariance)
    one = on_one_soil(both, "moist_earth", "m.yaml")
    assert one.model == Model(soil("moist_earth")) + effect("slip_sinkage", a=1.0)
    assert one.names == ("moist_earth.n", "slip_sinkage.a")
    assert one.covariance.tolist() == [[2.0, 0.0], [0.0, 3.0]]
    with pytest.raises(PredictionError, match=r"m.yaml: has several soils \(dry_sand, moist_earth"):
        on_one_soil(both, None, "m.yaml")
    with pytest.raises(PredictionError, match=r"m.yaml: has no soil 'drysand': did you mean"):
        on_one_soil(both, "drysand", "m.yaml")


def test_a_soil_whose_name_begins_with_another_keeps_its_deviations() -> None:
    sand = soil("dry_sand")
    model = Model([replace(sand, name="sand 1"), replace(sand, name="sand 1.5")])
    both = CalibratedModel(model, ("sand 1.n", "sand 1.5.n"), np.diag([1.0, 2.0]))
    for name, variance in (("sand 1", 1.0), ("sand 1.5", 2.0)):
        one = on_one_soil(both, name, "m.yaml")
        assert (one.names, one.covariance.tolist()) == ((f"{name}.n",), [[variance]])


def test_refusals() -> None:
    one = np.array([1.0])
    calibrated = CalibratedModel(Model(soil("dry_sand")))
    with pytest.raises(PredictionError, match=r"slip is 1\.5, expected -1 to 1"):
        predict_table(
            calibrated, {"load": one, "diameter": one, "width": one, "slip": np.array([0.1, 1.5])}
        )
    many = np.linspace(1, 2, 700)
    with pytest.raises(PredictionError, match="490000 combinations, at most 200000"):
        predict_table(calibrated, {"load": many, "diameter": many, "width": one})


@dataclass(frozen=True)
class _Broken(Effect):
    """A user's formula that is none from some slip on."""

    id = "broken"
    needs = ("slip",)
    drivers = ("slip",)

    def _change(self, conditions: Conditions) -> Array:
        return np.where(conditions["slip"] > 0.35, self.beyond, 1.0)

    beyond = np.nan


class _AtStiffness(_Broken):
    def modulus_factor(self, conditions: Conditions) -> Array:
        return self._change(conditions)


class _NegativeStiffness(_AtStiffness):
    beyond = -1.0


class _InfiniteDepth(_Broken):
    beyond = np.inf

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage * self._change(conditions)


class _AtResistance(_Broken):
    def added_resistance(self, state: WheelState, conditions: Conditions) -> Array:
        return self._change(conditions)


@pytest.mark.parametrize(
    "broken", [_AtStiffness, _NegativeStiffness, _InfiniteDepth, _AtResistance]
)
def test_an_effect_that_gives_no_number_is_named_with_row_and_setting(
    broken: type[_Broken],
) -> None:
    model = Model("dry_sand", effects=[effect("slip_sinkage", a=1.0), broken()])
    settings = {
        "load": np.array([20.0, 60.0]), "diameter": np.array([0.2]), "width": np.array([0.1]),
        "slip": np.array([0.1, 0.3, 0.4, 0.5]),
    }  # fmt: skip
    said = (
        r"row 3 of 8 \(load 20, diameter 0\.2, width 0\.1, slip 0\.4\): effect 'broken' gives no "
        "finite number, nor in 3 of the other rows"
    )
    with pytest.raises(PredictionError, match=said):
        predict_table(CalibratedModel(model), settings)
    good = predict_table(CalibratedModel(model), settings | {"slip": np.array([0.1, 0.3])})
    assert [row["status"] for row in good.rows()] == ["ok"] * 4


def test_every_wheel_that_is_not_refused_has_finite_numbers_or_is_sunk() -> None:
    """At the corners of what settings may be."""
    corners = {
        name: np.array([COLUMNS[name].low, COLUMNS[name].high])
        for name in ("load", "diameter", "width", "slip")
    }
    for name in SOILS:
        table = predict_table(CalibratedModel(Model(soil(name))), corners)
        for row in table.rows():
            known = [row[q] for q in ("sinkage", "resistance", "thrust", "drawbar_pull")]
            assert row["status"] != "ok" or np.isfinite(known).all(), row


@given(
    st.sampled_from(["load", "diameter", "width", "slip", "speed", "slope", "temperature"]),
    st.floats(allow_nan=True),
)
def test_a_setting_is_predicted_just_where_a_table_may_have_it(name: str, value: float) -> None:
    spec = COLUMNS.get(name, OTHER)
    settings = {"load": 60.0, "diameter": 0.2, "width": 0.1} | {name: value}
    columns = {one: np.array([number]) for one, number in settings.items()}
    if spec.low <= value <= spec.high:
        rows = predict_table(CalibratedModel(Model(soil("dry_sand"))), columns).rows()
        assert rows[0]["status"] != "ok" or np.isfinite(rows[0]["sinkage"])
    elif not spec.low * 0.9 <= value <= spec.high * 1.1:
        with pytest.raises(PredictionError, match=f"{name} is "):
            predict_table(CalibratedModel(Model(soil("dry_sand"))), columns)


ROLLING = {
    "load": np.array([60.0]),
    "diameter": np.array([0.2]),
    "width": np.array([0.1]),
    "slip": np.array([0.4]),
}
LAW = ("sand.log_reference_pressure", "sand.n")
STRENGTH = ("sand.cohesion", "sand.friction_angle", "sand.log_shear_displacement")


def test_a_strength_that_nobody_measured_is_said_and_makes_pull_uncertain() -> None:
    """As sure as of a soil of this kind, of other rigs and of the law itself, against sampling."""
    sand = Soil("sand", 1.6e6, 0.8, cohesion=800.0, friction_angle=0.5)
    known = CalibratedModel(Model(sand), LAW, np.diag([1e-4, 1e-4]))
    table = predict_table(known, ROLLING)
    (note,) = table.notes
    assert note.startswith("no measurement determines cohesion (800 +- 7")
    assert "bare rim's friction over the soil's (0.8 +- 0.12)" in note
    (row,) = table.rows()
    usual = usual_strength(sand)
    rng = np.random.default_rng(0)
    scale = usual.shear_displacement.standard_deviation / usual.shear_displacement.value
    pulls, torques = [], []
    for c, phi, kappa, eta, mu, peak in rng.normal(size=(3000, 6)):
        other = Soil(
            "sand", 1.6e6, 0.8,
            cohesion=max(800.0 + c * usual.cohesion.standard_deviation, 0.0),
            friction_angle=0.5 + phi * usual.friction_angle.standard_deviation,
            shear_displacement=0.015 * float(np.exp(scale * kappa)),
            rolling_share=max(1.3 + 0.4 * eta, 0.0),
            rim_friction=0.8 + 0.12 * mu,
            pressure_peak=min(max(0.1 + 0.2 * peak, 0.0), 0.9),
        )  # fmt: skip
        found = predict(Model(other), Conditions.of(60, 0.2, 0.1, slip=0.4))
        assert found.drawbar_pull is not None
        assert found.torque is not None
        pulls.append(found.drawbar_pull[0])
        torques.append(found.torque[0])
    law = np.hypot(0.05, 0.05) * 60.0
    assert row["drawbar_pull_std"] == pytest.approx(np.hypot(np.std(pulls), law), rel=0.1)
    assert row["torque_std"] == pytest.approx(np.hypot(np.std(torques), law * 0.1), rel=0.1)
    # The law of sinkage is as well known as before.
    alone = predict_table(known, {k: v for k, v in ROLLING.items() if k != "slip"})
    assert alone.notes == ()
    assert row["sinkage_std"] == pytest.approx(alone.rows()[0]["sinkage_std"], rel=1e-9)


def test_pull_always_has_a_deviation_and_the_note_names_only_what_is_not_known() -> None:
    plain = Soil("sand", 1.6e6, 0.8)
    bare = predict_table(CalibratedModel(Model(plain)), ROLLING)
    assert "friction angle (30 +- 5.7 deg)" in bare.notes[0]
    assert bare.to_dict()["notes"] == list(bare.notes)
    (row,) = bare.rows()
    assert row["drawbar_pull_std"] > 0.07 * 60.0
    assert "sinkage_std" not in row  # nobody says how well its law is known
    part = CalibratedModel(Model(plain), (*LAW, *STRENGTH[:2]), np.diag([1e-4, 1e-4, 1.0, 1e-6]))
    assert (
        predict_table(part, ROLLING)
        .notes[0]
        .startswith("no measurement determines shear displacement")
    )
    # A covariance that has everything is taken as it is: what is left is the law's own error.
    names = (*LAW, *STRENGTH, "sand.rolling_share", "sand.rim_friction", "sand.pressure_peak")
    full = CalibratedModel(Model(plain), names, np.diag([1e-6] * 8))
    measured = predict_table(full, ROLLING)
    assert measured.notes == ()
    assert measured.rows()[0]["drawbar_pull_std"] == pytest.approx(0.0707 * 60.0, rel=0.01)
    lugs = predict_table(full, ROLLING | {"grouser_height": np.array([0.012])})
    assert lugs.rows()[0]["drawbar_pull_std"] == pytest.approx(np.hypot(0.05, 0.1) * 60, rel=0.01)


def test_lugs_higher_than_the_wheel_are_refused() -> None:
    with pytest.raises(
        PredictionError, match=r"grouser_height is 0.12 m, expected at most the wheel's"
    ):
        predict_table(
            CalibratedModel(Model(soil("dry_sand"))), ROLLING | {"grouser_height": np.array([0.12])}
        )
