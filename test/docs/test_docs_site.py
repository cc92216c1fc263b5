# SPDX-License-Identifier: Apache-2.0
"""The pages of docs/ hang together, and what they draw and list is what the code has."""

from __future__ import annotations

import html
import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from chromium import CHROMIUM, Browser

from smallwheel_ros.common.node_parameter import WHEEL
from smallwheel_ros.effects.registry import families
from smallwheel_ros.onboard.declared import GENERAL, PER_WHEEL

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
IMAGES = DOCS / "images"
DRAWINGS = sorted((IMAGES / "theory").glob("*.svg"))


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def headings(page: Path) -> set[str]:
    """The headings of a page as links name them."""
    lines = re.findall(r"^#+ (.*)$", text_of(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", line.lower()).replace(" ", "-") for line in lines}


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md"], ids=lambda p: p.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)", text_of(page)):
        if "://" in target:
            continue
        file, _, heading = target.partition("#")
        there = page.parent / file if file else page
        assert there.exists(), target
        if heading and there.suffix == ".md":
            assert heading in headings(there), target


def test_every_page_is_in_the_table_of_contents() -> None:
    index = text_of(DOCS / "index.md")
    lines = "\n".join(re.findall(r"```\{toctree\}\n(.*?)```", index, re.DOTALL)).splitlines()
    entries = [line for line in lines if line and not line.startswith(":")]
    listed = [re.sub(r".*<(\w+)>", r"\1", entry) for entry in entries]
    assert {page.stem for page in PAGES} - {"index"} <= set(listed)
    assert len(listed) == len(set(listed))


def test_every_term_that_is_used_is_in_the_glossary() -> None:
    blocks = re.findall(r"```\{glossary\}\n(.*?)```", text_of(DOCS / "glossary.md"), re.DOTALL)
    lines = "\n".join(blocks).splitlines()
    terms = {line.lower() for line in lines if line and not line.startswith(" ")}
    for page in PAGES:
        for term in re.findall(r"\{term\}`([^`]+)`", text_of(page)):
            assert term.lower() in terms, f"{page.name}: {term}"


@pytest.mark.slow  # a quarter of a minute, for pictures that seldom change
def test_drawings_are_those_of_their_script(tmp_path: Path) -> None:
    made = subprocess.run(
        [sys.executable, DOCS / "drawings" / "draw.py", "-o", tmp_path],
        env={"PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert made.returncode == 0, made.stderr
    made_anew = {path.relative_to(tmp_path) for path in tmp_path.rglob("*.svg")}
    assert made_anew == {path.relative_to(IMAGES) for path in IMAGES.rglob("*.svg")}
    for name in made_anew:
        again = (tmp_path / name).read_bytes()
        assert again == (IMAGES / name).read_bytes(), f"{name}: run docs/drawings/draw.py"


def test_each_picture_is_shown_somewhere_and_made_by_a_command() -> None:
    shown = "".join(text_of(page) for page in (*PAGES, ROOT / "README.md"))
    pictures = [p.relative_to(IMAGES) for p in IMAGES.rglob("*") if p.is_file()]
    assert [str(p) for p in pictures if f"images/{p})" not in shown] == []
    made = {p for p in pictures if p.suffix != ".svg"}
    script = text_of(DOCS / "drawings" / "pictures.py")
    assert [str(p) for p in made if f'"{p}"' not in script] == []


@pytest.mark.parametrize("drawing", DRAWINGS, ids=lambda p: p.stem)
def test_each_drawing_is_shown_and_its_text_is_text(drawing: Path) -> None:
    assert any(f"images/theory/{drawing.name})" in text_of(page) for page in PAGES)
    assert "<text" in text_of(drawing)
    assert "#ffffff" not in text_of(drawing)  # no ground of its own: it must do on a dark page


def test_the_drawing_of_effects_names_effects_that_there_are() -> None:
    """It shows where the effects of the library act; one that is added later need not be in it."""
    text = text_of(DOCS / "images" / "theory" / "effects.svg")
    named = set(re.findall(r"\b[a-z]+(?:_[a-z]+)+\b", re.sub(r"<[^>]*>", " ", text)))
    assert len(named) > 10
    assert named <= set(families())


def test_a_docstring_of_plain_text_is_shown_as_it_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    core = pytest.importorskip("docutils.core")
    monkeypatch.syspath_prepend(str(DOCS))
    from plain_docstrings import as_restructured_text

    text = [
        "Sinkage grows with |slip| and b* of every_ `row_*`; see *this.",
        "",
        "H0 = b l c          (eq. 1)",
        "  with its second line indented",
        "",
        "Raises",
        "------",
        "Error",
        "    Where |x| > 1.",
    ]
    lines = as_restructured_text(text)
    assert lines[-4:] == ["Raises", "------", "Error", "    Where \\|x\\| > 1."]
    settings = {"halt_level": 2, "report_level": 2}  # a warning is raised
    page = core.publish_doctree("\n".join(lines[:-4]), settings_overrides=settings)
    assert "|slip| and b* of every_ row_*; see *this." in page.astext()
    (formula,) = page.findall(lambda node: node.tagname == "literal_block")
    assert formula.astext() == "\n".join(text[2:4])


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site; a warning of Sphinx is an error."""
    for package in ("sphinx", "myst_parser", "furo"):
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed: it is in tools/docs.lock")
    folder = tmp_path_factory.mktemp("docs") / "site"
    built = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", DOCS, folder],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert built.returncode == 0, built.stderr
    return folder


@pytest.mark.slow
def test_the_library_has_its_functions(site: Path) -> None:
    thrust = text_of(site / "_api" / "physics.html")
    assert 'id="smallwheel_ros.physics.traction.thrust"' in thrust
    assert re.search(r"shear_displacement</strong>.*?kappa, m\.", thrust, re.DOTALL)
    assert 'href="_api/physics.html"' in text_of(site / "api.html")


@pytest.mark.slow
def test_messages_have_every_field(site: Path) -> None:
    shown = re.findall(r'<span class="pre">(\w+)</span>', text_of(site / "messages.html"))
    for file in (ROOT / "msg").glob("*.msg"):
        assert set(re.findall(r"^[\w/\[\]]+ (\w+)", text_of(file), re.MULTILINE)) <= set(shown)


@pytest.mark.slow
def test_effects_have_every_form(site: Path) -> None:
    page = text_of(site / "effects.html")
    shown = html.unescape(re.sub(r"<[^>]+>", "", page)).replace("’", "'")  # as Sphinx sets it
    for forms in families().values():
        for form in forms:
            assert form.formula in shown
            assert form.source in shown
            for known in form.parameters():
                if known.published:
                    assert f"({known.published[0]:g} to {known.published[1]:g})" in shown


@pytest.mark.slow
def test_parameters_are_all_listed(site: Path) -> None:
    shown = re.sub(r"<[^>]+>", "", text_of(site / "parameters.html"))
    for parameter in (*GENERAL, *PER_WHEEL):
        assert parameter.name.removeprefix(f"{WHEEL}.") in shown


@pytest.mark.slow
def test_formulas_need_no_script(site: Path) -> None:
    assert text_of(site / "theory.html").count('<div class="math"><math') >= 10


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no chromium found: apt-get install chromium")
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [400, 1400])
def test_pages_can_be_read_in_a_browser(
    site: Path, width: int, scheme: str, tmp_path: Path
) -> None:
    browser = Browser(tmp_path / "profile")
    screen: dict[str, Any] = {"width": width, "height": 900, "mobile": width < 600}
    browser.call("Emulation.setDeviceMetricsOverride", deviceScaleFactor=1, **screen)
    preference = {"name": "prefers-color-scheme", "value": scheme}
    browser.call("Emulation.setEmulatedMedia", media="screen", features=[preference])
    for page in ("index", "theory", "tutorial_bench", "messages", "_api/physics"):
        browser.call("Page.navigate", url=(site / f"{page}.html").as_uri())
        browser.wait("document.readyState == 'complete' && !!document.querySelector('article h1')")
        assert browser.run("document.documentElement.scrollWidth") <= width, page
        assert browser.run(LOWEST_CONTRAST) >= 4.5, page
        assert not browser.run("[...document.images].filter(i => !i.naturalWidth).length"), page
    asked = [e["params"]["request"]["url"] for e in browser.events
             if e.get("method") == "Network.requestWillBeSent"]  # fmt: skip
    assert asked
    assert all(url.startswith(("file:", "data:")) for url in asked)
    browser.close()


# Of the text of paragraphs, links, code and terms, against the ground of the page or of their own.
LOWEST_CONTRAST = """
(() => {
  const numbers = text => (text.match(/[0-9.]+/g) || []).map(Number);
  const light = c => c.slice(0, 3).map(v => v / 255)
    .map(v => v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
  const ground = element => {
    for (let e = element; e; e = e.parentElement) {
      const c = numbers(getComputedStyle(e).backgroundColor);
      if (c.length === 3 || c[3] === 1) return c;
    }
    return [255, 255, 255];
  };
  const texts = document.querySelectorAll('article p, article a, article code, article dt, article td');
  return Math.min(...[...texts].filter(e => e.innerText.trim()).map(e => {
    const both = [light(numbers(getComputedStyle(e).color)), light(ground(e))].sort();
    return (Math.max(...both) + 0.05) / (Math.min(...both) + 0.05);
  }));
})()
"""
