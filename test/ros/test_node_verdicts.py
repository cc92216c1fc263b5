# SPDX-License-Identifier: Apache-2.0
"""What the measurements determine of the soil, in words: in the log and in diagnostics, over DDS.

Tests `diagnostics.py`.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from node_peer import ONE_WHEEL, Peer

from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.physics.wheel import Quantity
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.strength.words import StrengthEstimate
from smallwheel_ros.ros import NodeProcess

ONE_DIAMETER = "all wheels have one diameter (0.25 m)"


@pytest.mark.dds
def test_what_is_determined_is_said_before_driving_and_after(peer: Peer, tmp_path: Path) -> None:
    parameters, log = tmp_path / "rover.yaml", tmp_path / "node.log"
    # Where the sensor's zero may be millimetres off, a wheel 8 mm deep determines nothing.
    parameters.write_text(f"{ONE_WHEEL}    sinkage_zero_std: 0.0003\n")

    def message() -> str:
        entry = peer.entry("soil")
        return "" if entry is None else str(entry.message)

    def verdicts() -> dict[str, str]:
        return {v.key: v.value for v in peer.entry("soil").values if v.key.startswith("verdict")}

    with NodeProcess([parameters], log) as node:
        peer.wait_for_node()
        peer.spin_until(lambda: "no measurement yet" in message(), "diagnostics of the soil")
        assert f"{ONE_DIAMETER}: m stays what the prior says" in message()
        assert set(verdicts()) == {
            "verdict on reference pressure",
            "verdict on effective modulus",
            "verdict on k",
            "verdict on n",
            "verdict on m",
        }
        assert {text.split(":")[0] for text in verdicts().values()} == {"not determined"}
        strength = {v.key: v.value for v in peer.entry("soil").values}["strength"]
        assert strength.startswith("thrust is not determined: no balance, torque or drawbar pull")

        # Of the first 40 stretches of 0.2 m nothing is determined, and three more wait.
        peer.drive(0.0, 10.0)
        peer.spin_until(lambda: f"m not determined: {ONE_DIAMETER}" in message(), "m's verdict")
        assert "m stays what the prior says" not in message()
        assert verdicts()["verdict on reference pressure"].startswith("determined: ")
        assert re.fullmatch(
            "not determined: (9[5-9]|100) % of the prior's standard deviation is left",
            verdicts()["verdict on m"],
        )
        assert node.death() is None
    warnings = [line for line in log.read_text().splitlines() if ONE_DIAMETER in line]
    assert len(warnings) == 1
    assert warnings[0].startswith("[WARN]")
    assert "A wheel of another diameter would determine m" in warnings[0]


@pytest.mark.parametrize(
    ("second", "said"),
    [
        ({"rear.diameter": 0.25}, True),
        ({"rear.diameter": 0.4}, False),
        # The wheel of another size measures nothing.
        ({"rear.diameter": 0.4, "rear.sinkage_topic": ""}, True),
    ],
)
def test_two_sizes_determine_m_where_both_are_measured(
    second: dict[str, object], said: bool
) -> None:
    values = {"wheels": ["front", "rear"], "front.diameter": 0.25, "front.width": 0.1}
    pipeline = Pipeline(settings_from({**values, "rear.width": 0.1, **second}).onboard)
    assert [ONE_DIAMETER in text for text in pipeline.undeterminable] == [True] * said


def test_strength_is_said_once_it_is_measured() -> None:
    from smallwheel_ros.ros.diagnostics import strength_values

    nothing = Pipeline(
        settings_from({"wheels": ["a"], "a.diameter": 0.25, "a.width": 0.1}).onboard
    ).strength
    said = strength_values(nothing, {"balance": "vehicle.mass is not given"})
    assert set(said) == {"strength", "strength measured by", "strength by balance"}
    assert said["strength measured by"] == "nothing"
    measured = StrengthEstimate(
        sources=frozenset({"torque", "balance"}),
        status=("cohesion not determined",),
        remaining={"friction_angle": 0.2},
        other_resistance=Quantity(0.05, 0.02),
        steps=7,
        cohesion=Quantity(800.0, 300.0),
        friction_angle=Quantity(0.42, 0.02),
        shear_displacement=Quantity(0.015, 0.004),
    )
    said = strength_values(measured, {})
    assert said["strength measured by"] == "balance, torque"
    assert said["strength"] == "cohesion not determined"
    assert said["verdict on friction angle"].endswith("of the prior's standard deviation is left")
    assert said["friction angle [rad]"] == "0.42 +- 0.02"
