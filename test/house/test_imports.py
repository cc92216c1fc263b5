# SPDX-License-Identifier: Apache-2.0
"""docs/architecture.md lists the packages: what one imports stands above it in that list.

Every import counts, those inside functions too; only what a type checker alone reads does not.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

PAGE = Path(__file__).resolve().parents[2] / "docs" / "architecture.md"
PACKAGE = PAGE.parent.parent / "smallwheel_ros"


def packages() -> list[str]:
    """Folders and modules of the package in the order of the page."""
    text = PAGE.read_text(encoding="utf-8").split("<!-- packages -->")[1]
    return re.findall(
        r"`([a-z_]+)`", " ".join(row.split("|")[1] for row in text.splitlines() if "|" in row)
    )


def package_of(module: str) -> str:
    """`smallwheel_ros.fitting.fit` is in fitting, `smallwheel_ros.model.model` in model."""
    return module.split(".")[1] if "." in module else "__init__"


def imported(node: ast.AST) -> Iterator[str]:
    """Modules of the package that a piece of code imports, wherever it does."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test):
            continue
        if isinstance(child, ast.ImportFrom) and (child.module or "").startswith("smallwheel_ros"):
            plain = child.module == "smallwheel_ros"
            for name in child.names:
                yield f"smallwheel_ros.{name.name}" if plain else str(child.module)
        elif isinstance(child, ast.Import):
            yield from (n.name for n in child.names if n.name.startswith("smallwheel_ros"))
        yield from imported(child)


def test_imports_go_up_the_list_of_packages() -> None:
    order = {name: place for place, name in enumerate(packages())}
    wrong, met = [], set()
    for path in sorted(PACKAGE.rglob("*.py")):
        inside = path.relative_to(PACKAGE)
        if inside.parts[0] in ("__init__.py", "__main__.py"):
            continue  # what users import: everything is behind it
        here = inside.parts[0].removesuffix(".py")
        met.add(here)
        for module in imported(ast.parse(path.read_text(encoding="utf-8"))):
            there = package_of(module)
            if there in ("__init__", "__version__", "msg") or there == here:
                continue  # msg: what rosidl makes of the messages
            if here not in order or order.get(there, len(order)) > order[here]:
                wrong.append(f"{inside}: {module}")
    assert not wrong, wrong
    assert set(order) <= met, f"packages that are gone: {set(order) - met}"


def test_no_two_test_files_have_one_name(repository: Path) -> None:
    """Tests import from each other by name: of two the one that was collected first would be meant."""
    names = [path.stem for path in (repository / "test").glob("**/*.py")]
    assert sorted(set(names)) == sorted(names)
