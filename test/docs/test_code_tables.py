# SPDX-License-Identifier: Apache-2.0
"""Tables that the site makes from the code hold all of it, each constant with a name and a reason."""

from __future__ import annotations

import re

import pytest

from docs.code_tables import TABLES, constants_with_reasons
from smallwheel_ros.effects.registry import families
from smallwheel_ros.onboard.declared import GENERAL, PER_WHEEL

ALL = constants_with_reasons()


@pytest.mark.parametrize("constant", ALL, ids=lambda c: c.name)
def test_each_constant_has_a_name_and_a_reason(constant: tuple[str, float, str]) -> None:
    name, _, why = constant
    assert name.strip()
    assert why.strip()


def rows(name: str, argument: str) -> list[list[str]]:
    """The cells of a table's rows, without its header."""
    lines = [line for line in TABLES[name](argument) if line.startswith("|")]
    cells = [re.split(r"(?<!\\)\|", line)[1:-1] for line in lines]
    assert len({len(row) for row in cells}) == 1, "a bar in a cell ends it"
    return cells[2:]


@pytest.mark.parametrize("id", families())
def test_every_form_is_in_the_table_of_its_effect(id: str) -> None:
    assert [row[0].strip() for row in rows("effect", id)] == [f"`{f.form}`" for f in families()[id]]


@pytest.mark.parametrize(
    ("name", "argument", "count"),
    [
        ("parameters", "general", len(GENERAL)),
        ("parameters", "wheel", len(PER_WHEEL)),
        ("constants", "all", len(ALL)),
    ],
)
def test_each_parameter_and_constant_has_its_row(name: str, argument: str, count: int) -> None:
    assert len(rows(name, argument)) == count
