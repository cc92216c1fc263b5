# SPDX-License-Identifier: Apache-2.0
"""docs/architecture.md shows the way of one message as it is, traced.

`PYTHONPATH=. python test/house/test_architecture.py` writes it anew.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType

from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.pipeline.pipeline import Pipeline

PAGE = Path(__file__).resolve().parents[2] / "docs" / "architecture.md"
BEGIN, END = "<!-- traced -->\n", "<!-- end of trace -->\n"
PACKAGE, PAGE_OF_CODE = "smallwheel_ros/", "pipeline/pipeline.py"
MOST_CHANGES = 360  # of file in a turn of one wheel; with rows counted by `len`, as they are read
ROVER: dict[str, object] = {
    "wheels": ["front"],
    "front.diameter": 0.25,
    "front.width": 0.1,
    "vehicle.mass": 6.0,
    "imu_topic": "imu",
}
Call = tuple[str, str]  # file and function


def calls(
    work: Callable[[], object], of: Callable[[FrameType], bool] = lambda _: True
) -> list[Call]:
    """File and function of each function of this package that is called, in order of its first call."""
    found: dict[Call, None] = {}

    def profile(frame: FrameType, event: str, _: object) -> None:
        name = frame.f_code.co_filename
        if event == "call" and PACKAGE in name and of(frame):
            found[name.split(PACKAGE)[-1], frame.f_code.co_name] = None

    sys.setprofile(profile)
    try:
        work()
    finally:
        sys.setprofile(None)
    return [call for call in found if not call[1].startswith(("<", "__"))]


def from_the_page(frame: FrameType) -> bool:
    """Whether a function of another file is called by the page that a turn is written on."""
    caller = frame.f_back
    inside = frame.f_code.co_filename.endswith(PAGE_OF_CODE)
    return not inside and caller is not None and caller.f_code.co_filename.endswith(PAGE_OF_CODE)


def give(pipeline: Pipeline, i: int, load: bool = True) -> None:
    """Give the messages of the i-th instant of a drive at 50 Hz."""
    streams, stamp = pipeline.streams, 20_000_000 * i
    newtons = 60.0 + 10.0 * math.sin(0.1 * i)
    streams.add("odom", stamp, (0.3, 0.0, 0.006 * i, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    streams.add("imu", stamp, (0.0, 0.0, 0.0, 9.8, 0.0, 0.0, 1.0, 0.0))
    streams.add("front/wheel_speed", stamp, (0.33 / 0.125,))
    streams.add("front/sinkage", stamp, (2e-4 * newtons, 2.5e-7))
    if load:
        streams.add("front/load", stamp, (newtons,))


def trace() -> tuple[list[Call], list[Call]]:
    """What one message passes as it comes; what a turn calls from the page, once there is all to do."""
    pipeline = Pipeline(settings_from(ROVER).onboard)
    for i in range(1, 600):  # some metres of soil, so that all stages are at work
        give(pipeline, i, load=i < 599)
        if i % 100 == 0:
            list(pipeline.turns())
    append = calls(lambda: pipeline.streams.add("front/load", 20_000_000 * 599, (60.0,)))
    return append, calls(lambda: list(pipeline.turns()), from_the_page)


def in_words(append: list[Call], turn: list[Call]) -> str:
    """What a message passes, and what the page of a turn calls, in their order."""

    def listed(calls: list[Call]) -> str:
        files: dict[str, list[str]] = {}
        for file, name in calls:
            files.setdefault(file.removeprefix("pipeline/"), []).append(name)
        return ", ".join(f"`{file}` ({', '.join(names)})" for file, names in files.items())

    lines = [
        f"A message as it comes: {len(append)} functions of {listed(append)}.",
        "",
        f"A turn: {len(turn)} calls from one page, `{PAGE_OF_CODE}`: {listed(turn)}.",
    ]
    return "\n".join(lines) + "\n"


def rewritten(text: str) -> str:
    """The page with the trace as it is now."""
    before, rest = text.split(BEGIN)
    return before + BEGIN + in_words(*trace()) + END + rest.split(END)[1]


def test_the_page_shows_the_way_of_a_message_as_it_is() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert rewritten(text) == text, f"run `PYTHONPATH=. python {__file__}`"


def test_a_turn_can_be_followed_from_file_to_file() -> None:
    """Its reader has to turn over as often as the work goes from one file to another."""
    pipeline = Pipeline(settings_from(ROVER).onboard)
    for i in range(1, 640):  # to a turn of 0.8 s, when all stages are at work
        give(pipeline, i)
        if i in (*range(100, 600, 100), 599):
            list(pipeline.turns())
    files: list[str] = []

    def profile(frame: FrameType, event: str, _: object) -> None:
        name = frame.f_code.co_filename
        if event == "call" and PACKAGE in name:
            file = name.split(PACKAGE)[-1]
            if not files or files[-1] != file:
                files.append(file)

    sys.setprofile(profile)
    try:
        list(pipeline.turns())
    finally:
        sys.setprofile(None)
    assert len(files) <= MOST_CHANGES, f"{len(files)} changes among {len(set(files))} files"


if __name__ == "__main__":
    PAGE.write_text(rewritten(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
