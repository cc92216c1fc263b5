# SPDX-License-Identifier: Apache-2.0
"""How well a measurement repeats: the error that no model can go below.

Rows of one run that agree in everything that was set (`settings`) are repeats of one setting. What
they differ by is noise, "pure error" in the words of regression, the pooled standard deviation:

    sigma^2 = sum over runs, rows of (y - mean of the run)^2 / sum over runs of (rows - 1)

What differs from run to run (the soil was prepared anew) is not in it, so the held-out error of
even the true model stays somewhat above it.
"""

from __future__ import annotations

import numpy as np

from smallwheel_ros.measurements.settings import repeats_of_rows
from smallwheel_ros.measurements.table import Measurements

_FEWEST = 3  # degrees of freedom below which a spread says nothing


def repeatability(measurements: Measurements) -> dict[str, float]:
    """Standard deviation of repeats of one run by channel (SI), of the channels that have repeats."""
    index = repeats_of_rows(measurements)
    found = {}
    for name in measurements.channels:
        rows = measurements.channel_rows(name)
        rows = rows[index[rows] >= 0]
        value, run = measurements.channels[name][rows], index[rows]
        count = np.bincount(run)
        mean = np.bincount(run, value) / np.maximum(count, 1)
        freedom = int(np.maximum(count - 1, 0).sum())
        squares = float(np.sum((value - mean[run]) ** 2))
        if freedom >= _FEWEST and squares > 0.0:
            found[name] = float(np.sqrt(squares / freedom))
    return found
