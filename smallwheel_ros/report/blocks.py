# SPDX-License-Identifier: Apache-2.0
"""Blocks of which a result is told: on a page as HTML, on the terminal as lines of text.

Whatever text a block is given is escaped in HTML. On the terminal drawings are left out, and of
details only the summary is said.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any, Literal

from smallwheel_ros.common.tables import each, text_table
from smallwheel_ros.report.wording import in_words, inline

_MOST_ROWS = 20  # of a table in a notebook
_DIGITS = 4  # of a number that is drawn


@dataclass(frozen=True)
class Text:
    """A paragraph, or a list where there are items."""

    text: str = ""
    items: Sequence[str] = ()

    def html(self) -> str:
        """The block as HTML."""
        paragraph = f"<p>{inline(self.text)}</p>" if self.text else ""
        items = "".join(f"<li>{inline(item)}</li>" for item in self.items)
        return paragraph + (f"<ul>{items}</ul>" if items else "")

    def lines(self) -> list[str]:
        """The block as text."""
        inset = "  " if self.text else ""
        return [*([self.text] if self.text else []), *(f"{inset}{item}" for item in self.items)]


@dataclass(frozen=True)
class Callout:
    """What must not be missed: a headline and some sentences."""

    headline: str
    items: Sequence[str] = ()
    kind: Literal["result", "warning"] = "result"

    def html(self) -> str:
        """The block as HTML."""
        body = "".join(f"<p>{inline(item)}</p>" for item in self.items)
        head = f'<p class="headline">{inline(self.headline)}</p>'
        return f'<div class="callout {self.kind}">{head}{body}</div>'

    def lines(self) -> list[str]:
        """The block as text."""
        headline = self.headline.removesuffix(".") + "."
        return [headline, *(f"  {item}" for item in self.items)]


@dataclass(frozen=True)
class Table:
    """Rows of texts under a header.

    Columns in `numbers` are set right, rows in `strong` stressed, shares (0 to 1) in the column
    `bars` drawn as bars too (`over 0.99` as its number).
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
        caption = f"<caption><span>{inline(self.caption)}</span></caption>" if self.caption else ""
        label = escape(in_words(self.caption) or next(iter(self.header), "table"), quote=True)
        return (
            f'<div class="scroll" tabindex="0" role="group" aria-label="{label}"><table>{caption}'
            f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
        )

    def _cell(self, tag: str, column: int, text: str) -> str:
        kind = ' class="number"' if column in self.numbers else ""
        tag = tag if text else "td"  # a header cell without a word is none
        kind += ' scope="col"' if tag == "th" else ""
        shown = inline(text)
        if tag == "td" and column == self.bars and text not in ("-", ""):
            shown = (
                f'<b class="bar" style="--part:{100.0 * float(text.split()[-1]):.0f}%">{shown}</b>'
            )
        return f"<{tag}{kind}>{shown}</{tag}>"

    def lines(self) -> list[str]:
        """The block as text, without columns in which nothing stands."""
        filled = [i for i in range(len(self.header)) if any(row[i] for row in self.rows)]
        header = [self.header[i] for i in filled]
        right = [at for at, i in enumerate(filled) if i in self.numbers]
        table = text_table(header, [[row[i] for i in filled] for row in self.rows], right)
        inset = "  " if self.caption else ""
        caption = [self.caption] if self.caption else []
        return [*caption, *(f"{inset}{line}" for line in table.splitlines())]


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
        caption = f"<figcaption>{inline(self.caption)}</figcaption>" if self.caption else ""
        tag = "div" if self.kind in ("effects", "drive") else "figure"
        return f'<{tag} data-{self.kind}="{self.key}">{self.inside}{caption}</{tag}>'

    def lines(self) -> list[str]:
        """Nothing: it is for the page."""
        return []


@dataclass(frozen=True)
class Details:
    """Blocks that open on a click: what few readers need."""

    summary: str
    blocks: Sequence[Block]

    def html(self) -> str:
        """The block as HTML."""
        body = "".join(block.html() for block in self.blocks)
        return f"<details><summary>{inline(self.summary)}</summary>{body}</details>"

    def lines(self) -> list[str]:
        """The block as text."""
        return [f"{self.summary}."]


Block = Text | Callout | Table | Drawing | Details


@dataclass(frozen=True)
class Section:
    """A heading and what stands under it."""

    title: str
    blocks: Sequence[Block] = field(default=())

    def lines(self) -> list[str]:
        """The section as text; none where there is nothing to say."""
        found = [block.lines() for block in self.blocks]
        return [line.replace("\u00a0", " ") for lines in found for line in lines]


def rows_html(rows: Sequence[Mapping[str, Any]]) -> str:
    """The first rows of a result as a table of HTML, for a notebook."""
    if not rows:
        return ""
    cells = [
        [f"{value:.4g}" if isinstance(value, float) else str("" if value is None else value)
         for value in row.values()]
        for row in rows[:_MOST_ROWS]
    ]  # fmt: skip
    more = len(rows) - _MOST_ROWS
    rest = Text(f"and {more} more rows").html() if more > 0 else ""
    return Table(list(rows[0]), cells).html() + rest


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
