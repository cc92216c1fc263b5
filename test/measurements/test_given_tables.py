# SPDX-License-Identifier: Apache-2.0
"""How a table is typed: by its file's name, several where a lab has several, a folder where one may be.

Tests `given.py`.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from smallwheel_ros.api.compare import compare
from smallwheel_ros.api.diagnose import diagnose
from smallwheel_ros.api.fit import fit
from smallwheel_ros.commands.command import kinds_of


@pytest.mark.parametrize(
    ("function", "several", "folder"),
    [(compare, False, True), (diagnose, False, False), (fit, True, False)],
)
def test_a_table_is_a_file_without_an_option(function, several, folder):  # type: ignore[no-untyped-def]
    (kind, _), *_ = kinds_of(function).values()
    assert (kind.type, kind.unnamed) == (Path, True)
    assert (kind.several, kind.or_folder) == (several, folder)
