# SPDX-License-Identifier: Apache-2.0
"""`compare`: models against measurements, and laws on a folder of data sets."""

from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, overload

from smallwheel_ros.api.read import read
from smallwheel_ros.arguments import OwnLaws, unheard
from smallwheel_ros.common.errors import ArgumentError
from smallwheel_ros.measurements.given import DataOrSets
from smallwheel_ros.model.given import Models, OwnEffects, registry_of

if TYPE_CHECKING:
    import pandas as pd

    from smallwheel_ros.compare.comparison import Comparison
    from smallwheel_ros.compare.data_sets import Benchmark
    from smallwheel_ros.compare.law_table import LawTable
    from smallwheel_ros.measurements.measurements import Measurements


@overload
def compare(
    data: "Measurements | pd.DataFrame",
    models: Models = (),
    *,
    effects: OwnEffects | None = None,
    progress: Callable[..., object] = unheard,
) -> "Comparison": ...


@overload
def compare(
    data: "str | PathLike[str]",
    models: Models = (),
    *,
    effects: OwnEffects | None = None,
    law: OwnLaws | None = None,
    done: "Callable[[LawTable], object]" = unheard,
    progress: Callable[..., object] = unheard,
) -> "Comparison | Benchmark": ...


def compare(
    data: DataOrSets,
    models: Models = (),
    *,
    effects: OwnEffects | None = None,
    law: OwnLaws | None = None,
    done: "Callable[[LawTable], object]" = unheard,
    progress: Callable[..., object] = unheard,
) -> "Comparison | Benchmark":
    """Compare models with measurements, or laws on a folder of measured data sets.

    The closed forms of Bekker and of Meirion-Griffith & Spenko, the contact integral and, where pull or
    torque was measured, the law of Wong and Reece are fitted to the data, and judged on runs that were held
    out of the fit; so are a constant (the mean of the other runs) and a log-log regression. Errors are
    given for each channel, soil, wheel and range of conditions, beside the repeatability within runs.
    `diagnose` works out what error a true model would leave.

    In a folder a data set is a folder with its licence (a file LICENSE) and its tables. Sizes of plates,
    levels of slip, wheels, runs and soils are left out in turn, and every law is fitted to the rest: the
    mean of the rest, Bernstein-Goriatchkin, Bekker, Reece, Meirion-Griffith & Spenko, Wong and Reece where
    pull or torque was measured, the contact integral, and ours, which adds the effects that a diagnosis of
    the rest names. The errors are those on what was left out; ours wins, loses, or cannot be told from each
    other law.

    Parameters
    ----------
    data : path, DataFrame, or what `sw.read` returned
        The measurements, or a folder of data sets.
    models : one, several, or a dictionary of several by name, optional
        A further model to compare on a table; it is not fitted.
    effects : path, or what `sw.effects.load` returned, optional
        A Python file with effects of your own. It is run: name only files that you trust.
    law : path, optional
        A Python file with laws of your own to enter for a folder, which is run.
    done : callable, optional
        For a folder: called with each table of errors (a LawTable), one for each way of leaving rows out,
        as soon as it is complete.
    progress : callable, optional
        Called with the number of fits done and their total; for a folder with what is being compared, in
        words.

    Returns
    -------
    Comparison or Benchmark
        The errors of each model on the table (m, N or N m by channel); for a folder, those of each law on
        each data set, and the files that were not used.

    Examples
    --------
    >>> import smallwheel_ros as sw
    >>> found = sw.compare("rig.csv", {"sand": "dry_sand"})
    >>> [model.contender.name for model in found.models]
    ['constant', 'log_log_regression', 'bekker', 'meirion_griffith_spenko', 'contact_integral', 'sand']
    """
    if isinstance(data, (str, PathLike)) and Path(data).is_dir():
        from smallwheel_ros.compare.data_sets import held_against

        if models or effects is not None:
            raise ArgumentError(
                f"{data}: found a folder, whose laws are fitted in turn; models and effects go with a table, "
                "laws of your own with --law FILE (law=FILE)"
            )
        return held_against(Path(data), None if law is None else Path(law), done, progress)
    if law is not None:
        raise ArgumentError(
            f"law: found {law}, but the data is no folder of data sets; a table is compared with models"
        )
    from smallwheel_ros.compare.comparison import comparison_of
    from smallwheel_ros.compare.contenders import contenders_of

    return comparison_of(read(data), contenders_of(models, registry_of(effects)), progress=progress)
