# SPDX-License-Identifier: Apache-2.0
"""Forces of wheels for a state of the strength's filter, with their derivatives.

The state is that of `strength/filter.py`: numbers of the soil, of each wheel, and the grip of each cell, a
stretch of 0.1 m of the ground under the vehicle.
"""

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

# Indices of the state; from WHEELS on the errors of the wheels' slips, then ln of their torques' scales, then
# ln of the cells' grips.
COHESION, FRICTION, SHEAR, OTHER, SLIP, ROLLING, RIM, LOSS, LEVEL, WHEELS = range(10)
OF_SOIL = [COHESION, FRICTION, SHEAR, ROLLING, RIM]  # in the order of `sloped_forces`
_WIDEST = 1.0  # variance of ln thrust up to which a thrust is taken to be lognormal
_DEEPER = 1e-5  # of the diameter: step of sinkage for numerical derivatives


@dataclass(frozen=True)
class Rolling:
    """Rolling wheels on soil, a row each: all that their forces depend on except the filter's state.

    Attributes
    ----------
    order
        Index of the wheel among those that roll, (rows,).
    on
        The wheels on their soil.
    diameter, width
        Size of the wheel, m, (rows,).
    slip
        Slip, 1, (rows,).
    peak
        Place of the largest pressure at slip 1, as a share of the arc of contact, 1.
    along
        Cosine of the angle between the wheel's heading and the vehicle's course, (rows,), or (1,) for all:
        share of the pull that acts along the course.
    layers
        Effects that multiply the pressure by a function of depth.
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
        """Return the effects' factor on the pressure, as a function of depth.

        Parameters
        ----------
        times
            Number of copies of the rows, one after the other, to which the factor is applied.

        Returns
        -------
        callable or None
            Takes depths (m) and returns factors (1), both of shape (nodes, times * rows); None without such
            effects.
        """
        if not self.layers:
            return None
        rows = np.tile(np.arange(self.order.size), times)
        read = {name: getattr(self.on, name)[rows] for name in ("slip", "speed")}
        of = self.on.load[rows], self.diameter[rows], self.width[rows]
        contact = np.full(rows.size, ROLLS)
        return Stages(self.layers, Conditions(*of, contact, None, read)).pressure_factor


class Force(NamedTuple):
    """A force of each row, with its derivatives.

    Attributes
    ----------
    value
        The force, N, (rows,).
    row
        Derivatives with respect to the filter's state, N over the state's units, (rows, size).
    by_slip, by_load, by_sinkage
        Derivatives with respect to slip (N), ln load (N) and sinkage (N/m), (rows,).
    """

    value: Array
    row: Array
    by_slip: Array
    by_load: Array
    by_sinkage: Array

    def own(self, on: OnSoil) -> Array:
        """Variance of the force (N^2, (rows,)) due to sinkage and load errors independent among wheels.

        Parameters
        ----------
        on
            The wheels on their soil, whose `own` holds these errors.
        """
        zz, zw, ww = on.own[:, 0, 0], on.own[:, 0, 3], on.own[:, 3, 3]
        a, b = self.by_sinkage, self.by_load
        return np.maximum(a * a * zz + 2.0 * a * b * zw + b * b * ww, 0.0)


@dataclass(frozen=True)
class Believed:
    """State of a `StrengthFilter` after a step of the path.

    Stacked, it holds the states for many rows: all arrays, `end` included, then have a leading axis of rows.

    Attributes
    ----------
    x, P
        State and its covariance, (size,) and (size, size).
    cells
        Number of the cell of ground under each rolling wheel, (wheels,). A cell is 0.1 m of the ground, whose
        grip is part of the state.
    slips
        Mean slip of each rolling wheel over the step that has just ended, 1, (wheels,); NaN for a wheel that
        was not in it.
    end
        Stamp of the row that ended the step, s; -inf before the first step.
    """

    x: Array
    P: Array
    cells: Integers
    slips: Array
    end: float | Array

    @classmethod
    def stacked(cls, versions: Sequence[Believed], index: Integers) -> Believed:
        """Stack the states that rows refer to.

        Parameters
        ----------
        versions
            States to choose from.
        index
            Index of each row's state in `versions`, shape (rows,).

        Returns
        -------
        Believed
            A state for each row: every array has a leading axis of rows.
        """
        x, P, cells, slips, end = (
            np.array([getattr(one, name) for one in versions])[index]
            for name in ("x", "P", "cells", "slips", "end")
        )
        return cls(x, P, cells, slips, end)

    def forces(self, at: Rolling, *, exact_slip: bool = False) -> tuple[Force, Force, Force]:
        """Compute thrust, drawbar pull, and the torque as a force at the rim.

        Parameters
        ----------
        at
            The rolling wheels.
        exact_slip
            Whether slips are exact. Otherwise the slip errors in the state are added to them, and
            `Force.row` includes the derivatives with respect to these errors.

        Returns
        -------
        thrust, pull, rim : Force
            As measured: the pull is reduced by resistances that are not in the law, the rim force includes
            the scale of the wheel's torque and the friction of its drive.
        """
        return forces(self.x, self.cells, at, exact_slip=exact_slip)

    def spread(self, push: Force, row: Array) -> Array:
        """Compute the variance of forces that contain a thrust, due to the uncertainty of the state.

        It is the mean square deviation from the force at the state's mean. Thrust is a product of strength
        and grip, and is taken to be lognormal, so that the result is larger than to first order.

        Parameters
        ----------
        push
            The thrust that each force contains.
        row
            Derivatives of the forces with respect to the state, shape (rows, size), N over the state's units.

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
            Derivatives of the functions with respect to the state, shape (rows, size).

        Returns
        -------
        ndarray
            Shape (rows,), in the product of the functions' units.
        """
        shared: Array = np.matmul(one[:, None, :], self.P)[:, 0, :]
        return np.asarray((shared * other).sum(axis=1))


def forces(
    x: Array, cells: Integers, at: Rolling, *, exact_slip: bool = False
) -> tuple[Force, Force, Force]:
    """Compute thrust, drawbar pull, and the torque as a force at the rim, for a state of the filter.

    Parameters
    ----------
    x
        State, shape (size,) or (rows, size).
    cells
        Number of the cell of ground under each rolling wheel, shape (wheels,) or (rows, wheels).
    at
        The rolling wheels.
    exact_slip
        Whether slips are exact; see `Believed.forces`.

    Returns
    -------
    thrust, pull, rim : Force
        See `Believed.forces`.
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
    """Compute the pull and rim force of `forces` without derivatives, at half the cost.

    Parameters
    ----------
    x
        State, shape (size,).
    cells
        Number of the cell of ground under each rolling wheel, shape (wheels,).
    at
        The rolling wheels; their slips are corrected by the errors of slip in the state.

    Returns
    -------
    pull, rim : ndarray
        Shape (rows,), N.
    """
    on, wheels = at.on, cells.size
    slip = at.slip + x[SLIP] + x[WHEELS + at.order]
    of_soil = np.repeat(x[OF_SOIL], slip.size).reshape(-1, slip.size)
    rows = _once(on, at, slip, of_soil, np.exp(x[_cells(cells, at.order)]))
    _, pull, rim = _with_factor(forces_of(WheelRows(*rows), at.factor(1)), on.factor)
    gain = np.exp(x[WHEELS + wheels + at.order])
    return _shown(pull, rim, on, x[OTHER], gain, x[LOSS])


def _with_factor(forces: Array, factor: Array) -> tuple[Array, Array, Array]:
    """Apply the effects' factor to thrust and rim force, and its gain of thrust to the pull.

    forces: thrust, pull and rim force without the factor, or their derivatives, (3, ..., rows).
    """
    thrust, pull, rim = forces
    return factor * thrust, pull + (factor - 1.0) * thrust, factor * rim


def _shown(
    pull: Array, rim: Array, on: OnSoil, other: Array, gain: Array, loss: Array
) -> tuple[Array, Array]:
    """Pull less the resistances that are not in the law, and the rim force as a torque shows it (N), (rows,).

    other, loss: resistance not in the law and friction of the drive, over load. gain: scale of the torque.
    """
    return pull - on.other - other * on.reaching, gain * rim + loss * on.reaching


def _cells(cells: Integers, order: Integers) -> Integers:
    """Index in the state of the grip under each row's wheel, (rows,). cells: (wheels,) or (rows, wheels)."""
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
    """Forces at the sinkage, and then at one larger by `more` (m), as 2 * rows rows."""
    once = _once(on, at, slip, x[:, OF_SOIL].T, grip)
    rows = WheelRows(*np.concatenate([once, once], axis=1))
    rows.sinkage[slip.size :] += more
    return sloped_forces(rows, at.factor(2))
