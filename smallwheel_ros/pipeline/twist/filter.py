# SPDX-License-Identifier: Apache-2.0
"""The filter of `twist`: nine states of a vehicle whose rims slip, driven by its imu.

The states are the vehicle's speeds vx ahead and vy to the left, the offsets b and the places c of the imu
(two each), and the slip speeds s of the left side, of the right side and sideways. w is the yaw rate.

    d vx/dt =  w vy + ax - bx - cx w^2       imu on a body that turns (Yi et al. 2009, IEEE T-RO 25(5));
    d vy/dt = -w vx + ay - by - cy w^2       b: slope and zero, c: place of the imu
    rim     = vx - chi y w + s               of each side, y left of the middle; chi: effective over
                                             geometric track (Martinez et al. 2005, Pentzer et al. 2014)
    0       = vy + sy                        no motion sideways (Dissanayake et al. 2001), with a slip sy
                                             as uncertain as those of the rims
    ds/dt   = -s / (2 s) + noise             standard deviation of s: slip |rim|
    slip^2  = mean of s^2 / rim^2 over a minute, each weighted by how well the sensors showed it, and an
                                             initial value
    rim     is reduced by a steady share of it, which only a speed over ground shows; in gaps of that speed
            the last share is used. Using the pull as well was no better (docs/odometry.md)
    var vx  = P + (slip vx)^2 + (delay a)^2  slip that does not change is seen by no imu: taken as large
                                             as the slip that does; delays that are not known

Let r = 1 - var s / (slip rim)^2 be the share of the slip's variance that the sensors showed. The mean of
s^2 - r (1 - r) (slip rim)^2 is then r^2 times the true square of the slip speed, so that it counts as a
measurement of slip^2 with the weight r^2. Expectation-maximisation would use s^2 + var s with the weight 1;
since var s is what was believed before, the initial value would stay for minutes.
The scatter of the rims and their delay are learnt as well.

Rims that jump while the accelerometer feels nothing increase s, and with it slip; then vx follows from the
imu for some seconds, and its variance grows. Inputs that are missing are left out: without an accelerometer
the velocity may change by 1 m/s in a second, without a gyro the turn follows from the rims alone. No
constant was fitted to a vehicle.
"""

from __future__ import annotations

import math

import numpy as np

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.pipeline.tables import Array, Flags

_VX, _VY, _BX, _BY, _CX, _CY, _SL, _SR, _SY = range(9)
_CHI_STD = 0.5  # 1 steered or on one axle, 1.5 to 2 skid steering
_LEAST_CHI, _MOST_CHI = 0.8, 5.0  # an effective track is hardly narrower than the geometric one
_MEMORY = 60.0  # s of driving over which slip, delay and track are learnt
_SLIP_TIME = 2.0  # s that a slip lasts
_SLIP = 0.3  # to begin with, known by a factor of 3: 0.03 is asphalt, 1 is ice
# s of driving after which the measured slips count as much as this initial value.
_SLIP_WEIGHT = 4.0 * _SLIP_TIME / (2.0 * math.log(3.0)) ** 2
_LEAST_SLIP = 0.02  # effective radii are known no better
_TILT, _TILT_TIME = 0.3, 10.0  # m/s^2: slope of 2 degrees and zero of the accelerometer; s
_SHARE = 0.1  # of the rims' speed: steady slip and radii, until a speed over ground shows them
_SHARE_TIME = 300.0  # s after which the steady share is as uncertain again: another ground
_LEVER = 0.3  # m of the imu off the point about which the vehicle turns
_CREEP = 0.01  # m/s: part of a slip speed's deviation that does not grow with speed
_DRIVES = 0.2  # m/s at the rim, under which slip is noise
_RIM_STD, _LEAST_RIM_STD = 0.03, 0.003  # m/s, of one reading, at most and at least
_SPEED_STD = 0.02  # m/s: at least, of a speed over ground
_SYNC, _SYNC_WEIGHT = 0.1, 0.5  # s: deviation of the rims' delay at first, known to a factor of 2
_MOST_DELAY = 1.0  # s
_SLIPS = 16.0  # squared deviations: rims that are further off slip, and are not late
_UNFELT = 1.0  # m^2/s^3: an acceleration that is not measured, 1 m/s in a second
_STILL = 1.0  # s of rims at 0 after which the vehicle is taken to stand
_STEP = 0.02  # s: the shortest time over which a change of the rims counts as an acceleration
_EYE = np.eye(9)
_SEEN = np.zeros((3, 9))  # Jacobian of what is measured: left and right rim, no motion sideways
_SEEN[0, [_VX, _SL]] = _SEEN[1, [_VX, _SR]] = _SEEN[2, [_VY, _SY]] = 1.0
_MIDDLE = _SEEN[:2].mean(axis=0)
LONGEST = SECOND  # ns: after a longer time without rims the filter begins anew


class TwistFilter:
    """Kalman filter of speed, slip speeds and imu offsets of a vehicle; see the head of this module.

    Parameters
    ----------
    places
        Mean lateral position of the wheels of the left side and of the right side, positive to the left of
        the vehicle's middle, shape (2,), m.
    chi
        Initial ratio of effective to geometric track width, 1.
    """

    def __init__(self, places: Array, chi: float) -> None:
        self.places, self.half = places, 0.5 * float(places[0] - places[1])
        self.x: Array = np.zeros(9)
        self.P: Array = np.diag([0.25, 0.01, *[_TILT**2] * 2, *[_LEVER**2] * 2, 0.0, 0.0, 0.0])
        self.slip = _SLIP  # standard deviation of the slip speed over the rim's speed, at present
        self.slip2 = self.weight = 0.0  # weighted sum of measured slip^2, and sum of weights
        self.delay = _SYNC  # s by which rims may come late or early
        self.delay_sum = self.delay_weight = 0.0  # the same sums for the logarithm of delay^2
        self.chi, self.chi_var = chi, _CHI_STD**2
        self.share, self.share_var = 0.0, 0.0  # of the rims' speed that is lost throughout
        self.unseen = 0.0  # s since a speed over ground came
        self.turn2 = 0.1**2  # mean square error of the rims' yaw rate over 10 s of turning
        self.shakes2 = 0.1**2  # variance of one reading of the accelerometer
        self.gained = 0.0  # m/s^2: acceleration ahead, a mean over the last 0.3 s
        self.force = math.nan, math.nan  # specific force of the last row
        self.rims: Array = np.full(2, np.nan)
        self.before: Array = np.full(2, np.nan)  # rims of the row before
        self.rim2 = _RIM_STD**2  # variance of a rim's reading
        self.held = [0, 0]  # rows for which each side's rim has been the same to the last digit
        self.stands = 1.0  # rows for which a rim's value stays the same, over its last ten changes
        self.jump2 = 0.0  # m^2/s^2: mean square of the jumps of rims whose values come in steps
        self.still = 0.0  # s for which both rims have been 0
        self.turns = True  # whether the yaw rate of the last row is from a gyro
        self.period, self.count = 0.02, 0  # s: mean time between rows; rows in it, 20 at most

    def _begin(self, rims: Array) -> None:
        """Reset velocity and slip speeds after a gap; keep the imu's offsets and place, slip and track."""
        var = (self.slip * float(np.nanmax(np.abs(rims)))) ** 2
        for i, mean, own in ((_VX, float(np.nanmean(rims)), 0.25), (_VY, 0.0, 0.01)):
            self._set(i, mean, own + var)
        for i in (_SL, _SR, _SY):
            self._set(i, 0.0, var)
        self.gained = 0.0
        self.force = math.nan, math.nan
        self.rims, self.before = np.full((2, 2), np.nan)

    def _set(self, i: int, mean: float, variance: float) -> None:
        self.P[i] = self.P[:, i] = 0.0
        self.x[i], self.P[i, i] = mean, variance

    def step(self, apart: int, rims: Array, felt: Array, speed: float, speed_std: float) -> None:
        """Advance the filter to one instant of the rims, and update it there.

        Parameters
        ----------
        apart
            Time since the last instant, ns; after more than `LONGEST` the filter begins anew.
        rims
            Speed of the rims on the left and on the right, shape (2,), m/s; NaN for one that is unknown.
        felt
            Means since the last instant of yaw rate (rad/s), and of specific force ahead and to the left
            without gravity (m/s^2), shape (3,); NaN if unknown.
        speed, speed_std
            Speed over ground and its standard deviation, m/s; NaN if unknown.
        """
        dt = apart / SECOND
        self._teach(min(dt, LONGEST / SECOND), float(np.mean(rims)), speed, speed_std)
        rims = self._rolled(rims)
        if apart > LONGEST:
            self._begin(rims)
            dt = _STEP
        else:
            self.count = min(self.count + 1, 20)
            self.period += (dt - self.period) / self.count
        there = ~np.isnan(rims)
        known = np.where(there, rims, self.x[_VX])
        turn = float(felt[0])
        self.turns = not math.isnan(turn)
        if not self.turns:
            turn = (known[1] - known[0]) / (2.0 * self.chi * self.half) if there.all() else 0.0
        moved = rims - self.rims
        moved[np.isnan(moved)] = 0.0
        change = float(moved.sum()) / 2.0
        self._steps(moved)
        self._scatters(dt, rims)
        self.still = self.still + dt if not rims[there].any() else 0.0
        self.rims, self.before = rims, self.rims
        scale = self._on(dt, known, turn, felt[1:])
        self._see(dt, there, rims, turn, change / max(dt, _STEP))
        if not math.isnan(speed):
            R = max(speed_std, _SPEED_STD) ** 2 + (_SYNC * change / max(dt, _STEP)) ** 2
            self._update(_EYE[:1], np.array([speed]), np.array([[R]]))
        if np.nanmax(np.abs(rims)) > _DRIVES:
            self._learn(dt, there, rims, turn, scale)

    def _rolled(self, rims: Array) -> Array:
        """Speeds of the rims, reduced by the steady share of slip."""
        return np.asarray((1.0 - self.share) * rims)

    def _teach(self, dt: float, rim: float, speed: float, speed_std: float) -> None:
        """Learn the steady share of slip from a speed over ground.

        Slips last, so that readings are not independent. rim: mean of both sides' rims, m/s.
        """
        self.unseen += dt
        if self.share_var:
            self.share_var += dt * _SHARE**2 / _SHARE_TIME
        if math.isnan(speed + rim) or abs(rim) < _DRIVES:
            return
        before = self.share_var or _SHARE**2
        one = self.slip**2 + (max(speed_std, _SPEED_STD) / rim) ** 2
        noise = one * max(2.0 * _SLIP_TIME / self.unseen, 1.0)
        gain = before / (before + noise)
        self.share += gain * ((rim - speed) / rim - self.share)
        self.share_var = (1.0 - gain) * before
        self.unseen = 0.0

    def _steps(self, moved: Array) -> None:
        """Learn the steps of rims that hold a value over several rows and then jump.

        Means over their last ten changes, without those from 0. moved: change of each rim, m/s.
        """
        for i, by in enumerate(moved.tolist()):
            if by != 0.0 and self.rims[i] != 0.0:
                self.jump2 += 0.1 * ((by * by if self.held[i] > 1 else 0.0) - self.jump2)
                self.stands += 0.1 * (self.held[i] + 1 - self.stands)
            self.held[i] = self.held[i] + 1 if by == 0.0 else 0

    def _scatters(self, dt: float, rims: Array) -> None:
        """Learn the variance of a rim's reading from second differences: steady acceleration is no noise."""
        bend2 = float(np.mean((rims - 2.0 * self.rims + self.before) ** 2)) / 6.0
        if not math.isnan(bend2):
            bend2 = min(max(bend2, _LEAST_RIM_STD**2), _RIM_STD**2)
            self.rim2 += min(dt / 5.0, 1.0) * (bend2 - self.rim2)

    def _on(self, dt: float, rims: Array, turn: float, force: Array) -> Array:
        """Predict over dt (s) by the imu.

        Returns the speeds (m/s) to which the deviations of the left, right and sideways slip are
        proportional, (3,).
        """
        x = self.x
        keep, tilt = math.exp(-dt / _SLIP_TIME), math.exp(-dt / _TILT_TIME)
        F = _EYE.copy()
        F[_BX, _BX] = F[_BY, _BY] = tilt
        F[_SL, _SL] = F[_SR, _SR] = F[_SY, _SY] = keep
        ahead, aside = force.tolist()
        push = 0.0, 0.0
        if math.isnan(ahead):
            noise = _UNFELT * dt
            self.gained += min(dt / 0.3, 1.0) * (_UNFELT - self.gained)
        else:
            push = ahead * dt, aside * dt
            before = self.force
            change2 = 0.0
            if not math.isnan(before[0]):
                change2 = (ahead - before[0]) ** 2 + (aside - before[1]) ** 2
            self.shakes2 += min(dt / 5.0, 1.0) * (change2 / 4.0 - self.shakes2)
            noise = (
                0.1**2 * dt + 4.0 * self.shakes2 * dt**2
            )  # vibration is not white: twice its deviation
            self.gained += min(dt / 0.3, 1.0) * (ahead - float(x[_BX]) - self.gained)
            c, s, out = math.cos(turn * dt), math.sin(turn * dt), -turn * turn * dt
            F[_VX, _VX], F[_VX, _VY], F[_VX, _BX], F[_VX, _CX] = c, s, -dt, out
            F[_VY, _VX], F[_VY, _VY], F[_VY, _BY], F[_VY, _CY] = -s, c, -dt, out
        self.force = ahead, aside
        left, right = (abs(rim) + 0.5 * math.sqrt(self._jumps2) for rim in rims.tolist())
        low = 0.5 * abs(float(x[_VX]))  # a wheel that is locked slips, too
        scale = np.array([max(left, low), max(right, low), max(left, right, low)])
        self.x = F @ x
        self.x[0] += push[0]
        self.x[1] += push[1]
        tilts = _TILT**2 * (1.0 - tilt * tilt)
        self.P = F @ self.P @ F.T
        added = self.P.reshape(-1)[::10]  # the diagonal
        added[:4] += (noise, noise, tilts, tilts)
        added[_SL:] += ((self.slip * scale) ** 2 + _CREEP**2) * (1.0 - keep * keep)
        return scale

    @property
    def _jumps2(self) -> float:
        return self.jump2 if self.still < _STILL else 0.0

    def _see(self, dt: float, there: Flags, rims: Array, turn: float, change: float) -> None:
        """Update with the rims, and with no motion sideways.

        there: which rims are known. turn: yaw rate, rad/s. change: acceleration of the rims, m/s^2.
        """
        left, right = (self.places * turn).tolist()
        late = (self.delay * change) ** 2
        # A value that holds for a while is off by any part of the next jump.
        own = self.rim2 + late + self._jumps2 / 3.0
        both = self.chi_var * left * right + late
        R = np.array(
            [
                [own + self.chi_var * left * left, both, 0.0],
                [both, own + self.chi_var * right * right, 0.0],
                [0.0, 0.0, _RIM_STD**2],
            ]
        )
        if not self.turns:  # the turn is from the sides' difference, which measures nothing more
            way = np.sign(self.places)
            R[:2, :2] += (0.1 + abs(self.half * turn)) ** 2 * way[:, None] * way
        z = np.array([rims[0] + self.chi * left, rims[1] + self.chi * right, 0.0])
        if there.all():
            if not math.isnan(self.force[0]):
                self._delays(dt, float(z[0] + z[1]) / 2.0, float(R[:2, :2].mean()), late)
            self._update(_SEEN, z, R)
        else:
            rows = np.flatnonzero([*there, True])
            self._update(_SEEN[rows], z[rows], R[rows[:, None], rows])

    def _delays(self, dt: float, middle: float, R: float, late: float) -> None:
        """Learn the rims' delay from the difference between their mean and what the imu predicts.

        middle: mean of both sides' rims, without the turn, m/s. R: its variance; late: the part of R that is
        due to delay, m^2/s^2. The logarithm of delay^2 is learnt, by the slope of the likelihood and Fisher's
        information. The delay is at least as uncertain as the time for which a rim's value stays the same.
        """
        S = float(_MIDDLE @ self.P @ _MIDDLE) + R
        off2, share = (middle - float(_MIDDLE @ self.x)) ** 2 / S, late / S
        fade, now = math.exp(-dt / _MEMORY), 2.0 * math.log(self.delay / _SYNC)
        told = 0.5 * share * share
        self.delay_weight = fade * self.delay_weight + told
        self.delay_sum = (
            fade * self.delay_sum + told * now + 0.5 * share * (min(off2, _SLIPS) - 1.0)
        )
        log = 0.5 * self.delay_sum / (self.delay_weight + _SYNC_WEIGHT)
        least = min(self.stands * self.period / math.sqrt(12.0), _SYNC)
        self.delay = max(_SYNC * math.exp(min(log, math.log(_MOST_DELAY / _SYNC))), least)

    def _learn(self, dt: float, there: Flags, rims: Array, turn: float, scale: Array) -> None:
        """Learn slip and track from the present state. scale: what `_on` returned."""
        fade = math.exp(-dt / _MEMORY)
        self.slip2 *= fade
        self.weight *= fade
        for i in np.flatnonzero(there).tolist():
            rim2, s = float(scale[i]) ** 2, float(self.x[_SL + i])
            if not rim2 > 0.0:  # a side at rest shows nothing of its slip
                continue
            usual = self.slip**2 * rim2 + _CREEP**2
            share = min(max(1.0 - float(self.P[_SL + i, _SL + i]) / usual, 0.0), 1.0)
            seen = s * s - share * (1.0 - share) * usual - share**2 * _CREEP**2
            self.slip2 += dt * seen / rim2
            self.weight += dt * share**2
        self._believe()
        if not (there.all() and self.turns):
            return
        h, half = float(rims[1] - rims[0]) / 2.0, self.half * turn
        if abs(turn) > 0.1 or abs(h) > 0.1:
            missed = h / (self.chi * self.half) - turn
            self.turn2 += min(dt / 10.0, 1.0) * (missed * missed - self.turn2)
            r = (0.1 + 0.2 * abs(h)) ** 2 / max(dt, 1e-6)  # one reading a second, whatever the rate
            self.chi_var += dt * 0.01**2
            gain = self.chi_var * half / (half * half * self.chi_var + r)
            self.chi += gain * (h - self.chi * half)
            self.chi = min(
                max(self.chi, _LEAST_CHI), _MOST_CHI
            )  # a gyro of the wrong sign stays so
            self.chi_var *= 1.0 - gain * half

    def _believe(self) -> None:
        """Estimate slip from its measured squares and the initial value: Newton's method for ln slip^2."""
        seen, beginning = max(self.slip2, self.weight * _LEAST_SLIP**2), 2.0 * math.log(_SLIP)
        log = 2.0 * math.log(self.slip)
        for _ in range(2):
            more = seen * math.exp(-log)
            less = self.weight + _SLIP_WEIGHT * (log - beginning)
            log += max((more - less) / (more + _SLIP_WEIGHT), -1.0)
        self.slip = math.exp(0.5 * log)

    def _update(self, H: Array, z: Array, R: Array) -> None:
        """Update with measurements z = H x of covariance R. P stays symmetric; R is never near 0."""
        HP = H @ self.P
        G = np.linalg.solve(HP @ H.T + R, HP).T
        self.x = self.x + G @ (z - H @ self.x)
        P = self.P - G @ HP
        self.P = 0.5 * (P + P.T)

    def told(self, rims: Array, later: list[tuple[float, Array]]) -> tuple[float, ...]:
        """Compute the twist to publish at a row, from the present state.

        Parameters
        ----------
        rims
            Speed of the rims on the left and on the right, shape (2,), m/s; NaN for one that is unknown.
        later
            For rims stamped late, the intervals from the instant of the state to the stamp: length (s), and
            means of yaw rate (rad/s) and specific force ahead and to the left (m/s^2), shape (3,), of the
            imu in it. Empty otherwise.

        Returns
        -------
        tuple of float
            The columns of `Twists` except the stamp: vx (m/s), its variance, variance of vy (m^2/s^2), yaw
            rate (rad/s), its variance (rad^2/s^2), slip (1), period (s).
        """
        x, slip, rims = self.x, self.slip, self._rolled(rims)
        vx, vy, var_x, var_y = float(x[0]), float(x[1]), float(self.P[0, 0]), float(self.P[1, 1])
        for dt, felt in later:
            turn, ahead, aside = felt.tolist()
            noise = _UNFELT * dt
            if not math.isnan(turn + ahead + aside):
                ahead, aside = (
                    ahead - x[_BX] - x[_CX] * turn**2,
                    aside - x[_BY] - x[_CY] * turn**2,
                )
                vx, vy = vx + dt * float(ahead + turn * vy), vy + dt * float(aside - turn * vx)
                noise = 0.1**2 * dt + 4.0 * self.shakes2 * dt**2
            var_x, var_y = var_x + noise, var_y + noise
        var_x += (self.delay * self.gained) ** 2 + (slip**2 + self.share_var) * vx**2
        effective = self.chi * self.half
        left, right = rims.tolist()
        if math.isnan(left + right):  # one side alone: the turn is its difference from the middle
            side, rim = (1, right) if math.isnan(left) else (0, left)
            arm = self.chi * float(self.places[side])
            yaw = (vx - rim) / arm
            noise = (var_x + _RIM_STD**2) / arm**2
        else:
            yaw = (right - left) / (2.0 * effective)
            noise = (_RIM_STD / effective) ** 2
        # In a turn the past errors include those of rims in steps; straight ahead they do not.
        noise += max(self.turn2 * min(1.0, (yaw / 0.1) ** 2), 0.5 * self._jumps2 / effective**2)
        if not self.turns:  # the effective track has not been measured
            noise += yaw * yaw * self.chi_var / self.chi**2
        return vx, var_x, var_y + vy**2, yaw, noise, slip, self.period
