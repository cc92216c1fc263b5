"""Shear tests as they were measured: an annulus or plate turned or dragged under one normal stress."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ShearTests:
    """Rows of shear tests; SI units, arrays of shape (rows,).

    normal_stress, shear_stress: Pa. displacement: j of the soil at the annulus's middle radius or under
    the plate, m. run: one test, a curve at one normal stress. soil: "" where the table names none.
    line: of the file.
    """

    normal_stress: Array
    shear_stress: Array
    displacement: Array
    run: NDArray[np.str_]
    soil: NDArray[np.str_]
    line: NDArray[np.intp]
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    source: str = ""
    sha256: str = ""

    def __len__(self) -> int:
        return int(self.displacement.size)

    def take(self, rows: NDArray[np.bool_]) -> ShearTests:
        """Keep the rows of that mask."""
        arrays = ("normal_stress", "shear_stress", "displacement", "run", "soil", "line")
        return replace(self, **{name: getattr(self, name)[rows] for name in arrays})
