"""Replay against only deserialising the same messages with rosbags; memory over the bag's length.

    python benchmarks/replay.py [--repeats 5] [--long 1000000]

Everything runs one after the other in the same process, turn by turn, so that a busy machine slows
all of it down alike; ratios are of the medians of processor time. The peer is rosbags itself, without
this package's reader; every topic of the bag is an input, so both read the same messages. The page
(report.html) is not part of it: its time does not depend on the bag's length. Memory is measured in
processes of their own.
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
from pathlib import Path

from rosbags.highlevel import AnyReader

from smallwheel_ros.bags import BagReader, BagWriter
from smallwheel_ros.onboard.feed import Feed
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.replay.one import replay
from smallwheel_ros.replay.spec import Copy, ReplaySpec
from smallwheel_ros.simulate.drive import DriveSettings, simulate_drive
from smallwheel_ros.simulate.drive_bag import write_drive_bag

TARGET = 6.0
FLAT = 1.1
CONFIG = Path(__file__).resolve().parent.parent / "config" / "two_wheel_sizes.yaml"


def deserialise(bag: Path) -> int:
    with AnyReader([bag]) as reader:
        return sum(
            reader.deserialize(data, connection.msgtype) is not None
            for connection, _, data in reader.messages()
        )


def estimate(bag: Path) -> None:
    """The estimator alone: the messages given to it, and nothing written."""
    settings, _ = ReplaySpec(bag, CONFIG, Path()).settings()
    onboard = Onboard(settings.onboard)
    topics = Feed(onboard, settings).topics
    with BagReader(bag) as reader:
        takers = {
            f"/{t.name}": (reader.field_reader(t.type, t.fields + t.newer, t.values_of), t.take)
            for t in topics
        }
        for topic, _, log_time, data in reader.raw_messages():
            fields, take = takers[topic]
            take(fields(data), log_time)
    onboard.flush()


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


def memory(bag: Path, folder: Path) -> float:
    """Largest memory (MB) of a process that replays the bag."""
    command = [sys.executable, __file__, "--only", str(bag), str(folder)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return float(done.stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--distance", type=float, default=60.0, help="of the drive, m")
    parser.add_argument("--long", type=int, default=0, help="messages, for the memory; 0: not")
    parser.add_argument("--only", nargs=2, type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.only:
        replay(ReplaySpec(given.only[0], CONFIG, given.only[1]))
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bag = folder / "drive"
        settings = DriveSettings(seed=1, distance=given.distance, wheels="two_sizes")
        count = write_drive_bag(simulate_drive(settings), bag)

        def replayed(copy: Copy) -> Callable[[], object]:
            return lambda: replay(ReplaySpec(bag, CONFIG, folder / copy, copy=copy))

        tasks: dict[str, Callable[[], object]] = {
            "deserialise only (rosbags)": lambda: deserialise(bag),
            "estimator alone": lambda: estimate(bag),
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
        first = statistics.median(times["deserialise only (rosbags)"])
        print(f"{count} messages of a drive of {duration:.0f} s, median of {given.repeats}:")
        for task, found in times.items():
            middle = statistics.median(found)
            spread = f"{min(found) / first:.1f} to {max(found) / first:.1f}"
            print(
                f"  {task:<40}{middle:7.2f} s {1e6 * middle / count:6.1f} us a message"
                f" {middle / first:5.1f} x  ({spread}), {duration / middle:.0f} x real time"
            )
        ratio = statistics.median(times["replay, tables and a bag of estimates"]) / first
        verdict = "reached" if ratio <= TARGET else "MISSED"
        print(f"  target: replay at most {TARGET:g} x: {verdict}")
        if given.long:
            sizes = [given.long // 10, given.long]
            bags = [lengthened(bag, folder / f"long{size}", size) for size in sizes]
            used = [memory(one, folder / f"out{i}") for i, one in enumerate(bags)]
            for size, megabytes in zip(sizes, used, strict=True):
                print(f"  {size} messages: {megabytes:.0f} MB")
            verdict = "reached" if used[1] <= FLAT * used[0] else "MISSED"
            print(f"  target: at most {FLAT:g} x the memory for 10 x the messages: {verdict}")


if __name__ == "__main__":
    main()
