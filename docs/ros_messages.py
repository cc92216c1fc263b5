"""The directive `message NAME`: a message of this package as tables, from its definition in msg/."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from sphinx.util.docutils import SphinxDirective

FOLDER = Path(__file__).parent.parent / "msg"
FIELD = re.compile(r"(\S+)\s+(\w+(?:\s*=\s*\S+)?)\s*(?:#\s*(.*))?$")
UNIT = re.compile(r"\[([^]]+)\]\s*")


def _row(kind: str, name: str, remark: str) -> str:
    unit = UNIT.search(remark)
    cells = (f"`{name}`", kind, unit[1] if unit else "", UNIT.sub("", remark, count=1))
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def as_markdown(definition: str) -> list[str]:
    """Comments as text, lines of `----` as headings in bold, each block of fields as a table."""
    found: list[str] = []
    in_table = False
    for line in definition.splitlines():
        field = FIELD.match(line)
        if field and not line.startswith("#"):
            if not in_table:
                found += ["", "| field | type | unit | |", "| --- | --- | --- | --- |"]
            found.append(_row(field[1], field[2], field[3] or ""))
            in_table = True
            continue
        text = line.lstrip("#").strip()
        if in_table or not text:
            found.append("")
        in_table = False
        found.append(f"**{text.strip('- ')}**\n" if text.startswith("----") else text)
    return "\n".join(found).splitlines()


class Message(SphinxDirective):
    """Show one message."""

    required_arguments = 1

    def run(self) -> list[Any]:
        """Give the nodes of its text and tables."""
        file = FOLDER / f"{self.arguments[0]}.msg"
        self.env.note_dependency(str(file))
        lines = as_markdown(file.read_text(encoding="utf-8"))
        return self.parse_text_to_nodes("\n".join(lines))


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("message", Message)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
