# SPDX-License-Identifier: Apache-2.0
"""The soil's strength and the grip at a place, from what a vehicle's wheels pull: one filter (filterpy).

State x, with the standard deviations of its prior:

    c, phi, ln K      cohesion, friction angle, shear deformation modulus      as configured
                      of ln K in addition: shear curves of other forms         0.3
                      of phi in addition, for the margin: any ground           0.25
                      of c, for the margin: any ground's                       500 Pa, 500 Pa or more
    rho               motion resistance that is not in the law, over load      0.02
    d                 error of the measured slips, common to all wheels        0.025 in each step
    eta, mu           share of rolling in the shear, rim's friction over the soil's  as configured
    f                 friction of the drives at the rim, over load             0.01, mean 0.005
    b                 zero of the imu, as a force forward per mass             1.5 degrees of g
    d_1 .. d_W        error of each wheel's slip: its radius                   0.01
    t_1 .. t_W        ln of the scale of each wheel's torque                   0.1
    g_0 .. g_N        ln of the grip, in cells of 0.1 m of the ground from under the first wheel to
                      under the last one                                       0.25

Prediction, for each cell by which the vehicle moves: the rear wheels come to the cells of those
ahead of them, g_0 <- a g_0 with a = exp(-0.1 m / 0.7 m); Q: of g_0 (1 - a^2) 0.25^2, of d its
prior's, and of c, phi and ln K enough to be unknown again after 200 m.

Measurements, means over a step, all at once (thrust H_w, resistance B_w, torque T_w: `physics.stresses`):

    pull      P_w = h H_w - B_w - E_w - rho W_w          h, E_w: of the model's effects
    balance   sum over wheels P_w = M (a -+ b)           a: specific force g sin(slope) + dv/dt, - forward
    torque    e^t_w h T_w / r + f W_w, a force at the rim

The Jacobian H is taken at the slip at which the predicted law gives the measured pull: slope and speed
demand the pull, and slip follows from it and from the grip. The update is iterated (Bell and Cathey
1993): thrust is far from linear in slip, K and grip. A measurement that is 4 deviations off resets
the grip of all cells, and has a weight that falls with its likelihood.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel
from smallwheel_ros.pipeline.tables import Array

from .forces import (
    COHESION,
    FRICTION,
    LEVEL,
    LOSS,
    OTHER,
    RIM,
    ROLLING,
    SHEAR,
    SLIP,
    WHEELS,
    Force,
    Rolling,
    forces,
    pull_and_rim,
)  # fmt: skip
from .steps import CELL

STRENGTH = 4  # numbers of the state that are reported as the strength: c, phi, ln K, rho
GRIP_STD, SLIP_STD, LEVEL_STD, FORM_SHEAR = 0.25, 0.025, 0.257, 0.3
_OTHER_STD, _TORQUE_SCALE_STD, _RADIUS_STD = 0.02, 0.1, 0.01
_LOSS, _LOSS_STD = 0.005, 0.01
_LOW, _HIGH, _MOST = (-300.0, 0.1, math.log(2e-3)), (6000.0, 1.0, math.log(0.1)), 2.0
_LEAST_STD = (1.0, 1e-4, 1e-3, 1e-3, 1e-3)
_OF_WHEEL = (0.0, 0.2), (5.0, 1.5)  # least and largest of eta and mu, as at the bench
_MODELLED = [COHESION, FRICTION, SHEAR, ROLLING, RIM]  # numbers that a model file has
_LAW_ERROR, _TORQUE_ERROR, _LEAST_TORQUE = 0.02, 0.05, 0.25  # of the load; N at the rim
_GRIP_LENGTH, _OPEN_AFTER = 0.7, 200.0  # m
_ITERATIONS, _EXACT, _SURPRISE = 6, 1e-2, 4.0
_ONE_SITE = math.sqrt(0.5)  # correlation of the strengths of two soils that one vehicle crosses
Forces = tuple[Force, Force, Force]
_NEWTON_STEPS, _NEWTON_MOST, _LEAST_SLOPE = 2, 0.1, 0.1  # slip a step; of the load a unit of slip


class StrengthFilter:
    """Extended Kalman filter of soil strength, grip and errors of sensors; see the head of this module.

    Parameters
    ----------
    strength
        Prior of the soil's strength.
    wheels
        The rolling wheels.
    mass
        Mass of the vehicle, kg; 0 if unknown: then there is no balance.

    Attributes
    ----------
    kalman
        The filter of filterpy, with state x and covariance P.
    cells
        Number of the cell of ground (0.1 m) under each wheel, counted backwards from the first wheel in the
        direction of travel, shape (wheels,).
    prior_mean, prior_std
        Mean and standard deviations of (c, phi, ln K, rho) before any measurement, shape (4,).
    """

    def __init__(self, strength: Strength, wheels: tuple[Wheel, ...], mass: float) -> None:
        self.mass = mass
        places = np.array([wheel.longitudinal_position for wheel in wheels])
        first, last = (places.max(), places.min()) if places.size else (0.0, 0.0)
        self._behind = np.rint((first - places) / CELL).astype(int)
        self._ahead = np.rint((places - last) / CELL).astype(int)
        self.cells = self._behind
        count = int(self._behind.max(initial=0)) + 1
        self._grip = WHEELS + 2 * len(wheels)
        spread = np.zeros(self._grip + count)
        spread[[OTHER, SLIP, LOSS, LEVEL]] = _OTHER_STD, SLIP_STD, _LOSS_STD, LEVEL_STD
        spread[WHEELS:] = (
            [_RADIUS_STD] * len(wheels) + [_TORQUE_SCALE_STD] * len(wheels) + ([GRIP_STD] * count)
        )
        mean = np.zeros(spread.size)
        known = (
            strength.cohesion, strength.friction_angle, _log(strength.shear_displacement),
            strength.rolling_share, strength.rim_friction,
        )  # fmt: skip
        mean[_MODELLED], spread[_MODELLED] = np.array(known).T
        mean[LOSS] = _LOSS
        spread[_MODELLED] = np.maximum(spread[_MODELLED], _LEAST_STD)
        self.prior_mean, self.prior_std = mean[:STRENGTH], spread[:STRENGTH]
        self._prior, self._wheel_std = mean, spread[[ROLLING, RIM]]
        P = np.diag(np.square(spread))
        if strength.correlation is not None:
            own = spread[_MODELLED]
            P[np.ix_(_MODELLED, _MODELLED)] = strength.correlation * np.outer(own, own)
        self.kalman = ExtendedKalmanFilter(dim_x=mean.size, dim_z=1)
        self.kalman.x, self.kalman.P = mean, P
        self._moved, self._way, self._count, self._begun = 0.0, 1.0, count, False
        self._level, self._drag = (0.0, LEVEL_STD), 0.0

    def move(self, distance: float, forward: bool, slip_std: float) -> None:
        """Predict the state over a distance: the wheels move to new cells of ground, slips have a new error.

        Parameters
        ----------
        distance
            Distance driven since the last call, m. The wheels move by whole cells of 0.1 m; the remainder
            counts for the next call.
        forward
            Whether the vehicle goes forward; a change of direction resets the grip of all cells.
        slip_std
            Standard deviation of the new error of slip that is common to all wheels, 1.
        """
        self._way = 1.0 if forward else -1.0
        cells = self._behind if forward else self._ahead
        if self._begun and not np.array_equal(cells, self.cells):
            self._open()
        self._begun = True
        self.cells = cells
        self._moved += distance
        steps = int(self._moved / CELL + 0.5)
        self._moved -= steps * CELL
        for _ in range(min(steps, 2 * self._count)):
            self._predict(True, slip_std)
        if not steps:
            self._predict(False, slip_std)

    def _predict(self, onward: bool, slip_std: float) -> None:
        kalman, size, grip = self.kalman, self.kalman.x.size, self._grip
        F, Q = np.eye(size), np.zeros((size, size))
        F[SLIP, SLIP], Q[SLIP, SLIP] = 0.0, slip_std**2
        if onward:
            kept = math.exp(-CELL / _GRIP_LENGTH)
            F[grip:, grip:] = np.eye(self._count, k=-1)
            F[grip, grip], Q[grip, grip] = kept, GRIP_STD**2 * (1.0 - kept**2)
            drift = np.square(self.prior_std[:OTHER]) * 2.0 * CELL / _OPEN_AFTER
            Q[range(OTHER), range(OTHER)] = drift
        kalman.F, kalman.Q = F, Q
        kalman.predict()

    def level(self, zero: Array | None, drag: float) -> None:
        """Update the IMU's zero with what has been learnt about it elsewhere since the last call.

        Parameters
        ----------
        zero
            Present value and standard deviation of the zero ahead, by `rows.level`, shape (2,), m/s^2; None
            if unknown.
        drag
            Deceleration that wheels which are not listed may cause, m/s^2. It cannot be distinguished from
            the zero, whose deviation it increases, but only where it is larger than in all earlier calls.
        """
        kalman = self.kalman
        wider, value, precision = max(drag**2 - self._drag**2, 0.0), 0.0, 0.0
        self._drag = max(self._drag, drag)
        if zero is not None:
            less, value, precision = news(self._level, (float(zero[0]), float(zero[1])))
            wider, self._level = wider + less, (float(zero[0]), float(zero[1]))
        if wider > 0.0:
            kalman.P = kalman.P.copy()  # versions keep the one before
            kalman.P[LEVEL, LEVEL] += wider
        if precision > 0.0:
            H = np.zeros((1, kalman.x.size))
            H[0, LEVEL] = 1.0
            kalman.dim_z = 1
            R = np.array([[1.0 / precision]])
            kalman.update(
                np.array([value / precision]), lambda _: H, lambda x: x[LEVEL : LEVEL + 1], R=R
            )

    def _open(self) -> None:
        """Reset the grip of all cells: their prior variance is added, covariances with the rest become 0."""
        P, grip = self.kalman.P.copy(), self._grip
        self.kalman.P = P  # versions keep the one before
        before = np.diag(P)[grip:].copy()
        P[grip:, :grip] = P[:grip, grip:] = 0.0
        P[grip:, grip:] = np.diag(before + GRIP_STD**2)

    def update(
        self,
        at: Rolling,
        torque: Array,
        pull: Array,
        pull_std: Array,
        force: float,
        force_std: float,
    ) -> None:
        """Update the state from a step of the path; measurements that are unknown are NaN.

        Parameters
        ----------
        at
            The rolling wheels in the step.
        torque
            Torque of each, positive in the direction of travel, shape (wheels,), N m.
        pull, pull_std
            Drawbar pull of each and its standard deviation, shape (wheels,), N.
        force, force_std
            Specific force of the vehicle in the direction of travel, and its standard deviation, m/s^2.
        """
        turned, pulled = np.isfinite(torque), np.isfinite(pull)
        balanced = math.isfinite(force) and self.mass > 0.0
        of_all = np.array([self.mass * force] if balanced else [])
        z = np.concatenate([of_all, (2.0 * torque / at.diameter)[turned], pull[pulled]])
        if not z.size:
            return
        here = forces(self.kalman.x, self.cells, at)
        _, of_pull, of_rim = here
        law, own = np.square(_LAW_ERROR * at.on.reaching), of_pull.own(at.on)
        whole = [(self.mass * force_std) ** 2 + float((law + own).sum())] if balanced else []
        by_torque = np.square(_TORQUE_ERROR * at.on.reaching) + of_rim.own(at.on) + _LEAST_TORQUE**2
        noise = np.concatenate([whole, by_torque[turned], (law + own + pull_std**2)[pulled]])

        by_level = self._way * self.mass

        def shown(pulls: Array, rims: Array) -> Array:
            """Measurements predicted from pulls and rim forces (N), in the order of z."""
            value = (at.along * pulls).sum() + by_level * self.kalman.x[LEVEL]
            of_vehicle = np.array([value] if balanced else [])
            return np.concatenate([of_vehicle, rims[turned], pulls[pulled]])

        _, pulls, rims = self._asked(at, here, force, torque, pull)
        row = (at.share * pulls.row).sum(axis=0)[None]
        row[0, LEVEL] = by_level
        H = np.concatenate([row[: of_all.size], rims.row[turned], pulls.row[pulled]])
        value = shown(of_pull.value, of_rim.value)
        variance = np.einsum("ri,ij,rj->r", H, self.kalman.P, H)
        surprise = np.square((z - value) / _SURPRISE)
        if (surprise > variance + noise).any():
            self._open()
            variance = np.einsum("ri,ij,rj->r", H, self.kalman.P, H)
            # A measurement that no grip explains has the weight of its likelihood.
            noise = noise + np.maximum(surprise - variance - noise, 0.0)
        self._iterate(
            z, noise, value, H, lambda: shown(*pull_and_rim(self.kalman.x, self.cells, at))
        )

    def _asked(self, at: Rolling, made: Forces, force: float, torque: Array, pull: Array) -> Forces:
        """Forces, with slopes, at slips at which the predicted law gives the wheels' measured total pull.

        All slips are shifted by the same amount. Slope and speed demand a pull, and the measured slip follows
        from it and from the grip of the place. Slopes at the measured slip would treat places of different
        grip as one curve of pull over slip: too flat, and with too little friction.

        made: forces at the measured slip. force, torque, pull: as in `update`.
        """
        for _ in range(_NEWTON_STEPS):
            _, pulls, rims = made
            if math.isfinite(force) and self.mass > 0.0:
                zero = self._way * self.kalman.x[LEVEL]
                missing = self.mass * (force - zero) - (at.along * pulls.value).sum()
                slope = (at.along * pulls.by_slip).sum()
            else:
                by_pull = np.isfinite(pull)
                off = np.where(by_pull, pull - pulls.value, 2.0 * torque / at.diameter - rims.value)
                missing = np.nansum(off)
                slope = np.where(by_pull, pulls.by_slip, rims.by_slip)[np.isfinite(off)].sum()
            more = missing / max(slope, _LEAST_SLOPE * at.on.reaching.sum())
            slip = at.slip + min(max(more, -_NEWTON_MOST), _NEWTON_MOST)
            at = replace(at, slip=np.clip(slip, -1.0, 1.0))
            made = forces(self.kalman.x, self.cells, at)
        return made

    def _iterate(
        self, z: Array, noise: Array, value: Array, H: Array, predict: Callable[[], Array]
    ) -> None:
        kalman = self.kalman
        kalman.dim_z = z.size
        before, covariance = kalman.x, kalman.P
        for _ in range(_ITERATIONS):
            straight = value + H @ (before - kalman.x)
            kalman.x, kalman.P = before.copy(), covariance.copy()
            kalman.update(z, lambda _: H, lambda _, v=straight: v, R=np.diag(noise))
            kalman.x = bounded(kalman.x, self._prior)
            line = straight + H @ (kalman.x - before)
            value = predict()
            if (np.abs(value - line) < _EXACT * np.sqrt(noise)).all():
                break
        kalman.P = 0.5 * (kalman.P + kalman.P.T)

    @property
    def prior(self) -> list[float]:
        """Prior as 12 numbers, by which a saved state is recognised.

        Means of (c, phi, ln K, rho), their standard deviations, means of (eta, mu), and theirs.
        """
        of_wheel = self._prior[[ROLLING, RIM]].tolist(), self._wheel_std.tolist()
        return [*self.prior_mean.tolist(), *self.prior_std.tolist(), *of_wheel[0], *of_wheel[1]]

    @property
    def strength(self) -> tuple[Array, Array]:
        """Mean and covariance of (c, phi, ln K, rho), shape (4,) and (4, 4).

        Setting them makes their covariances with the rest of the state 0.
        """
        return self.kalman.x[:STRENGTH].copy(), self.kalman.P[:STRENGTH, :STRENGTH].copy()

    @strength.setter
    def strength(self, known: tuple[Array, Array]) -> None:
        self.kalman.x[:STRENGTH] = known[0]
        self.kalman.P[:STRENGTH, :] = self.kalman.P[:, :STRENGTH] = 0.0
        self.kalman.P[:STRENGTH, :STRENGTH] = known[1]

    def hand_over(self) -> None:
        """Start on a soil not met before: move (c, phi, ln K, rho) towards the prior.

        The strengths of two soils of one site are taken to have a correlation of sqrt(1/2): deviations of the
        mean from the prior are multiplied by that, the covariance by 1/2, and half of the prior's variance
        is added.
        """
        mean, covariance = self.strength
        left = (1.0 - _ONE_SITE**2) * np.diag(np.square(self.prior_std))
        off = mean - self.prior_mean
        self.strength = self.prior_mean + _ONE_SITE * off, _ONE_SITE**2 * covariance + left


def _log(length: Quantity) -> Quantity:
    """Ln of the shear displacement (m); its deviation includes differences between forms of shear curves."""
    relative = length.standard_deviation / length.value
    return Quantity(math.log(length.value), math.hypot(relative, FORM_SHEAR))


def bounded(x: Array, prior: Array) -> Array:
    """Limit the state to the range that a soil's strength can have, which always includes the prior.

    Parameters
    ----------
    x
        State, shape (size,).
    prior
        Mean of the state before any measurement, shape (size,).

    Returns
    -------
    ndarray
        The limited state, shape (size,).
    """
    inside = np.clip(x, -_MOST, _MOST)
    for place, low, high in ((range(OTHER), _LOW, _HIGH), ([ROLLING, RIM], *_OF_WHEEL)):
        inside[place] = np.clip(
            x[place], np.minimum(low, prior[place]), np.maximum(high, prior[place])
        )
    return inside


def news(before: tuple[float, float], now: tuple[float, float]) -> tuple[float, float, float]:
    """Compute the measurement, or the growth of variance, that leads from one estimate to a later one.

    Parameters
    ----------
    before, now
        Value and standard deviation, both in the same unit.

    Returns
    -------
    growth : float
        By how much the variance has grown; 0 if it has fallen.
    weighted, precision : float
        Of a measurement that would lead from `before` to `now`: its value times its precision, and the
        precision, which is 1 over its variance; both 0 if the variance has grown.
    """
    precision = now[1] ** -2 - before[1] ** -2
    if precision <= 0.0:
        return now[1] ** 2 - before[1] ** 2, 0.0, 0.0
    return 0.0, now[0] * now[1] ** -2 - before[0] * before[1] ** -2, precision
