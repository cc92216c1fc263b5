# SPDX-License-Identifier: Apache-2.0
"""Passes messages of a bag about the ground ahead (terrain classes, elevations) to a replay's cost map."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from smallwheel_ros.bags import BagReader, DefinitionError, Key, RawMessage
from smallwheel_ros.common.errors import reason
from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.drive.ground_ahead import AheadInputs
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.replay.spec import ReplaySpec


class RecordedAhead:
    """Messages about the ground ahead, held back until the estimates reach their time.

    Parameters
    ----------
    spec
        Specification of the replay, for the names of topics in the bag.
    reader
        Open reader of the bag.
    settings
        The node's settings.
    cost_map
        Map that takes the messages.
    pipeline
        Pipeline that counts problems with them.

    Attributes
    ----------
    topics
        For the name and type of each topic in the bag, its decoder and the function that takes its
        messages.
    notes
        A sentence on each topic that cannot be read.
    """

    def __init__(
        self,
        spec: ReplaySpec,
        reader: BagReader,
        settings: NodeSettings,
        cost_map: CostMap,
        pipeline: Pipeline,
    ) -> None:
        self._pipeline = pipeline

        def report(topic: str, why: str, text: str) -> None:
            pipeline.note(spec.in_bag(topic), why, text, unused=False)

        present = {topic[:2] for topic in reader.topics}
        self.topics: dict[Key, tuple[Callable[[bytes], Any], Callable[[Any], bool]]] = {}
        self.notes: list[str] = []
        for name, (kind, take) in AheadInputs(settings, cost_map, report).topics.items():
            key = spec.in_bag(name), kind
            if key not in present:
                continue
            try:
                self.topics[key] = reader.decoder(*key), take
            except DefinitionError as error:
                self.notes.append(f"topic {key[0]} is not read: {error}")
        self._waiting: deque[RawMessage] = deque()

    def keep(self, message: RawMessage) -> None:
        """Keep a message if it is about the ground ahead."""
        if message[:2] in self.topics:
            self._waiting.append(message)

    def take_until(self, time: int) -> None:
        """Pass to the map every kept message recorded up to a time (ns, inclusive)."""
        while self._waiting and self._waiting[0].log_time <= time:
            topic, kind, _, data = self._waiting.popleft()
            decode, take = self.topics[topic, kind]
            try:
                message = decode(data)
            except Exception as error:  # damaged bytes make rosbags raise as it likes
                self._pipeline.note(topic, "not_readable", f"topic {topic}: {reason(error)}")
            else:
                take(message)
