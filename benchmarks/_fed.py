# SPDX-License-Identifier: Apache-2.0
"""Messages of a made drive into the pipeline, in the order of their stamps, a turn each so often."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from typing import Any

import numpy as np

from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.pipeline.inputs import topics_of
from smallwheel_ros.pipeline.pipeline import Pipeline, Turn
from smallwheel_ros.pipeline.tables import Array, Integers

Message = tuple[int, str, Any]  # stamp (ns), topic, message


class _Columns(Mapping[str, Array]):
    """Fields of messages by path, each (messages, count), as a decoder gives them."""

    def __init__(self, messages: Sequence[Any]) -> None:
        self._messages = messages

    def __getitem__(self, path: str) -> Array:
        try:
            values = [reduce(getattr, path.split("."), m) for m in self._messages]
        except AttributeError as error:
            raise KeyError(path) from error
        return np.array(values, dtype=float).reshape(len(values), -1)

    def __iter__(self) -> Iterator[str]:
        return iter(())

    def __len__(self) -> int:
        return 0


def turns_of(
    pipeline: Pipeline, settings: NodeSettings, messages: Sequence[Message], period: int
) -> Iterator[tuple[int, list[Turn]]]:
    """Stamp (ns) of the newest message and what the turn then gave, each `period` (ns), and at the end."""
    topics = {topic.name: topic for topic in topics_of(settings)}
    begin = 0
    for i, (stamp, _, _) in enumerate(messages):
        last = i + 1 == len(messages)
        if not last and messages[i + 1][0] - messages[begin][0] < period:
            continue
        parts: dict[str, list[tuple[Integers, Array, Integers]]] = {}
        block = [m for m in messages[begin : i + 1] if m[1] in topics]
        for name in dict.fromkeys(name for _, name, _ in block):
            mine = [(k, at, m) for k, (at, of, m) in enumerate(block) if of == name]
            numbers, stamps, raw = (list(column) for column in zip(*mine, strict=True))
            joints = list(getattr(raw[0], "name", []))
            for stream, values in topics[name].read(_Columns(raw), joints).items():
                column = np.array(stamps), values, np.array(numbers)
                parts.setdefault(stream, []).append(column)
        rows = {}
        for stream, groups in parts.items():
            stamps_of, values, number = (np.concatenate(c) for c in zip(*groups, strict=True))
            rows[stream] = stamps_of, values, number
        pipeline.streams.add_rows(rows)
        yield stamp, list(pipeline.turns(last=last))
        begin = i + 1


def newest_of_each(wheel: Integers, values: Array, before: Array) -> Array:
    """At each row the newest value of every wheel, (rows, wheels). before: those of the last block."""
    found = np.empty((wheel.size, before.size))
    index = np.arange(wheel.size)
    for j in range(before.size):
        last = np.maximum.accumulate(np.where(wheel == j, index, -1))
        found[:, j] = np.where(last < 0, before[j], values[np.maximum(last, 0)])
    return found
