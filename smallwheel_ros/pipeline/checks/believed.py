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
MOVES, FELT = "moves", "felt"  # names of the derived streams: speed over ground; imu with z up
AGAINST, SLIDES, UNFELT = 9, 10, 11  # columns of `BelievedRows.trusted`
INERTIAL = 8  # column of `FELT`: the speed by the imu alone
_TURNING = SECOND // 10  # ns over which the rate of a steering angle is taken: some messages of it


@dataclass(frozen=True)
class RawRows:
    """Raw rows of all streams: the newly arrived ones, and those kept from earlier.

    Attributes
    ----------
    streams
        Rows by the stream's name, such as `<wheel>/load` or `odom`; SI units.
    until
        Stamp up to which all rows have arrived, ns.
    silent
        Names of the streams that have sent nothing for so long that they are no longer waited for.
    """

    streams: Mapping[str, Samples]
    until: int
    silent: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Trust:
    """Accuracy and independence of the ground speed at some instants; arrays of shape (instants,).

    Attributes
    ----------
    variance
        Variance of the speed, m^2/s^2.
    lag
        Delay of the speed after the motion of the wheels, s; as long as it is unknown, the largest usual one,
        0.5 s.
    of_wheels
        Whether the speed is computed from the wheels.
    may_be
        Whether it may be computed from the wheels; True until that has been decided.
    since
        Time since the last message that differed from the one before it, s.
    way
        Path of the rims from that message to the newest one, m.
    mean
        Time from the instant at which the speed holds to its message's stamp, s: half the averaging time of
        a speed computed from poses, 0 for a measured one.
    """

    variance: Array
    lag: Array
    of_wheels: Flags
    may_be: Flags
    since: Array
    way: Array
    mean: Array


class RimSpeeds(NamedTuple):
    """Speeds of a vehicle's rims at instants; arrays of shape (instants,), m/s, NaN where unknown.

    Attributes
    ----------
    mean
        Mean over the rims; for a vehicle that steers, vx of the rigid motion that fits the rims best.
    size
        Mean magnitude over the rims.
    turn
        Half the difference of the means of right and left, positive in a turn to the left; for a vehicle
        that steers, yaw rate of that rigid motion times half the track width.
    """

    mean: Array
    size: Array
    turn: Array


@dataclass(frozen=True)
class BelievedRows:
    """Raw rows, and the doubts about them; its methods give NaN wherever a stream is doubted.

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
        Rows of the imu in axes with z up, (rows, 9): yaw rate (rad/s); specific force ahead, left and up
        (m/s^2); unit vector that points up, NaN without an orientation; pitch rate (rad/s, positive nose
        down); speed by integration of the imu alone (m/s).
    trusted
        What was known of the ground speed at each of its messages, (rows, 12); flags are 0 or 1. Columns 0
        to 6 are the fields of `Trust` in their order; 7 no_twist, 8 share (also of an odometry that is not
        computed from the wheels), 9 against and 10 slides as in `Known`; 11 whether the imu did not feel the
        last change of the speed (`Unfelt.take`).
    doubted
        Which streams are doubted, and over which stamps.
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

        A ground speed is also NaN while nearly all of the path so far runs against the rims, or while the imu
        does not feel its changes.
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
        """Values of several streams at instants, interpolated or held.

        Parameters
        ----------
        names
            Names of raw streams, `MOVES` (speed over ground) or `FELT` (imu, z up).
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
        """Values of one stream at instants, interpolated or held.

        Parameters
        ----------
        name
            Name of the stream, as for `at_once`.
        instants
            Shape (instants,), ns.

        Returns
        -------
        ndarray
            Shape (instants, width), SI; NaN where there is no value, or the stream is doubted.
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
        """Names of the streams of wheel speeds, one for each wheel that rolls."""
        return [f"{wheel.name}/wheel_speed" for wheel in self.settings.rolling]

    def each_rim_of(self, shown: Mapping[str, Array], count: int) -> Array:
        """Compute the rim speeds of the wheels that roll, from values that have been looked up already.

        Parameters
        ----------
        shown
            Values by stream as given by `at_once`, shape (instants, width); wheel speeds in rad/s.
        count
            Number of instants.

        Returns
        -------
        ndarray
            Shape (rolling wheels, instants), m/s; NaN for a wheel whose stream is missing.
        """
        found = np.full((len(self.settings.rolling), count), np.nan)
        for row, wheel in zip(found, self.settings.rolling, strict=True):
            if (name := f"{wheel.name}/wheel_speed") in shown:
                row[:] = shown[name][:, 0] * wheel.diameter / 2.0
        return found

    def each_rim(self, instants: Integers) -> Array:
        """Speed (m/s) of the rim of each wheel that rolls, (rolling wheels, instants); NaN: unknown."""
        return self.each_rim_of(self.at_once(self.rim_streams, instants), instants.size)

    def steering(self, instants: Integers) -> tuple[Array, Array]:
        """Steering angle and its rate of each wheel that rolls.

        Parameters
        ----------
        instants
            Shape (instants,), ns.

        Returns
        -------
        angle : ndarray
            Shape (rolling wheels, instants), rad, positive to the left; 0 for a wheel that is not steered,
            NaN where the angle is unknown.
        rate : ndarray
            Same shape, rad/s: mean over the last tenth of a second; 0 where that is unknown.
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
        """Fit the motion of the vehicle as a rigid body to its rim speeds and steering angles.

        Parameters
        ----------
        instants
            Shape (instants,), ns.
        rims
            Speed of the rim of each wheel that rolls, shape (rolling wheels, instants), m/s.

        Returns
        -------
        ndarray
            Shape (3, instants): vx and vy (m/s) of the base frame, yaw rate (rad/s); NaN where fewer than
            two wheels are known. See `rigid_motion`.
        """
        angle, rate = self.steering(instants)
        rolling = self.settings.rolling
        arm = arms_of(self.settings)
        x, y = places_of(rolling, angle, arm)
        # While it is steered the middle of a wheel beside its axis is moved along, too.
        return rigid_motion(rims + rate * arm[:, None], x, y, angle)

    def unsteered_rims(self, rims: Array) -> Array:
        """Mean speed of the wheels that are not steered; some odometries are computed from these alone.

        Parameters
        ----------
        rims
            Speed of the rim of each wheel that rolls, shape (rolling wheels, instants), m/s.

        Returns
        -------
        ndarray
            Shape (instants,), m/s; NaN where no such wheel is known.
        """
        rolling, steered = self.settings.rolling, self.settings.steered
        return mean_of_known(rims[[wheel.name not in steered for wheel in rolling]])

    def rims(self, instants: Integers, rims: Array) -> RimSpeeds:
        """Summarise the rim speeds of all wheels at each instant by mean, magnitude and turning speed.

        Parameters
        ----------
        instants
            Shape (instants,), ns.
        rims
            Speed of the rim of each wheel that rolls, shape (rolling wheels, instants), m/s.

        Returns
        -------
        RimSpeeds
            Arrays of shape (instants,), m/s.
        """
        size = mean_of_known(np.abs(rims))
        side = np.array([wheel.lateral_position for wheel in self.settings.rolling])
        if self.settings.steered:
            ahead, _, turn = self.motion_of_rims(instants, rims)
            return RimSpeeds(ahead, size, 0.5 * float(np.ptp(side)) * turn)
        left, right = mean_of_known(rims[side > 0.0]), mean_of_known(rims[side < 0.0])
        return RimSpeeds(mean_of_known(rims), size, 0.5 * (right - left))

    def trust(self, instants: Integers) -> Trust:
        """Accuracy and independence of the ground speed at instants (ns), as learnt up to each instant."""
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
        """Period (ns) of the ground speed before each instant, shape (instants,); 0 without any message."""
        moves = self.moves.stamps
        if not moves.size:
            return np.zeros(instants.size, dtype=np.int64)
        row = np.maximum(np.searchsorted(moves, instants, side="right") - 1, 0)
        return np.asarray(np.minimum(self.moves.periods(moves)[row], self.rules.widest))

    def motion_anew(self) -> list[int]:
        """Stamps `anew` in (since, done] at which a doubt about ground speed, a rim or the imu begins."""
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
        """Stamps (ns) and values (rows, width) of a stream in (since, done], NaN where it is doubted."""
        stamps, values = self.streams.get(name, NO_ROWS).between(self.since, self.done)
        return stamps, self._of(name, stamps, values)

    def new_imu(self) -> Rows:
        """Stamps (ns) and rows of `felt` in (since, done], NaN where the imu is doubted."""
        stamps, values = self.felt.between(self.since, self.done)
        return stamps, self._of(IMU, stamps, values)

    def new_motion(self) -> dict[str, Rows]:
        """Rows of each raw stream in (since, done] by name, as stamps (ns) and values (rows, width).

        They are NaN where the stream is doubted, and for an odometry also where it is computed from the
        wheels and so shows no slip.
        """
        found = {name: self.new(name) for name in self.streams}
        if ODOMETRY in found:
            stamps, values = found[ODOMETRY]
            found[ODOMETRY] = stamps, self._of(SHOWS_NO_SLIP, stamps, values)
        return found


def arms_of(settings: OnboardSettings) -> Array:
    """Distance (m) of each rolling wheel's middle to the left of its steering axis; 0 if unknown.

    Returns
    -------
    ndarray
        Shape (rolling wheels,); 0 also for a wheel that is not steered.
    """
    steered = settings.steered
    arms = [steered[w.name].arm if w.name in steered else 0.0 for w in settings.rolling]
    return np.array([arm or 0.0 for arm in arms])


def mean_of_known(wheels: Array) -> Array:
    """Mean over the first axis, without NaN; NaN where all are NaN."""
    known = np.isfinite(wheels)
    count = known.sum(axis=0)
    total = np.where(known, wheels, 0.0).sum(axis=0)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))
