# SPDX-License-Identifier: Apache-2.0
"""Writes config/template.yaml from the declarations of the node's parameters.

`PYTHONPATH=. python docs/parameter_pages.py` writes it anew. The site shows the same as tables (code_tables).
"""

from pathlib import Path

from smallwheel_ros.onboard.template import template


def main() -> None:
    """Write the template into the checkout."""
    path = Path(__file__).resolve().parent.parent / "config" / "template.yaml"
    path.write_text(template(), encoding="utf-8")
    print(path)


if __name__ == "__main__":
    main()
