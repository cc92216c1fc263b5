# SPDX-License-Identifier: Apache-2.0
"""Figures into a folder."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path

from matplotlib.figure import Figure

from smallwheel_ros.common.files import OutputError, write_bytes


def write_figures(figures: Mapping[str, Figure], folder: Path) -> list[Path]:
    """Write each figure as PNG under its name. Raises OutputError where it cannot."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error.strerror or error}") from None
    written = []
    for name, figure in figures.items():
        picture = io.BytesIO()
        figure.savefig(picture, format="png", dpi=150)
        written.append(folder / f"{name}.png")
        write_bytes(written[-1], picture.getvalue())
    return written
