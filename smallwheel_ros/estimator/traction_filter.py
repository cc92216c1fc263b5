# SPDX-License-Identifier: Apache-2.0
"""The soil's strength and the grip at a place, from what a vehicle's wheels pull.

State x: `traction_state`.

Prediction, for each cell that the vehicle moves on: the wheels behind come to the cells of those
before them, g_0 <- a g_0 with a = exp(-0.1 m / 0.7 m); Q: of g_0 (1 - a^2) 0.25^2, of d its prior's,
and of c, phi and ln K so much that they are open again after 200 m. As the law becomes better known,
s' < s, its error of before has the share (s'/s)^2 of what is left in it, since an update leaves what
does not depend on it: e <- (s'/s) e, Q: 1 - (s'/s)^2.

Measurements, of means over a step of the path: with the thrust H_w = e^g H(W, i', l; c, phi, K) of each
wheel (Janosi and Hanamoto 1961) and its motion resistance B_w = R_w + e s_w + rho W_w, R_w and its
deviation s_w from the law,

where i' = i + d + d_w + eta z/D: a rigid wheel shears soil by rolling alone (Wong and Reece 1967),
r ((theta_0 - theta) - (sin theta_0 - sin theta)), which is r theta_0^3 / 8 in the mean over the arc, or
that of a slip of theta_0^2 / 4 = z/D. Of a tread that yields less is left of it.

    balance   sum over wheels (H_w - B_w) = M (a -+ b)    a: specific force g sin(slope) + dv/dt, - forward
    torque    e^t_w H_w + f W_w = T_w / arm,  arm = (D/2) theta_0 / sin theta_0
    pull      H_w - B_w = drawbar pull

R of the balance: (M sigma_a)^2 and what law and grip leave unexplained of each wheel's thrust; of a pull
also s_w^2, the part of the law's error that is the wheel's own.
H: analytic, at the state after the update (`traction_update`). A measurement that is 4 standard
deviations off opens the grip of all cells again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray

from smallwheel_ros.estimator.path_steps import CELL
from smallwheel_ros.estimator.traction_samples import RollingContact, Thrust, Torque, WheelStep
from smallwheel_ros.estimator.traction_state import (
    COHESION,
    FRICTION,
    GRIP_STD,
    LAW,
    LEVEL,
    LOSS,
    OTHER,
    ROLLING,
    SHEAR,
    SLIP,
    SLIP_STD,
    STRENGTH,
    WHEELS,
    prior,
)
from smallwheel_ros.estimator.traction_update import Predicted, iterated_update
from smallwheel_ros.physics.point_thrust import point_contact_length, point_thrust
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

Array = NDArray[np.float64]

# Of a step's thrust, what law and grip leave unexplained, over the thrust. Forms of the shear curve are most
# of it, and they do not average out: with less than this the strength gets surer than it is.
_UNEXPLAINED = 0.14
_ARM_STD = 0.05  # of the lever, which is that of an even stress
_GRIP_LENGTH = 0.7  # m
_OPEN_AFTER = 200.0  # m
_LEAST_TORQUE = 0.25  # N at the rim: resolution of any torque
_SURPRISE = 4.0
_WIDEST = 1.0  # a factor of e either way: over that a thrust is not known at all


class TractionFilter:
    """See the module. kalman: filterpy's filter, x and P of it are the state."""

    def __init__(self, strength: Strength, wheels: Sequence[Wheel], mass: float = 0.0) -> None:
        """Begin at the prior. mass: of the vehicle, kg, 0: not known."""
        self.mass = mass
        places = [wheel.longitudinal_position for wheel in wheels]
        first, last = max(places, default=0.0), min(places, default=0.0)
        self._behind = [round((first - place) / CELL) for place in places]
        self._ahead = [round((place - last) / CELL) for place in places]
        self._cells = round((first - last) / CELL) + 1
        self.order = {wheel.name: i for i, wheel in enumerate(wheels)}
        self.cell_of = self._behind  # of each wheel, the one that it is on
        self._scale, self._grip = WHEELS + len(places), WHEELS + 2 * len(places)
        mean, deviations = prior(strength, len(places), self._cells)
        self.prior_mean, self.prior_deviations = mean[:STRENGTH], deviations[:STRENGTH]
        self.kalman = ExtendedKalmanFilter(dim_x=len(mean), dim_z=1)
        self.kalman.x, self.kalman.P = mean.copy(), np.diag(np.square(deviations))
        self._moved = 0.0  # m since the last cell
        self._way = 1.0  # -1: backward
        self._law_std = math.inf  # least deviation of the resistances so far, over load

    # -- the strength of a soil

    @property
    def strength(self) -> tuple[Array, Array]:
        """Mean and covariance of (c, phi, ln K, rho)."""
        return self.kalman.x[:STRENGTH].copy(), self.kalman.P[:STRENGTH, :STRENGTH].copy()

    @strength.setter
    def strength(self, known: tuple[Array, Array]) -> None:
        """Go on on another soil."""
        mean, covariance = known
        self.kalman.x[:STRENGTH] = mean
        self.kalman.P[:STRENGTH, :] = self.kalman.P[:, :STRENGTH] = 0.0
        self.kalman.P[:STRENGTH, :STRENGTH] = covariance
        self._law_std = math.inf
        self._renew_law(0.0)

    def hand_over(self, alike: float) -> None:
        """Go on on another soil that nobody has met. alike: correlation of its strength with this one's."""
        mean, covariance = self.strength
        left = (1.0 - alike**2) * np.diag(np.square(self.prior_deviations))
        off = mean - self.prior_mean
        self.strength = self.prior_mean + alike * off, alike**2 * covariance + left

    def other_resistance(self, contact: RollingContact) -> tuple[float, float]:
        """Resistance (N) beyond that of the law as it is estimated.

        Beside it the deviation (N) of what the law does not give.
        """
        x, load = self.kalman.x, contact.load
        value = float(x[OTHER] * load + x[LAW] * contact.resistance.standard_deviation)
        return value, load * math.sqrt(self.kalman.P[OTHER, OTHER])

    def variance(self, row: Array) -> float:
        """Of a quantity with these slopes by the state, shape (size,)."""
        return float(row @ self.kalman.P @ row)

    # -- the zero of the imu

    @property
    def level(self) -> float:
        """Zero of the imu as it is believed, as a force forward per mass, m/s^2."""
        return float(self.kalman.x[LEVEL])

    def widen_level(self, variance: float) -> None:
        """Be less sure of it by so much, (m/s^2)^2."""
        self.kalman.P[LEVEL, LEVEL] += variance

    def use_level(self, zero: Quantity) -> None:
        """Use a measurement of it, m/s^2."""
        row = np.zeros(len(self.kalman.x))
        row[LEVEL] = 1.0
        iterated_update(
            self.kalman, zero.value, lambda: (self.level, row), zero.standard_deviation**2
        )

    # -- prediction

    def move(self, distance: float, forward: bool, slip_std: float = SLIP_STD) -> None:
        """Predict over a distance (m): to the next cells of ground, and to a new error of slip.

        slip_std: of that error, which all wheels have in common.
        """
        self._way = 1.0 if forward else -1.0
        cells = self._behind if forward else self._ahead
        if cells != self.cell_of:
            self.cell_of = cells
            self._open()
        self._moved += distance
        steps = int(self._moved / CELL + 0.5)
        self._moved -= steps * CELL
        for _ in range(min(steps, 2 * self._cells)):  # further on nothing is left of the cells
            self._predict(True, slip_std)
        if not steps:
            self._predict(False, slip_std)

    def _predict(self, onward: bool, slip_std: float) -> None:
        kalman, size = self.kalman, len(self.kalman.x)
        F, Q, grip = np.eye(size), np.zeros((size, size)), self._grip
        F[SLIP, SLIP] = 0.0
        Q[SLIP, SLIP] = slip_std**2
        if onward:
            kept = math.exp(-CELL / _GRIP_LENGTH)
            F[grip:, grip:] = np.eye(self._cells, k=-1)
            F[grip, grip] = kept
            Q[grip, grip] = GRIP_STD**2 * (1.0 - kept**2)
            drift = np.square(self.prior_deviations[:OTHER]) * 2.0 * CELL / _OPEN_AFTER
            Q[range(OTHER), range(OTHER)] = drift
        kalman.F, kalman.Q = F, Q
        kalman.predict()

    def _renew_law(self, kept: float) -> None:
        """Predict over a change of the law's estimate; kept: of the old error in the new one."""
        kalman = self.kalman
        kalman.x[LAW] *= kept
        kalman.P[LAW, :] *= kept
        kalman.P[:, LAW] *= kept
        kalman.P[LAW, LAW] += 1.0 - kept**2

    def _open(self) -> None:
        """Believe again in any grip of the cells; what they have in common with the rest goes."""
        P, grip = self.kalman.P, self._grip
        before = np.diag(P)[grip:].copy()
        P[grip:, :grip] = P[:grip, grip:] = 0.0
        P[grip:, grip:] = np.diag(before + GRIP_STD**2)

    # -- measurements

    def update(self, wheels: Sequence[WheelStep], specific_force: Quantity | None) -> None:
        """Use the means of a step. specific_force: m/s^2 along the travel, None: not known."""
        law = load = 0.0
        for wheel in wheels:
            law += wheel.contact.resistance.standard_deviation
            load += wheel.contact.load
        if law < self._law_std * load:
            self._renew_law(law / load / self._law_std)
            self._law_std = law / load
        pushes = [self.thrust(wheel) for wheel in wheels]
        unexplained = [
            (_UNEXPLAINED * push.value) ** 2 + (wheel.doubt * push.by_slip) ** 2
            for push, wheel in zip(pushes, wheels, strict=True)
        ]
        own = [push.own(w.contact) for push, w in zip(pushes, wheels, strict=True)]
        if specific_force is not None and self.mass > 0.0:
            noise = (self.mass * specific_force.standard_deviation) ** 2
            noise += sum(unexplained) + sum(own)
            self._use(self.mass * specific_force.value, partial(self._total, wheels), noise)
        for wheel, push, spread, alone in zip(wheels, pushes, unexplained, own, strict=True):
            if wheel.torque is not None:
                force = wheel.torque / wheel.contact.arm
                noise = _of_torque(force) + spread + push.own(wheel.contact, resisted=False)
                self._use(force, partial(self._turned, wheel), noise)
            if wheel.pull is not None:
                noise = wheel.pull.standard_deviation**2 + spread + alone
                noise += wheel.contact.resistance.standard_deviation**2  # the wheel's own part
                self._use(wheel.pull.value, partial(self._pull, wheel), noise)

    def _use(self, measured: float, predict: Callable[[], Predicted], noise: float) -> None:
        """Update by a measurement; predict: h(x) and H at the state as it is then."""
        value, row = predict()
        surprise = (measured - value) ** 2 / _SURPRISE**2
        if surprise > self.variance(row) + noise:
            self._open()
            # What no grip explains counts as little as it is likely.
            noise += max(surprise - self.variance(row) - noise, 0.0)
        iterated_update(self.kalman, measured, predict, noise)

    def torque(self, wheel: WheelStep, measured: float, noise: float) -> Torque:
        """What a torque (N m) of this moment tells of a wheel; the state stays as it is.

        noise: variance (N^2) of the wheel's thrust about that of the filter.
        """
        expected, row = self._turned(wheel)
        force = measured / wheel.contact.arm
        scale = math.exp(self.kalman.x[self._scale + wheel.order])
        shared = self.kalman.P @ row
        variance = float(row @ shared) + scale**2 * noise + _of_torque(force)
        return Torque(force - expected, variance, shared, scale * noise)

    def thrust(
        self, wheel: WheelStep, length: tuple[float, float] | None = None, exact_slip: bool = False
    ) -> Thrust:
        """Thrust of a wheel, and its slopes.

        length: of the contact (m), and its slope by the sinkage, where it is not its own. exact_slip:
        the slip has neither the error of measured ones nor the part of rolling, so that thrust depends
        on the sinkage by the length alone.
        """
        x, contact = self.kalman.x.tolist(), wheel.contact
        cell = self._grip + self.cell_of[wheel.order]
        if length is None:
            length = point_contact_length(contact.sinkage, contact.diameter)
        factor = contact.thrust_factor * math.exp(x[cell])
        slip, rolling = wheel.slip, contact.sinkage / contact.diameter
        if not exact_slip:
            slip += x[ROLLING] * rolling + x[SLIP] + x[WHEELS + wheel.order]
        push = point_thrust(
            contact.load,
            min(max(slip, -1.0), 1.0),
            length[0],
            contact.width,
            x[COHESION],
            x[FRICTION],
            math.exp(x[SHEAR]),
        )
        value, by_slip = factor * push.value, factor * push.by_slip
        row = np.zeros(len(x))
        row[COHESION] = factor * push.by_cohesion
        row[FRICTION] = factor * push.by_friction
        row[SHEAR] = factor * push.by_log_shear
        row[cell] = value
        if not exact_slip:
            row[SLIP] = row[WHEELS + wheel.order] = by_slip
            row[ROLLING] = by_slip * rolling
        by_log_load = factor * push.by_load * contact.load
        return Thrust(value, row, by_slip, by_log_load, factor * push.by_length * length[1])

    def spread(self, push: Thrust, row: Array) -> float:
        """Mean square deviation (N^2) of a force that a thrust is in; row: its slopes by the state.

        What soil and grip hold is a product of factors, each known by its share: it is taken to be
        lognormal, with the value as its median. Known to 60 %, it may well be three times as much.
        """
        P, share = self.kalman.P, 0.0
        if push.value:
            factors = push.row / push.value
            factors[OTHER : self._grip] = 0.0
            share = min(float(factors @ P @ factors), _WIDEST)
        more = math.expm1(2.0 * share) - 2.0 * math.expm1(0.5 * share) - share
        return float(row @ P @ row) + more * push.value**2

    def net(self, push: Thrust, contact: RollingContact) -> Predicted:
        """Thrust less all resistance (N), and its slopes by the state."""
        row = push.row.copy()
        row[OTHER], row[LAW] = -contact.load, -contact.resistance.standard_deviation
        beyond = float(row[OTHER : LAW + 1] @ self.kalman.x[OTHER : LAW + 1])
        return push.value - contact.resistance.value + beyond, row

    def _pull(self, wheel: WheelStep) -> Predicted:
        return self.net(self.thrust(wheel), wheel.contact)

    def _total(self, wheels: Sequence[WheelStep]) -> Predicted:
        values, rows = zip(*map(self._pull, wheels), strict=True)
        row = np.sum(rows, axis=0)
        row[LEVEL] = self._way * self.mass
        return sum(values) + row[LEVEL] * self.level, row

    def _turned(self, wheel: WheelStep) -> Predicted:
        push, x, load = self.thrust(wheel), self.kalman.x, wheel.contact.load
        place = self._scale + wheel.order
        scale = math.exp(x[place])
        row = scale * push.row
        row[place], row[LOSS] = scale * push.value, load
        return scale * push.value + float(x[LOSS]) * load, row


def _of_torque(force: float) -> float:
    """Variance (N^2) of a thrust that a torque shows."""
    return (_ARM_STD * force) ** 2 + _LEAST_TORQUE**2
