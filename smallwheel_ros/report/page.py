# SPDX-License-Identifier: Apache-2.0
"""A result told in sections of blocks: as one HTML file with its data, script and look, and as text."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

from smallwheel_ros.common.files import write_bytes
from smallwheel_ros.common.version import __version__
from smallwheel_ros.report.blocks import Block, Details, Drawing, Section, drawn

_ALWAYS = ("uPlot.iife.min.js", "elements.js", "plots.js", "figures.js")
_SCRIPTS = {
    "xy": (),
    "models": ("residuals.js",),
    "effects": ("residuals.js", "effects.js"),
    "drive": ("drive.js",),
}


@dataclass(frozen=True)
class Page:
    """Sections under a title; those without blocks are left out.

    served: by a server of this machine, which the page may ask.
    """

    title: str
    sections: Sequence[Section]
    subtitle: str = ""
    footer: str = ""
    served: bool = False

    def text(self) -> str:
        """As a command prints it: each section under its title, the first, which is the answer, without."""
        found = [(section.title, section.lines()) for section in self.sections]
        (_, answer), *others = [(title, lines) for title, lines in found if lines]
        parts = [[self.subtitle, *answer] if self.subtitle else answer]
        parts += [[title, *(f"  {line}" for line in lines)] for title, lines in others]
        return "\n\n".join("\n".join(lines) for lines in parts)

    def html(self) -> str:
        """One HTML page with everything in it."""
        title, shown = self.title, [section for section in self.sections if section.blocks]
        links = " ".join(
            f'<a href="#s{i}">{escape(s.title)}</a>' for i, s in enumerate(shown, start=1)
        )
        body = "".join(
            f'<section id="s{i}"><h2>{escape(section.title)}</h2>'
            + "".join(block.html() for block in section.blocks)
            + "</section>"
            for i, section in enumerate(shown, start=1)
        )
        end = f"Made by smallwheel_ros {__version__}." + (f" {self.footer}" if self.footer else "")
        drawings = list(_drawings([block for section in shown for block in section.blocks]))
        script, data = _script(drawings), embedded({d.key: drawn(d.data) for d in drawings})
        web = _web()
        return (
            '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
            f'<meta http-equiv="Content-Security-Policy" content="{_policy(script, self.served)}">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            '<meta name="color-scheme" content="light dark">'
            f'<link rel="icon" href="data:,"><title>{escape(title)}</title>'
            f"<style>{web['uPlot.min.css']}{web['page.css']}</style></head>"
            f"<body><header><h1>{escape(title)}</h1><p>{escape(self.subtitle)}</p></header>"
            f'<nav aria-label="sections">{links}</nav>'
            "<noscript><p>The plots need JavaScript; tables and sentences do not.</p></noscript>"
            f"<main>{body}</main><footer>{escape(end)}</footer>"
            f'<script type="application/json" id="data">{data}</script>'
            f"<script>{script}</script></body></html>\n"
        )

    def save(self, path: str | Path) -> None:
        """Write the page, whole or not at all. Raises OutputError where it cannot be written."""
        # A name that is no proper text (a surrogate from a broken file name) becomes a question mark.
        write_bytes(path, self.html().encode("utf-8", "replace"))


def embedded(data: Mapping[str, Any]) -> str:
    """JSON that nothing can break out of: no letter of it begins or ends anything in HTML."""
    text = json.dumps(data, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    for letter in "<>&\u2028\u2029":
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return text


@lru_cache(maxsize=1)
def _web() -> dict[str, str]:
    folder = files("smallwheel_ros.report") / "web"
    names = (*_ALWAYS, "residuals.js", "effects.js", "drive.js", "uPlot.min.css", "page.css")
    return {name: (folder / name).read_text(encoding="utf-8") for name in names}


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
