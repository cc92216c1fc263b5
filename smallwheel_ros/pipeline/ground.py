# SPDX-License-Identifier: Apache-2.0
"""Speed over ground and what the imu feels, as real robots send them, and how far each is to be believed.

    speed     the twist's; while every twist is exactly 0, that of the pose over 0.5 s, or two periods, along
              the heading, in the middle of both
    spread    what the speed does while the rims turn evenly: (v(t) - 2 v(t - 1 s) + v(t - 2 s)) / sqrt 6, and
              the same of three messages in a row; the larger one. Of poses also by their stamps: how far one
              is from the line between its neighbours, over the rims' speed, is how much its stamp is off
    lag       by how much the turning and the speed follow gyro and rims: largest correlation, as last found;
              until anything follows, it may be half a second
    of wheels the way by odometry is a constant times that of the rims, to 0.005 of it: it shows no slip;
              until 5 m of way are there it may be, unless it is further off, or no constant near 1
    imu       turned over where its z axis looks down

Each row depends on messages up to its own stamp alone, and sums go on over cuts.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np

from smallwheel_ros.onboard.settings import (
    IMU,
    ODOMETRY,
    STANDSTILL_SPEED,
    VELOCITY,
    OnboardSettings,
)
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import GRAVITY

from .stream import NEVER, Stream
from .streams import Streams
from .tables import SECOND, Array, Flags, Integers, steps_of, unknown

SPEED, YAW_RATE, X, Y, COSINE, SINE, SPEED_VARIANCE, YAW_VARIANCE, PITCH, ROLL = range(10)
WINDOW = (
    SECOND // 2
)  # between the poses of a speed: places are known to some cm, so speeds to some cm/s
DOWN = 0.5 * GRAVITY  # more along z than on the steepest slope
_STEADY = 0.1  # of the rims' speed: what they may change by where speed shows its own spread
_PLACE = (
    0.05  # m: what one place of a lidar or of cameras is off by, as long as nothing else is learnt
)
_SCAN = 0.1  # s that a turn of a lidar takes: at which instant of it a place holds is not known
_APART = (
    SECOND  # between speeds whose errors are not the same any more, even of a smoothed odometry
)
_SMOOTH = (
    0.5  # and where places show theirs: gained in 2 s, it puts one 0.03 s off its neighbours' line
)
_TOLD, _GUESSED = 10, 3  # readings that the parameters' deviation, and `_SCAN`, count for
LAGS = np.arange(11) * (SECOND // 10)  # ns
_TURNS, _ALIKE, _BETTER = (
    0.1,
    0.8,
    1.1,
)  # rad/s; correlation; what a lag has to explain more than none
_VARIES = 1e-6  # of the mean square: a thousandth of the mean
_LATE = 0.5  # s that odometries of lidars, cameras and satellites come late by
_ENOUGH = 100  # speeds while turning, or driving, before a lag is looked for
OWN, _PIECE, PIECES = (
    0.005,
    0.5,
    10,
)  # of the way, m: the best odometries wander by so much (KITTI)
_FEW = 2  # pieces, of which a factor leaves something over
_KEPT = 100  # pieces: of 50 m one that drives steadily with an odometry of its own has hills and stones, too
_NORMAL = 1.4826  # deviation over the median of the sizes, of normal errors
_MOVES = 0.3  # of a piece: what of it has to be way, or turning, for a share of it to say anything
_RADII = (
    0.15  # what the radii that are told, and those that an odometry is made with, differ by at most
)


@dataclass(frozen=True)
class Known:
    """What has turned out of odometry and imu, for those that report it.

    share: of the way by which an odometry that is made of the wheels is no multiple of them; NaN: of its own.
    no_twist: m by the pose while no twist has come; NaN: one has. down: whether z of the imu looks down.
    """

    share: float = math.nan
    no_twist: float = 0.0
    down: bool = False

    @property
    def of_wheels(self) -> bool:
        """Whether the odometry is made of the wheels."""
        return math.isfinite(self.share)

    @property
    def twist(self) -> bool:
        """Whether a twist has come."""
        return math.isnan(self.no_twist)


@dataclass
class Trust:
    """What is known of the speed at each of some instants.

    variance: m^2/s^2; lag: s, how much later it comes than what the wheels do, or may come; of_wheels:
    whether it is made of them; may_be: whether it is not known yet to be, or not to be; since: s for which
    the message has been the same; way: m by the rims meanwhile.
    """

    variance: Array
    lag: Array
    of_wheels: Flags
    may_be: Flags
    since: Array
    way: Array
    mean: Array


@dataclass
class _Sums:
    """Running sums of what is learnt, and what they were at the end of the last piece of way."""

    spread: list[Array] = field(default_factory=lambda: [np.zeros(2) for _ in range(3)])
    lag: list[float] = field(default_factory=lambda: [math.nan, math.nan])
    speed: Array = field(default_factory=lambda: unknown(2))
    way: float = 0.0
    changed: int = NEVER
    changed_way: float = 0.0
    stamp: int = NEVER
    alike: list[Array] = field(default_factory=lambda: [np.zeros((6, LAGS.size)) for _ in range(2)])
    parts: Array = field(default_factory=lambda: np.zeros(4))
    last: Array = field(default_factory=lambda: np.zeros(4))
    pieces: list[Array] = field(default_factory=list)
    of_wheels: bool = False
    share: float = math.nan
    may_be: bool = True


class Ground:
    """Rows of speed and imu, and how far they are believed.

    moves: speed (m/s) and yaw rate (rad/s). felt: the imu's rows, z up. posed: whether speed is that of the
    pose.
    """

    def __init__(self, settings: OnboardSettings, streams: Streams) -> None:
        self.settings, self.streams = settings, streams
        self.source = VELOCITY if settings.velocity == "topic" else ODOMETRY
        self.moves, self.felt = Stream("moves", 2), Stream("felt", 7)
        self._own = Stream(
            "own", 6
        )  # of each message: ns back to its speed's stamp, speed, yaw rate, new, way without a twist, off
        self._trust = Stream("trust", 9)
        self.posed = True
        self._way = 0.0
        self._up = self._looks_down = 0
        self._turned = [NEVER]  # stamps at which the imu was turned over, and back
        self._sums = _Sums()

    def advance(self, until: int) -> None:
        """Take what came, and learn of it up to a stamp (ns) at which all is there."""
        self._turn_over()
        self._speeds()
        self._learn(until)

    def bound(self, until: int) -> int:
        """Stamp (ns) up to which speeds are there: those of poses are in the middle between two."""
        source = self.streams.all.get(self.source)
        if source is None or not self.posed or not source.received or self.streams.silent(source):
            return until
        return min(until, self.moves.newest)

    def forget(self, before: int) -> None:
        """Drop what nothing asks for any more."""
        for stream in (self.moves, self.felt, self._own, self._trust):
            stream.forget(before)

    def trust(self, instants: Integers) -> Trust:
        """How far the speed is believed at instants up to which has been learnt."""
        stamps, (variance, lag, of_wheels, may_be, since, way, mean, *_) = self._last(instants)
        seconds = np.where(stamps == NEVER, 0.0, (instants - stamps) / SECOND)
        usual = np.where(np.isnan(variance), self.settings.noise.speed**2, variance)
        return Trust(
            usual,
            np.where(np.isnan(lag), _LATE, lag),
            of_wheels > 0.0,
            (may_be != 0.0) & (self.source == ODOMETRY),
            np.nan_to_num(since) + seconds,
            np.nan_to_num(way),
            np.nan_to_num(mean),
        )

    def known(self, stamp: int) -> Known:
        """What has turned out up to a stamp (ns) up to which has been learnt."""
        down = bisect_right(self._turned, stamp) % 2 == 0
        stamps, values = self._last(np.array([stamp], dtype=np.int64))
        if stamps[0] == NEVER:
            return Known(down=down)
        of_wheels, no_twist, share = values[[2, 7, 8], 0].tolist()
        return Known(share if of_wheels else math.nan, no_twist, down)

    def _last(self, instants: Integers) -> tuple[Integers, Array]:
        stamps, values = self._trust.last(instants)
        return stamps, values.T

    def rims(self, instants: Integers) -> tuple[Array, Array, Array]:
        """Speeds (m/s) of the rims: mean of all, mean size, and half of right less left."""
        wheels = [
            (wheel, self.streams.all[f"{wheel.name}/wheel_speed"])
            for wheel in self.settings.wheels
            if wheel.contact == ROLLING
        ]
        if not wheels:
            return unknown(instants.size), unknown(instants.size), unknown(instants.size)
        rims = np.stack(
            [s.at(instants, self.streams.rules)[:, 0] * w.diameter / 2.0 for w, s in wheels]
        )
        side = np.array([wheel.lateral_position for wheel, _ in wheels])
        turn = unknown(instants.size)
        if (side > 0.0).any() and (side < 0.0).any():
            turn = 0.5 * (rims[side < 0.0].mean(axis=0) - rims[side > 0.0].mean(axis=0))
        return rims.mean(axis=0), np.abs(rims).mean(axis=0), turn

    # --- What came

    def _turn_over(self) -> None:
        """Give the imu's rows with z up: most of those so far say where down is."""
        stream = self.streams.all.get(IMU)
        if stream is None or stream.newest <= self.felt.newest:
            return
        stamps, values = stream.between(self.felt.newest, stream.newest)
        # Gravity is felt; a driver without it in its acceleration may have it in the orientation.
        felt, told = values[:, 3], GRAVITY * values[:, 6]
        along = np.where(np.abs(felt) > DOWN, felt, told)
        up = self._up + np.cumsum(along > DOWN)
        looks_down = self._looks_down + np.cumsum(along < -DOWN)
        self._up, self._looks_down = int(up[-1]), int(looks_down[-1])
        over = looks_down > up
        before = np.concatenate([[len(self._turned) % 2 == 0], over[:-1]])
        self._turned += stamps[over != before].tolist()
        sign = np.array([-1.0, 1.0, -1.0, -1.0, 1.0, -1.0, -1.0])  # about x: y, z and yaw change
        turned = np.repeat(over[:, None], sign.size, axis=1)
        turned[:, 4:] &= told[:, None] < 0.0  # an orientation may be that of the vehicle already
        self.felt.extend(stamps, np.where(turned, sign * values, values))

    def _speeds(self) -> None:
        """Give the rows of speed and yaw rate."""
        stream = self.streams.all.get(self.source)
        if stream is None or stream.newest <= self._own.newest:
            return
        all_stamps, all_values = stream.stamps, stream.values
        first = int(np.searchsorted(all_stamps, self._own.newest, side="right"))
        stamps, values = all_stamps[first:], all_values[first:]
        same = (values == all_values[np.arange(first, all_stamps.size) - 1]) | np.isnan(values)
        new = ~same.all(axis=1)
        new[0] |= first == 0
        back: Array = np.zeros(stamps.size)
        speed, turn = values[:, SPEED], values[:, YAW_RATE]
        way, off = unknown(stamps.size), unknown(stamps.size)
        if self.source == ODOMETRY and self.posed:
            twist = np.logical_or.accumulate((speed != 0.0) | (turn != 0.0))
            posed = ~twist
            rules, rows = self.streams.rules, np.arange(all_stamps.size)
            longest = np.maximum(stream.gaps(all_stamps, rules), rules.silence - rules.reorder)
            apart = np.diff(all_stamps) > longest[:-1]  # it may have been silent meanwhile
            begin = np.maximum.accumulate(np.where(np.concatenate([[True], apart]), rows, 0))
            window = np.maximum(WINDOW, 2 * stream.periods(all_stamps)[first:])
            before = np.searchsorted(all_stamps, stamps - window, side="right") - 1
            before = np.maximum(before, begin[first:])
            now, then = values, all_values[before]
            span = stamps - all_stamps[before]
            near = (span >= WINDOW) & (span <= 2 * rules.widest)
            seconds = np.where(near, span, 1) / SECOND
            ahead, aside = now[:, COSINE] + then[:, COSINE], now[:, SINE] + then[:, SINE]
            length = np.hypot(ahead, aside)
            with np.errstate(invalid="ignore", divide="ignore"):
                along = (now[:, X] - then[:, X]) * ahead + (now[:, Y] - then[:, Y]) * aside
                along = along / length / seconds
            speeds = np.where(near, along, np.nan)
            cross = then[:, COSINE] * now[:, SINE] - then[:, SINE] * now[:, COSINE]
            dot = then[:, COSINE] * now[:, COSINE] + then[:, SINE] * now[:, SINE]
            turned = np.arctan2(cross, dot) / seconds
            speed = np.where(posed, speeds, speed)
            turn = np.where(posed, np.where(near, turned, np.nan), turn)
            back = np.where(posed, (span // 2).astype(float), 0.0)
            places = all_values[np.maximum(rows[first:] - 1, 0)][:, [X, Y]]
            steps = np.nan_to_num(np.hypot(*(values[:, [X, Y]] - places).T))
            way = np.where(posed, steps_of(steps, self._way), np.nan)
            self._way = float(way[-1])
            self.posed = bool(posed[-1])
            off = np.where(
                posed, _off_line(all_stamps, all_values, begin, rules.widest)[first:], off
            )
        self._own.extend(stamps, np.column_stack([back, speed, turn, new, way, off]))
        middle = stamps - back.astype(np.int64)
        # Also what is not known is a row: nothing is interpolated over it, whenever it is looked at.
        before_it = np.concatenate([[self.moves.newest], middle[:-1]])
        rising = middle > np.maximum.accumulate(before_it)
        self.moves.extend(middle[rising], np.column_stack([speed, turn])[rising])

    # --- What is learnt

    def _learn(self, until: int) -> None:
        after = max(self._trust.newest, NEVER)
        stamps, own = self._own.between(after, until)
        if not stamps.size:
            return
        sums = self._sums
        back, speed, turn, new, no_twist, off = own.T
        middle = stamps - back.astype(np.int64)
        back_to = np.array([*LAGS, _APART, 2 * _APART])
        mean, size, half_turn = (
            each.reshape(middle.size, -1) for each in self.rims((middle[:, None] - back_to).ravel())
        )
        before = np.concatenate([[sums.stamp], stamps[:-1]])
        passed = np.where(stamps - before > WINDOW, 0, stamps - before) / SECOND
        sums.stamp = int(stamps[-1])
        step = np.nan_to_num(size[:, 0]) * passed
        way = steps_of(step, sums.way)
        ways_before = np.concatenate([[sums.way], way[:-1]])
        sums.way = float(way[-1])
        # Since when the message has been the same, and the way of the rims meanwhile.
        is_new = new > 0.0
        changed = np.maximum.accumulate(np.where(is_new, stamps, NEVER))
        changed = np.maximum(changed, sums.changed)
        changed_way = np.maximum.accumulate(np.where(is_new, way, -1.0))
        changed_way = np.maximum(changed_way, sums.changed_way)
        sums.changed, sums.changed_way = int(changed[-1]), float(changed_way[-1])
        variance = self._spread(middle, back, speed, off, mean[:, [0, -2, -1]])
        lag = self._lag(middle, speed, turn, mean[:, : LAGS.size])
        parts = np.column_stack([mean[:, 0], speed, half_turn[:, 0], turn])
        parts = np.nan_to_num(parts) * passed[:, None]
        made, may_be, share = self._made_of_wheels(ways_before, way, parts)
        since = (stamps - changed) / SECOND
        same = since, way - changed_way
        rows = [variance, lag, made, may_be, *same, back / SECOND, no_twist, share]
        self._trust.extend(stamps, np.column_stack(rows))

    def _spread(
        self, middle: Integers, back: Array, speed: Array, off: Array, rims: Array
    ) -> Array:
        """Variance of a speed, by what it does while the rims turn evenly; of neighbours too.

        off: m, of a place from the line between its neighbours, as `_off_line` has it. rims: their mean
        speed then, `_APART` and twice that before, (rows, 3).
        """
        sums, rules = self._sums, self.streams.rules
        apart = [self.moves.at(middle - k * _APART, rules)[:, 0] for k in (1, 2)]
        with np.errstate(invalid="ignore"):
            most = np.abs(rims).max(axis=1)
            change = np.where(most > STANDSTILL_SPEED, np.ptp(rims, axis=1) / most, np.nan)
        before = np.concatenate([sums.speed, speed])
        sums.speed = before[-2:]
        bends = speed - 2.0 * apart[0] + apart[1], speed - 2.0 * before[1:-1] + before[:-2]
        told: Array = np.full(back.size, self.settings.noise.speed**2)
        with np.errstate(invalid="ignore", divide="ignore"):
            late2 = (off**2 - _PLACE**2) / rims[:, 0] ** 2
        good = (change < _SMOOTH) & np.isfinite(off)
        late2 = np.maximum(self._mean(2, good, late2, _SCAN**2, _GUESSED), _SCAN**2)
        place = np.sqrt(_PLACE**2 + late2 * np.nan_to_num(speed) ** 2)
        posed = 2.0 * (place * SECOND / np.maximum(2.0 * back, WINDOW)) ** 2
        told = np.where(back > 0.0, np.maximum(told, posed), told)
        found = told
        for i, bend in enumerate(bends):
            good = (change < _STEADY) & np.isfinite(bend)
            found = np.maximum(found, self._mean(i, good, bend**2 / 6.0, told, _TOLD))
        return np.asarray(found)

    def _mean(
        self, i: int, good: Flags, squares: Array, before: Array | float, count: int
    ) -> Array:
        """Mean of the good squares so far, in which what was before counts for `count` of them."""
        rows = np.column_stack([good, np.where(good, squares, 0.0)])
        total = np.cumsum(np.concatenate([self._sums.spread[i][None], rows]), axis=0)[1:]
        self._sums.spread[i] = total[-1]
        return np.asarray((count * before + total[:, 1]) / (count + total[:, 0]))

    def _lag(self, middle: Integers, speed: Array, turn: Array, rims: Array) -> Array:
        """How much later (s) the speed comes than gyro and rims, the larger one, or may come.

        What has been found stays when nothing follows any more: on ground that gives way a speed does not
        follow the rims, and comes no later for it.

        rims: their mean speed `LAGS` before, (rows, lags).
        """
        count = middle.size
        instants = (middle[:, None] - LAGS).ravel()
        gyro = self.felt.at(instants, self.streams.rules)[:, 0].reshape(count, -1)
        found = unknown(count)
        for i, (late, early) in enumerate(((turn, gyro), (speed, rims))):
            good = np.isfinite(late) & np.isfinite(early).all(axis=1)
            good &= (np.abs(early) > _TURNS).any(axis=1)
            y, x = np.where(good, late, 0.0)[:, None], np.where(good[:, None], early, 0.0)
            ones = np.broadcast_to(good[:, None].astype(float), x.shape)
            rows = np.stack(
                [ones, x, np.broadcast_to(y, x.shape), x * x, y * y + 0.0 * x, x * y], 1
            )
            total = np.cumsum(np.concatenate([self._sums.alike[i][None], rows]), axis=0)[1:]
            self._sums.alike[i] = total[-1]
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
            lag = np.concatenate([[self._sums.lag[i]], lag])
            newest = np.maximum.accumulate(np.where(np.isnan(lag), 0, np.arange(lag.size)))
            self._sums.lag[i] = float(lag[newest[-1]])
            found = np.fmax(found, lag[newest[1:]])
        return np.where(np.isnan(found), _LATE, found)

    def _made_of_wheels(
        self, before: Array, way: Array, parts: Array
    ) -> tuple[Flags, Flags, Array]:
        """Whether the last pieces of way are those of the rims, or in turning; may be; by how much not."""
        sums = self._sums
        if self.source != ODOMETRY:
            no = np.zeros(way.size, dtype=bool)
            return no, no, unknown(way.size)
        total = np.cumsum(np.concatenate([sums.parts[None], parts]), axis=0)[1:]
        found, may_be = np.empty((2, way.size), dtype=bool)
        share: Array = np.empty(way.size)
        ends = np.flatnonzero(np.floor(way / _PIECE) > np.floor(before / _PIECE))
        begin = 0
        for end in ends.tolist():
            found[begin:end], may_be[begin:end] = sums.of_wheels, sums.may_be
            share[begin:end] = sums.share
            sums.pieces = [*sums.pieces[1 - _KEPT :], total[end] - sums.last]
            sums.last, begin = total[end], end
            off, whole = _scatter(np.array(sums.pieces)), len(sums.pieces) >= PIECES
            rims, moves = total[end, :2]
            near = abs(moves - rims) <= _RADII * max(abs(rims), _PIECE)
            sums.may_be = not whole and near and (off < OWN or len(sums.pieces) < _FEW)
            sums.share = off
            if whole:
                sums.of_wheels = off < (2.0 * OWN if sums.of_wheels else OWN)
        found[begin:], may_be[begin:] = sums.of_wheels, sums.may_be
        share[begin:] = sums.share
        sums.parts = total[-1]
        return found, may_be, share


def _off_line(stamps: Integers, values: Array, begin: Integers, widest: int) -> Array:
    """By how much (m) the pose before each is off the line between its neighbours, as one place is, or NaN.

    Along its heading, where time is way. begin: of each row, the first behind a silence. widest: ns.
    """
    rows = np.arange(stamps.size)
    now, middle, then = rows, np.maximum(rows - 1, 0), np.maximum(rows - 2, 0)
    span = stamps[now] - stamps[then]
    good = (rows - 2 >= begin) & (span > 0) & (span <= 2 * widest)
    part = (stamps[middle] - stamps[then]) / np.where(good, span, 1)
    x, y = (
        values[middle, k] - part * values[now, k] - (1.0 - part) * values[then, k] for k in (X, Y)
    )
    along = x * values[middle, COSINE] + y * values[middle, SINE]
    return np.where(good, along / np.sqrt(1.0 + part**2 + (1.0 - part) ** 2), np.nan)


def _scatter(pieces: Array) -> float:
    """By which share of the way the odometry is no multiple of the rims: straight on, or in turns.

    That of the last pieces, or what is usual of all that are kept, whichever is larger: made of the wheels it
    is their multiple all the time, and an odometry of its own may be for some metres.
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
            usual = float(np.median(shares))
            spread = _NORMAL * float(np.median(np.abs(shares - usual)))
            off = max(off, spread / max(abs(usual), 1e-9))
        found = min(found, float(off))
    return found
