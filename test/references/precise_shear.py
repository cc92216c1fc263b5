# SPDX-License-Identifier: Apache-2.0
"""Certifies c, phi and K from shear tests, with their deviations.

Each run by least squares over displacement, x = (strength T, ln K [, K_r]):

    minimise  sum w_i (T s(j_i; x) - tau_i)^2,   w_i from halfway to the neighbours, 0 and the end; sum w = 1
    C = [M / max(1 - p/N, 0.1) + (0.001 T)^2] (4 J' w J)^-1,   M the minimum, p of x, N of rows

Then the runs, y = (T, ln K) of each, by generalised least squares on theta = (c, tan phi, ln K):

    y_i = X_i theta + e_i,  e_i ~ N(0, C_i + S_i),  S_i = diag[(phi_T l_i)^2, phi_K^2],
    l_i = |c + sigma_i tan phi|

phi at the maximum of the restricted likelihood with ln phi ~ N(ln (0.05, 0.2), 0.7^2). l is that of the same
regression with phi at these medians and l_i = |T_i|. Deviations: (X' V^-1 X)^-1 averaged over ln phi at
+- sqrt(2) v / sqrt(h) of the eigenvectors v and values h (at least 1/0.49) of the curvature.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import mpmath
from mpmath import mp
from precise import Certified, Number, number, write
from precise_fit import SPREAD, Vector, newton
from reference_file import read_reference

MEDIANS = [mp.log(mp.mpf("0.05")), mp.log(mp.mpf("0.2"))]
STRETCHES, RESOLUTION = 4, mp.mpf("0.001")
_FIRST = 6  # steps of Gauss and Newton before those of Newton

Matrix = mpmath.matrix
# s of (displacement, x without T), and its slopes by these.
Share = Callable[[Number, Vector], tuple[Number, Vector]]


def rising(j: Number, shape: Vector) -> tuple[Number, Vector]:
    """1 - exp(-j/K), by ln K."""
    x = j / mp.exp(shape[0])
    return -mp.expm1(-x), [-x * mp.exp(-x)]


def peaked(j: Number, shape: Vector) -> tuple[Number, Vector]:
    """K_r {1 + [1/(K_r (1 - 1/e)) - 1] exp(1 - j/K_w)} [1 - exp(-j/K_w)], by ln K_w and K_r."""
    x, residual = j / mp.exp(shape[0]), shape[1]
    high = 1 / (1 - mp.exp(-1))
    hump, rise = mp.exp(1 - x), -mp.expm1(-x)
    level = residual + (high - residual) * hump
    by_x = -(high - residual) * hump * rise + level * mp.exp(-x)
    return level * rise, [-x * by_x, (1 - hump) * rise]


@dataclass(frozen=True)
class Curve:
    """One run: normal stress, displacements and stresses, SI."""

    normal_stress: Number
    displacement: Vector
    stress: Vector

    @property
    def weights(self) -> Vector:
        """w."""
        j = self.displacement
        middle = [(a + b) / 2 for a, b in pairwise(j)]
        ends = [mp.mpf(0), *middle, j[-1]]
        return [(b - a) / j[-1] for a, b in pairwise(ends)]

    def fitted(self, share: Share, shape: Vector) -> tuple[Vector, Matrix, Number]:
        """x, its C, and the root of M. shape: where to start."""
        weights = self.weights

        def slopes(x: Vector) -> list[tuple[Number, Vector]]:
            found = []
            for j, tau in zip(self.displacement, self.stress, strict=True):
                s, by = share(j, x[1:])
                found.append((x[0] * s - tau, [s, *(x[0] * b for b in by)]))
            return found

        def equations(x: Vector) -> Vector:
            rows = list(zip(weights, slopes(x), strict=True))
            return [mp.fsum(w * off * by[i] for w, (off, by) in rows) for i in range(len(x))]

        def least_squares(x: Vector) -> Matrix:
            """The step of Gauss and Newton, which a distant start needs."""
            off = [mp.sqrt(w) * r for w, (r, _) in zip(weights, slopes(x), strict=True)]
            by = [
                [mp.sqrt(w) * b for b in bs] for w, (_, bs) in zip(weights, slopes(x), strict=True)
            ]
            return mp.lu_solve(mp.matrix(by), mp.matrix(off))

        x = [max(self.stress), *shape]
        for _ in range(_FIRST):
            x = [v - d for v, d in zip(x, least_squares(x), strict=True)]
        x = newton(equations, x)
        rows = list(zip(weights, slopes(x), strict=True))
        least = mp.fsum(w * off**2 for w, (off, _) in rows)
        size = len(x)
        information = mp.matrix(size)
        for a in range(size):
            for b in range(size):
                information[a, b] = STRETCHES * mp.fsum(w * by[a] * by[b] for w, (_, by) in rows)
        free = max(1 - mp.mpf(size) / len(weights), mp.mpf("0.1"))
        noise = least / free + (RESOLUTION * x[0]) ** 2
        return x, noise * information**-1, mp.sqrt(least)


def curves_of(rows: Sequence[Sequence[str]]) -> list[Curve]:
    """The runs of rows of the columns."""
    found = []
    for run in dict.fromkeys(row[0] for row in rows):
        mine = [row for row in rows if row[0] == run]
        found.append(
            Curve(
                1000 * number(mine[0][1]),
                [number(row[2]) / 1000 for row in mine],
                [1000 * number(row[3]) for row in mine],
            )
        )
    return found


class Regression:
    """All runs on theta = (c, tan phi, ln K). level: l of each run."""

    def __init__(self, curves: Sequence[Curve], level: Vector | None = None) -> None:
        fits = [curve.fitted(rising, [mp.log(curve.displacement[-1] / 8)]) for curve in curves]
        self.size = len(curves)
        self.number = mp.matrix([v for x, _, _ in fits for v in x])
        self.known = [c for _, c, _ in fits]
        self.level = level or [abs(x[0]) for x, _, _ in fits]
        self.design = mp.matrix(2 * self.size, 3)
        for i, curve in enumerate(curves):
            self.design[2 * i, 0], self.design[2 * i, 1] = mp.mpf(1), curve.normal_stress
            self.design[2 * i + 1, 2] = mp.mpf(1)

    def variance(self, logs: Vector) -> Matrix:
        """V."""
        found = mp.matrix(2 * self.size)
        for i, (known, level) in enumerate(zip(self.known, self.level, strict=True)):
            for a in range(2):
                for b in range(2):
                    found[2 * i + a, 2 * i + b] = known[a, b]
            found[2 * i, 2 * i] += (mp.exp(logs[0]) * level) ** 2
            found[2 * i + 1, 2 * i + 1] += mp.exp(2 * logs[1])
        return found

    def solved(self, logs: Vector) -> tuple[Vector, Matrix]:
        """theta, and its covariance for these phi."""
        inverse = self.variance(logs) ** -1
        covariance = (self.design.T * inverse * self.design) ** -1
        return list(covariance * self.design.T * inverse * self.number), covariance

    def cost(self, logs: Vector) -> Number:
        """Less the restricted likelihood and prior of ln phi, less constants."""
        theta, covariance = self.solved(logs)
        v = self.variance(logs)
        off = self.number - self.design * mp.matrix(theta)
        away = mp.fsum(((ln - m) / SPREAD) ** 2 for ln, m in zip(logs, MEDIANS, strict=True))
        squares = (off.T * v**-1 * off)[0] + away
        return (squares + mp.log(mp.det(v)) - mp.log(mp.det(covariance))) / 2

    def curvature(self, logs: Vector) -> Matrix:
        """Second derivatives of the cost."""
        found = mp.matrix(2)
        step = mp.mpf(10) ** -20
        for a in range(2):
            for b in range(2):
                ends = []
                for s, t in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                    at = list(logs)
                    at[a] += s * step
                    at[b] += t * step
                    ends.append(s * t * self.cost(at))
                found[a, b] = mp.fsum(ends) / (4 * step**2)
        return found

    def estimate(self) -> tuple[Vector, Matrix, Vector]:
        """theta, its covariance with what is not known of phi, and ln phi."""

        def gradient(logs: Vector) -> Vector:
            step = mp.mpf(10) ** -30
            return [
                (self.cost([v + step * (i == a) for i, v in enumerate(logs)])
                 - self.cost([v - step * (i == a) for i, v in enumerate(logs)])) / (2 * step)
                for a in range(2)
            ]  # fmt: skip

        with mp.workdps(2 * mp.dps):
            logs = newton_of(gradient, MEDIANS)
            values, vectors = mp.eigsy(self.curvature(logs))
            total = mp.zeros(3)
            for at in range(2):
                root = mp.sqrt(2 / max(values[at], SPREAD**-2))
                for sign in (1, -1):
                    there = [ln + sign * root * vectors[i, at] for i, ln in enumerate(logs)]
                    total += self.solved(there)[1] / 4
        return self.solved(logs)[0], total, logs


def newton_of(gradient: Callable[[Vector], Vector], start: Vector) -> Vector:
    """Root of a gradient that is itself a difference: its steps are wider than those of `newton`."""
    found = mp.findroot(lambda a, b: gradient([a, b]), start, tol=1e-50)
    return list(found)


def of_runs(rows: Sequence[Sequence[str]]) -> list[Certified]:
    """c, phi, K with deviations, and strength and K of each run."""
    curves = curves_of(rows)
    first = Regression(curves)
    c, tangent, _ = first.solved(MEDIANS)[0]
    level = [abs(c + curve.normal_stress * tangent) for curve in curves]
    theta, covariance, logs = Regression(curves, level).estimate()
    phi, modulus = mp.atan(theta[1]), mp.exp(theta[2])
    spread = [mp.sqrt(covariance[i, i]) for i in range(3)]
    found = [
        Certified("cohesion", theta[0], spread[0], "Pa"),
        Certified("friction_angle", phi, spread[1] * mp.cos(phi) ** 2, "rad"),
        Certified("shear_displacement", modulus, modulus * spread[2], "m"),
        Certified("phi.strength", mp.exp(logs[0]), None, "1"),
        Certified("phi.ln K", mp.exp(logs[1]), None, "1"),
    ]
    runs = list(dict.fromkeys(row[0] for row in rows))
    for run, curve in zip(runs, curves, strict=True):
        x, _, misfit = curve.fitted(rising, [theta[2]])
        found.append(Certified(f"{run}.strength", x[0], None, "Pa"))
        found.append(Certified(f"{run}.shear_displacement", mp.exp(x[1]), None, "m"))
        found.append(Certified(f"{run}.misfit", misfit / x[0], None, "1"))
    return found


def shear_exact() -> None:
    """Shear tests that follow the law to the last digit that is written."""
    c, phi, modulus = mp.mpf(800), mp.pi / 6, mp.mpf("0.012")
    for curve in curves_of(read_reference("shear_exact").rows):
        for j, tau in zip(curve.displacement, curve.stress, strict=True):
            limit = c + curve.normal_stress * mp.tan(phi)
            assert abs(limit * -mp.expm1(-j / modulus) / tau - 1) < mp.mpf(10) ** -20
    found = [
        Certified("cohesion", c, None, "Pa"),
        Certified("friction_angle", phi, None, "rad"),
        Certified("shear_displacement", modulus, None, "m"),
    ]
    write("shear_exact", found)


def shear_noise() -> None:
    """Shear tests with scatter from run to run and of readings."""
    write("shear_noise", of_runs(read_reference("shear_noise").rows))


def shear_cullinan() -> None:
    """One measured curve under two laws."""
    (curve,) = curves_of(read_reference("shear_cullinan").rows)
    found = []
    for law, share, start in (
        ("janosi_hanamoto", rising, [mp.log(mp.mpf("0.004"))]),
        ("peak_residual", peaked, [mp.log(mp.mpf("0.01")), mp.mpf("0.95")]),
    ):
        x, _, misfit = curve.fitted(share, start)
        found.append(Certified(f"{law}.strength", x[0], None, "Pa"))
        found.append(Certified(f"{law}.shear_displacement", mp.exp(x[1]), None, "m"))
        found += [Certified(f"{law}.residual", v, None, "1") for v in x[2:]]
        found.append(Certified(f"{law}.misfit", misfit / x[0], None, "1"))
    write("shear_cullinan", found)
