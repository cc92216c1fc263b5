"""What came of a replay."""

from __future__ import annotations

from dataclasses import dataclass, field

from smallwheel_ros.bag_files import BagTopic
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.parameters import NodeSettings
from smallwheel_ros.replay.blocks import Blocks
from smallwheel_ros.replay.inputs import Input, Missing
from smallwheel_ros.replay.record import Record
from smallwheel_ros.replay.spec import ReplaySpec


@dataclass
class Replayed:
    """What came of a replay; `document` makes plain values of it.

    Attributes
    ----------
    state
        ``complete``, ``ended_early`` (the bag is damaged) or ``interrupted``.
    ended
        In words, where and why it ended before the end; empty when complete.
    messages_read, message_count
        Of the topics that were read, and how many the bag says there are.
    """

    spec: ReplaySpec
    settings: NodeSettings
    notes: list[str]
    inputs: tuple[Input, ...]
    missing: list[Missing]
    topics: tuple[BagTopic, ...]
    start: int
    end: int
    message_count: int
    onboard: Onboard
    record: Record
    blocks: Blocks
    state: str = "complete"
    ended: str = ""
    messages_read: int = 0
    prefix: str = ""
    left_out: list[BagTopic] = field(default_factory=list)
    has_parquet: bool = False
