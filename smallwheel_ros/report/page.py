# SPDX-License-Identifier: Apache-2.0
"""Building blocks of a page, and the page: one file with its data, its script and its look.

Whatever text a block is given is escaped; what the script shows of the data it sets as text.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from smallwheel_ros import __version__
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.files import write_bytes
from smallwheel_ros.common.tables import each

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DIGITS = 4  # of a number that is drawn


class ReportError(SmallwheelError):
    """A report that cannot be made."""


@dataclass(frozen=True)
class Text:
    """A paragraph, or a list where there are items."""

    text: str = ""
    items: Sequence[str] = ()

    def html(self) -> str:
        """The block as HTML."""
        paragraph = f"<p>{escape(self.text)}</p>" if self.text else ""
        items = "".join(f"<li>{escape(item)}</li>" for item in self.items)
        return paragraph + (f"<ul>{items}</ul>" if items else "")


@dataclass(frozen=True)
class Callout:
    """What must not be missed: a headline and some sentences."""

    headline: str
    items: Sequence[str] = ()
    kind: Literal["result", "warning"] = "result"

    def html(self) -> str:
        """The block as HTML."""
        body = "".join(f"<p>{escape(item)}</p>" for item in self.items)
        head = f'<p class="headline">{escape(self.headline)}</p>'
        return f'<div class="callout {self.kind}">{head}{body}</div>'


@dataclass(frozen=True)
class Table:
    """Rows of texts under a header.

    Columns in `numbers` are set right, rows in `strong` stressed, shares (0 to 1) in the column
    `bars` drawn as bars too.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    numbers: Sequence[int] = ()
    strong: Sequence[int] = ()
    bars: int | None = None

    def html(self) -> str:
        """The block as HTML."""
        head = "".join(self._cell("th", i, text) for i, text in enumerate(self.header))
        body = "".join(
            f"<tr{' class=strong' if r in self.strong else ''}>"
            + "".join(self._cell("td", i, text) for i, text in enumerate(row))
            + "</tr>"
            for r, row in enumerate(self.rows)
        )
        caption = f"<caption><span>{escape(self.caption)}</span></caption>" if self.caption else ""
        label = escape(self.caption or next(iter(self.header), "table"), quote=True)
        return (
            f'<div class="scroll" tabindex="0" role="region" aria-label="{label}"><table>{caption}'
            f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
        )

    def _cell(self, tag: str, column: int, text: str) -> str:
        kind = ' class="number"' if column in self.numbers else ""
        kind += ' scope="col"' if tag == "th" else ""
        shown = escape(text)
        if tag == "td" and column == self.bars and text != "-":
            shown = f'<b class="bar" style="--part:{100.0 * float(text):.0f}%">{shown}</b>'
        return f"<{tag}{kind}>{shown}</{tag}>"


@dataclass(frozen=True)
class Drawing:
    """What the page's script draws.

    kind: which part of the script. data: what it draws, plain values; a number that is not finite is
    a gap. inside: HTML that stands there beforehand, safe as it is.
    """

    kind: Literal["xy", "models", "effects", "drive"]
    data: Mapping[str, Any]
    caption: str = ""
    inside: str = ""

    @property
    def key(self) -> str:
        """Name of the data in the page: the same data has the same."""
        text = self.kind + json.dumps(drawn(self.data), sort_keys=True)
        return self.kind + hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()[:12]

    def html(self) -> str:
        """The block as HTML."""
        caption = f"<figcaption>{escape(self.caption)}</figcaption>" if self.caption else ""
        tag = "div" if self.kind in ("effects", "drive") else "figure"
        return f'<{tag} data-{self.kind}="{self.key}">{self.inside}{caption}</{tag}>'


@dataclass(frozen=True)
class Picture:
    """A figure that does not move. description: what a reader who cannot see it should know."""

    figure: Figure
    caption: str
    description: str = ""

    def html(self) -> str:
        """The block as HTML: an SVG inside an address, so that pictures share no names."""
        from matplotlib import rc_context

        buffer = io.BytesIO()
        # A fixed salt and no date: the same data gives the same page.
        with rc_context({"svg.hashsalt": "smallwheel_ros"}), warnings.catch_warnings():
            # A column's name may have letters that the font lacks: the picture shows boxes.
            warnings.filterwarnings("ignore", message="Glyph .* missing")
            self.figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
        image = base64.b64encode(buffer.getvalue()).decode("ascii")
        alt = escape(self.description or self.caption, quote=True)
        return (
            f'<figure><img alt="{alt}" src="data:image/svg+xml;base64,{image}">'
            f"<figcaption>{escape(self.caption)}</figcaption></figure>"
        )


@dataclass(frozen=True)
class Details:
    """Blocks that open on a click: what few readers need."""

    summary: str
    blocks: Sequence[Block]

    def html(self) -> str:
        """The block as HTML."""
        body = "".join(block.html() for block in self.blocks)
        return f"<details><summary>{escape(self.summary)}</summary>{body}</details>"


Block = Text | Callout | Table | Drawing | Picture | Details


@dataclass(frozen=True)
class Section:
    """A heading and what stands under it."""

    title: str
    blocks: Sequence[Block] = field(default=())


def drawn(value: Any) -> Any:
    """Plain values with few digits; what is not finite becomes null."""
    return each(value, _short)


def _short(value: Any) -> Any:
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if not math.isfinite(value):
        return None
    short = float(f"{value:.{_DIGITS}g}")
    return int(short) if short.is_integer() and abs(short) < 1e15 else short


def embedded(data: Mapping[str, Any]) -> str:
    """JSON that nothing can break out of: no letter of it begins or ends anything in HTML."""
    text = json.dumps(data, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    for letter in "<>&\u2028\u2029":
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return text


_ALWAYS = ("uPlot.iife.min.js", "elements.js", "plots.js", "figures.js")


@lru_cache(maxsize=1)
def _web() -> dict[str, str]:
    folder = files("smallwheel_ros.report") / "web"
    names = (*_ALWAYS, "residuals.js", "effects.js", "drive.js", "uPlot.min.css", "page.css")
    return {name: (folder / name).read_text(encoding="utf-8") for name in names}


_SCRIPTS = {
    "xy": (),
    "models": ("residuals.js",),
    "effects": ("residuals.js", "effects.js"),
    "drive": ("drive.js",),
}


def page(
    title: str,
    sections: Sequence[Section],
    subtitle: str = "",
    footer: str = "",
    *,
    served: bool = False,
) -> str:
    """One HTML page with everything in it. Sections without blocks are left out.

    served: by a server of this machine, which the page may ask.
    """
    shown = [section for section in sections if section.blocks]
    links = " ".join(f'<a href="#s{i}">{escape(s.title)}</a>' for i, s in enumerate(shown, start=1))
    body = "".join(
        f'<section id="s{i}"><h2>{escape(section.title)}</h2>'
        + "".join(block.html() for block in section.blocks)
        + "</section>"
        for i, section in enumerate(shown, start=1)
    )
    end = f"Made by smallwheel_ros {__version__}." + (f" {footer}" if footer else "")
    drawings = list(_drawings([block for section in shown for block in section.blocks]))
    script, data = _script(drawings), embedded({d.key: drawn(d.data) for d in drawings})
    web = _web()
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{_policy(script, served)}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f'<link rel="icon" href="data:,"><title>{escape(title)}</title>'
        f"<style>{web['uPlot.min.css']}{web['page.css']}</style></head>"
        f"<body><header><h1>{escape(title)}</h1><p>{escape(subtitle)}</p></header>"
        f'<nav aria-label="sections">{links}</nav>'
        "<noscript><p>The plots need JavaScript; tables and sentences do not.</p></noscript>"
        f"<main>{body}</main><footer>{escape(end)}</footer>"
        f'<script type="application/json" id="data">{data}</script>'
        f"<script>{script}</script></body></html>\n"
    )


def _drawings(blocks: Sequence[Block]) -> Iterator[Drawing]:
    for block in blocks:
        if isinstance(block, Drawing):
            yield block
        elif isinstance(block, Details):
            yield from _drawings(block.blocks)


def _script(drawings: Sequence[Drawing]) -> str:
    """As much of the script as the page needs; uPlot comes first, with its licence's line."""
    wanted = {name for d in drawings for name in _SCRIPTS[d.kind]}
    web = _web()
    names = [*_ALWAYS, *(n for n in web if n in wanted)]
    return "\n".join(web[name] for name in names)


def _policy(script: str, served: bool) -> str:
    """Nothing may be fetched and nothing run but this very script, whatever the data is called."""
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    own = "connect-src 'self'; form-action 'self'" if served else "form-action 'none'"
    return (
        f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; "
        f"img-src data:; base-uri 'none'; {own}"
    )


def write_page(path: str | Path, html: str) -> None:
    """Write the page, whole or not at all. Raises OutputError where it cannot be written."""
    # A name that is no proper text (a surrogate from a broken file name) becomes a question mark.
    write_bytes(path, html.encode("utf-8", "replace"))
