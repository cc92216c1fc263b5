# SPDX-License-Identifier: Apache-2.0
"""Removes constant differences between the sinkages of a vehicle's wheels before a diagnosis.

A rig has one gauge. A vehicle has one for each wheel, each with its own zero, and the ground on its left
differs from that on its right. Differences of a millimetre or so would hide an effect, or look like one. So
the sinkages of wheels of one size are fitted together,

    z = constant of the wheel + a ln W + b (ln W)^2 + c slip

robustly (Huber 1964), and each wheel's constant is shifted to the mean of all.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from smallwheel_ros.fitting.noise import NORMAL
from smallwheel_ros.measurements.measurements import Measurements, codes_of
from smallwheel_ros.measurements.settings import one_row_a_wheel
from smallwheel_ros.physics.conditions import Array

# What wheels may not differ in, of those whose sinkages are compared: the tracks of others count as well.
_ALIKE = ("diameter", "width", "pass_number", "grouser_height", "grouser_count")
_HUBER = 1.5  # deviations from which on a row counts less
_LEAST = 1e-6  # m, where all rows agree: no gauge shows less
_SAID = 5e-5  # m; less is rounding


def evened(data: Measurements) -> Measurements:
    """Remove constant differences between wheels of one size from the sinkages, at equal load and slip.

    Parameters
    ----------
    data
        Any table.

    Returns
    -------
    Measurements
        The same table where its runs are not those of a vehicle (`settings.one_row_a_wheel`). Otherwise its
        notes state what was removed, and a sinkage that is then not positive counts as not measured (NaN).
    """
    if "sinkage" not in data.channels or not one_row_a_wheel(data):
        return data
    conditions, sinkage = data.conditions, data.channels["sinkage"].copy()
    alike = [conditions[name] for name in _ALIKE if name in conditions]
    # Unknown is alike with unknown: else each such row would be a kind of its own.
    keys = np.nan_to_num(np.column_stack([codes_of(conditions.contact)[1], *alike]), nan=-1.0)
    kinds, kind_of = np.unique(keys, axis=0, return_inverse=True)
    taken: dict[str, float] = {}
    for kind in range(len(kinds)):
        rows = np.flatnonzero((kind_of.ravel() == kind) & np.isfinite(sinkage))
        names, own = _own(data, rows)
        sinkage[rows] -= own[codes_of(data.wheel[rows])[1]] if names else 0.0
        for name, zero in zip(names, own.tolist(), strict=True):
            taken[name] = max(zero, taken.get(name, 0.0), key=abs)
    said = [f"{name} {1e3 * zero:+.1f} mm" for name, zero in taken.items() if abs(zero) >= _SAID]
    if said:
        note = (
            "what the sinkages of wheels of one size differ by (each sensor's zero, the ground of its side)"
            f" is taken out: {', '.join(said)}"
        )
        data = replace(data, notes=(*data.notes, note))
    sinkage[sinkage <= 0.0] = np.nan
    return replace(data, channels={**data.channels, "sinkage": sinkage})


def _own(data: Measurements, rows: NDArray[np.intp]) -> tuple[list[str], Array]:
    """Names of the wheels in these rows, and each one's constant minus their mean (m).

    Both are empty where there is nothing to compare, or too little.
    """
    names, number = codes_of(data.wheel[rows])
    if len(names) < 2 or rows.size < 2 * (len(names) + 3):  # as many again as the fit has constants
        return [], np.empty(0)
    load, shown = data.conditions.load[rows], data.channels["sinkage"][rows]
    log_load = np.log(load / np.median(load))
    slip = data.conditions["slip"][rows] if "slip" in data.conditions else np.zeros(rows.size)
    of_wheel = np.eye(len(names))[number]
    about = np.column_stack([of_wheel, log_load, log_load**2, np.nan_to_num(slip)])
    first = np.linalg.lstsq(about, shown, rcond=None)[0]
    size = max(NORMAL * float(np.median(np.abs(shown - about @ first))), _LEAST)
    found = least_squares(  # type: ignore[operator]  # see lab.shear
        lambda x: about @ x - shown, first, loss="huber", f_scale=_HUBER * size
    )
    own = found.x[: len(names)]
    return names, own - own.mean()
