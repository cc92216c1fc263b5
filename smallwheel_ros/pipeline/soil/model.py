# SPDX-License-Identifier: Apache-2.0
"""What sensors show under the soil's law: the state x, and h with its Jacobian H, for many stretches at once.

The law is p = k z^n D^m; K = k D^m is the modulus under one diameter. State:

    u    ln of the sinkage (m) of a reference wheel, the first one measured
    n    exponent of sinkage
    m    exponent of the wheel's diameter
    g    ln of the factor on sinkage in the rut of one wheel
    a    half of ln of the ratio of k under the left wheels to k under the right ones
    l    ln of the load cells' scale
    b    zero of the load cells, over the reference wheel's load W_ref
    s    slip sinkage: z (1 + s i) at slip i > 0
    t    s, by which sinkage is shown later than the load
    e    m/rad, error of the shown sinkage over pitch
    c    m, zero of all sinkage sensors
    f    ln of the scale of all sinkage sensors
    d_w, l_w   of each wheel, in addition: zero of its sensor (m), ln of the scale of its load cell

The measurements cannot determine f: a soil on which all sinkages are a twentieth smaller fits as
well. For a wheel with load W and slip i in a rut with exponent p

    h(x) = z(W'; z_ref, n, m) exp(g p + f) (1 + s max(i, 0)) + e pitch + c + d_w
    W'   = (W - b W_ref) exp(-l - l_w - t d ln W/dt - side a)        side: 1 left, -1 right

where z is the sinkage by the model's geometry and effects (`sinkage_of`), z_ref = exp(u), and p the exponent
`passes` of `Readings`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.model.nearby import neighbours, slopes
from smallwheel_ros.onboard.prior import EstimatorSettings, SoilPrior, covariates_of
from smallwheel_ros.physics.conditions import PRESSED, ROLLING, Conditions
from smallwheel_ros.physics.sinkage import CONTACT_RULES, Geometry
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.tables import Array, Columns, Flags, Integers, unknown

from .stretches import Stretches, WheelsUnderLoad

U, N, M, PASS, SIDE, LOAD_SCALE, LOAD_ZERO, SLIP, DELAY, PITCH, ZERO, SCALE, WHEELS = range(13)
LAW, EACH = 3, 2  # count of the law's numbers, and of those of each wheel from WHEELS on: d_w, l_w
# Prior deviations of what is learnt from the drive. The truth of some worlds in rates/drive_worlds.py is one
# to three of them off: sinkage x1.23 in a rut, loads 20 % or 6 N of 58 N, slip sinkage 3, 0.2 s, 0.03 m/rad.
_PASS_STD = 0.3  # of g
SIDE_STD = 0.3  # of a: soils under the two sides of a vehicle differ by a factor of 1.8
_LOAD_SCALE_STD = 0.1  # of l
_LOAD_ZERO_STD = 0.03  # of b
_SLIP_SINKAGE_STD = 1.0  # of s
# Relative deviation of what slip adds to a sinkage: where forms linear and quadratic in slip agree at 0.3,
# they differ by factors of 3 at 0.1 and 2 at 0.6 (effects/slip.py); where a wheel digs in, time matters, too.
_SLIP_DOUBT = 0.5
_DELAY_STD = 0.1  # s, of t
_PITCH_STD = 0.01  # m/rad, of e
_SINKAGE_SCALE_STD = (
    0.05  # of f: a range sensor 18 degrees off the vertical along which it is taken to look
)
# On the deviations of passes and of the common zero where nothing is wrong; on that of ln pressure where
# the soil may not be the one that was named: sand is firm in places, by 2 to 4.6 of the prior's deviations
# in drives of another author, which n and the zeros then had to make up for.
_FAULT_FREE, _MISNAMED = 0.1, 2.0
LEAST_SHARE = 0.15  # of the shown load, that the wheel carries at least, whatever the zero
LOG_DEPTH = math.log(REFERENCE_SINKAGE)
N_RANGE = 0.05, 2.9
# What a single sensor is off by besides, over what all are: m lives on what wheels of two sizes differ by.
# How a zero is taken moves all sensors alike, by up to a centimetre. What is left of each is how it is
# mounted and read, which a worse way of taking the zero does not change: half a millimetre to a millimetre.
_EACH_ZERO, _EACH_LOAD = 0.25, 0.5
_EACH_ZERO_MOST = 7.5e-4  # m
# Sensors that this deviation counts for, beside those of the vehicle.
_TOLD_ZEROS = 2.0
_LEAST_SLIP_FACTOR, _TINY = 0.2, 1e-9
_AXLE = 0.5  # of the diameter


@dataclass(frozen=True)
class Sinkage:
    """Predicted sinkage of wheels under loads.

    Attributes
    ----------
    value
        Sinkage, m, (rows,).
    slopes
        Its derivatives with respect to ln K at the reference diameter, n, m and ln load, m, (rows, 4).
    sunk
        Whether the wheel is sunk to its axle, (rows,).
    """

    value: Array
    slopes: Array
    sunk: Flags


def sinkage_of(
    laws: Array,
    load: Array,
    wheels: Sequence[Wheel],
    wheel: Integers,
    effects: Sequence[Effect] = (),
    slip: Array | None = None,
    speed: Array | None = None,
    geometry: Geometry = "contact_integral",
) -> Sinkage:
    """Compute the sinkage of wheels under loads.

    Parameters
    ----------
    laws
        ln K (Pa/m^n) at `REFERENCE_DIAMETER`, n, m; shape (rows, 3).
    load
        Load, shape (rows,), N.
    wheels
        All wheels.
    wheel
        Number of each row's wheel, shape (rows,).
    effects
        Effects of the model.
    slip
        Slip, shape (rows,), 1; None if no effect reads it.
    speed
        Speed, shape (rows,), m/s; None if no effect reads it.
    geometry
        Rule of contact: 'contact_integral' or 'closed_form'.

    Returns
    -------
    Sinkage
        As an instrument would show it, where effects are those of an instrument. NaN where an effect reads a
        rolling wheel's slip or speed, and that is unknown.
    """
    diameter, width = (
        np.array([getattr(w, a) for w in wheels])[wheel] for a in ("diameter", "width")
    )
    if effects:
        value, by = np.full(load.size, np.nan), np.full((load.size, 4), np.nan)
        sunk = np.zeros(load.size, dtype=bool)
        contact = np.array([w.contact for w in wheels])[wheel]
        known, read = covariates(effects, contact == ROLLING, slip, speed)
        if known.size:
            given = Conditions(load, diameter, width, contact).take(known)
            found = neighbours(
                laws[known], replace(given, covariates=read), effects, geometry=geometry
            )
            value[known], by[known] = found.sinkage[: known.size], slopes(found.sinkage).T
            sunk[known] = found.immobilised[: known.size]
        return Sinkage(value, by, sunk)
    pressed = np.array([w.contact == PRESSED for w in wheels])[wheel]
    across = np.log(diameter / REFERENCE_DIAMETER)
    modulus = np.exp(laws[:, 0] + laws[:, 2] * across)
    # A pressed wheel meets the soil on both sides of its lowest point: each carries half.
    made = CONTACT_RULES[geometry].sinkage(
        np.where(pressed, 0.5 * load, load), diameter, width, modulus, laws[:, 1]
    )
    z = made.sinkage
    by_load, by_n = z * made.slope_load, z * made.slope_exponent
    return Sinkage(
        z, np.stack([-by_load, by_n, -by_load * across, by_load], axis=1), made.sunk_to_axle
    )


def covariates(
    effects: Sequence[Effect], rolling: Flags, slip: Array | None, speed: Array | None
) -> tuple[Integers, dict[str, Array]]:
    """Select the rows for which the slip and speed that effects read are known, and their values there.

    Parameters
    ----------
    effects
        Effects of the model.
    rolling
        Whether the wheel rolls, shape (rows,); a pressed one needs neither slip nor speed.
    slip
        Slip, shape (rows,), 1; None: unknown for all.
    speed
        Speed, shape (rows,), m/s; None: unknown for all.

    Returns
    -------
    rows : ndarray
        Indices of the selected rows; all rows without effects.
    values : dict of ndarray
        By 'slip' and 'speed', of which only those that an effect reads: values of the selected rows, shape
        (selected rows,).
    """
    if not effects:
        return np.arange(rolling.size), {}
    given = {"slip": slip, "speed": speed}
    read = {name: given[name] for name in covariates_of(effects)}
    columns = {name: unknown(rolling.size) if v is None else v for name, v in read.items()}
    known = np.ones(rolling.size, dtype=bool)
    for column in columns.values():
        known &= np.isfinite(column) | ~rolling
    return np.flatnonzero(known), {name: column[known] for name, column in columns.items()}


@dataclass(frozen=True)
class Shown(Columns):
    """Predicted sinkages and their derivatives.

    Attributes
    ----------
    value
        Sinkage, m, (rows,): h(x) as the sensor shows it, or without its errors.
    H
        Derivatives of `value` with respect to the state, m over the state's units, (rows, size).
    by_load
        Derivative of `value` with respect to ln load, m, (rows,).
    doubt
        Variance of the sinkage due to uncertain effects of ruts and slip, m^2, (rows,).
    """

    value: Array
    H: Array
    by_load: Array
    doubt: Array


class LawModel:
    """Prior of the state, and h for the wheels of a vehicle.

    Parameters
    ----------
    prior
        Prior of the soil.
    settings
        Settings of the estimate that are about sensors and ground.
    effects
        Effects of the model.
    wheels
        All wheels.
    reference
        Load (N), diameter and width (m) of the reference wheel, whose sinkage is exp(u).

    Attributes
    ----------
    size
        Length of the state.
    own_zeros
        Indices in the state of the zeros of single sinkage sensors, shape (wheels,).
    side
        1 for wheels on the left, -1 on the right, 0 in the middle, shape (wheels,).
    mean, soil_covariance
        Mean and covariance of the state before any measurement, shape (size,) and (size, size).
    unnamed_covariance
        Covariance before any measurement if the soil may be another than the named one, (size, size).
    """

    def __init__(
        self,
        prior: SoilPrior,
        settings: EstimatorSettings,
        effects: Sequence[Effect],
        wheels: tuple[Wheel, ...],
        reference: tuple[float, float, float],
    ) -> None:
        self.wheels, self.effects, self.reference = wheels, tuple(effects), reference
        self.size = WHEELS + EACH * len(wheels)
        self.own_zeros = np.arange(WHEELS, self.size, EACH)
        self._across = math.log(reference[1] / REFERENCE_DIAMETER)
        self.side = np.sign([wheel.lateral_position for wheel in wheels])
        self.mean = np.zeros(self.size)
        modulus = math.exp(prior.log_modulus(reference[1]))
        self._contact, self._geometry = prior.contact, prior.geometry
        u = float(np.log(self._contact.sinkage(*reference, modulus, prior.n).sinkage))
        self.mean[:LAW] = u, prior.n, prior.m
        slip_known = any("slip" in effect.drivers for effect in self.effects)
        nuisances = (
            _PASS_STD,
            SIDE_STD,
            _LOAD_SCALE_STD,
            _LOAD_ZERO_STD,
            0.0 if slip_known else _SLIP_SINKAGE_STD,
            _DELAY_STD,
            _PITCH_STD,
            settings.sinkage_zero_std,
            _SINKAGE_SCALE_STD,
        )
        own_zero = min(_EACH_ZERO * settings.sinkage_zero_std, _EACH_ZERO_MOST)
        each = own_zero, _EACH_LOAD * _LOAD_SCALE_STD
        deviations = np.array([0.0] * LAW + [*nuisances] + [*each] * len(wheels))
        self.soil_covariance = np.diag(np.square(np.maximum(deviations, _TINY)))
        back = np.linalg.inv(self.law(self.mean)[1][:, :LAW])
        own = prior.law[1].copy()
        self.soil_covariance[:LAW, :LAW] = back @ own @ back.T
        own[0, 0] *= _MISNAMED**2
        self.unnamed_covariance = self.soil_covariance.copy()
        self.unnamed_covariance[:LAW, :LAW] = back @ own @ back.T

    def fault_free(self, covariance: Array) -> Array:
        """The covariance of the state with deviations of passes and of the common zero reduced to a tenth.

        Errors of single sensors are not reduced: otherwise wheels of two sizes would show them as m.
        """
        scale = np.ones(self.size)
        scale[[PASS, ZERO]] = _FAULT_FREE
        whole: Array = covariance * np.outer(scale, scale)
        return whole

    def own_zero_variance(self, mean: Array, covariance: Array) -> float:
        """Estimate the variance of the zeros of single sinkage sensors from a state, m^2.

        A step of expectation maximisation (Dempster, Laird and Rubin 1977): the prior's variance counts as
        two more sensors. Where wheels of one size agree, the difference between sizes is m; where they do
        not, it may be the sensors.

        Parameters
        ----------
        mean
            Shape (size,).
        covariance
            Shape (size, size).
        """
        squares = mean[self.own_zeros] ** 2 + np.diag(covariance)[self.own_zeros]
        told = _TOLD_ZEROS * self.soil_covariance[WHEELS, WHEELS]
        return float((told + squares.sum()) / (_TOLD_ZEROS + squares.size))

    def drift(self, law: float, side: float, border: float) -> tuple[Array, Array]:
        """Transition matrix F and process noise Q of the filter's prediction over a distance.

        Parameters
        ----------
        law
            Share of the law's deviation from the prior that is kept over the distance, 0 to 1.
        side
            Share of a, the difference of the sides, that is kept, 0 to 1.
        border
            Variance to be added to that of u just beyond a border, 1; 0 elsewhere.

        Returns
        -------
        F, Q : ndarray
            For the state's deviation from the prior, shape (size, size).
        """
        factors, Q = np.ones(self.size), np.zeros((self.size, self.size))
        factors[:LAW], factors[SIDE] = law, side
        Q[:LAW, :LAW] = (1.0 - law * law) * self.soil_covariance[:LAW, :LAW]
        Q[SIDE, SIDE] = (1.0 - side * side) * SIDE_STD**2
        Q[U, U] += border
        return np.diag(factors), Q

    def pressure(self, u: Array, n: Array) -> tuple[Array, Array, Array]:
        """Compute ln K under the reference wheel from its sinkage exp(u), and its derivatives.

        Parameters
        ----------
        u
            ln of the reference wheel's sinkage in m, shape (rows,).
        n
            Exponent of sinkage, shape (rows,).

        Returns
        -------
        log_modulus, by_u, by_n : ndarray
            ln K (Pa/m^n), and its derivatives with respect to u and n, shape (rows,).
        """
        load, diameter, width = self.reference
        ratio = np.exp(u) / diameter
        made = self._contact.shape(n, np.minimum(ratio, _AXLE))
        level = math.log(load / (width * math.sqrt(diameter)))
        by_ratio = np.where(ratio < _AXLE, made.slope_ratio, 0.0)
        log_modulus = level - (n + 0.5) * u - np.log(made.value)
        return log_modulus, -(n + 0.5) - by_ratio, -u - made.slope_exponent

    def law(self, y: Array) -> tuple[Array, Array]:
        """Compute the law from a state, and its Jacobian.

        Parameters
        ----------
        y
            State, shape (size,), of which only u, n and m are used.

        Returns
        -------
        law, jacobian : ndarray
            (ln pressure at the reference sinkage and diameter, n, m), shape (3,), and its derivatives with
            respect to the state, shape (3, size).
        """
        u, n, m = y[:LAW]
        log_modulus, by_sinkage, by_exponent = (float(v) for v in self.pressure(u, n))
        jacobian = np.eye(LAW, self.size)
        jacobian[0, :LAW] = by_sinkage, by_exponent + LOG_DEPTH, -self._across
        return np.array([log_modulus + n * LOG_DEPTH - m * self._across, n, m]), jacobian

    def h(self, x: Array, rows: Stretches) -> Shown:
        """Predict sinkages as the sensors show them.

        Parameters
        ----------
        x
            State, shape (size,), or (rows, size) with one state for each row.
        rows
            The stretches.

        Returns
        -------
        Shown
            h(x) and its derivatives, a row for each stretch.
        """
        index = np.arange(len(rows))
        whole = np.broadcast_to(x, (index.size, self.size))
        sunk = self.sinkage(whole, rows)
        scale = np.exp(whole[:, SCALE])
        value = scale * sunk.value
        row = scale[:, None] * sunk.H
        zero = WHEELS + EACH * rows.wheel
        row[:, PITCH] = rows.pitch
        row[:, ZERO] += 1.0
        row[index, zero] = 1.0
        row[:, SCALE] += value
        value = value + whole[:, PITCH] * rows.pitch + whole[:, ZERO] + whole[index, zero]
        return Shown(value, row, scale * sunk.by_load, scale**2 * sunk.doubt)

    def sinkage(self, y: Array, rows: WheelsUnderLoad) -> Shown:
        """Predict sinkages without those errors of their sensors that are part of the state.

        Parameters
        ----------
        y
            State of each row, shape (rows, size).
        rows
            Wheels with their loads, slips and passes.

        Returns
        -------
        Shown
            Sinkage and its derivatives, a row for each of `rows`.
        """
        index, own = np.arange(len(rows)), WHEELS + EACH * rows.wheel + 1
        u, n, m, passed, sides, scale, off, digs, delay = y[:, : DELAY + 1].T
        reference, side = self.reference[0], self.side[rows.wheel]
        weight = np.maximum(rows.load - off * reference, LEAST_SHARE * rows.load)
        load = weight * np.exp(-scale - y[index, own] - delay * rows.load_rate - side * sides)
        log_modulus, by_sinkage, by_exponent = self.pressure(u, n)
        laws = np.stack([log_modulus - m * self._across, n, m], axis=1)
        static = sinkage_of(
            laws, load, self.wheels, rows.wheel, self.effects, rows.slip, rows.speed, self._geometry
        )
        by_modulus, by_n, by_m, by_log_load = static.slopes.T
        slip = np.fmax(rows.slip, 0.0)
        rut = np.exp(rows.passes * passed)
        factor = rut * np.maximum(1.0 + digs * slip, _LEAST_SLIP_FACTOR)
        value, by_load = static.value * factor, by_log_load * factor
        row = np.zeros(y.shape)
        row[:, U] = factor * by_modulus * by_sinkage
        row[:, N] = factor * (by_n + by_modulus * by_exponent)
        row[:, M] = factor * (by_m - by_modulus * self._across)
        row[:, LOAD_SCALE] = row[index, own] = -by_load
        row[:, SIDE] = -by_load * side
        row[:, LOAD_ZERO] = -by_load * reference / weight
        row[:, DELAY] = -by_load * rows.load_rate
        row[:, PASS] = rows.passes * value
        row[:, SLIP] = static.value * rut * slip
        doubt = (rows.pass_doubt * passed * value) ** 2 + (_SLIP_DOUBT * digs * row[:, SLIP]) ** 2
        return Shown(value, row, by_load, doubt)


def reference_wheel(
    rows: Stretches, wheels: Sequence[Wheel], prior: SoilPrior
) -> tuple[float, float, float]:
    """Choose the reference wheel: the first one measured, under its load.

    A wheel that is pressed begins without load, so its reference is the load at which the prior's soil
    gives the reference sinkage.

    Parameters
    ----------
    rows
        The first stretches, at least one.
    wheels
        All wheels.
    prior
        Prior of the soil.

    Returns
    -------
    load, diameter, width : float
        N, m, m.
    """
    wheel = wheels[int(rows.wheel[0])]
    load = float(rows.load[0])
    if wheel.contact != ROLLING:
        ratio = REFERENCE_SINKAGE / wheel.diameter
        shape = float(prior.contact.shape(prior.n, ratio).value)
        modulus = math.exp(prior.log_modulus(wheel.diameter))
        level = modulus * REFERENCE_SINKAGE ** (prior.n + 0.5) * shape
        load = level * wheel.width * math.sqrt(wheel.diameter)
    return load, wheel.diameter, wheel.width
