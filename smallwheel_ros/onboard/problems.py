"""What could not be used: counted by stream and reason, and put in words."""

from __future__ import annotations

from collections import Counter, deque
from typing import NamedTuple

from smallwheel_ros.onboard.settings import Timing
from smallwheel_ros.onboard.streams import SECOND, StampFault

_KEPT = 1000


class Problem(NamedTuple):
    """Something that could not be used: of which stream, a key to count by, and in words."""

    stream: str
    reason: str
    text: str


class ProblemLog:
    """Counts since the start (`counts`, by stream and reason), and the words of what is new.

    rejected: measured sinkages that were not used for the soil, for whatever reason; whoever starts
    the soil over sets it to 0.
    """

    def __init__(self) -> None:
        self.rejected = 0
        self.counts: Counter[tuple[str, str]] = Counter()
        self._new: deque[Problem] = deque(maxlen=_KEPT)

    def add(self, stream: str, reason: str, text: str, *, unused: bool = True) -> None:
        """Note a problem; the words of all but the newest 1000 are forgotten.

        unused: the message was not used because of it.
        """
        self.counts[stream, reason] += 1
        self.rejected += unused and stream.endswith("/sinkage")
        self._new.append(Problem(stream, reason, text))

    def take(self) -> list[Problem]:
        """Give what is new since the last call."""
        taken = list(self._new)
        self._new.clear()
        return taken


def stamp_fault(
    stamp: int, newest: int | None, now: int | None, timing: Timing
) -> StampFault | None:
    """Judge a stamp by the newest one so far and the clock (None or 0: no clock, no opinion).

    JUMP_BACK is not a bad message: time itself went back (a bag that loops), and what was collected
    before is void.
    """
    if stamp <= 0:
        return StampFault.ZERO
    if now:
        if (stamp - now) / SECOND > timing.future_tolerance:
            return StampFault.FUTURE
        if (now - stamp) / SECOND > timing.maximum_age:
            return StampFault.TOO_OLD
    if newest is None or (newest - stamp) / SECOND <= timing.jump_tolerance:
        return None
    # A clock that has not gone back itself makes this one message late, and time no jump.
    clock_stands_by = now and (newest - now) / SECOND <= timing.future_tolerance
    return StampFault.LATE if clock_stands_by else StampFault.JUMP_BACK


def stamp_words(
    fault: StampFault, stamp: int, newest: int | None, now: int | None, timing: Timing
) -> str:
    """Say what is wrong with a header stamp (ns), with the numbers and what to do."""
    ahead, behind = ((stamp - (other or stamp)) / SECOND for other in (now, newest))
    behind = -behind
    if fault is StampFault.ZERO:
        return "header.stamp is zero: the publisher must stamp its messages"
    if fault is StampFault.FUTURE and not now:
        return (
            f"header.stamp is {-behind:.3f} s ahead of every other message: not believed until"
            " another one agrees"
        )
    if fault is StampFault.FUTURE:
        return (
            f"header.stamp is {ahead:.3f} s ahead of the clock, at most {timing.future_tolerance:g}"
            " s expected: are the clocks synchronised?"
        )
    if fault is StampFault.TOO_OLD:
        return (
            f"header.stamp is {-ahead:.3f} s behind the clock, at most {timing.maximum_age:g} s"
            " expected: for a bag, set use_sim_time and play it with its clock"
        )
    if fault is StampFault.DUPLICATE:
        return f"header.stamp {stamp / SECOND:.9f} came twice: is there more than one publisher?"
    if fault is StampFault.JUMP_BACK:
        return f"time went back by {behind:.3f} s (a bag that loops?): soil and buffers are reset"
    words = f"header.stamp is {behind:.3f} s behind the newest message: "
    if not now and behind > timing.jump_tolerance:
        return f"{words}not believed until another one agrees that time went back"
    return f"{words}too late to be used (parameter reorder_time, now {timing.reorder_time:g} s)"
