# SPDX-License-Identifier: Apache-2.0
"""Rows as they arrive, and as the stages after the checks read them.

`BelievedRows` is the only way in which later stages read measurements. A value at an instant is
interpolated or held from the rows around it, and is NaN where its stream is doubted at that instant. It
holds data only, no stage.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from smallwheel_ros.common.stamps import NEVER, SECOND
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, OnboardSettings
from smallwheel_ros.pipeline.intake.buffer import Samples, StampRules
from smallwheel_ros.pipeline.intake.layout import width_of
from smallwheel_ros.pipeline.tables import Array, Flags, Integers

from .doubts import NO_DOUBT, SHOWS_NO_SLIP, Doubted
from .lateness import LATE
from .rigid_motion import places_of, rigid_motion

Rows = tuple[Integers, Array]  # stamps (ns), values (rows, width)
NO_ROWS = Samples(np.empty(0, dtype=np.int64), np.empty((0, 12)))
MOVES, FELT = "moves", "felt"  # speed over ground and imu as they are read, beside the raw streams
AGAINST, SLIDES, UNFELT = 9, 10, 11  # of a row of what has been learnt of the speed
INERTIAL = 8  # of a row of `FELT`
_TURNING = SECOND // 10  # ns over which the rate of a steering angle is taken: some messages of it


@dataclass(frozen=True)
class RawRows:
    """Raw rows of all streams by name: the newly arrived ones, and those kept from earlier.

    Attributes
    ----------
    until
        Stamp up to which all rows have arrived, ns.
    silent
        Streams that are no longer waited for.
    """

    streams: Mapping[str, Samples]
    until: int
    silent: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Trust:
    """Accuracy and independence of the ground speed at some instants.

    Attributes
    ----------
    variance
        Variance of the speed, m^2/s^2.
    lag
        Delay, or possible delay, of the speed against the motion of the wheels, s.
    of_wheels
        Whether the speed is computed from the wheels.
    may_be
        Whether it may be computed from the wheels, because that is not known yet.
    since
        Time for which messages have repeated the same speed, s.
    way
        Path of the rims in that time, m.
    mean
        How long before its stamp the speed held, s, where it is a mean over time.
    """

    variance: Array
    lag: Array
    of_wheels: Flags
    may_be: Flags
    since: Array
    way: Array
    mean: Array


class RimSpeeds(NamedTuple):
    """Speeds (m/s) of the rims at instants: mean, mean magnitude, and half of right minus left.

    With steered wheels they are those of the rigid motion that fits the rims best: vx, the mean
    magnitude, and the yaw rate times half of the track width.
    """

    mean: Array
    size: Array
    turn: Array


@dataclass(frozen=True)
class BelievedRows:
    """Raw rows with the stamps from which streams are doubted, read through those doubts.

    Attributes
    ----------
    settings
        Settings of the vehicle.
    rules
        Rules for stamps: among others, how long a value is held.
    source
        The stream that gives the speed over ground.
    streams
        Raw rows by stream, as kept.
    moves
        Speed (m/s), yaw rate (rad/s) and sideways speed (m/s, NaN: unknown) over ground as measured,
        (rows, 3).
    felt
        Rows of the imu, z up, and the speed by the imu alone, (rows, 9).
    trusted
        What had been learnt about the speed up to each of its messages, (rows, 12).
    doubted
        Which streams are doubted, each from a stamp on.
    since, done
        The new rows lie in (since, done], ns: all of them have arrived, and all doubts about them are
        known.
    began, anew
        Stamps (ns) at which a doubt begins, and at which the soil has to be learnt anew.
    """

    settings: OnboardSettings
    rules: StampRules
    source: str
    streams: Mapping[str, Samples]
    moves: Samples = NO_ROWS
    felt: Samples = NO_ROWS
    trusted: Samples = NO_ROWS
    doubted: Doubted = NO_DOUBT
    since: int = NEVER
    done: int = NEVER
    began: tuple[int, ...] = ()
    anew: tuple[int, ...] = ()

    @cached_property
    def _ever(self) -> frozenset[str]:
        """Streams that are doubted at any time."""
        return frozenset[str]().union(*self.doubted.streams)

    def _of(self, name: str, stamps: Integers, values: Array) -> Array:
        """Rows of a stream, NaN where it is doubted.

        A speed is, too, while it goes against all rims so far, or the imu does not feel how it changes.
        """
        found = self.doubted.believed(name, stamps, values) if name in self._ever else values
        if not self._speed_doubted or name not in (self.source, SHOWS_NO_SLIP):
            return found
        flags = self.trusted.last(stamps)[1][:, [AGAINST, UNFELT]] > 0.0
        doubted = np.asarray(flags.any(axis=1))
        return np.where(doubted[:, None], np.nan, found)

    @cached_property
    def _speed_doubted(self) -> bool:
        """Whether any message of the speed is doubted by itself."""
        return bool(self.trusted.values[:, [AGAINST, UNFELT]].any())

    # --- At instants

    def at_once(self, names: Sequence[str], instants: Integers) -> dict[str, Array]:
        """Values of several streams at instants.

        Parameters
        ----------
        names
            Raw streams, `MOVES` (speed over ground), `FELT` (imu, z up).
        instants
            Shape (instants,), ns.

        Returns
        -------
        dict of ndarray
            By name, shape (instants, width), SI; NaN where there is no value, or the stream is doubted.
        """
        own = {MOVES: self.moves, FELT: self.felt, **self.streams}
        found = {
            name: own[name].at(instants, self.rules)
            if name in own
            else np.full((instants.size, width_of(name)), np.nan)
            for name in names
        }
        of = {MOVES: self.source, FELT: IMU}
        return {name: self._of(of.get(name, name), instants, found[name]) for name in names}

    def at(self, name: str, instants: Integers) -> Array:
        """Values of one stream at instants; see `at_once`.

        Parameters
        ----------
        name
            The stream.
        instants
            Shape (instants,), ns.
        """
        return self.at_once([name], instants)[name]

    def speeds(self, instants: Integers) -> Array:
        """Speed (m/s) and yaw rate (rad/s) as measured over ground, (instants, 2)."""
        return self.at(MOVES, instants)[:, :2]

    def aside(self, instants: Integers) -> Array:
        """Speed (m/s) of the base frame to the left, as measured over ground, (instants,); NaN: unknown."""
        return self.at(MOVES, instants)[:, 2]

    @cached_property
    def rim_streams(self) -> list[str]:
        """Streams of the speeds of the wheels that roll."""
        return [f"{wheel.name}/wheel_speed" for wheel in self.settings.rolling]

    def each_rim_of(self, shown: Mapping[str, Array], count: int) -> Array:
        """Speed (m/s) of the rim of each wheel that rolls, (wheels, instants); NaN without its stream.

        Parameters
        ----------
        shown
            Values of each stream at the instants, shape (instants, columns), from `at_once`; wheel speeds
            in rad/s.
        count
            Number of instants.
        """
        found = np.full((len(self.settings.rolling), count), np.nan)
        for row, wheel in zip(found, self.settings.rolling, strict=True):
            if (name := f"{wheel.name}/wheel_speed") in shown:
                row[:] = shown[name][:, 0] * wheel.diameter / 2.0
        return found

    def each_rim(self, instants: Integers) -> Array:
        """Speed (m/s) of the rim of each wheel that rolls, (wheels, instants)."""
        return self.each_rim_of(self.at_once(self.rim_streams, instants), instants.size)

    def steering(self, instants: Integers) -> tuple[Array, Array]:
        """Angle (rad, to the left) and its rate (rad/s) of each wheel that rolls, (wheels, instants).

        Both are 0 for a wheel that is not steered, and NaN where an angle is not known. The rate is a mean
        over the last tenth of a second.
        """
        rolling, steered = self.settings.rolling, self.settings.steered
        angle, rate = np.zeros((2, len(rolling), instants.size))
        for i, wheel in enumerate(rolling):
            if wheel.name in steered:
                name = f"{wheel.name}/steering"
                angle[i] = self.at(name, instants)[:, 0]
                change = angle[i] - self.at(name, instants - _TURNING)[:, 0]
                rate[i] = np.nan_to_num(change) * SECOND / _TURNING
        return angle, rate

    def motion_of_rims(self, instants: Integers, rims: Array) -> Array:
        """The rigid motion that fits the rims of steered wheels best: vx, vy and yaw rate, (3, instants).

        Parameters
        ----------
        instants
            Shape (instants,), ns.
        rims
            Speed of the rim of each wheel that rolls, shape (wheels, instants), m/s.
        """
        angle, rate = self.steering(instants)
        rolling = self.settings.rolling
        arm = arms_of(self.settings)
        x, y = places_of(rolling, angle, arm)
        # While it is steered the middle of a wheel beside its axis is moved along, too.
        return rigid_motion(rims + rate * arm[:, None], x, y, angle)

    def unsteered_rims(self, rims: Array) -> Array:
        """Mean speed (m/s) of the rims that are not steered; some odometries are computed from these alone.

        Parameters
        ----------
        rims
            Speed of the rim of each wheel that rolls, shape (wheels, instants), m/s.
        """
        rolling, steered = self.settings.rolling, self.settings.steered
        return mean_of_known(rims[[wheel.name not in steered for wheel in rolling]])

    def rims(self, instants: Integers, rims: Array) -> RimSpeeds:
        """Mean and turning speed of the vehicle's rims at instants.

        Parameters
        ----------
        instants
            Shape (instants,), ns.
        rims
            Speed of the rim of each wheel that rolls, shape (wheels, instants), m/s.
        """
        size = mean_of_known(np.abs(rims))
        side = np.array([wheel.lateral_position for wheel in self.settings.rolling])
        if self.settings.steered:
            ahead, _, turn = self.motion_of_rims(instants, rims)
            return RimSpeeds(ahead, size, 0.5 * float(np.ptp(side)) * turn)
        left, right = mean_of_known(rims[side > 0.0]), mean_of_known(rims[side < 0.0])
        return RimSpeeds(mean_of_known(rims), size, 0.5 * (right - left))

    def trust(self, instants: Integers) -> Trust:
        """Accuracy of the speed at instants."""
        stamps, values = self.trusted.last(instants)
        variance, lag, of_wheels, may_be, since, way, mean, *_ = values.T
        seconds = np.where(stamps == NEVER, 0.0, (instants - stamps) / SECOND)
        usual = np.where(np.isnan(variance), self.settings.noise.speed**2, variance)
        return Trust(
            usual,
            np.where(np.isnan(lag), LATE, lag),
            of_wheels > 0.0,
            (may_be != 0.0) & (self.source == ODOMETRY),
            np.nan_to_num(since) + seconds,
            np.nan_to_num(way),
            np.nan_to_num(mean),
        )

    def period(self, instants: Integers) -> Integers:
        """Period (ns) of the messages of speed, by those before each instant."""
        moves = self.moves.stamps
        if not moves.size:
            return np.zeros(instants.size, dtype=np.int64)
        row = np.maximum(np.searchsorted(moves, instants, side="right") - 1, 0)
        return np.asarray(np.minimum(self.moves.periods(moves)[row], self.rules.widest))

    def motion_anew(self) -> list[int]:
        """The stamps in `anew` that are due to a stream of motion: ground speed, rims or imu."""
        tells = {
            self.source,
            IMU,
            *(name for name in self.streams if name.endswith("/wheel_speed")),
        }
        found = []
        for stamp in self.anew:
            before, after = (self.doubted.set_at(at) for at in (stamp, stamp + 1))
            if self.since < stamp <= self.done and tells & (after - before):
                found.append(stamp)
        return found

    # --- Rows as they came

    def new(self, name: str) -> Rows:
        """Rows of a stream in (since, done], NaN where it is doubted."""
        stamps, values = self.streams.get(name, NO_ROWS).between(self.since, self.done)
        return stamps, self._of(name, stamps, values)

    def new_imu(self) -> Rows:
        """Rows of the imu in (since, done], z up, NaN where it is doubted."""
        stamps, values = self.felt.between(self.since, self.done)
        return stamps, self._of(IMU, stamps, values)

    def new_motion(self) -> dict[str, Rows]:
        """Rows of all streams in (since, done], NaN where doubted or where an odometry shows no slip."""
        found = {name: self.new(name) for name in self.streams}
        if ODOMETRY in found:
            stamps, values = found[ODOMETRY]
            found[ODOMETRY] = stamps, self._of(SHOWS_NO_SLIP, stamps, values)
        return found


def arms_of(settings: OnboardSettings) -> Array:
    """How far the middle of each rolling wheel is to the left of its steering axis, m; 0 if unknown."""
    steered = settings.steered
    arms = [steered[w.name].arm if w.name in steered else 0.0 for w in settings.rolling]
    return np.array([arm or 0.0 for arm in arms])


def mean_of_known(wheels: Array) -> Array:
    """Mean over the first axis, without NaN; NaN where all are NaN."""
    known = np.isfinite(wheels)
    count = known.sum(axis=0)
    total = np.where(known, wheels, 0.0).sum(axis=0)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))
