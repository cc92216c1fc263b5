"""Where results and copied messages go: table, new bag, record and blocks.

They wait until some are together. Work of one kind done at a stretch finds its code and data in the
processor's cache, which reading and estimating else push out between one estimate and the next.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial

from smallwheel_ros.onboard.onboard import Result
from smallwheel_ros.replay.blocks import Blocks
from smallwheel_ros.replay.new_bag import NewBag
from smallwheel_ros.replay.record import Record
from smallwheel_ros.replay.rows import estimate_of
from smallwheel_ros.replay.table_files import TableFiles

_MOST_BYTES = 1 << 20  # that wait to be copied


class Outputs:
    """Takes results and messages in their order; `write` brings what waits to its places.

    start: the bag's first log time, ns.
    """

    def __init__(
        self, table: TableFiles, bag: NewBag, record: Record, blocks: Blocks, start: int
    ) -> None:
        self._table, self._bag = table, bag
        self._record, self._blocks, self._start = record, blocks, start
        self._waiting: list[Callable[[], None]] = []
        self._bytes = 0

    def copy(self, key: tuple[str, str], log_time: int, data: bytes) -> None:
        """Take a message of a topic and type for the new bag."""
        self._waiting.append(partial(self._bag.copy, key, log_time, data))
        self._bytes += len(data)
        if self._bytes > _MOST_BYTES:
            self.write()

    def add(self, found: Iterable[Result], log_time: int, frame: str) -> None:
        """Take results; frame: that of odometry."""
        self._waiting += [partial(self._write, result, log_time, frame) for result in found]

    def write(self) -> None:
        """Write all that waits, in the order in which it came.

        Raises ReplayError or BagError if a file cannot be written.
        """
        waiting, self._waiting, self._bytes = self._waiting, [], 0
        for work in waiting:
            work()

    def _write(self, result: Result, log_time: int, frame: str) -> None:
        estimate = estimate_of(result, self._start)
        self._table.add(estimate.row)
        self._bag.write(estimate, log_time, frame)
        self._record.add(result, estimate.row)
        self._blocks.add(result, self._record.changing)
