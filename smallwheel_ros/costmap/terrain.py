# SPDX-License-Identifier: Apache-2.0
"""The margins that wheels have met on each terrain class, and the priors of named classes.

A new place of a class is treated as one more draw from the distribution of its places that have been crossed.
For a class without a prior, the mean is that of the places' margins, and the variance is

    variance of the soil's estimate, mean over the places  (an error that all of them share)
  + scatter^2 (1 + 1/N)                                    N: places crossed

    scatter^2 = (2 CLASS_SCATTER^2 + sum of squared deviations from the mean) / (N + 1)

the posterior of a normal spread whose prior is worth two places. A class that was crossed once therefore
costs more than one that has been crossed at length.

For a class with a name in `PRIORS` the prior, with its margin m0 and deviation s0, is worth two places too:

    mean      (2 m0 + sum of the margins) / (2 + N)
    variance  (N times that of the estimate + 2 s0^2 + sum of squared deviations of all 2 + N) / (2 + N)

The gain beyond the reference slip is the mean over the same places. A place where the vehicle got
stuck, and has not got through since, counts as one with a margin of -1. All of these costs are predictions,
99 at most.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from smallwheel_ros.common.node_parameter import parameter
from smallwheel_ros.costmap.cost import CostRules
from smallwheel_ros.costmap.grid import UNKNOWN, Cells, Grid
from smallwheel_ros.physics.wheel import Quantity

_PRIOR_PLACES = 2.0
# Standard deviation of the margin between places of one class, before they show it. The friction angle of one
# sand differs from place to place by 5 to 15 % (Cherubini and Orr 1999); with 9 %, tan(phi) of 32 degrees
# differs by 0.07. Of that a wheel at the reference slip 0.4 mobilises 0.65 (Janosi and Hanamoto, 0.1 m of
# contact, K 15 mm). In the worlds of rates/drive_worlds.py it is 0.04 on sand, 0.06 on soils of any kind.
CLASS_SCATTER = 0.05
_NOTHING_HELD = -1.0  # margin of a vehicle that is stuck: its own load holds it back


# The slip at which pulls are compared: what a driver accepts on a slope before turning back. With
# the 20 % at which wheels are often compared on a bench, small wheels hold hardly any slope.
REFERENCE_SLIP = 0.4
# Slip from which on no more pull is gained: of 17 vehicles that got stuck in snow, the 14 that went on for a
# second reached it, and none before (the same with 0.6 to 0.7; with 0.8 it is 12).
SPINS = 0.7


class Met(NamedTuple):
    """Margin that a kind of ground gives.

    Attributes
    ----------
    margin
        Drawbar pull over load at the reference slip, 1.
    beyond
        Gain of the margin from the reference slip to larger slip, 1.
    """

    margin: Quantity
    beyond: float = 0.0

    @property
    def most(self) -> Quantity:
        """The largest margin that the ground gives at any slip."""
        return Quantity(self.margin.value + self.beyond, self.margin.standard_deviation)


@dataclass(frozen=True)
class ClassPrior:
    """Margin of a named kind of ground before any wheel is on it: H (1 - exp(-slip / K)) - R.

    Attributes
    ----------
    grip
        Largest thrust over load, H, 1.
    softness
        Slip at which 63 % of it is reached, K, 1 (Janosi and Hanamoto 1961).
    resistance
        Resistance over load, R, 1.
    deviation
        Standard deviation of the margin, 1.
    """

    grip: float
    softness: float
    resistance: float
    deviation: float

    def margin(self, slip: float) -> Quantity:
        """The margin at a slip."""
        pull = -self.grip * math.expm1(-slip / self.softness)
        return Quantity(pull - self.resistance, self.deviation)

    def met(self, reference_slip: float) -> Met:
        """The margin at a reference slip, and the gain from there to a slip of `SPINS`."""
        margin = self.margin(reference_slip)
        return Met(margin, self.margin(max(SPINS, reference_slip)).value - margin.value)


# Grip: road adhesion of tyres (Taborek 1957, in Wong, Theory of Ground Vehicles, chapter 1: asphalt 0.8 to
# 0.9, gravel 0.6, dry earth 0.68, wet 0.55, packed snow 0.2, ice 0.1); of sand and mud tan(phi) of 22 and
# 17 degrees. Softness: pneumatic tyres on roads reach their best at a slip of 0.1 to 0.2 (Wong), in sand
# and snow pull goes on rising to 0.5 and more (Wong, chapter 2). Resistance: rolling resistance of tyres,
# asphalt 0.013, gravel 0.02, earth road 0.05 (Wong, chapter 1), loose sand 0.1 to 0.3 (Carvill 1993; Wong),
# snow 0.02 to 0.12 (CRREL TR-01-16, table 11). Deviation: half of their differences. Recorded drives on
# grass, gravel, sand, snow and a floor (129 m that teach a margin) are within two deviations, but only since
# they leave the margin unsure by 0.33: they neither confirm nor refute.
PRIORS: Mapping[str, ClassPrior] = {
    "asphalt": ClassPrior(0.9, 0.03, 0.015, 0.12),
    "gravel": ClassPrior(0.6, 0.06, 0.03, 0.12),
    "firm earth": ClassPrior(0.6, 0.08, 0.04, 0.15),
    "grass": ClassPrior(0.5, 0.08, 0.06, 0.15),
    "sand": ClassPrior(0.4, 0.25, 0.12, 0.10),
    "snow": ClassPrior(0.3, 0.25, 0.10, 0.10),
    "mud": ClassPrior(0.3, 0.20, 0.15, 0.15),
    "ice": ClassPrior(0.1, 0.05, 0.02, 0.05),
}


@dataclass(frozen=True, kw_only=True)
class TerrainSettings:
    """terrain.*: prior knowledge of terrain classes."""

    names: tuple[str, ...] | None = parameter(
        None,
        text="Names of the terrain classes, by number. Of asphalt, gravel, firm earth, grass, sand, snow, mud"
        " and ice something is known before any wheel is on them. Layers of elevation_topic with such a name"
        " are probabilities of the class.",
    )

    @property
    def without_prior(self) -> str:
        """A sentence on the classes whose names have no prior; empty if all have one."""
        others = [name for name in self.names or () if name not in PRIORS]
        if not others:
            return ""
        return (
            f"terrain.names: nothing is known of {', '.join(others)} before a wheel is on it, as of any"
            f" ground; there are margins of {', '.join(PRIORS)}"
        )


@dataclass
class _Class:
    places: int = 0
    mean: float = 0.0
    squares: float = 0.0  # sum of squared deviations from the mean
    variance: float = 0.0  # mean of the estimate's own
    beyond: float = 0.0  # mean

    def add(
        self, margin: float, deviation: float = 0.0, times: float = 1.0, beyond: float = 0.0
    ) -> _Class:
        """Return a copy with `times` more places of a margin with that deviation and that gain beyond."""
        count = self.places + times
        step = margin - self.mean
        return _Class(
            int(count),
            self.mean + step * times / count,
            self.squares + step * step * times * self.places / count,
            self.variance + (deviation**2 - self.variance) * times / count,
            self.beyond + (beyond - self.beyond) * times / count,
        )

    def expected(self, prior: Met | None) -> Met:
        """Margin to expect at a new place of the class."""
        if prior is not None:
            before = prior.margin
            whole = self.add(before.value, 0.0, _PRIOR_PLACES, prior.beyond)
            squares = whole.squares + _PRIOR_PLACES * before.standard_deviation**2
            spread = math.sqrt(whole.variance + squares / whole.places)
            return Met(Quantity(whole.mean, spread), whole.beyond)
        squares = self.squares + _PRIOR_PLACES * CLASS_SCATTER**2
        scatter = squares / (self.places + _PRIOR_PLACES - 1.0)
        spread = math.sqrt(self.variance + scatter * (1.0 + 1.0 / self.places))
        return Met(Quantity(self.mean, spread), self.beyond)


class TerrainClasses:
    """Margins by terrain class, and the costs that follow from them.

    Parameters
    ----------
    rules
        Rules by which a margin becomes a cost.
    apart
        Smallest distance, m, between two places of a wheel that both count, where they are of one class.
    priors
        Margins of classes before they are crossed, by the number of the class.
    """

    def __init__(
        self, rules: CostRules, apart: float, priors: Mapping[int, Met] | None = None
    ) -> None:
        self.rules = rules
        self._priors = dict(priors or {})
        self._apart = apart
        self.clear()

    def clear(self) -> None:
        """Forget all measured margins."""
        self._classes: dict[int, _Class] = {}
        self._last: dict[str, tuple[int, float, float]] = {}
        self._stuck: dict[int, int] = {}

    def has_prior(self, terrain: int) -> bool:
        """Whether the class has a prior of its own."""
        return terrain in self._priors

    def learn(
        self, wheel: str, x: float, y: float, terrain: int, margin: Quantity, beyond: float = 0.0
    ) -> bool:
        """Update a class with a wheel's margin on ground of that class.

        Parameters
        ----------
        wheel
            Name of the wheel.
        x, y
            Place of the wheel, m.
        terrain
            Number of the class; nothing is learnt below 0.
        margin
            Drawbar pull over load at the reference slip, 1.
        beyond
            Gain of the margin beyond the reference slip, 1.

        Returns
        -------
        bool
            Whether it was used: not if the class is below 0, or if the wheel's last place that counted is of
            the same class and closer than `apart`.
        """
        if terrain < 0:
            return False
        last = self._last.get(wheel)
        if (
            last is not None
            and last[0] == terrain
            and math.hypot(x - last[1], y - last[2]) < self._apart
        ):
            return False
        self._last[wheel] = (terrain, x, y)
        known = self._classes.get(terrain, _Class())
        self._classes[terrain] = known.add(margin.value, margin.standard_deviation, beyond=beyond)
        return True

    def stuck_at(self, terrains: Iterable[int]) -> None:
        """Set the classes of all places where the vehicle got stuck and has not got through since."""
        self._stuck = {}
        for terrain in terrains:
            if terrain >= 0:
                self._stuck[terrain] = self._stuck.get(terrain, 0) + 1

    def contradictions(self) -> list[str]:
        """Report each class where the vehicle got stuck at some places, but at fewer than half of them."""
        places = self.places()
        return [
            f"terrain class {terrain} is both: stuck at {stuck} of {places[terrain]} places: the"
            " classifier does not tell them apart, and its cost is that of the mean with their scatter"
            for terrain, stuck in sorted(self._stuck.items())
            if stuck < 0.5 * places[terrain]
        ]

    def margins(self) -> dict[int, Quantity]:
        """Margin to expect at a new place of each class that was crossed or has a prior, by its number."""
        return {terrain: met.margin for terrain, met in self._expected().items()}

    def most(self) -> dict[int, Quantity]:
        """Largest margin at any slip to expect at a new place of each class in `margins`, by its number."""
        return {terrain: met.most for terrain, met in self._expected().items()}

    def _expected(self) -> dict[int, Met]:
        return {
            terrain: self._with_stuck(terrain).expected(self._priors.get(terrain))
            for terrain in sorted({*self.places(), *self._priors})
        }

    def places(self) -> dict[int, int]:
        """Number of places of each class that were crossed, or where the vehicle got stuck."""
        met = {*self._classes, *self._stuck}
        return {terrain: self._with_stuck(terrain).places for terrain in sorted(met)}

    def _with_stuck(self, terrain: int) -> _Class:
        known, stuck = self._classes.get(terrain, _Class()), self._stuck.get(terrain, 0)
        return known.add(_NOTHING_HELD, 0.0, stuck) if stuck else known

    def table(self, other: Quantity | None = None) -> Cells:
        """Cost of each class number, int8 of shape (256,), indexed by the number as an unsigned byte.

        Parameters
        ----------
        other
            Largest margin to expect of classes of which nothing is known; None: their cost is -1. Numbers
            below 0 (bytes from 128 on) have a cost of -1 in any case.
        """
        table: Cells = np.full(256, UNKNOWN, dtype=np.int8)
        if other is not None:
            table[:128] = self.rules.expected(other.value, other.standard_deviation)
        known = self.most()
        if known:
            margins = [[one.value, one.standard_deviation] for one in known.values()]
            table[list(known)] = self.rules.expected(*np.array(margins).T)
        return table

    def costs(self, classes: Grid, other: Quantity | None = None) -> Grid:
        """Turn a grid of class numbers into a new one of costs, on level ground.

        Parameters
        ----------
        classes
            Class numbers; below 0 is not classified.
        other
            Largest margin to expect of classes of which nothing is known; None: their cost is -1.
        """
        # By bytes: numpy's indexing would convert each to a number of eight bytes first.
        found = classes.cells.tobytes().translate(self.table(other).tobytes())
        cells: Cells = np.frombuffer(found, np.int8).reshape(classes.cells.shape).copy()
        return replace(classes, cells=cells)
