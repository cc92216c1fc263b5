# SPDX-License-Identifier: Apache-2.0
"""Decompression that knows when to stop: a few kilobytes can be made to unpack to gigabytes."""

from __future__ import annotations

import bz2
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

from smallwheel_ros.common.errors import SmallwheelError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

# What one chunk or message may unpack to: the largest that robots record, raw pictures and clouds
# of points, are some tens of megabytes.
LARGEST = 64 << 20
# What a file may unpack to, as a multiple of its size. Pictures of depth, mostly zeros, reach 30.
MOST_TIMES = 100
_PIECE = 1 << 20
_DECOMPRESSORS: dict[bytes, Callable[[], Any]] = {
    b"\x28\xb5\x2f\xfd": zstd.ZstdDecompressor,
    b"\x04\x22\x4d\x18": LZ4FrameDecompressor,
    b"BZh": bz2.BZ2Decompressor,
}
_MAGICS = tuple(_DECOMPRESSORS)


class UnpackError(SmallwheelError):
    """Compressed data is damaged, or unpacks to more than the limit."""


def _check(size: int, limit: int) -> None:
    if size > limit:
        raise UnpackError(
            f"it unpacks to more than {limit >> 20} MiB, the limit here: a chunk or message may"
            f" unpack to {LARGEST >> 20} MiB, a file to {MOST_TIMES} times its size; if the bag is"
            " sound, decompress it with the tool that made it"
        )


class Unpacker:
    """Decompresses the parts of one file, within limits on each part and on the whole.

    size: of the file, bytes.
    """

    def __init__(self, size: int) -> None:
        self._left = max(LARGEST, MOST_TIMES * size)

    def __call__(self, data: bytes) -> bytes:
        """Return the data unpacked; as it is where it is not compressed (zstd, lz4, bz2).

        What ends too early gives what it holds. Raises UnpackError.
        """
        if not data.startswith(_MAGICS):
            return data
        make = next(make for magic, make in _DECOMPRESSORS.items() if data.startswith(magic))
        limit = min(LARGEST, self._left)
        try:
            found: bytes = make().decompress(data, limit + 1)
        except Exception as error:  # each library has errors of its own
            raise UnpackError(f"compressed data is damaged ({error})") from error
        _check(len(found), limit)
        self._left -= len(found)
        return found


def unpack_file(source: Path, target: Path) -> str:
    """Decompress a file (zstd) to wherever it ends; return what is wrong with it, or nothing."""
    limit = max(LARGEST, MOST_TIMES * source.stat().st_size)
    try:
        with zstd.open(source, "rb") as packed, target.open("wb") as plain:
            while piece := packed.read1(_PIECE):
                plain.write(piece)
                _check(plain.tell(), limit)
    except (zstd.ZstdError, EOFError, UnpackError) as error:
        return str(error)
    return ""
