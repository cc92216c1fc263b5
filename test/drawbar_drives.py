# SPDX-License-Identifier: Apache-2.0
"""Parameters of a rover whose load cells measure drawbar pull as well."""

from __future__ import annotations

from pathlib import Path

import yaml


def with_pulls(rover: Path, folder: Path) -> Path:
    """The rover's parameters, with drawbar pull from the load cells."""
    content = yaml.safe_load(rover.read_text())
    (node,) = content.values()
    values = node["ros__parameters"]
    for wheel in values["wheels"]:
        values.setdefault(wheel, {})["drawbar_pull_topic"] = f"{wheel}/load"
    path = folder / "with_pulls.yaml"
    path.write_text(yaml.safe_dump(content))
    return path
