# SPDX-License-Identifier: Apache-2.0
"""Public functions with two parameters or more name all of them in a numpydoc section, with shapes and units.

Not those whose docstring is elsewhere: effects' stages (`effects/base.py`), overloads, and commands, whose
docstring is their help. What the docstring of a class lists as attributes, the class has.
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
ATTRIBUTES = re.compile(SECTION.pattern.replace("Parameters", "Attributes"), SECTION.flags)
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


def attributes(node: ast.ClassDef) -> set[str]:
    """What a class declares, defines, or sets on itself."""
    found = set()
    for part in ast.walk(node):
        if isinstance(part, ast.Attribute) and ast.unparse(part.value) == "self":
            found.add(part.attr)
        elif isinstance(part, ast.FunctionDef):
            found.add(part.name)
    declared = [part.target for part in node.body if isinstance(part, ast.AnnAssign)]
    return found | {ast.unparse(name) for name in declared}


def not_there(sources: list[str]) -> list[str]:
    """Lines of an Attributes section that name nothing which the class or one of its bases has."""
    classes = [
        node
        for source in sources
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.ClassDef)
    ]
    of_name: dict[str, list[ast.ClassDef]] = {}
    for node in classes:
        of_name.setdefault(node.name, []).append(node)

    def known(node: ast.ClassDef) -> set[str]:
        bases = [b for base in node.bases for b in of_name.get(ast.unparse(base).split("[")[0], [])]
        return attributes(node).union(*(known(base) for base in bases if base is not node))

    found = []
    for node in classes:
        section = ATTRIBUTES.search(ast.get_docstring(node) or "")
        heads = [line for line in (section[1] if section else "").splitlines() if line[:1].strip()]
        names = {name.strip() for head in heads for name in head.split(" : ")[0].split(",")}
        found += [f"{node.name}: {name}" for name in sorted(names - known(node))]
    return found


def test_all_attributes_are_there() -> None:
    sources = [path.read_text(encoding="utf-8") for path in sorted(PACKAGE.rglob("*.py"))]
    assert not not_there(sources)


def test_what_counts_as_there() -> None:
    head = "class A(B):\n    "
    section = '"""Do.\n\n    Attributes\n    ----------\n    a, b\n        m.\n    """\n'
    whole = head + section
    assert not_there([whole]) == ["A: a", "A: b"]
    assert not_there([whole + "    a: int\n    def b(self): ...\n"]) == []
    assert not_there([whole + "    a: int\n", "class B:\n    b: int\n"]) == []
    assert not_there([whole + "    def f(self):\n        self.a = self.b = 1\n"]) == []
    swallowed = head + section.replace("m.\n", "m.\n\n    Raises E where it is not.\n")
    assert not_there([swallowed + "    a: int\n    b: int\n"]) == ["A: Raises E where it is not."]
