# SPDX-License-Identifier: Apache-2.0
"""Wheels on the soil under them: sinkage and resistances with their covariance, for many rows at once."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from smallwheel_ros.effects.base import Effect, WheelState
from smallwheel_ros.model.nearby import neighbours, slopes
from smallwheel_ros.model.stages import Stages
from smallwheel_ros.physics.conditions import ROLLING, Conditions
from smallwheel_ros.physics.sinkage import Geometry
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER
from smallwheel_ros.physics.wheel import Strength, Wheel
from smallwheel_ros.pipeline.soil.local_law import LocalLaws
from smallwheel_ros.pipeline.soil.model import LOG_DEPTH, covariates, sinkage_of
from smallwheel_ros.pipeline.tables import Array, Columns, Flags, Integers


@dataclass(frozen=True)
class OnSoil(Columns):
    """Predicted sinkages and resistances of wheels on soil.

    Attributes
    ----------
    wheel
        Number of the wheel.
    load
        Load that the wheel carries: that shown by its cell, without the cell's estimated errors, N.
    sinkage
        True sinkage, m.
    compaction, other
        Resistance by compaction, and by the effects, N; 0 for a wheel that does not roll.
    covariance
        Covariance of (sinkage, compaction, other, ln load), (rows, 4, 4): due to the law, the scatter of ln k
        from place to place, and the load.
    own
        The part of `covariance` that is independent from wheel to wheel, due to that scatter and the noise
        of the load, (rows, 4, 4).
    shown
        Sinkage as a sensor would show it, with the effects of instruments, m.
    exponent, diameter
        Exponent n (1) and diameter (m) as the effects change them.
    reaching
        Load that reaches the soil, as the effects change it, N.
    factor
        Factor of the effects on the thrust, 1.
    slip, speed
        Slip (1) and speed (m/s) that effects have read; NaN where none reads it.
    sunk
        Whether the wheel is sunk to its axle.
    """

    wheel: Integers
    load: Array
    sinkage: Array
    compaction: Array
    other: Array
    covariance: Array
    own: Array
    shown: Array
    exponent: Array
    diameter: Array
    reaching: Array
    factor: Array
    slip: Array
    speed: Array
    sunk: Flags

    def means(self, group: Integers, weight: Array) -> OnSoil:
        """Average every column over the rows of each group.

        A group is sunk to the axle if one of its rows is.

        Parameters
        ----------
        group
            Number of each row's group, from 0 on without a gap, shape (rows,); a group is of one wheel.
        weight
            Weight of each row in the mean of its group, 1, shape (rows,).

        Returns
        -------
        OnSoil
            One row for each group, in the order of their numbers.
        """
        total = np.bincount(group, weights=weight)
        columns: dict[str, Array] = {}
        for field in fields(self):
            column = getattr(self, field.name)
            sums = np.zeros((total.size, *column.shape[1:]))
            np.add.at(sums, group, column * weight.reshape(-1, *[1] * (column.ndim - 1)))
            columns[field.name] = sums / total.reshape(-1, *[1] * (column.ndim - 1))
        whole: dict[str, Any] = columns
        whole["wheel"] = np.rint(columns["wheel"]).astype(np.int64)
        whole["sunk"] = np.bincount(group, weights=self.sunk) > 0.0
        return OnSoil(**whole)

    def variance(self, **by: Array | float) -> Array:
        """Compute the variance of a quantity of each row from `covariance`, to first order.

        Parameters
        ----------
        **by
            Derivatives of the quantity with respect to `sinkage`, `compaction`, `other` and `log_load`, shape
            (rows,) or a number; 0 for those that are not given.

        Returns
        -------
        ndarray
            Shape (rows,), in the square of the quantity's unit.
        """
        row = np.zeros_like(self.covariance[:, 0])
        for i, name in enumerate(("sinkage", "compaction", "other", "log_load")):
            row[:, i] = by.get(name, 0.0)
        return np.asarray(np.maximum(np.einsum("ri,rij,rj->r", row, self.covariance, row), 0.0))


def on_soil(
    wheels: tuple[Wheel, ...], wheel: Integers, laws: LocalLaws, shown: Array, shown_std: Array,
    *, scatter: float, effects: tuple[Effect, ...] = (),
    slip: Array | None = None, speed: Array | None = None, strength: Strength | None = None,
    geometry: Geometry = "contact_integral",
) -> OnSoil:  # fmt: skip
    """Compute sinkage and resistances of wheels on their soils, with their covariance.

    Compaction resistance is b K z^(n + 1)/(n + 1) (Bekker 1960; eq. 14 of Meirion-Griffith and Spenko 2011),
    or as the effects change it.

    Parameters
    ----------
    wheels
        All wheels.
    wheel
        Number of each row's wheel, shape (rows,).
    laws
        Law of the soil under the wheel, and errors of its load cell, at each row.
    shown, shown_std
        Load shown by the cell, without noise, and its standard deviation, shape (rows,), N.
    scatter
        Standard deviation of ln k from place to place.
    effects
        Effects of the model.
    slip
        Slip, shape (rows,), 1; None if no effect reads it.
    speed
        Speed, shape (rows,), m/s; None if no effect reads it.
    strength
        Strength of the soil, for effects that read it; None: their factor on the thrust is 1.
    geometry
        Rule of contact: 'contact_integral' or 'closed_form'.

    Returns
    -------
    OnSoil
        One row for each load. Where an effect reads a rolling wheel's slip or speed, and that is unknown, all
        is NaN but the load and its variance.
    """
    rolling = np.array([w.contact == ROLLING for w in wheels])[wheel]
    known, read = covariates(effects, rolling, slip, speed)
    if known.size < shown.size:
        some = on_soil(
            wheels, wheel[known], laws.take(known), shown[known], shown_std[known], scatter=scatter,
            effects=effects, slip=read.get("slip"), speed=read.get("speed"),
            strength=strength, geometry=geometry,
        )  # fmt: skip
        return _among(some, known, wheel, laws, shown, shown_std)
    load, spread = laws.load(shown), laws.with_load(shown)
    law = laws.law.copy()
    law[:, 0] -= law[:, 1] * LOG_DEPTH
    exponent: Array = law[:, 1]
    reaching: Array = load.copy()
    factor: Array = np.ones(load.size)
    # Of sinkage, compaction, other, ln load by ln K, n, m, ln load.
    by_law = np.zeros((load.size, 4, 4))
    by_law[:, 3, 3] = 1.0
    diameter, width = (
        np.array([getattr(w, a) for w in wheels])[wheel] for a in ("diameter", "width")
    )
    if effects and load.size:
        contact = np.array([w.contact for w in wheels])[wheel]
        conditions = Conditions(load, diameter, width, contact, None, read)
        shear: tuple[()] | tuple[float, float, float] = ()
        if strength is not None:
            three = strength.cohesion, strength.friction_angle, strength.shear_displacement
            shear = three[0].value, three[1].value, three[2].value
        found = neighbours(law, conditions, effects, shear, geometry)
        table = np.stack([found.true_sinkage, found.compaction_resistance, found.true_resistance])
        table[2] -= table[1]
        table[1:, np.tile(~rolling, 9)] = 0.0
        by_law[:, :3] = np.stack([slopes(column) for column in table]).transpose(2, 0, 1)
        sinkage, compaction, other = (np.asarray(column[: load.size]) for column in table)
        depth, sunk = found.sinkage[: load.size], found.immobilised[: load.size]
        stages = Stages(effects, conditions)
        k = np.exp(law[:, 0] - law[:, 2] * np.log(REFERENCE_DIAMETER))
        on, diameter, modulus, exponent = stages.loaded(k, law[:, 1], law[:, 2])
        reaching = np.where(rolling, on, load)
        if strength is not None and rolling.any():
            held = strength.cohesion.value, strength.friction_angle.value
            soil = (np.full(load.size, value) for value in held)
            state = WheelState(on, diameter, width, sinkage, modulus, exponent, *soil)
            factor = np.where(rolling, stages.product("thrust_factor", state), factor)
    else:
        made = sinkage_of(law, load, wheels, wheel, geometry=geometry)
        sinkage, sunk, other = made.value, made.sunk, np.zeros(load.size)
        depth = sinkage
        by_law[:, 0] = made.slopes
        # R = b K z^(n + 1)/(n + 1): Bekker 1960, eq. 14 of Meirion-Griffith and Spenko 2011.
        power, log_z = law[:, 1] + 1.0, np.log(sinkage)
        across = np.log(diameter / REFERENCE_DIAMETER)
        compaction = width * np.exp(law[:, 0] + law[:, 2] * across + power * log_z) / power
        compaction = np.where(rolling, compaction, 0.0)
        direct = np.stack(
            [np.ones(load.size), log_z - 1.0 / power, across, np.zeros(load.size)], axis=1
        )
        along = direct + (power / sinkage)[:, None] * made.slopes
        by_law[:, 1] = compaction[:, None] * along
    # From here on by ln pressure, n, m and ln load.
    by_law[:, :3, 1] -= by_law[:, :3, 0] * LOG_DEPTH
    nothing = np.full(load.size, np.nan)
    alone = np.zeros((load.size, 4, 4))
    alone[:, 0, 0], alone[:, 3, 3] = scatter**2, (shown_std / shown) ** 2
    own = by_law @ alone @ by_law.transpose(0, 2, 1)
    both = by_law @ spread @ by_law.transpose(0, 2, 1) + own
    return OnSoil(
        wheel, load, sinkage, compaction, other, both, own, depth, np.array(exponent), np.array(diameter),
        reaching, factor, read.get("slip", nothing), read.get("speed", nothing), sunk,
    )  # fmt: skip


def _among(
    some: OnSoil, known: Integers, wheel: Integers, laws: LocalLaws, shown: Array, shown_std: Array
) -> OnSoil:
    """Put some rows into a table of all, at the indices `known`; of the others only the load is known."""
    columns: dict[str, Any] = {}
    for field in fields(some):
        column = getattr(some, field.name)
        blank = np.nan if column.dtype == float else False
        columns[field.name] = np.full((wheel.size, *column.shape[1:]), blank, dtype=column.dtype)
    columns["wheel"], columns["load"] = wheel, laws.load(shown)
    noise = (shown_std / shown) ** 2
    for name in ("own", "covariance"):
        columns[name][:] = 0.0
        columns[name][:, 3, 3] = noise
    columns["covariance"][:, 3, 3] += laws.with_load(shown)[:, 3, 3]
    for name, column in columns.items():
        column[known] = getattr(some, name)
    return OnSoil(**columns)
