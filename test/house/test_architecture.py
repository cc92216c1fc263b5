# SPDX-License-Identifier: Apache-2.0
"""docs/architecture.md shows the way of one message as it is: traced, not told.

`PYTHONPATH=. python test/house/test_architecture.py` writes it anew.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType, SimpleNamespace
from typing import Any

from smallwheel_ros.onboard.feed import Feed
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.parameters import settings_from

PAGE = Path(__file__).resolve().parents[2] / "docs" / "architecture.md"
BEGIN, END = "<!-- traced -->\n", "<!-- end of trace -->\n"
# The message that is traced ends a step of the path, so that strength and warnings are in it.
MOST_FILES = 25


def message(time: float, **fields: Any) -> SimpleNamespace:
    """A message with a header; its fields by attribute, as those of rclpy and rosbags."""
    whole = int(time)
    stamp = SimpleNamespace(sec=whole, nanosec=round((time - whole) * 1e9))
    return SimpleNamespace(header=SimpleNamespace(stamp=stamp, frame_id="odom"), **fields)


def vector(**parts: float) -> SimpleNamespace:
    """A group of numbers."""
    return SimpleNamespace(**parts)


def drive_on(feed: Feed, time: float, at_load: Callable[[], None]) -> list[Any]:
    """Give everything of one instant; the load comes last, and makes the result ready."""
    topics = {topic.name: topic for topic in feed.topics}
    pose = SimpleNamespace(
        pose=SimpleNamespace(
            position=vector(x=0.3 * time, y=0.0), orientation=vector(x=0.0, y=0.0, z=0.0, w=1.0)
        )
    )
    twist = SimpleNamespace(
        twist=SimpleNamespace(linear=vector(x=0.3), angular=vector(z=0.0)), covariance=[0.0] * 36
    )
    topics["odom"].handle(message(time, pose=pose, twist=twist), None)
    joints = message(time, name=["front_joint"], velocity=[2.5], effort=[])
    topics["joint_states"].handle(joints, None)
    topics["front/sinkage"].handle(message(time, sinkage=0.011, variance=1e-6), None)
    load = message(time, wrench=SimpleNamespace(force=vector(x=0.0, y=0.0, z=60.0)))
    at_load()
    return topics["front/load"].handle(load, None)


def trace() -> list[tuple[str, str]]:
    """File and function of every call of this package from the load's callback to the result."""
    settings = settings_from({"wheels": ["front"], "front.diameter": 0.25, "front.width": 0.1})
    onboard = Onboard(settings.onboard)
    feed = Feed(onboard, settings)
    calls: list[tuple[str, str]] = []

    def profile(frame: FrameType, event: str, _: Any) -> None:
        name = frame.f_code.co_filename
        if event == "call" and "smallwheel_ros/" in name:
            calls.append((name.split("smallwheel_ros/")[-1], frame.f_code.co_name))

    for i in range(100):  # two metres and more of soil, so that all of the estimator is at work
        drive_on(feed, 100.0 + 0.1 * i, lambda: None)
    try:
        results = drive_on(feed, 110.0, lambda: sys.setprofile(profile))
    finally:
        sys.setprofile(None)
    assert len(results) == 1
    return calls


def table(calls: list[tuple[str, str]]) -> str:
    """Files in the order in which the message comes to them, with their functions."""
    files: dict[str, list[str]] = {}
    for file, function in calls:
        functions = files.setdefault(file, [])
        if function not in functions and not function.startswith("<"):
            functions.append(function)
    lines = [f"{len(calls)} calls in {len(files)} files.", "", "| file | what it does there |"]
    lines.append("| --- | --- |")
    lines += [f"| {file} | {', '.join(names)} |" for file, names in files.items()]
    return "\n".join(lines) + "\n"


def rewritten(text: str) -> str:
    """The page with the trace as it is now."""
    before, rest = text.split(BEGIN)
    return before + BEGIN + table(trace()) + END + rest.split(END)[1]


def test_the_page_shows_the_way_of_a_message_as_it_is() -> None:
    text = PAGE.read_text(encoding="utf-8")
    if sys.version_info[:2] == (3, 11):  # others count comprehensions otherwise
        assert rewritten(text) == text, f"run `PYTHONPATH=. python {__file__}`"


def test_the_way_of_a_message_does_not_grow() -> None:
    assert len({file for file, _ in trace()}) <= MOST_FILES


if __name__ == "__main__":
    PAGE.write_text(rewritten(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
