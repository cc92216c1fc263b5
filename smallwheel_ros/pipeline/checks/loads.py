# SPDX-License-Identifier: Apache-2.0
"""Rules of `checks` about load cells and sinkage sensors; configured (static) loads are not judged."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np

from smallwheel_ros.physics.wheel import GRAVITY
from smallwheel_ros.pipeline.tables import Array

from .odometry import REPEAT_WAY
from .rims import HELD, SIGN_WAY
from .sums import Medians, Run, Said
from .window import CheckedWheels, Source, Window

WEIGHT_OFF = 0.1  # of the mass, known to 5 %, and 5 % of the cells
SWAP, SWAP_PIECE, SWAP_PIECES = 0.5, 0.2, 20  # correlation; m: a wheel's contact; how many
SWAP_SURE = 4.0  # standard errors of the mean of two correlations: by chance one in 30,000
ZERO_OFF = (
    0.02  # of the radius: on hard ground a sensor without fault shows 0, with the error of its zero
)
# N in one, inverted. A cell that shows kg divides by the standard gravity, wherever it is.
UNITS = (("kg", 1 / GRAVITY), ("kN", 1e-3), ("lbf", 0.2248))
SOFTEST, HARDEST = (
    100.0,
    1e8,
)  # Pa under 1 cm of sinkage: fresh snow 1 kPa, rock does not yield at 100 MPa


class HeldColumn:
    """Measures the path over which one wheel repeats a number bit for bit while most others keep changing.

    Parameters
    ----------
    what
        The quantity, `load` or `sinkage`.
    vehicle
        The wheels.
    """

    def __init__(self, what: str, vehicle: CheckedWheels) -> None:
        self.what, self.names = what, vehicle.names
        self.ways, self.counts = ([Run() for _ in vehicle.names] for _ in range(2))

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        A repeated zero counts like any other repeated number.
        """
        table, found = getattr(window, f"{self.what}s"), []
        if table is None or window.rims is None:
            return []
        inside = table.inside
        t = table.stamp[inside]
        step = np.diff(table.way, prepend=table.way[:1])[inside]
        for i, name in enumerate(self.names):
            others = np.delete(table.changes, i, axis=1).sum(axis=1) * 2 > len(self.names) - 1
            same = (~table.changes[:, i] & np.isfinite(table.x[:, i]))[inside]
            way, count = self.ways[i], self.counts[i]
            way.extend(same, step, t)
            count.extend(same, others[inside].astype(float), t)
            if way.most > REPEAT_WAY and count.most > HELD:
                text = f"its {self.what} is one and the same number over {way.most:.1f} m: check its driver"
                found.append(
                    Said(f"{name} {self.what}", way.most, text, (f"{name}/{self.what}",), way.began)
                )
        return found


class Weight:
    """Compares the sum of the loads with the weight, by the median of their ratio."""

    def __init__(self, vehicle: CheckedWheels) -> None:
        self.vehicle, self.sums = vehicle, Medians()
        self.each = Medians()

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        The median is judged after the first metre.
        """
        table, vehicle = window.loads, self.vehicle
        if table is None or not vehicle.mass > 0.0:
            return []
        if any(f"{name}/load" in window.memory.doubted for name in vehicle.names):
            return []  # a cell that is held is no witness
        x = table.x[table.inside]
        self.sums.extend(x.sum(axis=1)[:, None])
        self.each.extend(x)
        if not len(self.sums) or window.memory.way < SIGN_WAY:
            return []
        ratio = float(self.sums.value[0]) / (vehicle.mass * vehicle.gravity)
        if abs(ratio - 1.0) < WEIGHT_OFF:
            return []
        middle = self.each.value
        empty = np.flatnonzero(middle < WEIGHT_OFF * np.median(middle))
        names = [vehicle.names[i] for i in empty]
        why = [f"are they in {unit}?" for unit, one in UNITS if abs(ratio / one - 1.0) < WEIGHT_OFF]
        why += (
            [f"{', '.join(names)} carries nothing: a dead cell, or a wheel in the air"]
            if names
            else []
        )
        why += ["check the cells and vehicle.mass"]
        text = f"loads add up to {ratio:.3g} times the weight: {why[0]}"
        doubted = names or vehicle.names
        doubts = tuple(f"{name}/load" for name in doubted)
        # Where all are off, the filter has weighed them and knows it; one dead cell it takes at its word.
        return [Said(", ".join(names) or "loads", ratio, text, doubts, taught=bool(names))]


class Swapped:
    """Finds pairs of wheels whose sinkages each follow the load of the other.

    Changes of ln sinkage and ln load between means over successive 0.2 m of path are correlated.
    """

    def __init__(self, vehicle: CheckedWheels) -> None:
        self.names, n = vehicle.names, len(vehicle.names)
        self.open: dict[
            int, Array
        ] = {}  # piece: counts and sums of loads and sinkages, (4, wheels)
        self.last: Array | None = None
        self.count, self.sums, self.products = 0, np.zeros(2 * n), np.zeros((2 * n, 2 * n))

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        A piece of path is used two pieces later, when all of its rows have arrived.
        """
        if window.loads is None or window.sinkages is None or window.rims is None:
            return []
        for row, table in ((0, window.loads), (2, window.sinkages)):
            self._add(row, table)
        done = int(window.way(np.array([0.0]))[0] / SWAP_PIECE) - 1
        for piece in sorted(piece for piece in self.open if piece < done):
            self._close(self.open.pop(piece))
        return self._judged() if self.count >= SWAP_PIECES else []

    def _add(self, row: int, table: Source) -> None:
        x = table.x[table.inside]
        pieces = (table.way[table.inside] / SWAP_PIECE).astype(int)
        for piece in np.unique(pieces).tolist():
            mine = x[pieces == piece]
            known = np.isfinite(mine)
            sums = self.open.setdefault(piece, np.zeros((4, len(self.names))))
            sums[row] += known.sum(axis=0)
            sums[row + 1] += np.where(known, mine, 0.0).sum(axis=0)

    def _close(self, sums: Array) -> None:
        with np.errstate(divide="ignore", invalid="ignore"):
            now = np.log(np.r_[sums[3] / sums[2], sums[1] / sums[0]])
        if self.last is not None:
            change = now - self.last
            if np.isfinite(change).all():
                self.count += 1
                self.sums += change
                self.products += np.outer(change, change)
        self.last = now

    def _judged(self) -> list[Said]:
        w, found = len(self.names), []
        mean = self.sums / self.count
        covariance = self.products / self.count - np.outer(mean, mean)
        spread = np.sqrt(np.maximum(np.diag(covariance), 1e-18))
        c = (covariance / np.outer(spread, spread))[:w, w:]
        for i, j in combinations(range(w), 2):
            crossed, own = np.array([c[i, j], c[j, i]]), np.array([c[i, i], c[j, j]])
            sure = crossed.mean() > SWAP_SURE / math.sqrt(2.0 * self.count)
            if sure and (crossed - own).min() > SWAP:
                pair = self.names[i], self.names[j]
                text = (
                    f"sinkages of {pair[0]} and {pair[1]} follow each the load of the other: check load_topic"
                    " and sinkage_topic"
                )
                doubts = tuple(f"{name}/{what}" for name in pair for what in ("load", "sinkage"))
                found.append(
                    Said(
                        f"{pair[0]} and {pair[1]}", float(crossed.min()), text, doubts, taught=True
                    )
                )
        return found


class Impossible:
    """Judges the median sinkage in motion: no wheel rolls above the ground, or sunk past its axle."""

    def __init__(self, vehicle: CheckedWheels) -> None:
        self.vehicle = vehicle
        self.middles = [Medians() for _ in vehicle.names]

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        The median is judged after the first metre.
        """
        table, found = window.sinkages, []
        if table is None or window.rims is None:
            return []
        moved = np.diff(table.way, prepend=table.way[:1]) > 0.0
        for i, (name, medians) in enumerate(zip(self.vehicle.names, self.middles, strict=True)):
            medians.extend(table.x[moved & table.inside][:, [i]])
            radius = float(self.vehicle.radius[i])
            if not len(medians) or window.memory.way < SIGN_WAY:
                continue
            middle = float(medians.value[0])
            if -ZERO_OFF * radius <= middle <= radius:
                continue
            why = (
                "above the ground: set its zero"
                if middle < 0
                else "deep, over its radius: is it in mm?"
            )
            text = f"it rolls {abs(middle):.3g} m {why}"
            found.append(Said(f"{name} sinkage", middle, text, (f"{name}/sinkage",), taught=True))
        return found


def impossible_soil(k: float, n: float, m: float, width: float) -> str:
    """Explain why no soil follows p = k z^n b^m with these numbers, so that a sensor must be at fault.

    Judged at 1 cm of sinkage, so that the pressure does not depend on extrapolation by the exponents.

    Parameters
    ----------
    k
        Modulus, Pa m^-(n + m).
    n, m
        Exponents of sinkage and of the wheel's width, 1.
    width
        Width b of the wheel, m.

    Returns
    -------
    str
        The reason, in words; empty where a soil may have these numbers.
    """
    with np.errstate(over="ignore"):
        pressure = float(np.float64(k) * np.float64(0.01) ** n * np.float64(width) ** m)
    if SOFTEST <= pressure <= HARDEST:
        return ""
    return (
        f"no soil carries {pressure:.2g} Pa under 1 cm of sinkage: check zero, unit and mounting of the"
        " sinkage sensors, and the unit of the loads; the soil is not published"
    )
