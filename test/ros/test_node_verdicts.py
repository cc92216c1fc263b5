# SPDX-License-Identifier: Apache-2.0
"""What the measurements determine of the soil, in words: in the log and in diagnostics, over DDS."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from node_peer import ONE_WHEEL, Peer
from test_strength import MASS, PRIOR, WHEELS, drive

from smallwheel_ros.estimator.traction import TractionEstimator
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.parameters import settings_from
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

        # Of the first 16 stretches of 0.2 m nothing is determined, and three more wait.
        peer.drive(0.0, 6.0)
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
    onboard = Onboard(settings_from({**values, "rear.width": 0.1, **second}).onboard)
    assert [ONE_DIAMETER in text for text in onboard.undeterminable] == [True] * said


def test_strength_is_said_once_it_is_measured() -> None:
    from smallwheel_ros.ros.diagnostics import strength_values

    estimator = TractionEstimator(PRIOR, WHEELS, MASS)
    said = strength_values(estimator.estimate(), {"balance": "vehicle.mass is not given"})
    assert set(said) == {"strength", "strength measured by", "strength by balance"}
    drive(estimator, 0.42)
    said = strength_values(estimator.estimate(), {})
    assert said["strength measured by"] == "balance"
    assert said["verdict on friction angle"].endswith("of the prior's standard deviation is left")
    value, deviation = map(float, said["friction angle [rad]"].split(" +- "))
    assert abs(value - 0.42) < 3.0 * deviation
