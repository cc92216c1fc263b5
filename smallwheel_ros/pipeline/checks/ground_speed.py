# SPDX-License-Identifier: Apache-2.0
"""Ground speed and imu samples of real robots, and what is learnt of their accuracy, lag and independence.

    speed     the twist's. While every twist is exactly 0: the speed of the pose along the heading over
              0.5 s, or over two periods, at the middle of that time
    spread    of the speed while the rims turn evenly: (v(t) - 2 v(t - 1 s) + v(t - 2 s)) / sqrt 6, and the
              same over three consecutive messages, relative to sqrt(v^2 + 1), since errors of stamps matter
              more the faster a vehicle drives. The larger of the two, at the size that 0.8 of them keep to.
              For poses also the error of the stamp: distance of a pose from the line between its
              neighbours, over the rims' speed
    lag       the delay at which turning and speed correlate best with gyro and rims, the newest one found;
              until one is found it may be half a second
    of wheels the odometry's way is a constant multiple of the rims', to 0.005: it shows no slip. For the
              first 5 m it may be one, unless it departs by more, or the constant is not near 1
    against   nearly all of the way so far runs against the rims: either the odometry or the joints look
              backward, and which is unknown. Not where the vehicle may slide down a slope: then the
              speed is believed
    unfelt    a change of the speed that the imu does not feel (`unfelt.py`): the speed is unknown until it
              does, or for some seconds
    imu       turned over where its z axis points down

Each value depends only on messages up to its own stamp; sums are carried from block to block.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from smallwheel_ros.common.stamps import NEVER, SECOND
from smallwheel_ros.onboard.settings import (
    IMU,
    ODOMETRY,
    STANDSTILL_SPEED,
    VELOCITY,
    OnboardSettings,
)
from smallwheel_ros.pipeline.intake.buffer import Samples, Stream
from smallwheel_ros.pipeline.intake.layout import rules_of
from smallwheel_ros.pipeline.tables import Array, Flags, Integers, steps_of, unknown

from .believed import (
    AGAINST,
    FELT,
    INERTIAL,
    MOVES,
    NO_ROWS,
    SLIDES,
    UNFELT,
    BelievedRows,
    RawRows,
    mean_of_known,
)
from .doubts import Doubts
from .lateness import LAGS, LATE, Against, Lag, OfWheels
from .sums import RunningDeviation
from .unfelt import InertialSpeed, Unfelt
from .window import Known

SPEED, YAW_RATE, X, Y, COSINE, SINE, SPEED_VARIANCE, YAW_VARIANCE, PITCH, ROLL, ASIDE = range(11)
WINDOW = (
    SECOND // 2
)  # between the poses of a speed: places are known to some cm, so speeds to some cm/s
DOWN = 0.5  # of g: more along z than on the steepest slope
_STEADY = 0.1  # of the rims' speed: where they change by less, changes of the speed are its error
_PLACE = (
    0.05  # m: error of one pose by a lidar or by cameras, as long as nothing else has been learnt
)
_SCAN = 0.1  # s that a turn of a lidar takes: at which instant of it a pose holds is unknown
_APART = (
    SECOND  # between speeds whose errors are not the same any more, even of a smoothed odometry
)
_SLOW = 1.0  # m/s, under which a speed's error hardly depends on it: robots drove with 0.1 to 4 m/s
_SMOOTH = (
    0.5  # the same where poses show theirs: gained in 2 s, it puts one 0.03 s off the others' line
)
_NEAR = 6  # lags of 0.1 s that three messages in a row span, of an odometry of 4 Hz and more
_GUESSED = 3  # readings that `_UNTRIED` and `_SCAN` count for
_UNTRIED = (
    0.1  # m/s at rest, as a share like `_SLOW`: six odometries of real robots had 0.04 to 0.2
)


@dataclass
class _Sums:
    """Sums and last values that are carried from block to block.

    Attributes
    ----------
    quick, lasting
        Errors of the speed over three consecutive messages, and over 2 s.
    late
        Count and sum (s^2) of squared stamp errors of poses.
    speed
        Speeds of the last two messages, m/s.
    way
        Path of the rims, m.
    changed, changed_way
        Stamp (ns) of the last message that differed from the one before it, and the path (m) then.
    stamp
        Stamp of the last message, ns.
    """

    quick: RunningDeviation = field(default_factory=lambda: RunningDeviation(_GUESSED))
    lasting: RunningDeviation = field(default_factory=lambda: RunningDeviation(_GUESSED))
    late: Array = field(default_factory=lambda: np.zeros(2))
    speed: Array = field(default_factory=lambda: unknown(2))
    way: float = 0.0
    changed: int = NEVER
    changed_way: float = 0.0
    stamp: int = NEVER


class GroundSpeed:
    """Ground speed and imu samples, with what has been learnt of their accuracy, lag and independence.

    Parameters
    ----------
    settings
        Settings of the vehicle.
    doubts
        Doubts of the checks, which are respected as they are added; None: there are none.

    Attributes
    ----------
    source
        Name of the stream that gives the speed over ground.
    moves
        Speed (m/s), yaw rate (rad/s), sideways speed (m/s; 0 for a vehicle that does not steer), (rows, 3).
    felt
        Rows of the imu as in `BelievedRows.felt`.
    posed
        Whether the speed is computed from the pose, since every twist so far was 0.
    """

    def __init__(self, settings: OnboardSettings, doubts: Doubts | None = None) -> None:
        self.settings, self.rules = settings, rules_of(settings)
        self.doubts = Doubts() if doubts is None else doubts
        self.source = VELOCITY if settings.velocity == "topic" else ODOMETRY
        self._raw: Mapping[str, Samples] = {}
        self.moves, self.felt = Stream("moves", 3), Stream("felt", 9)
        self._own = Stream(
            "own", 6
        )  # of each message: ns back to its speed's stamp, speed, yaw rate, new, way without a twist, off
        self._trust = Stream("trust", 12)
        self.posed = True
        self._told_aside = False  # whether a twist has ever had a speed aside
        self._way = 0.0
        self._up = self._looks_down = 0
        self._turned = [NEVER]  # stamps at which the imu was turned over, and back
        self._sums = _Sums()
        self._turns_late, self._speed_late, self._of_wheels = Lag(), Lag(), OfWheels()
        self._of_unsteered, self._goes_against = OfWheels(), Against()
        self._inertial, self._unfelt = InertialSpeed(settings.gravity), Unfelt(settings.gravity)

    def take(self, raw: Mapping[str, Samples], since: int) -> None:
        """Compute speeds and upright imu rows from the raw rows that are new.

        Parameters
        ----------
        raw
            All raw rows that are kept, by stream.
        since
            Stamp before which computed rows are no longer needed, ns.
        """
        for stream in (self.moves, self.felt, self._own, self._trust):
            stream.forget(since)
        self._raw = raw
        self._turn_over()
        self._speeds()

    def bound(self, raw: RawRows) -> int:
        """Return the stamp (ns) up to which speeds are known; one of two poses holds midway between them."""
        waits = self._own.newest != NEVER and self.source not in raw.silent
        return min(raw.until, self.moves.newest) if self.posed and waits else raw.until

    def believed(
        self, since: int, done: int, began: tuple[int, ...] = (), anew: tuple[int, ...] = ()
    ) -> BelievedRows:
        """Return the rows with their doubts, and with everything learnt up to the newest one.

        Parameters
        ----------
        since, done
            The rows to be processed now lie in (since, done], ns.
        began
            Stamps at which a doubt began in this block, ns.
        anew
            Stamps at which the soil has to be learnt anew, ns.

        Returns
        -------
        BelievedRows
            All rows that are kept, also those at or before `since`.
        """
        own = self.moves.samples, self.felt.samples, self._trust.samples
        return BelievedRows(
            self.settings, self.rules, self.source, self._raw, *own, self.doubts.now, since, done,
            began, anew,
        )  # fmt: skip

    @property
    def doubt(self) -> str:
        """Reason in words why the newest ground speed is not believed; empty if it is believed."""
        newest = self._trust.samples.values[-1:]
        if (newest[:, AGAINST] > 0.0).any():
            way = "where the wheels turn ahead, or ahead where back"
            return f"so far all goes backward by {self.source} {way}"
        if newest[:, UNFELT].any():
            return f"the imu does not feel how the speed of {self.source} changes"
        return ""

    def known(self, stamp: int) -> Known:
        """What is known of odometry and imu at a stamp (ns); `learn` must have got that far."""
        down = bisect_right(self._turned, stamp) % 2 == 0
        stamps, values = self._trust.last(np.array([stamp], dtype=np.int64))
        if stamps[0] == NEVER:
            return Known(down=down)
        of_wheels, no_twist, share, against, slides = values[0, [2, 7, 8, AGAINST, SLIDES]].tolist()
        against = against if self.source == ODOMETRY else 0.0
        return Known(share if of_wheels else math.nan, no_twist, down, against, slides > 0.0)

    # --- What came

    def _turn_over(self) -> None:
        """Extend `felt` by the new imu rows, turned about x where most rows so far have z pointing down."""
        stream = self._raw.get(IMU, NO_ROWS)
        stamps, values = stream.after(self.felt.newest)
        if not stamps.size:
            return
        # Gravity is felt; a driver without it in its acceleration may have it in the orientation.
        felt, told = values[:, 3] / self.settings.gravity, values[:, 6]
        along = np.where(np.abs(felt) > DOWN, felt, told)
        up = self._up + np.cumsum(along > DOWN)
        looks_down = self._looks_down + np.cumsum(along < -DOWN)
        self._up, self._looks_down = int(up[-1]), int(looks_down[-1])
        over = looks_down > up
        before = np.concatenate([[len(self._turned) % 2 == 0], over[:-1]])
        self._turned += stamps[over != before].tolist()
        # About x: y, z, yaw and pitch change.
        sign = np.array([-1.0, 1.0, -1.0, -1.0, 1.0, -1.0, -1.0, -1.0])
        turned = np.repeat(over[:, None], sign.size, axis=1)
        turned[:, 4:7] &= told[:, None] < 0.0  # an orientation may be that of the vehicle already
        values = np.where(turned, sign * values, values)
        inertial = self._inertial.take(stamps, values)
        self.felt.extend(stamps, np.column_stack([values, inertial]))

    def _speeds(self) -> None:
        """Extend `moves` and `_own` by the new messages: from the twist, or from poses while it is 0."""
        stream = self._raw.get(self.source, NO_ROWS)
        if not stream.after(self._own.newest)[0].size:
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
        aside_told = self._aside(values)
        if self.source == ODOMETRY and self.posed:
            twist = np.logical_or.accumulate((speed != 0.0) | (turn != 0.0))
            posed = ~twist
            rules, rows = self.rules, np.arange(all_stamps.size)
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
            if self.settings.steered:
                with np.errstate(invalid="ignore", divide="ignore"):
                    across = (now[:, Y] - then[:, Y]) * ahead - (now[:, X] - then[:, X]) * aside
                    across = np.where(near, across / length / seconds, np.nan)
                aside_told = np.where(posed, across, aside_told)
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
        # Unknown speeds are rows, too, so that nothing is interpolated over them.
        before_it = np.concatenate([[self.moves.newest], middle[:-1]])
        rising = middle > np.maximum.accumulate(before_it)
        self.moves.extend(middle[rising], np.column_stack([speed, turn, aside_told])[rising])

    def _aside(self, values: Array) -> Array:
        """Sideways speeds (m/s) of twists; NaN as long as every one so far was exactly 0."""
        if not self.settings.steered:
            return np.zeros(len(values))
        aside = values[:, ASIDE if self.source == ODOMETRY else 2]
        moves = np.abs(np.nan_to_num(aside)) > 0.0
        told = np.logical_or.accumulate(np.append(self._told_aside, moves))[1:]
        self._told_aside = bool(told[-1])
        return np.where(told, aside, np.nan)

    def _felt_ahead(self, felt: Array) -> tuple[Array, Array]:
        """Mean sine of the slope, nose up, over the last second, and mean specific force ahead without it.

        Without an orientation the slope is computed from the force, which is then not reduced by it. felt:
        rows of the imu at each lag, (rows, lags, 9). Both results have shape (rows,): 1, m/s^2; NaN where
        unknown.
        """
        ahead, up = mean_of_known(np.moveaxis(felt[:, :, [1, 4]], 1, 0)).T
        gravity = self.settings.gravity
        return np.where(np.isnan(up), ahead / gravity, up), ahead - gravity * np.nan_to_num(up)

    # --- What is learnt

    def learn(self, until: int) -> None:
        """Learn accuracy, lag and independence of the speed from its messages up to a stamp (ns).

        All rows up to that stamp must have arrived.
        """
        after = max(self._trust.newest, NEVER)
        stamps, own = self._own.between(after, until)
        if not stamps.size:
            return
        sums, now = self._sums, self.believed(after, until)
        back, speed, turn, new, no_twist, off = own.T
        middle = stamps - back.astype(np.int64)
        back_to = np.array([*LAGS, _APART, 2 * _APART])
        instants = (middle[:, None] - back_to).ravel()
        shown = now.at_once([*now.rim_streams, MOVES, FELT], instants)
        doubted = now.doubted.at(self.source, stamps)
        each_rim = now.each_rim_of(shown, instants.size)
        rims = now.rims(instants, each_rim)
        mean, size, half_turn = (each.reshape(middle.size, -1) for each in rims)
        moved = shown[MOVES][:, 0].reshape(middle.size, -1)
        imu = shown[FELT].reshape(middle.size, back_to.size, -1)[:, : LAGS.size]
        felt_ahead = self._felt_ahead(imu)
        before = np.concatenate([[sums.stamp], stamps[:-1]])
        passed = np.where(stamps - before > WINDOW, 0, stamps - before) / SECOND
        sums.stamp = int(stamps[-1])
        speed, turn, off = (np.where(doubted, np.nan, each) for each in (speed, turn, off))
        passed[doubted] = 0.0
        step = np.nan_to_num(size[:, 0]) * passed
        way = steps_of(step, sums.way)
        ways_before = np.concatenate([[sums.way], way[:-1]])
        made, may_be = np.zeros((2, stamps.size), dtype=bool)
        share = unknown(stamps.size)
        sums.way = float(way[-1])
        # Stamp of the last message that differed from the one before it, and the path of the rims then.
        is_new = new > 0.0
        changed = np.maximum.accumulate(np.where(is_new, stamps, NEVER))
        changed = np.maximum(changed, sums.changed)
        changed_way = np.maximum.accumulate(np.where(is_new, way, -1.0))
        changed_way = np.maximum(changed_way, sums.changed_way)
        sums.changed, sums.changed_way = int(changed[-1]), float(changed_way[-1])
        variance = self._spread(moved[:, -2:], back, speed, off, mean)
        parts = np.column_stack([mean[:, 0], speed, half_turn[:, 0], turn])
        parts = np.nan_to_num(parts) * passed[:, None]
        # Delay of the speed after gyro or rims, whichever is larger.
        turns_late = self._turns_late.take(turn, imu[:, :, 0])
        lag = np.fmax(turns_late, self._speed_late.take(speed, mean[:, : LAGS.size]))
        against, slides = self._goes_against.take(
            mean[:, 0], half_turn[:, 0], speed, passed, *felt_ahead
        )
        if self.source == ODOMETRY:  # a speed of another topic is not computed from the wheels
            made, may_be, share = self._of_wheels.take(ways_before, way, parts)
        if self.settings.steered and self.source == ODOMETRY:
            # Odometries of car-like vehicles are computed from the axle that is not steered.
            unsteered = parts.copy()
            unsteered[:, 0] = (
                np.nan_to_num(now.unsteered_rims(each_rim[:, :: back_to.size])) * passed
            )
            other = self._of_unsteered.take(ways_before, way, unsteered)
            share = np.where(other[0] & ~made, other[2], share)
            made, may_be = made | other[0], may_be | other[1]
        late = np.rint(np.nan_to_num(lag) * SECOND / LAGS[1]).astype(int)
        inertial = imu[np.arange(middle.size), late, INERTIAL]
        unfelt = self._unfelt.take(middle, speed, moved[:, -2], inertial)
        lag = np.where(np.isnan(lag), LATE, lag)
        since = (stamps - changed) / SECOND
        same = since, way - changed_way
        rows = [
            variance,
            lag,
            made,
            may_be,
            *same,
            back / SECOND,
            no_twist,
            share,
            against,
            slides,
            unfelt,
        ]
        self._trust.extend(stamps, np.column_stack(rows))

    def _spread(self, earlier: Array, back: Array, speed: Array, off: Array, rims: Array) -> Array:
        """Variance (m^2/s^2) of each speed, from its changes while the rims turn evenly.

        earlier: speeds `_APART` and twice that before, (rows, 2), m/s. back: time from the instant of the
        speed to its stamp, ns. off: distance of a pose from the line between its neighbours, from
        `_off_line`, m. rims: their mean speed at each of `LAGS`, `_APART` and twice that before,
        (rows, lags + 2), m/s.
        """
        sums = self._sums
        with np.errstate(invalid="ignore"):
            whole, near = rims[:, [0, -2, -1]], rims[:, :_NEAR]
            most = np.abs(whole).max(axis=1)
            size = np.where(most > STANDSTILL_SPEED, most, np.nan)
            change, change_near = np.ptp(whole, axis=1) / size, np.ptp(near, axis=1) / size
        before = np.concatenate([sums.speed, speed])
        sums.speed = before[-2:]
        lasting = speed - 2.0 * earlier[:, 0] + earlier[:, 1]
        quick = speed - 2.0 * before[1:-1] + before[:-2]
        told: Array = np.full(back.size, self.settings.noise.speed**2)
        with np.errstate(invalid="ignore", divide="ignore"):
            late2 = (off**2 - _PLACE**2) / rims[:, 0] ** 2
        good = (change < _SMOOTH) & np.isfinite(off)
        place = np.sqrt(_PLACE**2 + self._late2(good, late2) * np.nan_to_num(speed) ** 2)
        posed = 2.0 * (place * SECOND / np.maximum(2.0 * back, WINDOW)) ** 2
        told = np.where(back > 0.0, np.maximum(told, posed), told)
        found = told
        # Errors of stamps grow with the speed: divided by this, fast and slow rows have the same error.
        with np.errstate(invalid="ignore"):
            share = _SLOW**2 + np.nan_to_num(np.fmax(most, np.abs(speed))) ** 2
        # The error over three messages is known first, and is assumed for lasting errors as well.
        learnt = np.sqrt(np.maximum(told / share, _UNTRIED**2))
        kinds = (quick, change_near, sums.quick), (lasting, change, sums.lasting)
        for bend, changes, deviation in kinds:
            good = (changes < _STEADY) & np.isfinite(bend)
            learnt = deviation.take(good, np.abs(bend) / np.sqrt(6.0 * share), learnt)
            found = np.maximum(found, share * learnt**2)
        return np.asarray(found)

    def _late2(self, good: Flags, squares: Array) -> Array:
        """Mean squared stamp error of the poses up to each row, s^2; at least the usual one of a lidar.

        good: mask of the rows that count. squares: squared error of each row, s^2.
        """
        rows = np.column_stack([good, np.where(good, squares, 0.0)])
        total = np.cumsum(np.concatenate([self._sums.late[None], rows]), axis=0)[1:]
        self._sums.late = total[-1]
        mean = (_GUESSED * _SCAN**2 + total[:, 1]) / (_GUESSED + total[:, 0])
        return np.asarray(np.maximum(mean, _SCAN**2))


def _off_line(stamps: Integers, values: Array, begin: Integers, widest: int) -> Array:
    """Distance (m) along the heading of the pose before each row from the line between its neighbours.

    Scaled to the error of a single pose, (rows,); NaN where the three are too far apart. values: rows of the
    odometry. begin: index of the first row since the last silence, for each row. widest: longest gap
    between two of the poses, ns.
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
