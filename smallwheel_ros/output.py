"""Write results: a file is there whole or not at all."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from smallwheel_ros.errors import SmallwheelError


class OutputError(SmallwheelError):
    """A result that cannot be written where it was asked for."""


def check_target(path: str | Path) -> Path:
    """Give the path if a file can be made there; ask before a long computation, not after it.

    Raises OutputError where the folder is missing or the path is a folder.
    """
    path = Path(path)
    if path.is_dir():
        raise OutputError(f"{path}: cannot be written: it is a folder, expected a file's name")
    if not path.parent.is_dir():
        raise OutputError(f"{path}: cannot be written: the folder {path.parent} does not exist")
    return path


def write_bytes(path: str | Path, content: bytes) -> None:
    """Put a file there in one step; one that was there is replaced only by a whole one.

    Raises OutputError where that is not possible.
    """
    write_whole(path, lambda draft: draft.write_bytes(content))


def write_whole(path: str | Path, write: Callable[[Path], object]) -> None:
    """Let `write` make a file beside `path`, then put it there in one step, as `write_bytes` does.

    A link stays, and what it points to is replaced. A device or a pipe (/dev/null, /dev/stdout) is
    written to as it is: put another file in its place, and every program would lose it.
    """
    path = check_target(path)
    try:
        if path.exists() and not path.is_file():
            write(path)
            return
        target = Path(os.path.realpath(path))
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
        os.close(handle)
        draft = Path(name)
        try:
            write(draft)
            draft.chmod(0o644)  # as any other new file, not private as a temporary one
            draft.replace(target)
        except BaseException:
            draft.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None


def json_text(document: Mapping[str, Any]) -> str:
    """Give the document as JSON text; a number that is not finite is a defect: ValueError."""
    return json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
