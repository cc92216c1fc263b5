# SPDX-License-Identifier: Apache-2.0
"""The node's documentation: every reason and every status is explained."""

from __future__ import annotations

import re
from pathlib import Path

from node_peer import documented_reasons

from smallwheel_ros.pipeline.mobility.status import Status

# As the pipeline counts: `note(stream, "reason", ...)`, or `return "reason", words` for who notes it.
_REASON = re.compile(
    r'(?:(?:note|_refuse)\(\s*[^()"]*(?:\(\))?[^()"]*,\s*|return |fault = )"([a-z_]+)",'
)


def test_every_reason_that_the_pipeline_counts_is_in_the_table(repository: Path) -> None:
    """Those that the node counts besides are looked up in test_node.py, where they are counted."""
    package = repository / "smallwheel_ros"
    files = [*(package / "pipeline").rglob("*.py"), *(package / "drive").glob("*.py")]
    texts = [path.read_text() for path in files]
    found = {reason for text in texts for reason in _REASON.findall(text)}
    assert {"late", "duplicate", "time_jump", "not_readable", "no_value"} <= found
    assert found | {"not_finite", "not_plausible"} <= documented_reasons(repository)


def test_every_status_is_in_the_table(repository: Path) -> None:
    text = (repository / "docs" / "node.md").read_text()
    for status in Status:
        assert f"| {status.name} |" in text
