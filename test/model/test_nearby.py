# SPDX-License-Identifier: Apache-2.0
"""Slopes of the model by differences, against those that the contact integral gives itself."""

from __future__ import annotations

import math

import numpy as np

from smallwheel_ros.effects.slip import Exponential
from smallwheel_ros.model.nearby import neighbours, slopes
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.soil.model import sinkage_of

RNG = np.random.default_rng(5)
ROWS = 50
WHEELS = (Wheel("small", 0.25, 0.1), Wheel("large", 0.4, 0.12), Wheel("press", 0.3, 0.1, "pressed"))
WHEEL = RNG.integers(0, 3, ROWS)
LOAD = RNG.uniform(20.0, 90.0, ROWS)
LAWS = np.column_stack(
    [RNG.uniform(12.5, 14.0, ROWS), RNG.uniform(0.6, 1.3, ROWS), RNG.uniform(-0.4, 0.4, ROWS)]
)


def test_slopes_of_the_contact_integral() -> None:
    diameter, width = (
        np.array([getattr(w, a) for w in WHEELS])[WHEEL] for a in ("diameter", "width")
    )
    contact = np.array([w.contact for w in WHEELS])[WHEEL]
    found = neighbours(LAWS, Conditions(LOAD, diameter, width, contact), ())
    own = sinkage_of(LAWS, LOAD, WHEELS, WHEEL)
    np.testing.assert_allclose(own.value, found.sinkage[:ROWS], rtol=1e-7)
    np.testing.assert_allclose(own.slopes, slopes(found.sinkage).T, rtol=1e-4, atol=1e-8)


def test_a_row_whose_slip_is_not_known_has_no_sinkage_and_harms_no_other() -> None:
    slip = np.where(np.arange(ROWS) % 7, 0.2, math.nan)
    effects = (Exponential(a=0.7),)
    all_known = sinkage_of(LAWS, LOAD, WHEELS, WHEEL, effects, np.full(ROWS, 0.2))
    found = sinkage_of(LAWS, LOAD, WHEELS, WHEEL, effects, slip)
    rolls = np.array([w.contact == "rolling" for w in WHEELS])[WHEEL]
    blank = np.isnan(slip) & rolls  # a pressed wheel needs none, as at the bench
    assert np.isnan(found.value[blank]).all()
    assert not found.sunk[blank].any()
    np.testing.assert_array_equal(found.value[~blank], all_known.value[~blank])
    np.testing.assert_array_equal(found.slopes[~blank], all_known.slopes[~blank])
    without = sinkage_of(LAWS, LOAD, WHEELS, WHEEL, effects).value
    np.testing.assert_array_equal(np.isnan(without), rolls)
