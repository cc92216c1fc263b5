# SPDX-License-Identifier: Apache-2.0
"""Rows that a wheel is exposed to."""

from __future__ import annotations

import numpy as np
import pytest

from smallwheel_ros.physics.conditions import Conditions, ConditionsError


def test_scalars_and_columns_become_rows() -> None:
    rows = Conditions.of([20, 40, 60], 0.2, 0.1, slip=[0.1, 0.2, 0.3], speed=0.1)
    assert len(rows) == 3
    assert rows["diameter"].tolist() == [0.2] * 3
    assert rows["speed"].tolist() == [0.1] * 3
    assert "slip" in rows
    assert "slope" not in rows
    assert rows.rolling.all()
    assert len(Conditions.of(20, 0.2, 0.1)) == 1


def test_contacts() -> None:
    rows = Conditions.of(20, 0.2, [0.1, 0.1, np.nan], contact=["rolling", "pressed", "plate"])
    assert rows.rolling.tolist() == [True, False, False]
    assert rows.pressed.tolist() == [False, True, False]
    assert rows.plate.tolist() == [False, False, True]
    pressed = Conditions.of([20, 30], 0.2, 0.1, contact="pressed")
    assert pressed.pressed.all()
    assert not pressed.rolling.any()


def test_some_of_the_rows() -> None:
    rows = Conditions.of([20, 40, 60], 0.2, 0.1, soil=["a", "b", "a"], slip=[0.1, 0.2, 0.3])
    for some in (np.array([True, False, True]), np.array([0, 2]), slice(None, None, 2)):
        taken = rows.take(some)
        assert taken.load.tolist() == [20, 60]
        assert taken["slip"].tolist() == [0.1, 0.3]
        assert taken.soil is not None
        assert taken.soil.tolist() == ["a", "a"]
        assert taken.rolling.tolist() == [True, True]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"load": [10, 20], "slip": [1, 2, 3]}, "different lengths: load 2, diameter 1, width 1"),
        ({"load": [[10, 20]]}, r"found an array of shape \(1, 2\)"),
        ({"load": [10, 0]}, r"load in row 2 is 0.0, expected a number over 0"),
        ({"load": np.inf}, "load in row 1 is inf"),
        ({"diameter": -0.1}, "diameter in row 1 is -0.1"),
        ({"width": np.nan}, "width in row 1 is nan"),
        ({"contact": "sliding"}, "contact 'sliding' is unknown, expected one of rolling, pressed"),
    ],
)
def test_rows_that_cannot_be(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ConditionsError, match=message):
        Conditions.of(**({"load": 10, "diameter": 0.2, "width": 0.1} | arguments))  # type: ignore[arg-type]


def test_a_missing_column_is_named() -> None:
    with pytest.raises(
        ConditionsError, match=r"no column 'speed'\. The columns are load, diameter, width"
    ):
        Conditions.of(10, 0.2, 0.1)["speed"]
