# SPDX-License-Identifier: Apache-2.0
"""A node saves soil and map by itself: at signals at once, and a kill costs little of what was learnt."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path

import pytest
from node_peer import Peer

from smallwheel_ros.ros import NodeProcess

pytestmark = pytest.mark.dds
PERIOD = 1.0  # s, soil.autosave_period


def parameters(file: Path, period: float = PERIOD) -> dict[str, str]:
    return {"soil.file": str(file), "soil.autosave_period": str(period)}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_ends_the_node_saves_what_it_knows(
    peer: Peer, one_wheel: Path, tmp_path: Path, number: signal.Signals
) -> None:
    from smallwheel_ros.msg import SoilEstimate

    file, logs = tmp_path / "soil.json", [tmp_path / "first.log", tmp_path / "second.log"]
    soils = peer.latched(SoilEstimate, "soil")
    with NodeProcess([one_wheel], logs[0], parameters(file, 3600.0)) as node:
        peer.wait_for_node()
        peer.drive(0.0, 2.0)
        peer.spin_until(lambda: soils[-1].measurements_accepted > 20, "a soil")
        peer.wait_for_turn()
        known = soils[-1].measurements_accepted
        assert not file.exists()
        os.kill(node.process_id, number)
        peer.spin_until(lambda: node.death() is not None, "the node has ended")
        assert "exit code 0" in str(node.death())
    soils.clear()
    with NodeProcess([one_wheel], logs[1], parameters(file)):
        peer.spin_until(lambda: bool(soils), "the soil of the new node")
        assert soils[0].measurements_accepted >= known
    said = logs[1].read_text()
    assert "soil restored from" in said
    assert "cost map restored from" in said
    assert "Traceback" not in logs[0].read_text() + said


def test_a_deactivated_node_has_saved_and_what_cannot_be_written_is_said_and_counted(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    from smallwheel_ros.msg import SoilEstimate

    file = tmp_path / "card" / "soil.json"
    file.parent.write_text("no folder: the card is not there yet")
    soils = peer.latched(SoilEstimate, "soil")
    log = tmp_path / "node.log"
    with NodeProcess([one_wheel], log, parameters(file)) as node:
        peer.wait_for_node()
        peer.drive(0.0, 2.0)
        peer.spin_until(lambda: soils[-1].measurements_accepted > 20, "a soil")
        peer.spin_until(
            lambda: "nothing saved" in getattr(peer.entry("saved soil"), "message", ""), "said"
        )
        assert str(file) in peer.entry("saved soil").message
        assert any("not_saved" in key for key in peer.counts()), peer.counts()
        file.parent.unlink()
        peer.spin_until(file.exists, "saved")
        peer.diagnostics.clear()
        peer.wait_for_turn()
        assert peer.entry("inputs") is not None
        assert peer.entry("saved soil") is None
        before = file.read_bytes()
        peer.drive(2.0, 3.0)
        assert peer.transition(label="deactivate")
        assert file.read_bytes() != before
        assert node.death() is None


@pytest.mark.slow
def test_a_kill_at_any_instant_costs_two_seconds_at_most(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    """A hundred kills at random instants; soil and map are one pair each time."""
    from smallwheel_ros.msg import SoilEstimate

    file, log = tmp_path / "soil.json", tmp_path / "node.log"
    known: list[tuple[float, int]] = []
    soils = peer.latched(SoilEstimate, "soil")
    peer.listen(
        SoilEstimate,
        "soil",
        lambda soil: known.append((time.monotonic(), soil.measurements_accepted)),
    )
    rng, expected, place = random.Random(1), 0, 0.0
    for number in range(101):
        soils.clear()
        with NodeProcess([one_wheel], log, parameters(file)) as node:
            peer.spin_until(lambda: bool(soils), "the soil of the new node")
            assert soils[0].measurements_accepted >= expected, number
            if expected:
                said = log.read_text()
                assert "soil restored from" in said, said
                assert "cost map restored from" in said, said
            peer.wait_for_node()
            known.clear()
            end = time.monotonic() + rng.uniform(2.5, 5.0)
            while time.monotonic() < end or not file.exists():
                peer.drive(place, place + 0.04)
                place += 0.04
            os.kill(node.process_id, signal.SIGKILL)
            killed = time.monotonic()
            peer.spin_until(lambda node=node: node.death() is not None, "the node is dead")
        before = [count for at, count in known if at <= killed - 2.0 * PERIOD]
        expected = max([expected, *before])
    assert expected > 500
