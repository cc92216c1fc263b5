# SPDX-License-Identifier: Apache-2.0
"""What no effect of a library explains: a law that fails at one place, bad runs, drifts, saturation.

A lab's grids differ from table to table: one to four loads, four to eight slips, two to four repeats.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pandas as pd

from rates._world_labs import Bench, repeated, rig_table, run_scatter, stream
from smallwheel_ros.simulate.rig import draw_design
from smallwheel_ros.simulate.settings import draw_effects

_SINKAGE, _RESISTANCE = "sinkage [mm]", "resistance [N]"


def any_lab(
    seed: int, part: int, hidden: Sequence[str] = (), *, repeats: tuple[int, int] = (2, 4)
) -> pd.DataFrame:
    """A full grid of loads and slips (passes, speeds where an effect follows them), repeated.

    Order of the runs is drawn.
    """
    names = {text.partition("=")[0] for text in hidden}
    own = stream(seed, 0, 60)
    effects = draw_effects(hidden, stream(seed, 0, 20))
    soil = draw_design(effects, (), stream(seed, 0, 21)).soil
    heavy = names & {"load_dependent_modulus", "hardpan", "bulldozing"} or any(
        name.startswith(("sinkage_", "load_", "resistance_", "rig_")) for name in names
    )
    loads = np.linspace(30.0, 110.0, int(own.integers(3 if heavy else 1, 5)))
    lowest = -0.5 if "skid_sinkage" in names else float(own.choice([-0.2, 0.0]))
    slips = np.round(np.linspace(lowest, own.uniform(0.5, 0.7), int(own.integers(4, 8))), 2)
    if names == {"skid_sinkage"}:
        slips = np.round(np.linspace(-0.6, 0.2, int(own.integers(4, 8))), 2)
    sizes = [(float(own.uniform(0.18, 0.32)), float(own.uniform(0.06, 0.12)))]
    if "width_dependent_modulus" in names:
        sizes = [(sizes[0][0], b) for b in (0.05, 0.08, 0.13)]
    passes = (1.0, 2.0, 4.0) if "multipass" in names else (1.0,)
    speeds = (0.02, 0.08, 0.3) if "penetration_rate" in names else (0.05,)
    if len(loads) * len(slips) * len(sizes) * len(passes) * len(speeds) > 24:
        slips = slips[np.linspace(0, len(slips) - 1, 3).astype(int)]
    times = int(own.integers(repeats[0], repeats[1] + 1))
    runs = [
        {"load": float(w), "slip": float(i), "diameter": d, "width": b, "pass_number": p, "speed": v}
        for w in loads for i in slips for d, b in sizes for p in passes for v in speeds
    ] * times  # fmt: skip
    rng = stream(seed, part, 61)
    order = rng.permutation(len(runs))
    at, number = repeated([runs[i] for i in order], 1)
    scatter = run_scatter(rng, number, float(own.uniform(0.02, 0.07)))
    return Bench(soil, effects).table(at, number, scatter, rng)


def deeper_at_one(seed: int, part: int, by: float = 0.6, setting: str = "slip") -> pd.DataFrame:
    """A lab in which one value of a setting sinks deeper, in every repeat."""
    table = any_lab(seed, part, repeats=(3, 3))
    own = stream(seed, 0, 62)
    column = "load [N]" if setting == "load" else setting
    values = np.unique(table[column])
    if values.size < 3:
        column, values = "slip", np.unique(table["slip"])
    worst = values[int(own.integers(1, values.size - 1))]
    table.loc[np.isclose(table[column], worst), _SINKAGE] *= 1.0 + by
    return table


def saturated(seed: int, part: int, hidden: Sequence[str], column: str = _SINKAGE) -> pd.DataFrame:
    """A sensor that shows no more than 60 to 80 % of the largest value there is."""
    table = any_lab(seed, part, hidden, repeats=(3, 3))
    most = float(table[column].max()) * stream(seed, 0, 63).uniform(0.6, 0.8)
    rng = stream(seed, part, 64)
    table[column] = np.minimum(table[column], most * (1.0 + 0.004 * rng.normal(size=len(table))))
    return table


def _transposed(value: float) -> float:
    """Two digits of a number as written with three digits, exchanged where that changes most."""
    text = f"{value:.1f}"
    digits = [i for i, c in enumerate(text) if c.isdigit()]
    made = []
    for a, b in itertools.pairwise(digits):
        swapped = list(text)
        swapped[a], swapped[b] = swapped[b], swapped[a]
        made.append(float("".join(swapped)))
    return max(made, key=lambda v: abs(np.log(max(v, 1e-3) / value)))


FAULTS = ("tenfold", "tenth", "transposed", "force-tenfold", "swapped", "doubled")


def bad_run(
    seed: int, part: int, fault: str, hidden: Sequence[str] = (), design: str = "drawn"
) -> pd.DataFrame:
    """Runs of one row, one of them written down wrong (or two swapped). `bad` in `attrs`: its rows."""
    if design == "drawn":
        runs = int(stream(seed, 0, 65).integers(16, 40))
        table = rig_table(seed, part, hidden, runs=runs, rows_per_run=1)
    else:
        table = any_lab(seed, part, hidden)
    rng = stream(seed, part, 66)
    row = int(rng.integers(len(table)))
    rows = [row]
    if fault == "tenfold":  # a wheel shown deeper than its axle is refused already
        small = table.index[table[_SINKAGE] * 10.0 < 0.5 * table["diameter [mm]"]]
        fault = "tenth" if small.empty else fault
        rows = [row if small.empty else int(rng.choice(small))]
    if fault == "tenfold":
        table.loc[rows[0], _SINKAGE] *= 10.0
    elif fault == "tenth":
        table.loc[rows[0], _SINKAGE] /= 10.0
    elif fault == "transposed":
        shown = np.array([max(_transposed(v), 0.05) for v in table[_SINKAGE]])
        by = np.abs(np.log(shown / table[_SINKAGE].to_numpy()))
        by[shown >= 0.5 * table["diameter [mm]"].to_numpy()] = 0.0  # refused already
        plain = np.flatnonzero(by > np.log(1.7))  # else the clearest there is
        rows = [int(rng.choice(plain)) if plain.size else int(np.argmax(by))]
        table.loc[rows[0], _SINKAGE] = shown[rows[0]]
    elif fault == "force-tenfold":
        table.loc[rows[0], _RESISTANCE] *= 10.0
    elif fault == "doubled":
        shallow = table.index[table[_SINKAGE] * 2.0 < 0.5 * table["diameter [mm]"]]
        rows = [int(rng.choice(shallow))]
        table.loc[rows[0], _SINKAGE] *= 2.0
    elif fault == "swapped":
        # The answers of two runs of which one sinks twice as deep.
        deep = np.log(table[_SINKAGE].to_numpy())
        half = np.log(0.5 * table["diameter [mm]"].to_numpy())
        fit = (deep < half[row]) & (deep[row] < half)  # deeper than its axle is refused already
        other = int(np.argmax(np.where(fit, np.abs(deep - deep[row]), -1.0)))
        rows = [row, other]
        table.loc[rows, [_SINKAGE, _RESISTANCE]] = table.loc[
            rows[::-1], [_SINKAGE, _RESISTANCE]
        ].to_numpy()
    table.attrs["bad"] = [str(name) for name in table.loc[rows, "run"]]
    return table


def drifting(seed: int, part: int, what: str, column: str = "time [s]") -> pd.DataFrame:
    """Something drifts over a lab's day, in the order of its runs. what: none, k, zero, force.

    column: what tells of the order, the time, `index` or `trial`.
    """
    table = any_lab(seed, part, repeats=(3, 4))
    own = stream(seed, 0, 67)
    runs = pd.factorize(table["run"])[0].astype(float)
    day = runs / runs.max()
    shape = day ** own.choice([0.6, 1.0, 1.5])  # not the law that a library fits
    sign = own.choice([-1.0, 1.0])
    if what == "k":
        table[_SINKAGE] *= np.exp(-sign * 0.35 * shape)
        table[_RESISTANCE] *= np.exp(-sign * 0.17 * shape)
    elif what == "zero":
        table[_SINKAGE] += abs(sign) * 0.35 * table[_SINKAGE].median() * shape
    elif what == "force":
        table[_RESISTANCE] += sign * 0.35 * table[_RESISTANCE].median() * shape
    pauses = stream(seed, part, 68).uniform(300.0, 1500.0, int(runs.max()) + 1).cumsum()
    table[column] = pauses[runs.astype(int)] if column == "time [s]" else runs + 1.0
    return table
