# SPDX-License-Identifier: Apache-2.0
"""A figure is the same in every page; README.md's are printed or declared, rates those of their files."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pandas as pd
import pytest
import yaml

from rates import real_drives, run

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


def test_the_rates_are_those_of_the_files_of_results(tmp_path: Path) -> None:
    page = tmp_path / "rates.md"
    shutil.copy(run.PAGE, page)
    run.write_page(page)
    assert page.read_text(encoding="utf-8") == run.PAGE.read_text(encoding="utf-8")


def test_what_fails_in_words_is_in_the_files_of_results() -> None:
    text = prose(run.PAGE)

    def values(subject: str, what: str) -> pd.Series[float]:
        rates = pd.read_csv(run.FOLDER / f"{subject}.csv")
        return rates[rates.what == what].set_index("world").value.astype(float)

    pulls = values("traction", "pull in its 95 % band")
    assert f"{pulls.min():.2f} of the pulls of the worst world" in text
    foreign, soil = (values(name, "m determined at the end")["all"] for name in ("foreign", "soil"))
    assert f"m is determined in {foreign:.2f} of the drives of `foreign`, in {soil:.2f} of" in text


def test_the_real_drives_are_those_of_their_file() -> None:
    table = pd.read_csv(real_drives.CSV, keep_default_na=False)
    text = (ROOT / "docs" / "real_robots.md").read_text(encoding="utf-8")
    assert real_drives.markdown(table) in text


def test_warnings_are_counted_in_one_file() -> None:
    """Each row of the page is a row of the file; other pages have none of them."""
    counts = pd.read_csv(
        ROOT / "rates" / "results" / "warnings.csv", dtype=str, keep_default_na=False
    )
    rows = []
    for drives, metres, seeds, *cells in counts.itertuples(index=False):
        way = f", {int(metres):,} m (seeds {seeds})" if metres else ""
        rows.append("| " + " | ".join([f"{drives}{way}", *cells]).replace("  ", " ") + " |")
    table = "\n".join(rows).replace("|  |", "| |")
    texts = {page.name: page.read_text(encoding="utf-8") for page in PAGES}
    assert table in texts["without_soil_sensors.md"]
    assert not [
        name
        for name, text in texts.items()
        if name != "without_soil_sensors.md" and any(row in text for row in table.splitlines())
    ]
