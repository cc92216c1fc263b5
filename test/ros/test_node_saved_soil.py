# SPDX-License-Identifier: Apache-2.0
"""The soil is saved, and the node goes on from it after it was killed; the alarm that calls for it."""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path

import pytest
from node_peer import Peer

from smallwheel_ros.ros import NodeProcess

pytestmark = pytest.mark.dds


def test_a_node_that_was_killed_goes_on_with_its_saved_soil(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    from smallwheel_ros.msg import SoilEstimate

    file = tmp_path / "soil.yaml"
    soils = peer.latched(SoilEstimate, "soil")
    first, second = tmp_path / "first.log", tmp_path / "second.log"
    with NodeProcess([one_wheel], first, {"soil.file": str(file)}) as node:
        peer.wait_for_node()
        peer.drive(0.0, 2.0)
        peer.spin_until(lambda: soils[-1].measurements_accepted > 20, "a soil")
        answer = peer.trigger("save_soil")
        assert answer.success, answer.message
        assert str(file) in answer.message
        peer.wait_for_turn()
        saved = soils[-1]
        assert saved.status == SoilEstimate.STATUS_OK
        os.kill(node.process_id, signal.SIGKILL)
        peer.spin_until(lambda: node.death() is not None, "the node is dead")
    soils.clear()
    with NodeProcess([one_wheel], second, {"soil.file": str(file)}):
        peer.spin_until(lambda: bool(soils), "the soil of the new node")
        restored = soils[0]
        assert restored.status == SoilEstimate.STATUS_OK
        assert restored.measurements_accepted == saved.measurements_accepted
        for name in ("k", "n", "m", "reference_pressure", "reference_pressure_standard_deviation"):
            assert getattr(restored, name) == pytest.approx(getattr(saved, name), rel=1e-9), name
        peer.wait_for_node()
        before = restored.measurements_accepted
        # Stretches wait for 0.6 m before they count. DDS may lose what is sent while the publishers of the
        # first node's time and the subscriptions of this one still find each other: then a way further on.
        for start in (2.0, 4.0, 6.0):
            peer.drive(start, start + 2.0)
            peer.wait_for_turn()
            if soils[-1].measurements_accepted > before + 10:
                break
        peer.spin_until(lambda: soils[-1].measurements_accepted > before + 10, "it goes on")
        # A reset goes back to the prior; the file stays.
        assert peer.trigger("reset").success
        peer.spin_until(lambda: soils[-1].status == SoilEstimate.STATUS_PRIOR_ONLY, "the prior")
        assert file.exists()
    assert "soil restored from" in second.read_text()
    assert "Traceback" not in first.read_text() + second.read_text()


def test_a_file_that_is_no_soil_is_said_and_the_prior_used(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    from smallwheel_ros.msg import SoilEstimate

    file = tmp_path / "soil.yaml"
    file.write_text("not a soil")
    soils = peer.latched(SoilEstimate, "soil")
    log = tmp_path / "node.log"
    with NodeProcess([one_wheel], log, {"soil.file": str(file)}) as node:
        peer.spin_until(lambda: bool(soils), "the prior")
        assert soils[0].status == SoilEstimate.STATUS_PRIOR_ONLY
        peer.spin_until(lambda: peer.entry("saved soil") is not None, "diagnostics")
        assert "the saved soil is not used" in peer.entry("saved soil").message
        assert str(file) in peer.entry("saved soil").message
        answer = peer.trigger("save_soil")
        assert not answer.success
        assert "the soil has not been measured yet" in answer.message
        peer.wait_for_node()
        peer.drive(0.0, 1.0)
        peer.spin_until(lambda: soils[-1].measurements_accepted > 5, "a soil")
        answer = peer.trigger("save_soil")
        assert not answer.success
        assert f"nothing saved: {file}" in answer.message
        peer.configure_with("soil.file", "")
        answer = peer.trigger("save_soil")
        assert not answer.success
        assert "parameter soil.file is empty" in answer.message
        assert file.read_text() == "not a soil"
        assert node.death() is None
    assert "Traceback" not in log.read_text()


def test_digging_in_is_an_alarm_and_dear_until_it_gets_through(
    peer: Peer, one_wheel: Path, tmp_path: Path
) -> None:
    from nav_msgs.msg import OccupancyGrid

    grids = peer.latched(OccupancyGrid, "cost")
    log = tmp_path / "node.log"
    with NodeProcess([one_wheel], log, {"cost.size": "8.0"}) as node:
        peer.wait_for_node()
        peer.drive(0.0, 1.5, slip=0.1, step=0.01, period=0.025)
        assert not any(message.level > message.LEVEL_OK for message in peer.vehicle)
        # The wheel spins, goes down and hardly gets on; a fifth of the speed it had.
        peer.drive(1.5, 1.65, slip=0.8, sinkage=0.025, step=0.002, period=0.025)
        peer.spin_until(
            lambda: any(m.level >= m.LEVEL_GETS_STUCK for m in peer.vehicle[-20:]), "the alarm"
        )
        assert "gets stuck" in peer.mobility[-1].status_text
        peer.spin_until(lambda: peer.entry("alarms").level == b"\x02", "the alarm in diagnostics")
        assert "its wheels dig in: stop" in peer.entry("alarms").message
        peer.spin_until(lambda: max(grids[-1].data) >= 90, "ground that it is warned of")
        peer.drive(1.65, 4.0, slip=0.1, step=0.01, period=0.025)
        peer.spin_until(lambda: peer.entry("alarms").message == "none", "the alarms end")
        # It got through: what was feared of this ground is taken back.
        peer.spin_until(lambda: max(grids[-1].data) < 50, "ground that it got through")
        assert node.death() is None
    said = log.read_text()
    assert "Traceback" not in said
    # Each alarm once when it begins and once when it ends, whatever its numbers are meanwhile.
    # The warning of getting stuck is of the first level or of the second as it begins.
    # It is one warning of two levels, the same words as everywhere, and ends as a whole.
    lines = [line for line in said.splitlines() if re.search("(may get|gets) stuck", line)]
    began = [line for line in lines if "no longer" not in line]
    assert sum("no longer" in line for line in lines) == 1, said
    for level, words in (("ERROR", "gets stuck, its wheels dig in"), ("WARN", "may get stuck")):
        mine = [line for line in began if words in line]
        assert all(level in line for line in mine)
    assert sum("gets stuck" in line for line in began) == 1, said
