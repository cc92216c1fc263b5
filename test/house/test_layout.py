# SPDX-License-Identifier: Apache-2.0
"""The tree shows the architecture: a test for each file, one class a name, small folders, names apart."""

from __future__ import annotations

import ast
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE, TESTS = ROOT / "smallwheel_ros", ROOT / "test"
NOT_OF_A_PACKAGE = {"docs", "house", "rates", "references", "data"}  # folders of test/
MOST_FILES = {".": 16, "views": 18}  # directly in a folder; a view for each kind of result
# Families of effects have forms, and a form is found by both names: an exponential of slip, one of a column.
BORNE_TWICE = {"Exponential"}


def sources() -> Iterator[Path]:
    """Files of the package, without those that only make a folder a package."""
    return (path for path in sorted(PACKAGE.rglob("*.py")) if path.name != "__init__.py")


@cache
def docstring(path: Path) -> str:
    return ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""


def own_tests(source: Path) -> list[Path]:
    """Tests of a file: of its name, or that name it in their first docstring, in the folder of its folder."""
    folder = TESTS / source.relative_to(PACKAGE).parent
    return [
        test
        for test in sorted(folder.glob("test_*.py"))
        if test.stem == f"test_{source.stem}" or f"`{source.name}`" in docstring(test)
    ]


def test_each_file_has_its_test() -> None:
    without = [str(source.relative_to(ROOT)) for source in sources() if not own_tests(source)]
    assert not without, (
        f"{without}: a test of a/b/x.py is test/a/b/test_x.py, or names `x.py` in the first docstring of "
        "a test in test/a/b"
    )


def test_no_test_names_a_file_that_is_gone() -> None:
    gone = []
    for test in sorted(TESTS.rglob("test_*.py")):
        folder = PACKAGE / test.relative_to(TESTS).parent
        last = docstring(test).split("\n\n")[-1]
        if last.startswith("Tests `"):
            names = re.findall(r"`(\w+\.py)`", last)
            gone += [f"{test.name}: {name}" for name in names if not (folder / name).is_file()]
    assert not gone, gone


def test_folders_of_tests_are_those_of_the_package() -> None:
    folders = {path.parent.relative_to(TESTS) for path in TESTS.rglob("test_*.py")}
    apart = [
        str(folder)
        for folder in folders
        if not (PACKAGE / folder).is_dir() and str(folder).partition("/")[0] not in NOT_OF_A_PACKAGE
    ]
    assert not apart, apart


def test_a_folder_is_seen_at_a_glance() -> None:
    count = Counter(str(path.parent.relative_to(PACKAGE)) for path in sources())
    large = {name: n for name, n in count.items() if n > MOST_FILES.get(name, MOST_FILES["."])}
    assert not large, large


def test_no_two_files_differ_by_an_s() -> None:
    names = {path.stem for path in sources()}
    assert not (pairs := sorted(name for name in names if f"{name}s" in names)), pairs


def test_a_class_has_its_name_alone() -> None:
    places = defaultdict(list)
    for path in sources():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef):
                places[node.name].append(f"{path.relative_to(PACKAGE)}:{node.lineno}")
    twice = {name for name, found in places.items() if len(found) > 1}
    assert twice == BORNE_TWICE, {name: places[name] for name in twice ^ BORNE_TWICE}
