# SPDX-License-Identifier: Apache-2.0
"""What docs/ says of effects is true: the tables, and the example of one's own."""

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


def test_every_form_is_in_the_table(repository: Path) -> None:
    text = (repository / "docs" / "effects.md").read_text(encoding="utf-8").replace("\\|", "|")
    instruments = text.split("\n## Instruments\n")[1]
    for id, forms in families().items():
        if all(form.kind == "instrument" for form in forms):
            section = "\n".join(re.findall(rf"^\| {id} (\|.*)$", instruments, re.MULTILINE))
            assert f"(images/effects/{id}.svg)" in instruments
        else:
            section = text.split(f"\n## {id}\n")[1].split("\n## ")[0]
        listed = re.findall(r"^\| `(.*?)` \| `(.*?)` \|", section, re.MULTILINE)
        assert listed == [(form.form, form.formula) for form in forms]
        for form in forms:
            assert form.source in section
            for known in form.parameters():
                assert f"`{known.name}`" in section
                if known.published:
                    assert f"({known.published[0]:g} to {known.published[1]:g})" in section


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
