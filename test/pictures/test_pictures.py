# SPDX-License-Identifier: Apache-2.0
"""How pictures look: as the pages do."""

from __future__ import annotations

import re
from pathlib import Path

from smallwheel_ros.pictures.house import wheel_colours


def test_a_wheel_has_the_colour_that_it_has_on_a_page(repository: Path) -> None:
    css = (repository / "smallwheel_ros" / "report" / "web" / "page.css").read_text()
    light = css[: css.index("color-scheme: light")]
    of_page = [colour.upper() for colour in re.findall(r"--w\d: (#\w{6})", light)]
    assert len(of_page) == 8
    colours = wheel_colours(f"wheel_{i}" for i in reversed(range(10)))
    assert [colours[f"wheel_{i}"] for i in range(10)] == [*of_page, *of_page[:2]]
