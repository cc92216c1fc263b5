# SPDX-License-Identifier: Apache-2.0
"""docs/architecture.md lists packages and the rooms of `pipeline`: what one imports stands above it there.

Every import counts, those inside functions too; only what a type checker alone reads does not.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

PAGE = Path(__file__).resolve().parents[2] / "docs" / "architecture.md"
PACKAGE = PAGE.parent.parent / "smallwheel_ros"


def listed(table: str) -> dict[str, int]:
    """Place of each name in the first column of a table of the page."""
    text = PAGE.read_text(encoding="utf-8").split(f"<!-- {table} -->")[1].split("<!-- end")[0]
    rows = " ".join(row.split("|")[1] for row in text.splitlines() if "|" in row)
    return {name: place for place, name in enumerate(re.findall(r"`([a-z_]+)`", rows))}


def imported(node: ast.AST, folder: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Modules of the package that a piece of code imports, wherever it does; folder: of its file."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test):
            continue
        if isinstance(child, ast.ImportFrom):
            module = tuple((child.module or "").split("."))
            if child.level:
                module = (*folder[: len(folder) - child.level + 1], *filter(None, module))
            if module == ("smallwheel_ros",):
                yield from ((*module, name.name) for name in child.names)
            elif module[0] == "smallwheel_ros":
                yield module
        elif isinstance(child, ast.Import):
            parts = (tuple(name.name.split(".")) for name in child.names)
            yield from (module for module in parts if module[0] == "smallwheel_ros")
        yield from imported(child, folder)


def arrows() -> Iterator[tuple[str, tuple[str, ...], tuple[str, ...]]]:
    """File, its module and a module that it imports, by the names below the package."""
    for path in sorted(PACKAGE.rglob("*.py")):
        inside = path.relative_to(PACKAGE)
        if inside.parts[0] in ("__init__.py", "__main__.py"):
            continue  # what users import: everything is in it
        here = inside.with_suffix("").parts
        for module in imported(
            ast.parse(path.read_text(encoding="utf-8")), ("smallwheel_ros", *here[:-1])
        ):
            if len(module) > 1 and module[1] not in ("__version__", "msg"):
                yield str(inside), here, module[1:]  # msg: what rosidl makes of the messages


def test_imports_go_up_the_list_of_packages() -> None:
    order, met = listed("packages"), set()
    wrong = []
    for file, here, there in arrows():
        met |= {here[0], there[0]}
        if here[0] != there[0] and not order.get(there[0], len(order)) < order.get(here[0], -1):
            wrong.append(f"{file}: {'.'.join(there)}")
    assert not wrong, wrong
    assert set(order) <= met, f"packages that are gone: {set(order) - met}"


def test_rooms_of_the_pipeline_import_from_those_that_data_passed_before() -> None:
    order, wrong = listed("rooms"), []
    for file, here, there in arrows():
        if here[0] != "pipeline" or here[1] in ("pipeline", "__init__"):
            continue
        apart = there[0] == "pipeline" and here[1] != there[1]
        if apart and not order.get(there[1], len(order)) < order.get(here[1], -1):
            wrong.append(f"{file}: {'.'.join(there)}")
    assert not wrong, wrong
    there_are = {path.stem for path in (PACKAGE / "pipeline").glob("[!_]*")} - {"pipeline"}
    assert set(order) == there_are, f"in one only: {set(order) ^ there_are}"


def test_no_file_is_in_a_circle_of_imports() -> None:
    graph: dict[str, set[str]] = {}
    for file, _, there in arrows():
        for parts in (there, there[:-1]):  # a module, or a name of one
            path = PACKAGE.joinpath(*parts).with_suffix(".py")
            if parts and path.is_file():
                graph.setdefault(file, set()).add(str(path.relative_to(PACKAGE)))
                break
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the files


def test_what_shows_a_result_is_there() -> None:
    """Results name it by a string, which no import and no linter sees."""
    names = [
        name
        for path in PACKAGE.rglob("*.py")
        for name in re.findall(r'\bshown="([\w.]+)"', path.read_text(encoding="utf-8"))
    ]
    assert len(names) > 5
    gone = [n for n in names if not PACKAGE.joinpath(*n.split(".")).with_suffix(".py").is_file()]
    assert not gone, gone


def test_no_two_test_files_have_one_name(repository: Path) -> None:
    """Tests import from each other by name: of two the one that was collected first would be meant."""
    names = [path.stem for path in (repository / "test").glob("**/*.py")]
    assert sorted(set(names)) == sorted(names)
