# SPDX-License-Identifier: Apache-2.0
"""The directive `effect ID`: the forms of an effect, from its classes in smallwheel_ros/effects."""

from __future__ import annotations

from typing import Any

from sphinx.util.docutils import SphinxDirective

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.registry import families

HEADER = ["| form | formula | parameters (published range) | source |", "| --- | --- | --- | --- |"]


def _parameters(form: type[Effect]) -> str:
    """Names of its parameters, each with its unit and the range that was published."""
    names = []
    for known in form.parameters():
        unit = "" if known.unit in ("", "1") else f" [{known.unit}]"
        published = (
            f" ({known.published[0]:g} to {known.published[1]:g})" if known.published else ""
        )
        names.append(f"`{known.name}`{unit}{published}")
    return ", ".join(names) or "-"


def _row(form: type[Effect]) -> str:
    """One form of an effect as a row of the table."""
    cells = [f"`{form.form}`", f"`{form.formula}`", _parameters(form), form.source]
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


def as_markdown(effect: str) -> list[str]:
    """The table of an effect's forms and, of an instrument's fault, how the instrument is checked."""
    forms = families()[effect]
    checked = ["", forms[0].next_step] if forms[0].kind == "instrument" else []
    return [*HEADER, *map(_row, forms), *checked]


class EffectForms(SphinxDirective):
    """Show one effect's forms."""

    required_arguments = 1

    def run(self) -> list[Any]:
        """Give the nodes of its table."""
        return self.parse_text_to_nodes("\n".join(as_markdown(self.arguments[0])))


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("effect", EffectForms)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
