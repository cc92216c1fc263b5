# SPDX-License-Identifier: Apache-2.0
"""`smallwheel replay` as it is typed: one bag or many, which options go together, and the exit codes.

Tests `replay.py`.
"""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from smallwheel_ros.bags import BagReader
from smallwheel_ros.cli import main
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drive")
    drive = simulate_drive(DriveSettings(seed=5, distance=2.0, wheels="two_sizes"))
    write_drive_bag(drive, folder / "bag")
    return folder / "bag"


@pytest.fixture(scope="module")
def cut(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same bag, whose recorder lost its power half way."""
    folder = tmp_path_factory.mktemp("cut") / "cut"
    shutil.copytree(bag, folder)
    (file,) = folder.glob("*.mcap")
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    return folder


@pytest.fixture
def rover(repository: Path) -> Path:
    return repository / "config" / "two_wheel_sizes.yaml"


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["replay", *map(str, arguments)])


def test_one_bag_begins_with_its_soil_file_and_leaves_it_there(
    bag: Path, rover: Path, tmp_path: Path
) -> None:
    soil = tmp_path / "soil.yaml"
    done = run(
        bag, "--config", rover, "-o", tmp_path / "out", "--copy", "none", "--soil-file", soil
    )
    assert done.exit_code == 0, done.output
    assert json.loads(soil.read_text())["format"] == "smallwheel soil state"
    assert str(tmp_path / "out" / "estimates.csv") in done.output
    assert not (tmp_path / "out" / "replays.json").exists()  # that is of many


@pytest.mark.parametrize("more", [["BAG"], ["--map"], ["--scheduler", "tcp://nowhere:8786"]])
def test_a_soil_file_is_for_one_bag(
    bag: Path, rover: Path, tmp_path: Path, more: list[str]
) -> None:
    given = [tmp_path / "other" if one == "BAG" else one for one in more]
    soil = tmp_path / "soil.yaml"
    done = run(bag, *given, "--config", rover, "-o", tmp_path / "out", "--soil-file", soil)
    assert done.exit_code == 2
    assert "--soil-file is for one bag" in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_folder_is_asked_for_before_anything_is_read(tmp_path: Path) -> None:
    done = run(tmp_path / "no_bag")
    assert done.exit_code == 2
    assert "give -o FOLDER (or --topics)" in done.stderr
    helped = " ".join(run("--help").stdout.split())
    assert "The command needs it, except with --topics" in helped


def test_topics_are_counted_over_the_length_of_the_bag(bag: Path) -> None:
    with BagReader(bag) as reader:
        assert reader.start_time is not None
        assert reader.end_time is not None
        seconds = (reader.end_time - reader.start_time) / 1e9
        counts = {topic.name: topic.message_count for topic in reader.topics}
    done = run(bag, "--topics")
    assert done.exit_code == 0
    assert f"{bag}: {seconds:.1f} s" in done.stdout
    for name, count in counts.items():
        assert re.search(rf"{name}\b.*\b{count}\b.*\b{count / seconds:.1f}\b", done.stdout), name
    content = json.loads(run(bag, "--topics", "--json", "-").stdout)
    assert content["bag"] == str(bag)
    assert content["duration"] == pytest.approx(seconds)
    assert content["damage"] is None or content["damage"] == ""


def test_a_damaged_bag_is_listed_with_exit_code_1(cut: Path) -> None:
    done = run(cut, "--topics")
    assert done.exit_code == 1
    assert "damaged: " in done.stderr
    assert "/odom" in done.stdout
    written = run(cut, "--topics", "--json", "-")
    assert written.exit_code == 0  # the document has it
    assert json.loads(written.stdout)["damage"]


def test_topics_of_several_bags_are_one_document(bag: Path, cut: Path, tmp_path: Path) -> None:
    alone = [json.loads(run(one, "--topics", "--json", "-").stdout) for one in (bag, cut)]
    printed = run(bag, cut, "--topics", "--json", "-")
    assert json.loads(printed.stdout)["bags"] == alone
    done = run(bag, cut, "--topics", "--json", tmp_path / "topics.json")
    assert json.loads((tmp_path / "topics.json").read_text())["bags"] == alone
    assert done.exit_code == 1
    assert f"{cut}: damaged: " in done.stderr
    assert all(f"{one}: " in done.stdout for one in (bag, cut))


def test_a_bag_that_ended_early_is_written_with_exit_code_1(
    cut: Path, rover: Path, tmp_path: Path
) -> None:
    done = run(cut, "--config", rover, "-o", tmp_path / "out", "--copy", "none")
    assert done.exit_code == 1
    assert "ended early: " in done.stderr
    assert (tmp_path / "out" / "estimates.csv").stat().st_size > 1000


def test_where_nothing_can_be_estimated_it_says_what_is_missing(
    bag: Path, rover: Path, tmp_path: Path
) -> None:
    away = ["--remap", "joint_states:=/elsewhere", "--remap", "odom:=/nowhere"]
    away += [x for wheel in WHEELS for x in ("--remap", f"{wheel}/sinkage:=/no_{wheel}")]
    done = run(bag, "--config", rover, "-o", tmp_path / "out", "--copy", "none", *away)
    assert done.exit_code == 2
    assert "nothing can be estimated" in done.stderr
    assert all(name in done.stderr for name in ("/nowhere", "/elsewhere", "/no_rear_left"))


def test_of_many_each_has_a_folder_and_what_failed_is_counted(
    bag: Path, rover: Path, tmp_path: Path
) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"no bag at all")
    out, rest = tmp_path / "out", ("--copy", "none", "--map", "--json", "-")
    done = run(bag, broken, "--config", rover, "-o", out, *rest)
    assert done.exit_code == 1
    assert f"{bag}: complete" in done.stderr
    assert "1 of 2 bags are done, see above for the others" in done.stderr
    document = json.loads((out / "replays.json").read_text())
    assert document == json.loads(done.stdout)
    assert [one["state"] for one in document["bags"]] == ["complete", "failed"]
    assert all((out / name).is_file() for name in document["files"].values())
    assert any(name.endswith(".yaml") for name in document["files"].values())  # the map of all
    assert (out / "bag" / "estimates.csv").is_file()


def test_a_bag_that_failed_alone_leaves_no_table(rover: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"no bag at all")
    done = run(broken, "--map", "--config", rover, "-o", tmp_path / "out", "--copy", "none")
    assert done.exit_code == 2
    assert json.loads((tmp_path / "out" / "replays.json").read_text())["files"] == {}
