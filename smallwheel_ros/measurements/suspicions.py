# SPDX-License-Identifier: Apache-2.0
"""What of a table deserves a second look: units, rows outside of what the models are of, odd runs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from smallwheel_ros.measurements.columns import COLUMNS, Mask
from smallwheel_ros.measurements.settings import ends_of_runs, one_row_a_wheel
from smallwheel_ros.measurements.table import Measurements, codes_of
from smallwheel_ros.physics.conditions import PLATE, ROLLING, Array
from smallwheel_ros.physics.stresses import mean_place

_SLIP_LIMIT = 0.95
_SHARES = 0.01  # slip that is nowhere over 1 %: no rig sets it so finely
_STRONGEST = np.radians(45.0)  # friction angle: no sand under wheels is stronger
_STEADY_LOAD = 1.5  # largest over smallest load within one run of repeats
_OTHER_UNIT = {"m": "mm", "N": "kN", "m/s": "mm/s"}  # the likeliest mistake

# Rows, what to say of them ({0}: where they are, {1}: the first of the values there), and the values.
Suspicion = tuple[Mask, str, Array]


def suspicions(data: Measurements, place: str) -> Iterator[str]:
    """Yield one sentence for each thing that deserves a second look."""
    for rows, words, values in (*_sizes(data), *_odd_rows(data), *_pulls(data)):
        if rows.any():
            count, first = int(rows.sum()), int(np.argmax(rows))
            where = f"{place} {data.line[first]}"
            where = where if count == 1 else f"{count} rows (first in {where})"
            yield words.format(f"in {where}", values[first])
    if data.runs_given:
        yield from _odd_runs(data)


def _sizes(data: Measurements) -> Iterator[Suspicion]:
    """Values that no small wheel has: most likely in another unit."""
    for name, spec in COLUMNS.items():
        if name not in data.conditions:
            continue
        values = data.conditions[name]
        for odd, word in ((values > spec.usual[1], "more"), (values < spec.usual[0], "less")):
            unit = _OTHER_UNIT.get(spec.unit)
            words = (
                f"{name} is {{1:.4g}} {spec.unit} {{0}}, {word} than expected of a small wheel: is the "
                f"unit right? A header names it, like '{name} [{unit}]'"
            )
            yield odd, words, values


def _odd_rows(data: Measurements) -> list[Suspicion]:
    """Rows outside of what the models are of, each kind with what is to say of it."""
    c, nothing = data.conditions, np.zeros(len(data), dtype=bool)
    z = data.channels.get("sinkage", np.full(len(data), np.nan))
    plate, sunk = c.contact == PLATE, data.sunk_to_axle
    percent = data.written_units.get("slip") == "%"
    slip = np.abs(c["slip"]) if "slip" in c else np.zeros(len(data))
    most = float(np.nanmax(slip, initial=0.0))
    blank = np.all([np.isnan(values) for values in data.channels.values()], axis=0)
    found = [
        (sunk, "sinkage is over half the diameter {}, where the wheel is dragged across its plane: "
         "deeper than any model of a rolling wheel holds"),
        ((z > c.diameter / 3) & ~plate & ~sunk, "sinkage is over a third of the diameter {}"),
        ((z > c.diameter) & plate, "sinkage of a plate is over its diameter {}"),
        (blank, "nothing was measured {}"),
        (percent & (0.0 < most <= _SHARES) & ~nothing,
         f"slip is {100.0 * most:.3g} % at most: if the numbers are shares and not per cent, the "
         "header is 'slip'"),
        (slip > _SLIP_LIMIT, f"slip is beyond ±{_SLIP_LIMIT} {{}}: a wheel that spins on the spot or "
         "is dragged locked, outside the range of the models"),
        (c["speed"] == 0.0 if "speed" in c else nothing,
         "speed is 0 {}: effects of speed have no value there"),
        (data.channels.get("resistance", nothing) < 0,
         "resistance is negative {}: it is positive against the direction of travel"),
    ]  # fmt: skip
    return [(rows, words, slip) for rows, words in found]


def _pulls(data: Measurements) -> Iterator[Suspicion]:
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
    words = (
        f"drawbar_pull is {{1:.4g}} N {{0}}, more than the {limit[np.argmax(over)]:.4g} N that a wheel of "
        "this load and sinkage can pull on the strongest sand (friction angle 45 deg): check load, "
        "pull and the zero of the sinkage"
    )
    yield over, words, pull


def _odd_runs(data: Measurements) -> Iterator[str]:
    names, index = codes_of(data.run)
    vehicle = one_row_a_wheel(data)
    for what, column in (("wheels", data.wheel), ("soils", data.soil)):
        if what == "wheels" and vehicle:
            continue
        low, high = ends_of_runs(codes_of(column)[1].astype(float), index, len(names))
        if (low < high).any():
            run = names[int(np.argmax(low < high))]
            yield (
                f"run '{run}' has rows of several {what}: rows of one run are repeats of one "
                "setting. If runs are numbered anew for each, give each a name of its own"
            )
    if vehicle:
        return  # its wheels carry different loads, each one load
    low, high = ends_of_runs(data.conditions.load, index, len(names))
    rolling = np.bincount(index, data.conditions.rolling) > 0  # what is pressed in is a curve
    wide = rolling & (high > _STEADY_LOAD * low)
    if wide.any():
        first = int(np.argmax(wide))
        yield (
            f"the load varies within {int(wide.sum())} of {int(rolling.sum())} runs (run '{names[first]}': "
            f"{low[first]:.4g} to {high[first]:.4g} N): a curve, not repeats. Its rows stay "
            "together in every split, and say nothing of the repeatability"
        )
