# SPDX-License-Identifier: Apache-2.0
"""What docs/ says of effects is true: a section for each, and the example of one's own."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from smallwheel_ros import cli
from smallwheel_ros.effects.base import STAGES, Effect
from smallwheel_ros.effects.registry import effect_class, families, load_effects


def blocks(path: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture
def page(repository: Path) -> Path:
    return repository / "docs" / "your_own_effect.md"


def test_every_effect_has_its_section_with_its_forms_and_its_drawing(repository: Path) -> None:
    text = (repository / "docs" / "effects.md").read_text(encoding="utf-8")
    sections = dict(re.findall(r"^##+ (\w+)\n(.*?)(?=^##|\Z)", text, re.MULTILINE | re.DOTALL))
    of_effects = {id: body for id, body in sections.items() if "```{code-table} effect" in body}
    assert set(of_effects) == set(families())
    instruments = text.index("\n## Instruments\n")
    for id, body in of_effects.items():
        assert f"```{{code-table}} effect {id}\n```" in body
        assert f"(images/effects/{id}.svg)" in body
        faults = {form.kind == "instrument" for form in families()[id]}
        assert faults == {text.index(f" {id}\n") > instruments}


def test_the_example_is_short_and_works(page: Path, tmp_path: Path) -> None:
    code, use = blocks(page, "python")
    own = tmp_path / "warm_sand.py"
    own.write_text(code)
    body = code[code.index("@dataclass") :]
    assert len([line for line in body.splitlines() if line.strip()]) <= 10
    form = effect_class("warm_sand", user=load_effects(own))
    assert issubclass(form, Effect)
    done = subprocess.run(
        [sys.executable, "-c", use], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    cold, warm = (float(v) for v in re.findall(r"0\.\d+", done.stdout))
    assert warm > cold


def test_the_examples_commands_work(page: Path, tmp_path: Path) -> None:
    own = tmp_path / "warm_sand.py"
    own.write_text(blocks(page, "python")[0])
    result = CliRunner().invoke(cli.main, ["effects", "warm_sand", "--effects", str(own)])
    assert result.exit_code == 0
    assert "loss of ln k per kelvin" in result.output


def test_the_stages_are_all_there(page: Path) -> None:
    listed = re.findall(r"^\| `(\w+)\(", page.read_text(encoding="utf-8"), re.MULTILINE)
    assert tuple(listed) == STAGES
