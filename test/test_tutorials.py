"""The tutorials print what they say. `PYTHONPATH=. python test/test_tutorials.py [PAGE]` writes it anew."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tempfile
from itertools import zip_longest
from pathlib import Path

import pytest
from click.testing import CliRunner

from smallwheel_ros import cli

DOCS = Path(__file__).resolve().parent.parent / "docs"
FAST, SLOW = ("theory", "tutorial_bench", "lab_tests"), ("tutorial_robot",)
BLOCK = re.compile(r"(?<=^```console\n).*?(?=^```$)", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
# Another processor or numerical library moves the last digits; of small differences, more.
RELATIVE, DIGITS = 0.05, 2


def commands(block: str) -> list[tuple[str, list[str]]]:
    """Each command of a block, with the lines that are shown below it."""
    found: list[tuple[str, list[str]]] = []
    for line in block.splitlines():
        if line.startswith("$ "):
            found.append((line[2:], []))
        else:
            found[-1][1].append(line)
    return found


def output(command: str) -> list[str]:
    """What a command prints, on both streams; those of this package run in this process."""
    program, *arguments = shlex.split(command)
    if program == "smallwheel":
        result = CliRunner().invoke(cli.main, arguments)
        assert result.exit_code == 0, f"{command}\n{result.output}"
        text = result.output
    else:
        words = [sys.executable if program == "python" else program, *arguments]
        done = subprocess.run(
            words,
            capture_output=True,
            text=True,
            timeout=300,
            env={**os.environ, "PYTHONPATH": str(DOCS.parent)},
        )
        assert done.returncode == 0, f"{command}\n{done.stderr}"
        text = done.stdout
    return [line.rstrip() for line in text.rstrip().splitlines()]


def same(shown: str, printed: str) -> bool:
    """Whether two lines have the same words, and the same numbers but for rounding."""
    if NUMBER.sub("#", shown).split() != NUMBER.sub("#", printed).split():
        return False
    for a, b in zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True):
        decimals = len(a.partition(".")[2].partition("e")[0])
        if abs(float(a) - float(b)) > max(RELATIVE * abs(float(a)), DIGITS * 0.1**decimals):
            return False
    return True


def run(block: str) -> list[tuple[list[str], list[str]]]:
    """What is shown, and what is printed, for each command of a block; in the working folder."""
    return [(shown, output(command)) for command, shown in commands(block)]


def set_up(folder: Path) -> None:
    """Put beside the commands what the tutorials expect beside them."""
    for part in ("config", "examples"):
        (folder / part).symlink_to(DOCS.parent / part)


@pytest.mark.parametrize(
    "page", [*FAST, *(pytest.param(page, marks=pytest.mark.slow) for page in SLOW)]
)
def test_it_prints_what_it_says(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    set_up(tmp_path)
    monkeypatch.chdir(tmp_path)
    blocks = BLOCK.findall((DOCS / f"{page}.md").read_text(encoding="utf-8"))
    assert blocks
    for block in blocks:
        for shown, printed in run(block):
            for a, b in zip_longest(shown, printed, fillvalue="(no line)"):
                assert same(a, b), f"shown: {a}\nprinted: {b}\nrun `python test/test_tutorials.py`"


def test_lines_are_compared_with_room_for_rounding_only() -> None:
    assert same("sinkage: 4.25 mm +- 0.838 mm", "sinkage:  4.24 mm +-  0.84 mm")
    assert not same("sinkage: 4.25 mm", "sinkage: 5.25 mm")
    assert not same("sinkage: 4.25 mm", "sinkage: 4.25 N")
    assert not same("sinkage: 4.25 mm", "sinkage: 4.25 mm 1")
    assert not same("slip 0.3", "slip -0.3")


def write_anew(page: Path) -> None:
    """Put what is printed now into a page."""

    def renewed(block: re.Match[str]) -> str:
        shown = commands(block[0])
        return "".join("\n".join([f"$ {command}", *output(command), ""]) for command, _ in shown)

    page.write_text(BLOCK.sub(renewed, page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    for name in sys.argv[1:] or (*FAST, *SLOW):
        with tempfile.TemporaryDirectory() as scratch:
            set_up(Path(scratch))
            os.chdir(scratch)
            write_anew(DOCS / f"{name}.md")
            os.chdir(DOCS)
