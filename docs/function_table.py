# SPDX-License-Identifier: Apache-2.0
"""Writes the table of functions in docs/python.md from their signatures and docstrings.

`python docs/function_table.py` writes it anew.
"""

from __future__ import annotations

import inspect
from pathlib import Path

import smallwheel_ros
from smallwheel_ros.commands.command import described

PAGE = Path(__file__).with_name("python.md")
BEGIN, END = "<!-- made by python docs/function_table.py -->\n\n", "\n<!-- end -->\n"
FUNCTIONS = ("read", "fit", "compare", "diagnose", "learn", "add", "predict", "replay")


def table() -> str:
    """Call, result and first sentence of each function."""
    lines = ["| function | gives | what it does |", "| --- | --- | --- |"]
    for name in FUNCTIONS:
        assert name in smallwheel_ros.__all__
        function = getattr(smallwheel_ros, name)
        signature = inspect.signature(function)
        named = [p.name for p in signature.parameters.values() if p.kind == p.KEYWORD_ONLY]
        taken = []
        for parameter in signature.parameters.values():
            if parameter.kind == parameter.VAR_KEYWORD:
                taken.append("...")
            elif parameter.name != "progress":
                by_name = parameter.default is not parameter.empty or parameter.name in named
                taken.append(parameter.name + ("=" if by_name else ""))
        gives = " or ".join(f"`{kind}`" for kind in signature.return_annotation.split(" | "))
        does = described(function)[0].partition("\n")[0]
        lines.append(f"| `sw.{name}({', '.join(taken)})` | {gives} | {does} |")
    return "\n".join(lines) + "\n"


def with_table(page: str) -> str:
    """Give the page with the table between its two marks."""
    before, _, rest = page.partition(BEGIN)
    return before + BEGIN + table() + END + rest.partition(END)[2]


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
