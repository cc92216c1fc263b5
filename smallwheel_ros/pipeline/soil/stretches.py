# SPDX-License-Identifier: Apache-2.0
"""Readings of a wheel over 0.2 m of its own path become one measurement of the soil.

    stretch   rows from one to the last before path - start >= length; it also ends where the vehicle
              turns back, and is then used if it has at least half that length
    sinkage   mean of the rows within 3 (sigma + MAD) of their median (MAD: median absolute deviation)
    load      exp(mean ln W), shrunk to the wheel's mean by the share of noise in its spread
              (regression calibration, Carroll and others 2006)
    sigma     of one reading, and of ln load, from second differences, so that a trend is not noise

Rows of a wheel that has not moved since its last row are left out: a wheel at rest gives no new
information.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields

import numpy as np

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.tables import Array, Columns, Flags, Integers, Readings

_SECOND_DIFFERENCE = 6.0  # variance of a - 2 b + c over that of one of three independent readings
# Number of readings that the learnt noise counts for at most, and that the configured one counts for.
_NOISE_MEMORY, _TOLD_READINGS = 200.0, 20.0
# Squared differences over their expectation are cut at the first; the mean is then the second.
_WORST_NOISE, _CUT_MEAN = 2.0, 0.742
_KEPT = 3.0  # readings so many deviations from the median are left out
_LOAD_MEMORY = 100  # stretches over which mean and spread of loads are taken
# Deviations of ln load: between stretches, at first; of one reading, until learnt.
_LEAST_LOAD_SPREAD, _TOLD_LOAD = 0.02, 0.02
# Path after which a wheel stands on other soil (correlation exp(-path/length)), m; of a pressed wheel the
# increase of its depth, over its diameter.
LENGTH, _PRESSED = 0.2, 0.02
_MOST_ROWS = 2000  # in one stretch of a pressed wheel, which need not move


@dataclass(frozen=True)
class WheelsUnderLoad(Columns):
    """Wheels under loads, for which the law predicts the sinkage.

    Attributes
    ----------
    wheel
        Number of the wheel.
    load
        Load as its cell shows it, without noise, N.
    load_variance
        Variance of ln load that is left of the cell's noise.
    load_rate
        d ln load / dt, 1/s.
    slip, speed
        Slip, 1, and speed of the wheel's place, m/s; NaN if unknown.
    passes, pass_doubt
        As in `Readings`.
    """

    wheel: Integers
    load: Array
    load_variance: Array
    load_rate: Array
    slip: Array
    speed: Array
    passes: Array
    pass_doubt: Array


@dataclass(frozen=True)
class Stretches(WheelsUnderLoad):
    """Means over stretches of wheels' paths, a row each, in the order in which they close.

    Attributes
    ----------
    end
        Stamp of the first row beyond the stretch, which closed it, ns.
    sinkage, variance
        Mean measured sinkage, m, and its variance due to the sensor's noise, m^2.
    pitch
        Mean pitch, rad, positive nose down.
    distance
        Path of the vehicle at the last row, m.
    place
        Mean place of the wheel along the vehicle's path, m: path of the vehicle, plus the distance by which
        the wheel runs ahead of the vehicle's middle in the direction of travel.
    onward
        Whether the vehicle goes forward.
    count, dropped
        Number of readings of sinkage in the mean, and of those left out as outliers.
    low, high
        Smallest and largest reading of sinkage in the stretch, m.
    step
        Smallest difference between consecutive readings of this sensor so far that is not 0, m; inf if none.
    """

    end: Integers
    sinkage: Array
    variance: Array
    pitch: Array
    distance: Array
    place: Array
    onward: Flags
    count: Integers
    dropped: Integers
    low: Array
    high: Array
    step: Array


def length_of(wheel: Wheel) -> float:
    """Length (m) of a stretch of a wheel: of its path if it rolls, of its sinkage if it is pressed."""
    return LENGTH if wheel.contact == ROLLING else _PRESSED * wheel.diameter


@dataclass(frozen=True)
class _StretchRows(Columns):
    """The columns of `Readings` from which a stretch is computed."""

    stamp: Integers
    sinkage: Array
    load: Array
    slip: Array
    speed: Array
    passes: Array
    pass_doubt: Array
    pitch: Array
    distance: Array
    path: Array
    onward: Flags

    @classmethod
    def of(cls, rows: Readings, chosen: Integers) -> _StretchRows:
        """Select these columns and the rows with the indices `chosen`."""
        return cls(**{one.name: getattr(rows, one.name)[chosen] for one in fields(cls)})


@dataclass
class _Wheel:
    """What is learnt of a wheel, and its open stretch.

    Attributes
    ----------
    length
        Length of its stretches, m.
    reading_variance, load_noise
        Variance of one reading of sinkage (m^2) and of ln load.
    noise_readings
        Number of readings that both variances count for.
    step
        As in `Stretches`.
    load_mean, load_spread
        Mean of ln load over stretches, and its variance between them, noise included.
    stretches
        Number of stretches closed so far.
    open
        Rows of the stretch in progress; None before the first row.
    """

    length: float
    reading_variance: float
    load_noise: float = _TOLD_LOAD**2
    noise_readings: float = _TOLD_READINGS
    step: float = math.inf
    load_mean: float = 0.0
    load_spread: float = _LEAST_LOAD_SPREAD**2
    stretches: int = 0
    open: _StretchRows | None = None

    def calibrated(self, mean: Array, count: Array) -> tuple[Array, Array]:
        """Loads without the noise of their cell, from means of ln load over readings.

        Parameters
        ----------
        mean
            Means of ln load, shape (rows,).
        count
            Number of readings in each mean, shape (rows,).

        Returns
        -------
        load, variance : ndarray
            Shape (rows,): load, N, and the remaining variance of its logarithm.
        """
        noise = self.load_noise / count
        if self.stretches == 0:
            return np.exp(mean), noise
        share = np.minimum(noise / max(self.load_spread, 1e-8), 1.0)
        return np.exp(mean - share * (mean - self.load_mean)), noise * (1.0 - share)


@dataclass
class StretchState:
    """State carried from block to block, of each wheel in the order of the settings."""

    wheels: list[_Wheel] = field(default_factory=list)

    @classmethod
    def of(cls, settings: OnboardSettings) -> StretchState:
        """Return the state before the first row."""
        variance = settings.estimator.sinkage_std**2
        return cls([_Wheel(length_of(wheel), variance) for wheel in settings.wheels])


@dataclass(frozen=True)
class Loads(Columns):
    """Load without its cell's noise, and its standard deviation, at each row.

    Attributes
    ----------
    load, load_std
        N; NaN where the load is unknown.
    """

    load: Array
    load_std: Array


def stretches(
    state: StretchState, rows: Readings, settings: OnboardSettings
) -> tuple[Stretches | None, Loads]:
    """Average a block of rows over stretches of each wheel's path, and free their loads of noise.

    Parameters
    ----------
    state
        State carried from block to block; it is updated.
    rows
        Readings of all wheels.
    settings
        The pipeline's settings.

    Returns
    -------
    Stretches or None
        Stretches that close in this block; None if none does.
    Loads
        Loads of the block's rows, from the readings of the stretch up to each row. Where a row has no usable
        sinkage, or its load is static, the load is that of `rows`.
    """
    found: list[Stretches] = []
    load, load_std = rows.load.copy(), rows.load_std.copy()
    usable = np.isfinite(rows.sinkage) & np.isfinite(rows.load) & (rows.load > 0.0)
    for name in settings.covariates:
        usable &= np.isfinite(getattr(rows, name))
    for number, wheel in enumerate(settings.wheels):
        mine = np.flatnonzero((rows.wheel == number) & usable)
        if not mine.size:
            continue
        static = wheel.name in settings.static_loads
        own = _StretchRows.of(rows, mine)
        closed, calm, deviation = _of_wheel(state.wheels[number], own, settings, number)
        found += closed
        if not static:
            load[mine], load_std[mine] = calm, deviation
    if not found:
        return None, Loads(load, load_std)
    whole = Stretches.joined(found)
    return whole.take(np.lexsort((whole.wheel, whole.end))), Loads(load, load_std)


def _of_wheel(
    state: _Wheel, rows: _StretchRows, settings: OnboardSettings, number: int
) -> tuple[list[Stretches], Array, Array]:
    """Closed stretches of a wheel; loads of its new rows and their deviations, from the rows up to each."""
    wheel = settings.wheels[number]
    ahead = wheel.longitudinal_position
    before = state.open
    held = 0 if before is None else len(before)
    joined = rows if before is None else _StretchRows.joined([before, rows])
    path, onward, count = joined.path, joined.onward, len(joined)
    moved = np.concatenate([[False], path[1:] > path[:-1]])
    if wheel.contact != ROLLING:
        moved[:] = True
    log_load = np.log(joined.load)
    calm, deviation = np.empty((2, count))
    turns = np.flatnonzero(np.diff(onward))
    found: list[Stretches] = []
    start = 0
    while True:
        end = int(np.searchsorted(path, path[start] + state.length))
        turn = turns[np.searchsorted(turns, start)] + 1 if (turns >= start).any() else count
        stop = min(end, int(turn))
        part = slice(start, min(stop, count))
        moved[start] = True
        many = np.cumsum(moved[part]).astype(float)
        means = np.cumsum(np.where(moved[part], log_load[part], 0.0)) / many
        value, variance = state.calibrated(means, many)
        calm[part], deviation[part] = value, value * np.sqrt(variance)
        if stop >= count:
            break
        enough = state.length if stop == end else 0.5 * state.length
        if path[stop] - path[start] >= enough:
            chosen = np.flatnonzero(moved[part])[:_MOST_ROWS] + start
            if chosen.size:
                stretch = joined.take(chosen)
                found.append(
                    _close(state, number, stretch, log_load[chosen], joined.stamp[stop], ahead)
                )
        start = stop
    keep = moved[start:].copy()
    keep[:1] = keep[-1:] = True
    if wheel.contact != ROLLING and count - start > _MOST_ROWS:
        keep[_MOST_ROWS:-1] = False
    state.open = joined.take(start + np.flatnonzero(keep))
    return found, calm[held:], deviation[held:]


def _close(
    state: _Wheel, number: int, rows: _StretchRows, log_load: Array, end: int, ahead: float
) -> Stretches:
    """Average the rows of a stretch, after learning the wheel's noise and loads from them.

    number: of the wheel. end: stamp of the row that closes the stretch, ns. ahead: longitudinal position of
    the wheel, m.
    """
    sinkage, count = rows.sinkage, len(rows)
    _learn_noise(state, sinkage, log_load)
    middle = _median(sinkage)
    off = np.abs(sinkage - middle)
    kept = off <= _KEPT * (math.sqrt(state.reading_variance) + _median(off))
    in_mean = int(kept.sum())
    mean_log_load = _mean(log_load)
    _learn_loads(state, mean_log_load, count)
    load, load_variance = state.calibrated(np.array([mean_log_load]), np.array([float(count)]))
    onward = bool(rows.onward[-1])
    place = _mean(rows.distance) + (ahead if onward else -ahead)
    numbers = {
        "end": end, "wheel": number, "sinkage": _mean(sinkage[kept]),
        "variance": state.reading_variance / in_mean, "load": load[0],
        "load_variance": load_variance[0], "load_rate": _slope(rows.stamp, log_load),
        "slip": _known_mean(rows.slip), "speed": _known_mean(rows.speed), "pitch": _mean(rows.pitch),
        "distance": rows.distance[-1], "place": place, "passes": _known_mean(rows.passes),
        "pass_doubt": _known_mean(rows.pass_doubt), "onward": onward, "count": in_mean,
        "dropped": count - in_mean, "low": sinkage.min(), "high": sinkage.max(), "step": state.step,
    }  # fmt: skip
    return Stretches(**{name: np.array([value]) for name, value in numbers.items()})


def _learn_noise(state: _Wheel, sinkage: Array, log_load: Array) -> None:
    """Learn the variances of one reading of sinkage and of ln load, and the sensor's step."""
    apart = np.abs(np.diff(sinkage))
    state.step = min(state.step, float(np.min(apart, where=apart > 0.0, initial=math.inf)))
    if sinkage.size < 3:
        return
    weight = min(1.0, sinkage.size / (state.noise_readings + sinkage.size))
    noise = _noise(sinkage, state.reading_variance) - state.reading_variance
    state.load_noise += weight * (_noise(log_load, state.load_noise) - state.load_noise)
    # A sensor that shows whole steps, or always one number, is not without noise.
    state.reading_variance = max(state.reading_variance + weight * noise, 1e-10)
    state.noise_readings = min(state.noise_readings + sinkage.size, _NOISE_MEMORY)


def _learn_loads(state: _Wheel, mean: float, count: int) -> None:
    """Learn mean and variance of ln load between stretches, noise included, from a stretch's mean."""
    state.stretches += 1
    gain = max(1.0 / state.stretches, 1.0 / _LOAD_MEMORY)
    if state.stretches == 1:
        state.load_mean = mean
        state.load_spread += state.load_noise / count
        return
    off = mean - state.load_mean
    state.load_mean += gain * off
    state.load_spread += gain * ((1.0 - gain) * off * off - state.load_spread)


def _noise(values: Array, believed: float) -> float:
    """Variance of one reading from second differences, which are limited by the variance believed so far."""
    squares = np.diff(values, 2) ** 2 / _SECOND_DIFFERENCE
    return _mean(np.minimum(squares, _WORST_NOISE * believed)) / _CUT_MEAN


def _slope(stamp: Integers, values: Array) -> float:
    """Least-squares slope of values over time, 1/s; 0 for fewer than three. stamp: ns."""
    time = (stamp - stamp[0]) / SECOND
    centred = time - _mean(time)
    square = float(centred @ centred)
    return float(centred @ values) / square if time.size >= 3 and square > 0.0 else 0.0


def _mean(values: Array) -> float:
    """Mean of a short column, equal to NumPy's to the bit, without the time of its checks of types."""
    return float(np.add.reduce(values)) / values.size


def _median(values: Array) -> float:
    """Median of a short column without NaN, equal to NumPy's, but faster."""
    ordered = np.sort(values)
    return 0.5 * float(ordered[(ordered.size - 1) // 2] + ordered[ordered.size // 2])


def _known_mean(values: Array) -> float:
    known = values[np.isfinite(values)]
    return _mean(known) if known.size else math.nan
