# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from smallwheel_ros.pictures.smoothing import smooth


def test_a_straight_line_stays_straight() -> None:
    x = np.linspace(0.0, 2.0, 60)
    curve = smooth(x, 3.0 - 2.0 * x, np.arange(60))
    np.testing.assert_allclose(curve.y, 3.0 - 2.0 * curve.x, atol=1e-9)


def test_the_band_covers_the_truth_where_rows_of_a_run_share_their_error() -> None:
    rng = np.random.default_rng(3)
    runs, rows = 40, 6
    inside = []
    for _ in range(40):
        run = np.repeat(np.arange(runs), rows)
        x = np.repeat(rng.uniform(0, 1, runs), rows)
        y = 0.5 * x + np.repeat(rng.normal(0, 0.3, runs), rows) + rng.normal(0, 0.02, runs * rows)
        curve = smooth(x, y, run)
        known = np.isfinite(curve.low)
        truth = 0.5 * curve.x
        inside.append(np.mean((curve.low <= truth)[known] & (truth <= curve.high)[known]))
    assert 0.85 < np.mean(inside) < 1.0


def test_few_values_give_the_mean_of_each() -> None:
    x = np.repeat([0.0, 1.0, 2.0], 12)
    y = np.repeat([5.0, -1.0, 2.0], 12) + np.tile([-0.1, 0.1], 18)
    curve = smooth(x, y, np.arange(36), np.array([0.0, 1.0, 2.0]))
    assert curve.y.tolist() == pytest.approx([5.0, -1.0, 2.0])
    assert np.all(curve.low <= curve.y)
    assert np.all(curve.y <= curve.high)


def test_too_few_runs_have_no_band() -> None:
    x = np.linspace(0.0, 1.0, 20)
    curve = smooth(x, x, np.repeat([0, 1], 10))
    assert np.isnan(curve.low).all()
    assert np.isfinite(curve.y).all()
