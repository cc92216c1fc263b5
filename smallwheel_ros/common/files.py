# SPDX-License-Identifier: Apache-2.0
"""Write results whole or not at all; read small text files, never a device or a pipe."""

from __future__ import annotations

import errno
import glob
import json
import os
import stat
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from smallwheel_ros.common.errors import SmallwheelError

_DRAFT = ".draft."  # in the name of a file that is being written, between its own and eight letters
_LEFT = 3600.0  # s after which a draft must be that of a killed process: writing takes seconds
LARGEST = 1_000_000  # bytes; a model file with the covariance of 200 parameters stays below


class OutputError(SmallwheelError):
    """A result cannot be written to the requested place."""


def check_target(path: str | Path) -> Path:
    """Return the path if a file can be made there; to be called before a long computation.

    Raises OutputError if its folder does not exist or the path is a folder.
    """
    path = Path(path)
    if path.is_dir():
        raise OutputError(f"{path}: cannot be written: it is a folder, expected a file's name")
    if not path.parent.is_dir():
        raise OutputError(f"{path}: cannot be written: the folder {path.parent} does not exist")
    return path


def check_targets(
    targets: Iterable[str | Path | None], inputs: Iterable[str | Path | None] = ()
) -> None:
    """Check before a long computation that outputs can be written and would not overwrite an input.

    Parameters
    ----------
    targets
        Files that a command is to write; - (standard output) and None are ignored.
    inputs
        Files that it reads; None is ignored.

    Raises
    ------
    OutputError
        If a target cannot be written, is an input, or is named twice.
    """
    paths = [check_target(path) for path in targets if path is not None and str(path) != "-"]
    given = [Path(path) for path in inputs if path is not None]
    files = [path for path in paths if path.is_file() or not path.exists()]  # no device or pipe
    for path in files:
        if path.exists() and any(one.exists() and os.path.samefile(path, one) for one in given):
            raise OutputError(f"{path}: is read by this command, expected another name to write to")
        if sum(path.resolve() == other.resolve() for other in files) > 1:
            raise OutputError(f"{path}: two outputs name the same file, expected two")
        folder = Path(os.path.realpath(path)).parent
        try:
            tempfile.TemporaryFile(dir=folder).close()
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None


def check_folder_target(path: Path | None) -> None:
    """Check that a folder for pictures is not an existing file. Raises OutputError if it is."""
    if path is not None and path.exists() and not path.is_dir():
        raise OutputError(f"{path}: a file, expected a folder for the pictures")


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a file atomically: an existing one is replaced only by a complete one.

    Parameters
    ----------
    path
        The file.
    content
        Its whole content.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    write_whole(path, lambda draft: draft.write_bytes(content))


def write_whole(path: str | Path, write: Callable[[Path], object]) -> None:
    """Let a function write a draft beside `path`, then move the draft there in one step.

    A link is kept, and its target replaced. A device or a pipe (/dev/null, /dev/stdout) is written to
    directly: replacing it by a file would take it from every other program.

    Parameters
    ----------
    path
        The file.
    write
        Called once with the path of the draft, which it has to write.

    Raises
    ------
    OutputError
        If the file cannot be written; then an existing one is unchanged.
    """
    path = check_target(path)
    if path.exists() and not path.is_file():
        with _said_of(path):
            write(path)
        return
    _put([(path, write)])


def write_together(files: Mapping[Path, bytes]) -> None:
    """Write files that belong together: all are written to drafts before the first gets its name.

    A process that is killed leaves all of them old or all of them new, except in the moment in which
    they get their names: a reader must check that they belong together.

    Parameters
    ----------
    files
        Contents by path, in the order in which the files get their names.

    Raises
    ------
    OutputError
        If a draft cannot be written, then no file is changed; or if one cannot get its name.
    """
    _put([(check_target(path), partial(_write, content)) for path, content in files.items()])


def _write(content: bytes, draft: Path) -> None:
    draft.write_bytes(content)


@contextmanager
def _said_of(path: Path) -> Iterator[None]:
    """Turn an error of the system on writing a file into an OutputError that names the file."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None


def _put(files: Sequence[tuple[Path, Callable[[Path], object]]]) -> None:
    """Write all files as drafts beside their places, then move them there."""
    drafts: list[tuple[Path, Path, Path]] = []
    try:
        for path, write in files:
            with _said_of(path):
                target = Path(os.path.realpath(path))
                handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}{_DRAFT}")
                os.close(handle)
                draft = Path(name)
                drafts.append((path, draft, target))
                write(draft)
                draft.chmod(0o644)  # as any other new file, not private as a temporary one
                with draft.open("rb") as stream:
                    os.fsync(stream.fileno())  # on the disk before its name is, if the power fails
        for path, draft, target in drafts:
            with _said_of(path):
                draft.replace(target)
    except BaseException:
        for _, draft, _ in drafts:
            draft.unlink(missing_ok=True)
        raise


def sweep_drafts(path: Path) -> None:
    """Delete drafts that killed processes have left of a file, and of files whose names begin with its name.

    Only drafts that were not written to for an hour are deleted; those that cannot be deleted stay.
    """
    target = Path(os.path.realpath(path))
    for draft in target.parent.glob(f".{glob.escape(target.name)}*{_DRAFT}*"):
        with suppress(OSError):
            if time.time() - draft.stat().st_mtime > _LEFT:
                draft.unlink()


def json_text(document: Mapping[str, Any]) -> str:
    """The document as JSON text. Raises ValueError for a number that is not finite: `tables.plain` first."""
    return json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def read_text_file(path: Path | str) -> str:
    """Return the text (UTF-8) of a file of at most `LARGEST` bytes.

    Raises
    ------
    OSError
        If there is no such file, it cannot be read, is no regular file, or is larger; `strerror` is
        the reason in words.
    UnicodeDecodeError
        If it is not UTF-8.
    """
    try:
        # A pipe without a writer would block the opening.
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except ValueError as error:
        raise OSError(errno.EINVAL, f"the name is not possible ({error})") from None
    with os.fdopen(handle, "rb") as stream:  # raises for a folder
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError(errno.EINVAL, "it is a device or a pipe, expected a file")
        content = stream.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise OSError(errno.EFBIG, f"it has more than {LARGEST} bytes, the most that is read")
    return content.decode("utf-8")
