# SPDX-License-Identifier: Apache-2.0
"""The errors of all laws on one set of rows, and whether ours is better or worse than each.

All laws are judged on the same points: those that each of them predicts. The unit is the part that was left
out: ours is better if the mean over parts of another law's error minus ours exceeds 0 by more than its
standard error allows (Student's t, paired, two-sided).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from smallwheel_ros.compare.fitted_laws import INTEGRAL, OURS, Fold, predictions
from smallwheel_ros.compare.left_out import Task
from smallwheel_ros.compare.own_law import OwnLaw
from smallwheel_ros.fitting.constants import ALARM
from smallwheel_ros.fitting.problem import Base, Problem

Array = NDArray[np.float64]
Verdict = Literal["wins", "loses", "cannot tell"]

_FEWEST = 3  # parts: the spread of two is a single number


@dataclass(frozen=True)
class Difference:
    """Error of a law minus that of ours, averaged over the parts that were left out.

    Ours is the contact integral with the effects that a diagnosis of the other parts names.

    Attributes
    ----------
    mean
        Mean difference of the rms errors, SI; positive if ours is smaller.
    std
        Standard error of the mean, SI; None for one part.
    parts
        Number of parts on which both have an error.
    """

    mean: float
    std: float | None
    parts: int


@dataclass(frozen=True)
class Errors:
    """Errors of one law on one channel.

    Attributes
    ----------
    law
        Name of the law.
    channel
        sinkage, resistance, drawbar_pull or torque.
    rmse
        Root mean square error over all points that are judged, SI; NaN if there are none.
    by_part
        The same for each part when it was left out, by its name; None where no point is judged.
    refused
        Number of points that it does not predict.
    effects
        By part, the effects that a diagnosis of the other parts named; empty for laws other than ours.
    at_bound
        By parameter, the number of fits in which it was at its bound.
    against
        Difference from the error of our law (`Difference`); None for our law itself, or if they have no part
        in common.
    """

    law: str
    channel: str
    rmse: float
    by_part: dict[str, float | None]
    refused: int
    effects: dict[str, tuple[str, ...]]
    at_bound: dict[str, int]
    against: Difference | None

    @property
    def verdict(self) -> Verdict | None:
        """Whether our law wins or loses against this one, or neither; None if they are not compared."""
        d = self.against
        if d is None:
            return None
        if d.std is None or d.parts < _FEWEST:
            return "cannot tell"
        if abs(d.mean) <= d.std * stdtrit(d.parts - 1, 1.0 - ALARM / 2.0):
            return "cannot tell"
        return "wins" if d.mean > 0 else "loses"


@dataclass(frozen=True)
class LawTable:
    """Errors of the laws for one contact in one soil, under one way of leaving rows out.

    Attributes
    ----------
    file, licence
        File of the table, and the first line of its licence.
    task
        The rows, and how they are left out.
    laws
        Errors of each law on each channel.
    judged
        By channel, the number of points that all laws predict: errors are those of these points.
    fits
        Number of fits of each law.
    """

    file: Path
    licence: str
    task: Task
    laws: tuple[Errors, ...]
    judged: dict[str, int]
    fits: int

    @property
    def others(self) -> list[Errors]:
        """Errors of the laws that are compared with ours, on every channel."""
        return [law for law in self.laws if law.law not in (INTEGRAL, OURS) and law.against]

    def of(self, channel: str) -> list[Errors]:
        """The laws' errors on that channel, in the order of the table."""
        return [law for law in self.laws if law.channel == channel]


def table_of(
    file: Path, licence: str, task: Task, own: tuple[OwnLaw, ...], progress: Callable[[str], object]
) -> LawTable:
    """Fit every law without each part of a task in turn, and compute its errors on that part.

    Parameters
    ----------
    file, licence
        File of the table, and the first line of its licence; kept in the result.
    task
        Measurements, and the part that each row belongs to.
    own
        Laws of the user's own.
    progress
        Called with a line of text on which part is left out.

    Raises
    ------
    LawError
        If one of `own` fails.
    """
    points = Problem.of(task.measurements, Base()).points
    row = np.array([rows[0] for rows in points.rows], dtype=np.intp)  # all are in one part
    part, parts = task.part[row], range(len(task.names))
    found: dict[str, Array] = {}
    held: dict[str, Counter[str]] = {}
    effects: dict[str, tuple[str, ...]] = {}
    folds = list(task.folds())
    for out, seen in folds:
        names = [task.names[code] for code in np.unique(task.part[out])]
        progress(f"{file}, {task.contact}: without {task.what} {', '.join(names)}")
        mine, fold = out[row], Fold(points, np.isin(row, seen), task.measurements.take(seen))
        for said in predictions(fold, own):
            found.setdefault(said.law, np.full(len(points), np.nan))[mine] = said.value[mine]
            held.setdefault(said.law, Counter()).update(said.at_bound)
            effects |= dict.fromkeys(names, said.effects) if said.law == OURS else {}
    laws, judged = [], {}
    for c, channel in enumerate(points.channels):
        here = points.channel == c
        mine_too = [law.name for law in own if channel in law.channels]
        known = {n: v for n, v in found.items() if n in mine_too or np.isfinite(v[here]).any()}
        some = [value for value in known.values() if np.isfinite(value[here]).any()]
        common = here & np.all(np.isfinite(some), axis=0)
        off = {n: np.where(common, v - points.value, np.nan) for n, v in known.items()}
        by_part = {n: [_known(error[part == p]) for p in parts] for n, error in off.items()}
        judged[channel] = int(common.sum())
        for name, error in off.items():
            compared = name != OURS and OURS in off
            laws.append(
                Errors(
                    name,
                    channel,
                    _rms(error),
                    dict(zip(task.names, by_part[name], strict=True)),
                    int((here & np.isnan(known[name])).sum()),
                    effects if name == OURS else {},
                    dict(held[name]),
                    difference(by_part[name], by_part[OURS]) if compared else None,
                )
            )
    return LawTable(file, licence, task, tuple(laws), judged, len(folds))


def difference(law: list[float | None], ours: list[float | None]) -> Difference | None:
    """Mean over parts of a law's error minus ours, with its standard error; None if no part has both.

    Parameters
    ----------
    law, ours
        Errors (rms) on each part, in the same order and unit; None where there is none.
    """
    d = [a - b for a, b in zip(law, ours, strict=True) if a is not None and b is not None]
    if not d:
        return None
    std = float(np.std(d, ddof=1) / np.sqrt(len(d))) if len(d) > 1 else None
    return Difference(float(np.mean(d)), std, len(d))


def _rms(error: Array) -> float:
    known = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def _known(error: Array) -> float | None:
    return None if np.isnan(found := _rms(error)) else found
