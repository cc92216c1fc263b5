# SPDX-License-Identifier: Apache-2.0
"""A figure is the same in every page, and those of README.md are printed or declared."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FIGURES: list[dict[str, str]] = yaml.safe_load(
    (ROOT / "docs" / "figures.yaml").read_text(encoding="utf-8")
)
BLOCK = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
QUANTITY = re.compile(r"(?<![\w.])(\d[\d.]*)(?: to (\d[\d.]*))? ?(mm|cm|m|s|ms|N|%|Hz|kg)\b")


def prose(page: Path) -> str:
    """The text of a page on one line, without its blocks."""
    return " ".join(BLOCK.sub("", page.read_text(encoding="utf-8")).split())


def wrong(figure: dict[str, str], text: str) -> list[str]:
    """What a text says in place of the figure."""
    return [found for found in re.findall(figure["pattern"], text) if found != figure["value"]]


@pytest.mark.parametrize("figure", FIGURES, ids=lambda figure: figure["value"])
def test_a_figure_is_the_same_in_every_page(figure: dict[str, str]) -> None:
    texts = {page.name: prose(page) for page in PAGES}
    assert any(re.search(figure["pattern"], text) for text in texts.values()), "no page has it"
    assert {name: found for name, text in texts.items() if (found := wrong(figure, text))} == {}


def test_another_figure_for_the_same_thing_is_found() -> None:
    figure = {"pattern": r"about ([\d.]+) times as fast", "value": "8"}
    assert wrong(figure, "it is about 2 times as fast, and about 8 times as fast there") == ["2"]


def test_each_figure_of_the_readme_is_printed_or_declared() -> None:
    page = ROOT / "README.md"
    shown = "\n".join(BLOCK.findall(page.read_text(encoding="utf-8")))
    printed = {(float(a), unit) for a, _, unit in QUANTITY.findall(shown)}
    text = prose(page)
    for figure in FIGURES:
        text = re.sub(figure["pattern"], "", text)
    told = QUANTITY.findall(text)
    assert told
    assert not [(a, unit) for a, _, unit in told if (float(a), unit) not in printed]
