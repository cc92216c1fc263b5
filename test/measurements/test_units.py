# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples

from smallwheel_ros.measurements.columns import UnitsError, base_unit, fits, spelled, to_base


@pytest.mark.parametrize(
    ("value", "unit", "expected", "converted"),
    [
        (12.0, "mm", "m", 0.012),
        (12.0, "cm", "m", 0.12),
        (1.0, "inch", "m", 0.0254),
        (1.0, "kgf", "N", 9.80665),
        (2.0, "kN", "N", 2000.0),
        (2.0, "mN", "N", 0.002),
        (2.0, "MN", "N", 2e6),
        (36.0, "km/h", "m/s", 10.0),
        (180.0, "deg", "rad", np.pi),
        (180.0, "°", "rad", np.pi),
        (20.0, "%", "1", 0.2),
        (20.0, "degC", None, 293.15),
        (7.0, "1", "1", 7.0),
        (3.0, "m/s²", None, 3.0),
        (3.0, "mm s⁻¹", "m/s", 3e-3),
    ],
)
def test_values_are_converted_to_si(
    value: float, unit: str, expected: str | None, converted: float
) -> None:
    assert to_base(np.array([value]), unit, expected)[0] == pytest.approx(converted, rel=1e-12)


@pytest.mark.parametrize(
    ("unit", "expected", "words"),
    [
        ("N", "m", "is a force, expected a length"),
        ("mm", "N", "is a length, expected a force"),
        ("kg", "N", "a mass is no force: use kgf"),
        ("kPa", "N", "a pressure"),
        ("deg", "1", "is an angle, expected a pure number"),
        ("%", "rad", "a ratio is no angle"),
        ("m/s^2", "m/s", "expected a speed"),
        ("MM", "m", "expected a length"),  # megamolar: case matters
    ],
)
def test_another_dimension_is_refused_with_both_named(unit: str, expected: str, words: str) -> None:
    with pytest.raises(UnitsError, match=words.replace("^", r"\^")):
        to_base(np.ones(1), unit, expected)


@pytest.mark.parametrize(
    "unit",
    [
        "foo", "2*m", "m)", "()", "9**9**9**9", "m**(9**9**9)", "1e5", "m" * 41,
        # pint evaluates powers of any digits of Unicode, and these would not end
        "9⁹⁹⁹⁹ m", "9⁹", "m⁹⁹⁹⁹⁹⁹⁹", "٩**٩**٩ m", "min**999999999", "((min^9)^9)^9",
    ],
)  # fmt: skip
def test_what_is_no_unit_is_refused(unit: str) -> None:
    with pytest.raises(UnitsError, match="unknown unit"):
        to_base(np.ones(1), unit)


@pytest.mark.parametrize(
    ("unit", "base"),
    [
        ("mm", "m"),
        ("kN", "N"),
        ("mm/s", "m/s"),
        ("deg", "rad"),
        ("%", "1"),
        ("kPa", "Pa"),
        ("kWh", "J"),
        ("mJ", "J"),
    ],
)
def test_base_units_are_shown_as_people_write_them(unit: str, base: str) -> None:
    assert base_unit(unit) == base


@pytest.mark.parametrize(
    ("unit", "size"),
    [
        ("Nm", 1.0),
        ("N m", 1.0),
        ("N*m", 1.0),
        ("N·m", 1.0),
        ("N-m", 1.0),
        ("mNm", 1e-3),
        ("kNm", 1e3),
        ("Ncm", 1e-2),
        ("lbf ft", 1.3558179483314),
        ("ft-lbf", 1.3558179483314),
        ("kgf cm", 0.0980665),
    ],
)
def test_a_force_times_a_length_is_a_torque(unit: str, size: float) -> None:
    assert base_unit(unit) == "N m"
    assert to_base(np.ones(1), unit)[0] == pytest.approx(size, rel=1e-12)
    with pytest.raises(UnitsError, match=r"expected a force \(N\)"):
        to_base(np.ones(1), unit, "N")


def test_nanometres_and_newtons_per_metre_are_no_torque() -> None:
    assert base_unit("nm") == "m"
    assert to_base(np.ones(1), "nm", "m")[0] == pytest.approx(1e-9)
    assert base_unit("N/m") != "N m"


@given(st.text("0123456789⁰¹²³⁴⁵⁶⁷⁸⁹٠٩۹𝟗９()^*/ m", max_size=45))
def test_no_text_of_digits_and_powers_is_computed(text: str) -> None:
    """Only names of units with an exponent of one digit get as far as pint."""
    with contextlib.suppress(UnitsError):
        assert np.isfinite(to_base(np.ones(1), text.strip() or "1")).all()


@settings(max_examples=examples(300))
@given(st.text(max_size=30))
def test_any_text_in_brackets_is_a_unit_or_a_units_error(text: str) -> None:
    with contextlib.suppress(UnitsError):
        to_base(np.ones(1), text or "1")


@settings(max_examples=examples(300))
@given(st.text("mNskg0123456789*^/().- %°²", max_size=30))
def test_any_text_that_looks_like_a_unit_is_one_or_a_units_error(text: str) -> None:
    with contextlib.suppress(UnitsError):
        to_base(np.ones(1), text.strip() or "1")


@pytest.mark.parametrize(
    ("text", "expected", "size"),
    [
        ("kg", "N", 9.80665),
        ("lbs", "N", 4.4482216152605),
        ("t", "N", 9806.65),
        ("kp", "N", 9.80665),
        ("KN", "N", 1000.0),
        ("kg/cm²", "Pa", 98066.5),
        ("kN/m2", "Pa", 1000.0),
        ("MM", "m", 1e-3),
        ("Zoll", "m", 0.0254),
        ("in", "m", 0.0254),
        ("Grad", "rad", np.pi / 180),
        ("degrés", "rad", np.pi / 180),
        ("pct", "1", 0.01),
        ("Prozent", "1", 0.01),
        ("kmh", "m/s", 1 / 3.6),
    ],
)
def test_units_as_labs_write_them(text: str, expected: str, size: float) -> None:
    unit = spelled(text, expected)
    assert unit is not None
    assert to_base(np.ones(1), unit, expected)[0] == pytest.approx(size, rel=1e-12)


def test_a_mass_is_a_weight_only_where_a_force_is_expected() -> None:
    assert spelled("kg", None) == "kg"
    assert spelled("kg", "m") == "kg"
    assert not fits("kg", "N")


def test_a_unit_that_is_two_is_refused() -> None:
    """pint takes grad for the gon; a German means a degree by it."""
    assert spelled("grad", "rad") is None
    with pytest.raises(UnitsError, match="write deg or gon"):
        to_base(np.ones(1), "grad")
