# SPDX-License-Identifier: Apache-2.0
"""Types of arguments by which users name a table of measurements."""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from smallwheel_ros.arguments import Kind

if TYPE_CHECKING:
    import pandas as pd

    from smallwheel_ros.measurements.measurements import Measurements, ShearTests

_Table: TypeAlias = "Measurements | str | PathLike[str] | pd.DataFrame"

Data = Annotated["_Table", Kind(type=Path, unnamed=True)]
Settings = Annotated["_Table", Kind("TABLE", type=Path)]
Tests = Annotated[
    "_Table | ShearTests | Sequence[_Table | ShearTests]",
    Kind(type=Path, unnamed=True, several=True),
]
DataOrSets = Annotated["_Table", Kind("DATA|FOLDER", type=Path, unnamed=True, or_folder=True)]
