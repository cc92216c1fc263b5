# SPDX-License-Identifier: Apache-2.0
"""Killed at each step of writing: what was there is whole, old or new, and the next try succeeds."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from lab_truth import plate_rows, write
from rows_of_drives import drive, rover, run

import smallwheel_ros as sw
from smallwheel_ros.bags import BagReader
from smallwheel_ros.cli import main
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.simulate import DriveSettings, simulate_drive, write_drive_bag

VEHICLE = rover()
KILLED = -signal.SIGKILL
STEPS = ("open", "os.rename", "os.remove", "os.mkdir", "os.chmod", "os.truncate", "shutil.rmtree")
MOST = 500


def killed_at(step: int, work: Callable[[], object]) -> int:
    """Do the work in a process of its own that is killed before its n-th step on files."""
    child = os.fork()
    if child == 0:
        left = step

        def hook(event: str, arguments: object) -> None:
            nonlocal left
            if event in STEPS:
                if left == 0:
                    os.kill(os.getpid(), signal.SIGKILL)
                left -= 1

        try:
            sys.addaudithook(hook)
            work()
        except BaseException:  # nothing of pytest may run on in the child
            os._exit(1)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def each_kill(work: Callable[[], object], every: int = 1) -> Iterator[int]:
    """Kill the work before its first step on files, its second, ... until it ends by itself."""
    for step in range(0, MOST, every):
        code = killed_at(step, work)
        assert code in (0, KILLED)
        yield step
        if code == 0:
            return
    pytest.fail(f"not done after {MOST} steps")


def seen_by_people(folder: Path) -> set[str]:
    """Names in a folder but for hidden drafts, which who is killed leaves behind."""
    return {file.name for file in folder.iterdir() if not file.name.startswith(".")}


@cache
def driven(seconds: float) -> Pipeline:
    pipeline = Pipeline(VEHICLE.onboard)
    run(VEHICLE, drive(seconds), pipeline=pipeline)
    return pipeline


def test_a_saved_soil_is_the_old_or_the_new_one(tmp_path: Path) -> None:
    path = tmp_path / "soil.json"
    old, new = driven(12.0), driven(20.0)
    old.save(path)
    before = path.read_bytes()
    new.save(tmp_path / "other.json")
    after = (tmp_path / "other.json").read_bytes()
    seen = set()
    for _ in each_kill(lambda: new.save(path)):
        assert path.read_bytes() in (before, after)
        Pipeline(VEHICLE.onboard).restore(path)
        seen.add(path.read_bytes())
    assert path.read_bytes() == after
    assert seen == {before, after}  # it was killed before and behind the step that counts
    assert seen_by_people(tmp_path) == {"soil.json", "other.json"}


def test_who_is_killed_saving_spoils_nothing_of_who_saves_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two nodes with one file: the other is killed at each step while this one is about to finish."""
    path = tmp_path / "soil.json"
    ours, other = driven(12.0), driven(20.0)
    ours.save(path)
    whole = path.read_bytes()
    other.save(path)
    others = path.read_bytes()
    to_disk = os.fsync
    for step in range(MOST):
        codes: list[int] = []

        def meanwhile(descriptor: int, step: int = step, codes: list[int] = codes) -> None:
            monkeypatch.setattr(os, "fsync", to_disk)
            to_disk(descriptor)
            codes.append(killed_at(step, lambda: other.save(path)))

        monkeypatch.setattr(os, "fsync", meanwhile)
        ours.save(path)
        assert path.read_bytes() == whole != others
        if codes == [0]:
            break
    assert codes == [0]
    assert step > 3  # it was killed with its draft begun, and whole
    assert seen_by_people(tmp_path) == {"soil.json"}


def test_a_result_is_the_old_or_the_new_one(tmp_path: Path) -> None:
    rows = plate_rows(np.random.default_rng(0), rows=6)
    fitted = sw.fit(write(tmp_path / "plates.csv", rows))
    for suffix in (".yaml", ".json", ".csv"):
        path = tmp_path / f"result{suffix}"
        fitted.save(path)
        after, before = path.read_bytes(), b"old"
        path.write_bytes(before)
        for _ in each_kill(lambda path=path: fitted.save(path)):
            assert path.read_bytes() in (before, after)
        assert path.read_bytes() == after


@pytest.mark.slow
def test_a_replay_that_was_killed_can_be_made_again(repository: Path, tmp_path: Path) -> None:
    bag, out = tmp_path / "drive", tmp_path / "out"
    short = DriveSettings(seed=1, distance=2.0, wheels="two_sizes", terrain="single")
    write_drive_bag(simulate_drive(short), bag)
    config = repository / "config" / "two_wheel_sizes.yaml"
    arguments = ["replay", *map(str, (bag, "--config", config, "-o", out))]

    def replay() -> None:
        result = CliRunner().invoke(main, arguments)
        assert result.exit_code == 0, result.output

    replay()
    whole = (out / "estimates.csv").read_bytes()
    tables = set()
    for _ in each_kill(replay, every=9):
        table = out / "estimates.csv"
        tables.add(table.read_bytes() if table.exists() else None)
        assert tables <= {whole, None}  # a table of that name is a whole one
    replay()
    assert (out / "estimates.csv").read_bytes() == whole
    assert not list(out.glob(".*"))
    assert not list(out.glob("*.part"))
    with BagReader(out / "bag") as reader:
        assert list(reader.messages())
