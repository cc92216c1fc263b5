# SPDX-License-Identifier: Apache-2.0
"""What is allowed in a table of measurements but looks like a mistake: warnings in one sentence."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.columns import COLUMNS
from smallwheel_ros.measurements.settings import codes_of, one_row_a_wheel
from smallwheel_ros.physics.conditions import PLATE, ROLLING, Array
from smallwheel_ros.physics.stresses import mean_place

if TYPE_CHECKING:
    from smallwheel_ros.measurements.table import Measurements

_SLIP_LIMIT = 0.95
_SHARES = 0.01  # slip that is nowhere over 1 %: no rig sets it so finely
_STRONGEST = np.radians(45.0)  # friction angle: no sand under wheels is stronger
_STEADY_LOAD = 1.5  # largest over smallest load within one run of repeats


def suspicions(data: Measurements, place: str) -> Iterator[str]:
    """Yield one sentence for each thing that deserves a second look."""
    yield from _sizes(data, place)
    yield from _depths(data, place)
    yield from _settings(data, place)
    yield from _pulls(data, place)
    if data.runs_given:
        yield from _runs(data)


def _where(data: Measurements, rows: NDArray[np.bool_], place: str) -> str:
    count = int(rows.sum())
    first = f"{place} {data.line[np.flatnonzero(rows)[0]]}"
    return f"in {first}" if count == 1 else f"in {count} rows (first in {first})"


_OTHER_UNIT = {"m": "mm", "N": "kN", "m/s": "mm/s"}  # the likeliest mistake


def _sizes(data: Measurements, place: str) -> Iterator[str]:
    """Values that no small wheel has: most likely in another unit."""
    for name, spec in COLUMNS.items():
        if name not in data.conditions:
            continue
        values = data.conditions[name]
        for odd, word in ((values > spec.usual[1], "more"), (values < spec.usual[0], "less")):
            if odd.any():
                value = values[np.flatnonzero(odd)[0]]
                yield (
                    f"{name} is {value:.4g} {spec.unit} {_where(data, odd, place)}, {word} than "
                    f"expected of a small wheel: is the unit right? A header names it, like "
                    f"'{name} [{_OTHER_UNIT[spec.unit]}]'"
                )


def _depths(data: Measurements, place: str) -> Iterator[str]:
    if "sinkage" not in data.channels:
        return
    z, d = data.channels["sinkage"], data.conditions.diameter
    plate = data.conditions.contact == PLATE
    sunk = data.sunk_to_axle
    if sunk.any():
        yield (
            f"sinkage is over half the diameter {_where(data, sunk, place)}, where the wheel is "
            "dragged across its plane: deeper than any model of a rolling wheel holds"
        )
    deep = (z > d / 3) & ~plate & ~sunk
    if deep.any():
        yield f"sinkage is over a third of the diameter {_where(data, deep, place)}"
    flat = (z > d) & plate
    if flat.any():
        yield f"sinkage of a plate is over its diameter {_where(data, flat, place)}"


def _settings(data: Measurements, place: str) -> Iterator[str]:
    nothing = np.all([np.isnan(values) for values in data.channels.values()], axis=0)
    if nothing.any():
        yield f"nothing was measured {_where(data, nothing, place)}"
    if "slip" in data.conditions:
        most = float(np.nanmax(np.abs(data.conditions["slip"]), initial=0.0))
        if data.written_units.get("slip") == "%" and 0.0 < most <= _SHARES:
            yield (
                f"slip is {100.0 * most:.3g} % at most: if the numbers are shares and not per cent, the "
                "header is 'slip'"
            )
        far = np.abs(data.conditions["slip"]) > _SLIP_LIMIT
        if far.any():
            yield (
                f"slip is beyond ±{_SLIP_LIMIT} {_where(data, far, place)}: a wheel that spins on "
                "the spot or is dragged locked, outside the range of the models"
            )
    if "speed" in data.conditions:
        still = data.conditions["speed"] == 0.0
        if still.any():
            yield f"speed is 0 {_where(data, still, place)}: effects of speed have no value there"
    if "resistance" in data.channels:
        negative = data.channels["resistance"] < 0
        if negative.any():
            yield (
                f"resistance is negative {_where(data, negative, place)}: it is positive against "
                "the direction of travel"
            )


def _pulls(data: Measurements, place: str) -> Iterator[str]:
    """Pulls of driven wheels that no sand gives, by the balance of stresses in its closed form.

    DP = W tan(delta - kappa t1) with cos t1 = 1 - 2 z/D (`physics.stresses.closed_form_forces`), kappa for
    n = 1. Where sinkage was not measured the wheel is taken not to sink.
    """
    if "drawbar_pull" not in data.channels:
        return
    c, pull = data.conditions, data.channels["drawbar_pull"]
    z = np.nan_to_num(data.channels.get("sinkage", np.zeros(len(data))))
    entry = np.arccos(np.clip(1.0 - 2.0 * z / c.diameter, -1.0, 1.0))
    limit = c.load * np.tan(_STRONGEST - mean_place(1.0).mean * entry)
    driven = c["slip"] >= 0.0 if "slip" in c else np.ones(len(data), dtype=bool)
    over = (pull > limit) & driven & (c.contact == ROLLING) & ~data.sunk_to_axle
    if over.any():
        row = int(np.flatnonzero(over)[0])
        yield (
            f"drawbar_pull is {pull[row]:.4g} N {_where(data, over, place)}, more than the "
            f"{limit[row]:.4g} N that a wheel of this load and sinkage can pull on the strongest sand "
            "(friction angle 45 deg): check load, pull and the zero of the sinkage"
        )


def _spread(values: Array, index: NDArray[np.intp], runs: int) -> tuple[Array, Array]:
    low, high = np.full(runs, np.inf), np.full(runs, -np.inf)
    np.minimum.at(low, index, values)
    np.maximum.at(high, index, values)
    return low, high


def _runs(data: Measurements) -> Iterator[str]:
    names, index = codes_of(data.run)
    vehicle = one_row_a_wheel(data)
    for what, column in (("wheels", data.wheel), ("soils", data.soil)):
        if what == "wheels" and vehicle:
            continue
        low, high = _spread(codes_of(column)[1].astype(float), index, len(names))
        if (low < high).any():
            run = names[np.flatnonzero(low < high)[0]]
            yield (
                f"run '{run}' has rows of several {what}: rows of one run are repeats of one "
                "setting. If runs are numbered anew for each, give each a name of its own"
            )
    if vehicle:
        return  # its wheels carry different loads, each one load
    low, high = _spread(data.conditions.load, index, len(names))
    rolling = np.bincount(index, data.conditions.rolling) > 0  # what is pressed in is a curve
    wide = rolling & (high > _STEADY_LOAD * low)
    if wide.any():
        first = int(np.flatnonzero(wide)[0])
        yield (
            f"the load varies within {int(wide.sum())} of {int(rolling.sum())} runs (run '{names[first]}': "
            f"{low[first]:.4g} to {high[first]:.4g} N): a curve, not repeats. Its rows stay "
            "together in every split, and say nothing of the repeatability"
        )
