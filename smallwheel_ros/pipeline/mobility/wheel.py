# SPDX-License-Identifier: Apache-2.0
"""Forces and margins of wheels on the estimated soil and strength.

Each number has a standard deviation, propagated to first order from law, strength, load and slip.
Drawbar pull is thrust less the resistance of the same stresses (`physics.stresses`), of the effects, and
of what is in no law. A torque measured at the same instant is fused with thrust and pull. The margin is
pull over load at the reference slip, at the wheel's sinkage or, where that is larger, at the sinkage of
the largest pull: a wheel that hardly sinks has a short contact, in which the law mobilises little shear;
since that was never measured, firm ground is assumed to hold as much as any softer one would.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from smallwheel_ros.costmap.terrain import SPINS
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.force_slopes import WheelRows, forces_of
from smallwheel_ros.pipeline.soil.local_law import Version, local_laws, sinkages
from smallwheel_ros.pipeline.soil.stretches import WheelsUnderLoad
from smallwheel_ros.pipeline.strength.contact import OnSoil, on_soil
from smallwheel_ros.pipeline.strength.forces import OF_SOIL, OTHER, WHEELS, Believed, Rolling
from smallwheel_ros.pipeline.strength.two_filters import RECENT, Strengths
from smallwheel_ros.pipeline.tables import Array, Flags, Integers, Mobility, Readings, unknown
from smallwheel_ros.pipeline.versions import Versions

# Scatter of a thrust about law and grip, as a share of it; N, least deviation of any pull.
SCATTER, _LEAST_STD = 0.05, 0.15
# Error of the law in a margin's pull, as a share of the load: with a balance of forces, and without one.
_FITTED, _UNFITTED = 0.03, 0.05
_LEAST_TORQUE = 0.25  # N at the rim: least deviation of a measured torque
HARDLY_TRAVELS = 0.95  # slip above which energy per metre is not given
# Margin of a wheel that is sunk to its axle: it pulls nothing, and its whole load has to be dragged along.
SUNK = -1.0
_OF_SUNK = {"margin": SUNK, "margin_std": 0.0, "beyond": 0.0}
_DEPTHS = np.geomspace(2e-3, 0.45, 33)  # of the diameter: sinkages among which the best is chosen


@dataclass(frozen=True)
class Predicted(Mobility):
    """Predicted mobility of wheels on the estimated soil.

    The margin rests on `Strengths.reserve`. Unlike in `Mobility`, it is `SUNK` (-1) where a rolling wheel is
    sunk to its axle.

    Attributes
    ----------
    sunk
        Whether the wheel is sunk to its axle: the soil does not carry the load before that.
    beyond
        Gain of pull over load from the reference slip to the slip at which the vehicle no longer moves, 1.
    """

    sunk: Flags
    beyond: Array

    @classmethod
    def unknown(cls, count: int) -> Predicted:
        """Return `count` rows in which every number is NaN, and no wheel is sunk."""
        names = [column.name for column in fields(Mobility)]
        sunk = np.zeros(count, dtype=bool)
        return cls(**{name: unknown(count) for name in [*names, "beyond"]}, sunk=sunk)


def mobility(
    rows: Readings, load: Array, load_std: Array, law: Integers, strength: Integers, soils: Versions[Version],
    strengths: Strengths, settings: OnboardSettings,
) -> Predicted:  # fmt: skip
    """Predict the mobility of the wheels at these rows.

    Parameters
    ----------
    rows
        Readings.
    load
        Load as the cells show it, without noise, shape (rows,), N, no NaN.
    load_std
        Standard deviation of the load, shape (rows,), N.
    law
        Number of the version of the soil under each wheel, shape (rows,).
    strength
        Number of the version of the strength at each row, shape (rows,).
    soils
        Versions of the soil's law.
    strengths
        Estimator of the strength, with its versions.
    settings
        The pipeline's settings.

    Returns
    -------
    Predicted
        One row for each of `rows`. Thrust, pull, margin and energy are NaN for wheels that do not roll.
    """
    wheels, count = settings.wheels, law.size
    laws = local_laws(soils, settings.wheels, rows, law)

    def at_slip(slip: Array) -> OnSoil:
        return on_soil(
            wheels, rows.wheel, laws, load, load_std, scatter=settings.estimator.soil_scatter,
            effects=settings.effects, slip=slip, speed=rows.speed,
            strength=settings.strength if settings.effects else None, geometry=settings.prior.geometry,
        )  # fmt: skip

    on = at_slip(rows.slip)
    reference = at_slip(np.full(count, settings.reference_slip)) if settings.effects else on
    names = "thrust", "drawbar_pull", "margin", "energy"
    names_of_all = [*names, *(f"{name}_std" for name in names), "beyond"]
    found = dict(zip(names_of_all, np.full((len(names_of_all), count), np.nan), strict=True))
    beyond, unsure = np.zeros(count), np.zeros(count)
    rolls = np.array([w.contact == ROLLING for w in wheels])[rows.wheel]
    sunk = on.sunk.copy()
    mine = np.flatnonzero(rolls & ~sunk & np.isfinite(on.sinkage) & np.isfinite(reference.sinkage))
    if mine.size:
        rolling, own, at_reference = rows.take(mine), on.take(mine), reference.take(mine)
        of = strengths.rolling(rolling.wheel, own, rolling.slip)
        now, reserve = strengths.at(strength[mine])
        beyond[mine] = on.load[mine] * now.x[:, OTHER]
        unsure[mine] = on.load[mine] * np.sqrt(now.P[:, OTHER, OTHER])
        made = _pulls(rolling, of, now) | _margins(
            at_reference, of, reserve, settings, bool(strengths.mass > 0.0)
        )
        for name, values in made.items():
            found[name][mine] = values
        sunk[mine] = at_reference.sunk
    for name, value in _OF_SUNK.items():
        found[name][rolls & sunk] = value
    nothing = np.where(on.sunk | np.isnan(on.sinkage), np.nan, 1.0)
    loaded = WheelsUnderLoad(
        rows.wheel, load, (load_std / load) ** 2, np.zeros(count), rows.slip, rows.speed, rows.passes,
        rows.pass_doubt,
    )  # fmt: skip
    sinkage, variance = sinkages(soils, loaded, law)
    measured = np.isfinite(sinkage)
    sinkage = np.where(measured, sinkage, on.shown) * nothing
    sinkage_std = np.sqrt(np.where(measured, variance, on.variance(sinkage=1.0))) * nothing
    other_std = np.sqrt(on.variance(other=1.0, log_load=beyond) + unsure**2)
    whole = on.compaction + on.other + beyond
    # Over the load, whose own deviation counts in both.
    ratio = on.variance(compaction=1.0, other=1.0, log_load=beyond - whole) + unsure**2
    return Predicted(
        load=on.load, load_std=np.sqrt(on.variance(log_load=on.load)),
        sinkage=sinkage, sinkage_std=sinkage_std,
        compaction_resistance=on.compaction * nothing,
        compaction_resistance_std=np.sqrt(on.variance(compaction=1.0)) * nothing,
        other_resistance=(on.other + beyond) * nothing, other_resistance_std=other_std * nothing,
        rolling_resistance_coefficient=whole / on.load * nothing,
        rolling_resistance_coefficient_std=np.sqrt(ratio) / on.load * nothing,
        **found, sunk=on.sunk,
    )  # fmt: skip


def _pulls(rows: Readings, at: Rolling, now: Believed) -> dict[str, Array]:
    """Thrust, pull and energy per metre at the present slip, and their deviations, by column of `Mobility`.

    A measured torque corrects both forces. Slip is the mean of the last step if that has ended within 2 s.
    """
    # The error of one measured slip makes several newtons; that of a step's mean is in the filter's state.
    recent = rows.time - now.end <= RECENT
    mean = now.slips[np.arange(at.order.size), at.order]
    averaged = recent & np.isfinite(mean)
    slip = np.where(averaged, mean, rows.slip)
    known = np.isfinite(rows.slip) & np.isfinite(slip)
    at = replace(at, slip=np.where(known, slip, 0.0))
    push, pull, rim = now.forces(at)
    own_slip = np.where(averaged, 0.0, (push.by_slip * np.nan_to_num(rows.slip_std)) ** 2)
    noise = (SCATTER * push.value) ** 2 + own_slip + _LEAST_STD**2
    found: dict[str, Array] = {}
    torque = np.where(rows.forward, 1.0, -1.0) * rows.torque
    both = push, pull
    by_state = [now.spread(push, force.row) + noise for force in both]
    rim_spread = now.product(rim.row, rim.row)
    shared = [now.product(rim.row, force.row) for force in both]
    by_law = [
        at.on.variance(sinkage=force.by_sinkage, other=by_other, log_load=force.by_load)
        for force, by_other in ((push, 0.0), (pull, -1.0))
    ]
    index = np.arange(at.order.size)
    scale = np.exp(now.x[index, WHEELS + now.cells.shape[-1] + at.order])
    for i, name in enumerate(("thrust", "drawbar_pull")):
        # A torque measured at this row corrects the force.
        variance = rim_spread + scale**2 * noise + _LEAST_TORQUE**2
        innovation = 2.0 * torque / at.diameter - rim.value
        common = shared[i] + scale * noise
        gain = np.where(np.isfinite(innovation), common / variance, 0.0)
        value = both[i].value + gain * np.nan_to_num(innovation)
        spread = np.maximum(by_state[i] - gain * common, 0.0)
        found[name] = np.where(known, value, np.nan)
        deviation = np.sqrt(np.maximum(spread + by_law[i], _LEAST_STD**2))
        found[f"{name}_std"] = np.where(known, deviation, np.nan)
    with np.errstate(all="ignore"):
        driven = rows.slip >= 0.0
        ratio = np.where(driven, 1.0 / (1.0 - rows.slip), 1.0 + rows.slip)
        by_slip = np.where(driven, ratio**2, 1.0)
    told = known & (rows.slip <= HARDLY_TRAVELS)
    over = by_slip * rows.slip_std * found["thrust"]
    found["energy"] = np.where(told, ratio * found["thrust"], np.nan)
    found["energy_std"] = np.where(told, np.hypot(ratio * found["thrust_std"], over), np.nan)
    return found


def _margins(
    on: OnSoil, at: Rolling, reserve: Believed, settings: OnboardSettings, balanced: bool
) -> dict[str, Array]:
    """Pull over load at the reference slip, its deviation, and its gain at the slip at which nothing moves.

    Neither is smaller on stiffer ground: where a wheel would pull more at a larger sinkage, that is used.
    balanced: whether the mass is known, so that a balance of forces has fitted the law.
    """

    def at_slip(value: float) -> Rolling:
        slip = np.full_like(on.load, value)
        best = _best_sinkage(on, at, reserve, slip)
        return replace(at, on=replace(on, sinkage=np.maximum(on.sinkage, best)), slip=slip)

    push, pull, _ = reserve.forces(at_slip(settings.reference_slip), exact_slip=True)
    by_law = on.variance(sinkage=pull.by_sinkage, other=-1.0, log_load=pull.by_load - pull.value)
    law = (_FITTED if balanced else _UNFITTED) * on.load
    spread = reserve.spread(push, pull.row) + by_law + law**2
    deviation = np.sqrt(np.maximum(spread, _LEAST_STD**2)) / on.load
    _, most, _ = reserve.forces(at_slip(max(settings.reference_slip, SPINS)), exact_slip=True)
    return {
        "beyond": np.maximum(most.value - pull.value, 0.0) / on.load,
        "margin": pull.value / on.load,
        "margin_std": deviation,
    }


def _best_sinkage(on: OnSoil, at: Rolling, of: Believed, slip: Array) -> Array:
    """Sinkage (m) at which each wheel pulls most, (rows,).

    Near its largest value a pull hardly changes with sinkage, so that load is rounded to 10 %, n to 0.1 and
    the effects' factor to 0.01: few different wheels have to be computed.
    """
    rows = np.arange(at.order.size)
    cell = WHEELS + 2 * of.cells.shape[-1] + of.cells[rows, at.order]
    keys = np.stack(
        [
            on.diameter, at.width, np.round(np.log(on.reaching), 1), np.round(on.exponent, 1),
            np.round(on.factor, 2), of.x[rows, cell], *of.x[:, OF_SOIL].T,
        ]
    )  # fmt: skip
    kinds, index = np.unique(keys, axis=1, return_inverse=True)
    size, many = kinds.shape[1], _DEPTHS.size
    columns = np.repeat(kinds, many, axis=1)
    diameter, width, log_load, exponent, factor, log_grip, c, phi, shear, rolls, rim = columns
    depths = np.tile(_DEPTHS, size) * diameter
    slips, peaks = (np.full(depths.size, value) for value in (slip[0], at.peak))
    load, grip = np.exp(log_load), np.exp(log_grip)
    made = forces_of(
        WheelRows(
            load, depths, diameter, width, slips, exponent, c, phi, shear, rolls, rim, peaks, grip
        )
    )
    pull = (made[1] + (factor - 1.0) * made[0]).reshape(size, many)
    best: Array = depths.reshape(size, many)[np.arange(size), pull.argmax(axis=1)]
    return np.asarray(best[index.reshape(-1)])
