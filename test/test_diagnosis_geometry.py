"""A base with the closed form (eq. 10): the geometry is what is missing, not the effects it looks like."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from click.testing import CliRunner

from smallwheel_ros.cli import main
from smallwheel_ros.diagnosis import diagnose
from smallwheel_ros.diagnosis.workbench import Base
from smallwheel_ros.measurements.table import Measurements, read_measurements
from smallwheel_ros.model_file import read_model
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table


def rig(folder: Path, seed: int, hidden: Sequence[str] = (), noise: float = 0.01) -> Measurements:
    settings = RigSettings(seed=seed, hidden=tuple(hidden), noise=noise, soil_scatter=0.02)
    write_table(simulate_rig(settings).table, folder / "rig.csv")
    return read_measurements(folder / "rig.csv")


@pytest.mark.parametrize("seed", [4030, 4031, 4032])
def test_the_geometry_is_named_and_nothing_else(tmp_path: Path, seed: int) -> None:
    found = diagnose(rig(tmp_path, seed), Base(geometry="closed_form")).document
    assert found["verdict"] == "missing_effect"
    assert found["missing_effects"] == ["contact_geometry"]
    assert [step["added"] for step in found["steps"]] == [None, "contact_geometry"]
    first, last = (step["held_out_rmse"] for step in found["steps"])
    assert last["resistance"] < 0.9 * first["resistance"]
    row = found["ranking"][0]
    assert (row["effect"], row["status"]) == ("contact_geometry", "significant")
    assert found["lack_of_fit"]["p_value"] < 0.02


def test_what_else_is_missing_is_named_after_it(tmp_path: Path) -> None:
    data = rig(tmp_path, 4033, ("multipass",))
    found = diagnose(data, Base(geometry="closed_form")).document
    assert found["missing_effects"] == ["contact_geometry", "multipass"]
    assert [step["added"] for step in found["steps"]][1:] == found["missing_effects"]


def test_where_noise_hides_the_geometry_no_effect_takes_its_place(tmp_path: Path) -> None:
    found = diagnose(rig(tmp_path, 4034, noise=0.2), Base(geometry="closed_form")).document
    assert found["verdict"] == "adequate"
    status = {row["effect"]: row["status"] for row in found["ranking"]}
    assert status["contact_geometry"] == "not_significant"
    assert any("eq. 10" in note for note in found["notes"])


def test_the_command_adds_it_to_a_model_file(tmp_path: Path) -> None:
    rig(tmp_path, 4030)
    data, before, after = (str(tmp_path / name) for name in ("rig.csv", "a.yaml", "b.yaml"))
    fitted = CliRunner().invoke(main, ["fit", data, "--geometry", "closed_form", "-o", before])
    assert fitted.exit_code == 0, fitted.output
    added = CliRunner().invoke(
        main, ["add", "contact_geometry", "--model", before, "--data", data, "-o", after]
    )
    assert added.exit_code == 0, added.output
    assert "recommended: the error fell" in added.output
    assert read_model(before).model.geometry == "closed_form"
    assert read_model(after).model.geometry == "contact_integral"
