# SPDX-License-Identifier: Apache-2.0
"""The soil's strength and the grip at a place, from what a vehicle's wheels pull.

State x, with the standard deviations of its prior:

    c, phi, ln K      cohesion, friction angle, shear deformation modulus      as configured
    rho               motion resistance that the law does not give, over load  0.04
    d                 error of the measured slips, common to all wheels        0.025 in each step
    t                 ln of the torque's scale                                 0.05
    eta               share of its rolling displacement by which a wheel shears soil  0.5, about 0.5
    g_0 .. g_N        ln of the grip, in cells of 0.1 m of the ground from under the first wheel to
                      under the last one                                       0.25

Prediction, for each cell that the vehicle moves on: the wheels behind come to the cells of those
before them, g_0 <- a g_0 with a = exp(-0.1 m / 0.7 m); Q: of g_0 (1 - a^2) 0.25^2, of d its prior's,
and of c, phi and ln K so much that they are open again after 200 m.

Measurements, of means over a step of the path: with the thrust H_w = e^g H(W, i + d, l; c, phi, K) of
each wheel (Janosi and Hanamoto 1961) and its motion resistance R_w,

where i + d is more by eta z/D: a rigid wheel shears soil by rolling alone (Wong and Reece 1967),
r ((theta_0 - theta) - (sin theta_0 - sin theta)), which is r theta_0^3 / 8 in the mean over the arc, or
that of a slip of theta_0^2 / 4 = z/D. Of a tread that yields little is left of it.

    balance   sum over wheels (H_w - R_w - rho W_w) = M f     f: specific force g sin(slope) + dv/dt
    torque    e^t H_w = T_w / arm,  arm = (D/2) theta_0 / sin theta_0
    pull      H_w - R_w - rho W_w = drawbar pull

R of the balance: (M sigma_f)^2, half of (sum of the deviations of R_w)^2, since wheels share the
law, and twice the scatter of each wheel's thrust, since near cells are not independent.
H: analytic. A measurement that is 4 standard deviations off opens the grip of all cells again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray

from smallwheel_ros.physics.point_thrust import point_contact_length, point_thrust
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

Array = NDArray[np.float64]

COHESION, FRICTION, SHEAR, OTHER, SLIP, TORQUE, ROLLING, GRIP = range(8)
STRENGTH = 4  # numbers of the state that belong to the soil
CELL = 0.1  # m
# Along one prepared rut the rig's pull varies by 1.2 N (median of 27 trials) of a limit of 12 N.
SCATTER = 0.1
_OTHER_STD, _SLIP_STD, _TORQUE_SCALE_STD, _TORQUE_STD = 0.04, 0.025, 0.05, 0.05
_ROLLING, _ROLLING_STD = 0.5, 0.5
_GRIP_STD, _GRIP_LENGTH = 0.25, 0.7  # m
_OPEN_AFTER = 200.0  # m
_LEAST_TORQUE = 0.4  # N at the rim, of any torque: friction of 0.05 N m in the drive
_NEAR = 2.0
_NEAR_TORQUE = 10.0  # torques of steps of one cell repeat one scatter, and one error of their scale
_SURPRISE = 4.0
# Where a strength is still one: thrust is linear in the cohesion, which may go below 0 a little.
_LOW = {COHESION: -300.0, FRICTION: 0.1, SHEAR: math.log(2e-3)}
_HIGH = {COHESION: 6000.0, FRICTION: 1.0, SHEAR: math.log(0.1)}
_MOST = 2.0  # of all others: a factor of 7 in grip or torque
# A strength that is configured as exact has to stay one that a filter can hold.
_LEAST_STD = (1.0, 1e-4, 1e-3)  # Pa, rad, ln K


class RollingContact(NamedTuple):
    """A wheel that rolls: load (N), sinkage, diameter, width (m), and its motion resistance (N).

    thrust_factor: of the model's effects on thrust, 1 without.
    """

    load: float
    sinkage: float
    diameter: float
    width: float
    resistance: Quantity
    thrust_factor: float = 1.0

    @property
    def arm(self) -> float:
        """Lever (m) of the thrust where shear stress is the same along the arc."""
        entry = math.acos(max(1.0 - 2.0 * self.sinkage / self.diameter, 0.0))
        return 0.5 * self.diameter * (entry / math.sin(entry) if entry > 1e-6 else 1.0)


class WheelStep(NamedTuple):
    """Means of one wheel over a step; torque (N m) and pull (N) None where not measured."""

    order: int
    contact: RollingContact
    slip: float
    torque: float | None = None
    pull: Quantity | None = None


class Thrust(NamedTuple):
    """Thrust (N), its slopes by the state, shape (size,), and by slip, ln load and contact length."""

    value: float
    row: Array
    by_slip: float
    by_log_load: float
    by_length: float


class TractionFilter:
    """See the module. kalman: filterpy's filter, x and P of it are the state."""

    def __init__(self, strength: Strength, wheels: Sequence[Wheel], mass: float = 0.0) -> None:
        """Begin at the prior. mass: of the vehicle, kg, 0: not known."""
        self.mass = mass
        places = [wheel.longitudinal_position for wheel in wheels]
        self._behind = [round((max(places) - place) / CELL) for place in places]
        self._ahead = [round((place - min(places)) / CELL) for place in places]
        self._cells = max(self._behind) + 1
        self.order = {wheel.name: i for i, wheel in enumerate(wheels)}
        self.cell_of = self._behind  # of each wheel, the one that it is on
        values = (strength.cohesion, strength.friction_angle, strength.shear_displacement)
        shear = min(max(values[2].value, 2e-3), 0.1)
        deviations = [q.standard_deviation for q in values]
        deviations[SHEAR] /= shear
        deviations = [max(a, b) for a, b in zip(deviations, _LEAST_STD, strict=True)]
        self.prior_mean = np.array([values[0].value, values[1].value, math.log(shear), 0.0])
        self.prior_deviations = np.array([*deviations, _OTHER_STD])
        rest = [_SLIP_STD, _TORQUE_SCALE_STD, _ROLLING_STD, *[_GRIP_STD] * self._cells]
        self.kalman = ExtendedKalmanFilter(dim_x=GRIP + self._cells, dim_z=1)
        self.kalman.x = np.array([*self.prior_mean, *[0.0] * len(rest)])
        self.kalman.x[ROLLING] = _ROLLING
        self.kalman.P = np.diag(np.square([*self.prior_deviations, *rest]))
        self._moved = 0.0  # m since the last cell

    # -- the strength of a soil

    @property
    def strength(self) -> tuple[Array, Array]:
        """Mean and covariance of (c, phi, ln K, rho)."""
        return self.kalman.x[:STRENGTH].copy(), self.kalman.P[:STRENGTH, :STRENGTH].copy()

    @strength.setter
    def strength(self, known: tuple[Array, Array] | None) -> None:
        """Go on on another soil; None: at the prior."""
        mean, covariance = known or (self.prior_mean, np.diag(np.square(self.prior_deviations)))
        self.kalman.x[:STRENGTH] = mean
        self.kalman.P[:STRENGTH, :] = self.kalman.P[:, :STRENGTH] = 0.0
        self.kalman.P[:STRENGTH, :STRENGTH] = covariance

    @property
    def other_share(self) -> tuple[float, float]:
        """Resistance that the law does not give, over load, and its standard deviation."""
        return float(self.kalman.x[OTHER]), math.sqrt(self.kalman.P[OTHER, OTHER])

    def variance(self, row: Array) -> float:
        """Of a quantity with these slopes by the state, shape (size,)."""
        return float(row @ self.kalman.P @ row)

    # -- prediction

    def move(self, distance: float, forward: bool) -> None:
        """Predict over a distance (m): to the next cells of ground, and to a new error of slip."""
        cells = self._behind if forward else self._ahead
        if cells != self.cell_of:
            self.cell_of = cells
            self._open()
        self._moved += distance
        steps = int(self._moved / CELL + 0.5)
        self._moved -= steps * CELL
        for _ in range(min(steps, 2 * self._cells)):  # further on nothing is left of the cells
            self._predict(True)
        if not steps:
            self._predict(False)

    def _predict(self, onward: bool) -> None:
        kalman, size = self.kalman, len(self.kalman.x)
        F, Q = np.eye(size), np.zeros((size, size))
        F[SLIP, SLIP] = 0.0
        Q[SLIP, SLIP] = _SLIP_STD**2
        if onward:
            kept = math.exp(-CELL / _GRIP_LENGTH)
            F[GRIP:, GRIP:] = np.eye(self._cells, k=-1)
            F[GRIP, GRIP] = kept
            Q[GRIP, GRIP] = _GRIP_STD**2 * (1.0 - kept**2)
            drift = np.square(self.prior_deviations[:OTHER]) * 2.0 * CELL / _OPEN_AFTER
            Q[range(OTHER), range(OTHER)] = drift
        kalman.F, kalman.Q = F, Q
        kalman.predict()

    def _open(self) -> None:
        """Believe again in any grip of the cells; what they have in common with the rest goes."""
        P, before = self.kalman.P, np.diag(self.kalman.P)[GRIP:].copy()
        P[GRIP:, :GRIP] = P[:GRIP, GRIP:] = 0.0
        P[GRIP:, GRIP:] = np.diag(before + _GRIP_STD**2)

    # -- measurements

    def update(self, wheels: Sequence[WheelStep], specific_force: Quantity | None) -> None:
        """Use the means of a step. specific_force: m/s^2 along the travel, None: not known."""
        scatter = [(SCATTER * self.thrust(w).value) ** 2 for w in wheels]
        if specific_force is not None and self.mass > 0.0:
            law = sum(w.contact.resistance.standard_deviation for w in wheels) ** 2
            noise = (self.mass * specific_force.standard_deviation) ** 2
            self._use(
                self.mass * specific_force.value,
                self._total(wheels),
                noise + 0.5 * law + _NEAR * sum(scatter),
            )
        for wheel, spread in zip(wheels, scatter, strict=True):
            if wheel.torque is not None:
                force = wheel.torque / wheel.contact.arm
                noise = _NEAR_TORQUE * (_of_torque(force) + spread)
                self._use(force, self._turned(wheel), noise)
            if wheel.pull is not None:
                noise = wheel.pull.standard_deviation**2 + spread
                noise += wheel.contact.resistance.standard_deviation**2
                self._use(wheel.pull.value, self._net(wheel), noise)

    def _use(self, measured: float, predicted: tuple[float, Array], noise: float) -> None:
        """Update by a measurement. predicted: h(x) and H at the state as it is."""
        kalman = self.kalman
        value, row = predicted
        surprise = (measured - value) ** 2 / _SURPRISE**2
        if surprise > self.variance(row) + noise:
            self._open()
            # What no grip explains counts as little as it is likely.
            noise += max(surprise - self.variance(row) - noise, 0.0)
        kalman.update(
            np.array([measured]),
            lambda _: row[None],
            lambda _: np.array([value]),
            R=np.array([[noise]]),
        )
        kalman.P = 0.5 * (kalman.P + kalman.P.T)
        for place, low in _LOW.items():
            kalman.x[place] = min(max(kalman.x[place], low), _HIGH[place])
        kalman.x[OTHER:] = np.clip(kalman.x[OTHER:], -_MOST, _MOST)

    def at_rim(self, wheel: WheelStep, torque: float) -> tuple[float, float]:
        """Thrust (N) that a torque (N m) of a wheel shows, and its variance."""
        force = torque / wheel.contact.arm / math.exp(self.kalman.x[TORQUE])
        return force, _of_torque(force)

    def thrust(
        self, wheel: WheelStep, length: float | None = None, exact_slip: bool = False
    ) -> Thrust:
        """Thrust of a wheel, and its slopes. length: of the contact (m), where it is not its own.

        exact_slip: the slip has neither the error of measured ones nor the part of rolling, so that
        thrust depends on the sinkage by the length alone.
        """
        x, contact = self.kalman.x.tolist(), wheel.contact
        cell = GRIP + self.cell_of[wheel.order]
        if length is None:
            length, _ = point_contact_length(contact.sinkage, contact.diameter)
        factor = contact.thrust_factor * math.exp(x[cell])
        rolling = 0.0 if exact_slip else contact.sinkage / contact.diameter
        slip = wheel.slip if exact_slip else wheel.slip + x[ROLLING] * rolling + x[SLIP]
        push = point_thrust(
            contact.load,
            min(max(slip, -1.0), 1.0),
            length,
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
            row[SLIP], row[ROLLING] = by_slip, by_slip * rolling
        return Thrust(
            value, row, by_slip, factor * push.by_load * contact.load, factor * push.by_length
        )

    def _net(self, wheel: WheelStep) -> tuple[float, Array]:
        push, load = self.thrust(wheel), wheel.contact.load
        push.row[OTHER] -= load
        held = wheel.contact.resistance.value + float(self.kalman.x[OTHER]) * load
        return push.value - held, push.row

    def _total(self, wheels: Sequence[WheelStep]) -> tuple[float, Array]:
        values, rows = zip(*map(self._net, wheels), strict=True)
        return sum(values), np.sum(rows, axis=0)

    def _turned(self, wheel: WheelStep) -> tuple[float, Array]:
        push, scale = self.thrust(wheel), math.exp(self.kalman.x[TORQUE])
        row = scale * push.row
        row[TORQUE] = scale * push.value
        return scale * push.value, row


def _of_torque(force: float) -> float:
    """Variance (N^2) of a thrust that a torque shows."""
    return (_TORQUE_STD * force) ** 2 + _LEAST_TORQUE**2
