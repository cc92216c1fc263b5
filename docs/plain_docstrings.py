# SPDX-License-Identifier: Apache-2.0
"""Docstrings here are plain text for people, with NumPy's sections: this makes reStructuredText of them.

Otherwise an absolute value `|slip|` is a substitution, and lines of formulas run into one another.
"""

from __future__ import annotations

import re
from itertools import groupby
from typing import Any

SPECIAL = re.compile(r"[*|]|(?<=\w)_(?!\w)")
CODE = re.compile(r"(`[^`]*`)")
SECTION = re.compile(r"\s*-{3,}\s*$")
COLUMNS = re.compile(r"\S {3,}\S")


def _escaped(line: str) -> str:
    """Escape what has a meaning in reStructuredText, outside of code."""
    parts = CODE.split(line)
    parts[::2] = [SPECIAL.sub(r"\\\g<0>", part) for part in parts[::2]]
    return "".join(parts)


def _is_layout(paragraph: list[str]) -> bool:
    """Tell whether indentation or columns of a paragraph mean something: formulas and tables."""
    return any(line.startswith(" ") or COLUMNS.search(line) for line in paragraph)


def as_restructured_text(lines: list[str]) -> list[str]:
    """Prose with its special characters escaped; formulas and tables as they stand."""
    found: list[str] = []
    in_section = False
    for blank, group in groupby(lines, key=lambda line: not line.strip()):
        paragraph = list(group)
        in_section = in_section or (len(paragraph) > 1 and bool(SECTION.match(paragraph[1])))
        if blank:
            found.append("")
        elif in_section or not _is_layout(paragraph):
            found += map(_escaped, paragraph)
        else:
            found += ["::", "", *("    " + line for line in paragraph), ""]
    return found


def process(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Handle Sphinx's event autodoc-process-docstring."""
    lines[:] = as_restructured_text(lines)
