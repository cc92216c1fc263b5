# SPDX-License-Identifier: Apache-2.0
"""What stands above a column, as people write it, and what it is.

Tests `headers.py`.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.measurements.columns import COLUMNS, TEXTS, UnitsError
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.headers import (
    UNKNOWN,
    WORDS,
    contact_of,
    find,
    is_summary,
    mapped_heading,
    meant,
    near_miss,
    read_heading,
)


@pytest.mark.parametrize(
    ("text", "name", "unit"),
    [
        ("sinkage [mm]", "sinkage", "mm"),
        (" sinkage[mm] ", "sinkage", "mm"),
        ("slip [-]", "slip", "1"),
        ("slip [ ]", "slip", "1"),
        ("slip", "slip", None),
        ("Load (N)", "load", "N"),
        ("load, N", "load", "N"),
        ("load_N", "load", "N"),
        ("Load N", "load", "N"),
        ("LOAD/N", "load", "N"),
        ("Load in kN", "load", "kN"),
        ("Radlast [kN]", "load", "kN"),
        ("Radlast Fz [N]", "load", "N"),
        ("Load (W)", "load", None),
        ("Load (W) [N]", "load", "N"),
        ("charge de la roue (N)", "load", "N"),
        ("mean wheel load [N]", "load", "N"),
        ("Einsinkung z [mm]", "sinkage", "mm"),
        ("enfoncement en mm", "sinkage", "mm"),
        ("z_mm", "sinkage", "mm"),
        ("DIAMÈTRE (cm)", "diameter", "cm"),
        ("Diameter\n[mm]", "diameter", "mm"),
        ("Raddurchmesser", "diameter", None),
        ("Rad-Breite [mm]", "width", "mm"),
        ("Schlupf %", "slip", "%"),
        ("slip_pct", "slip", "%"),
        ("Schraeglaufwinkel [°]", "slip_angle", "°"),
        ("slip_angle_deg", "slip_angle", "deg"),
        ("vitesse d’avance (m/s)", "speed", "m/s"),
        ("speed_m_s", "speed", "m/s"),
        ("v_kmh", "speed", "km/h"),
        ("Drehmoment / Nm", "torque", "Nm"),
        ("sinkage std (mm)", "sinkage_std", "mm"),
        ("Überfahrten", "pass_number", None),
        ("Versuch-Nr.", "run", None),
        ("Bodenart", "soil", None),
    ],
)
def test_a_header_is_understood(text: str, name: str, unit: str | None) -> None:
    heading = read_heading(text)
    assert (heading.name, heading.unit) == (name, unit)
    assert heading.rank < UNKNOWN


@pytest.mark.parametrize(
    ("text", "name", "unit"),
    [
        ("moisture index", "moisture index", None),
        ("temperature (degC)", "temperature", "degC"),
        ("side_force [N]", "side_force", "N"),
        ("rim_speed [mm/s]", "rim_speed", "mm/s"),
        ("sinkage (front)", "sinkage (front)", None),
        ("position (a)", "position (a)", None),
        ("s [mm]", "s", "mm"),  # a symbol with another unit is another quantity
        ("i [A]", "i", "A"),
        ("test_no", "test_no", None),
        ("load_std", "load_std", None),
    ],
)
def test_another_quantity_is_left_as_it_is(text: str, name: str, unit: str | None) -> None:
    heading = read_heading(text)
    assert (heading.name, heading.unit, heading.rank) == (name, unit, UNKNOWN)


@pytest.mark.parametrize("text", ["a [mm", "a mm]", "a [m] b", "a [m] [s]", "a [[m]]"])
def test_brackets_that_do_not_fit_are_refused(text: str) -> None:
    with pytest.raises(UnitsError, match="expected a name and one unit"):
        read_heading(text)


def test_a_radius_is_half_a_diameter() -> None:
    assert read_heading("Radius [cm]")[1:] == ("diameter", "cm", 1, 2.0)
    assert mapped_heading("Rr_mm", "radius")[1:] == ("diameter", "mm", -1, 2.0)


def test_what_the_user_says_comes_first() -> None:
    assert mapped_heading("F_vert_kN", "load")[1:3] == ("load", "kN")
    assert mapped_heading("F", "load [kN]")[1:3] == ("load", "kN")
    assert mapped_heading("sinkge", "sinkge").name == "sinkge"


@pytest.mark.parametrize("name", [n for n in (*COLUMNS, *TEXTS) if not n.endswith("_std")])
def test_every_quantity_has_words(name: str) -> None:
    match = find(name)
    assert match is not None
    assert (match.name, match.rank) == (name, 0)


@pytest.mark.parametrize("name", WORDS["words"])
def test_no_word_means_two_quantities(name: str) -> None:
    symbols = WORDS["symbols"].get(name, "")
    for word in (*WORDS["words"][name].split(","), *symbols.split()):
        found = find(word.strip())
        assert found is not None
        assert found.name == name, word


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("sinkge", "sinkage"),
        ("sinkge_mm", "sinkage"),
        ("Durchmeser (mm)", "diameter"),
        ("diamter", "diameter"),
        ("slipp", "slip"),
        ("enfoncment", "sinkage"),
    ],
)
def test_a_slip_of_the_keyboard_is_seen(text: str, name: str) -> None:
    assert meant(read_heading(text)) == name


@pytest.mark.parametrize(
    "text",
    [
        "density",
        "road",
        "loam",
        "skip",
        "note",
        "mode",
        "date",
        "temperature",
        "position",
        "rim_speed",
        "side_force",
        "wide",
        "day",
        "trial",
        "rung",
        "hardness",
        "moisture_index",
        "cone_index",
        "test_no",
        "motor_current",
    ],
)
def test_another_word_is_no_slip(text: str) -> None:
    assert near_miss(text) is None


@pytest.mark.parametrize(
    "text",
    ["Mean", "Mittelwert:", "Mean (n=3)", "Mean of 3", "Std.", "Summe", "Écart-type", "MAX", "SD"],
)
def test_rows_that_were_computed(text: str) -> None:
    assert is_summary(text)


@pytest.mark.parametrize("text", ["", "summer 2024", "max load 3", "Minneapolis", "run 1", "a"])
def test_rows_that_were_not(text: str) -> None:
    assert not is_summary(text)


def test_contacts_in_three_languages() -> None:
    assert [contact_of(t) for t in ("Platte", "gedrückt", "roulant", "PLATE", "flat")] == [
        "plate", "pressed", "rolling", "plate", "flat",
    ]  # fmt: skip


def test_runs_may_be_called_as_symbols_are(tmp_path: Path) -> None:
    rows = [f"{name},60,0.2,0.1,0.0{i}" for i, name in enumerate("bisrpvzWD", start=1)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["run,load,diameter,width,sinkage", *rows]))
    assert read_measurements(path).run.tolist() == [*"bisrpvzWD"]


def test_a_row_of_a_run_that_is_called_as_a_symbol_is_no_header(tmp_path: Path) -> None:
    """Nor where nobody knows the words of the header."""
    path = tmp_path / "a.csv"
    head = "deney,yük [N],çap [mm],genişlik [mm],batma [mm]"
    path.write_text("\n".join([head, "a,60,250,100,14.2", "b,90,250,100,18.9", "i,60,350,120,9.9"]))
    with pytest.raises(SmallwheelError, match="line 1: no column 'width'"):
        read_measurements(path)


@settings(max_examples=examples(300))
@given(st.text(max_size=30))
def test_any_text_is_a_header_or_a_units_error(text: str) -> None:
    with contextlib.suppress(UnitsError):
        heading = read_heading(text)
        meant(heading)
        assert heading.text == " ".join(text.split())
