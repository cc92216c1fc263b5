# SPDX-License-Identifier: Apache-2.0
"""README and tutorials show what their commands print.

As a program (PYTHONPATH=. and [PAGE ...]) it writes them anew.
"""

from __future__ import annotations

import difflib
import os
import re
import shlex
import signal
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

from smallwheel_ros import cli

DOCS = Path(__file__).resolve().parents[2] / "docs"
FAST = ("../README", "theory", "tutorial_bench", "lab_tests", "your_own_effect", "learn")
LONG, SLOW = ("benchmark",), ("tutorial_robot",)
FIRST_HOUR = "first_hour"
LEFT_OUT = "..."  # a line for those that a page does not show
CONTINUED = "\\\n"  # a command that goes on in the next line of a block, after `> `
WIDTH = 76  # columns of a block: a page of 1280 pixels shows as many
BLOCK = re.compile(r"(?<=^```console\n).*?(?=^```$)", re.MULTILINE | re.DOTALL)
SPAN = re.compile(r"`(smallwheel [^`]+)`|^    (smallwheel [^\\\n]+(?:\\\n[^\\\n]+)*)", re.MULTILINE)
SAVED = re.compile(r"save it as `(\w+\.py)`[^\n]*\n\n```python\n(.*?)```", re.DOTALL)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
# Another processor or numerical library moves the last digits; of small differences, more.
RELATIVE, DIGITS = 0.05, 2


def commands(block: str) -> list[tuple[str, list[str]]]:
    """Each command of a block, with the lines that are shown below it; `> ` goes on with a command."""
    found: list[tuple[str, list[str]]] = []
    for line in block.splitlines():
        if line.startswith("$ "):
            found.append((line[2:], []))
        elif line.startswith("> "):
            found[-1] = (f"{found[-1][0]}\n{line[2:]}", [])
        else:
            found[-1][1].append(line)
    return found


def folded(line: str) -> list[str]:
    """A printed line as a page shows it: what is wider than a block goes on below, further in."""
    indent = " " * (len(line) - len(line.lstrip()) + 4)
    return [
        part.rstrip()
        for part in textwrap.wrap(
            line,
            WIDTH,
            subsequent_indent=indent,
            break_long_words=False,
            break_on_hyphens=False,
        )
    ] or [""]


def subprocess_of(command: str) -> dict[str, Any]:
    """How to start a command in a process of its own: this Python, this checkout."""
    program, *arguments = shlex.split(command.replace(CONTINUED, ""))
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
    command, *filters = command.replace(CONTINUED, "").split(" | ")
    program, *arguments = shlex.split(command)
    if program == "smallwheel" and arguments[0] != "play":
        result = CliRunner().invoke(cli.main, arguments)
        assert result.exit_code == 0, f"{command}\n{result.output}"
        text = result.output
    else:
        done = subprocess.run(**subprocess_of(command), timeout=300)
        assert done.returncode == 0, f"{command}\n{done.stderr}"
        text = done.stdout
    for program in filters:
        cut = subprocess.run(shlex.split(program), input=text, capture_output=True, text=True)
        assert cut.returncode == 0, f"{program}\n{cut.stderr}"
        text = cut.stdout
    lines = [line.rstrip() for line in text.rstrip().splitlines()]
    return [part for line in lines for part in folded(line)]


def played(
    block: str, output: Callable[[str], list[str]] = output
) -> Iterator[tuple[str, list[str], list[str]]]:
    """Each command of a block, what is shown and what is printed; `&` runs on until the end of it.

    What such a command says goes to the file after `2>`, if it has one; `output` runs the others.
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


def words(text: str) -> list[str]:
    """The words of a text, its numbers left open."""
    return NUMBER.sub("#", text).split()


def same(shown: str, printed: str) -> bool:
    """Whether two texts have the same words, and the same numbers but for rounding."""
    if words(shown) != words(printed):
        return False
    for a, b in zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True):
        decimals = len(a.partition(".")[2].partition("e")[0])
        if abs(float(a) - float(b)) > max(RELATIVE * abs(float(a)), DIGITS * 0.1**decimals):
            return False
    return True


def abridged(shown: list[str], printed: list[str]) -> list[str]:
    """What is printed, less what a page leaves out at each line `...`.

    Between two such lines stand lines that follow each other in print; those of the first part
    are where the print begins, those of the last where it ends.
    """
    if LEFT_OUT not in shown:
        return printed
    parts: list[list[str]] = [[]]
    for line in shown:
        if line == LEFT_OUT:
            parts.append([])
        else:
            parts[-1].append(line)
    kept = printed[: len(parts[0])]
    place = len(parts[0])
    for part in parts[1:-1]:
        wanted = words("\n".join(part))
        for start in range(place + 1, len(printed) - len(part) + 1):
            if words("\n".join(printed[start : start + len(part)])) == wanted:
                break
        else:
            raise AssertionError(f"not printed: {part}")
        kept += [LEFT_OUT, *printed[start : start + len(part)]]
        place = start + len(part)
    last = len(printed) - len(parts[-1])
    assert last > place, f"nothing is left out of: {printed}"
    return [*kept, LEFT_OUT, *printed[last:]]


def set_up(folder: Path) -> None:
    """Put beside the commands what the tutorials expect beside them."""
    for part in ("config", "examples"):
        (folder / part).symlink_to(DOCS.parent / part)


def save(text: str) -> None:
    """Write the files of a page that its reader is told to save."""
    for name, content in SAVED.findall(text):
        Path(name).write_text(content, encoding="utf-8")


def check(text: str, output: Callable[[str], list[str]] = output) -> None:
    """Run a page's commands in the working folder by `output` and compare."""
    blocks = BLOCK.findall(text)
    assert blocks
    save(text)
    for block in blocks:
        for command, shown, printed in played(block, output):
            there = abridged(shown, printed)
            # Where a line is folded depends on how many digits a number has: words are compared.
            assert same("\n".join(shown), "\n".join(there)), (
                f"$ {command}\n"
                + "\n".join(difflib.unified_diff(shown, there, "shown", "printed", lineterm=""))
                + "\nrun `python test/docs/test_tutorials.py`"
            )


def text_of(page: str) -> str:
    """A page as it is."""
    return (DOCS / f"{page}.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "page", [*FAST, *(pytest.param(page, marks=pytest.mark.slow) for page in LONG)]
)
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


@pytest.mark.parametrize(
    "page", [*DOCS.glob("*.md"), DOCS.parent / "README.md"], ids=lambda p: p.stem
)
def test_blocks_are_no_wider_than_a_page_shows(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    tokens = pytest.importorskip("markdown_it").MarkdownIt().parse(text)
    blocks = [
        token.content
        for token in tokens
        if token.type in ("fence", "code_block") and token.info in ("", "console", "text", "none")
    ]
    wide = [line for block in blocks for line in block.splitlines() if len(line) > WIDTH]
    assert not wide, "\n".join(wide)


PAGES = [*sorted(DOCS.glob("*.md")), DOCS.parent / "README.md", DOCS.parent / "CONTRIBUTING.md"]


def test_commands_of_every_page_are_run() -> None:
    """A page with a block of commands is in one of the lists above."""
    run = {f"{page}.md".removeprefix("../") for page in (*FAST, *LONG, *SLOW, FIRST_HOUR)}
    assert {page.name for page in PAGES if "```console" in page.read_text(encoding="utf-8")} == run


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_commands_in_the_text_have_the_options_that_it_names(page: Path) -> None:
    for span, block in SPAN.findall(page.read_text(encoding="utf-8")):
        context = click.Context(cli.main)
        command: click.Command = cli.main
        for word in shlex.split((span or block).replace("\\\n", " "), comments=True)[1:]:
            if word == "--":  # what follows is for ROS
                break
            if isinstance(command, click.Group) and not word.startswith("-"):
                found = command.get_command(context, word)
                assert found is not None, f"{span or block}: there is no {word}"
                command = found
            elif word.startswith("-") and not word[1:2].isdigit():
                options = {
                    name for one in command.params for name in (*one.opts, *one.secondary_opts)
                }
                name = word.split("=")[0].rstrip(",.;:")
                assert name in {*options, "--help", "--version"}, f"{span or block}: {word}"


def test_the_tutorial_on_the_robot_up_to_ros(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    set_up(tmp_path)
    without, _ = text_of("tutorial_robot").split("\n## 6. In ROS\n")
    check(without)


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
    assert abridged(["...", "c", "..."], printed) == ["...", "c", "..."]
    with pytest.raises(AssertionError, match="not printed"):
        abridged(["a", "...", "x", "..."], printed)
    assert abridged(printed, printed[:2]) == printed[:2]
    with pytest.raises(AssertionError, match="nothing is left out"):
        abridged(["a", "b", "...", "c", "d"], printed)


def test_lines_are_compared_with_room_for_rounding_only() -> None:
    assert same("sinkage: 4.25 mm +- 0.838 mm", "sinkage:  4.24 mm +-  0.84 mm")
    assert not same("sinkage: 4.25 mm", "sinkage: 5.25 mm")
    assert not same("sinkage: 4.25 mm", "sinkage: 4.25 N")
    assert not same("sinkage: 4.25 mm", "sinkage: 4.25 mm 1")
    assert not same("slip 0.3", "slip -0.3")


def test_a_wide_line_goes_on_below_further_in() -> None:
    line = "  " + " ".join(["twelve"] * 12)
    assert folded(line) == ["  " + " ".join(["twelve"] * 10), "      twelve twelve"]
    assert folded("") == [""]


def write_anew(page: Path) -> None:
    """Put what is printed now into a page."""

    def renewed(block: re.Match[str]) -> str:
        return "".join(
            "\n".join(["$ " + command.replace("\n", "\n> "), *abridged(shown, printed), ""])
            for command, shown, printed in played(block[0])
        )

    text = page.read_text(encoding="utf-8")
    save(text)
    page.write_text(BLOCK.sub(renewed, text), encoding="utf-8")


if __name__ == "__main__":
    for name in sys.argv[1:] or (*FAST, *LONG, *SLOW, FIRST_HOUR):
        with tempfile.TemporaryDirectory() as scratch:
            set_up(Path(scratch))
            os.chdir(scratch)
            write_anew(DOCS / f"{name}.md")
            os.chdir(DOCS)
