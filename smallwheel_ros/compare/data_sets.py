# SPDX-License-Identifier: Apache-2.0
"""All data sets of a folder under all laws.

A data set is a folder with a licence file (LICENSE, LICENCE or COPYING) and tables beside it:
without a licence others could not repeat the figures.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.result import Result
from smallwheel_ros.compare.fitted_laws import NAMES
from smallwheel_ros.compare.law_table import Errors, LawTable, Verdict, table_of
from smallwheel_ros.compare.left_out import tasks_of
from smallwheel_ros.compare.own_law import LawError, load_laws
from smallwheel_ros.measurements.from_file import read_measurements

_LICENCES = ("LICENSE", "LICENCE", "COPYING")
_TABLES = (".csv", ".tsv", ".xlsx", ".xls", ".ods", ".parquet")


class BenchmarkError(SmallwheelError):
    """A folder without data that may be used."""


@dataclass(frozen=True, repr=False)
class Benchmark(Result, shown="views.law_table"):
    """Errors of all laws on the data sets of a folder, and their differences from ours.

    Our law is the contact integral with the effects that a diagnosis names.

    Attributes
    ----------
    folder
        The folder.
    tasks
        Errors of all laws for each contact, soil and way of leaving rows out, of each table.
    left_out
        Reason by file for each table, and by name for each law of the user's own, that was not used.
    """

    folder: Path
    tasks: tuple[LawTable, ...]
    left_out: dict[str, str]

    def judged(self, verdict: Verdict) -> list[tuple[LawTable, Errors]]:
        """The laws against which ours has this verdict, each with the table of errors that it is in."""
        return [(t, law) for t in self.tasks for law in t.others if law.verdict == verdict]

    def headline(self) -> str:
        """One line: how often our law has a smaller error than another, a larger one, or cannot be told."""
        wins, losses, ties = (len(self.judged(word)) for word in ("wins", "loses", "cannot tell"))
        return (
            f"{self.folder}: {wins + losses + ties} comparisons of ours with other laws on {len(self.tasks)} "
            f"sets of rows: ours wins {wins}, loses {losses}, cannot tell {ties}"
        )


def held_against(
    folder: Path,
    law: Path | None,
    done: Callable[[LawTable], object],
    progress: Callable[[str], object],
) -> Benchmark:
    """Compare the laws on every data set of a folder.

    Parameters
    ----------
    folder
        Contains tables with a licence file beside them, or a folder of such for each data set.
    law
        A Python file with laws of your own, which is run; None: none.
    done
        Called with each table of errors as soon as it is complete.
    progress
        Called with a line of text on what is being done.

    Raises
    ------
    BenchmarkError
        If no data set has a licence and a usable table.
    EffectError, LawError
        If a law of the file cannot be used.
    """
    own = () if law is None else load_laws(law, NAMES)
    sets = {file: _licence(file.parent) for file in _tables(folder)}
    if not sets:
        raise BenchmarkError(
            f"{folder}: no data set found, expected folders of tables ({', '.join(_TABLES)})"
        )
    tables: list[LawTable] = []
    left: dict[str, str] = {}
    for file, licence in sets.items():
        name = file.relative_to(folder)
        if not licence:
            left[str(name)] = f"no licence next to it, expected a file {' or '.join(_LICENCES)}"
            continue
        try:
            tasks = list(tasks_of(read_measurements(file)))
            for task in tasks:
                tables.append(table_of(name, licence, task, own, progress))
                done(tables[-1])
            if not tasks:
                left[str(name)] = "fewer than three runs of one contact in one soil, expected more"
        except LawError:
            raise
        except SmallwheelError as error:
            left[str(name)] = str(error)
    entered = {errors.law for table in tables for errors in table.laws}
    for unused in (one for one in own if one.name not in entered):
        left[unused.name] = f"no table has what it needs: {', '.join(unused.needs) or 'a channel'}"
    if not tables:
        raise BenchmarkError("; ".join(f"{file}: {why}" for file, why in left.items()))
    return Benchmark(folder, tuple(tables), left)


def _tables(folder: Path) -> list[Path]:
    """Files of tables in the folder and in its folders; raises BenchmarkError if it is no folder."""
    if not folder.is_dir():
        raise BenchmarkError(f"{folder}: no folder, expected one with data sets")
    files = [*folder.glob("*"), *folder.glob("*/*")]
    return sorted(f for f in files if f.is_file() and f.suffix.lower() in _TABLES)


def _licence(folder: Path) -> str:
    """First line of the licence file of a folder, else an empty text."""
    for file in sorted(folder.iterdir()):
        if file.is_file() and file.stem.upper() in _LICENCES:
            text = file.read_bytes()[:4000].decode(errors="replace")
            return next((line.strip() for line in text.splitlines() if line.strip()), file.name)
    return ""
