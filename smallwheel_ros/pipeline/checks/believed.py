# SPDX-License-Identifier: Apache-2.0
"""The tables on both sides of the checks: raw rows of all streams, and what of them is believed.

`BelievedRows` is what every later stage reads measurements through. It holds rows and no stage: what it
gives at an instant is that of the rows around it, NaN where their stream is doubted then.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from smallwheel_ros.common.stamps import NEVER, SECOND
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, VELOCITY, OnboardSettings
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.pipeline.intake.buffer import Samples, StampRules
from smallwheel_ros.pipeline.intake.layout import rules_of, width_of
from smallwheel_ros.pipeline.tables import Array, Flags, Integers, unknown

from .doubts import NO_DOUBT, SHOWS_NO_SLIP, Doubted
from .rigid_motion import places_of, rigid_motion

_LATE = 0.5  # s that odometries of lidars, cameras and satellites come late by
Rows = tuple[Integers, Array]  # stamps (ns), values (rows, width)
NO_ROWS = Samples(np.empty(0, dtype=np.int64), np.empty((0, 10)))
AGAINST = 9  # of a row of what has been learnt of the speed
_TURNING = SECOND // 10  # ns over which the rate of a steering angle is taken: some messages of it


@dataclass(frozen=True)
class RawRows:
    """Raw rows of all streams by name: those that came last, and what is kept of earlier ones.

    until: stamp (ns) up to which all is there. silent: streams that are not waited for any more.
    """

    streams: Mapping[str, Samples]
    until: int
    silent: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Trust:
    """Accuracy of the speed at some instants.

    variance: m^2/s^2; lag: s, how much later it comes than what the wheels do, or may come; of_wheels:
    whether it is computed from the wheels; may_be: whether that is not known yet; since: s for which
    the message has been the same; way: m by the rims meanwhile; mean: s before its stamp at which it holds.
    """

    variance: Array
    lag: Array
    of_wheels: Flags
    may_be: Flags
    since: Array
    way: Array
    mean: Array


@dataclass(frozen=True)
class BelievedRows:
    """Raw rows with the stamps from which streams are doubted, read through those doubts.

    Attributes
    ----------
    settings
        Of the vehicle.
    streams
        Raw rows by stream, as kept.
    moves
        Speed (m/s), yaw rate (rad/s) and speed aside (m/s, NaN: unknown) over ground as measured, (rows, 3).
    felt
        Rows of the imu, z up, (rows, 7).
    trusted
        What has been learnt of the speed with each of its messages, (rows, 10).
    doubted
        Which streams are not believed, from which stamp on.
    since, done
        New is what lies in (since, done], ns: there all is there, and all doubts are known.
    began, anew
        Stamps (ns) at which a doubt begins; and from which on nothing counts that was learnt of the soil.
    """

    settings: OnboardSettings
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
    def rules(self) -> StampRules:
        """The rules for how long values are held."""
        return rules_of(self.settings)

    @property
    def source(self) -> str:
        """The stream that gives the speed over ground."""
        return VELOCITY if self.settings.velocity == "topic" else ODOMETRY

    @cached_property
    def _ever(self) -> frozenset[str]:
        """Streams that are doubted at any time."""
        return frozenset[str]().union(*self.doubted.streams)

    def _of(self, name: str, stamps: Integers, values: Array) -> Array:
        """Rows of a stream, NaN where it is doubted, and of a speed that goes against all rims so far."""
        found = self.doubted.believed(name, stamps, values) if name in self._ever else values
        if not self._goes_against or name not in (self.source, SHOWS_NO_SLIP):
            return found
        against = self.trusted.last(stamps)[1][:, AGAINST] > 0.0
        return np.where(against[:, None], np.nan, found)

    @cached_property
    def _goes_against(self) -> bool:
        """Whether the speed goes against all rims so far at any time."""
        return bool(self.trusted.values.size and self.trusted.values[:, AGAINST].any())

    # --- At instants

    def at(self, name: str, instants: Integers) -> Array:
        """Values of a stream at instants.

        Parameters
        ----------
        name
            The stream.
        instants
            Shape (instants,), ns.

        Returns
        -------
        ndarray
            Shape (instants, width), SI; NaN where there is no value, or it is doubted.
        """
        if name not in self.streams:
            return np.full((instants.size, width_of(name)), np.nan)
        return self._of(name, instants, self.streams[name].at(instants, self.rules))

    def speeds(self, instants: Integers) -> Array:
        """Speed (m/s) and yaw rate (rad/s) as measured over ground, (instants, 2)."""
        return self._of(self.source, instants, self.moves.at(instants, self.rules)[:, :2])

    def aside(self, instants: Integers) -> Array:
        """Speed (m/s) of the base frame to the left as measured over ground; NaN: unknown, (instants,)."""
        found = self.moves.at(instants, self.rules)[:, 2:3]
        return self._of(self.source, instants, found)[:, 0]

    def imu(self, instants: Integers) -> Array:
        """Rows of the imu, z up, (instants, 7)."""
        return self._of(IMU, instants, self.felt.at(instants, self.rules))

    def each_rim(self, instants: Integers) -> Array:
        """Speed (m/s) of the rim of each wheel that rolls, (wheels, instants)."""
        rolling = [wheel for wheel in self.settings.wheels if wheel.contact == ROLLING]
        found = np.empty((len(rolling), instants.size))
        for row, wheel in zip(found, rolling, strict=True):
            row[:] = self.at(f"{wheel.name}/wheel_speed", instants)[:, 0] * wheel.diameter / 2.0
        return found

    def steering(self, instants: Integers) -> tuple[Array, Array]:
        """Angle (rad, to the left) and its rate (rad/s) of each wheel that rolls, (wheels, instants).

        0 of a wheel that is not steered, NaN where an angle is not known. A rate is that of the last tenth of
        a second.
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

    def motion_of_rims(self, instants: Integers) -> Array:
        """Rigid motion nearest to the rims of wheels that are steered: vx, vy, yaw rate, (3, instants)."""
        angle, rate = self.steering(instants)
        rolling = self.settings.rolling
        arm = arms_of(self.settings)
        x, y = places_of(rolling, angle, arm)
        # While it is steered the middle of a wheel beside its axis is moved along, too.
        return rigid_motion(self.each_rim(instants) + rate * arm[:, None], x, y, angle)

    def unsteered_rims(self, instants: Integers) -> Array:
        """Mean speed (m/s) of the rims that are not steered, from which some odometries are computed."""
        rolling, steered = self.settings.rolling, self.settings.steered
        fixed = [wheel.name not in steered for wheel in rolling]
        return mean_of_known(self.each_rim(instants)[fixed])

    def rims(self, instants: Integers) -> tuple[Array, Array, Array]:
        """Speeds (m/s) of the rims: mean of all, mean size, and half of right less left.

        Of steered wheels, likewise, vx of the rigid motion nearest to them, mean size, and its yaw rate times
        half of the width that they stand on.
        """
        if self.settings.steered:
            ahead, _, turn = self.motion_of_rims(instants)
            sides = [wheel.lateral_position for wheel in self.settings.rolling]
            half = 0.5 * (max(sides) - min(sides))
            return ahead, mean_of_known(np.abs(self.each_rim(instants))), half * turn
        rims = self.each_rim(instants)
        if not len(rims):
            return unknown(instants.size), unknown(instants.size), unknown(instants.size)
        rolling = [wheel for wheel in self.settings.wheels if wheel.contact == ROLLING]
        side = np.array([wheel.lateral_position for wheel in rolling])
        turn = unknown(instants.size)
        if (side > 0.0).any() and (side < 0.0).any():
            turn = 0.5 * (mean_of_known(rims[side < 0.0]) - mean_of_known(rims[side > 0.0]))
        return mean_of_known(rims), mean_of_known(np.abs(rims)), turn

    def trust(self, instants: Integers) -> Trust:
        """Accuracy of the speed at instants."""
        stamps, values = self.trusted.last(instants)
        variance, lag, of_wheels, may_be, since, way, mean, *_ = values.T
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

    def period(self, instants: Integers) -> Integers:
        """Time (ns) between the messages of speed before each instant."""
        moves = self.moves.stamps
        if not moves.size:
            return np.zeros(instants.size, dtype=np.int64)
        row = np.maximum(np.searchsorted(moves, instants, side="right") - 1, 0)
        return np.asarray(np.minimum(self.moves.periods(moves)[row], self.rules.widest))

    def motion_anew(self) -> list[int]:
        """Which of `anew` are of what tells of motion: speed over ground, rims, imu."""
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
        """Rows of all streams in (since, done], an odometry that shows no slip NaN too."""
        found = {name: self.new(name) for name in self.streams}
        if ODOMETRY in found:
            stamps, values = found[ODOMETRY]
            found[ODOMETRY] = stamps, self._of(SHOWS_NO_SLIP, stamps, values)
        return found


def arms_of(settings: OnboardSettings) -> Array:
    """Middle of each rolling wheel to the left of its steering axis, m; 0 where that is not known."""
    steered = settings.steered
    arms = [steered[w.name].arm if w.name in steered else 0.0 for w in settings.rolling]
    return np.array([arm or 0.0 for arm in arms])


def mean_of_known(wheels: Array) -> Array:
    """Mean over the first axis of those that are known, NaN where none is."""
    known = np.isfinite(wheels)
    count = known.sum(axis=0)
    total = np.where(known, wheels, 0.0).sum(axis=0)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))
