# SPDX-License-Identifier: Apache-2.0
"""The directive `parameters general` (or `wheel`): a table of the node's parameters, as declared."""

from __future__ import annotations

from typing import Any

from parameter_pages import span
from sphinx.util.docutils import SphinxDirective

from smallwheel_ros.common.node_parameter import WHEEL, NodeParameter, written
from smallwheel_ros.onboard.declared import GENERAL, PER_WHEEL

TABLES = {"general": GENERAL, "wheel": PER_WHEEL}


def _row(parameter: NodeParameter) -> str:
    """One parameter: name, type, default, range, meaning with unit."""
    default = "*required*" if parameter.required else "*optional*"
    if parameter.default is not None:
        default = f"`{written(parameter.default)}`"
    unit = f" [{parameter.unit}]" if parameter.unit else ""
    at_start = " *At start.*" if parameter.at_start else ""
    meaning = f"{parameter.description}{unit}{at_start}"
    cells = (parameter.name, parameter.kind, default, span(parameter), meaning)
    return f"| {' | '.join(cells)} |".replace(WHEEL, "*wheel*")


class Parameters(SphinxDirective):
    """Show one of the two tables."""

    required_arguments = 1

    def run(self) -> list[Any]:
        """Give the nodes of the table."""
        header = ["| name | type | default | range | meaning |", "| --- | --- | --- | --- | --- |"]
        return self.parse_text_to_nodes("\n".join([*header, *map(_row, TABLES[self.arguments[0]])]))


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("parameters", Parameters)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
