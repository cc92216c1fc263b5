# SPDX-License-Identifier: Apache-2.0
"""Why a law has a larger error than no law at all, from its own fit; and which rows no error includes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from smallwheel_ros.fitting import Base
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.held_out import rows_of
from smallwheel_ros.fitting.noise import NoiseLine
from smallwheel_ros.fitting.points import Index, Points
from smallwheel_ros.fitting.result import runs_differ, unusual
from smallwheel_ros.measurements.display import percent, shown_value
from smallwheel_ros.measurements.measurements import Measurements

Reasons = tuple[tuple[str, Index], ...]

_SUNK = "the wheel was measured deeper than its axle"
_SIZES = 3  # columns of `NoiseLine` that a law of plates has, too: load, diameter and width

MISSING = "an effect is missing, or a zero is off"
_STOPPED = [
    "its n is at its bound: over these runs depth rises with load less than in any one soil, as where soils "
    "are mixed"
]
SAME_FREEDOM = (
    "both have load and size alone, so this is no sign of a missing effect: the law weighs each depth by "
    "its share and holds its numbers to what soils show, and these curves are no one power of depth, or the "
    "sizes too few for its m"
)


def why_of(fitter: Fitter, fit: Fit, base: Base) -> dict[str, str]:
    """Words, by channel, on why a law may have a larger error than a regression.

    For channels with rolling wheels: an effect is missing (`MISSING`). For other bodies: scatter larger than
    soils and rigs usually have, or n at its upper bound. If neither holds, that both use load and size alone,
    so that it is no sign of a missing effect (`SAME_FREEDOM`), or else `MISSING`.

    Parameters
    ----------
    fitter, fit
        Fitter of the points, and the fit of the law to them.
    base
        The law before it was fitted.
    """
    points, said = fitter.points, {}
    large = unusual(fitter, fitter.true_scatter(fit))
    stopped = [p.field == "n" and value >= p.prior.high
               for p, value in zip(fit.vector.of_soils, fit.theta, strict=False)]  # fmt: skip
    for name in points.channels:
        use = points.of_channel(name) & (points.value > 0)
        if not use.any() or points.conditions.rolling[points.row[use]].any():
            said[name] = MISSING
            continue
        used = NoiseLine.through(points.value[use], points.row[use], points.conditions).used
        same = (used < (_SIZES if base.fixed_m is None else 1)).all()
        strays = _strays(name, large, fitter) + (_STOPPED if any(stopped) else [])
        said[name] = "; ".join(strays) or (SAME_FREEDOM if same else MISSING)
    return said


def _strays(channel: str, large: Mapping[str, float], fitter: Fitter) -> list[str]:
    """Words for each component of the scatter that is `unusual`. large: these, as shares of a value."""
    mine = ("tau", f"own:{channel}")
    apart = runs_differ({name: size for name, size in large.items() if name in mine})
    texts = [f"its {apart}"] if apart else []
    if f"zero:{channel}" in large:
        middle = float(np.median(fitter.level[fitter.points.of_channel(channel)]))
        size = shown_value(channel, large[f"zero:{channel}"] * middle)
        texts.append(
            f"its fit lays {size} of each run to a zero offset: check where the touch-down was read"
        )
    if "along" in large:
        texts.append(f"its curves stray by {percent(large['along'])} from a power of depth")
    return texts


def lone_soils(data: Measurements) -> list[str]:
    """Soils with a single run, if other soils have more: with that run held out, nothing is known of them."""
    runs = {str(s): np.unique(data.run[data.soil == s]).size for s in np.unique(data.soil)}
    lone = [name for name, count in runs.items() if count == 1]
    return lone if len(lone) < len(runs) else []


def left_out(points: Points, outliers: Index) -> Reasons:
    """List the reasons why no error includes some rows, each with the lines of these rows in the file.

    Parameters
    ----------
    points
        The points of the fit.
    outliers
        Indices of the rows left out as outliers, shape (outliers,).
    """
    data = points.measurements
    free = np.ones(len(data), dtype=bool)
    free[np.concatenate(list(rows_of(points).values()))] = False
    nothing = np.all([~np.isfinite(v) for v in data.channels.values()], axis=0)
    found = []
    for why, rows in (
        (f"{_SUNK}, where no model of a rolling wheel holds", data.sunk_to_axle),
        ("nothing was measured", nothing),
        ("far off the others of their run", np.isin(np.arange(len(data)), outliers)),
        ("a body that has not settled, or a channel that no model predicts there", free),
    ):
        if (rows & free).any():
            found.append((why, data.line[rows & free]))
            free[rows] = False
    return tuple(found)


def notes_of(points: Points, folds: int) -> tuple[str, ...]:
    """Sentences that apply to all errors of a table: notes of the points, what cannot be held out.

    Parameters
    ----------
    points
        The points of the fit.
    folds
        Number of folds; 0 if nothing could be held out.
    """
    notes = [note for note in points.notes if _SUNK not in note]
    if not folds:
        notes.append("all rows are of one run: nothing can be held out, every error is in sample")
        return tuple(notes)
    soil = points.measurements.soil
    run = {i: rows[0] for i, rows in zip(points.run, points.rows, strict=True)}
    names, count = np.unique(soil[list(run.values())], return_counts=True)
    if names.size > 1:
        notes += [
            f"soil '{name}' has one run: where it is held out, nothing is known of that soil"
            for name in names[count == 1]
        ]
    return tuple(notes)
