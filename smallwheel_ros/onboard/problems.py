"""Messages that could not be used: counted by stream and reason, and put in words."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass

from smallwheel_ros.onboard.settings import Timing
from smallwheel_ros.onboard.streams import SECOND, StampFault

_KEPT = 1000


@dataclass(frozen=True)
class Problem:
    """Something that could not be used: of which stream, a key to count by, and in words."""

    stream: str
    reason: str
    text: str


class ProblemLog:
    """Counts since the start, and the words of what is new.

    refused_sinkages: how many measured sinkages were not used for the soil, for whatever reason.
    """

    def __init__(self) -> None:
        self.refused_sinkages = 0
        self.counts: Counter[tuple[str, str]] = Counter()  # by stream and reason
        self._new: deque[Problem] = deque(maxlen=_KEPT)

    def add(self, stream: str, reason: str, text: str, *, unused: bool = True) -> None:
        """Note a problem; the words of all but the newest 1000 are forgotten.

        unused: the message was not used because of it.
        """
        self.counts[stream, reason] += 1
        self.refused_sinkages += unused and stream.endswith("/sinkage")
        self._new.append(Problem(stream, reason, text))

    def take(self) -> list[Problem]:
        """Give what is new since the last call."""
        taken = list(self._new)
        self._new.clear()
        return taken


def stamp_problem(
    fault: StampFault, stamp: int, newest: int | None, now: int | None, timing: Timing
) -> str:
    """Say what is wrong with a header stamp (ns), with the numbers and what to do."""
    if fault is StampFault.ZERO:
        return "header.stamp is zero: the publisher must stamp its messages"
    if fault is StampFault.FUTURE and not now:
        return (
            f"header.stamp is {(stamp - (newest or 0)) / SECOND:.3f} s ahead of every other message:"
            " not believed until another one agrees"
        )
    if fault is StampFault.FUTURE:
        return (
            f"header.stamp is {(stamp - (now or 0)) / SECOND:.3f} s ahead of the clock, at most"
            f" {timing.future_tolerance:g} s expected: are the clocks synchronised?"
        )
    if fault is StampFault.TOO_OLD:
        return (
            f"header.stamp is {((now or 0) - stamp) / SECOND:.3f} s behind the clock, at most"
            f" {timing.maximum_age:g} s expected: for a bag, set use_sim_time and play it with"
            " its clock"
        )
    if fault is StampFault.DUPLICATE:
        return f"header.stamp {stamp / SECOND:.9f} came twice: is there more than one publisher?"
    behind = ((newest or stamp) - stamp) / SECOND
    if fault is StampFault.LATE and not now and behind > timing.jump_tolerance:
        return (
            f"header.stamp is {behind:.3f} s behind the newest message: not believed until another"
            " one agrees that time went back"
        )
    if fault is StampFault.LATE:
        return (
            f"header.stamp is {behind:.3f} s behind the newest message: too late to be used"
            f" (parameter reorder_time, now {timing.reorder_time:g} s)"
        )
    return f"time went back by {behind:.3f} s (a bag that loops?): soil and buffers are reset"
