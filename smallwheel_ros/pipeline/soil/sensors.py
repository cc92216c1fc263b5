# SPDX-License-Identifier: Apache-2.0
"""Faults of sensors that stretches show before the filter uses them: stuck ones, and a wrong sum of loads.

A sinkage sensor that shows less variation than rolling over soil allows is stuck: its readings over five
stretches differ by less than a fifth of the variation expected from loads and texture. It is not judged
where that fifth is less than the sensor's steps.

All loads together are the vehicle's weight, whatever the cells show. Over six stretches of each wheel

    off = mean of ln(sum of W / (m g cos pitch)),    std = (0.02^2 + std(ln sum)^2/6)^1/2

0.02 is the uncertainty of the mass, by scale, water, dust. Where off is over 10 % either the cells
or the mass are wrong, and std is |off|, unless a wrong unit of the loads explains it. The rest of the weight
may be carried by wheels that are not listed.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from smallwheel_ros.common.stamps import NEVER
from smallwheel_ros.physics.wheel import GRAVITY
from smallwheel_ros.pipeline.checks.loads import UNITS, WEIGHT_OFF
from smallwheel_ros.pipeline.tables import Array, Integers

from .stretches import Stretches

# Stretches compared; least deviation of ln k from place to place; share of the expected variation.
_STUCK, _TEXTURE, _STILL = 5, 0.03, 0.2
# Exponent of the load in a sinkage, 1/(n + 1/2), of ordinary sand.
_USUAL = 0.7
_WEIGHED, _MASS_STD = 6, 0.02  # stretches of each wheel that are compared; deviation of ln mass
CONTRADICTION = math.log(1.1)  # neither load cells nor a weighed mass are 10 % off


class StuckSensors:
    """Looks for stuck sinkage sensors in the stretches of each wheel.

    Parameters
    ----------
    wheels
        Number of wheels.

    Attributes
    ----------
    stuck
        Whether each wheel's sensor is stuck at present, shape (wheels,).
    """

    def __init__(self, wheels: int) -> None:
        self.stuck = np.zeros(wheels, dtype=bool)
        self._shown: list[deque[tuple[float, ...]]] = [deque(maxlen=_STUCK) for _ in range(wheels)]

    def add(self, rows: Stretches) -> None:
        """Add stretches, in the order in which they closed."""
        columns = rows.low, rows.high, rows.load, rows.sinkage, rows.step, rows.count
        for wheel, *now in zip(rows.wheel.tolist(), *(c.tolist() for c in columns), strict=True):
            shown = self._shown[wheel]
            shown.append(tuple(now))
            low, high, load, sinkage, step, count = np.array(shown).T
            most, loads = float(high.max() - low.min()), float(np.std(np.log(load)))
            varies = _USUAL * abs(sinkage[-1]) * math.hypot(loads, _TEXTURE)
            coarse = step[-1] if most < step[-1] < math.inf else 0.0
            full = len(shown) == _STUCK and count.sum() >= _STUCK
            self.stuck[wheel] = full and most + coarse < _STILL * varies

    def findings(self, names: Sequence[str]) -> tuple[str, ...]:
        """Describe stuck sensors, and what to check.

        Parameters
        ----------
        names
            Names of all wheels.

        Returns
        -------
        tuple of str
            A sentence for each stuck sensor.
        """
        return tuple(
            f"{names[wheel]}: its sinkage sensor shows the same wherever it rolls, and is not used: is it"
            " stuck, dirty, or does it look at the wheel?"
            for wheel in np.flatnonzero(self.stuck).tolist()
        )


class Weighed(NamedTuple):
    """Comparison of the wheels' loads with the vehicle's weight.

    Attributes
    ----------
    loads
        Mean load of each wheel as its cell shows it, shape (wheels,), N.
    weight, weight_std
        Sum that the loads should have, normal to the slope, and its standard deviation, N.
    """

    loads: Array
    weight: float
    weight_std: float


class Weighing:
    """Compares the loads of all wheels with the vehicle's weight.

    Parameters
    ----------
    wheels
        Number of wheels.
    mass
        Mass of the vehicle, kg; 0: unknown.
    gravity
        Acceleration of gravity, m/s^2.
    """

    def __init__(self, wheels: int, mass: float, gravity: float = GRAVITY) -> None:
        self._mass, self._gravity = mass, gravity
        self._unlisted = NEVER, 0.0
        self._loads: list[deque[tuple[float, float]]] = [
            deque(maxlen=_WEIGHED) for _ in range(wheels)
        ]

    def add(self, rows: Stretches) -> Weighed | None:
        """Add stretches, and compare loads and weight once, when each wheel has six stretches.

        Parameters
        ----------
        rows
            The stretches.

        Returns
        -------
        Weighed or None
            The comparison, from the one call that makes it; None from all others, or without a mass.
        """
        if self._mass <= 0.0:
            return None
        columns = rows.wheel.tolist(), rows.load.tolist(), np.cos(rows.pitch).tolist()
        for wheel, load, upright in zip(*columns, strict=True):
            self._loads[wheel].append((load, upright))
        if min(map(len, self._loads)) < _WEIGHED:
            return None
        loads, upright = np.array(self._loads).transpose(2, 0, 1)  # of wheels by stretches
        sums = np.log(loads.sum(axis=0) / (self._mass * self._gravity * upright.mean(axis=0)))
        off, means = float(sums.mean()), loads.mean(axis=1)
        std = math.hypot(_MASS_STD, float(sums.std()) / math.sqrt(_WEIGHED))
        weight = float(means.sum()) * math.exp(-off)
        self._mass = 0.0
        if any(abs(math.exp(off) / one - 1.0) < WEIGHT_OFF for _, one in UNITS):
            return Weighed(
                means, weight, weight * std
            )  # cells that show kg, say: the mass is right
        if off < -CONTRADICTION:
            self._unlisted = int(rows.end.max()), 1.0 - math.exp(off)
        return Weighed(means, weight, weight * (abs(off) if abs(off) > CONTRADICTION else std))

    def unlisted(self, stamps: Integers) -> Array:
        """Return the share of the weight that the listed wheels do not carry, as known at some stamps.

        Parameters
        ----------
        stamps
            Shape (stamps,), ns.

        Returns
        -------
        ndarray
            Shape (stamps,), 0 to 1; 0 before the comparison, and where the loads are not over 10 % too small.
        """
        since, share = self._unlisted
        return np.where(stamps >= since, share, 0.0)
