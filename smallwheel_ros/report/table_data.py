# SPDX-License-Identifier: Apache-2.0
"""A table and what models leave of it, as the data that a page draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.held_out import CvErrors
from smallwheel_ros.measurements.cells import clipped
from smallwheel_ros.measurements.columns import CHANNEL_UNITS
from smallwheel_ros.measurements.display import Display, column_display, display, words
from smallwheel_ros.measurements.settings import levels
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.pictures.layers import thinned

Index = NDArray[np.intp]


class TableData:
    """Rows of a table that a page shows. rows: by channel, of the table. settings: names."""

    def __init__(
        self, measurements: Measurements, errors: Sequence[CvErrors], settings: Sequence[str]
    ) -> None:
        self.measurements, self.settings = measurements, list(settings)
        self.rows = {
            name: thinned(
                np.flatnonzero(
                    np.any([np.isfinite(e.error[name]) for e in errors if name in e.error], axis=0)
                )
            )
            for name in measurements.channels
            if any(name in e.error for e in errors)
        }
        self.rows = {name: rows for name, rows in self.rows.items() if rows.size}

    def data(self, floors: Mapping[str, float | None]) -> dict[str, Any]:
        """What the page draws. floors: expected error of a true model by channel, SI."""
        table = self.measurements
        kept = (
            np.unique(np.concatenate(list(self.rows.values()))) if self.rows else np.zeros(0, int)
        )
        runs, run = np.unique(table.run[kept], return_inverse=True)
        texts = {"soil": table.soil, **table.labels}
        return {
            "place": table.place,
            "line": table.line[kept].tolist(),
            "run": run.reshape(-1).tolist(),
            "runs": [str(name) for name in runs],
            "texts": {
                name: [clipped(str(value)) for value in values[kept]]
                for name, values in texts.items()
                if np.unique(values).size > 1
            },
            "settings": {name: self._setting(name, kept) for name in self.settings},
            "channels": {
                name: self._channel(name, rows, kept, floors.get(name))
                for name, rows in self.rows.items()
            },
        }

    def _setting(self, name: str, kept: Index) -> dict[str, Any]:
        how = column_display(self.measurements, name)
        values = self.measurements.conditions[name][kept] * how.scale
        known = values[np.isfinite(values)]
        few = levels(known) if known.size else None
        return {
            "words": words(name),
            "label": how.label,
            "unit": how.unit,
            "values": values.tolist(),
            "levels": None if few is None else few.tolist(),
        }

    def _channel(self, name: str, rows: Index, kept: Index, floor: float | None) -> dict[str, Any]:
        how = channel_display(name)
        return {
            "words": words(name),
            "label": how.label,
            "unit": how.unit,
            "rows": np.searchsorted(kept, rows).tolist(),
            "measured": (self.measurements.channels[name][rows] * how.scale).tolist(),
            "floor": None if floor is None else floor * how.scale,
        }

    def residual(self, errors: CvErrors) -> dict[str, list[float]]:
        """Measured less predicted of the rows shown, by channel."""
        return {
            name: [
                float(f"{e:.3g}") for e in errors.error[name][rows] * channel_display(name).scale
            ]
            for name, rows in self.rows.items()
            if name in errors.error
        }


def channel_display(name: str) -> Display:
    """How values of a channel are shown."""
    return display(name, CHANNEL_UNITS[name])
