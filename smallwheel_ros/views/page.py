# SPDX-License-Identifier: Apache-2.0
"""A page of blocks: text on the terminal, one self-contained HTML file, and its figures as pictures."""

from __future__ import annotations

import base64
import hashlib
import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smallwheel_ros.common.files import write_bytes
from smallwheel_ros.common.release import __version__
from smallwheel_ros.common.tables import each
from smallwheel_ros.measurements.display import probability_text
from smallwheel_ros.views.blocks import Figure, Models, Section, walked
from smallwheel_ros.views.plots import write_picture
from smallwheel_ros.views.svg import svg

if TYPE_CHECKING:
    from jinja2 import Template

_CODE = re.compile(r"`([^`]+)`")
_POWER = re.compile(r"(?<![\w.])(-?\d+(?:\.\d+)?)e([+-]\d+)(?!\w)")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_DIGITS = 3  # of a number in the page's data
_DRAWN = re.compile(r"<svg.*?</svg>", re.DOTALL)
_ID = re.compile(r'(id="|url\(#|href="#)(\w+)')
_STYLE = re.compile(r'style="([^"]*)"')


@dataclass(frozen=True)
class Page:
    """Sections under a title; those without content are left out when it is shown.

    Attributes
    ----------
    title, subtitle, footer
        Lines of text; subtitle and footer may be empty.
    sections
        The sections; the first one is the answer.
    """

    title: str
    sections: Sequence[Section]
    subtitle: str = ""
    footer: str = ""

    def text(self) -> str:
        """The page as a command prints it: each section under its title, the first without one."""
        (_, answer), *others = [(s.title, lines) for s in self.sections if (lines := s.lines())]
        parts = [[self.subtitle, *answer] if self.subtitle else answer]
        parts += [[title, *(f"  {line}" for line in lines)] for title, lines in others]
        return "\n\n".join("\n".join(lines) for lines in parts)

    def figures(self) -> list[Figure]:
        """All figures of the page, including those inside other blocks."""
        return [block for block in walked(b for s in self.sections for b in s.blocks)
                if isinstance(block, Figure)]  # fmt: skip

    def write(self, path: Path) -> None:
        """Write the page as an HTML file, whole or not at all. Raises OutputError."""
        write_bytes(path, html_of(self).encode("utf-8", "replace"))

    def write_pictures(self, folder: Path) -> list[Path]:
        """Write each figure as NAME.png into a folder; return their paths. Raises OutputError."""
        folder.mkdir(parents=True, exist_ok=True)
        return [write_picture(f.panels, folder / f"{f.name}.png") for f in self.figures()]


def html_of(page: Page) -> str:
    """The page as HTML."""
    shown = [section for section in page.sections if section.blocks]
    models = [b for b in walked(b for s in shown for b in s.blocks) if isinstance(b, Models)]
    script = _web("page.js") if models else ""
    data = embedded([{k: v for k, v in block.leaves.items() if k != "frames"} for block in models])
    html = _template().render(
        page=page, sections=shown, css=_web("page.css"), script=script, data=data, models=models,
        policy=_policy(script), version=__version__,
    )  # fmt: skip
    return _with_classes(html) + "\n"


def _with_classes(html: str) -> str:
    """Shorten the HTML: each style of the plots becomes a class, and ids become short and unique."""
    styles: dict[str, str] = {}
    ids: dict[tuple[int, str], str] = {}

    def shorter(drawn: re.Match[str]) -> str:
        text = _STYLE.sub(
            lambda s: f'class="{styles.setdefault(s[1], f"v{len(styles)}")}"', drawn[0]
        )
        return _ID.sub(lambda i: i[1] + ids.setdefault((drawn.start(), i[2]), f"i{len(ids)}"), text)

    body = _DRAWN.sub(shorter, html)
    rules = "".join(f".{name} {{ {style} }}\n" for style, name in styles.items())
    return body.replace("</style>", f"{rules}</style>", 1)


def inline(text: str) -> str:
    """The text as HTML: escaped, `commands` as code, 1.6e+07 as 1.6·10⁷."""
    parts = _CODE.split(text)
    return "".join(f"<code>{escape(part)}</code>" if i % 2 else escape(_powers(part))
                   for i, part in enumerate(parts))  # fmt: skip


def _powers(text: str) -> str:
    shown = _POWER.sub(lambda n: f"{n[1]}·10{str(int(n[2])).translate(_RAISED)}", text)
    return shown.replace(" -> ", " → ")


def embedded(data: Any) -> str:
    """JSON safe to embed in HTML: none of its characters can begin or end a tag."""
    text = json.dumps(
        each(data, _short), allow_nan=False, ensure_ascii=False, separators=(",", ":")
    )
    for letter in "<>&\u2028\u2029":
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return text


def _short(value: Any) -> Any:
    """A number with few digits; null where it is not finite."""
    if value is None or isinstance(value, (bool, int, str)):
        return value
    return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None


@lru_cache
def _web(name: str) -> str:
    return (files("smallwheel_ros.views") / "web" / name).read_text(encoding="utf-8")


@lru_cache(maxsize=1)
def _template() -> Template:
    from jinja2 import Environment, pass_context
    from markupsafe import Markup

    made = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    made.filters["inline"] = lambda text: Markup(inline(str(text)))
    made.filters["svg"] = lambda panel: Markup(svg(panel))
    made.filters["chance"] = probability_text
    made.filters["number"] = pass_context(
        lambda context, block: next(i for i, b in enumerate(context["models"]) if b is block)
    )
    return made.from_string(_web("page.html"))


def _policy(script: str) -> str:
    """Content security policy: nothing may be fetched, and nothing run but this script."""
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    return (f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; "
            "img-src data:; base-uri 'none'; form-action 'none'")  # fmt: skip
