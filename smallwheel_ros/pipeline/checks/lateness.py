# SPDX-License-Identifier: Apache-2.0
"""Delay of an odometry after gyro and rims, and whether it is computed from the wheels.

An odometry may also run against the rims, where it or the joints have the wrong sign. All sums are carried
from block to block: a result depends only on the rows before it.
"""

from __future__ import annotations

import math

import numpy as np

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.onboard.settings import SLOWEST_RIM
from smallwheel_ros.pipeline.tables import Array, Flags

from .sums import robust

LATE = 0.5  # s: largest usual delay of odometries by lidar, camera or satellite
MOVES = 0.1  # m/s: under it odometries and counters are noise (GNSS 0.05 to 0.1)
# Share of the path over which a joint of the wrong sign turns against the travel; the rest is what a delay of
# 0.5 s at 1 m/s may take.
SIGN_SHARE = 0.8
_BENDS = 0.5  # of the rims' mean: with a smaller half difference all of them surely go one way
_START = 0.05  # m: what noise of a speed and its delay add up to in a start
# Sine of a slope from which a vehicle may slide back on wheels that drive: the resistance of soft ground
# alone holds 0.05 to 0.1 of its weight.
_SLIDES = 0.09
_LEAST_ALIKE = 0.75  # of the rims' way: what an odometry that looks back shows of it on soft ground
_LONGEST = 5.0  # m, over which no vehicle slides as fast as its wheels drive
# s from the first turn of the rims, in which the imu shows the direction in which the vehicle goes: a start
# takes one or two, and over longer times slopes and zeros add up to a speed that is not there.
_START_S = 2.0
# Share of the odometry's change of speed that the imu feels: 1 for a good odometry, -1 for one that looks
# backward, 0 decides nothing.
_FELT = 0.5
LAGS = np.arange(11) * (SECOND // 10)  # ns
_TURNS, _ALIKE, _BETTER = (
    0.1,
    0.8,
    1.1,
)  # rad/s; correlation; what a lag has to explain more than none
_VARIES = 1e-6  # of the mean square: a thousandth of the mean
_ENOUGH = 100  # speeds while turning, or driving, before a lag is looked for
# Share of the path by which the best independent odometries wander (KITTI); over ten pieces they wander by
# 0.4 of that once in 250. Odometries of real robots that are computed from the wheels are multiples of their
# path to 0.00001.
_OWN, MADE = 0.005, 0.002
_PIECE, PIECES = 0.5, 10  # m, and number of pieces that decide
_FEW = 2  # pieces: the residual about a fitted factor says nothing for fewer
_KEPT = 100  # pieces, 50 m: in these a steady drive with an independent odometry has hills and stones, too
_MOVES = 0.3  # of a piece's length: with less path, or turn, its residual says nothing
_RADII = (
    0.15  # largest relative difference of the configured radii from those that an odometry assumes
)


class Lag:
    """Estimates the delay of a speed after the motion that it shows, as the lag of largest correlation."""

    def __init__(self) -> None:
        self._sums, self._found = np.zeros((6, LAGS.size)), math.nan

    def take(self, late: Array, early: Array) -> Array:
        """Estimate the lag of the speed at each row.

        Where the speed no longer follows the rims the last lag is kept: on ground that gives way the speed
        departs from the rims without being any later.

        Parameters
        ----------
        late
            Speed, or yaw rate, that may come late, shape (rows,), m/s or rad/s; NaN if unknown.
        early
            The motion that it may follow, at each of `LAGS` before each row, shape (rows, lags), same unit.

        Returns
        -------
        ndarray
            Shape (rows,), s, one of `LAGS`; NaN until the speed has followed the motion once.
        """
        good = np.isfinite(late) & np.isfinite(early).all(axis=1)
        good &= (np.abs(early) > _TURNS).any(axis=1)
        y, x = np.where(good, late, 0.0)[:, None], np.where(good[:, None], early, 0.0)
        ones = np.broadcast_to(good[:, None].astype(float), x.shape)
        rows = np.stack([ones, x, np.broadcast_to(y, x.shape), x * x, y * y + 0.0 * x, x * y], 1)
        total = _onward(self._sums, rows)
        self._sums = total[-1]
        n, sx, sy, xx, yy, xy = np.moveaxis(total, 1, 0)
        with np.errstate(invalid="ignore", divide="ignore"):
            covariance = xy - sx * sy / n
            own, other = xx - sx * sx / n, yy - sy * sy / n
            square = covariance**2 / (own * other)
        # What hardly changes follows nothing, and its variance is what rounding leaves.
        varies = (own > _VARIES * xx) & (other > _VARIES * yy) & (covariance > 0.0)
        square = np.where(varies, square, 0.0)
        best = square.argmax(axis=1)
        most = square.max(axis=1)
        told = (n[:, 0] >= _ENOUGH) & (most > _ALIKE**2)
        better = 1.0 - square[:, 0] > _BETTER * (1.0 - most)
        lag = np.where(told, np.where(better, LAGS[best] / SECOND, 0.0), np.nan)
        lag = np.concatenate([[self._found], lag])
        newest = np.maximum.accumulate(np.where(np.isnan(lag), 0, np.arange(lag.size)))
        self._found = float(lag[newest[-1]])
        return np.asarray(lag[newest[1:]])


class OfWheels:
    """Judges whether an odometry is computed from the wheels: then its path is a constant multiple of theirs.

    Path is compared in pieces of half a metre of the rims.
    """

    def __init__(self) -> None:
        self._total, self._last = np.zeros((2, 4))
        self._pieces: list[Array] = []
        self._made, self._may_be, self._share = False, True, math.nan

    def take(self, before: Array, way: Array, parts: Array) -> tuple[Flags, Flags, Array]:
        """Judge at each row whether the odometry is computed from the wheels.

        Parameters
        ----------
        before, way
            Path of the rims since the start of the drive, up to the row before each row, and up to the row
            itself, shape (rows,), m.
        parts
            Motion from the row before to each row, shape (rows, 4): path by the rims and by the odometry (m),
            turn by the rims (half of right minus left, m) and by the odometry (rad).

        Returns
        -------
        made : ndarray
            Shape (rows,), bool: whether it is computed from the wheels. False until ten pieces of path, of
            half a metre each, are complete.
        may_be : ndarray
            Shape (rows,), bool: True as long as there are fewer than ten pieces and these do not rule it out.
        share : ndarray
            Shape (rows,), 1: residual of the odometry's motion in the pieces about a constant multiple of
            that of the rims, relative to its size; the smaller of those of path and turn. NaN before the
            first piece is complete, infinite where the motion is too small to tell.
        """
        total = _onward(self._total, parts)
        found, may_be = np.empty((2, way.size), dtype=bool)
        share: Array = np.empty(way.size)
        ends = np.flatnonzero(np.floor(way / _PIECE) > np.floor(before / _PIECE))
        begin = 0
        for end in ends.tolist():
            found[begin:end], may_be[begin:end] = self._made, self._may_be
            share[begin:end] = self._share
            self._pieces = [*self._pieces[1 - _KEPT :], total[end] - self._last]
            self._last, begin = total[end], end
            off, whole = _scatter(np.array(self._pieces)), len(self._pieces) >= PIECES
            rims, moves = total[end, :2]
            near = abs(moves - rims) <= _RADII * max(abs(rims), _PIECE)
            self._may_be = not whole and near and (off < _OWN or len(self._pieces) < _FEW)
            self._share = off
            if whole:
                self._made = off < (_OWN if self._made else MADE)
        found[begin:], may_be[begin:] = self._made, self._may_be
        share[begin:] = self._share
        self._total = total[-1]
        return found, may_be, share


class Against:
    """Judges whether nearly all of the path so far runs against the rims, and whether it may be a slide back.

    Where the speed is backward while the rims drive ahead, either the speed or the joints have the wrong
    sign, or the vehicle slides down a slope while its wheels drive up. If the vehicle stood before, its imu
    feels in which direction it starts. Otherwise the slope along the path decides: no vehicle slides uphill
    or on level ground. Without a slope, a speed of the wrong sign is recognised by its magnitude, which,
    apart from its delay, equals that of the rims: a slide that is just as fast cannot be distinguished from
    it.
    """

    def __init__(self) -> None:
        self._total, self._start = np.zeros(5), _Start()

    def take(
        self, rims: Array, turn: Array, speed: Array, passed: Array, rise: Array, felt: Array
    ) -> tuple[Array, Flags]:
        """Compute the distance driven against the rims up to each row, and whether it may have been a slide.

        Parameters
        ----------
        rims
            Mean speed of the rims, shape (rows,), m/s.
        turn
            Half the difference of right and left rims, shape (rows,), m/s; NaN where one side has no wheels.
            Rows on which it is half the mean speed or more, as on a tight turn, are not judged.
        speed
            Speed over ground, shape (rows,), m/s.
        passed
            Time for which each row counts, shape (rows,), s.
        rise
            Sine of the slope, nose up, shape (rows,); NaN if unknown.
        felt
            Specific force ahead by the imu, less the part of gravity that its orientation implies (nothing
            without an orientation), shape (rows,), m/s^2; NaN if unknown.

        Returns
        -------
        against : ndarray
            Shape (rows,), m; 0 where it is not nearly all of the path, or may be a slide.
        slides : ndarray
            Shape (rows,), bool: whether it is nearly all of the path and may be a slide.
        """
        with np.errstate(invalid="ignore"):
            moves = np.minimum(np.abs(rims), np.abs(speed)) > MOVES
            moves &= ~(np.abs(turn) >= _BENDS * np.abs(rims))
            goes = np.where(moves, np.abs(speed) * passed, 0.0)
            against = np.where(rims * speed < 0.0, goes, 0.0)
            turned = np.where(against > 0.0, np.abs(rims) * passed, 0.0)
            climbs = np.where(against > 0.0, np.sign(rims) * rise * goes, 0.0)
        known = np.where(np.isfinite(climbs), against, 0.0)
        ways = np.column_stack([goes, against, turned, known, np.nan_to_num(climbs)])
        total = _onward(self._total, ways)
        self._total = total[-1]
        way, against, turned, known, climbed = total.T
        nearly_all = (against > _START) & (against > SIGN_SHARE * way)
        behind = LATE * np.nan_to_num(np.abs(rims))
        alike = (against + behind > _LEAST_ALIKE * turned) & (
            _LEAST_ALIKE * against < turned + behind
        )
        steep = climbed > _SLIDES * known
        by_way = np.where(known > 0.0, steep & ~(alike & (against > _LONGEST)), ~alike)
        feels, waits = self._start.take(rims, speed, passed, felt)
        slides = (feels > _FELT) | (by_way & ~waits & ~(feels < -_FELT))
        return np.where(nearly_all & ~slides, against, 0.0), np.asarray(nearly_all & slides)


class _Start:
    """Estimates which share of the odometry's change of speed the imu feels in the vehicle's first start."""

    def __init__(self) -> None:
        self._drives, self._stood = False, np.zeros(3)
        self._changed, self._shares = np.zeros(2), np.zeros(2)

    def take(self, rims: Array, speed: Array, passed: Array, felt: Array) -> tuple[Array, Flags]:
        """Estimate the share that is felt, from the rows up to each row.

        Parameters
        ----------
        rims, speed, passed, felt
            As in `Against.take`, shape (rows,).

        Returns
        -------
        feels : ndarray
            Shape (rows,): 1 for a speed of the right sign, -1 for one of the wrong sign, 0 if unknown.
        waits : ndarray
            Shape (rows,), bool: whether the start has not ended yet, so that it may be known later.
        """
        good = np.isfinite(rims + speed + felt)
        dt = np.where(good, passed, 0.0)
        drives = np.append(self._drives, np.abs(rims) > SLOWEST_RIM)
        stands = ~np.logical_or.accumulate(drives)[1:]
        shown, pushed = (np.where(good, each, 0.0) for each in (speed, felt))
        of_stand = np.where(stands, dt, 0.0)[:, None] * np.column_stack([good, shown, pushed])
        stood = _onward(self._stood, of_stand)
        zero = stood[:, 1:] / np.maximum(stood[:, :1], LATE)
        pace = np.where(stands, 0.0, dt)
        gains = np.column_stack([pace, pace * (pushed - zero[:, 1])])
        changed = _onward(self._changed, gains)
        lasts, gained = changed.T
        change = shown - zero[:, 0]
        pace = np.where(lasts <= _START_S, pace, 0.0)
        products = np.column_stack([gained * change, change**2]) * pace[:, None]
        shares = _onward(self._shares, products)
        both, own = shares.T
        self._drives, self._stood = not stands[-1], stood[-1]
        self._changed, self._shares = changed[-1], shares[-1]
        # A speed over the odometries' noise, for as long as they come late.
        enough = (stood[:, 0] >= LATE) & (own > LATE * MOVES**2)
        feels = np.where(enough, both / np.where(enough, own, 1.0), 0.0)
        waits = good & (stood[:, 0] >= LATE) & (lasts < _START_S) & (np.abs(feels) <= _FELT)
        return feels, waits


def _onward(before: Array, rows: Array) -> Array:
    """Running sums of `rows` along the first axis, in the same shape, plus `before` (shape of one row)."""
    return np.cumsum(np.concatenate([before[None], rows]), axis=0)[1:]


def _scatter(pieces: Array) -> float:
    """Smaller of the relative residuals of path and turn about a constant multiple of those of the rims.

    The residual of each is the larger of the rms over the last `PIECES` and the spread over all pieces: an
    odometry computed from the wheels is a multiple of theirs all the time, an independent one may be for some
    metres.
    pieces: (pieces, 4), columns as in `OfWheels.take`. Infinite where both motions are too small.
    """
    found = np.inf
    for rims, moves in ((pieces[:, 0], pieces[:, 1]), (pieces[:, 2], pieces[:, 3])):
        last, gone = rims[-PIECES:], moves[-PIECES:]
        mean = np.abs(last).mean()
        if not mean > _MOVES * _PIECE or not gone.any():
            continue
        factor = float(last @ gone) / float(last @ last)
        off = np.sqrt(np.mean((gone - factor * last) ** 2)) / max(abs(factor), 1e-9) / mean
        if len(pieces) > PIECES:
            moved = np.abs(rims) > _MOVES * _PIECE
            shares = moves[moved] / rims[moved]
            usual, spread = robust(shares)
            off = max(off, spread / max(abs(usual), 1e-9))
        found = min(found, float(off))
    return found
