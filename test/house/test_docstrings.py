# SPDX-License-Identifier: Apache-2.0
"""Public functions with two parameters or more name all of them in a numpydoc section, with shapes and units.

Not those whose docstring is elsewhere: effects' stages (`effects/base.py`), overloads, and commands, whose
docstring is their help.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2] / "smallwheel_ros"
SECTION = re.compile(
    r"^Parameters\n-{10}\n(.*?)(?:\n\n\w[\w ]*\n-{3,}|\Z)", re.DOTALL | re.MULTILINE
)
OF_CLICK = {"get_command", "resolve_command", "format_commands"}  # overridden in cli.py


def functions(node: ast.AST) -> Iterator[ast.FunctionDef]:
    """Public functions, and methods of public classes."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.ClassDef) and not child.name.startswith("_"):
            yield from functions(child)
        elif isinstance(child, ast.FunctionDef) and not child.name.startswith("_"):
            decorators = [ast.unparse(one) for one in child.decorator_list]
            yield from [child] if not any("command(" in text for text in decorators) else []


def parameters(function: ast.FunctionDef) -> list[str]:
    """Names of its parameters, but for the instance and private ones."""
    given = function.args
    every = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
    names = [one.arg for one in every if one is not None]
    return [name for name in names if name not in ("self", "cls") and not name.startswith("_")]


def listed(docstring: str) -> set[str]:
    """Parameters that the section names: `a`, `a, b`, `a : of a type`."""
    section = SECTION.search(docstring)
    heads = [line for line in (section[1] if section else "").splitlines() if line[:1].strip()]
    return {name.strip(" *") for head in heads for name in head.split(":")[0].split(",")}


def unnamed(source: str) -> list[str]:
    """Functions of a file that do not name all of their parameters."""
    found = []
    for function in functions(ast.parse(source)):
        docstring, names = ast.get_docstring(function), parameters(function)
        lacking = set(names) - listed(docstring or "")
        if docstring and len(names) > 1 and lacking and function.name not in OF_CLICK:
            found.append(f"{function.name}: {', '.join(sorted(lacking))}")
    return found


def test_all_parameters_are_named() -> None:
    lacking = [
        f"{path.relative_to(PACKAGE)}: {text}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for text in unnamed(path.read_text(encoding="utf-8"))
    ]
    assert not lacking, "\n".join(lacking)


def test_what_counts_as_named() -> None:
    section = "Parameters\n    ----------\n    a, b\n        m.\n    how : text\n        c.\n"
    whole = f'"""Do.\n\n    {section}    """'
    head = "def f(self, a, b, *, how=1):\n    "
    assert unnamed(head + whole) == []
    assert unnamed(head + whole.replace("a, b", "a")) == ["f: b"]
    assert unnamed(head + '"""Do. a: m."""') == ["f: a, b, how"]
    assert unnamed("def f(self, a):\n    " + '"""Do."""') == []
    assert unnamed(head.replace("def f", "def _f") + '"""Do."""') == []
