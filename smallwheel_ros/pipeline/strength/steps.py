# SPDX-License-Identifier: Apache-2.0
"""Rows averaged over steps of 0.1 m of the vehicle's path, for each wheel that rolls.

A step ends after 0.1 m of path, after the rims have turned by 0.3 m, before a pause of 2 s, and where the
direction of travel or the soil changes. Its slip is that of mean speed and mean rim speed: the mean
of single slips would be biased by their noise. Rows of a wheel at rest belong to no step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.pipeline.rows.level import Level
from smallwheel_ros.pipeline.rows.slip import slip_of
from smallwheel_ros.pipeline.rows.steering import ASIDE
from smallwheel_ros.pipeline.soil.borders import Soils
from smallwheel_ros.pipeline.soil.local_law import local_laws
from smallwheel_ros.pipeline.tables import Array, Flags, Integers, Readings

from .contact import OnSoil, on_soil

CELL, _SPINS, _PAUSE = 0.1, 0.3, 2 * SECOND  # m of path, m of the rims, ns: longest step
_ALIKE = 0.3  # s over which the errors of an odometry are correlated
_FORCE_STD, _LAG = 0.07, 0.2  # m/s^2: of a mean specific force; s by which an acceleration is late


@dataclass(frozen=True)
class _StepRows(Readings):
    """Readings of wheels that roll, with loads without noise.

    Attributes
    ----------
    version, soil
        Number of the law's version under the wheel, and number of that soil.
    """

    version: Integers
    soil: Integers


@dataclass(frozen=True)
class Steps:
    """Steps of the vehicle's path, and the wheels in each.

    Arrays of shape (steps,) have a value for each step, those of shape (rows,) one for each wheel in a step.

    Attributes
    ----------
    end
        Stamp of the row that ends each step, shape (steps,), ns.
    length
        Length of each step along the vehicle's path, shape (steps,), m.
    forward
        Whether the vehicle goes forward, shape (steps,).
    force, force_std
        Mean specific force in the direction of travel, g sin(slope) + dv/dt, and its standard deviation,
        shape (steps,), m/s^2; NaN if unknown.
    soil
        Number of the soil that each step is on, shape (steps,).
    step, wheel
        Index of the step, and number of the wheel, of each row of a wheel, shape (rows,).
    slip, slip_std
        Slip of each wheel over its step, and its standard deviation, shape (rows,), 1.
    torque
        Mean torque, positive in the direction of travel, shape (rows,), N m; NaN if unknown.
    pull, pull_std
        Mean measured drawbar pull, and its standard deviation, shape (rows,), N; NaN if unknown.
    contact
        The wheels on their soil under their mean loads, a row each.
    level
        Zero of the imu's specific force ahead, and its standard deviation, shape (steps, 2), m/s^2; None:
        unknown.
    unlisted
        Share of the weight on wheels that are not listed, shape (steps,), 1; None: 0.
    along
        Cosine of the angle between the wheel's heading and the vehicle's course, shape (rows,), 1; None: 1.
    """

    end: Integers
    length: Array
    forward: Flags
    force: Array
    force_std: Array
    soil: Integers
    step: Integers
    wheel: Integers
    slip: Array
    slip_std: Array
    torque: Array
    pull: Array
    pull_std: Array
    contact: OnSoil
    level: Array | None = None
    unlisted: Array | None = None
    along: Array | None = None


class Excitation(NamedTuple):
    """Ranges of load and |slip| over the measurements of the strength.

    Attributes
    ----------
    load
        Least and largest load, N; inf and 0 before the first measurement.
    slip
        Least and largest |slip|, 1; 1 and 0 before the first measurement.
    """

    load: tuple[float, float] = (math.inf, 0.0)
    slip: tuple[float, float] = (1.0, 0.0)

    def widened(self, load: Array, slip: Array) -> Excitation:
        """Return the ranges widened to include a step's wheels.

        Parameters
        ----------
        load
            Loads, shape (wheels,), N.
        slip
            |slip|, shape (wheels,), 1.
        """
        return Excitation(
            (min(self.load[0], float(load.min())), max(self.load[1], float(load.max()))),
            (min(self.slip[0], float(slip.min())), max(self.slip[1], float(slip.max()))),
        )


@dataclass
class StepState:
    """State carried from block to block.

    Attributes
    ----------
    open
        Rows of the step in progress; None if there are none.
    level
        Estimator of the imu's zero.
    """

    open: _StepRows | None = None
    level: Level = field(default_factory=Level)


def steps(
    state: StepState, rows: Readings, load: Array, load_std: Array, version: Integers,
    soils: Soils, settings: OnboardSettings,
) -> Steps | None:  # fmt: skip
    """Average the rows of a block over the steps that end in it.

    Parameters
    ----------
    state
        State carried from block to block; it is updated.
    rows
        Readings of all wheels.
    load, load_std
        Load without noise and its standard deviation, shape (rows,), N.
    version
        Number of the version of the soil under the wheel, shape (rows,).
    soils
        The soils by version; versions that no row needs any more are dropped from it.
    settings
        The pipeline's settings.

    Returns
    -------
    Steps or None
        None if no step ends. A step may have no rows of wheels, where no slip or load is known.
    """
    state.level.take(rows)
    carried = version if state.open is None else np.concatenate([version, state.open.version])
    soils.forget(carried)
    rolling = np.array([w.contact == ROLLING for w in settings.wheels])[rows.wheel]
    use = rolling & ~rows.stands & np.isfinite(rows.speed) & np.isfinite(rows.rim_speed)
    number = np.array([soils.versions[one].number for one in version[use].tolist()], dtype=np.int64)
    columns = vars(rows.take(use)) | {"load": load[use], "load_std": load_std[use]}
    new = _StepRows(**columns, version=version[use], soil=number)
    whole = new if state.open is None else _StepRows.joined([state.open, new])
    if not len(whole):
        return None
    bounds, kept, way, whole_start = _bounds(whole)
    state.open = whole.take(slice(whole_start, None))
    if not kept:
        return None
    made = _means(whole, bounds, way, soils, settings)
    level = state.level.at(made.end)
    state.level.forget(int(made.end[-1]))
    return replace(made, level=level, unlisted=soils.weighing.unlisted(made.end))


def _bounds(rows: _StepRows) -> tuple[list[tuple[int, int, int]], int, list[float], int]:
    """Split rows into steps.

    Returns the first row, last + 1 and the ending row of each step; the number of steps; their lengths (m);
    and the row at which the step in progress begins.
    """
    distance = np.maximum.accumulate(rows.distance)
    gaps = np.diff(rows.stamp, prepend=rows.stamp[0])
    turned = np.cumsum(np.abs(rows.rim_speed) * gaps / SECOND)
    paused = (gaps > _PAUSE) | np.concatenate([[False], np.diff(rows.forward)])
    another = np.concatenate([[False], np.diff(rows.soil) != 0])
    breaks = np.flatnonzero(paused | another)
    found: list[tuple[int, int, int]] = []
    ways: list[float] = []
    start, count = 0, distance.size
    while start < count:
        i = int(np.searchsorted(distance, distance[start] + CELL))
        spin = turned[start] + _SPINS
        i = max(min(i, int(np.searchsorted(turned, spin))), start + 1)
        later = breaks[np.searchsorted(breaks, start + 1) :]
        cut = int(later[0]) if later.size else count
        stop = min(i, cut)
        if stop >= count:
            break
        way = float(distance[stop - 1 if stop == cut else stop] - distance[start])
        if not (stop == cut and (another[stop] or way < 0.5 * CELL)):
            found.append((start, stop, stop))
            ways.append(way)
        start = stop
    return found, len(found), ways, start


def _means(
    rows: _StepRows, bounds: list[tuple[int, int, int]], way: list[float], soils: Soils,
    settings: OnboardSettings,
) -> Steps:  # fmt: skip
    wheels = len(settings.wheels)
    step = np.full(rows.stamp.size, -1)
    for place, (start, stop, _) in enumerate(bounds):
        step[start:stop] = place
    inside = np.flatnonzero(step >= 0)
    key = step[inside] * wheels + rows.wheel[inside]
    keys, group = np.unique(key, return_inverse=True)

    def mean(column: Array) -> Array:
        values = column[inside]
        known = np.isfinite(values)
        count = np.bincount(group[known], minlength=keys.size)
        total = np.bincount(group[known], weights=values[known], minlength=keys.size)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)

    count = np.bincount(group, minlength=keys.size)
    number, wheel = keys // wheels, keys % wheels
    starts, ends = (np.array([b[i] for b in bounds]) for i in (0, 1))
    duration = (rows.stamp[ends - 1] - rows.stamp[starts]) / SECOND
    alone = np.minimum(count, np.maximum(1.0, duration[number] / _ALIKE))
    speed_std = mean(rows.speed_std) / np.sqrt(alone)
    slip, slip_std, _ = slip_of(
        mean(rows.speed), speed_std, mean(rows.rim_speed), mean(rows.rim_std), 0.0
    )
    sign = np.where(rows.forward, 1.0, -1.0)
    good = np.isfinite(slip) & np.isfinite(mean(rows.load))
    contact = _contacts(rows, inside, group, good, (slip, mean(rows.speed)), soils, settings)
    sound = ~contact.sunk & np.isfinite(contact.sinkage)
    good[good] = sound
    force = _of_vehicle(step, sign * rows.pushed)
    ahead, behind = (sign * rows.gained)[ends - 1], (sign * rows.gained)[starts]
    late = np.abs(ahead - behind) * np.minimum(_LAG / np.maximum(duration, 1e-3), 1.0)
    noise = settings.noise.drawbar_pull / np.sqrt(np.maximum(count, 1))
    along = np.cos(mean(rows.apart))[good]
    if settings.steered:
        # Wheels that go across their heading are held by forces that no law here has.
        skids = mean(np.abs(np.nan_to_num(rows.slip_angle))) > ASIDE
        force[np.unique(number[skids])] = np.nan
    return Steps(
        rows.stamp[ends], np.array(way), rows.forward[starts], force,
        np.hypot(_FORCE_STD, np.nan_to_num(late)), rows.soil[starts], number[good], wheel[good],
        slip[good], slip_std[good], mean(sign * rows.torque)[good], mean(rows.pull)[good], noise[good],
        contact.take(sound), along=along,
    )  # fmt: skip


def _contacts(
    rows: _StepRows, inside: Integers, group: Integers, good: Flags, at: tuple[Array, Array], soils: Soils,
    settings: OnboardSettings,
) -> OnSoil:  # fmt: skip
    """Mean contact of wheels over their steps, a row for each group that is `good`.

    A group is the rows of one wheel in one step. The wheel is put on each version of the law that it has met
    in the step, under the mean load there, and the results are averaged. row `inside[i]` belongs to
    `group[i]`; at: slip and speed (m/s) of each group.
    """
    some = good[group] & np.isfinite(rows.load[inside])
    row, of = inside[some], (np.cumsum(good) - 1)[group[some]]
    versions, version = np.unique(rows.version[row], return_inverse=True)
    parts, first, part = np.unique(
        of * versions.size + version, return_index=True, return_inverse=True
    )
    count = np.bincount(part).astype(float)
    load, load_std = (
        np.bincount(part, weights=column[row]) / count for column in (rows.load, rows.load_std)
    )
    within, lead = parts // versions.size, rows.take(row[first])
    slip, speed = (column[good][within] for column in at)
    contact = on_soil(
        settings.wheels, lead.wheel,
        local_laws(soils.versions, settings.wheels, lead, rows.version[row[first]]), load, load_std,
        scatter=settings.estimator.soil_scatter, effects=settings.effects,
        strength=settings.strength if settings.effects else None, slip=slip, speed=speed,
        geometry=settings.prior.geometry,
    )  # fmt: skip
    return contact.means(within, count)


def _of_vehicle(step: Integers, values: Array) -> Array:
    """Means over all rows of each step, (steps,); NaN where one is unknown. step: of each row, -1: none."""
    inside = step >= 0
    count = np.bincount(step[inside])
    total = np.bincount(step[inside], weights=values[inside])
    return np.asarray(total / np.maximum(count, 1))
