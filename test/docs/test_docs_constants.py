# SPDX-License-Identifier: Apache-2.0
"""The table of constants in docs/diagnosis.md is that of the code. Run as a script, it is made anew."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import pytest

from smallwheel_ros.fitting import constants

BEGIN = "<!-- constants: begin (made by `python test/docs/test_docs_constants.py`) -->\n"
END = "<!-- constants: end -->\n"


class Constant(NamedTuple):
    name: str
    value: float
    why: str


def read() -> list[Constant]:
    """What the comment above each constant says: its name, a dash, and why."""
    found = []
    source = Path(constants.__file__).read_text(encoding="utf-8")
    for comment, value in re.findall(r"((?:^# .*\n)+)^[A-Z_]+ = (.*)$", source, re.MULTILINE):
        name, why = " ".join(re.sub(r"^#\s+", "", comment, flags=re.MULTILINE).split("\n")).split(
            " - ", 1
        )
        found.append(Constant(name.strip(), float(value), why.strip()))
    return found


TABLE = read()


def table() -> str:
    rows = [f"| {c.name} | {c.value:g} | {c.why.replace('|', '/')} |\n" for c in TABLE]
    return "".join(["| constant | value | why |\n", "| --- | --- | --- |\n", *rows])


def split(page: str) -> tuple[str, str, str]:
    before, rest = page.split(BEGIN)
    shown, after = rest.split(END)
    return before, shown, after


def test_the_page_has_the_constants_of_the_code(repository: Path) -> None:
    page = (repository / "docs" / "diagnosis.md").read_text(encoding="utf-8")
    assert split(page)[1] == table(), "run `python test/docs/test_docs_constants.py`"


@pytest.mark.parametrize("constant", TABLE, ids=lambda c: c.name)
def test_each_constant_has_a_name_and_a_reason(constant: tuple[str, float, str]) -> None:
    name, _, why = constant
    assert name.strip()
    assert why.strip()


if __name__ == "__main__":
    path = Path(__file__).resolve().parents[2] / "docs" / "diagnosis.md"
    before, _, after = split(path.read_text(encoding="utf-8"))
    path.write_text(before + BEGIN + table() + END + after, encoding="utf-8")
