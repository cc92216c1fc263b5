# SPDX-License-Identifier: Apache-2.0
"""The whole pipeline in the field, from messages on: stops, wrong wiring, sensors that die.

The truth is that of `benchmarks.field_drives`. One drive of some worlds here; many of each in the slow
suite and in docs/field_rates.md.
"""

from __future__ import annotations

from functools import cache

import pytest

from benchmarks.field_drives import make_drive
from benchmarks.field_scores import FieldScore, run
from benchmarks.field_worlds import WORLDS
from smallwheel_ros.onboard.onboard import Onboard


@cache
def driven(name: str, seed: int = 1) -> tuple[Onboard, FieldScore]:
    return run(make_drive(WORLDS[name], seed), seed)


def slow(*names: str) -> list[object]:
    return [pytest.param(name, marks=pytest.mark.slow) for name in names]


STOPS = ("stop and go", "creeping")


@pytest.mark.parametrize(
    "name", [*STOPS, *slow("stop and go, six", "stops of 40 s", "stop and go, long", "manoeuvres")]
)
def test_stops_and_creeping_leave_pull_and_margin_in_their_bands(name: str) -> None:
    """F1, F10: standing is no evidence, a slip has the deviation of its speeds, starting off no slope."""
    _, score = driven(name)
    for quantity in ("sinkage", "resistance", "pull", "margin"):
        assert score.held(quantity) > 0.88, quantity
    assert score.warned == 0


def test_a_parked_vehicle_does_not_travel() -> None:
    """Noise of speeds is no way: 40 s of it at 20 Hz had added up to a decimetre."""
    onboard, score = driven("stops of 40 s")
    assert onboard.soil.distance == pytest.approx(score.length, abs=0.06 * score.length)
