# SPDX-License-Identifier: Apache-2.0
"""Parameters of the node as fields of dataclasses: names, kinds, and what is wrong with a value."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from smallwheel_ros.common.node_parameter import (
    NodeParameter,
    filled,
    group,
    group_per_wheel,
    parameter,
    rows_of,
    topic,
    written,
)


@dataclass(frozen=True, kw_only=True)
class Timing:
    wait: float = parameter(0.2, "s", (0.0, 5.0), "How long.")
    source: Literal["header", "clock"] = parameter("header", text="Of stamps.")


@dataclass(frozen=True, kw_only=True)
class OneWheel:
    diameter: float = parameter(None, "m", (0.01, 2.0), "Of the wheel.", required=True)
    load_topic: str = topic("<wheel>/load", "Of its load cell.")


@dataclass(frozen=True, kw_only=True)
class Declared:
    wheels: tuple[str, ...] = parameter(("a", "b"), text="Names.")
    timing: Timing = group(Timing)
    by_wheel: dict[str, OneWheel] = group_per_wheel(OneWheel)
    derived: int = field(default=7)


ROWS = {row.name: row for row in rows_of(Declared)}


def test_names_and_kinds_are_those_of_the_fields() -> None:
    assert {name: row.kind for name, row in ROWS.items()} == {
        "wheels": "string_array",
        "timing.wait": "double",
        "timing.source": "string",
        "<wheel>.diameter": "double",
        "<wheel>.load_topic": "string",
    }
    assert ROWS["timing.source"].choices == ("header", "clock")
    own = ROWS["<wheel>.load_topic"].for_wheel("front")
    assert (own.name, own.default) == ("front.load_topic", "front/load")


def test_values_fill_the_groups() -> None:
    values = {
        "wheels": ["a"],
        "timing.wait": 1.0,
        "timing.source": "clock",
        "a.diameter": 0.2,
        "a.load_topic": "x",
    }
    made = filled(Declared, values)
    assert made.timing == Timing(wait=1.0, source="clock")
    assert made.by_wheel == {"a": OneWheel(diameter=0.2, load_topic="x")}
    assert (made.wheels, made.derived) == (("a",), 7)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("<wheel>.diameter", None, "is missing, expected a double from 0.01 to 2 m"),
        ("timing.wait", True, "is bool True, expected a double from 0 to 5 s"),
        ("timing.wait", 6.0, "is 6.0, expected a double from 0 to 5 s"),
        ("timing.wait", "0.1", "write it without quotes"),
        ("timing.source", "clok", "expected 'header' or 'clock'"),
        ("wheels", "a", "write [a]"),
        ("<wheel>.load_topic", "2/x", "the name of a topic"),
    ],
)
def test_what_is_wrong_is_said_with_the_mend(name: str, value: object, words: str) -> None:
    assert words in str(ROWS[name].problem(value))


@given(st.floats(), st.floats(-1e3, 1e3), st.floats(0.0, 1e3))
def test_a_range_has_both_its_ends(value: float, low: float, width: float) -> None:
    one = NodeParameter("x", "double", None, "", low=low, high=low + width)
    assert one.spans(low)
    assert one.spans(one.high or low)
    assert (one.problem(value) is None) == (low <= value <= low + width)


@given(st.text() | st.floats(allow_nan=False) | st.integers() | st.booleans() | st.lists(st.text()))
@example("\n")
@example(["a", "\n b\n"])
def test_a_value_is_read_back_as_it_was_written(value: float | str | list[str]) -> None:
    text = written(value)
    assert "\n" not in text
    assert yaml.safe_load(f"[{text}]") == [value]
