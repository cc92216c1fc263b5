# SPDX-License-Identifier: Apache-2.0
"""What sensors show of the soil's law: the state, and the measurement model h with its Jacobian H.

State x, all but m as the sensors show it:

    u    ln of the sinkage (m) that is shown of a reference wheel, the one measured first
    n'   exponent of sinkage as it is shown
    m    exponent of the wheel's diameter
    g    ln of the factor on sinkage in the rut of one wheel
    a    half of ln of what k is under the left wheels, over that under the right ones
    l    ln of the load cells' scale
    b    what the load cells show too much, over the reference wheel's load W_ref
    s    slip sinkage: z (1 + s i) at slip i > 0
    t    s, by which sinkage is shown behind the load
    e    m/rad, error of the shown sinkage with pitch
    c    m, zero of all sinkage sensors
    d_w  m, zero of the sensor of wheel w besides
    l_w  ln of the scale of the load cell of wheel w besides

From what is shown to the soil: with q = 1 - c / exp(u),

    ln z_ref = u + ln q,    n + 1/2 = (n' + 1/2) q

Why u and n'? A zero that is off bends ln z_ref and n together; in the shown numbers a measurement
says little of c, so that a filter which is linearised anew each time does not learn a zero that
nobody measured. h of a wheel with load W, slip i, and p of its rut (`Position.on_pass`):

    h(x) = z(W'; z_ref, n, m) exp(g p) (1 + s max(i, 0)) + e pitch + c + d_w
    W'   = (W - b W_ref) exp(-l - l_w - t d ln W/dt - side a)

since sinkage is of W/k; side: 1 of a wheel on the left, -1 on the right, 0 in the middle.

z is the sinkage of the contact integral (Meirion-Griffith and Spenko 2011 with the load's integral
in place of its approximation), with the model's effects. The variance of a segment about h(x) is

    R = sigma^2/count + by^2 var(ln W) + (0.02 z)^2 + (ruts of many passes) + by^2 S^2 r + A c

by = dh / d ln W. sigma, var(ln W): noise of the sensors (`stretches`). 0.02 z: what the law misses.
S: the soil's deviation of ln k from place to place; A: variance of the shown sinkage that load has no part
in. Both are learnt from the innovations (`Scatter`). r, c: 2/e and 1 of a segment alone; 2 and
(1 + a)/(1 - a) of one as it counts among its neighbours, which are alike by a.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior
from smallwheel_ros.estimator.stretches import Segment
from smallwheel_ros.estimator.wheel_sinkage import (
    Law,
    LoadedWheel,
    point_pressure,
    point_sinkage,
    wheel_sinkage,
)
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE

Array = NDArray[np.float64]

U, N, M, PASS, SIDE, LOAD_SCALE, LOAD_ZERO, SLIP, DELAY, PITCH, ZERO, WHEELS = range(12)
SIDE_STD = 0.3  # of a: soils under the two sides of a vehicle differ by a factor of 1.8
EACH = 2  # numbers of each wheel, from WHEELS on: d_w, l_w
LAW = 3
_LOG_REFERENCE_SINKAGE = math.log(REFERENCE_SINKAGE)
_N_RANGE = (0.05, 2.9)
_SHOWN_N_RANGE = (-0.35, 5.0)
LEAST_SHARE = 0.15  # of the shown sinkage and load that is the wheel's, whatever the zero
_LEAST_SLIP_FACTOR = 0.2
# What a single sensor is off by besides what is common to all, over that: zeros are set together, while
# each load cell has its own mounting and wear.
_EACH_ZERO, _EACH_LOAD = 0.25, 0.5
_TINY = 1e-9  # a nuisance that is taken not to be there
_MODEL_ERROR = 0.02  # of sinkage: the law against the public single-wheel rig, within one soil
LARGEST = 9.0  # a squared innovation counts at most as so many of its variances


class Shown(NamedTuple):
    """h(x) in m, its row of H (shape (size,)), and its slope by ln load.

    doubt: variance (m^2) by what many passes make of a rut.
    """

    value: float
    row: Array
    by_load: float
    doubt: float = 0.0

    def variance(self, covariance: Array) -> float:
        """By that of x, m^2."""
        return float(self.row @ covariance @ self.row)


def reference_wheel(given: Segment, prior: SoilPrior) -> tuple[float, float, float]:
    """Load (N), diameter and width (m) of the reference wheel: the one measured first.

    A wheel that is pressed begins without load, so its reference is the load under which the prior's
    soil lets it sink to the reference sinkage.
    """
    load, diameter, width = given.load, given.diameter, given.width
    if given.contact != ROLLING:
        unit = point_pressure(1.0, diameter, width, _LOG_REFERENCE_SINKAGE, prior.n).log_modulus
        load = math.exp(prior.log_modulus(diameter) - unit)
    return load, diameter, width


class LawModel:
    """The state's prior and h for the wheels of one vehicle.

    reference: of the wheel that u is of (`reference_wheel`).
    """

    def __init__(
        self,
        prior: SoilPrior,
        settings: EstimatorSettings,
        effects: Sequence[Effect],
        reference: tuple[float, float, float],
    ) -> None:
        self.reference = reference
        self.effects = tuple(effects)
        self._across = math.log(reference[1] / REFERENCE_DIAMETER)
        each = _EACH_ZERO * settings.sinkage_zero_std, _EACH_LOAD * settings.load_scale_std
        self.wheel_deviations: Array = np.maximum(each, _TINY)
        log_modulus = prior.log_modulus(reference[1])
        u = point_sinkage(*reference, log_modulus, prior.n).log_sinkage
        self.mean: Array = np.zeros(WHEELS)
        self.mean[:LAW] = u, prior.n, prior.m
        slip_known = any("slip" in effect.drivers for effect in self.effects)
        nuisances = (
            settings.pass_std,
            SIDE_STD,
            settings.load_scale_std,
            settings.load_zero_std,
            0.0 if slip_known else settings.slip_sinkage_std,
            settings.delay_std,
            settings.pitch_std,
            settings.sinkage_zero_std,
        )
        back = np.linalg.inv(self.law(self.mean)[1][:, :LAW])
        soil = np.diag(np.square([0.0] * LAW + [max(std, _TINY) for std in nuisances]))
        soil[:LAW, :LAW] = back @ prior.law[1] @ back.T
        self.soil_covariance = soil

    def prior(self, factor: float) -> Array:
        """Covariance of x before any measurement. factor: on the deviations of passes and zeros."""
        scale = np.ones(WHEELS)
        scale[[PASS, ZERO]] = factor
        back = np.linalg.inv(self.soil(self.mean)[1])
        prior: Array = back @ (self.soil_covariance * np.outer(scale, scale)) @ back.T
        return prior

    def soil(self, x: Array) -> tuple[Array, Array]:
        """From what is shown to the soil: the same numbers with ln z_ref and n, and the Jacobian."""
        y, jacobian = x.copy(), np.eye(len(x))
        u, half, zero = float(x[U]), float(x[N]) + 0.5, float(x[ZERO])
        shown = math.exp(u)
        share = 1.0 - zero / shown
        bounded = max(share, LEAST_SHARE)
        y[U] = u + math.log(bounded)
        y[N] = min(max(half * bounded - 0.5, _N_RANGE[0]), _N_RANGE[1])
        jacobian[N, N] = bounded
        if share == bounded:
            jacobian[U, U] = 1.0 / share
            jacobian[U, ZERO] = -1.0 / (shown * share)
            jacobian[N, U] = half * (1.0 - share)
            jacobian[N, ZERO] = -half / shown
        return y, jacobian

    def shown(self, y: Array) -> Array:
        """From the soil to what is shown: the inverse of `soil`."""
        x = y.copy()
        wheel = math.exp(y[U])
        shown = max(wheel + y[ZERO], LEAST_SHARE * wheel)
        x[U] = math.log(shown)
        x[N] = (y[N] + 0.5) * shown / wheel - 0.5
        return x

    def law(self, y: Array) -> tuple[Array, Array]:
        """Ln pressure at the reference sinkage and diameter, n and m; and their Jacobian by y."""
        u, n, m = y[:LAW].tolist()
        log_modulus, by_sinkage, by_exponent = point_pressure(*self.reference, u, n)
        jacobian = np.eye(LAW, len(y))
        jacobian[0, :LAW] = by_sinkage, by_exponent + _LOG_REFERENCE_SINKAGE, -self._across
        pressure = log_modulus + n * _LOG_REFERENCE_SINKAGE - m * self._across
        return np.array([pressure, n, m]), jacobian

    def h(self, x: Array, segment: Segment) -> Shown:
        """What the sensor of a wheel shows."""
        y, jacobian = self.soil(x)
        shown = self._of_soil(y, segment)
        row = shown.row @ jacobian
        row[PITCH] = segment.pitch
        row[ZERO] += 1.0
        value = shown.value + x[PITCH] * segment.pitch + x[ZERO]
        if segment.position.index is not None:
            zero = WHEELS + EACH * segment.position.index
            row[zero] = 1.0
            value += x[zero]
        return Shown(value, row, shown.by_load, shown.doubt)

    def sinkage(self, y: Array, segment: Segment) -> Shown:
        """The sinkage itself, without what is wrong with its sensor; y and the row are the soil's."""
        timely = y.copy()
        timely[DELAY] = 0.0
        shown = self._of_soil(timely, segment)
        shown.row[DELAY] = 0.0
        return shown

    def _of_soil(self, y: Array, segment: Segment) -> Shown:
        u, n, m, passed, sides, scale, off, digs, delay = y[: DELAY + 1].tolist()
        position = segment.position
        own = None if position.index is None else WHEELS + EACH * position.index + 1
        if own is not None:
            scale += float(y[own])
        reference = self.reference[0]
        weight = max(segment.load - off * reference, LEAST_SHARE * segment.load)
        load = weight * math.exp(-scale - delay * segment.load_rate - position.side * sides)
        wheel = LoadedWheel(
            load,
            segment.diameter,
            segment.width,
            segment.contact,
            segment.slip,
            segment.speed,
        )
        log_modulus, by_sinkage, by_exponent = point_pressure(*self.reference, u, n)
        law = Law(log_modulus - m * self._across, n, m)
        static = wheel_sinkage(law, wheel, self.effects)
        by_modulus, by_n, by_m, by_log_load = static.slopes
        slip = 0.0 if segment.slip is None else max(segment.slip, 0.0)
        rut = math.exp(position.passes * passed)
        factor = rut * max(1.0 + digs * slip, _LEAST_SLIP_FACTOR)
        value, by_load = static.value * factor, by_log_load * factor
        row = np.zeros(len(y))
        row[U] = factor * by_modulus * by_sinkage
        row[N] = factor * (by_n + by_modulus * by_exponent)
        row[M] = factor * (by_m - by_modulus * self._across)
        row[LOAD_SCALE] = -by_load
        row[SIDE] = -by_load * position.side
        row[LOAD_ZERO] = -by_load * reference / weight
        if own is not None:
            row[own] = -by_load
        row[DELAY] = -by_load * segment.load_rate
        row[PASS] = position.passes * value
        row[SLIP] = static.value * rut * slip
        return Shown(value, row, by_load, (position.pass_doubt * passed * value) ** 2)

    def bounded(self, x: Array) -> Array:
        """Keep the shown exponent where the law can be computed."""
        x[N] = min(max(x[N], _SHOWN_N_RANGE[0]), _SHOWN_N_RANGE[1])
        return x


# ---- the noise of a segment


class Innovation(NamedTuple):
    """Shown less expected (m), and variances (m^2): by the state, in all, and of sensors and law alone.

    by_load: slope of what is shown by ln load.
    """

    value: float
    state_variance: float
    variance: float
    base: float
    by_load: float


class Scatter:
    """What segments differ by beyond state and sensors, learnt from innovations.

    A regression of nu^2 - H P H - base on (1, by^2 share): `additive` (m^2) and `soil`, the variance
    of ln k at a place. `share`: of that, what is left in a segment's mean.
    """

    _MEMORY = 150.0  # segments
    _TOLD = 30.0  # segments that what is told of the soil's scatter counts for

    def __init__(self, soil_scatter: float) -> None:
        self._told = soil_scatter**2
        self.additive, self.soil = 0.0, soil_scatter**2
        # Mean over a segment as long as the correlation length of an Ornstein-Uhlenbeck process:
        # its variance, and that of many such means together, over the variance at a point.
        self.share = 2.0 * math.exp(-1.0)
        self.together = 2.0
        self._normal: Array = np.zeros((2, 2))
        self._moment: Array = np.zeros(2)
        self._alike: dict[str, float] = {}
        self._products = np.array([0.0, 1.0])  # of neighbours, and squares

    def noise(self, segment: Segment, shown: Shown) -> tuple[float, float, float]:
        """Variance of a segment alone, of it as it counts among its neighbours, and its base.

        Base: of sensors and law.
        """
        by_load = shown.by_load**2
        base = (
            segment.variance
            + by_load * segment.log_load_variance
            + (_MODEL_ERROR * shown.value) ** 2
            + shown.doubt
        )
        soil = by_load * self.soil
        alone = base + self.share * soil + self.additive
        counts = base + self.together * soil + self.additive_together * self.additive
        return alone, counts, base

    def at_a_place(self, segment: Segment, shown: Shown) -> float:
        """Variance of the sinkage at one place (m^2) by soil, load and what the law misses.

        Whether what is left over is the ground's or the sensor's nobody knows: it counts as the ground's, and
        varies more at a point than in the mean over a segment.
        """
        by_place = shown.by_load**2 * (self.soil + segment.log_load_variance)
        return (
            by_place + (_MODEL_ERROR * shown.value) ** 2 + shown.doubt + self.additive / self.share
        )

    def learn(self, innovation: Innovation, wheel: str) -> None:
        """Take an innovation of a wheel."""
        size = innovation.variance
        square = min(innovation.value**2, LARGEST * size)
        weight = 1.0 / size**2
        features = np.array([1.0, innovation.by_load**2 * self.share])
        keep = 1.0 - 1.0 / self._MEMORY
        self._normal = keep * self._normal + weight * np.outer(features, features)
        excess = square - innovation.state_variance - innovation.base
        self._moment = keep * self._moment + weight * excess * features
        self._solve(weight * features[1] ** 2)
        before = self._alike.get(wheel, 0.0)
        now = innovation.value / math.sqrt(size)
        now = math.copysign(min(abs(now), 3.0), now)
        products = np.array([now * before, 0.5 * (now**2 + before**2)])
        self._products = keep * self._products + products
        # Where an update fails, a copy of this object is gone back to: it keeps its own mapping.
        self._alike = self._alike | {wheel: now}

    @property
    def additive_together(self) -> float:
        """How much more neighbouring errors of the sinkage count, being alike: (1+r)/(1-r)."""
        alike = min(max(self._products[0] / self._products[1], 0.0), 0.8)
        return float((1.0 + alike) / (1.0 - alike))

    def _solve(self, size: float) -> None:
        """Both variances at least 0; the told scatter is worth some segments of this size."""
        normal, moment = self._normal.copy(), self._moment.copy()
        told = self._TOLD * size
        normal[1, 1] += told
        moment[1] += told * self._told
        # No error of the sinkage is expected that the sensor's own noise does not show.
        normal[0, 0] *= 1.0 + self._TOLD / self._MEMORY
        additive, soil = np.linalg.solve(normal, moment)
        if additive < 0.0:
            additive, soil = 0.0, moment[1] / normal[1, 1]
        floor = 0.25 * self._told
        if soil < floor:
            additive, soil = (moment[0] - normal[0, 1] * floor) / normal[0, 0], floor
        self.additive, self.soil = max(float(additive), 0.0), float(soil)
