# SPDX-License-Identifier: Apache-2.0
"""The paper's printed numbers: what reproduces, and that the verdicts are earned."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from smallwheel_ros.physics.paper import (
    BEKKER,
    LOADS,
    MEIRION_GRIFFITH_SPENKO,
    TABLE_3,
    _line,
    paper_lines,
    resistance,
    sinkage,
    sinkage_for,
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
    taken = [
        line for line in paper_lines() if line.place in {f"Table {i}" for i in (1, 2, 4, 5, 6)}
    ]
    # Wheel and loads; c, phi, n, k of one soil; k, n of four; c, phi of three; k, n, m of three.
    assert Counter(line.place[-1] for line in taken) == {"1": 5, "2": 4, "4": 8, "5": 6, "6": 9}
    assert {line.status for line in taken} == {"taken over"}
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
    # 1 - 5.172 mm / 8.8 mm
    assert found["under-prediction of eq. 7 at 65 N"] == pytest.approx(41.2, abs=0.1)


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


def test_printed_values_of_equations_are_those_of_the_paper_by_hand() -> None:
    """Each of the fourteen, with the paper's numbers: k in N, m; eq. 7's and eq. 10's sinkage at 46 N."""
    by_place = {line.place: line.printed for line in paper_lines() if line.place[:3] == "eq."}
    bekker, newer = 3.9221253e-3, 9.1158059e-3  # m
    length = 0.085 * np.arccos(1.0 - bekker / 0.085)
    limit = 0.085 * length * 2050.0 + 46.0 * np.tan(np.radians(27.5))
    kappa = BEKKER.shear_displacement
    by_hand = {
        "eq. 2": limit * (1.0 - np.exp(-0.3 * length / kappa)),
        "eq. 3": 46.0,
        "eq. 4": 46.0,
        "eq. 5": 1783.0 * 0.01**0.75,
        "eq. 6": 46.0,
        "eq. 7": 1e3 * bekker,
        "eq. 8": 17.0 * 0.01**0.48,
        "eq. 9": 1604.0 * 0.01**0.8 * 0.17**0.39,
        "eq. 10": 1e3 * newer,
        "eq. 12": 0.085 * 1783e3 * bekker**1.75 / 1.75,
        "eq. 13": 0.085 * 1604e3 * 0.17**0.39 * newer**1.8 / 1.8,
    }
    for place, value in by_hand.items():
        assert by_place[place] == pytest.approx(value, rel=1e-5), place
    # The horizontal part of the pressure on the arc is the work of pressing a plate of that width down.
    assert by_place["eq. 11"] == pytest.approx(by_hand["eq. 13"], rel=1e-5)


@pytest.mark.parametrize(("computed", "status"), [(9.85, True), (9.7499, False), (9.8501, False)])
def test_a_number_is_reproduced_to_the_digits_that_are_printed(
    computed: float, status: bool
) -> None:
    line = _line("Table 7", "sinkage", "mm", 9.8, computed, "", inferred=False)
    assert (line.status == "reproduced") is status
    whole = _line("Table 7", "load", "N", 46.0, 46.4, "", inferred=True)
    assert whole.status == "reproduced under an inferred reading"


def test_the_sinkage_of_a_resistance_is_eq_14_turned_round() -> None:
    for depth in (1e-3, 14.2e-3):
        assert sinkage_for(BEKKER, resistance(BEKKER, depth)) == pytest.approx(depth, rel=1e-9)
