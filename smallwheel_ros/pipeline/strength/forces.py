# SPDX-License-Identifier: Apache-2.0
"""Forces of wheels for a state of the strength's filter, with their slopes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.model.stages import Stages
from smallwheel_ros.physics.conditions import ROLLING as ROLLS
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.force_slopes import SlopedForces, WheelRows, forces_of, sloped_forces
from smallwheel_ros.pipeline.tables import Array, Integers

from .contact import OnSoil

# Places in the state; from WHEELS on errors of the wheels' slips, then scales of torques, then grips.
COHESION, FRICTION, SHEAR, OTHER, SLIP, ROLLING, RIM, LOSS, LEVEL, WHEELS = range(10)
OF_SOIL = [COHESION, FRICTION, SHEAR, ROLLING, RIM]  # in the order of `sloped_forces`
_WIDEST = 1.0  # variance of ln thrust up to which it is taken to be lognormal
_DEEPER = 1e-5  # of the diameter, for the slopes by sinkage


@dataclass(frozen=True)
class Rolling:
    """Rolling wheels, a row each.

    Attributes
    ----------
    order
        Index of the wheel among those that roll, (rows,).
    on
        The wheels on their soil.
    diameter, width
        m, (rows,).
    slip
        1, (rows,).
    peak
        Place of the largest pressure at slip 1, as a share of the arc.
    layers
        Effects that change the pressure by depth.
    along
        Share of each wheel's pull along the vehicle's course, (rows,).
    """

    order: Integers
    on: OnSoil
    diameter: Array
    width: Array
    slip: Array
    peak: float
    along: Array
    layers: tuple[Effect, ...] = ()

    @property
    def share(self) -> Array:
        """`along` as a column, (rows, 1)."""
        return self.along[:, None]

    def factor(self, times: int) -> Callable[[Array], Array] | None:
        """Factor of the effects on pressure by depth, for `times` copies of the rows; None without any."""
        if not self.layers:
            return None
        rows = np.tile(np.arange(self.order.size), times)
        read = {name: getattr(self.on, name)[rows] for name in ("slip", "speed")}
        of = self.on.load[rows], self.diameter[rows], self.width[rows]
        contact = np.full(rows.size, ROLLS)
        return Stages(self.layers, Conditions(*of, contact, None, read)).pressure_factor


class Force(NamedTuple):
    """A force of each row (N, shape (rows,)), with its slopes.

    Attributes
    ----------
    value
        The force, N, (rows,).
    row
        Slopes by the state, (rows, size).
    by_slip, by_load, by_sinkage
        Slopes by slip (N), ln load (N) and sinkage (N/m), (rows,).
    """

    value: Array
    row: Array
    by_slip: Array
    by_load: Array
    by_sinkage: Array

    def own(self, on: OnSoil) -> Array:
        """Variance (N^2) due to the wheel's own place and load."""
        zz, zw, ww = on.own[:, 0, 0], on.own[:, 0, 3], on.own[:, 3, 3]
        a, b = self.by_sinkage, self.by_load
        return np.maximum(a * a * zz + 2.0 * a * b * zw + b * b * ww, 0.0)


@dataclass(frozen=True)
class Believed:
    """State of the filter after a step.

    Stacked, it holds the states for many rows: all arrays then have a leading axis of rows.

    Attributes
    ----------
    x, P
        State and its covariance, (size,) and (size, size).
    cells
        Cell of the ground under each wheel, (wheels,).
    """

    x: Array
    P: Array
    cells: Integers
    slips: Array  # of the step just over, of each rolling wheel; NaN: it was not in it
    end: float | Array  # s

    @classmethod
    def stacked(cls, versions: Sequence[Believed], index: Integers) -> Believed:
        """The states that rows refer to, stacked.

        Parameters
        ----------
        versions
            States to choose from.
        index
            Number of each row's state among them, shape (rows,).
        """
        x, P, cells, slips, end = (
            np.array([getattr(one, name) for one in versions])[index]
            for name in ("x", "P", "cells", "slips", "end")
        )
        return cls(x, P, cells, slips, end)

    def forces(self, at: Rolling, *, exact_slip: bool = False) -> tuple[Force, Force, Force]:
        """Compute thrust, pull, and the rim force that corresponds to the torque.

        Parameters
        ----------
        at
            The rolling wheels.
        exact_slip
            Whether slips are taken as exact.
        """
        return forces(self.x, self.cells, at, exact_slip=exact_slip)

    def spread(self, push: Force, row: Array) -> Array:
        """Compute the mean square deviation of forces that contain a thrust, for lognormal soil and grip.

        Parameters
        ----------
        push
            The thrust.
        row
            Slopes of the force by the state, shape (rows, size), N.

        Returns
        -------
        ndarray
            Shape (rows,), N^2.
        """
        grip = WHEELS + 2 * self.cells.shape[-1]
        safe = np.where(push.value == 0.0, 1.0, push.value)
        factors = np.where(push.value[:, None] == 0.0, 0.0, push.row / safe[:, None])
        factors[:, OTHER:grip] = 0.0
        share = np.minimum(self.product(factors, factors), _WIDEST)
        more = np.expm1(2.0 * share) - 2.0 * np.expm1(0.5 * share) - share
        return np.asarray(self.product(row, row) + more * push.value**2)

    def product(self, one: Array, other: Array) -> Array:
        """Covariance of two linear functions of the state.

        Parameters
        ----------
        one, other
            Slopes by the state, shape (rows, size).

        Returns
        -------
        ndarray
            Shape (rows,).
        """
        shared: Array = np.matmul(one[:, None, :], self.P)[:, 0, :]
        return np.asarray((shared * other).sum(axis=1))


def forces(
    x: Array, cells: Integers, at: Rolling, *, exact_slip: bool = False
) -> tuple[Force, Force, Force]:
    """Compute the forces of wheels for a state; see `Believed.forces`.

    Parameters
    ----------
    x
        State, shape (size,) or (rows, size).
    cells
        Cell of ground of each wheel, shape (wheels,) or (rows, wheels).
    at
        The rolling wheels.
    exact_slip
        Whether slips are taken as exact.
    """
    on, order, count = at.on, at.order, at.order.size
    size, wheels = x.shape[-1], cells.shape[-1]
    index, more = np.arange(count), _DEEPER * at.diameter
    x, cell = np.broadcast_to(x, (count, size)), _cells(cells, order)
    own, scale = WHEELS + order, WHEELS + wheels + order
    slip = at.slip if exact_slip else at.slip + x[:, SLIP] + x[index, own]
    made = _twice(on, at, slip, more, x, np.exp(x[index, cell]))
    cohesion, sine = x[:, COHESION], np.sin(2.0 * x[:, FRICTION])
    values = _with_factor(made.values, np.tile(on.factor, 2))
    found = []
    for each, slopes in zip(values, _with_factor(made.slopes[..., :count], on.factor), strict=True):
        value, deeper = each[:count], each[count:]
        row = np.zeros((count, size))
        row[:, OF_SOIL] = slopes[:-1].T
        row[index, cell] = cohesion * slopes[0] + 0.5 * sine * slopes[1]
        if not exact_slip:
            row[:, SLIP] = row[index, own] = slopes[-1]
        by_load = value - cohesion * slopes[0]
        found.append(Force(value, row, slopes[-1], by_load, (deeper - value) / more))
    thrust, pull, rim = found
    other, gain, loss = x[:, OTHER], np.exp(x[index, scale]), x[:, LOSS]
    shown, felt = _shown(pull.value, rim.value, on, other, gain, loss)
    pull.row[:, OTHER] = -on.reaching
    pull = pull._replace(value=shown, by_load=pull.by_load - other * on.reaching)
    by_state = gain[:, None] * rim.row
    by_state[index, scale], by_state[:, LOSS] = gain * rim.value, on.reaching
    by_load = gain * rim.by_load + loss * on.reaching
    rim = Force(felt, by_state, gain * rim.by_slip, by_load, gain * rim.by_sinkage)
    return thrust, pull, rim


def pull_and_rim(x: Array, cells: Integers, at: Rolling) -> tuple[Array, Array]:
    """Compute pull, and the rim force that corresponds to the torque (N): those of `forces`, without slopes.

    Parameters
    ----------
    x
        State, shape (size,).
    cells
        Cell of ground of each wheel, shape (wheels,).
    at
        The rolling wheels.
    """
    on, wheels = at.on, cells.size
    slip = at.slip + x[SLIP] + x[WHEELS + at.order]
    of_soil = np.repeat(x[OF_SOIL], slip.size).reshape(-1, slip.size)
    rows = _once(on, at, slip, of_soil, np.exp(x[_cells(cells, at.order)]))
    _, pull, rim = _with_factor(forces_of(WheelRows(*rows), at.factor(1)), on.factor)
    gain = np.exp(x[WHEELS + wheels + at.order])
    return _shown(pull, rim, on, x[OTHER], gain, x[LOSS])


def _with_factor(forces: Array, factor: Array) -> tuple[Array, Array, Array]:
    """Thrust, pull (thrust less resistance) and rim force with the effects' factor on thrust and torque.

    forces: without it, (3, ..., rows), or their slopes.
    """
    thrust, pull, rim = forces
    return factor * thrust, pull + (factor - 1.0) * thrust, factor * rim


def _shown(
    pull: Array, rim: Array, on: OnSoil, other: Array, gain: Array, loss: Array
) -> tuple[Array, Array]:
    """Pull less resistances that the law does not give, and the rim force as a torque shows it (N), (rows,).

    other, loss: per N of load; gain: of the motor's torque.
    """
    return pull - on.other - other * on.reaching, gain * rim + loss * on.reaching


def _cells(cells: Integers, order: Integers) -> Integers:
    """Place in the state of the grip under each rolling wheel. cells: (wheels,) or (rows, wheels)."""
    wheels = cells.shape[-1]
    under = np.broadcast_to(cells, (order.size, wheels))[np.arange(order.size), order]
    return np.asarray(WHEELS + 2 * wheels + under)


def _once(on: OnSoil, at: Rolling, slip: Array, of_soil: Array, grip: Array) -> Array:
    peak = np.full(slip.size, at.peak)
    own = on.reaching, on.sinkage, on.diameter, at.width, slip, on.exponent
    return np.array([*own, *of_soil, peak, grip])


def _twice(
    on: OnSoil, at: Rolling, slip: Array, more: Array, x: Array, grip: Array
) -> SlopedForces:
    """Forces at the sinkage, and a little deeper, one after the other."""
    once = _once(on, at, slip, x[:, OF_SOIL].T, grip)
    rows = WheelRows(*np.concatenate([once, once], axis=1))
    rows.sinkage[slip.size :] += more
    return sloped_forces(rows, at.factor(2))
