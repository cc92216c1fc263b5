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
)

# Worked out by hand from the printed tables: (quantity, printed, computed to the digits given)
BY_HAND = [
    ("Table 7: compaction resistance, Bekker", 50.6, 50.59, "inferred"),
    ("Table 7: compaction resistance, Meirion-Griffith & Spenko", 17.9, 17.92, "inferred"),
    ("Table 7: compaction resistance, Meirion-Griffith & Spenko", 17.9, 13.02, "not"),
    ("Table 7: sinkage, Bekker", 5.2, 5.17, "inferred"),
    ("Table 7: sinkage, Meirion-Griffith & Spenko", 9.8, 11.89, "not"),
    ("Table 7: sinkage, Meirion-Griffith & Spenko", 9.8, 9.78, "inferred"),
    ("improvement of sinkage", 3.6, 1.17, "not"),
    ("improvement of resistance", 10.0, 10.28, "reproduced"),
    ("Table 7: measured sinkage", 8.8, 8.50, "not"),
]


def test_the_table() -> None:
    lines = paper_lines()
    assert len(lines) == len(BY_HAND)
    for line, (quantity, printed, computed, verdict) in zip(lines, BY_HAND, strict=True):
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
