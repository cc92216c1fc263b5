# SPDX-License-Identifier: Apache-2.0
"""What drafted laws share: they know their range, and go on in a straight line beyond it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.effects.base import EffectError
from smallwheel_ros.effects.drafted import Drafted, continued
from smallwheel_ros.physics.conditions import Conditions


@given(st.floats(-5.0, 5.0))
def test_beyond_its_range_a_shape_is_its_tangent(u: float) -> None:
    found = float(continued(np.square, np.array([u]), 0.0, 1.0)[0])
    expected = u * u if 0.0 <= u <= 1.0 else 0.0 if u < 0.0 else 2.0 * u - 1.0
    assert found == pytest.approx(expected, abs=1e-3 * (1.0 + abs(u)))


def test_it_says_where_it_is_used_beyond_its_range() -> None:
    class Law(Drafted):
        id = "law"
        version = 1
        learnt_from = "0" * 64
        valid = {"slip": (0.1, 0.4)}  # noqa: RUF012

    def rows(slip: float) -> Conditions:
        return Conditions.of(load=60.0, diameter=0.2, width=0.1, slip=slip)

    assert Law().caution(rows(0.3)) == ""
    assert "slip 0.9 (learnt from 0.1 to 0.4)" in Law().caution(rows(0.9))


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ({"version": 2}, "version 2"),
        ({"learnt_from": None}, "SHA-256"),
        ({"valid": {"slip": (1.0, 0.0)}}, "lowest and a highest"),
    ],
)
def test_a_file_of_another_kind_is_refused(body: dict[str, object], message: str) -> None:
    whole = {"id": "law", "version": 1, "learnt_from": "0" * 64, "valid": {}}
    with pytest.raises(EffectError, match=message):
        type("Law", (Drafted,), whole | body)
