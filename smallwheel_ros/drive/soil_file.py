# SPDX-License-Identifier: Apache-2.0
"""The saved soil that a drive continues from, written again at its end, and the cost map beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.files import sweep_drafts
from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.costmap.grid import Grid, digest_of, map_files, read_map, write_map
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.soil.saved_state import check_may_replace, write_state

from .messages import soil_fields


class SoilFileError(SmallwheelError):
    """A soil cannot be saved; the message says why."""


@dataclass(frozen=True)
class SoilAndMap:
    """Contents of the files to be saved: that of the soil, and those of the cost map.

    Attributes
    ----------
    soil
        Content of the soil's file.
    beside
        Contents of the cost map's files by path, which are written before the soil's; empty for no map.
    digest
        SHA-256 of the map that belongs to the soil (`grid.digest_of`); None for no map.
    words, map_words
        What is saved of the soil and of the map, in words for the user.
    """

    soil: bytes
    beside: Mapping[Path, bytes]
    digest: str | None
    words: str
    map_words: str


class SoilFile:
    """The file of a saved soil (parameter soil.file), and the cost map saved beside it.

    The file contains the SHA-256 of the map that was saved with it, so that a map of another soil is
    not used. When a new pair is saved, the old map is first copied to a second name: if the process is
    killed before the new soil is written, the old soil still has its map.

    Parameters
    ----------
    name
        Path of the file; empty for no file.

    Attributes
    ----------
    problem
        Why the saved soil is not used, in words; empty if it is, or if there is none.
    """

    def __init__(self, name: str) -> None:
        self._path = Path(name).expanduser() if name else None
        # The cost map is saved beside it.
        self._map_path = self._path and self._path.with_name(f"{self._path.name}.cost_map.yaml")
        self._before = self._path and self._path.with_name(
            f"{self._path.name}.cost_map.before.yaml"
        )
        self._digest: str | None = None  # of the map of the saved soil
        self.problem = ""

    # --- Going on from it

    def restore(self, pipeline: Pipeline) -> str:
        """Restore the pipeline's state from the file; return what was restored, in words, or an empty text.

        If the file cannot be used, `problem` says why, and the pipeline is reset.
        """
        if self._path is None:
            return ""
        sweep_drafts(self._path)
        if not self._path.exists():
            return ""
        try:
            self._digest = pipeline.restore(self._path).cost_map
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
        """Restore the cost map that was saved with the soil, after `restore`.

        Returns what was restored, or why the map is not used, in words; an empty text if there is no map or
        the soil was not restored.
        """
        path, before = self._map_path, self._before
        if path is None or before is None or not path.exists() or self.problem:
            return ""
        try:
            grid = read_map(path)
        except SmallwheelError as error:
            return f"the saved cost map is not used: {error}"
        if digest_of(grid) != self._digest and (old := _map_at(before)) is not None:
            path, grid = before, old
        if digest_of(grid) != self._digest:
            return (
                f"the saved cost map is not used: {path} was not saved with the soil of {self._path}, or"
                " was changed; the soil is used alone"
            )
        cost_map.remember(grid)
        count = int((grid.cells >= 0).sum())
        return f"cost map restored from {path}: {count} cells in {grid.frame}"

    # --- Saving

    def prepared(self, pipeline: Pipeline, cost_map: CostMap) -> SoilAndMap:
        """Make the contents of the files that would be saved now.

        Parameters
        ----------
        pipeline
            Pipeline whose soil is saved.
        cost_map
            Cost map; it is saved with the soil if it has any cell.

        Raises
        ------
        SoilFileError
            If there is no file to write to, or the soil has not been measured yet.
        """
        if self._path is None:
            raise SoilFileError("parameter soil.file is empty: set the file to save to")
        if pipeline.soil.accepted == 0:
            raise SoilFileError("the soil has not been measured yet")
        path, whole = self._map_path, cost_map.whole()
        beside: Mapping[Path, bytes] = {}
        digest, words = None, ""
        if path is not None and whole is not None:
            if cost_map.remembered is not None and cost_map.remembered.frame != whole.frame:
                words = f"{path} is left as it is: {cost_map.problem}"
                digest = self._digest
            else:
                beside = map_files(path, whole)
                digest = digest_of(whole)
                words = f"{path} in {whole.frame}"
        of_soil = f"{self._path}: {pipeline.soil.accepted} measurements"
        return SoilAndMap(pipeline.saved(digest), beside, digest, of_soil, words)

    def write(self, given: SoilAndMap) -> str:
        """Write prepared files; return what was written, in words. Raises SmallwheelError if it fails."""
        assert self._path is not None
        check_may_replace(self._path)
        beside, map_words = given.beside, given.map_words
        try:
            if any(path.exists() for path in beside):
                self._keep_what_goes_with_the_soil()
        except SmallwheelError as error:
            beside, map_words = {}, f"the cost map is not saved: {error}"
        write_state(self._path, given.soil, beside)
        self._digest = given.digest
        return "; ".join(filter(None, [given.words, map_words]))

    def _keep_what_goes_with_the_soil(self) -> None:
        """Copy the map that is about to be replaced to its second name, if it belongs to the saved soil."""
        assert self._map_path is not None
        assert self._before is not None
        there = read_map(self._map_path)
        if digest_of(there) == self._digest:
            write_map(self._before, there)

    def save(self, pipeline: Pipeline, cost_map: CostMap) -> tuple[bool, str]:
        """Save soil and cost map, if there is anything to save.

        Parameters
        ----------
        pipeline, cost_map
            Pipeline whose soil is saved, and the cost map that is saved with it.

        Returns
        -------
        saved, words : bool, str
            Whether the soil was saved, and what was saved or why nothing was, in words for the user.
        """
        try:
            return True, self.write(self.prepared(pipeline, cost_map))
        except SmallwheelError as error:
            return False, f"nothing saved: {error}"


def _map_at(path: Path) -> Grid | None:
    try:
        return read_map(path)
    except SmallwheelError:
        return None


def _check_finite(fields: dict[str, Any]) -> None:
    for name, value in fields.items():
        if not isinstance(value, str) and not np.isfinite(value).all():
            raise ValueError(f"{name} would be {value}")
