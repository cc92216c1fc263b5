# SPDX-License-Identifier: Apache-2.0
"""`benchmark`: laws of sinkage, pull and torque on measured data sets."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from smallwheel_ros.arguments import DataSets, OwnLaws, unheard

if TYPE_CHECKING:
    from smallwheel_ros.benchmark.data_sets import Benchmark
    from smallwheel_ros.benchmark.table import LawTable


def benchmark(
    folder: DataSets,
    *,
    law: OwnLaws | None = None,
    done: "Callable[[LawTable], object]" = unheard,
    progress: Callable[[str], object] = unheard,
) -> "Benchmark":
    """Compare laws of sinkage, pull and torque on measured data sets.

    A data set is a folder with its licence (a file LICENSE) and its tables. Sizes of plates, levels of
    slip, wheels, runs and soils are left out in turn, and every law is fitted to the rest: the mean of
    the rest, Bernstein-Goriatchkin, Bekker, Reece, Meirion-Griffith & Spenko, Wong and Reece where pull
    or torque was measured, the contact integral, and ours, which adds the effects that a diagnosis of
    the rest names. The errors are those on what was left out; ours wins, loses, or cannot be told from
    each other law.

    Parameters
    ----------
    folder
        A folder of data sets.
    law
        A Python file with laws of your own, which is run.
    done
        Given each set of rows when its laws are through.
    progress
        Told what is worked on.
    """
    from smallwheel_ros.benchmark.data_sets import held_against

    return held_against(Path(folder), None if law is None else Path(law), done, progress)
