# SPDX-License-Identifier: Apache-2.0
"""A soil that a drive goes on from and that is saved at its end, with the cost map beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.costmap.grid import read_map, write_map
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.soil.saved_state import check_may_replace

from .messages import soil_fields


class SoilFile:
    """The file of the parameter soil.file; an empty name is none.

    problem: why the saved soil is not used, in words; empty where it is, or where there is none.
    """

    def __init__(self, name: str) -> None:
        self._path = Path(name).expanduser() if name else None
        # The cost map is saved beside it.
        self._map_path = self._path and self._path.with_name(f"{self._path.name}.cost_map.yaml")
        self.problem = ""

    def restore(self, pipeline: Pipeline) -> str:
        """Let a new estimate go on from the file; return in words what it goes on from."""
        if self._path is None or not self._path.exists():
            return ""
        try:
            pipeline.restore(self._path)
            _check_finite(soil_fields(pipeline.soil, pipeline.rejected))
        except SmallwheelError as error:
            self.problem = f"the saved soil is not used: {error}"
        except Exception as error:  # numbers that were not thought of
            self.problem = (
                f"the saved soil is not used: {self._path}: {type(error).__name__}: {error}; delete"
                " the file to begin with the prior"
            )
        if self.problem:
            pipeline.reset()  # it may be half restored
            return ""
        return f"soil restored from {self._path}: {pipeline.soil.accepted} measurements"

    def restore_map(self, cost_map: CostMap) -> str:
        """Let a cost map go on from the one beside the soil; return in words what came of it."""
        path = self._map_path
        if path is None or not path.exists() or self.problem:
            return ""
        try:
            grid = read_map(path)
        except SmallwheelError as error:
            return f"the saved cost map is not used: {error}"
        cost_map.remember(grid)
        count = int((grid.cells >= 0).sum())
        return f"cost map restored from {path}: {count} cells in {grid.frame}"

    def _save_map(self, cost_map: CostMap) -> str:
        path, whole = self._map_path, cost_map.whole()
        if path is None or whole is None:
            return ""
        if cost_map.remembered is not None and cost_map.remembered.frame != whole.frame:
            return f"{path} is left as it is: {cost_map.problem}"
        try:
            if path.exists() or path.with_suffix(".pgm").exists():
                read_map(path)  # nothing but a saved map is replaced
            write_map(path, whole)
        except SmallwheelError as error:
            return f"the cost map is not saved: {error}"
        return f"{path} in {whole.frame}"

    def save(self, pipeline: Pipeline, cost_map: CostMap) -> tuple[bool, str]:
        """Save soil and cost map; return whether the soil is saved, and in words what came of it."""
        if self._path is None:
            return False, "nothing saved: parameter soil.file says where to, and is empty"
        if pipeline.soil.accepted == 0:
            return False, "nothing saved: the soil has not been measured yet"
        try:
            check_may_replace(self._path)
            pipeline.save(self._path)
        except SmallwheelError as error:
            return False, f"nothing saved: {error}"
        saved = f"{self._path}: {pipeline.soil.accepted} measurements"
        return True, "; ".join(filter(None, [saved, self._save_map(cost_map)]))


def _check_finite(fields: dict[str, Any]) -> None:
    for name, value in fields.items():
        if not isinstance(value, str) and not np.isfinite(value).all():
            raise ValueError(f"{name} would be {value}")
