# SPDX-License-Identifier: Apache-2.0
"""What small results look like in print, as a page and as one plot.

Tests `added.py`, `fit.py`, `learnt.py`, `measured.py` and `prediction.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import smallwheel_ros as sw
from smallwheel_ros.common.result import ResultError
from smallwheel_ros.fitting import FitResult
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.simulate import RigSettings, simulate_rig
from smallwheel_ros.views import added, fit, learnt
from smallwheel_ros.views.blocks import Callout, Table
from smallwheel_ros.views.blocks import Figure as Figures


@pytest.fixture(scope="module")
def data() -> Measurements:
    return sw.read(simulate_rig(RigSettings(seed=3, runs=12)).table)


@pytest.fixture(scope="module")
def fitted(data: Measurements) -> FitResult:
    found = sw.fit(data)
    assert isinstance(found, FitResult)
    return found


def test_a_table_is_a_line_for_each_column(data: Measurements) -> None:
    load = data.conditions.load
    assert f"load [N]: {load.min():.3g} to {load.max():.3g}" in str(data).replace(".0 ", " ")
    axes = Figure().subplots()
    assert data.plot(axes) is axes
    shown = axes.collections[0].get_offsets() if axes.collections else axes.lines[0].get_xydata()
    np.testing.assert_allclose(np.asarray(shown)[:, 1], 1e3 * data.channels["sinkage"])
    with pytest.raises(ResultError, match="no column 'sinkge' to draw: did you mean 'sinkage'"):
        data.plot(axes, "sinkge")


def test_a_fit_has_each_number_in_print_and_on_its_page(fitted: FitResult, tmp_path: Path) -> None:
    page = fitted.save(tmp_path / "fit.html").read_text()
    for text in (str(fitted), page):
        assert "held" in text
        for one in fitted.parameters:
            assert one.name in text.replace("_", " ").replace(" ", "_"), one.name
    for channel, label, scale in (
        ("sinkage", "sinkage [mm]", 1e3),
        ("resistance", "resistance [N]", 1.0),
    ):
        axes = fitted.plot(Figure().subplots(), channel)
        assert axes.get_ylabel() == f"measured {label}"
        assert axes.get_xlabel() == f"predicted {label}"
        shown = np.concatenate([np.asarray(c.get_offsets()) for c in axes.collections])
        residual = fitted.residuals[channel]
        measured = fitted.measurements.channels[channel]
        by_hand = scale * np.column_stack([measured - residual, measured])
        inside = {tuple(point) for point in np.round(by_hand, 6).tolist()}
        assert len(shown) > 0.9 * len(by_hand)
        assert {tuple(point) for point in np.round(shown, 6).tolist()} <= inside


def test_correlations_of_a_half_are_listed_the_closest_first(data: Measurements) -> None:
    fitted = sw.fit(data, effects="slip_sinkage")
    assert isinstance(fitted, FitResult)
    tables = [
        b
        for s in fit.page(fitted, pictures=False).sections
        for b in s.blocks
        if isinstance(b, Table)
    ]
    rows = next(table.rows for table in tables if table.rows and "correlation" in table.rows[0])
    by_pair = {
        (fitted.names[b], fitted.names[a]): fitted.correlation[a, b]
        for a in range(len(fitted.names)) for b in range(a)
        if abs(fitted.correlation[a, b]) > 0.5
    }  # fmt: skip
    assert {(row["one"], row["other"]): row["correlation"] for row in rows} == by_pair
    sizes = [abs(row["correlation"]) for row in rows]
    assert sizes == sorted(sizes, reverse=True)
    text = "\n".join(line for table in tables if table.rows is rows for line in table.lines())
    owner, _, name = rows[0]["one"].rpartition(".")
    assert f"{owner}: {name.replace('_', ' ')}" in text


def test_a_prediction_is_a_row_for_each_setting(fitted: FitResult) -> None:
    table = sw.predict(fitted, load=[40.0, 60.0], diameter=0.2, width=0.1, slip=[0.1, 0.2, 0.3])
    numbers = [line.split() for line in str(table).splitlines()]
    loads = [line[0] for line in numbers if line and line[0] in ("40", "60")]
    assert loads == ["40"] * 3 + ["60"] * 3
    axes = table.plot(Figure().subplots(), "sinkage")
    assert sum(len(line.get_xdata()) == 3 for line in axes.lines) == 2


def test_an_effect_that_was_added_says_what_it_changed(
    data: Measurements, fitted: FitResult, tmp_path: Path
) -> None:
    found = sw.add("slip_sinkage", model=fitted, data=data)
    assert "slip sinkage" in str(found)
    assert "<svg" in found.save(tmp_path / "added.html").read_text()
    (row,) = [row for row in found.rows() if row["channel"] == "resistance"]
    for channel, sides, scale in (
        ("resistance", (row["before"], row["after"]), 1.0),
        (None, (found.rows()[0]["before"], found.rows()[0]["after"]), 1e3),  # the sinkage, in mm
    ):
        axes = Figure().subplots()
        assert found.plot(axes, channel) is axes
        lengths = [bar.get_width() for bar in axes.patches]
        assert lengths == pytest.approx([scale * value for value in sides])
        assert axes.get_xlabel() == f"held-out RMSE [{'mm' if scale > 1.0 else 'N'}]"
    page = added.page(found)
    assert [section.title for section in page.sections] == ["In short", "Its numbers"]
    callout, *_, figure = page.sections[0].blocks
    assert isinstance(callout, Callout)
    assert callout.tone == ("result" if found.recommended else "warning")
    assert isinstance(figure, Figures)
    assert not any(
        isinstance(b, Figures) for b in added.page(found, pictures=False).sections[0].blocks
    )
    (numbers,) = page.sections[1].blocks
    assert isinstance(numbers, Table)
    assert {row["owner"] for row in numbers.rows} == {"slip_sinkage"}


def test_a_search_for_a_law_without_an_answer_says_so(data: Measurements) -> None:
    found = sw.learn(data.take(slice(0, 6)))
    assert found.verdict == "refused"
    assert found.headline() in str(found)
    assert learnt.page(found).text() == str(found)
