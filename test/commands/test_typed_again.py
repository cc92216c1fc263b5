# SPDX-License-Identifier: Apache-2.0
"""What somebody typed, as words to type again: `typed.py`."""

from __future__ import annotations

import shlex

import click
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.commands.typed import RememberedCommand, typed_again


@click.command(cls=RememberedCommand)
@click.argument("tables", nargs=-1)
@click.option("--map", multiple=True)
@click.option("-s", "--seed", type=int, default=0)
@click.option("--clock/--no-clock", default=True)
@click.option("--html")
@click.option("--more", is_flag=True)
def command(**_: object) -> None:
    """Print what was typed, without the outputs."""
    click.echo(typed_again({"tables", "map", "seed", "clock"}, "--more"), nl=False)


def again(*words: str) -> list[str]:
    done = CliRunner().invoke(command, list(words), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    words = shlex.split(done.output)
    words.remove("--more")
    return words


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("a.csv", "a.csv"),
        ("--html r.html a.csv", "a.csv"),
        ("a.csv --map x=1 b.csv --map=y=2", "a.csv b.csv --map x=1 --map y=2"),
        ("-s3 a.csv", "a.csv --seed 3"),
        ("a.csv --no-clock", "a.csv --no-clock"),
        ("a.csv --clock", "a.csv --clock"),
        ("--html r.html -- -a.csv", "-- -a.csv"),
        ("-s 3 -- -a.csv", "--seed 3 -- -a.csv"),
    ],
)
def test_options_keep_their_values_and_outputs_go(typed: str, expected: str) -> None:
    assert again(*shlex.split(typed)) == shlex.split(expected)


_WORD = st.text(st.characters(codec="utf-8", exclude_categories=("Cc", "Cs")), min_size=1)


@given(st.lists(_WORD, min_size=1, max_size=3), st.lists(_WORD, max_size=3))
def test_what_is_typed_again_means_the_same(tables: list[str], headers: list[str]) -> None:
    options = [f"--map={header}" for header in headers]
    first = again(*options, "--", *tables)
    assert again(*first) == first
    assert {*tables, *headers} <= {*first}
