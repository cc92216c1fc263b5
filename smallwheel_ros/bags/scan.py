"""Read a damaged bag record by record, without the index that it may have lost.

What is given is what the file holds up to its damage; `ScanDamage` then says where that is.
"""

from __future__ import annotations

from collections.abc import Iterator
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple


class ScanDamage(Exception):
    """Where a file ends or is damaged, in words."""


class ScanChannel(NamedTuple):
    """A topic as the file describes it; `encoding` is ros2msg, ros2idl, ros1 or empty."""

    topic: str
    type: str
    encoding: str
    definition: str
    qos: str = ""


class Scanned(NamedTuple):
    """One message, still serialised; log_time in ns."""

    channel: ScanChannel
    log_time: int
    data: bytes


def by_log_time(chunk: Iterator[Scanned]) -> Iterator[Scanned]:
    """Give the messages of a chunk by log time, all that come before an error, then the error."""
    found: list[Scanned] = []
    damage: Exception | None = None
    try:
        found.extend(chunk)
    except Exception as error:
        damage = error
    # `extend` keeps what came before the error.
    yield from sorted(found, key=attrgetter("log_time"))
    if damage is not None:
        raise damage


def scan(path: Path, kind: str) -> Iterator[Scanned]:
    """Give the messages of one storage file in the order in which they were written.

    Parameters
    ----------
    kind
        ``.mcap``, ``.db3`` or ``.bag``.

    Raises
    ------
    ScanDamage
        After the readable messages, if the file ends too early or is damaged.
    """
    from smallwheel_ros.bags import scan_mcap, scan_ros1, scan_sqlite

    scanners = {".mcap": scan_mcap.scan, ".db3": scan_sqlite.scan, ".bag": scan_ros1.scan}
    try:
        yield from scanners[kind](path)
    except ScanDamage:
        raise
    except OSError as error:
        raise ScanDamage(f"cannot be read: {error.strerror or error}") from error
    except Exception as error:
        # Damaged bytes can mean anything, so any error is damage here.
        raise ScanDamage(f"damaged: {error or type(error).__name__}") from error
