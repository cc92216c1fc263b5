"""What came of a replay."""

from __future__ import annotations

from dataclasses import dataclass, field

from smallwheel_ros.bag_files import BagTopic
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.replay.inputs import Input, Missing
from smallwheel_ros.replay.spec import ReplaySpec
from smallwheel_ros.replay.steady_segments import SteadySegments
from smallwheel_ros.replay.summary import DriveSummary


@dataclass
class Replayed:
    """What came of a replay; `document` makes plain values of it.

    Attributes
    ----------
    state
        ``complete``, ``ended_early`` (the bag is damaged) or ``interrupted``.
    ended
        In words, what is wrong with the bag, or where the replay stopped; empty when complete.
    messages_read, message_count
        Of the topics that were read, and how many the bag says there are.
    """

    spec: ReplaySpec
    settings: NodeSettings
    notes: list[str]
    inputs: tuple[Input, ...]
    missing: list[Missing]
    start: int
    end: int
    message_count: int
    onboard: Onboard
    summary: DriveSummary
    segments: SteadySegments
    state: str = "complete"
    ended: str = ""
    messages_read: int = 0
    prefix: str = ""
    left_out: list[BagTopic] = field(default_factory=list)
