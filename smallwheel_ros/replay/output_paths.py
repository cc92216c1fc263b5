"""The folder of a replay: what is in it, what an earlier replay left, what is done."""

from __future__ import annotations

import csv
import fcntl
import io
import json
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from smallwheel_ros.output import json_text, write_bytes
from smallwheel_ros.replay.spec import ReplayError, ReplaySpec
from smallwheel_ros.replay.steady_segments import SteadySegments

SUMMARY = "replay.json"
ESTIMATES, MEASUREMENTS, REPORT, BAG = "estimates", "measurements.csv", "report.html", "bag"
_FILES = (
    f"{ESTIMATES}.csv",
    f"{ESTIMATES}.parquet",
    f"{ESTIMATES}.csv.part",
    f"{ESTIMATES}.parquet.part",
    MEASUREMENTS,
    REPORT,
    SUMMARY,
)


def csv_text(header: Iterable[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """Return rows as CSV."""
    names = list(header)
    text = io.StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def read_summary(folder: Path) -> dict[str, Any] | None:
    """Return what a replay into that folder said of itself; None where there is none."""
    try:
        content = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def done_before(spec: ReplaySpec) -> dict[str, Any] | None:
    """Return the summary of the same replay if it is there and complete."""
    summary = read_summary(spec.folder)
    if summary is None or summary.get("state") not in ("complete", "ended_early"):
        return None
    try:
        same = summary.get("fingerprint") == spec.fingerprint()
    except OSError:
        return None
    there = all((spec.folder / name).exists() for name in summary.get("files", {}).values())
    return summary if same and there else None


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Make a folder and keep other replays out of it meanwhile, also those that are killed.

    Raises
    ------
    ReplayError
        If it cannot be made, or another replay is at work in it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise ReplayError(f"folder {folder} cannot be used: {error.strerror or error}") from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ReplayError(
                f"folder {folder}: another replay is writing into it; wait until it is done, or"
                " give another folder with -o"
            ) from None
        except OSError:
            pass  # a file system without locks
        yield
    finally:
        os.close(handle)


class OutputPaths:
    """Where the outputs of one replay go.

    Raises
    ------
    ReplayError
        If the folder cannot be used, or holds something else under the names needed.
    """

    def __init__(self, spec: ReplaySpec) -> None:
        self._spec, self._folder = spec, spec.folder
        self.estimates = self._folder / ESTIMATES
        self.bag = self._folder / BAG
        self.report = self._folder / REPORT

    def check(self) -> None:
        """Raise ReplayError if the folder is the bag, or the bag is what would be cleared."""
        folder = self._folder
        if folder.resolve() == self._spec.bag.resolve():
            raise ReplayError(f"folder {folder} is the bag itself: give another one with -o")
        if self._spec.bag.resolve().is_relative_to(self.bag.resolve()):
            raise ReplayError(
                f"bag {self._spec.bag} is what an earlier replay has written into folder {folder},"
                " which a new one clears: give another one with -o"
            )

    def begin(self) -> bool:
        """Clear the folder of an earlier replay; note that one is under way.

        Returns whether the earlier one was killed in its midst.
        """
        folder, killed = self._folder, False
        try:
            before = read_summary(folder)
            if before is None:
                there = [name for name in (*_FILES, BAG) if (folder / name).exists()]
                if there:
                    raise ReplayError(
                        f"folder {folder} has {there[0]}, which no replay has made: give another"
                        " folder, or remove it"
                    )
            else:
                killed = before.get("state") == "running"
                for name in _FILES:
                    (folder / name).unlink(missing_ok=True)
                # The second: what a replay that was killed had written of its bag.
                for leftover in (self.bag, *folder.glob(f".{BAG}-*")):
                    shutil.rmtree(leftover, ignore_errors=True)
            self._write({"schema": 1, "state": "running", "bag": str(self._spec.bag)})
        except OSError as error:
            raise ReplayError(
                f"folder {folder} cannot be used: {error.strerror or error}"
            ) from error
        return killed

    def _write(self, content: dict[str, Any]) -> None:
        write_bytes(self._folder / SUMMARY, json_text(content).encode())

    def write_measurements(self, segments: SteadySegments) -> None:
        """Write the steady stretches as a table of measurements, if there are any."""
        rows = list(segments.table())
        if rows:
            write_bytes(self._folder / MEASUREMENTS, csv_text(rows[0], rows).encode())

    def files(self) -> dict[str, str]:
        """Return what has been written, by what it is, as names in the folder."""
        names = {
            "estimates_csv": f"{ESTIMATES}.csv",
            "estimates_parquet": f"{ESTIMATES}.parquet",
            "measurements": MEASUREMENTS,
            "bag": BAG,
            "report": REPORT,
        }
        return {what: name for what, name in names.items() if (self._folder / name).exists()}

    def finish(self, document: dict[str, Any]) -> None:
        """Write the summary: from now on this replay is done."""
        self._write(document)
