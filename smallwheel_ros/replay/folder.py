# SPDX-License-Identifier: Apache-2.0
"""The folder of a replay: what is in it, what an earlier replay left, what is done."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from smallwheel_ros.common.files import json_text, write_bytes
from smallwheel_ros.replay.spec import ReplayError, ReplaySpec

SUMMARY, ESTIMATES, MEASUREMENTS, BAG = "replay.json", "estimates", "measurements.csv", "bag"
FILES = {
    "estimates_csv": f"{ESTIMATES}.csv",
    "estimates_parquet": f"{ESTIMATES}.parquet",
    "measurements": MEASUREMENTS,
    "bag": BAG,
    "report": "report.html",
    "cost_map": "cost_map.yaml",
    "cost_map_image": "cost_map.pgm",
}
_UNFINISHED = f"{ESTIMATES}.csv.part"


def files_in(folder: Path) -> dict[str, str]:
    """Return what has been written, by what it is, as names in the folder."""
    return {what: name for what, name in FILES.items() if (folder / name).exists()}


def read_summary(folder: Path) -> dict[str, Any] | None:
    """Return what a replay into that folder said of itself; None where there is none."""
    try:
        content = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def write_summary(folder: Path, content: dict[str, Any]) -> None:
    """Say of a replay what became of it. Raises OutputError."""
    write_bytes(folder / SUMMARY, json_text(content).encode())


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
        raise _unusable(folder, error) from error
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


def _unusable(folder: Path, error: OSError) -> ReplayError:
    return ReplayError(f"folder {folder} cannot be used: {error.strerror or error}")


def check_folder(spec: ReplaySpec) -> None:
    """Raise ReplayError if the folder is the bag, or the bag is what would be cleared."""
    folder, bag = spec.folder, spec.bag.resolve()
    if folder.resolve() == bag:
        raise ReplayError(f"folder {folder} is the bag itself: give another one with -o")
    if bag.is_relative_to((folder / BAG).resolve()):
        raise ReplayError(
            f"bag {spec.bag} is what an earlier replay has written into folder {folder}, which a"
            " new one clears: give another one with -o"
        )


def begin(spec: ReplaySpec) -> bool:
    """Clear the folder of an earlier replay, drafts of a killed one too; note that one is under way.

    Returns
    -------
    bool
        Whether the earlier one was killed in its midst.

    Raises
    ------
    ReplayError
        If the folder cannot be used, or holds something else under the names needed.
    """
    folder, before = spec.folder, read_summary(spec.folder)
    names = (*FILES.values(), _UNFINISHED, SUMMARY)
    try:
        if before is None:
            for name in names:
                if (folder / name).exists():
                    raise ReplayError(
                        f"folder {folder} has {name}, which no replay has made: give another"
                        " folder, or remove it"
                    )
        else:
            # What a replay that was killed had not put in its place yet.
            drafts = (path for name in names for path in folder.glob(f".{name}[.-]*"))
            for path in (*(folder / name for name in names), *drafts):
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink(missing_ok=True)
        write_summary(folder, {"schema": 1, "state": "running", "bag": str(spec.bag)})
    except OSError as error:
        raise _unusable(folder, error) from error
    return before is not None and before.get("state") == "running"
