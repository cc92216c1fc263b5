# SPDX-License-Identifier: Apache-2.0
"""Running sums give what the whole arrays give, wherever these are cut into spans."""

from __future__ import annotations

import copy
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples
from raw_drives import NAMES, Rows, drive
from test_rules import heard

from smallwheel_ros.onboard.settings import ODOMETRY
from smallwheel_ros.pipeline.checks.sums import Pieces, Run

CUTS = st.lists(st.integers(0, 30), max_size=6).map(sorted)
AMOUNTS = st.integers(0, 8).map(lambda quarters: 0.25 * quarters)  # sums of them are exact


def expected_run(
    flag: list[bool], amount: list[float], begin: int, end: int
) -> tuple[float, float, float]:
    """Sum at the last row, largest sum in the span, and number of its first row, row by row."""
    found, first = list[tuple[float, float]](), 0
    for i in range(end):
        if not flag[i]:
            first = i + 1
        found.append((sum(amount[first : i + 1]), float(first)))
    now, since = found[-1] if found else (0.0, np.nan)
    most, began = now, since
    for total, start in reversed(found[begin:]):  # of equal ones the earliest
        if total >= most:
            most, began = total, start
    return now, most, began if most > 0.0 else np.nan


@settings(max_examples=examples(200), deadline=None)
@given(rows=st.lists(st.tuples(st.booleans(), AMOUNTS), max_size=30), cuts=CUTS)
def test_a_run_is_that_of_all_rows_so_far(rows: list[tuple[bool, float]], cuts: list[int]) -> None:
    flag, amount = [row[0] for row in rows], [row[1] for row in rows]
    run, edges = Run(), [0, *(min(cut, len(rows)) for cut in cuts), len(rows)]
    for begin, end in pairwise(edges):
        part = slice(begin, end)
        run.extend(
            np.array(flag[part], dtype=bool), np.array(amount[part]), np.arange(begin, float(end))
        )
        wanted = expected_run(flag, amount, begin, end)
        np.testing.assert_array_equal([run.now, run.most, run.began], wanted)


@pytest.mark.parametrize(
    ("before", "began"), [([True, True, False], 3.0), ([True, True, True, False, True], 4.0)]
)
def test_a_run_begins_after_the_row_that_ended_the_one_before(
    before: list[bool], began: float
) -> None:
    run, count = Run(), len(before)
    run.extend(np.array(before), np.ones(count), np.arange(float(count)))
    run.extend(np.ones(3, dtype=bool), np.ones(3), np.arange(count, count + 3.0))
    assert run.began == began


@settings(max_examples=examples(200), deadline=None)
@given(ways=st.lists(st.integers(0, 14).map(lambda n: 0.25 * n), max_size=30), cuts=CUTS)
def test_pieces_are_sums_over_the_rows_that_end_in_them(ways: list[float], cuts: list[int]) -> None:
    """Rows as long as several pieces included: a piece without any row is no evidence of anything."""
    pieces, edges = Pieces(1.0, 2), [0, *(min(cut, len(ways)) for cut in cuts), len(ways)]
    for begin, end in pairwise(edges):
        part = np.array(ways[begin:end])
        pieces.extend(part, np.stack([3.0 * part, part], axis=1))
    wanted, total = dict[int, float](), 0.0
    for way in ways:
        total += way
        wanted[int(total)] = wanted.get(int(total), 0.0) + way
    over = [sums for piece, sums in sorted(wanted.items()) if piece < int(total) and sums > 0.0]
    np.testing.assert_allclose(pieces.rows[:, 1] if len(pieces) else [], over, rtol=1e-12)
    if len(pieces):
        np.testing.assert_allclose(pieces.rows[:, 0] / pieces.rows[:, 1], 3.0, rtol=1e-12)


def test_rows_longer_than_a_piece_are_judged_by_their_own_ratio() -> None:
    """At 1.5 m/s and a row each 0.4 s, rims in another unit: named with it, and with a number."""
    rows = copy.deepcopy(drive(60.0))
    for name in (ODOMETRY, *(f"{name}/wheel_speed" for name in NAMES)):
        stamps, values = rows[name]
        kept = np.unique(np.searchsorted(stamps, np.arange(stamps[0], stamps[-1], 400_000_000)))
        rows[name] = stamps[kept], values[kept]
        columns = [0] if name != ODOMETRY else [0, 2, 3]
        rows[name][1][:, columns] *= 2.5 if name == ODOMETRY else 2.5 * 180.0 / np.pi
    text = "; ".join(finding.text for finding in _of_unit(rows))
    assert "deg/s" in text
    assert "nan" not in text


def _of_unit(rows: Rows) -> list:
    return [finding for finding in heard(rows) if finding.rule == "unit"]
