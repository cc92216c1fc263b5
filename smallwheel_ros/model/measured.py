# SPDX-License-Identifier: Apache-2.0
"""The data that a model was fitted to, as far as a prediction needs it: `measured` of a model file.

It holds the range of the settings, so that a prediction can say that it extrapolates; the scatter
of runs and rows, for the deviation of a new measurement; and the observed error of the law of pull
and torque.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.wheel import GRAVITY

Array = NDArray[np.float64]

_ROOM = 0.05  # of a measured range: a setting that is no further outside counts as measured
_SAME = 0.01  # of the diameter: wheels whose sizes differ by less are one wheel
_OFF_LINE = 4.0  # standard deviations: beyond, a row is off the line of two tied settings


@dataclass(frozen=True)
class RunScatter:
    """Scatter of new measurements of one channel about the right model, as standard deviations.

    Relative ones are fractions of the channel's level: the predicted value for sinkage and resistance, the
    load for drawbar pull, load times radius for torque.

    Attributes
    ----------
    run
        Deviation common to all rows of a run, relative.
    zero
        Deviation of a run's zero, in the channel's SI unit.
    absolute, relative
        Deviation of one row: a constant part, in the channel's SI unit, and a relative part.
    law
        Error of the law itself from setting to setting, relative.
    """

    run: float = 0.0
    zero: float = 0.0
    absolute: float = 0.0
    relative: float = 0.0
    law: float = 0.0

    def of_law(self, level: Array) -> Array:
        """Variance due to the error of the law, at levels in the channel's SI unit; the same shape."""
        return np.asarray((self.law * level) ** 2)

    def of_run(self, level: Array) -> Array:
        """Variance due to the run and its zero, at levels in the channel's SI unit; the same shape."""
        return np.asarray((self.run * level) ** 2 + self.zero**2)

    def of_row(self, level: Array) -> Array:
        """Variance of a single row within its run, at levels in the channel's SI unit; the same shape."""
        return np.asarray((self.relative * level) ** 2 + self.absolute**2)


@dataclass(frozen=True)
class ForceLaw:
    """Error of drawbar pull or torque predicted by a fitted model, due to the law of thrust itself.

    Dimensionless standard deviations: of pull over the load, of torque over load times radius.

    Attributes
    ----------
    known
        Total error for wheels and slips that were measured, including that of the soil's fitted strength.
    law
        For wheels or slips that were not measured: the part of the law's error that differs between the
        slips of one wheel. The error of the soil's strength is not included, but comes from the covariance.
    wheel
        For wheels or slips that were not measured: the part of the law's error that all slips of one wheel
        share, likewise without the error of the strength.
    """

    known: float
    law: float
    wheel: float

    @property
    def elsewhere(self) -> float:
        """The error for a wheel or slip that was not measured: both parts together."""
        return float(np.hypot(self.law, self.wheel))


@dataclass(frozen=True)
class Tied:
    """Two settings that were varied together, so that data cannot separate their influence.

    They lay on the line other = at + slope * setting.

    Attributes
    ----------
    setting, other
        Names of the two settings.
    at
        Value of `other` on the line where `setting` is 0, SI.
    slope
        Unit of `other` per unit of `setting`, SI.
    deviation
        Standard deviation of `other` from the line, SI.
    """

    setting: str
    other: str
    at: float
    slope: float
    deviation: float

    def off(self, conditions: Conditions) -> NDArray[np.bool_]:
        """Rows over four deviations off that line, shape (rows,); the conditions must have both settings."""
        away = conditions[self.other] - self.at - self.slope * conditions[self.setting]
        return np.asarray(np.abs(away) > _OFF_LINE * self.deviation)


@dataclass(frozen=True)
class Measured:
    """Range and scatter of the measurements that a model was fitted to; by default nothing is known of them.

    Attributes
    ----------
    ranges
        Smallest and largest value of each setting by name, SI.
    wheels
        Diameter, width and height of the lugs (0 without lugs) of each wheel, m.
    stiffness
        Standard deviation of ln k from run to run.
    runs
        Scatter of new measurements by channel: `sinkage`, `resistance`, `drawbar_pull`, `torque`.
    forces
        Error of the law of `drawbar_pull` and of `torque`, for those that were measured.
    tied
        Pairs of settings that were varied together.
    unexplained
        Whether the data confirms no law, so that differences between runs may be an error of the law.
    """

    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    wheels: tuple[tuple[float, float, float], ...] = ()
    stiffness: float = 0.0
    runs: Mapping[str, RunScatter] = field(default_factory=dict)
    forces: Mapping[str, ForceLaw] = field(default_factory=dict)
    tied: tuple[Tied, ...] = ()
    unexplained: bool = False

    def plain(self) -> dict[str, Any]:
        """The section `measured` of a model file: the attributes by name, as plain lists and dicts."""
        return {
            "ranges": {n: [float(a), float(b)] for n, (a, b) in self.ranges.items()},
            "wheels": [list(map(float, one)) for one in self.wheels],
            "stiffness": float(self.stiffness),
            "runs": {n: asdict(v) for n, v in self.runs.items()},
            "forces": {n: asdict(v) for n, v in self.forces.items()},
            "tied": [asdict(one) for one in self.tied],
            "unexplained": self.unexplained,
        }

    def has_wheel(self, conditions: Conditions) -> NDArray[np.bool_]:
        """Rows with a wheel and a slip that were measured, shape (rows,).

        Sizes may differ from the measured ones by 1 % of the diameter; the slip must be in its range.
        """
        lugs = conditions.covariates.get("grouser_height", 0.0)
        size = np.column_stack(np.broadcast_arrays(conditions.diameter, conditions.width, lugs))
        room = _SAME * conditions.diameter
        found = np.zeros(len(conditions), dtype=bool)
        for wheel in self.wheels:
            found |= np.all(np.abs(size - np.array(wheel)) <= room[:, None], axis=1)
        return found & ~self.beyond("slip", conditions)

    @property
    def settings(self) -> dict[str, tuple[float, float]]:
        """`ranges`, with standard gravity (m/s^2) where the table had no column of it.

        Empty where there are no ranges.
        """
        standard = {"gravity": (GRAVITY, GRAVITY)} if self.ranges else {}
        return {**standard, **self.ranges}

    def beyond(self, name: str, conditions: Conditions) -> NDArray[np.bool_]:
        """Rows in which a setting is clearly outside the measured range, shape (rows,).

        That is by more than 5 % of the range or of its upper end, whichever is more; by more than 1 % of the
        value where only one was measured.

        Parameters
        ----------
        name
            Name of the setting: load, diameter, width, gravity or a covariate. One that the conditions or the
            ranges do not have is never outside.
        conditions
            Settings, SI units; a blank (NaN) is not outside. Gravity is standard where they have none.
        """
        if name in conditions:
            values = conditions[name]
        elif name == "gravity":
            values = np.full(len(conditions), GRAVITY)
        else:
            return np.zeros(len(conditions), dtype=bool)
        if name not in self.settings:
            return np.zeros(len(conditions), dtype=bool)
        low, high = self.settings[name]
        room = _ROOM * max(high - low, abs(high) if high > low else 0.2 * abs(high))
        return np.asarray((values < low - room) | (values > high + room))
