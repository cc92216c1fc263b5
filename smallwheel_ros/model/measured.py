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

_ROOM = 0.05  # of what was measured, of a range and off a line: what a setting is good to
_SAME = 0.01  # of a size: one wheel
_OFF_LINE = 4.0  # deviations off the line that two settings lay on


@dataclass(frozen=True)
class RunScatter:
    """Scatter of new measurements of one channel about the right model, in standard deviations.

    Attributes
    ----------
    run
        Deviation of a whole run, relative to the value.
    zero
        Deviation of a run's zero, SI.
    absolute, relative
        Deviation of one row: a constant part, SI, and a part relative to the value.
    law
        Error of the law itself from setting to setting, relative.
    """

    run: float = 0.0
    zero: float = 0.0
    absolute: float = 0.0
    relative: float = 0.0
    law: float = 0.0

    def of_law(self, level: Array) -> Array:
        """Variance due to the error of the law, for values of that size; same shape."""
        return np.asarray((self.law * level) ** 2)

    def of_run(self, level: Array) -> Array:
        """Variance due to the run, for values of that size; same shape."""
        return np.asarray((self.run * level) ** 2 + self.zero**2)

    def of_row(self, level: Array) -> Array:
        """Variance due to a row of a run, for values of that size; same shape."""
        return np.asarray((self.relative * level) ** 2 + self.absolute**2)


@dataclass(frozen=True)
class ForceLaw:
    """Error of the law of pull or torque, as a standard deviation.

    That of pull is divided by the load, that of torque by load times radius.

    Attributes
    ----------
    known
        The error for a wheel and slips that were measured.
    law
        For any other wheel or slip, the part that varies over the slips of a wheel.
    wheel
        For any other wheel or slip, the part common to all slips of a wheel.
    """

    known: float
    law: float
    wheel: float

    @property
    def elsewhere(self) -> float:
        """The error for a wheel that was not measured."""
        return float(np.hypot(self.law, self.wheel))


@dataclass(frozen=True)
class Tied:
    """Two settings that were varied together: other = at + slope * setting, with a scatter `deviation`.

    All in the SI units of the settings.
    """

    setting: str
    other: str
    at: float
    slope: float
    deviation: float

    def off(self, conditions: Conditions) -> NDArray[np.bool_]:
        """Rows in which the two settings are not on that line, shape (rows,)."""
        away = conditions[self.other] - self.at - self.slope * conditions[self.setting]
        return np.asarray(np.abs(away) > _OFF_LINE * self.deviation)


@dataclass(frozen=True)
class Measured:
    """Range and scatter of the measurements.

    Attributes
    ----------
    ranges
        Smallest and largest value of each setting, SI.
    wheels
        (diameter, width, lugs) of each, m.
    stiffness
        Standard deviation of ln k from run to run.
    runs
        Scatter by channel.
    forces
        Error of the law of pull and of torque, by channel, where measured.
    unexplained
        Whether the data confirms no law, so that differences of runs may be an error of the law.
    """

    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    wheels: tuple[tuple[float, float, float], ...] = ()
    stiffness: float = 0.0
    runs: Mapping[str, RunScatter] = field(default_factory=dict)
    forces: Mapping[str, ForceLaw] = field(default_factory=dict)
    tied: tuple[Tied, ...] = ()
    unexplained: bool = False

    def plain(self) -> dict[str, Any]:
        """The ranges and scatter as plain values, for a model file."""
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
        """Rows with a wheel that was measured, at slips that were measured."""
        lugs = conditions.covariates.get("grouser_height", 0.0)
        size = np.column_stack(np.broadcast_arrays(conditions.diameter, conditions.width, lugs))
        room = _SAME * conditions.diameter
        found = np.zeros(len(conditions), dtype=bool)
        for wheel in self.wheels:
            found |= np.all(np.abs(size - np.array(wheel)) <= room[:, None], axis=1)
        return found & ~self.beyond("slip", conditions)

    @property
    def settings(self) -> dict[str, tuple[float, float]]:
        """Ranges of the settings; gravity is the standard one unless the table says otherwise."""
        standard = {"gravity": (GRAVITY, GRAVITY)} if self.ranges else {}
        return {**standard, **self.ranges}

    def beyond(self, name: str, conditions: Conditions) -> NDArray[np.bool_]:
        """Rows in which a setting is outside the measured range, shape (rows,).

        Parameters
        ----------
        name
            Name of the setting: load, diameter, width, gravity or a covariate; an unknown one is never
            outside.
        conditions
            Settings, SI units; gravity is standard where they have none.
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
