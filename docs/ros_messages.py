# SPDX-License-Identifier: Apache-2.0
"""The directive `message NAME`: a message of this package, from its definition in msg/."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from sphinx.util.docutils import SphinxDirective

FOLDER = Path(__file__).parent.parent / "msg"
FIELD = re.compile(r"(\S+)\s+(\w+(?:\s*=\s*\S+)?)\s*(?:#\s*(.*))?$")
UNIT = re.compile(r"\[([^]]+)\]\s*")


def _item(kind: str, name: str, remark: str) -> str:
    """One field as an item of a list: name, type, unit and comment."""
    unit = UNIT.match(remark)
    rest = UNIT.sub("", remark, count=1).strip()
    return f"- `{name}` {kind}{f', {unit[1]}' if unit else ''}{f': {rest}' if rest else ''}"


def _block(comment: list[str], fields: list[tuple[str, str, str]]) -> list[str]:
    """Fields that one comment is about; with a single one the comment is its text."""
    if len(fields) == 1:
        kind, name, remark = fields[0]
        return ["", _item(kind, name, " ".join([remark, *comment]).strip())]
    return ["", *comment, "", *(_item(*field) for field in fields)]


def as_markdown(definition: str) -> list[str]:
    """Headings, comments and fields of a definition, in its order."""
    found: list[str] = []
    comment: list[str] = []
    fields: list[tuple[str, str, str]] = []
    for line in [*definition.splitlines(), ""]:
        field = None if line.startswith("#") else FIELD.match(line)
        if field:
            fields.append((field[1], field[2], field[3] or ""))
            continue
        if fields:
            found += _block(comment, fields)
            comment, fields = [], []
        text = line.lstrip("#").strip()
        if text.startswith("----"):
            found += ["", f"**{text.strip('- ')}**"]
        elif text:
            comment.append(text)
        else:  # a paragraph that is about no field
            found += ["", *comment]
            comment = []
    return found


class Message(SphinxDirective):
    """Show one message."""

    required_arguments = 1

    def run(self) -> list[Any]:
        """Give the nodes of its text."""
        file = FOLDER / f"{self.arguments[0]}.msg"
        self.env.note_dependency(str(file))
        lines = as_markdown(file.read_text(encoding="utf-8"))
        return self.parse_text_to_nodes("\n".join(lines))


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("message", Message)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
