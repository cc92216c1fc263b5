# SPDX-License-Identifier: Apache-2.0
"""Pages in a real browser: they answer to mouse and keyboard, fetch nothing, and can be read.

Tests `law_table.py`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from chromium import Browser, needs_chromium
from click.testing import CliRunner
from lab_truth import plate_rows, write

from smallwheel_ros import cli
from smallwheel_ros.api.compare import compare
from smallwheel_ros.api.diagnose import diagnose
from smallwheel_ros.diagnosis.pipeline import Diagnosis
from smallwheel_ros.measurements.display import shown_value
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table
from smallwheel_ros.views import report

pytestmark = needs_chromium

EVIL = '</script><img src=x onerror="document.title=1"> $x^{ "&\' \u202egnp'
# Contrast of every text with what is behind it (WCAG 2.1, relative luminance), and where it is too low.
CONTRAST = """
(() => {
  const parse = text => text.match(/[\\d.]+/g).map(Number);
  const linear = c => (c /= 255) <= 0.03928 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  const light = ([r, g, b]) => 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
  const behind = e => {
    for (; e; e = e.parentElement) {
      const c = parse(getComputedStyle(e).backgroundColor);
      if (c.length < 4 || c[3] > 0.5) return c;
    }
    return [255, 255, 255];
  };
  const low = [];
  for (const e of document.querySelectorAll('body *')) {
    const own = [...e.childNodes].some(n => n.nodeType === 3 && n.textContent.trim());
    if (!own || !e.checkVisibility() || e.closest('script, style, svg, .sr')) continue;
    const [a, b] = [light(parse(getComputedStyle(e).color)), light(behind(e))].sort((x, y) => y - x);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < 4.5) low.push(`${ratio.toFixed(2)} ${e.tagName} ${e.textContent.slice(0, 40)}`);
  }
  return low;
})()
"""
# What can be pointed at by name: every field and plot has one; ids are not given twice.
NAMES = """
(() => {
  const lacking = [];
  for (const e of document.querySelectorAll('[tabindex="0"], input, select, button')) {
    const name = e.getAttribute('aria-label') || e.labels?.[0]?.textContent || e.textContent;
    if (!name?.trim()) lacking.push(e.outerHTML.slice(0, 80));
  }
  const ids = [...document.querySelectorAll('[id]')].map(e => e.id);
  return [...lacking, ...ids.filter((id, i) => ids.indexOf(id) !== i)];
})()
"""


@pytest.fixture(scope="module")
def diagnosis(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    """A table with hidden slip sinkage and hostile names; slip in per cent, as its header says."""
    table = simulate_rig(RigSettings(seed=3, runs=16, hidden=("slip_sinkage",))).table
    table["soil"] = "sand" + EVIL
    table["run"] = table["run"].astype(str) + EVIL
    table["slip [%]"] = 100.0 * table.pop("slip")
    path = tmp_path_factory.mktemp("rig") / "rig<b>.csv"
    write_table(table, path)
    return diagnose(read_measurements(path))


@pytest.fixture(scope="module")
def page(diagnosis: Diagnosis, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The whole report, with the steps to set and unset, as a file's address."""
    path = tmp_path_factory.mktemp("page") / "report.html"
    report.page(diagnosis, compare(diagnosis.measurements)).write(path)
    return path.as_uri()


@pytest.fixture(scope="module")
def laws(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A table of laws on plates whose runs have hostile names."""
    folder = tmp_path_factory.mktemp("laws")
    rows = plate_rows(np.random.default_rng(0), runs=1, rows=6)
    (folder / "a_laboratory_with_a_name").mkdir()
    folder /= "a_laboratory_with_a_name"
    write(
        folder / "plates_of_the_first_soil_bin.csv", [[f"{row[0]}{EVIL}", *row[1:]] for row in rows]
    )
    (folder / "LICENSE").write_text(f"CC0 {EVIL}")
    return compare(str(folder.parent)).save(folder / "laws.html").as_uri()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    made = Browser(tmp_path_factory.mktemp("profile"))
    yield made
    made.close()


SHOWN = "[...document.querySelectorAll('.view')][0]"


def click(browser: Browser, name: str = "slip sinkage") -> None:
    browser.run("[...document.querySelectorAll('fieldset label')]"
                f".find(e => e.innerText.includes('{name}')).click()")  # fmt: skip


def shown(browser: Browser) -> str:
    return str(browser.run(f"{SHOWN}.innerText"))


def test_a_click_shows_what_was_fitted_beforehand_and_fetches_nothing(
    browser: Browser, page: str, diagnosis: Diagnosis
) -> None:
    browser.look()
    browser.open(page)
    browser.events.clear()
    assert "The base model: sinkage" in shown(browser)
    before, after = (step["held_out_rmse"] for step in diagnosis.document["steps"])
    click(browser)
    said = shown(browser)
    for channel in before:
        assert (
            f"{shown_value(channel, before[channel])} → {shown_value(channel, after[channel])}"
            in said
        )
    assert "z = z0" in said  # the formula of the form that was fitted
    assert "a true model" in said
    click(browser)
    assert "The base model: sinkage" in shown(browser)
    assert browser.requests == []
    assert browser.complaints == []
    assert browser.run("document.title") != "1"
    assert browser.run("document.querySelectorAll('img').length") == 0


def test_the_bar_of_the_error_falls(browser: Browser, page: str) -> None:
    """Bars of the base, of what is set and of a true model, as long as their errors."""
    browser.look()
    browser.open(page)
    click(browser)
    part = ("[...document.querySelectorAll('[data-view]:not([hidden]) td .bar')]"
            ".map(e => parseFloat(e.style.getPropertyValue('--part')))")  # fmt: skip
    bars = browser.run(part)[:3]
    assert bars[0] == 100.0
    assert bars[1] < 40.0
    assert bars[2] < 40.0


def test_everything_can_be_done_by_keyboard(browser: Browser, page: str) -> None:
    browser.look()
    browser.open(page)
    browser.run("document.querySelector('fieldset input').focus()")
    browser.press("Space")
    assert "With slip sinkage" in shown(browser)


def test_residuals_follow_the_setting_beside_measured_over_predicted(
    browser: Browser, page: str
) -> None:
    browser.look()
    browser.open(page)
    options = browser.run(
        "[...document.querySelector('.models select').options].map(o => o.textContent)"
    )
    assert "slip [%]" in options
    titles = f"[...{SHOWN}.querySelectorAll('.plot:not([hidden]) .title')].map(e => e.textContent)"
    assert "sinkage: residual over slip" in browser.run(titles)
    assert "sinkage: measured against predicted" in browser.run(titles)
    browser.run("const s = document.querySelector('.models select'); s.value = 'load';"
                "s.dispatchEvent(new Event('change', {bubbles: true}))")  # fmt: skip
    assert "sinkage: residual over load" in browser.run(titles)
    assert "sinkage: measured against predicted" in browser.run(titles)
    assert browser.run(f"{SHOWN}.querySelectorAll('.plot:not([hidden]) circle').length") > 100


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [390, 1280])
def test_the_page_can_be_read_at_any_width_and_in_the_dark(
    browser: Browser, page: str, width: int, dark: bool
) -> None:
    browser.look(width, dark)
    browser.open(page)
    click(browser)
    assert browser.run("document.documentElement.scrollWidth") <= width
    assert browser.run(CONTRAST) == []
    assert browser.run(NAMES) == []
    wide = "Math.max(...[...document.querySelectorAll('.plot')].map(e => e.getBoundingClientRect().right))"
    assert browser.run(wide) <= width


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("which", ["page", "drive", "laws"])
def test_axe_finds_nothing(
    browser: Browser, request: pytest.FixtureRequest, which: str, width: int
) -> None:
    package = pytest.importorskip("axe_core_python", reason="axe-core-python is not installed")
    browser.look(width)
    browser.open(request.getfixturevalue(which))
    browser.run("document.querySelectorAll('details').forEach(part => part.open = true)")
    browser.run((Path(package.__file__).parent / "axe.min.js").read_text(encoding="utf-8"))
    found = "axe.run().then(r => r.violations.map(v => [v.id, v.nodes.map(n => n.html)]))"
    assert browser.run(found) == []
    assert browser.run("document.documentElement.scrollWidth") <= width


def test_paper_is_light(browser: Browser, page: str, tmp_path: Path) -> None:
    browser.look(1280, dark=True, print_it=True)
    browser.open(page)
    assert browser.run("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    browser.paper(tmp_path / "page.pdf")
    assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")


def test_a_compared_model_can_be_chosen(browser: Browser, page: str) -> None:
    browser.look()
    browser.open(page)
    browser.run("const m = document.querySelector('[name=model]'); m.value = '2';"
                "m.dispatchEvent(new Event('change', {bubbles: true}))")  # fmt: skip
    told = browser.run("document.querySelector('.models.pick .view').innerText")
    assert "Where Bekker is worst" in told
    assert browser.complaints == []


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory, repository: Path) -> str:
    """A replayed drive's page."""
    folder = tmp_path_factory.mktemp("drive")
    config = str(repository / "config" / "four_wheels.yaml")
    for command in (
        ["simulate", "drive", "--distance", "12", "-o", str(folder / "bag")],
        ["replay", str(folder / "bag"), "--config", config, "-o", str(folder / "out")],
    ):
        done = CliRunner().invoke(cli.main, command)
        assert done.exit_code == 0, done.output
    return (folder / "out" / "report.html").as_uri()


def test_a_drive_has_its_path_wheels_and_soil(browser: Browser, drive: str) -> None:
    browser.look()
    browser.events.clear()
    browser.open(drive)
    titles = browser.run("[...document.querySelectorAll('.plot .title')].map(e => e.textContent)")
    assert "the path, coloured by sinkage [mm]" in titles
    assert any(title.endswith(": drawbar pull") for title in titles)
    assert "reference pressure" in titles
    assert browser.run(CONTRAST) == []
    assert browser.run(NAMES) == []
    assert [url for url in browser.requests if not url.startswith("file:")] == []
    assert browser.complaints == []
