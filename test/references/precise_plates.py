# SPDX-License-Identifier: Apache-2.0
"""Certifies k, n, m, kc and kphi from plates, and k, n, m from a rolling wheel, with their deviations."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mpmath import mp
from precise import Certified, Number, number, write
from precise_fit import Data, Estimate, Law, Prior, Problem, Vector, deviation
from precise_wheel import Wheel, closed_form
from reference_file import read_reference

DEPTH, SIZE = mp.mpf("0.010"), mp.mpf("0.200")  # z_ref and D_ref of ln p_ref
EXACT = mp.mpf(10) ** -20  # of a noise-free value: they have 25 digits
NEAR = mp.mpf(10) ** -5  # of a sinkage, from which its slope by the load is good to as much

# Of ln p_ref, n and the slope of ln p by ln size, before the data.
MEAN = [mp.mpf("10.5"), mp.mpf("0.9"), mp.mpf(0)]
SPREADS = [mp.mpf(3), mp.mpf("0.4"), mp.mpf("0.6")]


def plate_law(rows: Sequence[tuple[Number, Number]], size_factor: Callable[..., Vector]) -> Law:
    """Sinkage of plates: p = p_ref (z/z_ref)^n g. rows: pressure and size over reference.

    size_factor: of (rho, n, s), ln g and its slopes by n and s.
    """

    def law(theta: Vector) -> tuple[Vector, list[Vector]]:
        log_pressure, n, s = theta
        predicted, slopes = [], []
        for pressure, rho in rows:
            log_g, by_n, by_s = size_factor(rho, n, s)
            log_z = (mp.log(pressure) - log_pressure - log_g) / n
            z = DEPTH * mp.exp(log_z)
            predicted.append(z)
            slopes.append([-z / n, -z / n * (log_z + by_n), -z / n * by_s])
        return predicted, slopes

    return law


def power_of_size(rho: Number, n: Number, s: Number) -> Vector:
    """g = rho^s."""
    return [s * mp.log(rho), mp.mpf(0), mp.log(rho)]


def within(g: Number) -> Number:
    """A factor over 0. Raises ArithmeticError where no soil has it."""
    if g <= 0:
        raise ArithmeticError("a plate of negative pressure")
    return g


def bekker(rho: Number, n: Number, s: Number) -> Vector:
    """g = 1 - s + s/rho."""
    g = within(1 - s + s / rho)
    return [mp.log(g), mp.mpf(0), (1 / rho - 1) / g]


def reece(rho: Number, n: Number, s: Number) -> Vector:
    """g = (1 - s + s rho) rho^-n."""
    g = within(1 - s + s * rho)
    return [mp.log(g) - n * mp.log(rho), -mp.log(rho), (rho - 1) / g]


def prior(tied: int = 0) -> Prior:
    """Of (ln p_ref, n, s). tied: 1 where s has n in it (s = slope + n)."""
    mean = [MEAN[0], MEAN[1], MEAN[2] + tied * MEAN[1]]
    covariance = mp.diag([d**2 for d in SPREADS])
    covariance[2, 2] += tied * SPREADS[1] ** 2
    covariance[1, 2] = covariance[2, 1] = tied * SPREADS[1] ** 2
    return Prior(mean, covariance, [mp.mpf(1), mp.mpf(0), mp.mpf(0)])


def plates_of(rows: Sequence[Sequence[str]]) -> tuple[Data, list[Number], list[Number]]:
    """Values, diameters (m) and pressures (Pa) of rows of the plates' columns."""
    runs = [row[0] for row in rows]
    size = [number(row[2]) / 1000 for row in rows]
    pressure = [4 * number(row[3]) / (mp.pi * d**2) for row, d in zip(rows, size, strict=True)]
    path = []
    for i, run in enumerate(runs):
        mine = [j for j, name in enumerate(runs) if name == run]
        path.append(mp.mpf(mine.index(i)) / (len(mine) - 1))
    depth = [number(row[4]) / 1000 for row in rows]
    settings = [[number(row[3]), d] for row, d in zip(rows, size, strict=True)]
    body = [row[2] for row in rows]
    data = Data(depth, settings, runs, ["sinkage"] * len(rows), body, path, curves=True)
    return data, size, pressure


def laws_of_size(rows: Sequence[Sequence[str]]) -> list[Certified]:
    """Constants of the three laws with their deviations; and the scatter of the first."""
    data, size, pressure = plates_of(rows)
    under = list(zip(pressure, [d / SIZE for d in size], strict=True))
    own = Problem(data, plate_law(under, power_of_size), prior()).solved(MEAN)
    residual, length = mp.nstr(own.residual, 12), mp.nstr(own.length, 3)
    print(f"for the head: residual standard deviation {residual} m, l = {length} of a curve")
    log_pressure, n, m = own.theta
    k = mp.exp(log_pressure - n * mp.log(DEPTH) - m * mp.log(SIZE))
    of_k = [k, -k * mp.log(DEPTH), -k * mp.log(SIZE)]
    found = [Certified("k", k, deviation(of_k, own.covariance), "Pa/m^(n+m)")]
    for name, value, at in (("n", n, 1), ("m", m, 2)):
        found.append(Certified(name, value, mp.sqrt(own.covariance[at, at]), "1"))
    middle = mp.exp(mp.fsum(mp.log(d / 2) for d in size) / len(size))
    under = list(zip(pressure, [d / 2 / middle for d in size], strict=True))
    at_middle = log_pressure + m * mp.log(
        2 * middle / SIZE
    )  # far from it Newton's method does not rest
    for law, tied in ((bekker, 0), (reece, 1)):
        problem = Problem(data, plate_law(under, law), prior(tied), held=own)
        slope = mp.mpf(tied) * n + m * (1 if tied else -1)
        found += constants(law, problem.solved([at_middle, n, slope]), middle)
    found += [
        Certified(f"phi.{name}", mp.exp(ln), None, "1")
        for name, ln in zip(own.names, own.log_deviation, strict=True)
    ]
    return found


def constants(law: Callable[..., Vector], fit: Estimate, b: Number) -> list[Certified]:
    """kc, kphi of Bekker or Reece, from K = p_ref / z_ref^n at the size b, with derivatives by hand."""
    log_pressure, n, s = fit.theta
    modulus = mp.exp(log_pressure - n * mp.log(DEPTH))
    by_n = -mp.log(DEPTH)
    if law is bekker:
        first, second = modulus * s * b, modulus * (1 - s)
        slopes = [
            [first, first * by_n, modulus * b],
            [second, second * by_n, -modulus],
        ]
        names = [("bekker.kc", "Pa/m^(n-1)"), ("bekker.kphi", "Pa/m^n"), ("bekker.n", "1")]
    else:
        first, second = modulus * (1 - s) * b**n, modulus * s * b ** (n - 1)
        grown = by_n + mp.log(b)
        slopes = [
            [first, first * grown, -modulus * b**n],
            [second, second * grown, modulus * b ** (n - 1)],
        ]
        names = [("reece.c kc'", "Pa"), ("reece.gamma kphi'", "Pa/m"), ("reece.n", "1")]
    slopes.append([mp.mpf(0), mp.mpf(1), mp.mpf(0)])
    return [
        Certified(name, value, deviation(slope, fit.covariance), unit)
        for (name, unit), value, slope in zip(names, (first, second, n), slopes, strict=True)
    ]


def plates_exact() -> None:
    """Plates that follow p = k z^n D^m to the last digit that is written."""
    k, n, m = mp.mpf("4e6"), mp.mpf("0.9"), mp.mpf("0.4")
    data, size, pressure = plates_of(read_reference("plates_exact").rows)
    for z, d, p in zip(data.value, size, pressure, strict=True):
        assert abs(z * (k * d**m / p) ** (1 / n) - 1) < EXACT
    units = (("k", k, "Pa/m^(n+m)"), ("n", n, "1"), ("m", m, "1"))
    write("plates_exact", [Certified(name, value, None, unit) for name, value, unit in units])


def plates(name: str) -> None:
    """Plates with noise, simulated or measured."""
    write(name, laws_of_size(read_reference(name).rows))


def wheel_law(settings: Sequence[tuple[Number, Number, Number, str]]) -> Law:
    """Sinkage and compaction resistance of rolling wheels. settings: load, diameter, width, channel.

    Sinkage by Newton's method on the balance of load, slopes by the same balance: dz = -(dW/dtheta) /
    (dW/dz), each an integral over the arc.
    """

    last: dict[tuple[Number, ...], tuple[Vector, Number, Number, Vector]] = {}

    def one(load: Number, d: Number, b: Number, theta: Vector) -> dict[str, tuple[Number, Vector]]:
        log_pressure, n, m = theta
        k = mp.exp(log_pressure - n * mp.log(DEPTH) - m * mp.log(SIZE))
        wheel = Wheel(load, d, b, k, n, m)

        def up(z: Number, weight: Callable[[Number], Number]) -> Number:
            entry, low = wheel.entry(z), 1 - 2 * z / d

            def carried(share: Number) -> Number:
                cos = mp.cos(entry * share)
                depth = max(d / 2 * (cos - low), mp.mpf(0))
                return depth**n * cos * weight(depth) if depth else mp.mpf(0)

            return b * d / 2 * wheel.modulus * entry * mp.quad(carried, [0, 1])

        # From where it was at another theta, by its slopes there.
        z, by_depth = closed_form(wheel), (n + 0.5) * load / closed_form(wheel)
        if (load, d, b) in last:
            there, near, its_slope, slopes = last[load, d, b]
            moved = mp.fdot(slopes, [t - o for t, o in zip(theta, there, strict=True)])
            if abs(moved) < NEAR * near:
                z, by_depth = near + moved, its_slope
        moved = mp.mpf(1)
        while abs(moved) > z * mp.mpf(10) ** (5 - mp.dps):
            if not 0 < z < d / 2:
                raise ArithmeticError("a wheel above the soil, or sunk to its axle")
            moved = (up(z, lambda depth: mp.mpf(1)) - load) / by_depth
            z -= moved
            if abs(moved) > z * NEAR:
                by_depth = up(z, lambda depth: n / depth)
        # Each point of the arc goes as deep as the wheel does: d depth / d z = 1.
        by_depth = up(z, lambda depth: n / depth)
        by_n = up(z, lambda depth: mp.log(depth / DEPTH))
        by_m = load * mp.log(d / SIZE)
        slopes = [-load / by_depth, -by_n / by_depth, -by_m / by_depth]
        last[load, d, b] = theta, z, by_depth, slopes
        bottom = wheel.modulus * z**n * b
        resistance = bottom * z / (n + 1)
        of_soil = [
            resistance,
            resistance * (mp.log(z / DEPTH) - 1 / (n + 1)),
            resistance * mp.log(d / SIZE),
        ]
        shown = [own + bottom * s for own, s in zip(of_soil, slopes, strict=True)]
        return {"sinkage": (z, slopes), "resistance": (resistance, shown)}

    known: dict[tuple[Number, ...], tuple[Vector, list[Vector]]] = {}

    def law(theta: Vector) -> tuple[Vector, list[Vector]]:
        key = (*theta, mp.dps)
        if key not in known:
            wheels = {w[:3]: one(*w[:3], theta) for w in dict.fromkeys(settings)}
            found = [wheels[w[:3]][w[3]] for w in settings]
            known[key] = [f for f, _ in found], [s for _, s in found]
        return known[key]

    return law


def rolling_wheel() -> None:
    """k, n, m of wheels of two sizes that roll, from sinkage and resistance."""
    rows = read_reference("wheel_k_n_m").rows
    settings, data, sizes = [], [], []
    for channel, column, unit in (("sinkage", 4, 1000), ("resistance", 5, 1)):
        for row in rows:
            settings.append((number(row[3]), number(row[1]), number(row[2]), channel))
            data.append((number(row[column]) / unit, row[0], channel, row[1]))
            sizes.append([number(row[3]), number(row[1]), number(row[2])])
    value, run, channel, body = (list(column) for column in zip(*data, strict=True))
    measured = Data(value, sizes, run, channel, body, [mp.mpf(0)] * len(value), curves=False)
    own = Problem(measured, wheel_law(settings), prior()).solved(
        [mp.mpf("10.4"), mp.mpf("0.8"), mp.mpf("0.35")]
    )
    log_pressure, n, m = own.theta
    k = mp.exp(log_pressure - n * mp.log(DEPTH) - m * mp.log(SIZE))
    of_k = [k, -k * mp.log(DEPTH), -k * mp.log(SIZE)]
    found = [Certified("k", k, deviation(of_k, own.covariance), "Pa/m^(n+m)")]
    for name, value_, at in (("n", n, 1), ("m", m, 2)):
        found.append(Certified(name, value_, mp.sqrt(own.covariance[at, at]), "1"))
    found += [
        Certified(f"phi.{name}", mp.exp(ln), None, "1")
        for name, ln in zip(own.names, own.log_deviation, strict=True)
    ]
    write("wheel_k_n_m", found)
