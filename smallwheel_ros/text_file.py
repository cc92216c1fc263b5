# SPDX-License-Identifier: Apache-2.0
"""Read a small text file whole, and nothing but a file: a device or a pipe would never end."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

LARGEST = 1_000_000  # bytes; a model file with the covariance of 200 parameters stays below


def read_text_file(path: Path | str) -> str:
    """Return the text (UTF-8) of a file of at most `LARGEST` bytes.

    Raises
    ------
    OSError
        If there is no such file, it cannot be read, is no regular file, or is larger; `strerror`
        says it in words.
    UnicodeDecodeError
        If it is not UTF-8.
    """
    try:
        # A pipe that nobody writes to would block the opening.
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
