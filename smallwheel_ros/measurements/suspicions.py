# SPDX-License-Identifier: Apache-2.0
"""What deserves a second look in a readable table: units, signs, sizes, runs, their order."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from smallwheel_ros.measurements.columns import COLUMNS, Mask
from smallwheel_ros.measurements.measurements import Measurements, codes_of
from smallwheel_ros.measurements.settings import (
    Index,
    ends_of_runs,
    one_row_a_wheel,
    order_columns,
    runs_of_rows,
    varied_settings,
)
from smallwheel_ros.physics.conditions import PLATE, Array

SHARES = 0.01  # slip that is nowhere over 1 %: no rig sets it so finely
# Pa: a load over the area of a plate, or over diameter times width of a wheel. The lightest rover's wheel has
# 300 (5 N on 200 x 80 mm), and no soil bears more than a heavy vehicle's tyre presses with.
_LIGHTEST, _HEAVIEST = 50.0, 1e6
_FOLLOWS = 0.9  # share of pairs of runs that rise with the order, less that of those that fall
_ORDERED = 6  # runs: fewer follow an order by chance
_MOST_PAIRED = 1000  # runs at most whose order is compared
_SLIP_LIMIT = 0.95
_STEADY_LOAD = 1.5  # largest over smallest load within one run of repeats
_OTHER_UNIT = {"m": "mm", "N": "kN", "m/s": "mm/s"}  # the likeliest mistake


def suspicions(data: Measurements) -> Iterator[str]:
    """Yield one sentence for each thing that deserves a second look: units, signs, runs."""
    c, z = data.conditions, data.channels
    odd: list[tuple[Mask, str]] = []
    kilonewtons = _kilonewtons(data)
    if kilonewtons:
        yield kilonewtons
    for name, spec in COLUMNS.items():
        values = c[name] if name in c else np.full(len(data), np.nan)
        unit = _OTHER_UNIT.get(spec.unit, spec.unit)
        for rows, word in ((values > spec.usual[1], "more"), (values < spec.usual[0], "less")):
            first = values[int(np.argmax(rows))]
            if name == "load" and word == "less" and kilonewtons:
                continue
            odd.append(
                (
                    rows,
                    f"{name} is {first:.4g} {spec.unit} {{}}, {word} than expected of a small "
                    f"wheel: is the unit right? A header names it, like '{name} [{unit}]'",
                )
            )
    if z:
        blank = np.all([np.isnan(values) for values in z.values()], axis=0)
        odd.append((blank, "nothing was measured {}"))
    odd.append((data.sunk_to_axle, "sinkage is over half the diameter {}, where the wheel is dragged "
                "across its plane: deeper than any model of a rolling wheel holds"))  # fmt: skip
    depth = z.get("sinkage", np.full(len(data), np.nan))
    rollers = (c.diameter < c.width) & (c.contact != PLATE)
    d, b = (f"{1e3 * size[int(np.argmax(rollers))]:.4g} mm" for size in (c.diameter, c.width))
    both = f"a roller of {d}, {b} wide, or a wheel of {b}, {d} wide, with the headers interchanged?"
    odd.append((rollers, f"the diameter is under the width {{}}: {both}"))
    third = (depth > c.diameter / 3) & (c.contact != PLATE) & ~data.sunk_to_axle
    odd.append((third, "sinkage is over a third of the diameter {}"))
    if "slip" in c:
        odd.append(
            (
                np.abs(c["slip"]) > _SLIP_LIMIT,
                f"slip is beyond ±{_SLIP_LIMIT} {{}}: a wheel that "
                "spins on the spot or is dragged locked, outside the range of the models",
            )
        )
    if "resistance" in z:
        words = "resistance is negative {}: it is positive against the direction of travel"
        odd.append((z["resistance"] < 0, words))
    if "slip" in c and data.written_units.get("slip") == "%":
        most = float(np.nanmax(np.abs(c["slip"]), initial=0.0))
        shares = np.full(len(data), 0.0 < most <= SHARES)
        odd.append((shares, f"slip is {100.0 * most:.3g} % at most: if the numbers are shares and not "
                    "per cent, the header is 'slip'"))  # fmt: skip
    for rows, words in odd:
        if rows.any():
            first = f"{data.place} {data.line[int(np.argmax(rows))]}"
            count = int(rows.sum())
            yield words.format(
                f"in {first}" if count == 1 else f"in {count} rows (first in {first})"
            )
    if not data.runs_given or one_row_a_wheel(data):
        return  # the wheels of a vehicle carry different loads, each one load
    names, index = codes_of(data.run)
    for what, column in (("wheels", data.wheel), ("soils", data.soil)):
        low, high = ends_of_runs(codes_of(column)[1].astype(float), index, len(names))
        if (low < high).any():
            yield (
                f"run '{names[int(np.argmax(low < high))]}' has rows of several {what}: rows of one run "
                "are repeats of one setting. If runs are numbered anew for each, give each a name of its own"
            )
    low, high = ends_of_runs(c.load, index, len(names))
    rolling = np.bincount(index, c.rolling) > 0  # what is pressed in is a curve
    wide = rolling & (high > _STEADY_LOAD * low)
    if wide.any():
        at = int(np.argmax(wide))
        yield (
            f"the load varies within {int(wide.sum())} of {int(rolling.sum())} runs (run '{names[at]}': "
            f"{low[at]:.4g} to {high[at]:.4g} N): a curve, not repeats. Its rows stay "
            "together in every split, and say nothing of the repeatability"
        )


def _kilonewtons(data: Measurements) -> str:
    """A sentence if all loads, read as N, are so small that they are likely in kN; "" if not."""
    c = data.conditions
    width = np.where(c.contact == PLATE, np.pi / 4.0 * c.diameter, c.width)
    pressure = c.load / (c.diameter * width)
    low, high = float(np.nanmin(pressure)), float(np.nanmax(pressure))
    if not high < _LIGHTEST or not 1e3 * high < _HEAVIEST or data.written_units.get("load") == "kN":
        return ""
    small, large = float(c.load.min()), float(c.load.max())
    return (
        f"load is {small:.3g} to {large:.3g} N, {low:.2g} to {high:.2g} Pa on these sizes; read in kN it is "
        f"{small:.3g} to {large:.3g} kN, {low:.2g} to {high:.2g} kPa, as usual: which is it? For kN the "
        "header is 'load [kN]'"
    )


def _swept(values: Array, run: Index) -> bool:
    """Whether a setting is swept within most runs, as load in a curve: a run then has no one value of it."""
    low, high = ends_of_runs(values, run, int(run.max()) + 1)
    return bool(np.mean(high - low > (_STEADY_LOAD - 1.0) * np.abs(low)) > 0.5)


def order_followed(data: Measurements) -> str:
    """A sentence if settings follow the order of the runs, so that a drift could look like them; else ""."""
    times = order_columns(data)
    _, run = runs_of_rows(data)
    first = np.unique(run, return_index=True)[1]
    if first.size < _ORDERED:
        return ""
    first = first[:: first.size // _MOST_PAIRED + 1]
    order = data.conditions[times[0]][first] if times else first.astype(float)
    # Wheels are changed seldom: only runs of the same wheel are compared.
    wheel = codes_of(data.wheel[first])[1]
    before = np.where(wheel[:, None] == wheel, np.sign(order[:, None] - order), 0.0)
    found = [
        name
        for name, values in varied_settings(data).items()
        if not _swept(values, run) and abs(_together(before, values[first])) > _FOLLOWS
    ]
    if not found:
        return ""
    listed = " and ".join(found)
    follow = "follow" if len(found) > 1 else "follows"
    if times:
        return (
            f"{listed} followed the time ({times[0]}) throughout: a drift of soil or instruments looks like "
            f"an effect of {listed}. Runs in another order would tell the two apart"
        )
    return (
        f"{listed} {follow} the order of the rows: if runs were made in this order, a drift of soil or "
        f"instruments looks like an effect of {listed}. A column of time would tell"
    )


def _together(before: Array, values: Array) -> float:
    """Goodman and Kruskal's gamma of values with an order: pairs that rise less those that fall, over both.

    before: sign of the order of each pair, shape (runs, runs); 0 for pairs that are not compared. values:
    shape (runs,). 0 if no pair differs.
    """
    signs = before * np.sign(values[:, None] - values)
    pairs = float(np.nansum(np.abs(signs)))
    return float(np.nansum(signs)) / pairs if pairs else 0.0
