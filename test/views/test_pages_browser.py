# SPDX-License-Identifier: Apache-2.0
"""Pages in a real browser: they answer to mouse and keyboard, ask for nothing, and can be read."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import Browser, needs_chromium
from click.testing import CliRunner
from lab_truth import plate_rows, write
from smallwheel_ros.explore import ExploreServer, Session
from smallwheel_ros.explore.data import explored_page

from smallwheel_ros import cli
from smallwheel_ros.benchmark.benchmark import benchmark
from smallwheel_ros.compare.comparison import compare
from smallwheel_ros.diagnosis import Base
from smallwheel_ros.effects.registry import default_registry
from smallwheel_ros.measurements.display import shown_value
from smallwheel_ros.measurements.wheels import read_measurements
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table

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
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """A table with hidden slip sinkage and hostile names; slip in per cent, as its header says."""
    table = simulate_rig(RigSettings(seed=3, runs=16, hidden=("slip_sinkage",))).table
    table["soil"] = "sand" + EVIL
    table["run"] = table["run"].astype(str) + EVIL
    table["slip [%]"] = 100.0 * table.pop("slip")
    path = tmp_path_factory.mktemp("rig") / "rig<b>.csv"
    write_table(table, path)
    return Session.of(read_measurements(path), Base(), default_registry())


@pytest.fixture(scope="module")
def page(session: Session, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The whole report with a few of the effects and pairs in it, as a file's address."""
    path = tmp_path_factory.mktemp("page") / "report.html"
    session.beforehand = lambda pairs=True: [(), ("slip_sinkage",), ("multipass",),  # type: ignore[method-assign]
                                  ("multipass", "slip_sinkage")]  # fmt: skip
    comparison = compare(session.measurements)
    explored_page(session.diagnosis, session, comparison).save(path)
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
    return benchmark(folder.parent).save(folder / "laws.html").as_uri()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    made = Browser(tmp_path_factory.mktemp("profile"))
    yield made
    made.close()


def click(browser: Browser, name: str) -> Any:
    return browser.run(f"document.querySelector('input[value={name}]').click()")


def shown(browser: Browser) -> str:
    return str(browser.run("document.querySelector('.view').innerText"))


def test_a_click_shows_what_was_fitted_beforehand_and_asks_nobody(
    browser: Browser, page: str, session: Session
) -> None:
    browser.look()
    browser.open(page)
    browser.events.clear()
    assert "The base model: sinkage" in shown(browser)
    assert (
        browser.run("document.body.innerText.split('The model lacks slip').length") == 2
    )  # said once
    before, after = (step["held_out_rmse"] for step in session.document["steps"])
    # Drawn within the click itself: what is there right after it is what it shows.
    said = browser.run(
        "document.querySelector('input[value=slip_sinkage]').click();"
        "document.querySelector('.view').innerText"
    )
    for channel in before:
        assert (
            f"{shown_value(channel, before[channel])} → {shown_value(channel, after[channel])}"
            in said
        )
    assert "This is what the diagnosis names." in said
    assert "z = z0" in said  # the formula of the form that was fitted
    bars = browser.run("[...document.querySelectorAll('.stairs svg')].map(e => e.ariaLabel)")
    number = shown_value("sinkage", after["sinkage"]).split()[0]
    assert bars[0].startswith("base model ")
    assert f"+ slip sinkage {number}" in bars[0]
    assert browser.run("document.querySelector('[role=status]').textContent").startswith(
        "With slip"
    )
    click(browser, "multipass")
    assert "With multipass and slip sinkage" in shown(browser)
    assert browser.run("[...document.querySelectorAll('.means:not([hidden])')].length") == 2
    click(browser, "hardpan")
    assert "Not fitted beforehand" in shown(browser)
    assert "smallwheel explore" in shown(browser)
    assert browser.requests == []
    assert browser.complaints == []
    assert browser.run("document.title") != "1"
    assert browser.run("document.querySelectorAll('img').length") == 0


def test_everything_can_be_done_by_keyboard(browser: Browser, page: str) -> None:
    browser.look()
    browser.open(page)
    browser.run("document.querySelector('input[value=slip_sinkage]').focus()")
    browser.press("Space")
    assert "With slip sinkage" in shown(browser)
    browser.run("document.querySelector('.residuals [role=img]').focus()")
    browser.press("ArrowRight")
    told = browser.run("document.querySelector('[role=status]').textContent")
    assert re.match(r"run .*, line \d+, .*slip [\d.]+ %.*measured [\d.]+ mm, predicted", told)
    browser.press("Enter")  # as a click on the point
    told = browser.run("document.querySelector('.point').innerText")
    assert "is grey" in told
    assert "is not in this file: smallwheel explore" in told
    browser.press("Escape")
    assert browser.run("document.querySelector('.tip').hidden")


def test_residuals_follow_the_setting_in_the_unit_of_its_header(
    browser: Browser, page: str
) -> None:
    browser.look()
    browser.open(page)
    options = browser.run(
        "[...document.querySelector('.play select').options].map(o => o.textContent)"
    )
    assert "slip [%]" in options
    title = "document.querySelectorAll('.residuals .title')[1].textContent"
    assert browser.run(title) == "sinkage: what is left over slip"
    browser.run("const s = document.querySelector('.play select'); s.value = 'load';"
                "s.dispatchEvent(new Event('change', {bubbles: true}))")  # fmt: skip
    assert browser.run(title) == "sinkage: what is left over load"


def drawn(browser: Browser, colour: str) -> int:
    """How many pixels of the plots have a colour."""
    found: int = browser.run(f"""
      (() => {{
        const probe = document.body.appendChild(document.createElement('i'));
        probe.style.color = 'var({colour})';
        const [r, g, b] = getComputedStyle(probe).color.match(/\\d+/g).map(Number);
        probe.remove();
        let count = 0;
        for (const canvas of document.querySelectorAll('canvas')) {{
          const {{data}} = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
          for (let i = 0; i < data.length; i += 4) {{
            count += Math.abs(data[i] - r) + Math.abs(data[i + 1] - g) + Math.abs(data[i + 2] - b) < 12
              && data[i + 3] > 200;
          }}
        }}
        return count;
      }})()""")
    return found


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [400, 1400])
def test_the_page_can_be_read_at_any_width_and_in_the_dark(
    browser: Browser, page: str, width: int, dark: bool
) -> None:
    browser.look(width, dark)
    browser.open(page)
    click(browser, "slip_sinkage")
    browser.wait("document.querySelector('.residuals canvas').width > 0")
    assert browser.run("document.documentElement.scrollWidth") <= width
    assert browser.run(CONTRAST) == []
    assert browser.run(NAMES) == []
    wide = "Math.max(...[...document.querySelectorAll('.plot')].map(e => e.getBoundingClientRect().right))"
    assert browser.run(wide) <= width
    browser.wait("performance.now() > 300")  # uPlot draws after the script
    assert drawn(browser, "--with") > 300


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


def test_large_numbers_on_axes_are_written_as_people_do(browser: Browser, page: str) -> None:
    browser.open(page)
    values = "[0, 0.01, 2000, -250000, 1.1e6, 1e7, -1e6, 2.5e-5, 1e-5].map(tick)"
    assert browser.run(values) == [
        "0", "0.01", "2000", "-250000", "1.1·10⁶", "10⁷", "-1·10⁶", "2.5·10⁻⁵", "10⁻⁵",
    ]  # fmt: skip


def test_paper_is_light_and_no_plot_is_wider_than_it(
    browser: Browser, page: str, tmp_path: Path
) -> None:
    browser.look(1400, dark=True)
    browser.open(page)
    browser.run("addEventListener('beforeprint', () => setTimeout(() => { window.wide = "
                "Math.max(...[...document.querySelectorAll('canvas')].map(e => e.offsetWidth)) }));"
                "dispatchEvent(new Event('beforeprint'))")  # fmt: skip
    browser.wait("window.wide > 0")
    assert browser.run("window.wide") <= 660
    paper = "getComputedStyle(document.documentElement).getPropertyValue('--paper').trim()"
    assert browser.run(paper) == "#fff"
    browser.run("dispatchEvent(new Event('afterprint'))")
    assert browser.run(paper) != "#fff"
    browser.paper(tmp_path / "page.pdf")
    assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")


def test_a_compared_model_can_be_chosen(browser: Browser, page: str) -> None:
    browser.look()
    browser.open(page)
    legend = "document.querySelector('[data-models] .legend').innerText"
    browser.run("const m = document.querySelector('[name=model]'); m.value = '1';"
                "m.dispatchEvent(new Event('change', {bubbles: true}))")  # fmt: skip
    assert "Bekker" in browser.run(legend)
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


def test_the_map_and_the_lines_of_a_drive_show_the_same_time(browser: Browser, drive: str) -> None:
    browser.look()
    browser.events.clear()
    browser.open(drive)
    browser.run("document.querySelector('[data-part=map] [role=img]').focus()")
    browser.press("ArrowRight")
    browser.wait("document.querySelector('[data-part=wheels] .u-cursor-x').style.transform")
    told = browser.run("document.querySelector('[role=status]').textContent")
    assert re.match(r"-?[\d.]+ s, sinkage: [\d.]+ mm", told)
    browser.run("document.querySelector('[data-part=wheels] [role=img]').focus()")
    browser.press("ArrowRight")
    ring = "document.querySelector('[data-part=map] .mark')?.hidden === false"
    browser.wait(ring)
    browser.run("const c = document.querySelector('[name=colour]'); c.value = 'cost';"
                "c.dispatchEvent(new Event('change', {bubbles: true}))")  # fmt: skip
    assert "100" in browser.run("document.querySelector('.ramp').innerText")
    assert browser.run(CONTRAST) == []
    assert browser.run(NAMES) == []
    assert [url for url in browser.requests if not url.startswith("file:")] == []
    assert browser.complaints == []


def test_explore_fits_what_was_not_fitted_beforehand(browser: Browser, session: Session) -> None:
    with ExploreServer(session) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            browser.look()
            browser.events.clear()
            browser.open(server.url)
            click(browser, "sinkage_offset")
            browser.wait(
                "document.querySelector('.view').innerText.includes('With sinkage offset')"
            )
            assert browser.run("location.search") == "?effects=sinkage_offset&over=slip"
            browser.run("document.querySelector('.residuals [role=img]').focus()")
            browser.press("ArrowRight")
            browser.press("Enter")
            browser.wait("document.querySelector('.point').innerText.includes('other runs')")
            asked = [url for url in browser.requests if "/without?" in url]
            assert len(asked) == 1
            assert all(url.startswith(server.url) for url in browser.requests)
            assert browser.complaints == []
        finally:
            server.shutdown()
            thread.join()


def test_a_page_is_small(page: str, drive: str) -> None:
    """What is not data fits into 175 kB, so that 100 rows with all pairs stay under 600."""
    for address in (page, drive):
        html = Path(address.removeprefix("file://").replace("%3C", "<")).read_text()
        data = re.search(r'id="data">(.*?)</script>', html)
        assert data is not None
        json.loads(data[1])
        assert len(html) - len(data[1]) < 175e3
