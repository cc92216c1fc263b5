# SPDX-License-Identifier: Apache-2.0
"""Fitted numbers as a table: degrees and millimetres, large numbers by their power of ten, doubts in words.

Tests `parameters.py`.
"""

from __future__ import annotations

from typing import Any

from smallwheel_ros.views.parameters import parameter_table


def row(**more: Any) -> dict[str, Any]:
    return {
        "owner": "dry_sand",
        "form": None,
        "name": "n",
        "value": 0.8123,
        "std": 0.0321,
        "unit": "1",
    } | more


def cells(one: dict[str, Any]) -> dict[str, str]:
    """What a row shows, by the header of its column."""
    return {column.header: column.text(one) for column in parameter_table([one]).columns}


def test_numbers_are_shown_in_the_units_of_people() -> None:
    shown = cells(
        row(name="friction_angle", value=0.5, std=0.01, unit="rad", published_range=(0.4, 0.6))
    )
    assert (shown["parameter"], shown["unit"]) == ("friction angle", "deg")
    assert (shown["value"], shown["std"], shown["published"]) == ("28.65", "0.573", "22.9 to 34.4")
    shown = cells(row(name="shear_displacement", value=0.0123, std=None, unit="m"))
    assert (shown["value"], shown["std"], shown["unit"]) == ("12.30", "-", "mm")
    assert shown["published"] == "-"


def test_from_a_hundred_thousand_on_a_number_has_its_power_of_ten() -> None:
    assert cells(row(value=1.6043e6, std=99_900.0))["value"] == "1.604e+06"
    assert cells(row(value=1e5, std=99_900.0))["value"] == "1e+05"
    assert cells(row(value=-2.5e5))["value"] == "-2.5e+05"
    assert cells(row(value=99_990.0))["value"] == "99990"
    assert cells(row())["value"] == "0.8123"


def test_an_effect_is_in_words_and_a_soil_keeps_its_name() -> None:
    assert cells(row())["of"] == "dry_sand"
    shown = cells(row(owner="slip_sinkage", form="linear_growth"))
    assert (shown["of"], shown["form"]) == ("slip sinkage", "linear growth")


def test_what_is_doubtful_is_said_with_its_remedy() -> None:
    assert cells(row(status="determined", remedy="none"))[""] == ""
    assert cells(row())[""] == ""
    assert cells(row(status="held"))[""] == "held"
    assert cells(row(status="tied", remedy="vary the load"))[""] == "tied: vary the load"
    for plausible, word in ((True, "yes"), (False, "no"), (None, "-")):
        assert cells(row(plausible=plausible))["plausible"] == word


def test_rows_of_the_owners_that_are_named_are_stressed() -> None:
    rows = [row(), row(owner="slip_sinkage", form="linear")]
    table = parameter_table(rows, "numbers", strong=("slip_sinkage",))
    assert [table.strong(one) for one in table.rows] == [False, True]
    assert table.lines()[0] == "numbers"
