# SPDX-License-Identifier: Apache-2.0
"""The paper's printed numbers: what reproduces, and that the verdicts are earned."""

from __future__ import annotations

import numpy as np
import pytest

from smallwheel_ros.physics.paper import (
    BEKKER,
    LOADS,
    MEIRION_GRIFFITH_SPENKO,
    TABLE_3,
    paper_lines,
    resistance,
    sinkage,
    table_7,
)

# Worked out by hand from the printed tables: (quantity, printed, computed to the digits given)
BY_HAND = [
    ("compaction resistance, Bekker", 50.6, 50.59, "inferred"),
    ("compaction resistance, Meirion-Griffith & Spenko", 17.9, 17.92, "inferred"),
    ("compaction resistance, Meirion-Griffith & Spenko", 17.9, 13.02, "not"),
    ("sinkage, Bekker", 5.2, 5.17, "inferred"),
    ("sinkage, Meirion-Griffith & Spenko", 9.8, 11.89, "not"),
    ("sinkage, Meirion-Griffith & Spenko", 9.8, 9.78, "inferred"),
    ("improvement of sinkage", 3.6, 1.17, "not"),
    ("improvement of resistance", 10.0, 10.28, "reproduced"),
    ("measured sinkage", 8.8, 8.50, "not"),
]


def test_table_7() -> None:
    lines = table_7()
    assert len(lines) == len(BY_HAND)
    for line, (quantity, printed, computed, verdict) in zip(lines, BY_HAND, strict=True):
        assert line.place == "Table 7"
        assert line.quantity == quantity
        assert line.printed == printed
        assert line.computed == pytest.approx(computed, abs=0.006)
        assert line.reading
        assert {
            "inferred": "reproduced under an inferred reading",
            "not": "not reproduced",
            "reproduced": "reproduced",
        }[verdict] == line.status


def test_equations_by_hand() -> None:
    # eq. 7: [3 W / (b (3 - n) k sqrt(D))]^(2/(2n+1)) with Table 2, at 46 and 84 N
    for load, expected in ((46.0, 3.92e-3), (84.0, 6.35e-3)):
        z = (3 * load / (0.085 * 2.25 * 1783e3 * 0.17**0.5)) ** (1 / 1.25)
        assert sinkage(BEKKER, load) == pytest.approx(z, rel=1e-12)
        assert z == pytest.approx(expected, abs=5e-6)
    # eq. 14 with Table 6 at 14.2 mm
    work = 0.085 * 1604e3 * 0.17**0.39 * 14.2e-3**1.8 / 1.8
    assert resistance(MEIRION_GRIFFITH_SPENKO, 14.2e-3) == pytest.approx(work, rel=1e-12)


def test_measured_points_rise_more_steeply_than_any_of_the_laws() -> None:
    """What Table 3 implies grows as W^1.08; eq. 7 and 10 with the printed n as W^0.77 to 0.8."""
    implied = [sinkage(BEKKER, load) / (1 - error) for load, error in TABLE_3.items()]
    growth = np.log(implied[1] / implied[0]) / np.log(LOADS[1] / LOADS[0])
    assert growth == pytest.approx(1.08, abs=0.01)


def test_every_table_and_equation_is_there_in_the_order_of_the_paper() -> None:
    places = list(dict.fromkeys(line.place for line in paper_lines()))
    assert places == [*(f"Table {i}" for i in range(1, 8)), *(f"eq. {i}" for i in range(1, 15))]


def test_the_library_has_what_tables_1_2_4_5_and_6_print() -> None:
    taken = [line for line in paper_lines() if line.status == "taken over"]
    assert {line.place for line in taken} == {f"Table {i}" for i in (1, 2, 4, 5, 6)}
    for line in taken:
        assert line.printed is not None
        assert line.computed == pytest.approx(line.printed, rel=1e-12)
    by_name = {line.quantity: line.computed for line in taken}
    # Read off Tables 2 and 5.
    assert by_name["moist_earth, cohesion"] == pytest.approx(3.13)
    assert by_name["moist_earth, friction angle"] == pytest.approx(34.0)
    assert by_name["dry_sand_bekker, cohesion"] == pytest.approx(2.05)


def test_what_table_3_implies() -> None:
    """Measured sinkages by its errors of eq. 7; eq. 10 and the exact contact are above them."""
    found = {line.quantity: line.computed for line in paper_lines() if line.place == "Table 3"}
    assert found["measured sinkage at 46 N"] == pytest.approx(5.85, abs=0.006)
    assert found["measured sinkage at 84 N"] == pytest.approx(11.20, abs=0.006)
    for load, closed, exact in ((46, 56, 62), (84, 29, 36)):
        assert round(found[f"over-prediction of eq. 10 at {load} N"]) == closed
        assert round(found[f"over-prediction of the exact contact integral at {load} N"]) == exact


def test_equations_are_those_of_the_library() -> None:
    lines = [line for line in paper_lines() if line.place.startswith("eq.")]
    assert {line.status for line in lines} == {"reproduced"}
    # Worked out by hand: eq. 1 with A = b l, l = r acos(1 - z/r); eq. 14 at 9.116 mm.
    by_place = {line.place: line.printed for line in lines}
    length = 0.085 * np.arccos(1.0 - 3.922125e-3 / 0.085)
    limit = 0.085 * length * 2050.0 + 46.0 * np.tan(np.radians(27.5))
    assert by_place["eq. 1"] == pytest.approx(limit, rel=1e-6)
    work = 0.085 * 1604e3 * 0.17**0.39 * 9.115806e-3**1.8 / 1.8
    assert by_place["eq. 14"] == pytest.approx(work, rel=1e-6)
