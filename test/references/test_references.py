# SPDX-License-Identifier: Apache-2.0
"""What the package finds agrees with what is certified, to the digits that RESULTS.md states.

`PYTHONPATH=. python test/references/test_references.py` writes the page anew.
"""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # run as a script

from compared import ASKED, OFF, Compared, compared, digits
from reference_file import HERE, names, read_reference

PAGE = HERE / "RESULTS.md"
BEGIN = "<!-- made by python test/references/test_references.py -->\n\n"
END = "<!-- end -->\n"
KEYS = {"Name", "What", "Source", "Licence", "Law", "Certified"}
SHOWN = 12  # digits of a certified value on the page
WAVER = 1  # digits by which another processor or library may agree more or less


@cache
def lines_of(name: str) -> list[Compared]:
    return compared(name)


@pytest.mark.parametrize("name", names())
def test_the_certified_digits_come_out(name: str) -> None:
    lines = lines_of(name)
    assert lines
    for line in lines:
        assert line.digits >= line.asked.digits, line
        if line.of_deviation is not None:
            assert line.of_deviation >= line.asked.of_deviation, line
        if line.off is not None:
            assert line.off < OFF, line


@pytest.mark.parametrize("name", names())
def test_a_file_is_of_the_form(name: str) -> None:
    reference = read_reference(name)
    assert reference.head["Name"] == name
    assert set(reference.head) >= KEYS
    assert all(len(row) == len(reference.columns) for row in reference.rows)
    for value in reference.certified.values():
        assert float(value.value) or value.value == "0"
        assert len(re.sub(r"e.*|[-.]", "", value.value).lstrip("0")) <= 30
        assert value.deviation is None or float(value.deviation) > 0.0


def test_every_problem_is_compared_and_certified_by_the_script() -> None:
    script = ast.parse((HERE / "certify.py").read_text(encoding="utf-8"))
    texts = {node.value for node in ast.walk(script) if isinstance(node, ast.Constant)}
    assert set(names()) == set(ASKED)
    assert set(names()) <= texts


@pytest.mark.parametrize(
    "path", [*sorted(HERE.glob("precise*.py")), HERE / "certify.py"], ids=lambda p: p.stem
)
def test_what_certifies_knows_nothing_of_the_package(path: Path) -> None:
    allowed = {"mpmath", "reference_file", "__future__", "collections", "dataclasses",
               "functools", "itertools", "sys", "typing"}  # fmt: skip
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        modules += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        for module in modules:
            top = module.partition(".")[0]
            assert top in allowed or top.startswith("precise"), f"{path.name}: {module}"


@pytest.mark.parametrize(
    "name",
    [
        "paper_2011",
        "plates_exact",
        "shear_exact",
        "shear_cullinan",
        pytest.param("contact_integral", marks=pytest.mark.slow),
    ],
)
def test_the_script_certifies_again_what_stands_there(name: str, tmp_path: Path) -> None:
    """Those that take seconds; of the others `certify.py` says how long."""
    folder = shutil.copytree(
        HERE, tmp_path / "references", ignore=shutil.ignore_patterns("__pycache__")
    )
    path = folder / f"{name}.txt"
    whole = path.read_text(encoding="utf-8")
    head, _, data = whole.split("\n\n")
    path.write_text(f"{head}\n\nCertified values\n\n{data}", encoding="utf-8")
    done = subprocess.run(
        [sys.executable, folder / "certify.py", name], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert path.read_text(encoding="utf-8") == whole


@pytest.mark.parametrize(
    ("found", "certified", "agree"), [(1.001, "1", 3.0), (2.0, "2", 15.0), (-1.0, "1", 0.0)]
)
def test_digits(found: float, certified: str, agree: float) -> None:
    assert digits(found, certified) == pytest.approx(agree, abs=1e-9)


def test_a_file_that_is_not_of_the_form_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("reference_file.HERE", tmp_path)
    (tmp_path / "a.txt").write_text("Name: a\n\nData\nx\n1\n")
    with pytest.raises(ValueError, match=r"a\.txt: found 2 parts, expected three"):
        read_reference("a")
    (tmp_path / "b.txt").write_text("Name b\n\nCertified values\nname\n\nData\nx\n1\n")
    with pytest.raises(ValueError, match=r"b\.txt: 'Name b' in the head, expected KEY: TEXT"):
        read_reference("b")


def rounded(text: str) -> str:
    """A certified number as the page shows it."""
    return f"{float(text):.{SHOWN}g}"


def summary() -> list[str]:
    """One row a problem."""
    lines = [
        "| problem | values | digits, least | of deviations | what limits them |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name in names():
        found = lines_of(name)
        least = min(int(line.digits) for line in found)
        stds = [int(line.of_deviation) for line in found if line.of_deviation is not None]
        worst = min(found, key=lambda line: line.digits)
        link = f"[{name}](#{name})"
        of_stds = min(stds, default="-")
        lines.append(f"| {link} | {len(found)} | {least} | {of_stds} | {worst.asked.why} |")
    return lines


def paper_table() -> list[str]:
    """What the paper prints beside what its own equations give."""
    reference = read_reference("paper_2011")
    lines = ["| printed | its equations give | off by | |", "| --- | --- | --- | --- |"]
    for case, printed, unit, status, reading in reference.rows:
        value = float(reference.certified[case].value)
        unit = "times" if unit == "1" else unit
        off = 100.0 * (value / float(printed) - 1.0)
        lines.append(f"| {printed} {unit} | {value:.6g} | {off:+.2f} % | {status}: {reading} |")
    return lines


def problem_table(name: str) -> list[str]:
    """Certified values of one problem, and the digits that agree."""
    lines = [
        "| value | certified | standard deviation | unit | digits | of the deviation |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for line in lines_of(name):
        std = line.certified.deviation
        stated = "-" if std is None else rounded(std)
        of_std = "-" if line.of_deviation is None else str(int(line.of_deviation))
        value = (
            f"| {line.name} | {rounded(line.certified.value)} | {stated} | {line.certified.unit} "
        )
        lines.append(f"{value}| {int(line.digits)} | {of_std} |")
    return lines


def table() -> str:
    """What stands between the marks of the page."""
    count = sum(len(lines_of(name)) for name in names())
    lines = [f"{len(names())} problems, {count} values.", "", *summary(), ""]
    for name in names():
        head = read_reference(name).head
        lines += [
            f"## {name}",
            "",
            head["What"],
            "",
            f"Law: `{head['Law']}`",
            "",
            f"Source: {head['Source']}",
            "",
        ]
        lines += [*paper_table(), ""] if name == "paper_2011" else []
        lines += [*problem_table(name), ""]
    return "\n".join(lines)


def split(page: str) -> tuple[str, str, str]:
    before, rest = page.split(BEGIN)
    shown, after = rest.split(END)
    return before, shown, after


def test_the_page_lists_the_digits_that_agree() -> None:
    shown = split(PAGE.read_text(encoding="utf-8"))[1]
    made = table()
    whole = re.compile(r"(?<=\| )\d{1,2}(?= \|)")  # digits: those of a processor may differ by one
    assert whole.sub("N", shown) == whole.sub("N", made), (
        f"run `PYTHONPATH=. python {Path(__file__).name}`"
    )
    for before, now in zip(whole.findall(shown), whole.findall(made), strict=True):
        assert abs(int(before) - int(now)) <= WAVER


if __name__ == "__main__":
    before, _, after = split(PAGE.read_text(encoding="utf-8"))
    PAGE.write_text(before + BEGIN + table() + END + after, encoding="utf-8")
