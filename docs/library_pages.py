# SPDX-License-Identifier: Apache-2.0
"""Writes the pages of the library, one for each package, from the modules that there are.

Each module is a section that autodoc fills from its docstrings.
"""

from __future__ import annotations

import ast
import pkgutil
import shutil
from pathlib import Path

# What a user of the library does not import: the program's own commands, its pages and its node.
LEFT_OUT = {"commands", "demo", "views", "ros", "msg"}
# Of the modules that are in no package, those that one does import.
ALONE = {"api"}


def public(package: Path) -> dict[str, list[str]]:
    """By page, the full names of its modules: a package with all that is in it, or a module alone."""
    pages: dict[str, list[str]] = {}
    for entry in pkgutil.iter_modules([str(package)]):
        name = f"{package.name}.{entry.name}"
        if entry.ispkg and entry.name not in LEFT_OUT:
            inner = _modules(package / entry.name, name)
            pages[entry.name] = [name, *inner]
        elif not entry.ispkg and entry.name in ALONE:
            pages[entry.name] = [name]
    return pages


def _modules(folder: Path, name: str) -> list[str]:
    found = []
    for entry in pkgutil.iter_modules([str(folder)]):
        found.append(f"{name}.{entry.name}")
        if entry.ispkg:
            found += _modules(folder / entry.name, found[-1])
    return found


def _first_line(package: Path, module: str) -> str:
    """The first line of a module's docstring, without importing it."""
    path = package.parent.joinpath(*module.split("."))
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return (ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").split("\n")[0]


def _section(title: str, module: str, line: str, members: bool) -> list[str]:
    options = ["   :members:"] if members else []
    return [title, line * len(title), "", f".. automodule:: {module}", *options, ""]


def write(package: Path, folder: Path) -> None:
    """Write FOLDER/NAME.rst for each page, and FOLDER/overview.txt with a line about each."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    table = ["| page | what |", "| --- | --- |"]
    for page, (first, *rest) in public(package).items():
        # A package's own names come from its modules, and are told there.
        text = _section(page, first, "=", members=not rest)
        for module in rest:
            text += _section(module.removeprefix(f"{first}."), module, "-", members=True)
        (folder / f"{page}.rst").write_text("\n".join(text), encoding="utf-8")
        table.append(f"| [{page}](_api/{page}.rst) | {_first_line(package, first)} |")
    (folder / "overview.txt").write_text("\n".join(table) + "\n", encoding="utf-8")
