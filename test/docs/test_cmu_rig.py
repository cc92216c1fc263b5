# SPDX-License-Identifier: Apache-2.0
"""`examples/cmu_rig.py` on small files of the public repository's form."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from smallwheel_ros.bags import BagWriter, message_type
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.measurements.from_file import read_measurements

START = 1_700_000_000 * 10**9

LAG = 5 * 3600.0


@pytest.fixture(scope="module")
def rig(repository: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("cmu_rig", repository / "examples/cmu_rig.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["cmu_rig"] = module
    spec.loader.exec_module(module)
    return module


def write_forces(path: Path, times: np.ndarray, force: np.ndarray) -> None:
    stamp, header = message_type("builtin_interfaces/msg/Time"), message_type("std_msgs/msg/Header")
    vector, wrench = (
        message_type("geometry_msgs/msg/Vector3"),
        message_type("geometry_msgs/msg/Wrench"),
    )
    kind = "geometry_msgs/msg/WrenchStamped"
    with BagWriter(path) as writer:
        for time, z in zip((START + (times * 1e9).astype(int)).tolist(), force, strict=True):
            message = message_type(kind)(
                header=header(stamp=stamp(sec=time // 10**9, nanosec=time % 10**9), frame_id="ft"),
                wrench=wrench(force=vector(x=1.0, y=2.0, z=float(z)), torque=vector(x=0, y=0, z=0)),
            )
            writer.write("/force", kind, time, message)


def write_trial(folder: Path, name: str, columns: int, zero: float = 7.0) -> None:
    """4 mm/s down from second 2 on, 1 N for each mm; the log's clock lags by 5 h."""
    folder.mkdir(parents=True, exist_ok=True)
    start = folder / f"force-displacement_{name}"
    time = np.arange(0.0, 8.0, 0.01)
    depth = 4.0 * (time - 2.0)  # mm
    write_forces(Path(f"{start}.bag"), time, zero - np.maximum(depth, 0.0))
    write_forces(Path(f"{start}_zero.bag"), time[:50] - 100.0, np.full(50, zero))
    more = ",0" * (columns - 7)
    Path(f"{start}.txt").write_text(
        "".join(
            f"1,2,3,0,{10.0 - z:.9f},{1e3 * t:.0f},{START / 1e9 + t - LAG:.6f}{more}\n"
            for t, z in zip(time[::2], depth[::2], strict=True)
        )
    )


@pytest.fixture
def copy(rig: ModuleType, tmp_path: Path) -> Path:
    """A repository of two trials, one log with the later column, and four rolling rows."""
    folder = tmp_path / "repository"
    write_trial(folder / rig.DATA / "a", "1", 8)
    write_trial(folder / rig.DATA / "b", "6", 7)
    rows = np.zeros(4, dtype=[(name, object) for name in (*rig.FIELDS, "polyx")])
    for i, (beta, slip) in enumerate(((0, -1.0), (0, 0.5), (75, 0.0), (90, 0.2))):
        rows[i] = (2.0, -3.0, 0.1, -20.0, 10.0, 5.0, -12.5, 5.0, float(beta), 1.0, slip,
                   np.ones(2))  # fmt: skip
    savemat(folder / rig.DATA / rig.ROLLING, {"all_results": rows.reshape(-1, 1)})
    (folder / rig.LICENCE).write_text("MIT")
    return folder


def trials(rig: ModuleType) -> tuple[object, ...]:
    # Z is 10 mm where the plate touches; the second is the wheel, with 2 N taken off.
    return (rig.Press("a", "1", 60, 1.0, 6.0, 10.0), rig.Press("b", "6", 0, 1.0, 6.0, 10.0, 2.0))


def test_the_tables_say_what_was_recorded(rig: ModuleType, copy: Path, tmp_path: Path) -> None:
    rig.write_tables(copy, tmp_path, trials(rig))
    pressed = pd.read_csv(tmp_path / "indentation.csv")
    for run, off in (("a_1", 0.0), ("b_6", 2.0)):
        rows = pressed[pressed["run"] == run].iloc[2:-2]
        assert len(rows) > 50
        load, sinkage = rows["load [N]"].to_numpy(), rows["sinkage [m]"].to_numpy()
        assert load + off == pytest.approx(1e3 * sinkage, abs=0.03)
        assert np.diff(rows["t [s]"]) == pytest.approx(0.05, abs=1e-3)
    assert (pressed[["sinkage [m]", "load [N]"]] > 0).all(axis=None)
    plates, wheel = (read_measurements(tmp_path / "indentation.csv").take(rows) for rows in (
        np.flatnonzero(pressed["run"] == "a_1"), np.flatnonzero(pressed["run"] == "b_6")))  # fmt: skip
    assert set(plates.conditions.diameter) == {0.06}
    assert set(wheel.conditions.diameter) == {0.116}
    for name, angles in (
        ("rolling", [0, 0]),
        ("rolling_to_75", [0, 0, 75]),
        ("rolling_smooth_wheel", [0, 0, 75, 90]),
    ):
        table = read_measurements(tmp_path / f"{name}.csv")
        assert np.rad2deg(table.conditions["slip_angle"]) == pytest.approx(angles)
        assert table.channels["sinkage"] == pytest.approx(0.0125)
        assert table.channels["drawbar_pull"] == pytest.approx(3.0)
        assert table.conditions.load == pytest.approx(20.0)
    assert (tmp_path / "LICENSE").read_text() == "MIT"


@pytest.mark.parametrize("lacking", ["mat", "log", "licence", "fields", "no mat at all", "columns"])
def test_what_is_not_that_repository_is_refused_by_its_file(
    rig: ModuleType, copy: Path, tmp_path: Path, lacking: str
) -> None:
    mat, log = copy / rig.DATA / rig.ROLLING, copy / rig.DATA / "a" / "force-displacement_1.txt"
    file = {"log": log, "columns": log, "licence": copy / rig.LICENCE}.get(lacking, mat)
    if lacking == "fields":
        savemat(mat, {"all_results": np.ones(3)})
    elif lacking == "no mat at all":
        mat.write_text("version https://git-lfs.github.com/spec/v1\n")
    elif lacking == "columns":
        log.write_text("1,2,3,4,5,6,7,8,9\n")
    else:
        file.unlink()
    with pytest.raises(SmallwheelError, match="expected") as refused:
        rig.write_tables(copy, tmp_path / "out", trials(rig))
    assert str(file) in str(refused.value)


def test_the_public_files_give_the_shared_tables(
    rig: ModuleType, shared_data: Path, tmp_path: Path
) -> None:
    """One trial is there as it was recorded: the same rows come of it."""
    raw = shared_data / "cmu_wheel_rig" / "raw"
    folder = tmp_path / rig.DATA
    folder.mkdir()
    (folder / "force-displacement").symlink_to(raw)
    press = next(t for t in rig.TRIALS if (t.folder, t.name) == ("force-displacement", "6"))
    made = rig.indentation(tmp_path, (press,))
    known = pd.read_csv(shared_data / "cmu_wheel_rig" / "indentation.csv")
    known = known[known["run"] == "fd_fd_6"]
    assert len(made) == len(known) == 268
    for name in ("sinkage [m]", "load [N]"):
        assert made[name].to_numpy() == pytest.approx(known[name].to_numpy(), abs=1e-6)
