"""Write results: a file is there whole or not at all."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
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
    path = check_target(path)
    try:
        handle, draft = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            os.chmod(draft, 0o644)  # as any other new file, not private as a temporary one
            os.replace(draft, path)
        except BaseException:
            os.unlink(draft)
            raise
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None


def json_text(document: Mapping[str, Any]) -> str:
    """Give the document as JSON text; a number that is not finite is a defect: ValueError."""
    return json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
