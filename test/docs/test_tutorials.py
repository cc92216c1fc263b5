# SPDX-License-Identifier: Apache-2.0
"""The tutorials print what they say. Run as a program (PYTHONPATH=. and [PAGE]) this writes them anew."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from smallwheel_ros import cli

DOCS = Path(__file__).resolve().parents[2] / "docs"
FAST, SLOW = ("theory", "tutorial_bench", "lab_tests"), ("tutorial_robot",)
FIRST_HOUR = "first_hour"
LEFT_OUT = "..."  # a line for those that a page does not show
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


def subprocess_of(command: str) -> dict[str, Any]:
    """How to start a command in a process of its own: this Python, this checkout."""
    program, *arguments = shlex.split(command)
    python = {"python": [sys.executable], "smallwheel": [sys.executable, "-m", "smallwheel_ros"]}
    return {
        "args": [*python.get(program, [program]), *arguments],
        "env": {**os.environ, "PYTHONPATH": str(DOCS.parent)},
        "text": True,
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
    }


def output(command: str) -> list[str]:
    """What a command prints; those of this package run in this process, `play` with its threads not."""
    program, *arguments = shlex.split(command)
    if program == "smallwheel" and arguments[0] != "play":
        result = CliRunner().invoke(cli.main, arguments)
        assert result.exit_code == 0, f"{command}\n{result.output}"
        text = result.output
    else:
        done = subprocess.run(**subprocess_of(command), timeout=300)
        assert done.returncode == 0, f"{command}\n{done.stderr}"
        text = done.stdout
    return [line.rstrip() for line in text.rstrip().splitlines()]


def played(block: str) -> Iterator[tuple[str, list[str], list[str]]]:
    """Each command of a block, what is shown and what is printed; `&` runs on until the end of it.

    What such a command says goes to the file after `2>`, if it has one.
    """
    background = []
    try:
        for command, shown in commands(block):
            if command.endswith("&"):
                started, _, log = command.removesuffix("&").partition(" 2> ")
                with open(log.strip() or os.devnull, "w", encoding="utf-8") as said:
                    streams = {"stdout": subprocess.DEVNULL, "stderr": said}
                    background.append(subprocess.Popen(**subprocess_of(started) | streams))
            yield command, shown, [] if command.endswith("&") else output(command)
    finally:
        for process in background:
            process.send_signal(signal.SIGINT)
            process.wait(60)


def same(shown: str, printed: str) -> bool:
    """Whether two lines have the same words, and the same numbers but for rounding."""
    if NUMBER.sub("#", shown).split() != NUMBER.sub("#", printed).split():
        return False
    for a, b in zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True):
        decimals = len(a.partition(".")[2].partition("e")[0])
        if abs(float(a) - float(b)) > max(RELATIVE * abs(float(a)), DIGITS * 0.1**decimals):
            return False
    return True


def abridged(shown: list[str], printed: list[str]) -> list[str]:
    """What is printed, with as many lines at begin and end as are shown about the line `...`."""
    if LEFT_OUT not in shown:
        return printed
    first = shown.index(LEFT_OUT)
    last = len(shown) - first - 1
    assert len(printed) > first + last, f"nothing is left out of: {printed}"
    return [*printed[:first], LEFT_OUT, *printed[len(printed) - last :]]


def set_up(folder: Path) -> None:
    """Put beside the commands what the tutorials expect beside them."""
    for part in ("config", "examples"):
        (folder / part).symlink_to(DOCS.parent / part)


def check(text: str) -> None:
    """Run a page's commands in the working folder and compare."""
    blocks = BLOCK.findall(text)
    assert blocks
    for block in blocks:
        for _, shown, printed in played(block):
            for a, b in zip_longest(shown, abridged(shown, printed), fillvalue="(no line)"):
                assert same(a, b), (
                    f"shown: {a}\nprinted: {b}\nrun `python test/docs/test_tutorials.py`"
                )


def text_of(page: str) -> str:
    """A page as it is."""
    return (DOCS / f"{page}.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", FAST)
def test_it_prints_what_it_says(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    set_up(tmp_path)
    check(text_of(page))


@pytest.mark.slow
@pytest.mark.dds
@pytest.mark.parametrize("page", SLOW)
def test_it_prints_what_it_says_with_ros(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    set_up(tmp_path)
    check(text_of(page))


def first_hour() -> tuple[str, str, str]:
    """Its parts: at the bench, on the robot without ROS, and with it."""
    bench, rest = text_of(FIRST_HOUR).split("\n## On the robot\n")
    without, with_ros = rest.split("\n## The node\n")
    return bench, without, with_ros


def test_the_first_hour_without_ros(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From an empty folder, where rclpy cannot be imported: not by a process of its own either."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "rclpy", None)
    bench, without, _ = first_hour()
    check(bench + without)


@pytest.mark.dds
def test_the_first_hour_with_ros(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    _, without, with_ros = first_hour()
    check(without + with_ros)


def test_of_a_long_output_begin_and_end_are_compared() -> None:
    printed = ["a", "b", "c", "d"]
    assert abridged(["a", "..."], printed) == ["a", "..."]
    assert abridged(["...", "x"], printed) == ["...", "d"]
    assert abridged(["a", "...", "c", "d"], printed) == ["a", "...", "c", "d"]
    assert abridged(printed, printed[:2]) == printed[:2]
    with pytest.raises(AssertionError, match="nothing is left out"):
        abridged(["a", "b", "...", "c", "d"], printed)


def test_lines_are_compared_with_room_for_rounding_only() -> None:
    assert same("sinkage: 4.25 mm +- 0.838 mm", "sinkage:  4.24 mm +-  0.84 mm")
    assert not same("sinkage: 4.25 mm", "sinkage: 5.25 mm")
    assert not same("sinkage: 4.25 mm", "sinkage: 4.25 N")
    assert not same("sinkage: 4.25 mm", "sinkage: 4.25 mm 1")
    assert not same("slip 0.3", "slip -0.3")


def write_anew(page: Path) -> None:
    """Put what is printed now into a page."""

    def renewed(block: re.Match[str]) -> str:
        return "".join(
            "\n".join([f"$ {command}", *abridged(shown, printed), ""])
            for command, shown, printed in played(block[0])
        )

    page.write_text(BLOCK.sub(renewed, page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    for name in sys.argv[1:] or (*FAST, *SLOW, FIRST_HOUR):
        with tempfile.TemporaryDirectory() as scratch:
            set_up(Path(scratch))
            os.chdir(scratch)
            write_anew(DOCS / f"{name}.md")
            os.chdir(DOCS)
