# SPDX-License-Identifier: Apache-2.0
"""Many bags, interruptions, a full disk, a cluster.

Tests `many.py`.
"""

from __future__ import annotations

import importlib.util
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from bag_kinds import beginning
from click.testing import CliRunner, Result

from rates.speed import again_and_again
from smallwheel_ros.bags import BagReader, BagWriter
from smallwheel_ros.cli import main
from smallwheel_ros.costmap.grid import read_map
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.replay.many import Outcome, merge, outcome_of
from smallwheel_ros.replay.spec import ReplaySpec
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

COMMAND = [sys.executable, "-m", "smallwheel_ros.cli", "replay"]
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
MOBILITY = {f"/mobility_estimator/{wheel}/mobility" for wheel in WHEELS}


@pytest.fixture(scope="module")
def rover(repository) -> Path:
    return repository / "config" / "two_wheel_sizes.yaml"


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> list[Path]:
    """The beginnings of three drives on one soil each, as single files."""
    folder = tmp_path_factory.mktemp("bags")
    files = []
    for seed in (1, 2, 3):
        drive = DriveSettings(seed=seed, distance=3.0, wheels="two_sizes", terrain="single")
        write_drive_bag(simulate_drive(drive), folder / f"whole_{seed}")
        beginning(folder / f"whole_{seed}", folder / f"drive_{seed}", 14.0)
        files.append(folder / f"drive_{seed}.mcap")
        (folder / f"drive_{seed}" / f"drive_{seed}.mcap").rename(files[-1])
    return files


@pytest.fixture(scope="module")
def long_bag(bags, tmp_path_factory) -> Path:
    """One drive that takes some seconds to replay: a short one, again and again on its way."""
    return again_and_again(bags[0], tmp_path_factory.mktemp("long") / "long", 15)


def smallwheel(*arguments: object, code: int = 0):
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == code, (result.output, result.exception)
    return result


def states(folder: Path) -> dict[str, str]:
    content = json.loads((folder / "replays.json").read_text())
    return {Path(entry["bag"]).name: entry["state"] for entry in content["bags"]}


def assert_merged(folder: Path, names: list[str]) -> None:
    """The merged tables are those of the single bags, one after the other."""
    merged = pd.read_csv(folder / "estimates.csv", float_precision="round_trip")
    assert list(merged["bag"].unique()) == names
    for name, rows in merged.groupby("bag"):
        single = pd.read_csv(folder / name / "estimates.csv", float_precision="round_trip")
        pd.testing.assert_frame_equal(
            rows.drop(columns="bag").reset_index(drop=True), single, check_dtype=False
        )
    read_measurements(folder / "measurements.csv")
    measured = pd.read_csv(folder / "measurements.csv")
    assert {run.split()[0] for run in measured["run"]} <= set(names)
    sizes = [len(pd.read_csv(folder / n / "measurements.csv")) for n in names
             if (folder / n / "measurements.csv").exists()]  # fmt: skip
    assert len(measured) == sum(sizes)


# --- Many bags


def with_a_bad_one(folder: Path, bags, rover, jobs: int) -> Result:
    """Replay two bags, and one between them that is none, into a folder."""
    (folder / "bad.mcap").write_bytes(b"no bag at all")
    return smallwheel(
        "replay", bags[0], folder / "bad.mcap", bags[1],
        "--config", rover, "-o", folder / "out", "--jobs", jobs, code=1,
    )  # fmt: skip


@pytest.fixture(scope="module")
def failed(bags, rover, tmp_path_factory) -> tuple[Path, Result]:
    """The first two bags replayed, and one that is none: the folder, and what was said."""
    folder = tmp_path_factory.mktemp("failed")
    return folder, with_a_bad_one(folder, bags, rover, 1)


def test_no_estimate_of_a_long_bag_is_lost_in_the_joined_table(tmp_path):
    """Four wheels at 10 Hz have 250,000 estimates after 104 minutes; an older joined table is replaced."""
    counts = {"long": 250_000, "short": 7}
    for name, count in counts.items():
        (tmp_path / name).mkdir()
        pd.DataFrame({"travel": range(count)}).to_csv(
            tmp_path / name / "estimates.csv", index=False
        )
    (tmp_path / "estimates.csv").write_text("bag,travel\nold,1\n")
    merge(tmp_path, [Outcome(f"{n}.mcap", str(tmp_path / n), "complete") for n in counts])
    merged = pd.read_csv(tmp_path / "estimates.csv")
    assert merged.groupby("bag").size().to_dict() == counts
    assert merged["travel"].tolist() == [*range(250_000), *range(7)]


def test_bags_of_one_site_make_one_map_and_the_newest_is_on_top(bags, rover, failed, tmp_path):
    out = shutil.copytree(failed[0] / "out", tmp_path / "out")  # two of them are done
    printed = smallwheel("replay", *bags, "--config", rover, "-o", out, "--map").output
    assert "cost_map.yaml" in printed
    assert json.loads((out / "replays.json").read_text())["files"]["cost_map"] == "cost_map.yaml"
    folders = [out / f"drive_{i}" for i in (1, 2, 3)]
    folders.sort(key=lambda folder: json.loads((folder / "replay.json").read_text())["start"])
    parts = [read_map(folder / "cost_map.yaml") for folder in folders]
    whole = read_map(out / "cost_map.yaml")
    assert whole.frame == "odom"
    for part in parts:
        known = np.argwhere(part.cells >= 0)
        for row, column in known[:: max(len(known) // 50, 1)]:
            x = part.origin[0] + (column + 0.5) * part.resolution
            y = part.origin[1] + (row + 0.5) * part.resolution
            cell = whole.cells[whole.cell(x, y)]
            assert cell >= 0
            assert cell == 100 or part is not parts[-1] or cell == part.cells[row, column]
    # Another frame: said, and what there was stays.
    path = out / "drive_1" / "cost_map.yaml"
    path.write_text(path.read_text().replace("frame: odom", "frame: map"))
    arguments = ("replay", *bags, "--config", rover, "-o", out, "--map")
    found = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert found.exit_code == 2
    assert "expected maps in one frame, found" in found.output
    assert all(f"{frame} (" in found.output for frame in ("map", "odom"))
    assert (out / "drive_3" / "cost_map.yaml").exists()


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_failed_bag_is_reported_and_the_others_kept(bags, rover, failed, tmp_path, jobs):
    if jobs == 1:
        result = failed[1]
        shutil.copytree(failed[0], tmp_path, dirs_exist_ok=True)
    else:
        result = with_a_bad_one(tmp_path, bags, rover, jobs)
    bad, out = tmp_path / "bad.mcap", tmp_path / "out"
    assert "bad.mcap: cannot be read" in result.stderr
    assert "2 of 3 bags are done" in result.stderr
    assert all(f"{bag}: complete" in result.stderr for bag in bags[:2])  # each when it is done
    expected = {bag.name: "complete" for bag in bags[:2]} | {"bad.mcap": "failed"}
    assert states(out) == expected
    assert_merged(out, ["drive_1", "drive_2"])

    # What is done is not done again, and a bag that is mended meanwhile is.
    before = (out / "drive_1" / "estimates.csv").stat().st_mtime_ns
    bad.write_bytes(bags[0].read_bytes())
    result = smallwheel(
        "replay", bags[0], bad, bags[1], "--config", rover, "-o", out, "--jobs", jobs
    )
    assert (out / "drive_1" / "estimates.csv").stat().st_mtime_ns == before
    assert result.stdout.count("(before)") == 2
    assert set(states(out).values()) == {"complete"}


def test_drives_that_tell_the_pass_and_drives_that_do_not_make_one_table(rover, tmp_path):
    names = ["without_places", "with_places"]
    drive = DriveSettings(seed=9, distance=6.0, wheels="two_sizes", terrain="single")
    write_drive_bag(simulate_drive(drive), tmp_path / names[1])
    jumped = 0.0
    with BagReader(tmp_path / names[1]) as reader, BagWriter(tmp_path / names[0]) as writer:
        for topic, kind, log_time, message in reader.messages():
            if topic == "/odom":
                jumped += 2.0  # of a track that begins anew nothing is known
                message.pose.pose.position.x += jumped
            writer.write(topic, kind, log_time, message)
    out, drives = tmp_path / "out", [tmp_path / name for name in names]
    smallwheel("replay", *drives, "--config", rover, "-o", out)
    columns = [pd.read_csv(out / name / "measurements.csv").columns for name in names]
    assert ["pass_number" in found for found in columns] == [False, True]
    assert_merged(out, names)
    assert list(pd.read_csv(out / "measurements.csv")) == list(columns[0])


def test_other_parameters_are_another_replay(bags, rover, tmp_path):
    out, other = tmp_path / "out", tmp_path / "other.yaml"
    smallwheel("replay", bags[0], "--config", rover, "-o", out)
    first = pd.read_csv(out / "estimates.csv")
    other.write_text(rover.read_text().replace("name: dry_sand", "name: wong_snow"))
    result = smallwheel("replay", bags[0], "--config", other, "-o", out)
    assert "(before)" not in result.stdout
    assert not first["soil_k"].equals(pd.read_csv(out / "estimates.csv")["soil_k"])


def test_bags_of_one_name_are_refused(bags, rover, tmp_path):
    (tmp_path / "drive_1.mcap").write_bytes(bags[0].read_bytes())
    arguments = (bags[0], tmp_path / "drive_1.mcap", "--config", rover, "-o", tmp_path / "out")
    assert "have one name, drive_1" in smallwheel("replay", *arguments, code=2).stderr


def test_a_process_that_dies_costs_only_its_own_bag(bags, rover, tmp_path):
    """A bag whose process is killed, as by a lack of memory."""
    out = tmp_path / "out"
    process = started(*bags[:2], "--config", rover, "-o", out, "--jobs", 1)
    wait_for(out / "drive_1" / ".replay", 100, process)
    (worker,) = subprocess.check_output(["pgrep", "-P", str(process.pid)], text=True).split()
    os.kill(int(worker), signal.SIGKILL)
    _, stderr = process.communicate(timeout=120)
    assert process.returncode == 1, stderr
    assert "drive_1.mcap: the process that replayed it died (signal 9)" in stderr
    assert states(out) == {"drive_1.mcap": "failed", "drive_2.mcap": "complete"}


# --- Interruptions


def started(*arguments: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def wait_for(path: Path, size: int, process: subprocess.Popen[str]) -> None:
    """Wait until a file has grown so far: the work is in its midst."""
    end = time.monotonic() + 120
    while not (path.exists() and path.stat().st_size > size):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)]
)
def test_interrupted_leaves_what_was_finished(long_bag, rover, tmp_path, number):
    out = tmp_path / "out"
    process = started(long_bag, "--config", rover, "-o", out, "--copy", "none")
    wait_for(out / ".replay", 100, process)
    process.send_signal(number)
    _, stderr = process.communicate(timeout=120)
    assert process.returncode == 1, stderr
    assert "the same command does all of it" in stderr
    assert "Traceback" not in stderr
    summary = json.loads((out / "replay.json").read_text())
    assert summary["state"] == "interrupted"
    table = pd.read_csv(out / "estimates.csv")
    assert 0 < len(table) == summary["estimates"]
    with BagReader(out / "bag") as reader:
        assert sum(1 for _ in reader.messages(MOBILITY)) == len(table)
    assert "interrupted" in (out / "report.html").read_text()


def test_killed_leaves_what_was_there_and_the_same_command_does_all(bags, rover, tmp_path):
    out = tmp_path / "out"
    smallwheel("replay", bags[0], "--config", rover, "-o", out)
    before = (out / "estimates.csv").read_bytes()
    process = started(bags[1], "--config", rover, "-o", out)
    wait_for(out / ".replay", 100, process)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait(30)
    assert (out / "estimates.csv").read_bytes() == before
    smallwheel("replay", bags[1], "--config", rover, "-o", out)
    summary = json.loads((out / "replay.json").read_text())
    assert (summary["state"], summary["bag"]) == ("complete", str(bags[1]))
    assert not list(out.glob(".*"))


@pytest.mark.slow
def test_many_interrupted_are_resumed(bags, long_bag, rover, tmp_path):
    out = tmp_path / "out"
    arguments = (bags[0], long_bag, bags[1], "--config", rover, "-o", out, "--jobs", 2)
    process = started(*arguments, "--copy", "none")
    wait_for(out / "long" / ".replay", 100, process)
    wait_for(out / "drive_1" / "replay.json", 2000, process)
    os.killpg(process.pid, signal.SIGINT)  # Ctrl-C goes to all processes of the terminal
    _, stderr = process.communicate(timeout=120)
    assert process.returncode == 1, stderr
    assert "the same command does the rest" in stderr
    assert "Traceback" not in stderr
    found = states(out)
    assert found["drive_1.mcap"] == "complete"
    assert found["long"] in ("interrupted", "not_begun")
    result = smallwheel("replay", *arguments, "--copy", "none")
    assert "complete (before)" in result.stdout
    assert set(states(out).values()) == {"complete"}


@pytest.mark.parametrize("state", ["interrupted", "complete", "ended_early"])
def test_a_result_of_other_options_is_none_of_this_replay(bags, rover, tmp_path, state):
    """Before, what an interrupted run with other parameters had left was listed as this run's."""
    spec = ReplaySpec(bags[0], rover, tmp_path)
    left = {"state": state, "ended": "by Ctrl-C", "fingerprint": spec.fingerprint()}
    (tmp_path / "replay.json").write_text(json.dumps(left))
    assert outcome_of(spec).state == state
    assert outcome_of(ReplaySpec(bags[0], rover, tmp_path, rate=5.0)).state == "not_begun"


def test_a_full_disk_is_one_message(bags, rover, tmp_path):
    def little_room() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))

    command = [*COMMAND, str(bags[0]), "--config", str(rover), "-o", str(tmp_path / "out")]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=120, preexec_fn=little_room
    )
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert "cannot be" in done.stderr
    assert not list((tmp_path / "out").iterdir())


# --- A cluster

NO_DASK = importlib.util.find_spec("distributed") is None


@pytest.mark.slow
@pytest.mark.skipif(NO_DASK, reason="needs dask.distributed: pip install distributed")
def test_a_cluster_of_two_processes(bags, rover, tmp_path):
    from distributed import LocalCluster

    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"no bag at all")
    out = tmp_path / "out"
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None,
        local_directory=tmp_path,
    ) as cluster:  # fmt: skip
        arguments = ("replay", bad, *bags[:2], "--config", rover, "-o", out,
                     "--scheduler", cluster.scheduler_address)  # fmt: skip
        result = smallwheel(*arguments, code=1)
        assert "bad.mcap: cannot be read" in result.stderr
        assert states(out) == {bag.name: "complete" for bag in bags[:2]} | {"bad.mcap": "failed"}
        assert_merged(out, ["drive_1", "drive_2"])
    # The same as on this machine alone.
    smallwheel("replay", bags[0], "--config", rover, "-o", tmp_path / "alone")
    one = (tmp_path / "alone" / "estimates.csv").read_text()
    assert (out / "drive_1" / "estimates.csv").read_text() == one


def test_no_cluster_is_one_message(bags, rover, tmp_path):
    arguments = ("replay", bags[0], "--config", rover, "-o", tmp_path / "out")
    result = smallwheel(*arguments, "--scheduler", "tcp://127.0.0.1:9", code=2)
    expected = "dask.distributed" if NO_DASK else "no Dask scheduler answers at tcp://127.0.0.1:9"
    assert expected in result.stderr
