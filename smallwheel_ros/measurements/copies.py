# SPDX-License-Identifier: Apache-2.0
"""Runs that occur in a table twice, because they were pasted again, perhaps under other names.

Where readings have few digits, two runs of one setting can agree to the last digit by chance: if readings
scatter by `sigma` and are written in steps of `q`, two of them are equal with probability
q / (2 sqrt(pi) sigma). Equal runs are copies if there are far more of them than chance allows.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc

from smallwheel_ros.measurements.columns import to_base
from smallwheel_ros.measurements.measurements import Measurements, codes_of
from smallwheel_ros.measurements.settings import set_columns
from smallwheel_ros.physics.conditions import Array

_SCATTER = 0.02  # of a reading: runs in soil that was prepared anew differ by 3 to 10 %
_CHANCE = 1e-3  # probability that chance alone makes so many runs equal
_MANY = 10  # different values, whose smallest step is that of the gauge
_MOST_DECIMALS = 10
_EXACT = 1e-9  # of the largest value: less is the rounding of a unit's conversion


def without_copies(data: Measurements) -> tuple[Measurements, str]:
    """Keep only the first of runs that are copies of each other.

    Returns the table, and a sentence about the rows that were left out; empty if none were.
    """
    rows = _stretches(data)
    settings, readings = _columns(data)
    everything = np.column_stack([settings, *readings.values()])
    chances = _chances(data, readings)
    alike: defaultdict[bytes, list[NDArray[np.intp]]] = defaultdict(list)
    equal_settings: defaultdict[bytes, list[float]] = defaultdict(list)
    for one in rows:
        order = one[np.lexsort(everything[one].T)]
        alike[everything[order].tobytes()].append(order)
        equal_settings[settings[order].tobytes()].append(float(np.prod(chances[one])))
    copies = [copy for same in alike.values() for copy in same[1:]]
    expected = sum(0.5 * (len(c) - 1) * sum(c) for c in equal_settings.values())
    # Probability of at least as many equal runs by chance, given the number expected (Poisson).
    if not copies or not gammainc(len(copies), expected) < _CHANCE:
        return data, ""
    first = min(copies, key=lambda one: int(one.min()))
    (of,) = (same[0] for same in alike.values() if any(one is first for one in same))
    left = np.concatenate(copies)
    where = f"{data.place} {data.line[first.min()]} is {data.place} {data.line[of.min()]}"
    runs = f"{len(copies)} run{'s' if len(copies) > 1 else ''}"
    return data.take(np.delete(np.arange(len(data)), left)), (
        f"{left.size} rows, in {runs}, are copies of others to the last digit ({where}): counted once"
    )


def _stretches(data: Measurements) -> list[NDArray[np.intp]]:
    """Row indices of each stretch of neighbouring rows that have one run."""
    run = codes_of(data.run)[1]
    return np.split(np.arange(run.size), np.flatnonzero(np.diff(run)) + 1) if run.size else []


def _columns(data: Measurements) -> tuple[Array, dict[str, Array]]:
    """Settings, shape (rows, settings), texts as codes; and readings by channel. Blank is -1e300."""
    c = data.conditions
    names = ("load", "diameter", "width", *set_columns(data), *data.responses)
    texts = [c.contact, data.soil, *([data.wheel] if data.wheels_given else [])]
    codes = [np.unique(text, return_inverse=True)[1].astype(float) for text in texts]
    settings = np.column_stack([*(np.array(c[name], dtype=float) for name in names), *codes])
    read = {**data.channels, **{f"{name}_std": v for name, v in data.declared_std.items()}}
    blank = -1e300
    return np.nan_to_num(settings, nan=blank), {
        name: np.nan_to_num(values, nan=blank) for name, values in read.items()
    }


def _chances(data: Measurements, readings: dict[str, Array]) -> Array:
    """Probability that another run of the same setting has the same readings as each row, shape (rows,).

    A channel that has one value throughout cannot tell runs apart, and does not count.
    """
    found = np.ones(len(data))
    for name, values in readings.items():
        known = values > -1e299
        if name.endswith("_std") or not known.any() or np.ptp(values[known]) == 0.0:
            continue
        unit = data.written_units.get(name)
        factor = float(to_base(np.ones(1), unit)[0]) if unit else 1.0
        finest = factor * _step(values[known] / factor)
        scatter = np.maximum(_SCATTER * np.abs(values), 1e-300)
        chance = finest / (2.0 * np.sqrt(np.pi) * scatter)
        found *= np.where(known, np.minimum(chance, 1.0), 1.0)
    return found


def _step(values: Array) -> float:
    """Step in which values are written: the smallest between two if there are many, else the last decimal."""
    exact = _EXACT * float(np.abs(values).max())
    steps = np.diff(np.unique(values))
    steps = steps[steps > exact]
    if steps.size >= _MANY:
        return float(steps.min())
    near = (np.abs(values - np.round(values, d)).max() <= exact for d in range(_MOST_DECIMALS))
    return 10.0 ** -next((d for d, fits in enumerate(near) if fits), _MOST_DECIMALS)
