# SPDX-License-Identifier: Apache-2.0
"""Where results are written: whole or not at all, and never in the place of a device or a link.

Tests `files.py`.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from smallwheel_ros.common.files import OutputError, sweep_drafts, write_bytes, write_whole


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


def test_what_a_killed_process_left_is_taken_away_once_nobody_writes_it_any_more(
    tmp_path: Path,
) -> None:
    """A process that is killed in the middle of a file leaves its draft, of the file and of those beside."""
    target, beside = tmp_path / "soil.json", tmp_path / "soil.json.cost_map.yaml"
    dies = (
        "import os, signal, sys; from pathlib import Path;"
        "from smallwheel_ros.common.files import write_whole;"
        "write_whole(Path(sys.argv[1]),"
        " lambda draft: (draft.write_bytes(b'half'), os.kill(os.getpid(), signal.SIGKILL)))"
    )
    for path in (target, beside):
        done = subprocess.run([sys.executable, "-c", dies, path], check=False)
        assert done.returncode == -signal.SIGKILL
    theirs = tmp_path / ".soil.json.original"
    theirs.write_bytes(b"of somebody")
    left = {path for path in tmp_path.iterdir() if path != theirs}
    assert len(left) == 2
    sweep_drafts(target)
    assert left <= {*tmp_path.iterdir()}  # somebody may still be writing these
    for path in (*left, theirs):
        os.utime(path, (0.0, 0.0))
    sweep_drafts(target)
    assert [*tmp_path.iterdir()] == [theirs]
