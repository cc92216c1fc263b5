# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import importlib.util
import math
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from click.testing import CliRunner
from readings import Given as Onboard

from smallwheel_ros.bags import BagReader, BagWriter, message_type
from smallwheel_ros.cli import main
from smallwheel_ros.onboard.parameters import read_parameters, settings_from
from smallwheel_ros.replay.trial import Trial, TrialError, TrialSettings, read_trial, write_trial

START = 1_700_000_000 * 10**9
RIG = TrialSettings(log_behind=14400.0, start=6.42, end=19.8)


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


@pytest.fixture
def files(tmp_path: Path) -> dict[str, Path]:
    """A made-up trial: 5 mm/s down from second 2 to 6, W = 10^6 z^1.5, sensor zero at 7 N."""
    time = np.arange(0.0, 8.0, 0.01)
    depth = np.clip(0.005 * (time - 2.0), -0.01, 0.02)
    load = 1e6 * np.maximum(depth, 0.0) ** 1.5
    paths = {name: tmp_path / name for name in ("trial", "zero", "axis.txt")}
    write_forces(paths["trial"], time, 7.0 - load)
    write_forces(paths["zero"], time[:100] - 100.0, 7.0 + 0.1 * (-1.0) ** np.arange(100))
    # the log's clock is 20 s behind
    lines = [
        f"1,2,3,0,{-1e3 * z:.9f},{1e3 * t:.0f},{1.7e9 + t - 20.0:.6f}"
        for t, z in zip(time[::2], depth[::2], strict=True)
    ]
    paths["axis.txt"].write_text("\n".join(lines) + "\n")
    return paths


MADE_UP = TrialSettings(wheel="rig", log_behind=20.0, start=1.5, end=5.5)


def read(files: dict[str, Path], settings: TrialSettings = MADE_UP) -> Trial:
    return read_trial(files["trial"], files["zero"], files["axis.txt"], settings)


class TestRead:
    def test_load_and_sinkage(self, files: dict[str, Path]) -> None:
        trial = read(files)
        assert trial.zero == pytest.approx(7.0)
        assert trial.load_time[0] == pytest.approx(START + 1.5e9, abs=1e7)
        assert trial.load_time[-1] == pytest.approx(START + 5.5e9, abs=1e7)
        at = (trial.sinkage_time - START) / 1e9
        np.testing.assert_allclose(trial.sinkage, 0.005 * (at - 2.0), atol=2e-9)
        load = np.interp(trial.sinkage_time, trial.load_time, trial.load)
        np.testing.assert_allclose(load, 1e6 * np.maximum(trial.sinkage, 0) ** 1.5, atol=1e-3)

    def test_compliance_is_taken_off(self, files: dict[str, Path]) -> None:
        stiff, soft = read(files), read(files, replace(MADE_UP, compliance=1e-6))
        load = np.interp(stiff.sinkage_time, stiff.load_time, stiff.load)
        np.testing.assert_allclose(stiff.sinkage - soft.sinkage, 1e-6 * load, atol=1e-8)

    def test_written_bag(self, files: dict[str, Path], tmp_path: Path) -> None:
        trial = read(files)
        count = write_trial(trial, tmp_path / "out", replace(MADE_UP, sinkage_std=0.0005))
        with BagReader(tmp_path / "out") as reader:
            messages = list(reader.messages())
        assert len(messages) == count
        loads = [m.message for m in messages if m.topic == "/rig/load"]
        sinkages = [m.message for m in messages if m.topic == "/rig/sinkage"]
        assert len(loads) == len(trial.load)
        assert len(sinkages) == np.sum(trial.sinkage >= 0) < len(trial.sinkage)
        assert [m.wrench.force.z for m in loads] == trial.load.tolist()
        assert [m.sinkage for m in sinkages] == trial.sinkage[trial.sinkage >= 0].tolist()
        assert {m.variance for m in sinkages} == {0.0005**2}
        stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in loads]
        assert stamps == trial.load_time.tolist()

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("1,2,3\n", r"axis.txt, line 1: 3 columns, expected 7"),
            ("1,2,3,4,5,6,7,8,9\n", r"axis.txt, line 1: 9 columns, expected 7"),
            ("\n1,2,3,4,x,6,7\n", r"axis.txt, line 2: not numbers"),
            ("1,2,3,4,nan,6,7\n", r"axis.txt, line 1: 7 columns, expected 7 finite"),
            ("", "axis.txt has no lines"),
        ],
    )
    def test_bad_log(self, files: dict[str, Path], text: str, words: str) -> None:
        files["axis.txt"].write_text(text)
        with pytest.raises(TrialError, match=words):
            read(files)

    def test_window_with_nothing_in_it(self, files: dict[str, Path]) -> None:
        with pytest.raises(TrialError, match=r"the log begins -20\.000 s after it with 0 s for"):
            read(files, replace(MADE_UP, log_behind=0.0))

    def test_bag_without_forces(self, files: dict[str, Path], tmp_path: Path) -> None:
        with BagWriter(tmp_path / "none") as writer:
            text = message_type("std_msgs/msg/String")(data="no force")
            writer.write("/text", "std_msgs/msg/String", START, text)
        with pytest.raises(TrialError, match="none has no geometry_msgs/WrenchStamped"):
            read({**files, "trial": tmp_path / "none"})

    def test_force_that_is_not_a_number(self, files: dict[str, Path], tmp_path: Path) -> None:
        write_forces(tmp_path / "nan", np.arange(3.0), np.array([1.0, math.nan, 2.0]))
        with pytest.raises(TrialError, match="force 2 of 3 is nan N"):
            read({**files, "trial": tmp_path / "nan"})


class TestCommand:
    def arguments(self, files: dict[str, Path], out: Path) -> list[str]:
        return [
            *("convert-trial", str(files["trial"]), "--zero", str(files["zero"])),
            *("--log", str(files["axis.txt"]), "-o", str(out), "--log-behind", "20"),
        ]

    def test_converts(self, files: dict[str, Path], tmp_path: Path) -> None:
        done = CliRunner().invoke(main, self.arguments(files, tmp_path / "out"))
        assert done.exit_code == 0, done.output
        assert "loads to" in done.output
        with BagReader(tmp_path / "out") as reader:
            assert {t.name for t in reader.topics} == {"/wheel/load", "/wheel/sinkage"}

    def test_bad_input_is_one_message(self, files: dict[str, Path], tmp_path: Path) -> None:
        files["axis.txt"].write_text("nonsense\n")
        done = CliRunner().invoke(main, self.arguments(files, tmp_path / "out"))
        assert done.exit_code == 2
        assert "line 1: not numbers" in done.output
        assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def recorded(shared_data: Path) -> Trial:
    raw = shared_data / "cmu_wheel_rig" / "raw" / "force-displacement_6"
    return read_trial(f"{raw}.bag", f"{raw}_zero.bag", f"{raw}.txt", RIG)


@pytest.fixture(scope="module")
def example(repository: Path) -> ModuleType:
    """The example, whose fits share no code with the library."""
    spec = importlib.util.spec_from_file_location(
        "press_trial", repository / "examples" / "press_trial.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class TestRecordedTrial:
    """The trial of a real rig."""

    def test_reads(self, recorded: Trial) -> None:
        assert recorded.zero == pytest.approx(5.5515, abs=1e-3)
        assert 1300 < len(recorded.load) < 1400
        assert len(recorded.sinkage) == 668
        assert recorded.load.max() == pytest.approx(303.5, abs=0.5)
        assert recorded.sinkage.max() == pytest.approx(0.0408, abs=1e-4)

    def test_pressed_wheel_agrees_with_direct_fits(
        self, recorded: Trial, repository: Path, example: ModuleType
    ) -> None:
        settings = settings_from(read_parameters(repository / "config" / "press_rig.yaml"))
        onboard = Onboard(settings.onboard)
        events: list[tuple[int, str, float]] = [
            *((t, "on_load", w) for t, w in zip(recorded.load_time, recorded.load, strict=True)),
            *(
                (t, "on_sinkage", z)
                for t, z in zip(recorded.sinkage_time, recorded.sinkage, strict=True)
            ),
        ]
        for time, method, value in sorted(events):
            getattr(onboard, method)("wheel", int(time), float(value))
        onboard.flush()
        soil = onboard.soil
        assert soil.accepted > 600
        fits = example.direct_fits(recorded)
        # A fit of all at once, with correlated scatter but a zero that is taken for exact: the filter
        # allows for a zero that is off, so it is less sure, and not further off than it says.
        direct = fits["correlated scatter and prior"]
        deviation = math.sqrt(soil.covariance[1, 1])
        assert deviation > math.sqrt(direct.covariance[1, 1])
        assert soil.n == pytest.approx(direct.x[1], abs=deviation)
        log_pressure = math.log(soil.reference_pressure)
        deviation = math.sqrt(soil.log_covariance[0, 0])
        assert deviation > math.sqrt(direct.covariance[0, 0])
        assert log_pressure == pytest.approx(direct.x[0], abs=deviation)
        # Fits that take each sample for an independent one differ by many of their own standard
        # deviations, since the law does not hold along the whole curve: the filter must be between.
        shallow, deep = fits["least squares in ln load"], fits["least squares in sinkage"]
        assert shallow.x[1] < soil.n < deep.x[1]
        assert deep.x[0] < log_pressure < shallow.x[0]
