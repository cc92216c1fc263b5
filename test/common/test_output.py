# SPDX-License-Identifier: Apache-2.0
"""Where results are written: whole or not at all, and never in the place of a device or a link.

Tests `files.py`.
"""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest

from smallwheel_ros.common.files import OutputError, write_bytes, write_whole


def test_a_pipe_stays_a_pipe(tmp_path: Path) -> None:
    """As /dev/null and /dev/stdout must: `--json /dev/stdout` may not replace the device."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    got: list[bytes] = []
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()), daemon=True)
    reader.start()
    write_bytes(pipe, b"result")
    reader.join(10.0)
    assert got == [b"result"]
    assert pipe.is_fifo()


@pytest.mark.parametrize("there", [True, False])
def test_a_link_stays_a_link(tmp_path: Path, there: bool) -> None:
    (tmp_path / "elsewhere").mkdir()
    target = tmp_path / "elsewhere" / "real.json"
    if there:
        target.write_bytes(b"old")
    link = tmp_path / "link.json"
    link.symlink_to(target)
    write_bytes(link, b"new")
    assert link.is_symlink()
    assert target.read_bytes() == b"new"
    assert [path.name for path in target.parent.iterdir()] == ["real.json"]


def test_what_fails_leaves_the_old_file_and_no_draft(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_bytes(b"old")

    def full(draft: Path) -> None:
        draft.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match="No space left"):
        write_whole(path, full)
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["result.json"]


def test_a_folder_that_takes_no_files_is_one_message() -> None:
    with pytest.raises(OutputError, match="cannot be written"):
        write_bytes("/proc/result.json", b"new")
