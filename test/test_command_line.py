# SPDX-License-Identifier: Apache-2.0
"""The command `smallwheel` and `python -m smallwheel_ros`, and what is read of typed arguments.

Tests `__main__.py`, `arguments.py` and `cli.py`.
"""

from __future__ import annotations

import subprocess
import sys
from typing import get_type_hints

import pytest
from click.testing import CliRunner

from smallwheel_ros import arguments, cli
from smallwheel_ros.common.errors import ArgumentError


def test_the_module_is_the_command() -> None:
    command = [sys.executable, "-m", "smallwheel_ros", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("Usage: smallwheel ")
    assert all(name in done.stdout for name in cli.COMMANDS)


def test_bad_input_is_one_message_and_exit_code_2() -> None:
    done = CliRunner().invoke(cli.main, ["diagnose", "no_such_file.csv"])
    assert done.exit_code == 2
    assert "no_such_file.csv" in done.stderr
    assert "Traceback" not in done.stderr
    done = CliRunner().invoke(cli.main, ["dianose"])
    assert done.exit_code == 2
    assert "did you mean 'diagnose'" in done.stderr


def test_each_command_is_there() -> None:
    for name in cli.COMMANDS:
        assert cli.main.get_command(None, name) is not None, name  # type: ignore[arg-type]


def kind(name: str) -> arguments.Kind:
    found: arguments.Kind = getattr(arguments, name).__metadata__[0]
    return found


def test_pairs_are_read_once_each() -> None:
    read = kind("OtherSetting").read
    assert read is not None
    assert read(["speed=0.1", "slope = 10 deg"]) == {"speed": "0.1", "slope": "10 deg"}
    for text, message in ((["speed"], "NAME=VALUE"), (["a=1", "a=2"], "twice")):
        with pytest.raises(ArgumentError, match=message):
            read(text)


def test_lists_of_names_may_have_spaces() -> None:
    read = kind("Ids").read
    assert read is not None
    assert read("a, b,,c ") == ("a", "b", "c")
    assert get_type_hints(arguments.Kind)["metavar"] is not None
