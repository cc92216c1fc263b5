# SPDX-License-Identifier: Apache-2.0
"""The rows of a table split by what differs between them: a soil, a wheel, a range of slip."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.columns import Array, Mask
from smallwheel_ros.measurements.settings import OF_RANGE, cluster, varied_settings
from smallwheel_ros.measurements.table import Measurements

_FEW_VALUES = 5  # a column with at most so many different values is split by value
_PARTS = 4  # otherwise into so many parts of about as many rows


@dataclass(frozen=True)
class Part:
    """Some of the rows, named: by which column ("slip") and which of its values ("0.2 to 0.4").

    range: smallest and largest value of a numeric column, in SI; empty for a text.
    """

    by: str
    label: str
    rows: Mask
    range: tuple[float, ...] = ()


def parts(measurements: Measurements) -> list[Part]:
    """The rows split by soil, wheel, contact and each setting that was varied."""
    texts = {
        "soil": measurements.soil,
        "wheel": _wheels(measurements),
        "contact": measurements.conditions.contact,
    }
    found: list[Part] = []
    for by, names in texts.items():
        kinds = np.unique(names)
        if kinds.size > 1:
            found += [Part(by, str(kind) or "not named", names == kind) for kind in kinds]
    for by, values in varied_settings(measurements).items():
        found += _by_value(by, values)
    return found


def _wheels(measurements: Measurements) -> NDArray[np.str_]:
    """Names of the wheels; with the size where wheels of several sizes share one name."""
    size = measurements.conditions.diameter
    names = measurements.wheel
    shared = any(np.unique(np.round(size[names == n], 6)).size > 1 for n in np.unique(names))
    if not shared:
        return names
    return np.array([f"{n} {1e3 * d:.4g} mm" for n, d in zip(names, size, strict=True)])


def levels(values: Array) -> Array | None:
    """The different values of a column that has few, else None."""
    known = values[np.isfinite(values)]
    code = cluster(known, OF_RANGE * float(np.ptp(known)))
    if code.max() >= _FEW_VALUES:
        return None
    return np.asarray(np.bincount(code, known) / np.bincount(code), dtype=float)


def _by_value(by: str, values: Array) -> list[Part]:
    known = np.isfinite(values)
    few = levels(values)
    if few is not None:
        nearest = np.abs(values[:, None] - few).argmin(axis=1)
        return [
            Part(by, f"{level:.4g}", known & (nearest == i), (float(level),))
            for i, level in enumerate(few)
        ]
    edges = np.unique(np.quantile(values[known], np.linspace(0, 1, _PARTS + 1)))
    number = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, edges.size - 2)
    found = [
        Part(by, f"{low:.3g} to {high:.3g}", known & (number == i), (float(low), float(high)))
        for i, (low, high) in enumerate(pairwise(edges))
    ]
    return [part for part in found if part.rows.any()]
