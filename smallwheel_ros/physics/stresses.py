# SPDX-License-Identifier: Apache-2.0
"""Thrust, resistance, drawbar pull and torque of a rigid wheel, from the stresses along its contact.

The sinkage comes first, from the law of depth and its effects or from a sensor; then the balance of
forces. Angles from the lowest point, r the radius, R = r + lambda h where lugs of height h make the
soil shear between rim and tip:

    depth          d(t) = r (cos t - cos t1),  cos t1 = 1 - z/r,  0 <= t <= t1   (Bekker 1956)
    pressure       p(t) = A [d(t)/z]^n                            n of p = k z^n D^m; largest at the bottom,
                   or, with a peak at t_m = c2 i t1, p(t) = p(t1 - (t1 - t_m) t/t_m) for t < t_m: from the
                   peak to the lowest point it falls to 0 (Wong and Reece 1967; c2 is small in pulls of rigs)
    displacement   j(t) = R {eta [(t1 - t) - (sin t1 - sin t)] + (1 - u)(sin t1 - sin t)}
                   u = V/(R omega): 1 - i driven, 1/(1 + i) skidding      (Wong and Reece 1967: eta = 1)
                   at a slip angle beta also j_y = R u tan(beta) (t1 - t); shear points along (j, j_y)
    shear          tau = mu (c + p tan phi) (1 - exp(-|j|/K)) sign j      (Janosi and Hanamoto 1961)
                   mu where the rim slides back over the soil, j > 0; 1 where it is dragged, j < 0
    A from         W = b Int (r p cos t + R tau sin t) dt                 linear in A: nothing to solve
    thrust         H = b Int R tau cos t dt
    resistance     B = b Int r p sin t dt
    drawbar pull   DP = H - B
    torque         T = b Int R^2 tau dt

None of them contains k: the load determines the size of the pressure, the sinkage the arc over
which it acts. Soil that a wheel dug or ploughed loose carries like the rest: the arc is that of the
whole sinkage. mu is the rim's friction over the soil's: under 1 for a bare rim that drives soil
back; 1 between lugs, and where the rim is dragged over the soil, since soil sticks ahead of it and
shears on soil. tau is 0 where that changes, so all forces are continuous in slip.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Of the lugs' height, where soil shears: between rim and tip. Held: 0 to 1 predict rigs alike.
LUG_SHARE = 0.5
DEEPEST = 0.985  # of the radius: there the arc still has an end
LOCKED = 0.02  # least R omega / V of a wheel that skids: beyond it shear has reached its limit
FASTEST = 0.97  # slip of a driven wheel, likewise


def _squared(nodes: int) -> tuple[Array, Array]:
    """Places x^2 of 0 .. 1 and their weights, (nodes, 1): a power of the distance from 0 is smooth over x."""
    x, weight = (column[:, None] for column in np.polynomial.legendre.leggauss(nodes))
    root = 0.5 * (x + 1.0)
    return root**2, weight * root


# From the entry angle, where pressure begins; from the lowest point, where it ends if it has a peak.
_FROM_ENTRY, _FROM_BOTTOM = _squared(12), _squared(8)
# Each doubles the digits, but near a double root, where j hardly turns back and its kink is weak.
_NEWTON_STEPS = 6
_BLOCK = 1024  # rows worked on at a time: the nodes' arrays then stay in the processor's cache


class ShearLaw(NamedTuple):
    """Parameters of the shear law, of the soil and of the rim; numbers or arrays of shape (rows,).

    Attributes
    ----------
    cohesion, friction_angle
        Cohesion c of the soil, Pa, and its angle of internal friction phi, rad.
    shear_displacement
        Shear deformation modulus K, m.
    rolling_share
        eta, 1: share of the displacement by rolling alone that shears the soil.
    rim_friction
        mu, 1: friction of a rim without lugs that slides back over the soil, over the soil's own.
    """

    cohesion: ArrayLike
    friction_angle: ArrayLike
    shear_displacement: ArrayLike
    rolling_share: ArrayLike = 1.0
    rim_friction: ArrayLike = 1.0


class WheelForces(NamedTuple):
    """Forces of wheels from the stresses along their contact; arrays of one shape.

    Attributes
    ----------
    thrust
        Forward component of the shear stresses, N; negative where a wheel skids.
    resistance
        Backward component of the pressure, N; the drawbar pull is thrust - resistance.
    torque
        Torque of the shear stresses about the axle, N m.
    load
        Load that the stresses carry, N.
    """

    thrust: Array
    resistance: Array
    torque: Array
    load: Array


def rim_friction(bare: ArrayLike, lug_height: ArrayLike) -> Array:
    """mu of each row: the friction of the rim on the soil over the soil's own; 1 for a rim with lugs.

    Parameters
    ----------
    bare
        mu of a rim without lugs, 1.
    lug_height
        Height of the lugs, m; 0 or less: the rim has none.
    """
    return np.asarray(np.where(np.asarray(lug_height) <= 0.0, bare, 1.0))


def speed_ratio(slip: ArrayLike) -> Array:
    """u = V/(R omega) of a slip, -1 to 1, limited so that a wheel never quite stands or spins on the spot."""
    i = np.asarray(slip, dtype=float)
    driven, skids = 1.0 - np.minimum(i, FASTEST), 1.0 / np.maximum(1.0 + i, LOCKED)
    return np.asarray(np.where(i >= 0.0, driven, skids))


def wheel_forces(
    load: ArrayLike,
    sinkage: ArrayLike,
    diameter: ArrayLike,
    width: ArrayLike,
    slip: ArrayLike,
    exponent: ArrayLike,
    shear: ShearLaw,
    *,
    lug_height: ArrayLike = 0.0,
    slip_angle: ArrayLike = 0.0,
    factor: Callable[[Array], Array] | None = None,
    peak: ArrayLike = 0.0,
    pressure: ArrayLike | None = None,
) -> WheelForces:
    """Compute the forces of wheels at a given sinkage by the formulas of the module's docstring.

    All arrays broadcast to one shape.

    Parameters
    ----------
    load
        Normal load, N.
    sinkage, diameter, width
        Sinkage, diameter and width of the wheel, m.
    slip
        -1 to 1, from the speed along the wheel's plane.
    exponent
        Exponent n of sinkage.
    shear
        Strength of the soil and of its contact with the rim.
    lug_height
        Height of the lugs, m.
    slip_angle
        Angle between the wheel's plane and its direction of travel, rad.
    factor
        Function of the depth below the surface (m) that returns the factor on the pressure (1), both of
        shape (nodes, rows), with the nodes of the quadrature along the contact; None: the factor is 1.
    peak
        Angle t_m of the largest pressure over the entry angle t1; from there to the lowest point the
        pressure falls as it rises from the entry (Wong and Reece 1967). 0: it is largest at the lowest point.
    pressure
        Pressure A of the soil at the depth z, Pa. If given, it replaces the load, and the resulting load is
        what the soil carries; where it is NaN, the load determines A.

    Returns
    -------
    WheelForces
        Of the broadcast shape.
    """
    given = (load, sinkage, diameter, width, slip, exponent, lug_height, slip_angle, peak)
    columns = (*given, *shear, np.nan if pressure is None else pressure)
    rows = np.broadcast_arrays(*(np.asarray(a, dtype=float) for a in columns))
    shape = rows[0].shape
    flat = [np.atleast_1d(a).reshape(-1) for a in rows]
    found = np.empty((4, flat[0].size))
    # A factor knows the rows of its model, so those are one block.
    block = _BLOCK if factor is None else max(flat[0].size, 1)
    for first in range(0, flat[0].size, block):
        part = slice(first, first + block)
        found[:, part] = _forces([a[part] for a in flat], factor)
    return WheelForces(*(values.reshape(shape) for values in found))


class Arc(NamedTuple):
    """Nodes of a quadrature along the contact of each row; arrays of shape (nodes, rows).

    Attributes
    ----------
    weight
        Weight of the node in an integral over the angle, rad.
    sine, cosine
        Sine and cosine of the node's angle from the lowest point.
    pressure
        Pressure over A, the pressure of the soil at the depth of the lowest point.
    rolled, slid
        With t the node's angle and t1 the entry angle: (t1 - t) - (sin t1 - sin t), the displacement by
        rolling, and sin t1 - sin t, that by slip, both over R. eta times the first and 1 - u times the second
        add up to j/R; the module's docstring defines eta, u and R.
    displacement
        Shear displacement over the shear deformation modulus, j/K, negative where the rim is dragged forward
        over the soil.
    friction
        mu, the friction of the rim on the soil over the soil's own: 1 where the displacement is not above 0.
    by_peak
        Derivative of `pressure` with respect to `ArcRows.peak`; None if no row has a peak.
    """

    weight: Array
    sine: Array
    cosine: Array
    pressure: Array
    rolled: Array
    slid: Array
    displacement: Array
    friction: Array
    by_peak: Array | None = None

    def around(self, *stresses: Array) -> Array:
        """Integrate stresses over the angle of the contact.

        Parameters
        ----------
        *stresses
            Stresses at the nodes, each of shape (nodes, rows).

        Returns
        -------
        array, shape (stresses, 3, rows)
            Integrals of each stress times the sine, times the cosine, and alone. For a shear stress they give
            the components up and forward, and the torque; for a pressure the components backward and up.
        """
        whole = self.weight * np.array(stresses)
        found = np.empty((len(stresses), 3, whole.shape[-1]))
        np.einsum("knr,nr->kr", whole, self.sine, out=found[:, 0])
        np.einsum("knr,nr->kr", whole, self.cosine, out=found[:, 1])
        np.add.reduce(whole, axis=1, out=found[:, 2])
        return found


class ArcRows(NamedTuple):
    """Wheels, and the soil under each, as `arc_of` takes them: arrays of shape (rows,), SI units.

    Attributes
    ----------
    sinkage, diameter
        Sinkage and diameter of the wheel, m.
    slip
        Slip, -1 to 1, from the speed along the wheel's plane.
    exponent
        Exponent n of sinkage in the pressure p = k z^n D^m, 1.
    shear_displacement
        Shear deformation modulus K, m.
    rolling_share
        eta, 1: share of the displacement by rolling alone that shears the soil.
    rim_friction
        mu, 1: friction of the rim on the soil over the soil's own, where the rim slides back over the soil.
    peak
        Angle of the largest pressure as a share of the entry angle, both from the lowest point; 0: the
        pressure is largest at the lowest point.
    sheared_radius
        R, m: radius at which the soil shears. It is that of the rim, or lies between rim and tip of the lugs.
    """

    sinkage: Array
    diameter: Array
    slip: Array
    exponent: Array
    shear_displacement: Array
    rolling_share: Array
    rim_friction: Array
    peak: Array
    sheared_radius: Array


def arc_of(rows: ArcRows, factor: Callable[[Array], Array] | None = None) -> Arc:
    """Compute pressures and shear displacements at nodes along the contact of each wheel.

    Parameters
    ----------
    rows
        Wheels, and the soil under each; SI units, shape (rows,) each.
    factor
        Function of the depth below the surface (m) that returns the factor on the pressure (1), both of
        shape (nodes, rows), with the nodes of the quadrature along the contact; None: the factor is 1.

    Returns
    -------
    Arc
    """
    r, u = 0.5 * rows.diameter, speed_ratio(rows.slip)
    deep = np.minimum(np.maximum(rows.sinkage / r, 1e-6), DEEPEST)
    above = 1.0 - deep
    entry = np.arccos(above)
    # Nodes on either side of a kink: of the pressure at its peak, of the shear where its sign changes.
    top = rows.peak * entry
    lost = 1.0 - u
    peaks = top > 0.0
    kink = top
    if not peaks.all():
        own = _unsheared(entry, rows.rolling_share, lost - rows.rolling_share)
        kink = np.where(peaks, top, own)
    split = kink.any()
    kink = np.maximum(kink, 1e-6 * entry) if split else kink
    place, weight = _FROM_ENTRY
    ahead = entry - kink
    t, w = entry - ahead * place, ahead * weight  # (nodes, rows)
    if split:
        place, weight = _FROM_BOTTOM
        t = np.concatenate([t, kink * place])
        w = np.concatenate([w, kink * weight])
    sine, cosine = np.sin(t), np.cos(t)
    slid = np.sin(entry) - sine
    rolled = entry - t - slid
    j = (rows.sheared_radius / rows.shear_displacement) * (
        rows.rolling_share * rolled + lost * slid
    )
    under = cosine  # where on the rim the same pressure is found as here
    peaked = bool(rows.peak.any())
    if peaked:
        beyond = np.where(peaks, entry - ahead * place, t[-place.size :])
        under = np.concatenate([cosine[: -place.size], np.cos(beyond)])
    depth = np.maximum(under - above, 1e-300)
    pressure = np.exp(rows.exponent * np.log(depth / deep))
    if factor is not None:
        pressure = pressure * factor(r * depth)
    friction = np.where(j > 0.0, rows.rim_friction, 1.0)
    by_peak = None
    if peaked:
        # Below the peak, at t < t_m, the pressure is that of an angle which moves by t t1/t_m^2 with t_m.
        by_peak, last = np.zeros_like(pressure), slice(-place.size, None)
        fall = -rows.exponent * pressure[last] * np.sin(beyond) / depth[last]
        moves = place * entry / np.where(peaks, top, 1.0) * entry
        by_peak[last] = np.where(peaks, fall * moves, 0.0)
    return Arc(w, sine, cosine, pressure, rolled, slid, j, friction, by_peak)


def _forces(rows: list[Array], factor: Callable[[Array], Array] | None) -> Array:
    load, sinkage, diameter, width, slip, n, height, angle, peak, *of_shear, pressure = rows
    c, phi, modulus, eta, mu = of_shear
    r = 0.5 * diameter
    big = r + LUG_SHARE * height
    arc = arc_of(ArcRows(sinkage, diameter, slip, n, modulus, eta, mu, peak, big), factor)
    j, f = arc.displacement, arc.pressure
    if np.any(angle):
        turned = np.tan(np.clip(angle, -1.5, 1.5)) * (arc.rolled + arc.slid)
        length = np.hypot(j, (big / modulus) * speed_ratio(slip) * turned) + 1e-300
        called = -np.expm1(-length) * j / length
    else:
        called = np.copysign(-np.expm1(-np.abs(j)), j)
    called = arc.friction * called
    (back, up, _), (held_up, held_on, held), rubs = arc.around(f, called, f * called)
    rubbed_up, rubbed_on, rubbed = rubs
    grip = np.tan(phi)
    # Shear that points down leaves little of it only where no wheel is: sunk to the axle and skidding.
    lift = np.maximum(r * up + big * grip * rubbed_up, 1e-3 * r * up)
    balanced = np.maximum(load / width - c * big * held_up, 0.0) / lift
    p = np.where(np.isnan(pressure), balanced, pressure)
    thrust = width * big * (c * held_on + p * grip * rubbed_on)
    resistance = width * r * p * back
    torque = width * big**2 * (c * held + p * grip * rubbed)
    return np.stack([thrust, resistance, torque, width * (p * lift + c * big * held_up)])


def _unsheared(entry: Array, eta: Array, share: Array) -> Array:
    """Angle inside the contact at which j changes its sign, for a wheel that skids; 0 if there is none.

    eta (t1 - t) + share (sin t1 - sin t) is concave over t where share < 0: Newton's method from its left end
    does not pass the root.
    """
    found = np.zeros_like(entry)
    there = (eta * entry + share * np.sin(entry) < 0.0) & (eta + share * np.cos(entry) > 0.0)
    if not there.any():
        return found
    end, rolling, rest = entry[there], eta[there], share[there]
    t = np.zeros_like(end)
    for _ in range(_NEWTON_STEPS):
        off = rolling * (end - t) + rest * (np.sin(end) - np.sin(t))
        t = t + off / (rolling + rest * np.cos(t))
    found[there] = t
    return found


class MeanPlace(NamedTuple):
    """Mean and standard deviation of t/t1 over the contact, 1, weighted by the pressure (1 - (t/t1)^2)^n.

    t is the angle of a place on the rim from the lowest point, t1 the entry angle. `closed_form_forces` calls
    the two kappa and sigma.
    """

    mean: float
    deviation: float


def mean_place(n: float) -> MeanPlace:
    """kappa and sigma of `closed_form_forces`, for an exponent n."""
    mean = math.gamma(n + 1.5) / (math.sqrt(math.pi) * math.gamma(n + 2.0))
    return MeanPlace(mean, math.sqrt(1.0 / (2.0 * n + 3.0) - mean**2))


def closed_form_forces(
    load: float, sinkage: float, diameter: float, width: float, slip: float, place: MeanPlace,
    cohesion: float, tangent: float, shear_displacement: float, rolling_share: float = 1.0,
    rim_friction: float = 1.0, lug_height: float = 0.0,
) -> tuple[float, float]:  # fmt: skip
    """Compute drawbar pull and torque of a wheel as if all of the pressure acted at its mean place.

        DP = W tan(delta - kappa t1),  T = W R sin(delta) / cos(delta - kappa t1)
        tan(delta) = (tan(phi) + c b r t1 / W) q

    r is the radius of the wheel and R that at which the soil shears: r without lugs, else r and half of the
    lugs' height. t1 is the entry angle from the lowest point, cos(t1) = 1 - z/r. q is the mean of
    mu (1 - exp(-|j|/K)) sign j at the two angles (kappa - sigma) t1 and (kappa + sigma) t1, where j is the
    shear displacement of the module's docstring, and mu is 1 where j < 0. It approximates `wheel_forces`, can
    be checked by hand, and is quick enough for planners; its mean error is 0.004 of the load for a driven
    wheel, 0.05 for one that skids.

    Parameters
    ----------
    load
        Normal load W, N, above 0.
    sinkage, diameter, width
        Sinkage z, diameter 2 r and width b of the wheel, m.
    slip
        Slip, -1 to 1.
    place
        kappa and sigma, as `mean_place` returns them for the soil's exponent n.
    cohesion
        Cohesion c of the soil, Pa.
    tangent
        tan(phi), with the soil's angle of internal friction phi.
    shear_displacement
        Shear deformation modulus K, m.
    rolling_share
        eta, 1: share of the displacement by rolling alone that shears the soil.
    rim_friction
        mu, 1: friction of the rim on the soil over the soil's own, where the rim slides back over the soil.
        It should be 1 for a rim with lugs, as the function `rim_friction` has it; `lug_height` does not
        change it here.
    lug_height
        Height of the lugs, m.

    Returns
    -------
    drawbar_pull, torque : float
        Drawbar pull, N, and torque, N m.
    """
    r = 0.5 * diameter
    big = r + LUG_SHARE * lug_height
    deep = min(max(sinkage / r, 1e-6), DEEPEST)
    entry, sin1 = math.acos(1.0 - deep), math.sqrt(deep * (2.0 - deep))
    u = 1.0 - min(slip, FASTEST) if slip >= 0.0 else 1.0 / max(1.0 + slip, LOCKED)
    called = 0.0
    for at in (place.mean - place.deviation, place.mean + place.deviation):
        t = entry * min(at, 1.0)
        rim = sin1 - math.sin(t)
        j = big / shear_displacement * (rolling_share * (entry - t - rim) + (1.0 - u) * rim)
        friction = rim_friction if j > 0.0 else 1.0
        called += 0.5 * friction * math.copysign(1.0 - math.exp(-abs(j)), j)
    delta = math.atan((tangent + cohesion * width * r * entry / load) * called)
    turned = delta - place.mean * entry
    return load * math.tan(turned), load * big * math.sin(delta) / math.cos(turned)
