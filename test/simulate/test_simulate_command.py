# SPDX-License-Identifier: Apache-2.0
"""Tests `command.py` and `options.py`."""

from __future__ import annotations

import json

import pandas as pd
import pytest
from click.testing import CliRunner

from smallwheel_ros.bags import BagReader
from smallwheel_ros.cli import main


def run(*arguments):
    result = CliRunner().invoke(main, ["simulate", *(str(a) for a in arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def test_rig_writes_table_and_answer_apart(tmp_path):
    table = tmp_path / "rig.csv"
    result = run("rig", "-o", table, "--hidden", "slip_sinkage,bulldozing", "--seed", 7)
    assert result.exit_code == 0
    assert "32 runs, 96 rows" in result.output
    assert len(pd.read_csv(table)) == 96
    answer = json.loads((tmp_path / "rig.csv.answer.json").read_text())
    assert [e["effect"] for e in answer["hidden"]] == ["slip_sinkage", "bulldozing"]
    assert "slip_sinkage" not in table.read_text()
    assert sorted(f.name for f in tmp_path.iterdir()) == ["rig.csv", "rig.csv.answer.json"]


def test_a_hidden_effect_takes_its_size(tmp_path):
    table = tmp_path / "rig.csv"
    result = run("rig", "-o", table, "--hidden", "slip_sinkage,load_offset=-4", "--strength", 0.5)
    assert result.exit_code == 0, result.output
    answer = json.loads((tmp_path / "rig.csv.answer.json").read_text())
    assert [e["effect"] for e in answer["hidden"]] == ["slip_sinkage", "load_offset"]
    assert answer["hidden"][1]["amplitude"] == -4.0


def test_rig_summary_as_json(tmp_path):
    table, answer = tmp_path / "rig.parquet", tmp_path / "truth.json"
    result = run("rig", "-o", table, "--answer", answer, "--runs", 5, "--json", "-")
    assert result.exit_code == 0
    assert json.loads(result.output)["rows"] == 15 == len(pd.read_parquet(table))
    assert answer.exists()
    assert run("rig", "-o", table, "--json", tmp_path / "s.json").exit_code == 0
    assert json.loads((tmp_path / "s.json").read_text())["runs"] == 32


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_drive_writes_bag_and_answer_apart(tmp_path, storage):
    bag = tmp_path / "drive"
    result = run("drive", "-o", bag, "--distance", 3, "--storage", storage, "--hidden", "multipass")
    assert result.exit_code == 0, result.output
    with BagReader(bag) as reader:
        assert reader.message_count == sum(1 for _ in reader.messages()) > 1000
    answer = json.loads((tmp_path / "drive.answer.json").read_text())
    assert answer["hidden"][0]["effect"] == "multipass"
    assert sorted(f.name for f in tmp_path.iterdir()) == ["drive", "drive.answer.json"]
    again = run("drive", "-o", bag, "--distance", 3)
    assert again.exit_code == 2
    assert "exists already" in again.output


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (["rig", "-o", "x.csv", "--hidden", "bulldosing"], "did you mean 'bulldozing'"),
        (["rig", "-o", "x.csv", "--hidden", "load_offset=much"], "its size is 'much'"),
        (["rig", "-o", "x.csv", "--runs", "-1"], "runs is -1"),
        (["rig", "-o", "x.csv", "--runs", "many"], "'many' is not a valid integer"),
        (["rig", "-o", "x.csv", "--noise", "2"], "noise is 2.0"),
        (["rig", "-o", "x.csv", "--tie", "slip,lode"], "did you mean 'load'"),
        (["rig", "-o", "x.csv", "--channels", "sinkage,sinkage"], "each once"),
        (["rig", "-o", "x.xlsx"], ".csv or .parquet"),
        (["rig", "-o", "missing/x.csv"], "folder missing does not exist"),
        (["rig", "-o", "x.csv", "--answer", "missing/a.json"], "folder missing does not exist"),
        (["rig", "-o", "x.csv", "--answer", "x.csv"], "two outputs name the same file"),
        (["rig", "-o", "x.csv", "--json", "missing/a.json"], "folder missing does not exist"),
        (["rig"], "--output"),
        (["drive", "-o", "missing/bag"], "folder missing does not exist"),
        (["drive", "-o", "bag", "--wheels", "six"], "one of four, two_sizes"),
        (["drive", "-o", "bag", "--distance", "nan"], "distance is nan"),
        (["drive", "-o", "bag", "--hidden", "moisture"], "simulate rig"),
        (["drive", "-o", "bag", "--hidden", "load_offset=-4"], "simulate rig"),
        (["drive", "-o", "bag", "--storage", "csv"], "'csv' is not one of"),
    ],
)
def test_bad_input_is_one_message_and_exit_code_2(arguments, match, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run(*arguments)
    assert result.exit_code == 2
    assert match in result.output
    assert "Traceback" not in result.output
    assert list(tmp_path.iterdir()) == []


def test_an_older_table_stays_when_the_new_one_fails(tmp_path):
    table = tmp_path / "rig.csv"
    assert run("rig", "-o", table).exit_code == 0
    before = table.read_bytes()
    assert run("rig", "-o", table, "--strength", 99).exit_code == 2
    assert table.read_bytes() == before
    assert run("rig", "-o", table, "--seed", 5).exit_code == 0
    assert table.read_bytes() != before
