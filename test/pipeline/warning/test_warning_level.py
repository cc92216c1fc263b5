# SPDX-License-Identifier: Apache-2.0
"""What is said at each level of the warning, wherever it is said."""

from __future__ import annotations

import math

import pytest

from smallwheel_ros.pipeline.warning.hazard import RISKS
from smallwheel_ros.pipeline.warning.warning_level import WarningLevel


def test_levels_of_the_warning_are_those_between_no_sign_and_stuck() -> None:
    warned = [WarningLevel.warned(level) for level in range(len(RISKS))]
    assert warned == [WarningLevel.OK, WarningLevel.MAY_GET_STUCK, WarningLevel.GETS_STUCK]
    assert [one.short for one in warned[1:]] == ["may get stuck", "gets stuck"]


@pytest.mark.parametrize("level", list(WarningLevel))
def test_a_sentence_has_the_slip_where_there_is_a_warning(level: WarningLevel) -> None:
    warns = level in (WarningLevel.MAY_GET_STUCK, WarningLevel.GETS_STUCK)
    assert ("slip by 0.43" in level.said(0.432)) == warns
    assert warns or "nan" not in level.said(math.nan)
    assert not warns or level.short in level.said(0.5)


def test_no_two_levels_say_the_same() -> None:
    assert len({level.said(0.5) for level in WarningLevel}) == len(WarningLevel)
