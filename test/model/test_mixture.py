# SPDX-License-Identifier: Apache-2.0
"""One model for several that the data could not tell apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.effects.registry import effect
from smallwheel_ros.model.mixture import mixed
from smallwheel_ros.model.model import CalibratedModel, Model, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import soil

SAND = soil("dry_sand")
FIRMER = replace(SAND, k=1.2 * SAND.k, n=SAND.n + 0.02)
AT = Conditions.of([20.0, 60.0, 110.0], 0.2, 0.1, slip=[0.1, 0.3, 0.5], speed=[0.03, 0.1, 0.3])


def rivals(share: float) -> CalibratedModel:
    first = CalibratedModel(Model(FIRMER) + effect("slip_sinkage", a=0.8))
    second = CalibratedModel(
        Model(SAND) + effect("bulldozing", scale=2.0) + effect("penetration_rate", mu=0.08)
    )
    return CalibratedModel(Model(SAND), rivals=((share, first), (1.0 - share, second)))


# Of what the rivals differ by, to first order: what digs deeper also meets more soil. In the last row the two
# of resistance agree to a ninth of it, since bulldozing makes up for digging, and 3 % of it is left.
LEFT = {"sinkage": 0.02, "resistance": 0.28, "drawbar_pull": 0.13, "torque": 0.04}


@given(share=st.floats(0.02, 0.98))
def test_it_predicts_the_mean_of_the_rivals_predictions(share: float) -> None:
    both = rivals(share)
    found = predict(mixed(both), AT)
    each = [(p, predict(one, AT)) for p, one in both.rivals]
    for name, left in LEFT.items():
        mean = sum(p * getattr(one, name) for p, one in each)
        apart = np.abs(getattr(each[0][1], name) - getattr(each[1][1], name))
        assert (np.abs(getattr(found, name) - mean) <= left * apart + 1e-9).all(), name


@pytest.mark.parametrize("first", [0, 1])
def test_a_rival_that_is_sure_is_the_model(first: int) -> None:
    one = rivals(0.5).rivals[first][1]
    sure = CalibratedModel(Model(SAND), rivals=((1.0, one),))
    for name in ("sinkage", "resistance", "drawbar_pull", "torque"):
        expected = getattr(predict(one, AT), name)
        assert getattr(predict(mixed(sure), AT), name) == pytest.approx(expected, rel=1e-9)


def test_a_model_without_rivals_is_itself() -> None:
    model = Model(SAND) + effect("slip_sinkage", a=0.8)
    assert mixed(CalibratedModel(model)) == model


@pytest.mark.parametrize("contact", ["pressed", "plate"])
def test_a_blank_covariate_silences_the_rival_that_reads_it_alone(contact: str) -> None:
    """To second order the sinkage is the mean of theirs; before, no rival's effect acted."""
    first = CalibratedModel(Model(SAND) + effect("load_dependent_modulus", g=0.2))
    second = CalibratedModel(Model(SAND) + effect("penetration_rate", mu=0.3))
    both = CalibratedModel(Model(SAND), rivals=((0.5, first), (0.5, second)))
    at = Conditions.of([60.0, 120.0], 0.2, 0.1, speed=[np.nan, np.nan], contact=[contact] * 2)
    each = [predict(one, at).sinkage for one in (first, second)]
    apart = np.abs(each[0] - each[1])
    assert apart[1] > 1e-4
    assert np.isfinite(each).all()
    off = np.abs(predict(mixed(both), at).sinkage - np.mean(each, axis=0))
    assert (off <= 0.1 * apart + 1e-9).all()
