# SPDX-License-Identifier: Apache-2.0
"""Paths on a map can be read, whatever their shape and values."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from matplotlib.figure import Figure

from smallwheel_ros.views.plots import Layer, Panel, draw
from smallwheel_ros.views.svg import svg

ALONG = np.linspace(0.0, 28.0, 200)


def path(x: np.ndarray, y: np.ndarray, value: np.ndarray) -> Panel:
    """A path with a place where something happened."""
    layers = [Layer("way", x, y, value=value), Layer("points", x[:1], y[:1], name="what happened")]
    return Panel("x [m]", "y [m]", "a path", layers, equal=True, wide=True, height=5.0)


@pytest.mark.parametrize("turned", [False, True])
def test_a_narrow_path_fills_the_picture_at_one_scale(
    turned: bool, caplog: pytest.LogCaptureFixture
) -> None:
    x, y = (0.01 * ALONG, ALONG) if turned else (ALONG, 0.01 * ALONG)
    figure = Figure(figsize=(7.5, 5.0), layout="constrained")
    axes = figure.subplots()
    with caplog.at_level(logging.WARNING):
        draw(axes, path(x, y, np.arange(200.0)))
        figure.draw_without_rendering()
    assert not caplog.records
    box = axes.get_window_extent()
    assert box.width > 0.7 * figure.bbox.width
    assert box.height > 0.7 * figure.bbox.height
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    assert box.width / (right - left) == pytest.approx(box.height / (high - low), rel=1e-6)
    assert left < x.min() <= x.max() < right
    assert low < y.min() <= y.max() < high


def test_the_key_does_not_lie_on_the_path() -> None:
    figure = Figure(figsize=(7.5, 5.0), layout="constrained")
    axes = figure.subplots()
    draw(axes, path(ALONG, ALONG, np.arange(200.0)))
    figure.draw_without_rendering()
    key = axes.get_legend()
    assert key is not None
    assert key.get_window_extent().y0 >= axes.get_window_extent().y1


@pytest.mark.parametrize("value", [0.0, 3.0, -0.2])
def test_colours_of_one_value_alone_begin_at_zero_or_at_it(value: float) -> None:
    figure = Figure()
    axes = figure.subplots()
    draw(axes, path(ALONG, ALONG, np.full(200, value)))
    low, high = axes.collections[0].get_clim()
    assert low == min(0.0, value)
    assert high > low
    assert svg(path(ALONG, ALONG, np.full(200, value))).startswith("<svg ")
