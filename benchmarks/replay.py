# SPDX-License-Identifier: Apache-2.0
"""Replay with tables against real time; memory over the bag's length.

    python benchmarks/replay.py [--repeats 3] [--long 1000000]

Six wheels whose load, sinkage and joints come at 100 Hz, as odometry does: 1400 messages and 600 estimates a
second. Beside the replay, in the same run: only deserialising the messages, and the pipeline without any
output. Processor time of one core, medians. The page (report.html) is not part of it: its time does not
depend on the bag's length. Memory is measured in processes of their own.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

from smallwheel_ros.arguments import Copy
from smallwheel_ros.bags import BagReader, BagWriter
from smallwheel_ros.replay.recording import turns_of
from smallwheel_ros.replay.replay import replay
from smallwheel_ros.replay.spec import ReplaySpec, read_settings
from smallwheel_ros.simulate import DriveSettings, sensors, simulate_drive, write_drive_bag
from smallwheel_ros.simulate.world import ROVERS

TARGET = 20.0
FLAT = 1.1
CONFIG = Path(__file__).resolve().parent.parent / "config" / "two_wheel_sizes.yaml"
RATE = 100.0  # Hz


def six_wheels(folder: Path, distance: float) -> tuple[Path, Path, int]:
    """A bag, its parameter file, and the number of messages."""
    rover = ROVERS["two_sizes"]
    front = rover.wheels[:2]
    middle = [replace(w, name=w.name.replace("front", "middle"), x=0.0) for w in front]
    six = replace(rover, wheels=(*front, *middle, *rover.wheels[2:]))
    with patch.dict(sensors._RATES, dict.fromkeys(sensors._RATES, RATE)):
        drive = simulate_drive(DriveSettings(seed=1, distance=distance, wheels=six))
    bag, config = folder / "drive", folder / "rover.yaml"
    count = write_drive_bag(drive, bag)
    text = CONFIG.read_text().replace("rear_left,", "middle_left, middle_right, rear_left,", 1)
    more = "".join(
        f"    {w.name}: {{diameter: {w.diameter}, width: {w.width}, lateral_position: {w.y},"
        " longitudinal_position: 0.0}\n"
        for w in middle
    )
    config.write_text(text.replace("    rear_left:\n", f"{more}    rear_left:\n", 1))
    return bag, config, count


def deserialise(bag: Path) -> int:
    with BagReader(bag) as reader:
        return sum(1 for _ in reader.messages())


def estimate(bag: Path, config: Path) -> None:
    """The pipeline alone: the messages decoded and taken through all stages, and nothing written."""
    with BagReader(bag) as reader:
        settings, _ = read_settings(ReplaySpec(bag, config, Path()), reader)
    for _ in turns_of(bag, settings):
        pass


def lengthened(bag: Path, target: Path, messages: int) -> Path:
    """The drive again and again, on and on in time, until the bag has so many messages."""
    with BagReader(bag) as reader, BagWriter(target) as writer:
        recorded = list(reader.messages())
        length = (reader.end_time or 0) - (reader.start_time or 0) + 10**7
        for turn in range(-(-messages // len(recorded))):
            for topic, kind, log_time, message in recorded:
                stamp = message.header.stamp
                total = stamp.sec * 10**9 + stamp.nanosec + (length if turn else 0)
                message.header.stamp = type(stamp)(sec=total // 10**9, nanosec=total % 10**9)
                writer.write(topic, kind, log_time + turn * length, message)
    return target


def memory(bag: Path, config: Path, folder: Path) -> float:
    """Largest memory (MB) of a process that replays the bag."""
    command = [sys.executable, __file__, "--only", str(bag), str(config), str(folder)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return float(done.stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--distance", type=float, default=15.0, help="of the drive, m")
    parser.add_argument("--long", type=int, default=0, help="messages, for the memory; 0: not")
    parser.add_argument("--only", nargs=3, type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.only:
        replay(ReplaySpec(*given.only))
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bag, config, count = six_wheels(folder, given.distance)

        def replayed(copy: Copy) -> Callable[[], object]:
            return lambda: replay(ReplaySpec(bag, config, folder / copy, copy=copy))

        tasks: dict[str, Callable[[], object]] = {
            "deserialise only": lambda: deserialise(bag),
            "pipeline alone": lambda: estimate(bag, config),
            "replay, tables and a bag of estimates": replayed("none"),
            "replay, originals copied too": replayed("all"),
        }
        times: dict[str, list[float]] = {task: [] for task in tasks}
        for _ in range(given.repeats):
            for task, run in tasks.items():
                start = time.process_time()
                run()
                times[task].append(time.process_time() - start)
        with BagReader(bag) as reader:
            duration = ((reader.end_time or 0) - (reader.start_time or 0)) / 1e9
        print(f"{count} messages of a drive of {duration:.0f} s, median of {given.repeats}:")
        speeds = {task: duration / statistics.median(found) for task, found in times.items()}
        for task, found in times.items():
            print(
                f"  {task:<40}{1e6 * statistics.median(found) / count:7.1f} us a message,"
                f" {speeds[task]:.1f} x real time"
                f" ({duration / max(found):.1f} to {duration / min(found):.1f})"
            )
        reached = speeds["replay, tables and a bag of estimates"] >= TARGET
        print(f"  target: {TARGET:g} x real time: {'reached' if reached else 'MISSED'}")
        if given.long:
            sizes = [given.long // 10, given.long]
            bags = [lengthened(bag, folder / f"long{size}", size) for size in sizes]
            used = [memory(one, config, folder / f"out{i}") for i, one in enumerate(bags)]
            for size, megabytes in zip(sizes, used, strict=True):
                print(f"  {size} messages: {megabytes:.0f} MB")
            verdict = "reached" if used[1] <= FLAT * used[0] else "MISSED"
            print(f"  target: at most {FLAT:g} x the memory for 10 x the messages: {verdict}")


if __name__ == "__main__":
    main()
