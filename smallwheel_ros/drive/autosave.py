# SPDX-License-Identifier: Apache-2.0
"""Automatic saving of soil and cost map, so that a robot that loses its power loses little.

The content is made between turns of the pipeline; a thread writes it, since a memory card may take seconds.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.drive.soil_file import SoilAndMap, SoilFile
from smallwheel_ros.pipeline.pipeline import Pipeline


class Autosave:
    """Saves the soil file automatically.

    Parameters
    ----------
    file
        The soil file. If the soil saved in it could not be used, saving is suspended.

    Attributes
    ----------
    held
        Why saving is suspended, in words; empty if it is not.
    problem
        Why the newest attempt failed, in words; empty if it did not.
    failures
        Number of failed attempts.
    """

    def __init__(self, file: SoilFile) -> None:
        self._file = file
        self.held = file.problem and "the file is left as it is, and nothing is saved by itself"
        self.problem = ""
        self.failures = 0
        self._written: SoilAndMap | None = None  # the newest that was given to be written
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="autosave")
        self._busy: Future[str] | None = None

    def begin(self, pipeline: Pipeline, cost_map: CostMap) -> None:
        """Begin to write soil and map in a thread if they have changed since the last time.

        It does nothing while a file is being written (`writes`), if saving is suspended, or before the soil
        has been measured.

        Parameters
        ----------
        pipeline, cost_map
            Pipeline whose soil is saved, and the cost map that is saved with it.
        """
        if self._busy is not None:
            return
        given = self._changed(pipeline, cost_map)
        if given is not None:
            self._written = given
            self._busy = self._thread.submit(self._file.write, given)

    def writes(self) -> bool:
        """Whether a file is still being written; if not, `problem` and `failures` are up to date."""
        if self._busy is not None and not self._busy.done():
            return True
        self._take_result()
        return False

    def finish(self, pipeline: Pipeline, cost_map: CostMap) -> None:
        """Save soil and map if they have changed, and wait until they are written.

        Parameters
        ----------
        pipeline, cost_map
            Pipeline whose soil is saved, and the cost map that is saved with it.
        """
        self._take_result()
        self.begin(pipeline, cost_map)
        self._take_result()

    def hold(self, why: str) -> None:
        """Suspend automatic saving, as the file is worth more than the present state; give the reason."""
        self.held = why

    def go_on(self) -> None:
        """Resume automatic saving, after a user has saved the present state."""
        self.held = ""

    def _changed(self, pipeline: Pipeline, cost_map: CostMap) -> SoilAndMap | None:
        if self.held or pipeline.soil.accepted == 0:
            return None
        given = self._file.prepared(pipeline, cost_map)
        return None if given == self._written else given

    def _take_result(self) -> None:
        """Wait for the thread, and note whether it failed."""
        if self._busy is None:
            return
        try:
            self._busy.result()
            self.problem = ""
        except SmallwheelError as error:
            self.problem, self._written = f"nothing saved: {error}", None
            self.failures += 1
        finally:
            self._busy = None
