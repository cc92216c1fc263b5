# SPDX-License-Identifier: Apache-2.0
"""Sinkage from load: the paper's closed form, flat plates, and soils whose pressure is layered."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smallwheel_ros.physics.contact import (
    AXLE_RATIO,
    ContactSinkage,
    ShapeIntegral,
    contact_sinkage,
    shape_integral,
)

Array = NDArray[np.float64]

PressureFactor = Callable[[Array], Array]

_BLOCK = 4096  # rows worked on at a time

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(40)
_U = 0.5 * (_NODES + 1.0)
_HEIGHT = (1.0 - _U**3) ** 2  # s/z0: clusters the nodes where p ~ (z0 - s)^n is not smooth
_DEPTH = _U**3 * (2.0 - _U**3)  # 1 - s/z0
_JACOBIAN = 0.5 * _WEIGHTS * 6.0 * _U**2 * (1.0 - _U**3)


def closed_form_sinkage(
    load: ArrayLike, diameter: ArrayLike, width: ArrayLike, modulus: ArrayLike, exponent: ArrayLike
) -> Array:
    """Sinkage (m) of a rolling wheel by z0 = [3 W / (b (3 - n) K sqrt(D))]^(2/(2n+1)).

    Bekker 1956 (eq. 7): K = kc/b + kphi; Meirion-Griffith and Spenko 2011 (eq. 10): K = k D^m.
    It assumes a parabola for the wheel and two terms of a series: it needs n < 3 and z0 << D, and
    differs from the contact integral by 1 to 10 % on real soils.

    Parameters
    ----------
    load
        Normal load W, N.
    diameter, width
        Diameter D and width b of the wheel, m.
    modulus
        Modulus K of the pressure p = K z^n, Pa/m^n.
    exponent
        Exponent n of sinkage, under 3.

    Returns
    -------
    array of the broadcast shape
    """
    n = np.asarray(exponent, dtype=float)
    d, k = np.asarray(diameter, dtype=float), np.asarray(modulus, dtype=float)
    base = 3.0 * np.asarray(load, dtype=float) / (np.asarray(width) * (3.0 - n) * k * np.sqrt(d))
    return np.asarray(base ** (2.0 / (2.0 * n + 1.0)))


def _closed_form_contact(
    load: ArrayLike, diameter: ArrayLike, width: ArrayLike, modulus: ArrayLike, exponent: ArrayLike
) -> ContactSinkage:
    """`closed_form_sinkage` with its derivatives, as `contact_sinkage` gives them."""
    n = np.asarray(exponent, dtype=float)
    z = closed_form_sinkage(load, diameter, width, modulus, n)
    slope = np.broadcast_to(1.0 / (n + 0.5), z.shape)
    by_exponent = slope * (1.0 / (3.0 - n) - np.log(z))
    return ContactSinkage(z, z > AXLE_RATIO * np.asarray(diameter), slope, by_exponent)


def _closed_form_shape(exponent: ArrayLike, ratio: ArrayLike) -> ShapeIntegral:
    """I(n, z/D) as eq. 7 and 10 have it: (3 - n)/3 at every depth."""
    n, epsilon = np.broadcast_arrays(np.asarray(exponent, float), np.asarray(ratio, float))
    return ShapeIntegral((3.0 - n) / 3.0, np.zeros(epsilon.shape), -1.0 / (3.0 - n))


Geometry = Literal["contact_integral", "closed_form"]


class ContactRule(NamedTuple):
    """The relation of load and sinkage of a rolling wheel.

    Attributes
    ----------
    sinkage
        Function of load (N), diameter (m), width (m), modulus K (Pa/m^n) and exponent n, in this order, that
        returns a `ContactSinkage`.
    shape
        Function of n and z/D that returns the `ShapeIntegral` of this rule.
    """

    sinkage: Callable[[ArrayLike, ArrayLike, ArrayLike, ArrayLike, ArrayLike], ContactSinkage]
    shape: Callable[[ArrayLike, ArrayLike], ShapeIntegral]


CONTACT_RULES: Mapping[Geometry, ContactRule] = {
    "contact_integral": ContactRule(contact_sinkage, shape_integral),
    "closed_form": ContactRule(_closed_form_contact, _closed_form_shape),
}


class ClosedForm(NamedTuple):
    """Sinkage (m) and compaction resistance (N) by the closed forms, of the broadcast shape."""

    sinkage: Array
    compaction_resistance: Array


def closed_form(
    load: ArrayLike,
    diameter: ArrayLike,
    width: ArrayLike,
    k: ArrayLike,
    n: ArrayLike,
    m: ArrayLike,
) -> ClosedForm:
    """Compute sinkage and compaction resistance by eq. 10 and 14 (Meirion-Griffith and Spenko 2011).

    It is made for many rows: the three powers of the two equations take two logarithms and two
    exponentials, and rows are processed in blocks that stay in the processor's cache.

    Parameters
    ----------
    load
        Normal load W, N.
    diameter, width
        Diameter D and width b of the wheel, m.
    k
        Modulus k of the pressure p = k z^n D^m, Pa/m^(n+m).
    n, m
        Exponents of sinkage and diameter; n under 3.

    Returns
    -------
    ClosedForm
    """
    columns = np.broadcast_arrays(
        *(np.asarray(a, dtype=float) for a in (load, diameter, width, k, n, m))
    )
    shape = columns[0].shape
    w, d, b, kk, nn, mm = (column.reshape(-1) for column in columns)
    sinkage, resistance = np.empty(w.size), np.empty(w.size)
    work = np.empty((4, min(w.size, _BLOCK)))
    for first in range(0, w.size, _BLOCK):
        rows = slice(first, min(first + _BLOCK, w.size))
        bk, log_d, log_z, scratch = work[:, : rows.stop - first]
        np.multiply(b[rows], kk[rows], out=bk)
        np.log(d[rows], out=log_d)
        np.subtract(3.0, nn[rows], out=log_z)
        log_z *= bk
        np.divide(w[rows], log_z, out=log_z)
        log_z *= 3.0
        np.log(log_z, out=log_z)
        np.add(mm[rows], 0.5, out=scratch)
        scratch *= log_d
        log_z -= scratch
        np.add(nn[rows], 0.5, out=scratch)
        log_z /= scratch
        np.exp(log_z, out=sinkage[rows])
        np.add(nn[rows], 1.0, out=scratch)
        log_z *= scratch
        log_d *= mm[rows]
        log_z += log_d
        np.exp(log_z, out=log_z)
        log_z *= bk
        np.divide(log_z, scratch, out=resistance[rows])
    return ClosedForm(sinkage.reshape(shape), resistance.reshape(shape))


def plate_sinkage(
    load: ArrayLike, diameter: ArrayLike, modulus: ArrayLike, exponent: ArrayLike
) -> Array:
    """Sinkage (m) of a flat round plate: W = K z^n pi D^2 / 4 (Bernstein 1913).

    With K = k it is eq. 8, with K = k D^m eq. 9 of Meirion-Griffith and Spenko 2011.

    Parameters
    ----------
    load
        Normal load W, N.
    diameter
        Diameter D of the plate, m.
    modulus
        Modulus K of the pressure p = K z^n, Pa/m^n.
    exponent
        Exponent n of sinkage, above 0.

    Returns
    -------
    array of the broadcast shape
    """
    area = np.pi / 4.0 * np.asarray(diameter, dtype=float) ** 2
    pressure = np.asarray(load, dtype=float) / area
    return np.asarray((pressure / np.asarray(modulus)) ** (1.0 / np.asarray(exponent, dtype=float)))


def compaction_resistance(
    sinkage: ArrayLike, width: ArrayLike, modulus: ArrayLike, exponent: ArrayLike
) -> Array:
    """Compaction resistance R_c = b K z^(n+1) / (n+1), N: the work of pressing a metre of rut, per metre.

    Bekker 1956; Meirion-Griffith and Spenko 2011, eq. 14. Exact for any shape of the contact.

    Parameters
    ----------
    sinkage
        Sinkage z, m. A negative one, which some effects can produce, compacts nothing: the resistance is 0.
    width
        Width b of the rut, m.
    modulus
        K = k D^m, Pa/m^n.
    exponent
        Exponent n of sinkage.
    """
    n = np.asarray(exponent, dtype=float)
    depth = np.maximum(np.asarray(sinkage, dtype=float), 0.0)
    work = np.asarray(modulus) * depth ** (n + 1.0) / (n + 1.0)
    return np.asarray(np.asarray(width) * work)


def loads_by_depth(
    sinkage: Array, diameter: Array, width: Array, modulus: Array, exponent: Array
) -> tuple[Array, Array]:
    """Split the load that soil with p = K z^n carries on a wheel into parts by depth.

    The parts are the terms of a quadrature of the contact integral over depth: their sum is the load, and
    the sum of their products with f(depth) is the load that soil with p = K z^n f(z) carries.

    Parameters
    ----------
    sinkage, diameter, width
        Sinkage, diameter and width of the wheels, m, each of shape (rows,).
    modulus, exponent
        K (Pa/m^n) and n, each of shape (rows,).

    Returns
    -------
    depths, loads
        Depth below the undisturbed surface (m) and part of the load (N), each of shape (nodes, rows).
    """
    column = (slice(None),) + (None,) * sinkage.ndim
    height = _HEIGHT[column] * sinkage
    # (z u)^n by one exponential: a power takes several times as long
    pressure = modulus * sinkage**exponent * np.exp(np.log(_DEPTH)[column] * exponent)
    # dx/ds of the wheel's outline, times sqrt(s), which the substitution takes out at s = 0
    outline = (diameter - 2.0 * height) / (2.0 * np.sqrt(diameter - height))
    scale = width * np.sqrt(sinkage) * (_JACOBIAN / np.sqrt(_HEIGHT))[column]
    return _DEPTH[column] * sinkage, pressure * outline * scale


def layered_work(sinkage: Array, modulus: Array, exponent: Array, factor: PressureFactor) -> Array:
    """Integral of the pressure p = K z^n f(z) over depth, from 0 to a sinkage.

    Times the width it is the compaction resistance (Meirion-Griffith and Spenko 2011, eq. 13).

    Parameters
    ----------
    sinkage
        m, shape (rows,).
    modulus, exponent
        K (Pa/m^n) and n, shape (rows,).
    factor
        f: takes depths (m) of shape (nodes, rows) and returns factors (1) of the same shape.

    Returns
    -------
    array, shape (rows,)
        N/m.
    """
    column = (slice(None),) + (None,) * sinkage.ndim
    # depth = z u^3 makes the power at depth 0 smooth
    depth = sinkage * (_U**3)[column]
    pressure = modulus * depth**exponent * factor(depth)
    return np.asarray(sinkage * np.sum(pressure * (1.5 * _WEIGHTS * _U**2)[column], axis=0))


def solve_layered(
    load: Array, upper: Array, load_at: Callable[[Array], Array]
) -> tuple[Array, NDArray[np.bool_]]:
    """Find the sinkage at which soil of any kind, such as layered soil, carries a load.

    Uses inverse quadratic steps (Chandrupatla 1997) in ln W over ln z, in which a pressure law is
    nearly a straight line, and bisection where it rises steeply, as at a hard layer.

    Parameters
    ----------
    load
        W > 0, N, shape (rows,).
    upper
        The deepest that a wheel may sink, m, shape (rows,).
    load_at
        Function of the sinkage (m) that returns the load (N) that the soil carries, both of shape (rows,).

    Returns
    -------
    sinkage, sunk
        Sinkage (m), and whether the soil carries less than the load even at `upper`, which then is the
        sinkage; each of shape (rows,).
    """
    target, top = np.log(load), np.log(upper)
    x1, x2 = top, top - 25.0  # the newest, and the other end
    with np.errstate(all="ignore"):  # a law may overflow at depths that no root is at
        f1, f2 = (np.log(load_at(np.exp(x))) - target for x in (x1, x2))
        sunk = f1 < 0.0
        share, met, root = f1 / (f1 - f2), sunk, top
        share = np.where((share > 0.0) & (share < 1.0), share, 0.5)
        for _ in range(80):
            root = np.where(met, root, x1 + share * (x2 - x1))
            f = np.log(load_at(np.exp(root))) - target
            met = met | (np.abs(f) < 1e-12) | (np.abs(x2 - x1) < 1e-13)
            if met.all():
                break
            same = (f < 0.0) == (f1 < 0.0)
            x3, f3 = np.where(same, x1, x2), np.where(same, f1, f2)
            x2, f2 = np.where(same, x2, x1), np.where(same, f2, f1)
            x1, f1 = root, f
            part, rise = (x1 - x2) / (x3 - x2), (f1 - f2) / (f3 - f2)
            smooth = (rise**2 < part) & ((1.0 - rise) ** 2 < 1.0 - part)
            share = f1 / (f1 - f2) * f3 / (f3 - f2)
            share += (x3 - x1) / (x2 - x1) * f1 / (f3 - f1) * f2 / (f3 - f2)
            least = 5e-14 / np.abs(x2 - x1)
            share = np.clip(np.where(smooth, share, 0.5), least, 1.0 - least)
    return np.exp(root), sunk
