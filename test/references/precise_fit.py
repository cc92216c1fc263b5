# SPDX-License-Identifier: Apache-2.0
"""Certifies fits of k, n, m: the estimate of the likelihood with variance components, at its exact maximum.

    y = f(theta) + e,  e ~ N(0, V),  theta ~ N(c, P^-1),  ln phi_k ~ N(ln median_k, 0.7^2)

    V_ij = (0.001 L_i)^2 (i = j)
         + tau^2 j_i j_j + own^2 L_i L_j + zero^2 med(L)^2      within a run (own, zero: and channel)
         + along^2 L_i L_j exp(-|path_i - path_j| / l)          within a run that is a curve
         + 0.05^2 L_i L_j [(1 + b) exp(-|ln L_i - ln L_j|) + b] all curves; b = 1 within one body, else 0

with j = df/d ln k, l the best of 0.1, 0.25, 0.6 of a curve, and L the size of each value as a line through
the data has it (`levels`): by channel

    sum_i min(y_i / med(y), 1) (ln y_i - a - b . x_i)^2 -> least,  x = ln load, ln of each size

L = exp(a + b . x), not under the least y nor over the largest, then at least 0.05 of its median. Neither
theta nor the law moves it. A size that an earlier column determines stays out: at the data L is the same
without it, while b would not be determined. theta and phi solve together, at the estimate itself
(`equations`):

    J' V^-1 (y - f) = P (theta - c)                                          V held
    -1/2 tr(S^-1 dS/d ln phi) + 1/2 e' S^-1 dS/d ln phi S^-1 e = (ln phi - ln median) / 0.49
    S = V + J P^-1 J',  e = y - f + J (theta - c)                            J held

The values of curves are fitted under other weights W than V, which judges: W is V without its last row, and
no two values share an error: each of its parts is a value's own. theta and the ln phi of W solve together as
above; then the ln phi of V and l at this theta and J. Deviations of theta are those of an estimate under W
of values whose errors have V, and never more than those before the data:

    C = A^-1 (J' W^-1 V W^-1 J + P) A^-1,  A = J' W^-1 J + P

Matrices are whole and solved by elimination, derivatives exact, the equations solved by Newton's method.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import mpmath
from mpmath import mp
from precise import Number

Vector = list[Number]
Matrix = mpmath.matrix
# Predictions and their slopes by parameter, shape (values, parameters).
Law = Callable[[Vector], tuple[Vector, list[Vector]]]

SPREAD = mp.mpf("0.7")
LENGTHS = [mp.mpf(v) for v in ("0.1", "0.25", "0.6")]
MEDIANS = {"tau": "0.05", "own": "0.03", "zero": "0.01", "along": "0.03"}
SHAPE, RESOLUTION, FLOOR = mp.mpf("0.05"), mp.mpf("0.001"), mp.mpf("0.05")
DEPENDENT = mp.mpf(10) ** -16  # of a column's square: less is left of one that others determine
STEPS, LEAST_STEP = 60, 0.01  # of Newton's method
ROUNDS, CLOSE = 3, mp.mpf(10) ** -4  # of theta and ln phi in turn, to come near both
ROOM = 15  # digits that sums and quadrature may lose: at 50, 35 are left, of which 30 are shown


@dataclass(frozen=True)
class Data:
    """What was measured: values, and of each its run, channel, body and place along a curve.

    settings: load (N) and sizes (m) of each value, all over 0.
    """

    value: Vector
    settings: Sequence[Vector]
    run: Sequence[str]
    channel: Sequence[str]
    body: Sequence[str]
    path: Vector
    curves: bool

    def __len__(self) -> int:
        return len(self.value)


@dataclass(frozen=True)
class Prior:
    """Of theta: mean c and covariance P^-1. stiffness: d ln k of each parameter (1 for ln p_ref)."""

    mean: Vector
    covariance: Matrix
    stiffness: Vector

    @property
    def precision(self) -> Matrix:
        """P."""
        return self.covariance**-1


@dataclass(frozen=True)
class Estimate:
    """What was found. names, log_deviation: of the components of V; residual: standard deviation of y - f.

    weights: ln phi of W.
    """

    theta: Vector
    covariance: Matrix
    names: Sequence[str]
    log_deviation: Vector
    length: Number
    residual: Number
    weights: Vector


def levels(data: Data) -> Vector:
    """L."""
    found = [mp.mpf(0)] * len(data)
    for channel in dict.fromkeys(data.channel):
        mine = [i for i in range(len(data)) if data.channel[i] == channel]
        value = [data.value[i] for i in mine]
        middle = median(value)
        weight = [min(y / middle, mp.mpf(1)) for y in value]
        columns = [
            [mp.log(s) for s in of] for of in zip(*(data.settings[i] for i in mine), strict=True)
        ]
        line = projected([mp.log(y) for y in value], [[mp.mpf(1)] * len(mine), *columns], weight)
        size = [min(max(mp.exp(ln), min(value)), max(value)) for ln in line]
        least = FLOOR * median(size)
        for i, one in zip(mine, size, strict=True):
            found[i] = max(one, least)
    return found


def projected(target: Vector, columns: Sequence[Vector], weight: Vector) -> Vector:
    """Where least squares with these weights puts the target: on columns made orthogonal one by one."""

    def dot(a: Vector, b: Vector) -> Number:
        return mp.fsum(w * x * y for w, x, y in zip(weight, a, b, strict=True))

    found, kept = [mp.mpf(0)] * len(target), []
    for column in columns:
        left = list(column)
        for other in kept:
            share = dot(column, other) / dot(other, other)
            left = [a - share * b for a, b in zip(left, other, strict=True)]
        if dot(left, left) <= DEPENDENT * dot(column, column):
            continue
        kept.append(left)
        share = dot(target, left) / dot(left, left)
        found = [a + share * b for a, b in zip(found, left, strict=True)]
    return found


def median(values: Vector) -> Number:
    """The middle one, or the mean of the two in the middle."""
    ordered, half = sorted(values), len(values) // 2
    return ordered[half] if len(values) % 2 else (ordered[half - 1] + ordered[half]) / 2


@dataclass(frozen=True)
class Components:
    """The parts of V: base + sum of phi_k^2 kernel_k."""

    names: Sequence[str]
    medians: Vector
    base: Matrix
    kernels: Sequence[Matrix]

    @classmethod
    def of(
        cls, data: Data, level: Vector, stiff: Vector, length: Number, weights: bool = False
    ) -> Components:
        """For these levels, stiffnesses j and length of correlation. weights: those of W."""
        size, channels = len(data), list(dict.fromkeys(data.channel))
        middle = {
            c: median([level[i] for i in range(size) if data.channel[i] == c]) for c in channels
        }
        many = len(set(data.body)) > 1

        def matrix(element: Callable[[int, int], Number]) -> Matrix:
            found = mp.matrix(size)
            for i in range(size):
                for j in range(i + 1):
                    found[i, j] = found[j, i] = element(i, j)
            return found

        def base(i: int, j: int) -> Number:
            alone = (RESOLUTION * level[i]) ** 2 if i == j else mp.mpf(0)
            if not data.curves or weights:
                return alone
            same = 1 if data.body[i] == data.body[j] else 0
            near = mp.exp(-abs(mp.log(level[i] / level[j])))
            shape = (1 + same) * near + (same if many else 0)
            return alone + SHAPE**2 * level[i] * level[j] * shape

        def run(i: int, j: int) -> bool:
            shared = i == j or not (weights and data.curves)
            return shared and data.run[i] == data.run[j]

        def own(i: int, j: int, channel: str) -> bool:
            return run(i, j) and data.channel[i] == data.channel[j] == channel

        parts = {"tau": matrix(lambda i, j: stiff[i] * stiff[j] * run(i, j))}
        for c in channels:
            parts[f"own:{c}"] = matrix(lambda i, j, c=c: level[i] * level[j] * own(i, j, c))
            parts[f"zero:{c}"] = matrix(lambda i, j, c=c: middle[c] ** 2 * own(i, j, c))
        if data.curves:
            parts["along"] = matrix(
                lambda i, j: level[i] * level[j] * run(i, j)
                * mp.exp(-abs(data.path[i] - data.path[j]) / length)
            )  # fmt: skip
        medians = [mp.log(mp.mpf(MEDIANS[name.partition(":")[0]])) for name in parts]
        return cls(tuple(parts), medians, matrix(base), tuple(parts.values()))

    def total(self, log_deviation: Vector) -> Matrix:
        """V."""
        found = self.base.copy()
        for ln, kernel in zip(log_deviation, self.kernels, strict=True):
            found += mp.exp(2 * ln) * kernel
        return found

    def slopes(self, log_deviation: Vector) -> list[Matrix]:
        """dV/d ln phi."""
        pairs = zip(log_deviation, self.kernels, strict=True)
        return [2 * mp.exp(2 * ln) * kernel for ln, kernel in pairs]


def trace(a: Matrix, b: Matrix) -> Number:
    """Trace of a b', b symmetric."""
    return mp.fsum(a[i, j] * b[i, j] for i in range(a.rows) for j in range(a.cols))


@dataclass(frozen=True)
class Problem:
    """Data, law and prior. held: components that another fit found, and which stay as they are."""

    data: Data
    law: Law
    prior: Prior
    length: Number = LENGTHS[1]
    held: Estimate | None = None
    weights: bool = True  # of the two, W; of values that are no curve they are the same

    def at(self, theta: Vector) -> tuple[Matrix, Matrix, Components]:
        """J, y - f and the components there."""
        predicted, slopes = self.law(theta)
        level = levels(self.data)
        stiff = [mp.fdot(row, self.prior.stiffness) for row in slopes]
        left = mp.matrix([y - f for y, f in zip(self.data.value, predicted, strict=True)])
        parts = Components.of(self.data, level, stiff, self.length, self.weights)
        return mp.matrix(slopes), left, parts

    def spread(
        self, jacobian: Matrix, theta: Vector, left: Matrix, v: Matrix
    ) -> tuple[Matrix, Matrix]:
        """S and e."""
        away = mp.matrix([t - c for t, c in zip(theta, self.prior.mean, strict=True)])
        return v + jacobian * self.prior.covariance * jacobian.T, left + jacobian * away

    def equations(self, unknown: Vector) -> Vector:
        """The stationary equations of the head, of theta and then of ln phi, each 0 at the estimate."""
        size = len(self.prior.mean)
        theta, free = list(unknown[:size]), list(unknown[size:])
        logs = list(self.held.weights) if self.held else free
        found = self.of_theta(theta, logs)
        return found if self.held else found + self.of_components(theta, logs)

    def of_theta(self, theta: Vector, logs: Vector) -> Vector:
        """Those of theta alone, at these components."""
        jacobian, left, parts = self.at(theta)
        away = mp.matrix([t - c for t, c in zip(theta, self.prior.mean, strict=True)])
        pull = jacobian.T * mp.lu_solve(parts.total(logs), left) - self.prior.precision * away
        return list(pull)

    def near(self, theta: Vector, logs: Vector) -> Vector:
        """Theta near its equations by Gauss-Newton steps, halved where they lead out or uphill."""

        def value(at: Vector, v: Matrix) -> Number:
            _, left, _ = self.at(at)
            off = mp.matrix([t - c for t, c in zip(at, self.prior.mean, strict=True)])
            return -(left.T * mp.lu_solve(v, left))[0] - (off.T * self.prior.precision * off)[0]

        for _ in range(STEPS):
            jacobian, _, parts = self.at(theta)
            v = parts.total(logs)
            weighted = jacobian.T * mp.lu_solve_mat(v, jacobian)
            pull = mp.matrix(self.of_theta(theta, logs))
            move = mp.lu_solve(weighted + self.prior.precision, pull)
            theta, moved = uphill(theta, move, lambda at, v=v: value(at, v))
            if moved < CLOSE:
                break
        return theta

    def climbed(self, theta: Vector, logs: Vector) -> Vector:
        """Ln phi near the top of their likelihood, by the average information."""
        for _ in range(STEPS):
            slopes = mp.matrix(self.of_components(theta, logs))
            move = mp.lu_solve(self.information(theta, logs), slopes)
            logs, moved = uphill(logs, move, lambda free: self.likelihood([*theta, *free]))
            if moved < CLOSE:
                break
        return logs

    def information(self, theta: Vector, logs: Vector) -> Matrix:
        """The average information of ln phi, its prior's included."""
        jacobian, left, parts = self.at(theta)
        s, e = self.spread(jacobian, theta, left, parts.total(logs))
        inverse = s**-1
        moved = [slope * inverse * e for slope in parts.slopes(logs)]
        found = mp.eye(len(logs)) / SPREAD**2
        for a in range(len(logs)):
            for b in range(len(logs)):
                found[a, b] += (moved[a].T * inverse * moved[b])[0] / 2
        return found

    def of_components(self, theta: Vector, logs: Vector) -> Vector:
        """Those of ln phi alone, at a theta."""
        jacobian, left, parts = self.at(theta)
        s, e = self.spread(jacobian, theta, left, parts.total(logs))
        inverse = s**-1
        white = inverse * e
        found = []
        for ln, middle, slope in zip(logs, parts.medians, parts.slopes(logs), strict=True):
            gain = -trace(inverse, slope) / 2 + (white.T * slope * white)[0] / 2
            found.append(gain - (ln - middle) / SPREAD**2)
        return found

    def likelihood(self, unknown: Vector) -> Number:
        """Restricted likelihood of phi, with its prior, less constants."""
        size = len(self.prior.mean)
        jacobian, left, parts = self.at(list(unknown[:size]))
        logs = list(unknown[size:])
        s, e = self.spread(jacobian, list(unknown[:size]), left, parts.total(logs))
        away = mp.fsum(
            (((ln - m) / SPREAD) ** 2) for ln, m in zip(logs, parts.medians, strict=True)
        )
        return -(mp.log(mp.det(s)) + (e.T * mp.lu_solve(s, e))[0] + away) / 2

    def covariance(self, theta: Vector, logs: Vector, weights: Matrix) -> Matrix:
        """C, mean over ln phi of V by its second differences at logs +- sqrt(3) times the columns of a root.

        The root is Cholesky's of the inverse of the average information of ln phi. weights: W.
        """
        jacobian, _, parts = self.at(theta)
        root = mp.cholesky(self.information(theta, logs) ** -1)
        middle = self._of_theta(jacobian, parts.total(logs), weights)
        total = middle.copy()
        for column in range(len(logs)):
            for sign in (1, -1):
                there = [ln + sign * mp.sqrt(3) * root[i, column] for i, ln in enumerate(logs)]
                total += (self._of_theta(jacobian, parts.total(there), weights) - middle) / 6
        return total

    def _of_theta(self, jacobian: Matrix, v: Matrix, weights: Matrix) -> Matrix:
        """C of one V."""
        w = weights if self.data.curves else v
        moved = mp.lu_solve_mat(w, jacobian)
        inverse = (jacobian.T * moved + self.prior.precision) ** -1
        if not self.data.curves:
            return inverse
        found = inverse * (moved.T * v * moved + self.prior.precision) * inverse
        size = found.rows
        before = [1 / self.prior.precision[i, i] for i in range(size)]
        least = [min(mp.mpf(1), mp.sqrt(before[i] / found[i, i])) for i in range(size)]
        for i in range(size):
            for j in range(size):
                found[i, j] *= least[i] * least[j]
        return found

    def solved(self, theta: Vector) -> Estimate:
        """The estimate, from a start near it."""
        size = len(theta)
        unknown = list(theta)
        if not self.held:
            with mp.workdps(20):
                logs = self.at(theta)[2].medians
                for _ in range(ROUNDS):
                    theta = self.near(theta, logs)
                    logs = self.climbed(theta, logs)
                unknown = newton(self.equations, [*theta, *logs])
        unknown = newton(self.equations, unknown)
        theta = unknown[:size]
        weights = list(self.held.weights) if self.held else unknown[size:]
        w = self.at(theta)[2].total(weights)
        return self._judged(theta, weights, w)

    def _judged(self, theta: Vector, weights: Vector, w: Matrix) -> Estimate:
        """The components of V at a theta, and with them what is known of it."""
        best: tuple[Number, Problem, Vector] | None = None
        for length in LENGTHS if self.data.curves else LENGTHS[1:2]:
            here = replace(self, length=length, weights=False)
            with mp.workdps(20):
                logs = here.climbed(theta, list(weights))
                logs = newton(lambda free, here=here: here.of_components(theta, free), logs)
                value = here.likelihood([*theta, *logs])
            if best is None or value > best[0]:
                best = value, here, logs
        assert best is not None
        here = best[1]
        logs = newton(lambda free: here.of_components(theta, free), best[2])
        _, left, parts = here.at(theta)
        residual = mp.sqrt(mp.fsum(r**2 for r in left) / (len(self.data) - len(theta)))
        covariance = here.covariance(theta, logs, w)
        return Estimate(theta, covariance, parts.names, logs, here.length, residual, weights)


def uphill(x: Vector, move: Matrix, value: Callable[[Vector], Number]) -> tuple[Vector, Number]:
    """The end of a step, halved until the value rises, and how far the whole one was."""
    before, share = value(x), mp.mpf(1)
    while True:
        tried = [v + share * d for v, d in zip(x, move, strict=True)]
        try:
            if value(tried) > before or share < LEAST_STEP:
                return tried, max(abs(d) for d in move)
        except ArithmeticError:  # out of the law's domain
            pass
        share /= 2


def newton(equations: Callable[[Vector], Vector], start: Vector) -> Vector:
    """Newton's method with central differences, and half a step where a whole one does not help."""
    x, f = list(start), equations(start)
    for _ in range(STEPS):
        columns = []
        step = mp.mpf(10) ** (-mp.dps // 3)
        for i in range(len(x)):
            ends = [equations([v + s * step * (i == j) for j, v in enumerate(x)]) for s in (1, -1)]
            columns.append([(a - b) / (2 * step) for a, b in zip(*ends, strict=True)])
        move = mp.lu_solve(mp.matrix(columns).T, mp.matrix(f))
        share = mp.mpf(1)
        while True:
            tried = [v - share * d for v, d in zip(x, move, strict=True)]
            try:
                reached = equations(tried)
                if norm(reached) < norm(f) or share < LEAST_STEP:
                    break
            except ArithmeticError:  # out of the law's domain
                pass
            share /= 2
        x, f = tried, reached
        if max(abs(d) for d in move) < mp.mpf(10) ** (ROOM - mp.dps):
            return x
    raise ArithmeticError("Newton's method did not come to rest")


def norm(values: Vector) -> Number:
    """Sum of squares."""
    return mp.fsum(v**2 for v in values)


def deviation(slopes: Vector, covariance: Matrix) -> Number:
    """Standard deviation of a number with these slopes by theta, to first order (delta method)."""
    g = mp.matrix(slopes)
    return mp.sqrt((g.T * covariance * g)[0])
