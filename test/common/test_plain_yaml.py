# SPDX-License-Identifier: Apache-2.0
"""The one reader of YAML: what is no plain text of names and decimal numbers is refused by line."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.cli import main
from smallwheel_ros.common.files import LARGEST
from smallwheel_ros.common.plain_yaml import PlainYamlError, parse_yaml, read_yaml, write_yaml

BOMB = "a0: &a0 [x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 10)
)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0", 0),
        ("-12", -12),
        ("1.", 1.0),
        (".5", 0.5),
        ("1e-3", 1e-3),
        ("+1.5E6", 1.5e6),
        ("'010'", "010"),
        ('"1:30"', "1:30"),
        ("2026-11-22", "2026-11-22"),
        ("front_1", "front_1"),
        ("yes", True),
        ("~", None),
        ("<<", "<<"),
    ],
)
def test_plain_values(text: str, value: object) -> None:
    found = parse_yaml(f"a: {text}\n")["a"]
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: 1\nb: 010", "line 2: number '010', expected decimal digits"),
        ("a: 0x1F", "number '0x1F'"),
        ("a: 0b11", "number '0b11'"),
        ("a: 0o17", "number '0o17'"),
        ("a: 1:30", "number '1:30'"),
        ("a: 1:30:00.5", "number '1:30:00.5'"),
        ("a: 1_000", "number '1_000'"),
        ("a: 1_0.5", "number '1_0.5'"),
        ("a: ٣", "number '٣'"),
        ("a: ٣.٥", "number '٣.٥'"),
        ("a: " + "9" * 5000, "number '9999"),
        ("a: !!int foo", "line 1: tag"),
        ("a: !!python/object:os.system x", "tag"),
        ("a: ! 5", "tag"),
        ("a: &x 1\nb: 2", "anchors and aliases"),
        (BOMB, "anchors and aliases"),
        ("a: *x", "anchors and aliases"),
        ("[" * 10_000, "more than 20 levels"),
        ("".join(f"{' ' * i}a:\n" for i in range(50)), "more than 20 levels"),
        ("a: {b: 1, b: 2}", "key 'b' is there twice"),
        ("? [a, b]\n: 1", "a key is a list or a mapping"),
        ("--- 1\n--- 2", "another document"),
        ("a: \x07", "not YAML text"),
    ],
)
def test_refusals(text: str, words: str) -> None:
    with pytest.raises(PlainYamlError, match="not YAML text") as caught:
        parse_yaml(text)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**17), 10**17)
    | st.floats(allow_nan=False)
    | st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc")))
    | st.sampled_from(["010", "1:30", "1_000", "٣", "1e3", "no", "~", "&a", "*a", "!b", "<<"]),
    lambda inner: st.lists(inner) | st.dictionaries(st.text("abc", min_size=1), inner),
    max_leaves=10,
)


@given(plain)
def test_what_is_written_is_read_as_the_same(value: Any) -> None:
    assert parse_yaml(write_yaml({"value": value})) == {"value": value}


def test_nothing_but_a_small_file_is_read(tmp_path: Path) -> None:
    with pytest.raises(PlainYamlError, match="a device or a pipe"):
        read_yaml("/dev/zero")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(PlainYamlError, match="a device or a pipe"):
        read_yaml(tmp_path / "pipe")
    with pytest.raises(PlainYamlError, match="directory"):
        read_yaml(tmp_path)
    with pytest.raises(PlainYamlError, match="name is not possible"):
        read_yaml("a\0b")
    (tmp_path / "large").write_text("#" * (LARGEST + 1))
    with pytest.raises(PlainYamlError, match="more than 1000000 bytes"):
        read_yaml(tmp_path / "large")
    (tmp_path / "latin").write_bytes(b"a: \xe9")
    with pytest.raises(PlainYamlError, match="not YAML text"):
        read_yaml(tmp_path / "latin")


@pytest.mark.parametrize(
    "text", [BOMB, "a: !!int foo", "[" * 10_000, "/**:\n ros__parameters:\n  load_sign: 01\n"]
)
def test_replay_ends_with_one_message(tmp_path: Path, text: str) -> None:
    config = tmp_path / "rover.yaml"
    config.write_text(text)
    arguments = ["replay", str(tmp_path), "--config", str(config), "-o", str(tmp_path / "out")]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 2
    assert f"{config}: not YAML text: line" in result.output
