# SPDX-License-Identifier: Apache-2.0
"""All data sets of a folder under all laws: `benchmark(folder)`, and what it finds.

A data set is a folder with a licence file (LICENSE, LICENCE or COPYING) and tables beside it: without a
licence nobody else can repeat the figures.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from smallwheel_ros.benchmark.laws import FOUND, INTEGRAL, ONE_SIZE, LawError, errors_of
from smallwheel_ros.benchmark.parts import Task, tasks_of
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.results import Result
from smallwheel_ros.common.tables import text_table
from smallwheel_ros.measurements.columns import CHANNEL_UNITS, CHANNELS
from smallwheel_ros.measurements.display import display, listed, number, sentence, words
from smallwheel_ros.measurements.wheels import read_measurements

_LICENCES = ("LICENSE", "LICENCE", "COPYING")
_TABLES = (".csv", ".tsv", ".xlsx", ".ods", ".parquet")
# The first is everybody's: it is no loss, and no win.
_OURS = (ONE_SIZE, INTEGRAL, FOUND, "Meirion-Griffith & Spenko")


class BenchmarkError(SmallwheelError):
    """A folder without data that may be used."""


@dataclass(frozen=True)
class TaskErrors:
    """One contact in one soil of one table, and the laws' errors on its parts. file: its table."""

    file: Path
    licence: str
    task: Task
    laws: tuple[LawError, ...]

    @property
    def channels(self) -> tuple[str, ...]:
        """What was measured, sinkage first."""
        return tuple(dict.fromkeys(law.channel for law in self.laws))

    def of(self, channel: str) -> list[LawError]:
        """The laws' errors on that channel."""
        return [law for law in self.laws if law.channel == channel]

    def best(self, channel: str) -> LawError:
        """The law of the least error over all parts."""
        return min(self.of(channel), key=lambda law: np.nan_to_num(law.rmse, nan=np.inf))

    def lost(self, channel: str) -> dict[str, str]:
        """By part, the law that beats every form of ours there."""
        found = {}
        for part in self.task.names:
            known = {law.law: e for law in self.of(channel) if (e := law.by_part[part]) is not None}
            if known and (first := min(known, key=lambda law: known[law])) not in _OURS:
                found[part] = first
        return found

    def text(self) -> str:
        """The file, a table for each channel, and the effects that were found."""
        lines = [f"{self.file} ({self.licence})"]
        for channel in self.channels:
            lines += self._channel(channel)
        effects = dict.fromkeys(e for law in self.laws for f in law.effects.values() for e in f)
        found = f"Effects found: {listed(list(effects))}" if effects else "No effect was found"
        return "\n".join([*lines, f"{found}."])

    def _channel(self, channel: str) -> list[str]:
        task, shown = self.task, display(channel, CHANNEL_UNITS[channel])
        title = (
            f"{task.contact}, {task.soil}, {len(task.measurements)} rows; {words(channel)} "
            f"[{shown.unit}, rms] of each {task.what} left out"
        )

        def cell(error: float | None) -> str:
            return "-" if error is None else number(shown.scale * error)

        names = task.names if task.what != "run" or len(task.names) <= 6 else ()
        rows = [
            [law.law, cell(law.rmse), *(cell(law.by_part[name]) for name in names)]
            for law in self.of(channel)
        ]
        table = text_table(["law", "all", *names], rows)
        lost = [f"{law} ({part})" for part, law in self.lost(channel).items()]
        said = f"Least error: {self.best(channel).law}."
        if lost:
            said += f" Ours loses on {len(lost)} of {len(task.names)} parts, to {', '.join(lost)}."
        return [title, *(f"  {line}" for line in table.splitlines()), said]


@dataclass(frozen=True, repr=False)
class Benchmark(Result):
    """What the laws leave on each table. left_out: files that were not used, with the reason."""

    folder: Path
    tasks: tuple[TaskErrors, ...]
    left_out: dict[str, str]

    def headline(self) -> str:
        """How many tables, and how often a form of the law of Meirion-Griffith & Spenko is best."""
        first = sum(errors.best("sinkage").law in _OURS[1:] for errors in self.tasks)
        return (
            f"{self.folder}: {len(self.tasks)} sets of rows; a form of Meirion-Griffith & Spenko's law "
            f"has the least error of sinkage on {first} of them"
        )

    def text(self) -> str:
        """As `smallwheel benchmark` prints it."""
        return "\n\n".join([*(errors.text() for errors in self.tasks), self.ending()])

    def ending(self) -> str:
        """The text below the tables: what was not used, and the headline."""
        left = [sentence(f"not used: {file}: {why}") for file, why in self.left_out.items()]
        return "\n\n".join([*(["\n".join(left)] if left else []), f"{self.headline()}."])

    def to_dict(self) -> dict[str, Any]:
        """As `smallwheel benchmark --json` writes it."""
        return {
            "folder": str(self.folder),
            "tasks": [
                {
                    "file": str(errors.file),
                    "licence": errors.licence,
                    "contact": errors.task.contact,
                    "soil": errors.task.soil,
                    "left_out": errors.task.what,
                    "rows": len(errors.task.measurements),
                    "laws": [
                        {
                            "law": law.law,
                            "channel": law.channel,
                            f"{law.channel}_rmse": law.rmse,
                            "by_part": law.by_part,
                            "effects": {name: list(ids) for name, ids in law.effects.items()},
                        }
                        for law in errors.laws
                    ],
                    "lost": errors.lost("sinkage"),
                    "lost_forces": {n: errors.lost(n) for n in errors.channels if n != "sinkage"},
                }
                for errors in self.tasks
            ],
            "not_used": dict(self.left_out),
        }

    def rows(self) -> list[dict[str, Any]]:
        """One row for each table, law, channel and part; errors in SI."""
        return [
            {
                "file": str(errors.file), "contact": errors.task.contact, "soil": errors.task.soil,
                "law": law.law, "channel": law.channel, "left_out": errors.task.what, "part": part,
                **{f"{name}_rmse": error if name == law.channel else None for name in CHANNELS},
            }
            for errors in self.tasks
            for law in errors.laws
            for part, error in law.by_part.items()
        ]  # fmt: skip


def benchmark(
    folder: Path,
    progress: Callable[[str], object] = lambda step: None,
    done: Callable[[TaskErrors], object] = lambda errors: None,
) -> Benchmark:
    """Hold the laws against every data set of a folder.

    progress: told what is worked on; done: given each set of rows when its laws are through. Raises
    BenchmarkError where no data set has a licence and a table.
    """
    sets = {file: _licence(file.parent) for file in _tables(folder)}
    if not sets:
        raise BenchmarkError(
            f"{folder}: no data set found, expected folders of tables ({', '.join(_TABLES)})"
        )
    tasks: list[TaskErrors] = []
    left: dict[str, str] = {}
    for file, licence in sets.items():
        name = file.relative_to(folder)
        if not licence:
            left[str(name)] = f"no licence beside it, expected a file {' or '.join(_LICENCES)}"
            continue
        before = len(tasks)
        try:
            for task in tasks_of(read_measurements(file)):
                laws = errors_of(task, _named(progress, name, task))
                tasks.append(TaskErrors(name, licence, task, tuple(laws)))
                done(tasks[-1])
        except SmallwheelError as error:
            left[str(name)] = str(error)
            continue
        if len(tasks) == before:
            left[str(name)] = "fewer than three runs with sinkage, expected some to leave out"
    if not tasks:
        raise BenchmarkError("; ".join(f"{file}: {why}" for file, why in left.items()))
    return Benchmark(folder, tuple(tasks), left)


def _named(progress: Callable[[str], object], file: Path, task: Task) -> Callable[[str], object]:
    return lambda step: progress(f"{file}, {task.contact}: {step}")


def _tables(folder: Path) -> list[Path]:
    """Tables of the folder and of the folders in it."""
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
