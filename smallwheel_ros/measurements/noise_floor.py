"""How well a measurement repeats: the error that no model can go below.

Rows of one run that agree in everything that was set (`settings`) are repeats of one setting. What
they differ by is noise, "pure error" in the words of regression, the pooled standard deviation:

    sigma^2 = sum over runs, rows of (y - mean of the run)^2 / sum over runs of (rows - 1)

What differs from run to run (the soil was prepared anew) is not in it, so the held-out error of
even the true model stays somewhat above it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.settings import repeats_of_rows
from smallwheel_ros.measurements.table import Measurements

_FEWEST = 3  # degrees of freedom below which a spread says nothing


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
    index = repeats_of_rows(measurements)
    return {name: _of_channel(measurements, name, index) for name in measurements.channels}


def repeatability(measurements: Measurements) -> dict[str, float]:
    """What repeats of one run differ by (standard deviation), of the channels that have repeats."""
    return {
        name: floor.value
        for name, floor in noise_floor(measurements).items()
        if floor.source == "repeats" and floor.value is not None
    }


def _of_channel(measurements: Measurements, name: str, index: NDArray[np.intp]) -> NoiseFloor:
    rows = measurements.channel_rows(name)
    rows = rows[index[rows] >= 0]
    value, of = measurements.channels[name][rows], index[rows]
    count = np.bincount(of)
    mean = np.bincount(of, value) / np.maximum(count, 1)
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
