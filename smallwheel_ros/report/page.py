"""Building blocks of a report. Whatever text they are given is escaped."""

from __future__ import annotations

import base64
import io
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Literal

from matplotlib import rc_context
from matplotlib.figure import Figure

from smallwheel_ros import __version__
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.output import write_bytes
from smallwheel_ros.report.style import CSS

# Nothing may be fetched and nothing run, even if a text should slip through unescaped.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


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
    """Rows of texts under a header; columns in `numbers` set right, rows in `strong` stressed."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    numbers: Sequence[int] = ()
    strong: Sequence[int] = ()

    def html(self) -> str:
        """The block as HTML."""
        head = "".join(self._cell("th", i, text) for i, text in enumerate(self.header))
        body = "".join(
            f"<tr{' class=strong' if r in self.strong else ''}>"
            + "".join(self._cell("td", i, text) for i, text in enumerate(row))
            + "</tr>"
            for r, row in enumerate(self.rows)
        )
        caption = f"<caption>{escape(self.caption)}</caption>" if self.caption else ""
        return (
            f'<div class="scroll"><table>{caption}<thead><tr>{head}</tr></thead>'
            f"<tbody>{body}</tbody></table></div>"
        )

    def _cell(self, tag: str, column: int, text: str) -> str:
        kind = ' class="number"' if column in self.numbers else ""
        return f"<{tag}{kind}>{escape(text)}</{tag}>"


@dataclass(frozen=True)
class Picture:
    """A figure, drawn into the page. description: what a reader who cannot see it should know."""

    figure: Figure
    caption: str
    description: str = ""

    def html(self) -> str:
        """The block as HTML."""
        alt = escape(self.description or self.caption, quote=True)
        caption = f"<figcaption>{escape(self.caption)}</figcaption>" if self.caption else ""
        width = int(96 * self.figure.get_size_inches()[0])
        image = f'<img width="{width}" alt="{alt}" src="{_data_uri(self.figure)}">'
        return f"<figure>{image}{caption}</figure>"


@dataclass(frozen=True)
class Details:
    """Blocks that open on a click: what few readers need."""

    summary: str
    blocks: Sequence[Block]

    def html(self) -> str:
        """The block as HTML."""
        body = "".join(block.html() for block in self.blocks)
        return f"<details><summary>{escape(self.summary)}</summary>{body}</details>"


Block = Text | Callout | Table | Picture | Details


@dataclass(frozen=True)
class Section:
    """A heading and what stands under it."""

    title: str
    blocks: Sequence[Block] = field(default=())


def _data_uri(figure: Figure) -> str:
    """The figure as an SVG inside an address, so that pictures share no names and need no file."""
    buffer = io.BytesIO()
    # A fixed salt and no date: the same data gives the same page.
    fixed = rc_context({"svg.hashsalt": "smallwheel_ros", "svg.fonttype": "path"})
    with fixed, warnings.catch_warnings():
        # A column's name may have letters that the font lacks: the picture shows boxes.
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None}, dpi=150)
    return "data:image/svg+xml;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def page(title: str, sections: Sequence[Section], subtitle: str = "", footer: str = "") -> str:
    """One HTML page with everything in it. Sections without blocks are left out."""
    shown = [section for section in sections if section.blocks]
    links = " ".join(f'<a href="#s{i}">{escape(s.title)}</a>' for i, s in enumerate(shown, start=1))
    body = "".join(
        f'<section id="s{i}"><h2>{escape(section.title)}</h2>'
        + "".join(block.html() for block in section.blocks)
        + "</section>"
        for i, section in enumerate(shown, start=1)
    )
    end = f"Made by smallwheel_ros {__version__}." + (f" {footer}" if footer else "")
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>{escape(title)}</title><style>{CSS}</style></head>'
        f"<body><header><h1>{escape(title)}</h1><p>{escape(subtitle)}</p></header>"
        f"<nav>{links}</nav><main>{body}</main><footer>{escape(end)}</footer></body></html>\n"
    )


def write_page(path: str | Path, html: str) -> None:
    """Write the page, whole or not at all. Raises OutputError where it cannot be written."""
    # A name that is no proper text (a surrogate from a broken file name) becomes a question mark.
    write_bytes(path, html.encode("utf-8", "replace"))
