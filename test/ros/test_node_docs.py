# SPDX-License-Identifier: Apache-2.0
"""The node's documentation: every reason is explained, every command of the first steps runs."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from node_peer import documented_reasons

from smallwheel_ros.pipeline.answers import Status

# As the pipeline counts: `note(stream, "reason", ...)`, or `return "reason", words` for who notes it.
_REASON = re.compile(
    r'(?:(?:note|_refuse)\(\s*[^()"]*(?:\(\))?[^()"]*,\s*|return |fault = )"([a-z_]+)",'
)


def test_every_reason_that_the_pipeline_counts_is_in_the_table(repository: Path) -> None:
    """Those that the node counts besides are looked up in test_node.py, where they are counted."""
    package = repository / "smallwheel_ros"
    texts = [path.read_text() for path in sorted((package / "pipeline").glob("*.py"))]
    found = {reason for text in texts for reason in _REASON.findall(text)}
    assert {"late", "duplicate", "time_jump", "not_readable", "no_value"} <= found
    assert found | {"not_finite", "not_plausible"} <= documented_reasons(repository)


def test_every_status_is_in_the_table(repository: Path) -> None:
    text = (repository / "docs" / "node.md").read_text()
    for status in Status:
        assert f"| {status.name} |" in text


def test_the_first_steps_run(repository: Path, tmp_path: Path) -> None:
    text = (repository / "docs" / "bag_to_map.md").read_text()
    blocks = re.findall(r"^```sh\n(.*?)```", text, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 3
    for part in ("config", "examples"):
        (tmp_path / part).symlink_to(repository / part)
    for block in blocks:
        program, *arguments = block.split()
        command = [sys.executable, *arguments]
        if program == "smallwheel":
            command = [sys.executable, "-m", "smallwheel_ros.cli", *arguments]
        done = subprocess.run(
            command,
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=300,
            env={**os.environ, "PYTHONPATH": str(repository)},
        )
        assert done.returncode == 0, done.stderr
    picture = (tmp_path / "cost_map.png").read_bytes()
    assert picture[:8] == b"\x89PNG\r\n\x1a\n"
    assert "cells are known" in done.stdout
