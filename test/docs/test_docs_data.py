# SPDX-License-Identifier: Apache-2.0
"""Each table in docs/data.md is read, or refused, with what the page says of it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import MeasurementsError

PAGE = Path(__file__).resolve().parents[2] / "docs" / "data.md"
EXAMPLES = re.findall(
    r"```none(?: map: (?P<map>[^\n]*))?\n(.*?)```\n(?:```text\n(.*?)```)?",
    PAGE.read_text(encoding="utf-8"),
    re.DOTALL,
)
REFUSED = (8, 9)  # the last two


def test_there_are_ten() -> None:
    assert len(EXAMPLES) == 10


@pytest.mark.parametrize("number", range(10))
def test_what_is_said_of_an_example_is_so(tmp_path: Path, number: int) -> None:
    given, table, words = EXAMPLES[number]
    path = tmp_path / "table.csv"
    path.write_text(table, encoding="utf-8")
    mapping = dict([given.split("=")]) if given else {}
    if number in REFUSED:
        with pytest.raises(MeasurementsError) as caught:
            read_measurements(path, map=mapping)
        said = str(caught.value)
    else:
        data = read_measurements(path, map=mapping)
        said = "\n".join((*data.understood, *data.notes, *data.warnings))
    assert words or number == 0
    for line in words.splitlines():
        assert line in said, said
