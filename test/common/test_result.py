# SPDX-License-Identifier: Apache-2.0
"""What all results have in common: text, plain values, rows and files; and what errors say.

Tests `console.py`, `errors.py`, `release.py`, `result.py` and `tables.py`.
"""

from __future__ import annotations

import csv
import json
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.common.console import show
from smallwheel_ros.common.errors import ArgumentError, SmallwheelError, kind_of, nearest, reason
from smallwheel_ros.common.release import __version__
from smallwheel_ros.common.result import Result, ResultError
from smallwheel_ros.common.tables import plain, text_table


@dataclass(frozen=True, repr=False)
class Sum(Result):
    """A result that shows itself."""

    parts: tuple[float, ...]

    def headline(self) -> str:
        return f"a sum of {len(self.parts)}"

    def text(self) -> str:
        return f"{sum(self.parts):g}"

    def to_dict(self) -> dict[str, Any]:
        return {"parts": list(self.parts), "sum": sum(self.parts)}

    def rows(self) -> list[dict[str, Any]]:
        return [{"part": i, "value": value} for i, value in enumerate(self.parts)]


class Bare(Result, shown="test_result"):
    """A result that another module shows: this one, which has its text alone."""

    def headline(self) -> str:
        return "bare"


def text(result: Result) -> str:
    return f"shown: {result.headline()}"


def test_a_result_is_its_text_in_print_and_its_headline_in_a_list() -> None:
    assert str(Sum((1.0, 2.5))) == "3.5"
    assert repr([Sum((1.0,))]) == "[<Sum: a sum of 1>]"


def test_files_are_written_by_their_suffix(tmp_path: Path) -> None:
    result = Sum((1.0, 2.5))
    assert json.loads(result.save(tmp_path / "a.json").read_text()) == result.to_dict()
    with result.save(tmp_path / "a.csv").open() as file:
        assert list(csv.reader(file)) == [["part", "value"], ["0", "1.0"], ["1", "2.5"]]
    with pytest.raises(ResultError, match=r"cannot be saved as '\.jsn': did you mean '\.json'"):
        result.save(tmp_path / "a.jsn")
    assert len(list(tmp_path.iterdir())) == 2


def test_a_notebook_shows_twenty_rows_and_says_how_many_more() -> None:
    html = Sum(tuple(map(float, range(23))))._repr_html_()
    assert html.count("<tr>") == 21
    assert "and 3 more rows" in html


def test_a_result_names_the_module_that_shows_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "smallwheel_ros.test_result", sys.modules[__name__])
    assert str(Bare()) == "shown: bare"
    needs: list[Callable[[], object]] = [Bare().rows, Bare().to_dict]
    for need in needs:
        with pytest.raises(NotImplementedError, match="a Bare has no"):
            need()


def test_a_command_prints_text_or_json(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    show(Sum((1.0,)), None, [tmp_path / "x.csv"])
    assert capsys.readouterr().out == f"1\nwritten: {tmp_path / 'x.csv'}\n"
    show(Sum((1.0,)), "-")
    assert json.loads(capsys.readouterr().out) == {"parts": [1.0], "sum": 1.0}


@given(st.recursive(
    st.floats() | st.integers() | st.text() | st.none() | st.booleans(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
))  # fmt: skip
def test_plain_values_are_json_whatever_they_were(value: object) -> None:
    json.dumps(plain(value), allow_nan=False)
    assert plain({"x": np.array([1.0, math.nan])}) == {"x": [1.0, None]}


def test_columns_of_numbers_are_set_to_the_right() -> None:
    table = text_table(["name", "N"], [["a", "1"], ["long", "20.5"]])
    assert table.split("\n") == ["name     N", "a        1", "long  20.5"]


def test_errors_say_what_there_is() -> None:
    assert issubclass(ArgumentError, SmallwheelError)
    assert nearest("slp", ["slip", "load"]) == "did you mean 'slip'? Expected one of load, slip"
    assert nearest("xyz", ["slip", "load"]) == "expected one of load, slip"
    assert reason(OSError(2, "No such file or directory")) == "No such file or directory"
    assert reason(ValueError()) == "ValueError"
    assert (kind_of(None), kind_of(3)) == ("nothing", "int")


def test_the_release_is_three_numbers() -> None:
    assert all(part.isdigit() for part in __version__.split("."))
    assert __version__.count(".") == 2
