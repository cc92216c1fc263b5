# SPDX-License-Identifier: Apache-2.0
"""Rules of `checks` about odometry and imu: their source, delay and mounting."""

from __future__ import annotations

from collections import deque

import numpy as np
from scipy.special import stdtrit

from smallwheel_ros.onboard.felt_gravity import unlike_gravity
from smallwheel_ros.onboard.settings import IMU, ODOMETRY
from smallwheel_ros.pipeline.tables import Array

from .lateness import MOVES
from .sums import Run, Said
from .window import (
    ABOVE,
    AHEAD,
    COSINE,
    GAP,
    GYRO,
    LEFT,
    SINE,
    SPEED,
    CheckedWheels,
    Window,
    X,
    Y,
)  # fmt: skip

LATE, LATE_ALIKE = 0.2, 0.8  # s, correlation
ALIKE = 0.1  # of their speed: what wheels of one side differ by on even ground
JUMP, JUMP_FACTOR = 1.0, 3.0  # m, 1
REPEAT_WAY = 1.0  # m by the rims
NO_TWIST_WAY = 2.0  # m of the pose
FRAME_ASIDE, FRAME_WAY, FRAME_FITS = 0.3, 1.0, 0.15  # of the pose's speed, m, of the way
FRAME_MOVES = 0.2  # of the way: a twist that hardly moves fits any axis across it
GRAVITY_TIME = 10.0  # s: over less a start or a stop may make a tenth of it
TILT, TILT_CHANCE, STANDS = 0.03, 0.001, 4  # rad, of Student's t distribution, standstills
USUAL = 0.1  # rad: slopes on which vehicles stop, and mountings; in one heading both look alike


class NoTwist:
    """Measures the path by the pose while every twist is 0."""

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        It reports as long as every twist so far was 0.
        """
        way = window.memory.known.no_twist
        text = (
            "the odometry has no twist (0 throughout while its pose moves): its speed is taken from"
            " differences of the pose; let the driver fill in the twist if it can"
        )
        return [Said(ODOMETRY, way, text)] if way > NO_TWIST_WAY else []


class TwistFrame:
    """Whether the twist's linear.x is the pose's speed along x of the map, rather than along its heading.

    Some simulators and motion capture publish it so. It is judged where the pose goes along its heading at
    another speed than along x, and not along x either. There a twist that is the vehicle's own
    speed differs from the speed along x by over `FRAME_ASIDE` of it, even if the heading is wrong.
    """

    def __init__(self) -> None:
        self.sums = np.zeros(3)  # m: way, misfit of the twist along x, way by the twist

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        An odometry that has no twist, or is computed from the wheels, is not judged.
        """
        o, known = window.odometry, window.memory.known
        if o is None or not known.twist or known.of_wheels:
            return []
        along, across = window.pose_steps / GAP
        ahead = along * o.x[:, COSINE] + across * o.x[:, SINE]
        pace, twist = np.hypot(along, across), o.x[:, SPEED]
        aside = np.minimum(np.abs(ahead - along), pace - np.abs(along))
        rows = o.inside & (pace > MOVES) & (aside > FRAME_ASIDE * pace) & np.isfinite(twist)
        columns = pace, np.abs(twist - along), np.abs(twist)
        self.sums += np.stack(columns)[:, rows] @ o.dt[rows]
        way, misfit, moved = self.sums.tolist()
        fits = misfit < FRAME_FITS * way and moved > FRAME_MOVES * way
        window.memory.of_map = way > FRAME_WAY and fits
        if not window.memory.of_map:
            return []
        text = (
            "its twist is along the axes of the map, not of the vehicle (off the speed of the pose along x by"
            f" {misfit / way:.0%} on {way:.1f} m): publish it in child_frame_id, turned by the heading, as"
            " nav_msgs/Odometry has it"
        )
        return [Said("odometry", way, text, (ODOMETRY,), taught=True)]


class ZDown:
    """Reports an imu in most of whose rows z points down; all rules then use its gyro turned over."""

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        It reports while z points down.
        """
        text = (
            "z of the imu looks down: it is turned over; publish it in base_link's axes for others"
        )
        return [Said("imu", 1.0, text)] if window.memory.known.down else []


class RepeatedTwists:
    """Measures the path of the rims while a source repeats one message bit for bit.

    Parameters
    ----------
    source
        Stream to be judged, that of the odometry or of the imu.
    """

    def __init__(self, source: str) -> None:
        self.source, self.run = source, Run()

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        Spans in which the source shows nothing but 0 are skipped.
        """
        rows = window.imu if self.source == IMU else window.odometry
        if rows is None or window.rims is None or not np.nan_to_num(rows.x).any():
            return []
        inside = rows.inside
        rim = np.nan_to_num(np.median(np.abs(rows.rims[inside]), axis=1))
        # A stop adds no way, and ends no run: only a new message does.
        way = np.where(rim > MOVES, rim, 0.0) * rows.dt[inside]
        self.run.extend(rows.same[inside], way, rows.stamp[inside])
        if not self.run.most > REPEAT_WAY:
            return []
        text = f"it repeats one and the same message for {self.run.most:.1f} m: check its driver"
        subject = "imu" if self.source == IMU else "odometry"
        return [Said(subject, self.run.most, text, (self.source,), self.run.began)]


class OfWheelsRule:
    """Reports an odometry that is computed from the wheels; no other rule then uses it as evidence."""

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        Positions of such an odometry stay in use.
        """
        known = window.memory.known
        if not known.of_wheels:
            return []
        text = (
            f"it agrees with the wheels to {known.share:.2%} of the distance: it is computed from them and"
            " shows no slip: give an independent odometry (camera, lidar, GNSS), or velocity_topic"
        )
        return [Said("odometry", known.share, text, (ODOMETRY,), places=True)]


class Late:
    """Finds the lag at which changes of the odometry's speed over 0.5 s follow those of the rims best.

    Where ground gives way as the wheels start, slip grows together with the speed. That looks like a lag,
    too, but the speed then changes by far less than that of the rims, and the rule does not report.
    """

    FOLLOWS = 0.75  # of the rims' changes; of less, slip is the usual reason
    STEP, SMOOTH, OVER = 0.05, 9, 10  # s; samples of a mean; of a change
    LAGS = np.arange(-10, 21)  # steps

    def __init__(self, vehicle: CheckedWheels) -> None:
        self.count = 0
        self.sums = np.zeros((5, len(self.LAGS)))
        self.sides = [side for side in (vehicle.y > 0, vehicle.y <= 0) if side.any()]

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        Rows on which the wheels of a side differ are left out: one that spins runs ahead of the speed.
        """
        moves, step = window.moves, self.STEP
        if window.rims is None or len(moves.t) < 3 or window.memory.known.of_wheels:
            return []
        first = round(-1.0 / step)
        t: Array = np.asarray(np.arange(first, round(4.0 / step)) * step, dtype=np.float64)
        each = window.rims_ahead_at(t)
        apart = np.max([np.ptp(each[:, side], axis=1) for side in self.sides], axis=0)
        rims: Array = np.asarray(np.median(each, axis=1), dtype=np.float64)
        rims = np.where(apart <= ALIKE * np.abs(rims) + MOVES, rims, np.nan)
        rim = _smoothed(rims, self.SMOOTH)
        v = _smoothed(moves.at(t, SPEED), self.SMOOTH)
        da, db = rim[self.OVER :] - rim[: -self.OVER], v[self.OVER :] - v[: -self.OVER]
        here = np.arange(-first, -first + round(2.0 / step))
        shifted = here[:, None] + self.LAGS
        b = db[np.minimum(shifted, len(db) - 1)]
        good = np.isfinite(da[here]) & np.isfinite(b).all(axis=1) & (shifted[:, -1] < len(db))
        a, b = da[here][good][:, None], b[good]
        self.count += len(a)
        self.sums += [
            np.broadcast_to(column, b.shape).sum(axis=0) for column in (a, b, a * a, b * b, a * b)
        ]
        if self.count < 80:
            return []
        mean_a, mean_b, aa, bb, ab = self.sums / self.count
        spread = np.sqrt(np.maximum((aa - mean_a**2) * (bb - mean_b**2), 0.0))
        if aa[0] - mean_a[0] ** 2 < 0.02**2 or not spread.all():
            return []
        alike = (ab - mean_a * mean_b) / spread
        best = int(np.argmax(alike))
        late = step * float(self.LAGS[best])
        follows = (ab - mean_a * mean_b)[best] / (aa - mean_a**2)[best]
        text = f"it is {late:.2f} s behind the wheels (correlation {alike[best]:.2f}): check its stamps"
        return (
            [Said("odometry", late, text)]
            if late > LATE - 1e-9 and alike[best] >= LATE_ALIKE and follows > self.FOLLOWS
            else []
        )


def _smoothed(values: Array, count: int) -> Array:
    """Moving mean over an odd number of samples centred on each; NaN at the ends."""
    found = np.full(values.size, np.nan)
    edge = count // 2
    found[edge:-edge] = np.lib.stride_tricks.sliding_window_view(values, count).mean(axis=1)
    return found


class Jumps:
    """Counts steps of the pose that are too long for the odometry's own speed and for that of any wheel."""

    def __init__(self, vehicle: CheckedWheels) -> None:
        self.count, self.most = 0, 0.0

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        Gaps of 1 s or more are not judged.
        """
        o = window.odometry
        if o is None or window.rims is None:
            return []
        rim = np.nan_to_num(np.abs(o.rims)).max(axis=1)
        step, dt = np.hypot(*np.diff(o.x[:, [X, Y]], axis=0).T), np.diff(o.t)
        most = np.fmax(rim[1:], np.abs(o.x[1:, SPEED]))
        rows = o.inside[1:] & (dt < 2 * GAP)
        jump = np.nan_to_num(step - JUMP_FACTOR * most * dt)[rows]
        now = int((jump > JUMP).sum())
        self.count += now
        if now:  # its ways tell no radius; places and speeds between jumps are of use all the same
            window.memory.doubted.add(ODOMETRY)
        self.most = max(self.most, float(jump.max(initial=0.0)))
        text = (
            f"its pose jumps {self.count} times, by up to {self.most:.1f} m, where no wheel turns so fast:"
            " check GNSS or loop closures; places on the map are off by that"
        )
        return [Said("odometry", self.most, text)] if self.count else []


class FeltGravity:
    """Compares the magnitude of the imu's mean specific force, over all of its rows, with gravity."""

    def __init__(self, vehicle: CheckedWheels) -> None:
        self._gravity = vehicle.gravity
        self._seconds, self._sum = 0.0, np.zeros(3)

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        An imu that also gives an orientation stays in use, because the slope is taken from that.
        """
        imu = window.imu
        if imu is None:
            return []
        felt = imu.x[:, [AHEAD, LEFT, ABOVE]]
        rows = imu.inside & np.isfinite(felt).all(axis=1)
        self._seconds += float(imu.dt[rows].sum())
        self._sum += (imu.dt[rows, None] * felt[rows]).sum(axis=0)
        if self._seconds < GRAVITY_TIME:
            return []
        strength = float(np.linalg.norm(self._sum)) / self._seconds
        words = unlike_gravity(strength, self._gravity)
        return [Said("imu", strength, words, () if window.oriented else (IMU,))] if words else []


class Tilt:
    """Estimates the mounting tilt of the imu from standstills at different headings.

    A zero error turns with the vehicle, a slope of the ground does not. Model: ahead = e cos a + n sin a + p,
    left = n cos a - e sin a + r (e, n: slope of the ground; p, r: zero errors of the imu, rad; a: heading),
    fitted by least squares with prior deviations `USUAL`.
    """

    def __init__(self, vehicle: CheckedWheels) -> None:
        self._gravity = vehicle.gravity
        self.stands: deque[Array] = deque(maxlen=100)  # heading, ahead, left
        self._open = np.zeros(
            6
        )  # of a stand that is not over: begin, end, heading; count, ahead, left

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        A standstill of over a second counts once it has ended.
        """
        imu, moves = window.imu, window.moves
        if imu is None or window.rims is None or len(moves.t) < 3:
            return []
        t = imu.t[imu.inside]
        x = imu.x[imu.inside]
        rims = np.abs(imu.rims[imu.inside]).max(axis=1)
        still = (
            (rims < 1e-3) & (np.abs(moves.at(t, SPEED)) < MOVES / 2) & (np.abs(x[:, GYRO]) < 0.02)
        )
        heading = moves.at(t, 2)
        stamp = imu.stamp[imu.inside]
        edges = np.flatnonzero(np.diff(still)) + 1
        for part, flags in zip(
            np.split(np.arange(t.size), edges), np.split(still, edges), strict=True
        ):
            if part.size and flags[0]:
                if not self._open[3]:
                    self._open[[0, 2]] = stamp[part[0]], heading[part[0]]
                self._open[1] = stamp[part[-1]]
                self._open[3:] += [part.size, x[part, AHEAD].sum(), x[part, LEFT].sum()]
            if part.size and (not flags[0] or part[-1] < t.size - 1):
                self._close()
        return self._judged() if len(self.stands) >= STANDS else []

    def _close(self) -> None:
        begin, end, heading, count, ahead, left = self._open
        self._open = np.zeros(6)
        if end - begin > 1.0 and np.isfinite(heading + ahead + left):
            self.stands.append(np.array([heading, ahead / count, left / count]))

    def _judged(self) -> list[Said]:
        heading, ahead, left = np.array(self.stands).T
        shown = np.r_[ahead, left] / self._gravity
        c, s, one = np.cos(heading), np.sin(heading), np.ones(len(heading))
        design = np.vstack(
            [np.column_stack([c, s, one, 0 * one]), np.column_stack([-s, c, 0 * one, one])]
        )
        rest = shown - design @ np.linalg.lstsq(design, shown, rcond=None)[0]
        variance = max(float(rest @ rest) / (len(shown) - 4), 0.01**2)
        covariance = np.linalg.inv(design.T @ design / variance + np.eye(4) / USUAL**2)
        found = covariance @ design.T @ shown / variance
        std = np.sqrt(np.diag(covariance))
        sure = float(stdtrit(len(shown) - 4, 1.0 - 0.5 * TILT_CHANCE))
        return [
            Said(
                "imu",
                float(found[i]),
                f"it shows {np.degrees(found[i]):+.1f} +- {np.degrees(std[i]):.1f} degrees ({word} up)"
                " whichever way the vehicle stands: level it",
            )
            for i, word in ((2, "nose"), (3, "left side"))
            if abs(found[i]) > max(TILT, sure * std[i])
        ]
