# SPDX-License-Identifier: Apache-2.0
"""What node and replay say of a drive is the same; and a vehicle that is parked for an hour costs nothing."""

from __future__ import annotations

import sys
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.field_drives import make_drive
from benchmarks.field_worlds import WORLDS
from smallwheel_ros.costmap.cost_map import CostSettings
from smallwheel_ros.onboard.events import DriveEvents
from smallwheel_ros.onboard.feed import Feed
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.onboard.statements import statements


def replayed(world: str) -> tuple[Onboard, DriveEvents, list[Any]]:
    """The first half of a drive, as a replay takes it."""
    drive = make_drive(WORLDS[world], 1)
    settings = settings_from(drive.parameters)
    onboard = Onboard(settings.onboard)
    feed = Feed(onboard, settings)
    topics = {topic.name: topic for topic in feed.topics}
    summary, newest = DriveEvents(onboard, drive.messages[0][0]), {}
    for _, topic, message in drive.messages[: len(drive.messages) // 2]:
        for result in topics[topic].handle(message, None) if topic in topics else ():
            summary.add(result)
            newest[result.wheel] = result
    summary.finish()
    return onboard, summary, list(newest.values())


@pytest.mark.parametrize("world", ["sinkage in mm", "odometry repeats"])
def test_node_and_replay_say_the_same(world: str) -> None:
    """F6: a replay's JSON had neither the filter's concern nor the warnings of getting stuck."""
    from smallwheel_ros.ros.diagnostics import WARN, entries
    from smallwheel_ros.ros.outputs import CostPublisher

    onboard, summary, newest = replayed(world)
    said = statements(onboard, newest)
    assert said
    cost = CostPublisher(CostSettings(), onboard.settings.wheels, None, lambda *_: None)
    found = {entry.name: entry for entry in entries(onboard, newest, cost)}
    for statement in said:
        entry = found[statement.entry]
        assert statement.text in entry.message
        assert int.from_bytes(entry.level, "big") >= int.from_bytes(WARN, "big")
    kinds = {event.kind for event in summary.events}
    assert kinds >= {statement.kind for statement in said}
    texts = " ".join(event.text for event in summary.events)
    assert ("1000 times too large: in mm?" if "mm" in world else "odometry repeats") in texts
    placed = [event for event in summary.events if event.kind == "sensor"]
    assert placed
    assert all(event.place is not None for event in placed)


def test_where_nothing_was_measured_the_vehicle_entry_says_so() -> None:
    """F6: with every sinkage refused it had said that slopes up to 12 degrees are held."""
    from smallwheel_ros.ros.diagnostics import _vehicle

    onboard, _, newest = replayed("sinkage in mm")
    text, _ = _vehicle(onboard, newest)
    assert "nothing measured yet" in text
    assert "holds slopes" not in text


def parked(minutes: float) -> tuple[list[int], float]:
    """Sizes (bytes) of an `Onboard`, at ten times, and its slowest message (s of the processor)."""
    drive = make_drive(WORLDS["plain"], 1)
    settings = settings_from(drive.parameters)
    onboard = Onboard(settings.onboard)
    feed = Feed(onboard, settings)
    topics = {topic.name: topic for topic in feed.topics}
    messages = [one for one in drive.messages if one[1] in topics]
    begin = messages[0][0]
    ends = begin + 15_000_000_000  # 15 s of driving; then the last second again and again
    moving = [one for one in messages if one[0] <= ends]
    standing = [one for one in messages if one[0] <= begin + 1_000_000_000]
    for _, topic, message in moving:
        topics[topic].handle(message, None)
    rounds = round(minutes * 60)
    sizes, slowest = [], 0.0
    for i in range(1, rounds + 1):
        shift = moving[-1][0] - begin + i * 1_000_000_000
        for stamp, topic, message in standing:
            now = stamp + shift
            message.header.stamp.sec = now // 1_000_000_000
            message.header.stamp.nanosec = now % 1_000_000_000
            start = time.thread_time()
            topics[topic].handle(message, None)
            slowest = max(slowest, time.thread_time() - start)
        if i % max(rounds // 10, 1) == 0:
            sizes.append(size_of(onboard))
    return sizes, slowest


def size_of(thing: object) -> int:
    """Bytes of a thing and of all that it holds."""
    seen: set[int] = set()
    waiting, whole = [thing], 0
    while waiting:
        one = waiting.pop()
        if id(one) in seen or isinstance(one, type | SimpleNamespace):
            continue
        seen.add(id(one))
        whole += one.nbytes if isinstance(one, np.ndarray) else sys.getsizeof(one)
        if isinstance(one, dict):
            waiting += [*one.keys(), *one.values()]
        elif hasattr(one, "__iter__") and not isinstance(one, str | bytes | np.ndarray):
            waiting += list(one)
        waiting += list(getattr(one, "__dict__", {}).values())
    return whole


@pytest.mark.parametrize("minutes", [3.0, pytest.param(60.0, marks=pytest.mark.slow)])
def test_a_parked_vehicle_does_not_fill_the_memory(minutes: float) -> None:
    """F15: the stuck warning had 39,960 entries after 200 s."""
    sizes, slowest = parked(minutes)
    print(
        f"{minutes:g} min: {sizes[0] / 1e3:.0f} to {sizes[-1] / 1e3:.0f} kB, slowest {1e3 * slowest:.0f} ms"
    )
    # Buffers are halved now and then; what grows with the messages would have grown tenfold.
    assert max(sizes[5:]) <= 1.2 * max(sizes[:5])
