# SPDX-License-Identifier: Apache-2.0
"""Why a law has more error than no law at all, by what its own fit found."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from smallwheel_ros.fitting import Base
from smallwheel_ros.fitting.constants import HIDE, SPREAD
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.line import Line
from smallwheel_ros.measurements.display import percent, shown_value
from smallwheel_ros.measurements.table import Measurements

_SIZES = 3  # columns of `line` that a law of plates has, too: load, diameter and width

MISSING = "an effect is missing (`smallwheel diagnose`), or a zero is off"
SAME_FREEDOM = (
    "both have load and size alone, so this is no sign of a missing effect: the law weighs each depth by "
    "its share and holds its numbers to what soils show, and these curves are no one power of depth, or the "
    "sizes too few for its m"
)


def why_of(fitter: Fitter, fit: Fit, base: Base) -> dict[str, str]:
    """By channel, why a law of bodies that do not roll is worse than a line, in words; of wheels `MISSING`.

    What its fit had to lay to scatter that soils and rigs hardly have, over `HIDE` prior deviations of the
    usual (95 % of tables have less), else that both have the same settings to go by.
    """
    variance, points, said = fitter.variance, fitter.points, {}
    far = fit.scatter.log_deviation > variance.log_median + HIDE * SPREAD
    found = fit.scatter.deviations
    large = {name: found[name] for name, is_far in zip(variance.names, far, strict=True) if is_far}
    for name in points.channels:
        use = points.of_channel(name) & (points.value > 0)
        if not use.any() or points.conditions.rolling[points.row[use]].any():
            said[name] = MISSING
            continue
        used = Line.through(points.value[use], points.row[use], points.conditions).used
        same = (used < (_SIZES if base.fixed_m is None else 1)).all()
        said[name] = _strays(name, large, fitter) or (SAME_FREEDOM if same else MISSING)
    return said


def _strays(channel: str, large: Mapping[str, float], fitter: Fitter) -> str:
    texts = []
    if "tau" in large:
        texts.append(
            f"its runs differ by {percent(large['tau'])} in firmness, more than those of one soil: name the "
            "soils (column soil)"
        )
    if f"own:{channel}" in large:
        texts.append(f"its runs differ by {percent(large[f'own:{channel}'])} in what they show")
    if f"zero:{channel}" in large:
        middle = float(np.median(fitter.level[fitter.points.of_channel(channel)]))
        size = shown_value(channel, large[f"zero:{channel}"] * middle)
        texts.append(
            f"its fit lays {size} of each run to a zero: look at where the touch-down was read"
        )
    if "along" in large:
        texts.append(f"its curves stray by {percent(large['along'])} from a power of depth")
    return "; ".join(texts)


def lone_soils(data: Measurements) -> list[str]:
    """The soils of one run, where others have more: held out, nothing is known of them."""
    runs = {str(s): np.unique(data.run[data.soil == s]).size for s in np.unique(data.soil)}
    lone = [name for name, count in runs.items() if count == 1]
    return lone if len(lone) < len(runs) else []
