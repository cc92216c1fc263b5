# SPDX-License-Identifier: Apache-2.0
"""Predictions in print and as curves: which setting lies across, one curve for each of the others.

Tests `prediction.py`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import smallwheel_ros as sw
from smallwheel_ros.prediction.prediction import PredictionError
from smallwheel_ros.views.prediction import draw, panels, text

WHEEL: dict[str, Any] = {"diameter": 0.2, "width": 0.1}


def test_the_setting_of_most_values_lies_across_and_the_others_are_curves() -> None:
    table = sw.predict("dry_sand", load=[20, 40, 60, 80], slip=[0.1, 0.3], **WHEEL)
    sinkage, resistance, pull = panels(table)
    assert (sinkage.x, sinkage.y) == ("load [N]", "sinkage [mm]")
    assert [layer.name for layer in pull.layers] == ["slip 0.1", "slip 0.3"]
    assert len({layer.dash for layer in pull.layers}) == 2
    rows = [row for row in table.rows() if row["slip"] == pytest.approx(0.3)]
    for panel, quantity, scale in (
        (sinkage, "sinkage", 1e3), (resistance, "resistance", 1.0), (pull, "drawbar_pull", 1.0)
    ):  # fmt: skip
        np.testing.assert_allclose(panel.layers[1].x, [20.0, 40.0, 60.0, 80.0])
        np.testing.assert_allclose(panel.layers[1].y, [scale * row[quantity] for row in rows])
    assert sinkage.title == ""
    # Nothing is known of the soil, but how far the law of the pull is off.
    assert sinkage.layers[1].low is None
    std = [row["drawbar_pull_std"] for row in rows]
    np.testing.assert_allclose(np.asarray(pull.layers[1].high) - pull.layers[1].y, std)
    np.testing.assert_allclose(pull.layers[1].y - np.asarray(pull.layers[1].low), std)


def test_without_slip_there_is_no_pull_and_one_setting_is_a_point() -> None:
    one = sw.predict("dry_sand", load=60.0, **WHEEL)
    assert [panel.y for panel in panels(one)] == ["sinkage [mm]", "resistance [N]"]
    (layer,) = panels(one)[0].layers
    assert layer.kind == "points"
    from matplotlib.figure import Figure

    with pytest.raises(PredictionError, match=r"no .torqe. was predicted.*sinkage"):
        draw(Figure().subplots(), one, "torqe")


def test_a_wheel_sunk_to_its_axle_is_no_point_of_a_curve_and_has_no_number() -> None:
    table = sw.predict("calcium_silicate", load=[5.0, 10.0, 500.0], **WHEEL)
    (layer,) = panels(table)[0].layers
    np.testing.assert_allclose(layer.x, [5.0, 10.0])
    last = text(table).split("\n\n")[0].splitlines()[-1]
    assert last.endswith("sunk to the axle")
    assert last.split()[3:5] == ["-", "-"]


def test_of_more_than_eight_curves_the_first_are_drawn_and_the_title_says_so() -> None:
    loads, slips = np.linspace(20.0, 80.0, 12), np.linspace(0.0, 0.4, 9)
    table = sw.predict("dry_sand", load=loads.tolist(), slip=slips.tolist(), **WHEEL)
    panel = panels(table)[0]
    assert len(panel.layers) == 8
    assert panel.title == "the first 8 of 9 curves"
    eight = sw.predict("dry_sand", load=loads.tolist(), slip=slips[:8].tolist(), **WHEEL)
    assert panels(eight)[0].title == ""


def test_two_hundred_rows_are_printed_and_the_rest_is_counted() -> None:
    loads = np.linspace(20.0, 80.0, 203)
    printed, *notes = text(sw.predict("dry_sand", load=loads.tolist(), **WHEEL)).split("\n\n")
    assert len(printed.splitlines()) == 201
    assert notes[0] == "and 3 more rows: -o writes all of them"
    printed, *notes = text(sw.predict("dry_sand", load=loads[:200].tolist(), **WHEEL)).split("\n\n")
    assert len(printed.splitlines()) == 201
    assert not any("more rows" in note for note in notes)
