# SPDX-License-Identifier: Apache-2.0
"""The parameter file beside the real drive is what `smallwheel init` finds, with its blanks filled in."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

from smallwheel_ros import cli
from smallwheel_ros.init.rover import FILL_IN


def flat(values: dict[str, object], above: str = "") -> dict[str, object]:
    """Each value by its full name."""
    found: dict[str, object] = {}
    for name, value in values.items():
        found |= (
            flat(value, f"{above}{name}.") if isinstance(value, dict) else {above + name: value}
        )
    return found


def parameters(path: Path) -> dict[str, object]:
    return flat(yaml.safe_load(path.read_text(encoding="utf-8"))["/**"]["ros__parameters"])


def test_it_is_what_init_finds(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = repository / "examples" / "data" / "pathfinder_flat"
    monkeypatch.chdir(tmp_path)
    made = CliRunner().invoke(cli.main, ["init", str(drive), "-o", "found.yaml"])
    assert made.exit_code == 0, made.output
    found = parameters(Path("found.yaml"))
    filled = parameters(drive.with_name("pathfinder.yaml"))
    assert found.keys() == filled.keys()
    assert FILL_IN in found.values()
    assert {n: v for n, v in found.items() if v != FILL_IN} == {
        n: filled[n] for n, v in found.items() if v != FILL_IN
    }
