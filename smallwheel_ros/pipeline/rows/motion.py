# SPDX-License-Identifier: Apache-2.0
"""Path of wheels and vehicle, direction of travel, passes over the same ground, and which rows are due.

The sums:

    path      + (|v| now + |v| before)/2 dt of the wheel's place, 0 where it stands     Turning counts.
    distance  the same for the vehicle's middle, over the rows of all wheels
              Over a pause of the recording: between the poses before and after, where there are any.
    onward    the direction in which all turning wheels drive; while they disagree, as before
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.settings import STANDSTILL_SPEED, OnboardSettings
from smallwheel_ros.physics.conditions import PRESSED, ROLLING
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.tables import Aligned, Array, Flags, Integers, Readings, steps_of

from .passes import Passes
from .steering import ASIDE

_LONGEST = 1.0  # s between two rows over which speeds are taken to change evenly
# s: a recording that was paused; speeds do not tell what was driven meanwhile, places do
_PAUSED = 10.0


@dataclass
class _Last:
    """Last row of a wheel, or of the vehicle: stamp (ns; -1: none), speed (m/s), path (m), place x, y (m)."""

    stamp: int = -1
    speed: float = 0.0
    path: float = 0.0
    place: Array = field(default_factory=lambda: np.full(2, np.nan))


@dataclass
class MotionState:
    """State that `motion` carries from block to block.

    Attributes
    ----------
    wheels, vehicle
        Last row of each wheel and of the vehicle.
    passes
        Tracks of the wheels so far.
    ways
        Whether a wheel last turned forward, by its number.
    onward
        Whether the vehicle as a whole goes forward.
    due
        Stamp at which the next estimate is due, by the wheel's number, ns.
    deepest
        Largest sinkage of a wheel that is pressed, not rolled, by its number, m.
    """

    wheels: list[_Last]
    passes: Passes
    vehicle: _Last = field(default_factory=_Last)
    ways: dict[int, bool] = field(default_factory=dict)
    onward: bool = True
    due: dict[int, int] = field(default_factory=dict)
    deepest: dict[int, float] = field(default_factory=dict)

    @classmethod
    def of(cls, settings: OnboardSettings) -> MotionState:
        """State before the first row."""
        return cls([_Last() for _ in settings.wheels], Passes(settings.wheels))


def motion(state: MotionState, rows: Aligned, settings: OnboardSettings) -> Readings:
    """Add paths, distance, direction of travel, passes, and whether an estimate is due.

    Parameters
    ----------
    state
        State carried from block to block; it is updated.
    rows
        Aligned rows, in order of stamps.
    settings
        Settings of the vehicle.

    Returns
    -------
    Readings
        The same rows, with the columns that `Readings` adds.
    """
    wheels = settings.wheels
    count = len(rows)
    places = np.column_stack([rows.x, rows.y])
    path, due, pressed = np.empty(count), np.empty(count, dtype=bool), np.zeros(count)
    pressed_before = max(state.deepest.values(), default=0.0)
    for number, wheel in enumerate(wheels):
        mine = np.flatnonzero(rows.wheel == number)
        if not mine.size:
            continue
        if wheel.contact == PRESSED:
            path[mine] = pressed[mine] = _pressed(state, number, rows.sinkage[mine])
        else:
            own = rows.stamp[mine], rows.speed[mine], rows.stands[mine], places[mine]
            path[mine] = _path(state.wheels[number], *own)
        due[mine] = _due(state, number, rows.stamp[mine], settings.mobility.rate)
    distance = _path(state.vehicle, rows.stamp, rows.vehicle_speed, rows.stands, places)
    distance = np.maximum(distance, np.maximum.accumulate(np.maximum(pressed, pressed_before)))
    onward = _onward(state, rows)
    counted = state.passes.numbers(rows, distance, onward)
    passes, doubt = rut_of(wheels, rows.wheel, onward, counted)
    if settings.steered:
        off = np.isnan(counted) & _off_track(rows, wheels)
        passes, doubt = (np.where(off, 0.5, one) for one in (passes, doubt))
    return Readings(
        **vars(rows), distance=distance, path=path, onward=onward,
        pass_number=counted, passes=passes, pass_doubt=doubt, due=due,
    )  # fmt: skip


def _off_track(rows: Aligned, wheels: tuple[Wheel, ...]) -> Flags:
    """Whether rear wheels run beside the ruts of the front ones, in a bend or on a sideways course; (rows,).

    In a bend of radius r their tracks are wheelbase^2 / (2 r) apart; beside means over half a wheel's width.
    """
    places = [w.longitudinal_position for w in wheels if w.contact == ROLLING]
    width = np.array([wheel.width for wheel in wheels])[rows.wheel]
    moves = np.maximum(np.abs(rows.vehicle_speed), STANDSTILL_SPEED)
    off = 0.5 * (max(places) - min(places)) ** 2 * np.abs(rows.yaw_rate) / moves
    return np.asarray((off > 0.5 * width) | (np.abs(rows.course) > ASIDE))


def _path(last: _Last, stamps: Integers, speed: Array, stands: Flags, places: Array) -> Array:
    """Integrate speeds (m/s) to paths (m) at rows, shape (rows,), and update `last`.

    stamps: ns. places: x, y (m), shape (rows, 2), which give the path over a pause of the recording.
    """
    size = np.abs(speed)
    size = np.where(size > STANDSTILL_SPEED, size, 0.0)  # of what is not known, too
    before = np.concatenate([[last.speed], size[:-1]])
    stamp = np.concatenate([[last.stamp if last.stamp >= 0 else stamps[0]], stamps])
    seconds = np.diff(stamp) / SECOND
    mean = np.where(seconds > _LONGEST, np.minimum(size, before), 0.5 * (size + before))
    step = np.where(stands, 0.0, mean * seconds)
    apart = np.hypot(*np.diff(np.vstack([last.place, places]), axis=0).T)
    step = np.where((seconds > _PAUSED) & np.isfinite(apart), apart, step)
    last.place = places[-1].copy()
    found = steps_of(step, last.path)
    last.stamp, last.speed, last.path = int(stamps[-1]), float(size[-1]), float(found[-1])
    return found


def _pressed(state: MotionState, number: int, sinkage: Array) -> Array:
    """Largest sinkage (m) up to each row: a pressed wheel meets new soil only by going deeper."""
    deepest = state.deepest.get(number, 0.0)
    deep = np.fmax.accumulate(np.concatenate([[deepest], sinkage]))[
        1:
    ]  # also after values that are unknown
    state.deepest[number] = float(deep[-1])
    return deep


def _due(state: MotionState, number: int, stamps: Integers, rate: float) -> Flags:
    """Mask of the rows that are a period of the rate (1/s) apart; of all rows where the rate is 0.

    Half a period of slack: a sensor of the same rate loses none by the jitter of its stamps.
    """
    if rate == 0.0:
        return np.ones(stamps.size, dtype=bool)
    period = round(SECOND / rate)
    due = state.due.get(number, int(stamps[0]) - period // 2)
    found = np.zeros(stamps.size, dtype=bool)
    for i, stamp in enumerate(stamps.tolist()):
        if stamp >= due:
            found[i] = True
            due = max(due, stamp - period // 2) + period
    state.due[number] = due
    return found


def _onward(state: MotionState, rows: Aligned) -> Flags:
    """Whether the vehicle as a whole goes forward, (rows,): the direction in which all its wheels turn.

    While they disagree it remains as before.
    """
    told = ~rows.stands & np.isfinite(rows.slip)
    if told.any() and len(set(state.ways.values())) <= 1:
        way = next(iter(state.ways.values()), bool(rows.forward[told][0]))
        if (rows.forward[told] == way).all():
            state.ways.update(dict.fromkeys(np.unique(rows.wheel[told]).tolist(), way))
            state.onward = way
            return np.full(told.shape, way)
    found = np.empty(told.shape, dtype=bool)
    for i, (wheel, tells, forward) in enumerate(
        zip(rows.wheel.tolist(), told.tolist(), rows.forward.tolist(), strict=True)
    ):
        if tells:
            state.ways[wheel] = forward
            if len(set(state.ways.values())) == 1:
                state.onward = forward
        found[i] = state.onward
    return found


def rut_of(
    wheels: tuple[Wheel, ...], wheel: Integers, onward: Flags, number: Array
) -> tuple[Array, Array]:
    """Compute the exponent p by which the rut of earlier passes changes a wheel's sinkage.

    Sinkage in a rut is exp(p g) times that on fresh ground, where g is the logarithm of the factor at the
    second pass: p is 0 on fresh ground and 1 at the second pass. It is the mean of two laws of the pass
    number N: log2 N, where sinkage grows with a power of N (Holm 1969), and 2 (1 - 1/N), where the first
    passes do most of the compaction.

    Parameters
    ----------
    wheels
        All wheels.
    wheel
        Index into `wheels` of each row, shape (rows,).
    onward
        Whether the vehicle goes forward, shape (rows,).
    number
        Pass number, 1 on fresh ground, shape (rows,). Where it is NaN, 1 plus the number of the vehicle's
        wheels that run ahead in the same track is used.

    Returns
    -------
    passes : ndarray
        p, shape (rows,), 1.
    doubt : ndarray
        Half the difference of the two laws, shape (rows,), 1.
    """
    count = np.array([[1.0 + len(ahead_of(wheels, w, way)) for way in (-1.0, 1.0)] for w in wheels])
    number = np.where(np.isnan(number), count[wheel, onward.astype(int)], number)
    deepens, compacts = np.log2(number), 2.0 * (1.0 - 1.0 / number)
    doubt = 0.5 * (deepens - compacts)
    return compacts + doubt, np.abs(doubt)


def ahead_of(wheels: tuple[Wheel, ...], wheel: Wheel, way: float) -> list[Wheel]:
    """Return the rolling wheels that run ahead of a wheel in its track.

    Parameters
    ----------
    wheels
        All wheels.
    wheel
        One of them.
    way
        Direction of travel: 1 forward, -1 backward.

    Returns
    -------
    list of Wheel
        Those whose track overlaps that of the wheel; none for a wheel that does not roll.
    """
    return [
        other
        for other in wheels
        if other.contact == ROLLING == wheel.contact
        and way * (other.longitudinal_position - wheel.longitudinal_position) > 0.0
        and abs(other.lateral_position - wheel.lateral_position) < 0.5 * (wheel.width + other.width)
    ]
