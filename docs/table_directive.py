# SPDX-License-Identifier: Apache-2.0
"""The directive `code-table NAME ARGUMENT`: a table that code_tables.py makes from the code."""

from __future__ import annotations

from typing import Any

from code_tables import TABLES
from sphinx.util.docutils import SphinxDirective


class CodeTable(SphinxDirective):
    """Show one table."""

    required_arguments = 2

    def run(self) -> list[Any]:
        """Give the nodes of the table."""
        name, argument = self.arguments
        return self.parse_text_to_nodes("\n".join(TABLES[name](argument)))


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("code-table", CodeTable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
