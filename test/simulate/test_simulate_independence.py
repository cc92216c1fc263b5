# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import ast
from pathlib import Path

import pytest

import smallwheel_ros.simulate

FOLDER = Path(smallwheel_ros.simulate.__file__).parent
# What the truth may share with the rest of the package: nothing that computes soil or wheels.
_COMMON = ("console", "errors", "files", "stamps", "tables")
SHARED = {"smallwheel_ros.bags"} | {f"smallwheel_ros.common.{name}" for name in _COMMON}


def imported(source: str) -> set[str]:
    names, tree = set(), ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            node.body = []  # never run
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            names.add(node.module)
            if node.module == "smallwheel_ros":
                names |= {f"smallwheel_ros.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("file", sorted(FOLDER.rglob("*.py")), ids=lambda f: f.name)
def test_the_truth_does_not_use_the_model(file):
    for name in imported(file.read_text()):
        if name.startswith("smallwheel_ros.simulate") or not name.startswith("smallwheel_ros"):
            assert name not in ("importlib", "runpy"), "an import that this test cannot see"
            continue
        assert name in SHARED, f"{file.name} imports {name}"


def test_what_is_shared_does_not_use_the_model_either():
    for name in SHARED:
        place = FOLDER.parent.joinpath(*name.split(".")[1:])
        files = [place.with_suffix(".py")] if not place.is_dir() else sorted(place.rglob("*.py"))
        assert files
        for file in files:
            own = {n for n in imported(file.read_text()) if n.startswith("smallwheel_ros.")}
            known = {n for n in own if any(n == s or n.startswith(f"{s}.") for s in SHARED)}
            assert own == known, file.name


def test_this_test_sees_imports():
    source = "from smallwheel_ros import model\nimport smallwheel_ros.physics.soil as s\n"
    assert imported(source) >= {"smallwheel_ros.model", "smallwheel_ros.physics.soil"}
