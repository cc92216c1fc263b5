# SPDX-License-Identifier: Apache-2.0
"""The rows of all streams: which messages are kept, and up to which stamp all have arrived.

A callback appends numbers and does nothing else. What is decided about a message depends only on
earlier messages and on its own `now`, never on when results are asked for:

    kept     stamp is later than the stream's newest one, and than what the stream has missed:
             frontier = newest,  or  latest - reorder  where it was silent for longer than `silence`
    late     any other: counted by reason, and not kept; out_of_order if its own stream has newer ones
    clock    now - age <= stamp <= now + future, or the message is refused
    jump     latest - stamp > `jump`, and the clock went back too (latest > now + future). Without a clock a
             second message in a row has to agree: of another stamp, and of another stream or of one that
             was heard before. So one wrong clock among good ones resets nothing.

    watermark = min over streams of newest,  of a silent one latest - reorder - gap

Nothing at or before the watermark changes any more: the value of a stream at t depends on its last row
before t and its first one at or after t, within its gap. That is `StampRules.gap`, and for a slow stream
1.25 of the second longest time between its newest messages. A slow stream is silent later, too.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Mapping

import numpy as np

from smallwheel_ros.common.stamps import NEVER, SECOND
from smallwheel_ros.pipeline.tables import Array, Integers

from .buffer import Samples, StampRules, Stream
from .plausible import fault, flaw, sound

Arrivals = Mapping[
    str, tuple[Integers, Array, Integers]
]  # of streams: stamps, values, numbers of messages
_ONE_BY_ONE = 32  # messages, of which one is refused, that are not worth being halved


def _halves(rows: Arrivals, middle: int) -> tuple[Arrivals, Arrivals]:
    """Split rows into those of messages with a number under `middle`, and all others."""
    before: dict[str, tuple[Integers, Array, Integers]] = {}
    after = before.copy()
    for name, (stamps, values, numbers) in rows.items():
        cut = int(np.searchsorted(numbers, middle))
        if cut > 0:
            before[name] = stamps[:cut], values[:cut], numbers[:cut]
        if cut < numbers.size:
            after[name] = stamps[cut:], values[cut:], numbers[cut:]
    return before, after


class Streams:
    """The streams of a vehicle: keeps the rows of messages, and counts messages that cannot be used.

    Parameters
    ----------
    widths
        Number of values in a row, by stream.
    rules
        Rules for stamps.
    on_jump
        Called when time has gone back, before rows are dropped and the first message of the new time is
        kept, so that the owner can take the rows so far and start again.

    Attributes
    ----------
    all
        The streams, by name.
    latest, oldest
        Newest stamp of all streams, and stamp of the first row kept, ns; NEVER without any.
    problems
        Number of messages that were not kept, or used only in part, by stream and reason.
    words
        The newest explanation of each problem, by stream and reason.
    """

    def __init__(
        self,
        widths: Mapping[str, int],
        rules: StampRules,
        on_jump: Callable[[], None] = lambda: None,
    ) -> None:
        self.all = {name: Stream(name, width) for name, width in widths.items()}
        self.rules, self._on_jump = rules, on_jump
        self.latest = self.oldest = NEVER
        self._doubted: tuple[int, str] | None = (
            None  # the last message, if it was far from all others
        )
        self._refused, self._forgotten = array("q"), 0  # measured sinkages: newest stamps then
        self.problems: Counter[tuple[str, str]] = Counter()
        self.words: dict[tuple[str, str], str] = {}

    def add(self, name: str, stamp: int, values: tuple[float, ...], now: int | None = None) -> None:
        """Keep the row of one message; one that cannot be used is counted with the reason.

        Parameters
        ----------
        name
            Name of the stream.
        stamp
            Stamp of the row, ns.
        values
            Values of the row, SI.
        now
            Time of the clock as the message arrives, ns; None or 0 without a clock.
        """
        stream = self.all[name]
        stream.received += 1
        wrong = fault(stream.kind, values) or self._untimely(name, stamp, now)
        if wrong is not None:
            self._refuse(stream, *wrong)
            return
        self._doubted = None
        if stamp <= self._frontier(stream):
            if stamp == stream.newest:
                text = f"stamp {stamp / SECOND:.9f} came twice: is there more than one publisher?"
                self._refuse(stream, "duplicate", text)
            else:
                self._refuse(stream, *self._behind(stream, stamp))
            return
        lacks = flaw(stream.kind, values)
        if lacks is not None:
            self.note(name, *lacks)
        stream.append(stamp, values)
        self.oldest = stamp if self.oldest == NEVER else self.oldest
        self.latest = max(self.latest, stamp)

    def add_rows(self, rows: Arrivals, clock: Integers | None = None) -> None:
        """Keep the rows of many messages, with the same result as `add` for one after the other, but faster.

        Parameters
        ----------
        rows
            By stream: stamps (rows,), ns; values (rows, width), SI; and numbers of the messages (rows,),
            which rise in the order of arrival over all streams.
        clock
            Time of the clock as each message arrived, indexed by the numbers, shape (messages,), ns; None
            without a clock.
        """
        if not rows:
            return
        stamps = np.concatenate([one[0] for one in rows.values()])
        numbers = np.concatenate([one[2] for one in rows.values()])
        order = np.argsort(numbers, kind="stable")
        if self._plain(rows, stamps[order], None if clock is None else clock[numbers[order]]):
            for name, (own, values, _) in rows.items():
                self.all[name].extend(own, values)
                self.all[name].received += own.size
            self.oldest = int(stamps[order[0]]) if self.oldest == NEVER else self.oldest
            self.latest = max(self.latest, int(stamps.max()))
            self._doubted = None
            return
        middle = numbers[order[order.size // 2]]
        if order.size > _ONE_BY_ONE and middle > numbers[order[0]]:
            for part in _halves(rows, int(middle)):
                self.add_rows(part, clock)
            return
        names = np.repeat(np.arange(len(rows)), [one[0].size for one in rows.values()])
        index = np.concatenate([np.arange(one[0].size) for one in rows.values()])
        keys, all_values = list(rows), [one[1] for one in rows.values()]
        for i in order:
            row = tuple(all_values[names[i]][index[i]].tolist())
            now = None if clock is None else int(clock[numbers[i]])
            self.add(keys[names[i]], int(stamps[i]), row, now)

    def _plain(
        self,
        rows: Arrivals,
        arrived: Integers,
        clock: Integers | None,
    ) -> bool:
        """Whether `add` would keep each of these messages without a remark.

        arrived: stamps of all rows in the order of arrival, ns. clock: time at each of them, ns.
        """
        rules = self.rules
        if int(arrived.min()) <= 0 or int(arrived.max()) >= -NEVER:
            return False
        before = np.maximum.accumulate(np.concatenate([[self.latest], arrived]))[:-1]
        apart = (arrived - before)[1 if self.latest == NEVER else 0 :]
        if ((apart <= -rules.reorder) | (apart > rules.jump)).any():
            return False
        if clock is not None:
            ahead = arrived - clock
            if ((clock > 0) & ((ahead > rules.future) | (-ahead > rules.age))).any():
                return False
        for name, (own, values, _) in rows.items():
            stream = self.all[name]
            if own[0] <= stream.newest or not (np.diff(own) > 0).all():
                return False
            if not sound(stream.kind, values):
                return False
        return True

    def _frontier(self, stream: Stream) -> int:
        """Stamp (ns) at or before which messages of a stream come too late."""
        if not self.silent(stream):
            return stream.newest
        return max(stream.newest, self.latest - self.rules.reorder)

    # --- What is refused

    def _untimely(self, name: str, stamp: int, now: int | None) -> tuple[str, str] | None:
        """Reason and words why a stamp is not believed, or None.

        Where time has jumped back everything is reset, and the stamp is believed.
        """
        rules = self.rules
        if not 0 < stamp < -NEVER:
            return (
                "stamp_zero",
                f"stamp is {stamp / SECOND:g} s: the publisher must stamp its messages",
            )
        if now:
            ahead = (stamp - now) / SECOND
            if stamp - now > rules.future:
                return "stamp_in_future", (
                    f"stamp is {ahead:.3f} s ahead of the clock, at most {rules.future / SECOND:g} s"
                    " expected: are the clocks synchronised? (A bag: replay it with --no-clock)"
                )
            if now - stamp > rules.age:
                return "stamp_too_old", (
                    f"stamp is {-ahead:.3f} s behind the clock, at most {rules.age / SECOND:g} s"
                    " expected: for a bag, set use_sim_time and play it with its clock, or replay it"
                    " with --no-clock"
                )
        if self.latest == NEVER or abs(stamp - self.latest) <= rules.jump:
            return None
        if now:
            if stamp > self.latest:
                return None
            if self.latest - now <= rules.future:  # the clock has not gone back
                return self._behind(self.all[name], stamp)
        else:
            doubted, self._doubted = self._doubted, (stamp, name)
            heard = self.all[name].newest != NEVER
            if (
                doubted is None
                or not 0 < abs(stamp - doubted[0]) <= rules.jump
                or not (heard or doubted[1] != name)
            ):
                apart = (stamp - self.latest) / SECOND
                return "far", f"stamp is {apart:.3f} s from all others: another has to agree first"
        if stamp < self.latest:
            back = (self.latest - stamp) / SECOND
            self.note(name, "time_jump", f"time went back by {back:.3f} s: everything starts over")
            self._on_jump()
            self.clear()
        return None

    def _behind(self, stream: Stream, stamp: int) -> tuple[str, str]:
        """Reason and words for a message that is too late: out of order in its topic, or simply too old."""
        if stamp < stream.newest:
            return "out_of_order", (
                f"stamp is {(stream.newest - stamp) / SECOND:.3f} s before that of the message before:"
                " those of one topic have to come in order (two publishers, or two threads of one?)"
            )
        behind, reorder = (self.latest - stamp) / SECOND, self.rules.reorder / SECOND
        return "late", (
            f"stamp is {behind:.3f} s behind the newest message: too late to be used (parameter"
            f" timing.reorder_time, now {reorder:g} s)"
        )

    def _refuse(self, stream: Stream, reason: str, text: str) -> None:
        self.note(stream.name, reason, text)
        if stream.kind == "sinkage":
            self._refused.append(self.latest)

    @property
    def refused_sinkages(self) -> int:
        """Number of measured sinkages that were refused since the start or the last jump of time."""
        return self._forgotten + len(self._refused)

    def refused(self, stamps: Integers) -> Integers:
        """Number of refused sinkages so far when each of the given stamps was passed.

        Parameters
        ----------
        stamps
            Shape (rows,), ns, at or after that of the last call of `kept`.

        Returns
        -------
        ndarray
            Shape (rows,): number that arrived before the first row of any stream newer than the stamp.
        """
        at = np.maximum.accumulate(np.array(self._refused, dtype=np.int64))
        return self._forgotten + np.searchsorted(at, stamps)

    def note(self, name: str, reason: str, text: str, times: int = 1) -> None:
        """Count a problem with messages of a stream, and keep its explanation.

        Parameters
        ----------
        name
            Name of the stream.
        reason
            Key under which it is counted, such as `late`.
        text
            Explanation for the user.
        times
            Number of messages that had it.
        """
        self.problems[name, reason] += times
        self.words.pop((name, reason), None)  # the newest is the last
        self.words[name, reason] = text

    # --- Up to when all is there

    def clear(self) -> None:
        """Drop all rows; keep the counts of problems."""
        for stream in self.all.values():
            stream.clear()
        self.latest = self.oldest = NEVER
        del self._refused[:]
        self._forgotten = 0

    def silent(self, stream: Stream) -> bool:
        """Whether a stream is no longer waited for."""
        passed, rules = self.latest - max(stream.newest, self.oldest), self.rules
        return passed > rules.silence and passed > stream.hold(rules) + rules.reorder

    @property
    def watermark(self) -> int:
        """Stamp (ns) up to which all rows have arrived, so that no value at or before it changes any more."""
        rules, found = self.rules, self.latest
        for stream in self.all.values():
            newest = stream.newest
            if self.silent(stream):
                newest = self.latest - rules.reorder - stream.hold(rules)
            found = min(found, newest)
        return found

    def silent_ones(self) -> frozenset[str]:
        """Names of the streams that are no longer waited for."""
        return frozenset(name for name, stream in self.all.items() if self.silent(stream))

    def kept(self, since: int) -> dict[str, Samples]:
        """Drop rows that only values before a stamp (ns) depend on, and return a snapshot of the others.

        Returns
        -------
        dict of Samples
            Raw rows by stream.
        """
        drop = int(np.searchsorted(np.array(self._refused, dtype=np.int64), since))
        del self._refused[:drop]
        self._forgotten += drop
        found = {}
        for name, stream in self.all.items():
            stream.forget(since)
            found[name] = stream.samples
        return found
