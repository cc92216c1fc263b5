# SPDX-License-Identifier: Apache-2.0
"""What no law can be learnt of, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from smallwheel_ros.fitting.constants import FEWEST_RUNS
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.learn.drivers import FEWEST_LEVELS, Driver
from smallwheel_ros.learn.law import Law
from smallwheel_ros.measurements.columns import COLUMNS, is_bookkeeping, is_response
from smallwheel_ros.measurements.settings import settings_of_rows
from smallwheel_ros.measurements.table import Measurements

FEWEST_SETTINGS = 10


def too_little(points: Points) -> str:
    """Say what is lacking of settings and runs, "" where there is enough."""
    settings = settings_in(points)
    if settings == 1:
        return "every run has the same setting: a law needs something that was varied"
    if settings < FEWEST_SETTINGS:
        return f"{settings} settings, and a law needs {FEWEST_SETTINGS} or more"
    if points.run_count < FEWEST_RUNS:
        return (
            f"{points.run_count} runs, and a law needs {FEWEST_RUNS} or more: settings of one run "
            "share its soil"
        )
    return ""


def settings_in(points: Points) -> int:
    """How many settings the rows have that are used."""
    used = np.unique(np.concatenate(points.rows))
    return int(np.unique(settings_of_rows(points.measurements)[used]).size)


def nothing_to_follow(drivers: Sequence[Driver], notes: Sequence[str]) -> str:
    """Say why no setting can be followed, "" where one can. notes: on settings that are no drivers."""
    if any(d.columns and d.levels >= FEWEST_LEVELS for d in drivers):
        return ""
    why = "; ".join([*notes, *(_values(d) for d in drivers if d.columns)])
    return f"there is nothing that a law could follow: {why or 'nothing was varied'}"


def cannot_be_told(law: Law, measurements: Measurements) -> str:
    """Say why what is missing may not be this law, though it fits best, "" where it may."""
    known = {*measurements.conditions.covariates, *measurements.channels, *COLUMNS}
    blank = [name for name, unit in measurements.units.items()
             if name not in known and not name.endswith("_std")
             and not is_response(name, unit) and not is_bookkeeping(name)]  # fmt: skip
    if blank:
        return (
            f"something is missing, and {' and '.join(blank)}, blank in some rows, may be what it "
            "follows: fill the cells in, or leave the column out"
        )
    few = [d for t in law.terms for d, _ in t.factors if d.levels < FEWEST_LEVELS]
    return f"what is missing follows {few[0].name}; {_values(few[0])}" if few else ""


def _values(driver: Driver) -> str:
    return f"{driver.name} has {driver.levels} values: a law needs {FEWEST_LEVELS} or more"
