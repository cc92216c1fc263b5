"""How well a measurement repeats: the error that no model can go below.

Rows of one run are repeats of one setting. What they differ by is noise, "pure error" in the words
of regression:

    sigma^2 = sum over runs, rows of (y - mean of the run)^2 / sum over runs of (rows - 1)

What differs from run to run (the soil was prepared anew) is not in it, so the held-out error of
even the true model stays somewhat above it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.physics.conditions import Array

_FEWEST = 3  # degrees of freedom below which a spread says nothing

# How far settings may differ within a run and still be called the same: as a ratio, or absolutely.
_RATIO = {"load": 1.25, "diameter": 1.01, "width": 1.01, "speed": 1.25}
_DIFFERENCE = {"slip": 0.05, "slip_angle": 0.035, "slope": 0.035, "pass_number": 0.5}


@dataclass(frozen=True)
class NoiseFloor:
    """Standard deviation of one row of a channel.

    value: in the channel's SI unit, None where the data does not say. freedom: its degrees of
    freedom (repeats) or rows (declared). reason: why there is none, else how it was found.
    """

    value: float | None
    source: Literal["repeats", "declared"] | None
    freedom: int
    reason: str

    @property
    def std(self) -> float | None:
        """Standard deviation of the value itself, for a Gaussian noise; None if declared."""
        if self.value is None or self.source != "repeats":
            return None
        return float(self.value / np.sqrt(2.0 * self.freedom))


def noise_floor(measurements: Measurements) -> dict[str, NoiseFloor]:
    """Noise floor of each channel: from repeats where there are, else from declared deviations."""
    index, runs = _repeats(measurements)
    return {name: _of_channel(measurements, name, index, runs) for name in measurements.channels}


def repeatability(measurements: Measurements) -> dict[str, float]:
    """What repeats of one run differ by (standard deviation), of the channels that have repeats."""
    return {
        name: floor.value
        for name, floor in noise_floor(measurements).items()
        if floor.source == "repeats" and floor.value is not None
    }


def _repeats(measurements: Measurements) -> tuple[NDArray[np.intp], int]:
    """The run of each row, -1 where the run's settings differ too much to be repeats."""
    if measurements.runs_given:
        runs, index = np.unique(measurements.run, return_inverse=True)
    else:
        runs, index = np.unique(_exact_settings(measurements), axis=0, return_inverse=True)
    index = index.reshape(-1)
    same = np.ones(len(runs), dtype=bool)
    for name, ratio in _RATIO.items():
        if name in measurements.conditions:
            low, high = _range(measurements.conditions[name], index, len(runs))
            same &= ~(high > ratio * low)
    for name, difference in _DIFFERENCE.items():
        if name in measurements.conditions:
            low, high = _range(measurements.conditions[name], index, len(runs))
            same &= ~(high - low > difference)
    for text in (measurements.soil, measurements.conditions.contact):
        codes = np.unique(text, return_inverse=True)[1].reshape(-1).astype(float)
        low, high = _range(codes, index, len(runs))
        same &= low == high
    return np.where(same[index], index, -1), len(runs)


def _exact_settings(measurements: Measurements) -> Array:
    """A table of everything that was set, for finding rows of the same setting."""
    conditions = measurements.conditions
    texts = (measurements.soil, conditions.contact)
    columns = [conditions.load, conditions.diameter, conditions.width]
    columns += [conditions[name] for name in (*_RATIO, *_DIFFERENCE) if name in conditions]
    codes = [np.unique(t, return_inverse=True)[1].reshape(-1).astype(float) for t in texts]
    return np.asarray(np.nan_to_num(np.column_stack([*columns, *codes]), nan=-1.0))


def _range(values: Array, index: NDArray[np.intp], count: int) -> tuple[Array, Array]:
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    known = np.isfinite(values)
    np.minimum.at(low, index[known], values[known])
    np.maximum.at(high, index[known], values[known])
    return np.where(np.isfinite(low), low, 0.0), np.where(np.isfinite(high), high, 0.0)


def _of_channel(
    measurements: Measurements, name: str, index: NDArray[np.intp], runs: int
) -> NoiseFloor:
    rows = measurements.channel_rows(name)
    rows = rows[index[rows] >= 0]
    value, of = measurements.channels[name][rows], index[rows]
    count = np.bincount(of, minlength=runs)
    mean = np.bincount(of, value, minlength=runs) / np.maximum(count, 1)
    freedom = int(np.maximum(count - 1, 0).sum())
    if freedom >= _FEWEST:
        spread = float(np.sqrt(np.sum((value - mean[of]) ** 2) / freedom))
        if spread > 0.0:
            repeated = int((count > 1).sum())
            return NoiseFloor(spread, "repeats", freedom, f"{repeated} settings with repeats")
    declared = measurements.declared_std.get(name)
    if declared is not None and np.isfinite(declared).any():
        known = declared[np.isfinite(declared)]
        level = float(np.sqrt(np.mean(known**2)))
        return NoiseFloor(level, "declared", known.size, f"stated in {known.size} rows")
    return NoiseFloor(
        None,
        None,
        freedom,
        "no setting was repeated (rows of one run), and the table states no "
        f"{name}_std: repeat a few runs to know the noise",
    )
