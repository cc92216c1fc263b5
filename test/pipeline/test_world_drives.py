# SPDX-License-Identifier: Apache-2.0
"""One drive through some worlds of `rates`, the whole pipeline; `rates/run.py` counts all."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest

from rates.drive_trial import trial
from rates.drive_worlds import WORLDS
from rates.drives import SOON, held

# Where the model has no part for what goes on, bands may be narrower than the errors.
LEAST = {"rough 3 mm": 0.8, "zero +5 mm": 0.8}


@cache
def line(subject: str, name: str, seed: int = 0) -> dict[str, Any]:
    return trial(WORLDS[subject][name], seed)


def slow(*names: str) -> list[object]:
    return [pytest.param(name, marks=pytest.mark.slow) for name in names]


@pytest.mark.parametrize(
    "name",
    [
        "zero known",
        *slow(
            "outliers 5 %", "right x3, equal",
            "nominal", "rough 3 mm", "turning", "firm", "delay 200 ms", "zero +5 mm",
            "ruts z x1.23, equal", "pitch error", "another law of the rim",
        ),
    ],
)  # fmt: skip
def test_what_is_said_to_be_determined_is_right(name: str) -> None:
    """At every second of the drive, not only where it ends."""
    found = line("soil", name)
    assert found["wrong"] == {}
    assert held(found, "sinkage") >= LEAST.get(name, 0.88)
    assert found["changes"] == 0
    if name == "zero known":
        assert all(found["determined"].values())
        assert found["stated"]["n"] < 0.12
    if "equal" in name:  # wheels of one size say nothing of m
        assert not found["determined"]["m"]


@pytest.mark.parametrize("name", ["soil x2", *slow("soil x2 over 1 m", "soil x1.5")])
def test_another_soil_is_found_within_a_metre(name: str) -> None:
    found = line("soil", name)
    assert found["wrong"] == {}
    assert found["changes"] == 1
    assert -0.7 <= found["found"] - 12.0 <= 1.0


@pytest.mark.parametrize(
    "name", ["stop and go", *slow("plain, two sizes", "creeping", "manoeuvres", "stop and go, six")]
)
def test_stops_and_manoeuvres_leave_all_in_its_band_and_nobody_is_accused(name: str) -> None:
    """Standing is no evidence, a slip has the deviation of its speeds, starting off is no slope."""
    found = line("field", name)
    for quantity in ("sinkage", "resistance", "pull", "margin"):
        assert held(found, quantity) > 0.88, quantity
    assert found["false"]["first level"] == 0
    assert found["findings"] == {}
    assert found["wrong"] == {}


@pytest.mark.parametrize(
    "name",
    [
        "encoder holds",
        *slow(
            "loads in kg",
            "encoder at 0", "sinkage in mm", "odometry repeats", "caster not listed", "sinkage frozen",
            "encoder holds, stops", "odometry repeats, stops", "loads 15 % high",
        ),
    ],
)  # fmt: skip
def test_what_is_wired_wrongly_or_dies_is_said_within_5_m(name: str) -> None:
    found = line("field", name)
    assert found["said"] is not None
    assert found["said"] <= SOON
    others = {"front_right", "rear_left", "rear_right"}
    if WORLDS["field"][name].said.startswith("front_left"):
        assert not [words for words in found["findings"] if any(o in words for o in others)]


@pytest.mark.parametrize(
    "name", ["imu tilted, turned", *slow("imu tilted", "there and back, ruts")]
)
def test_what_cannot_be_seen_is_in_the_bands(name: str) -> None:
    found = line("field", name)
    assert held(found, "pull") > 0.88
    assert held(found, "margin") > 0.88


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("odometry without twist", "no twist"),
        *(
            pytest.param(name, words, marks=pytest.mark.slow)
            for name, words in (
                ("skid steering, spins", ""), ("driven imu, skid steering", ""), ("motor current", ""),
                ("odometry at 4 Hz", ""), ("imu z down", "looks down"),
            )
        ),
    ],
)  # fmt: skip
def test_what_real_robots_do_is_no_fault_and_slip_is_known(name: str, words: str) -> None:
    found = line("robots", name)
    assert all(words and words in text for text in found["findings"])
    assert bool(found["findings"]) == bool(words)
    assert found["known"][0] > 0.85 * found["known"][1]
    assert held(found, "slip") > 0.85
    assert found["false"]["first level"] == 0
