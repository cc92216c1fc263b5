# SPDX-License-Identifier: Apache-2.0
"""What models leave: means of runs, points and axes of the panels, by hand."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import smallwheel_ros as sw
from smallwheel_ros.fitting.held_out import CvErrors
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.views.leftovers import (
    Left,
    leftovers,
    means,
    measured_panel,
    residual_panel,
    settings_of,
    thinned,
)

LOADS = np.repeat([20.0, 40.0, 60.0], 4)
MEASURED = np.linspace(0.010, 0.021, 12)


def table() -> Measurements:
    return sw.read(pd.DataFrame({
        "load [N]": LOADS, "diameter [m]": 0.2, "width [m]": 0.1, "sinkage [m]": MEASURED,
        "run": [f"r{i}" for i in range(12)],
    }))  # fmt: skip


def left(error: np.ndarray, name: str = "model", colour: str = "with") -> Left:
    return Left(CvErrors({"sinkage": error}, np.arange(error.size)), name, colour)


def test_means_are_of_runs_and_their_band_is_twice_the_standard_error() -> None:
    x = np.repeat([1.0, 2.0], 6)
    run = np.array([0, 0, 0, 1, 2, 3, 4, 4, 4, 4, 5, 5])
    y = np.array([1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 5.0, 5.0, 5.0, 5.0, 7.0, 9.0])
    found = means(x, y, run)
    assert found.x.tolist() == [1.0, 2.0]
    assert found.y == pytest.approx([(2.0 + 4.0 + 6.0 + 8.0) / 4.0, (5.0 + 8.0) / 2.0])
    # Runs 2, 4, 6, 8: their deviation is sqrt(20 / 3); two runs have no band.
    assert found.half[0] == pytest.approx(2.0 * np.sqrt(20.0 / 3.0) / 2.0)
    assert np.isnan(found.half[1])


def test_a_setting_of_many_values_has_eight_parts_of_as_many_rows() -> None:
    x = np.linspace(0.0, 1.0, 80) ** 2
    found = means(x, 10.0 * x, np.arange(80))
    assert found.x == pytest.approx(x.reshape(8, 10).mean(axis=1))
    assert found.y == pytest.approx(10.0 * found.x)
    assert means(np.zeros(0), np.zeros(0), np.zeros(0, int)).x.size == 0


def test_residuals_are_shown_in_millimetres_over_the_setting_with_the_floor_as_a_band() -> None:
    error = np.linspace(-0.003, 0.002, 12)
    error[4] = np.nan
    panel = residual_panel(table(), [left(error)], "sinkage", "load", floor=0.0005)
    band, points, squares = panel.layers
    assert (band.low, band.high) == pytest.approx((-1.0, 1.0))  # twice the floor
    known = np.isfinite(error)
    np.testing.assert_allclose(points.x, LOADS[known])
    np.testing.assert_allclose(points.y, 1e3 * error[known])
    np.testing.assert_allclose(squares.x, [20.0, 40.0, 60.0])
    middle = 1e3 * np.array([error[:4].mean(), error[5:8].mean(), error[8:].mean()])
    np.testing.assert_allclose(squares.y, middle)
    np.testing.assert_allclose(np.asarray(squares.high) - middle, middle - np.asarray(squares.low))
    # 6 % of the 5 mm beyond what is shown, 5 % of 40 N beyond the loads.
    assert panel.y_range == pytest.approx((-3.3, 2.3))
    assert panel.x_range == pytest.approx((18.0, 62.0))
    assert (panel.x, panel.y) == ("load [N]", "measured - predicted [mm]")


def test_where_no_row_has_both_there_are_no_points() -> None:
    panel = residual_panel(table(), [left(np.full(12, np.nan))], "sinkage", "load")
    assert all(np.asarray(layer.x).size == 0 for layer in panel.layers[1:])
    assert panel.x_range == pytest.approx((18.0, 62.0))


def test_a_model_without_the_channel_is_left_out() -> None:
    none = CvErrors({}, np.arange(12))
    panel = residual_panel(table(), [Left(none, "none", "base")], "sinkage", "load")
    assert len(panel.layers) == 1
    assert len(measured_panel(MEASURED, [Left(none, "none", "base")], "sinkage").layers) == 1


def test_measured_stands_over_measured_less_the_residual_and_what_is_beyond_is_counted() -> None:
    error = np.full(12, 0.001)
    panel = measured_panel(MEASURED, [left(error)], "sinkage")
    diagonal, points = panel.layers
    assert diagonal.diagonal
    np.testing.assert_allclose(points.y, 1e3 * MEASURED)
    np.testing.assert_allclose(points.x, 1e3 * MEASURED - 1.0)
    assert panel.x_range == panel.y_range == pytest.approx((10.0 - 0.15 * 11.0, 21.0 + 0.15 * 11.0))
    assert panel.title == "sinkage"
    error[[0, 1, 2]] = 0.005, -0.03, np.nan
    panel = measured_panel(MEASURED, [left(error)], "sinkage")
    assert panel.title == "sinkage (2 points beyond the axes)"
    np.testing.assert_allclose(panel.layers[1].y, 1e3 * MEASURED[3:])
    error[1] = 0.001
    one = measured_panel(MEASURED, [left(error)], "sinkage")
    assert one.title == "sinkage (1 point beyond the axes)"
    many = np.tile(MEASURED, 100)  # more than are drawn: all are counted
    far = np.where(np.arange(many.size) % 12 == 1, -0.03, 0.001)
    assert (
        measured_panel(many, [left(far)], "sinkage").title == "sinkage (100 points beyond the axes)"
    )


def test_points_are_thinned_only_where_there_are_more() -> None:
    rows = np.arange(100, 150)
    assert thinned(rows, 50) is rows
    some = thinned(rows, 20)
    assert some.size == 20 == np.unique(some).size
    assert (np.diff(some) > 0).all()
    assert set(some) <= set(rows)


def test_the_load_is_the_setting_where_none_was_varied() -> None:
    assert settings_of(table()) == ["load"]
    same = pd.DataFrame({"load [N]": [20.0] * 3, "diameter [m]": 0.2, "width [m]": 0.1,
                         "sinkage [m]": [0.01, 0.011, 0.012]})  # fmt: skip
    assert settings_of(sw.read(same)) == ["load"]


def test_what_a_page_draws_is_the_residuals_in_steps() -> None:
    error = np.linspace(-0.003, 0.002, 12)
    better = 0.1 * error
    better[3] = np.nan
    models = {"": left(error).errors, "slip": left(better).errors}
    found = leftovers(table(), models, "", "base model", {"sinkage": 0.0005})
    assert (found["base"], found["base_key"], found["first"]) == ("base model", "", "load")
    channel = found["channels"]["sinkage"]
    # A power of ten at most a hundredth of the axis: 1e-2 of some 5 mm.
    assert channel["step"] == 0.01
    assert channel["rows"].tolist() == list(range(12))
    np.testing.assert_allclose(channel["measured"], 1e3 * MEASURED)
    np.testing.assert_allclose(found["left"][""]["sinkage"], 1e3 * error / 0.01, atol=0.51)
    assert found["left"]["slip"]["sinkage"][3] is None
    assert found["left"]["slip"]["sinkage"][0] == -30
    assert found["rows"][0].startswith("run r0, ")
    np.testing.assert_allclose(found["settings"]["load"]["values"], LOADS)
    assert found["at"]["sinkage"]["load"] == pytest.approx([20.0, 40.0, 60.0])
    steps = found["means"][""]["sinkage"]["load"]
    assert len(steps) == 6  # a mean and half its band for each of three loads
    np.testing.assert_allclose(steps[::2], error.reshape(3, 4).mean(axis=1) / 1e-5, atol=0.51)
    spread = 2.0 * error.reshape(3, 4).std(axis=1, ddof=1) / 2.0
    np.testing.assert_allclose(steps[1::2], spread / 1e-5, atol=0.51)
    titles = [(one["over"], one["title"]) for one in found["frames"]]
    assert titles == [
        ("load", "sinkage: residual over load"), ("", "sinkage: measured against predicted"),
    ]  # fmt: skip
