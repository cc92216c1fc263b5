# SPDX-License-Identifier: Apache-2.0
"""The variance components: how measured values differ from the right model's predictions.

    y = f(theta) + e,   e ~ N(0, V),
    V = pure / count                                   rows within a point (repeatability)
      + tau^2 j j'          within a run               the soil is a little firmer; j = df / d ln k
      + own^2 L L'          within a run and channel   the run's touch-down, tare and mounting
      + zero^2 med(L)^2     within a run and channel   the same, of a size that does not grow with y
      + fit^2 L L'          within a setting           lack of fit of the law over settings
      + declared^2 diag(s^2)                           stated deviations, by one factor

and for swept runs

      + along^2 L L' exp(-|d path| / l)   within a run         what neighbours along a curve share

Two laws are wrong by an amount that is given, not fitted: where it is fitted, any effect gains by
shrinking it. A curve strays from a power of depth, over all runs and once more within each body (plate
or wheel), and no law of size is a power either:

      + shape^2 L L' [(1 + same body) exp(-|d ln L|) + same body]

Drawbar pull and torque have L^2 [law^2 exp(-|d slip| / 0.3) + wheel^2] within each wheel (`FORCE_LAW`). L
is the size of each value, of pull the load W, of torque W r (`levels_of`). phi = (tau, own, ...) have
log-normal priors; ln phi is found by maximising

    ln N(e; 0, V + J P^-1 J') + ln p(ln phi)

(restricted likelihood with the parameters' prior) by Newton steps with the average information
(Gilmour, Thompson and Cullis 1995).

V is used to judge models; the weights of a fit differ (`working`). Under V an error that all values
of a curve share, a level, a shift or a tilt, costs next to nothing, so that a fit would leave to it
what the parameters could describe: on a real plate a zero of 8 mm in each of four runs, twice the
error of a straight line in logarithms; with plates and wheels in one sand the difference of the two
kinds. A fit therefore weighs drawbar pull and torque without the error of their law, and each point
of a curve by its own errors (the working independence of Liang and Zeger 1986): rows as shallow as
the error of the zero then weigh little.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular

from smallwheel_ros.fitting import constants
from smallwheel_ros.fitting.noise import wheel_discrepancy
from smallwheel_ros.fitting.points import Index, Points
from smallwheel_ros.measurements.columns import FORCES

Array = NDArray[np.float64]

_STEPS = 15
_TOLERANCE = 0.01  # nats
_RESOLUTION = 1e-3  # of the level: no instrument shows more than three digits
_LENGTHS = np.log([0.1, 0.25, 0.6])  # correlation length along a curve, of its length


class Covariance:
    """A covariance S = L L', shape (values, values). Raises LinAlgError if it is not positive definite."""

    def __init__(self, matrix: Array) -> None:
        self.matrix = matrix
        self.root = np.linalg.cholesky(matrix)
        self.log_root = float(np.log(np.diag(self.root)).sum())

    def of(self, kept: NDArray[np.bool_]) -> Covariance:
        """The covariance of some of the values; itself where all are kept."""
        return self if kept.all() else Covariance(self.matrix[np.ix_(kept, kept)])

    def whiten(self, columns: Array) -> Array:
        """L^-1 columns: their scalar products are those under S^-1, shape as given, (values, ...)."""
        return np.asarray(solve_triangular(self.root, columns, lower=True, check_finite=False))

    def solve(self, columns: Array) -> Array:
        """S^-1 columns, shape as given."""
        return np.asarray(cho_solve((self.root, True), columns, check_finite=False))


@dataclass(frozen=True)
class Scatter:
    """The variance components, as ln of their standard deviations.

    Attributes
    ----------
    names, log_deviation
        Names of the components, and ln of their standard deviations, shape (components,).
    log_length
        ln of the correlation length along a curve, as a share of the curve.
    """

    names: tuple[str, ...]
    log_deviation: Array
    log_length: float

    def with_those_of(self, other: Scatter) -> Scatter:
        """The scatter, with the deviations of another one for the components that both have."""
        known = dict(zip(other.names, other.log_deviation, strict=True))
        values = [known.get(n, v) for n, v in zip(self.names, self.log_deviation, strict=True)]
        return Scatter(self.names, np.array(values), other.log_length)

    @property
    def deviations(self) -> dict[str, float]:
        """Deviation by name."""
        return dict(zip(self.names, np.exp(self.log_deviation).tolist(), strict=True))


class VarianceModel:
    """The variance components of one set of points.

    Parameters
    ----------
    points
        The points.
    level
        Size of each value, L, shape (values,).
    pure
        Variance of each value due to the repeatability of its rows, shape (values,).
    stated
        Standard deviation of each value as the table declares it, shape (values,); 0 where it does not.
    working
        See `Fitter`.
    law_known
        Whether the errors of the law of pull and torque are the given ones; else two factors on them are
        fitted ("law:" within a wheel, "wheel:" between wheels).

    Attributes
    ----------
    level
        Size of each value, L, shape (values,).
    working
        See `Fitter`.
    start
        The components at their priors' medians.
    """

    def __init__(
        self,
        points: Points,
        level: Array,
        pure: Array,
        stated: Array,
        *,
        working: bool = False,
        law_known: bool = True,
    ) -> None:
        self.points, self.level = points, level
        self.swept, self.working = bool(points.swept.any()), working
        sizes, run = np.outer(level, level), _same(points.run)
        told = bool(points.forces) and not (working or law_known)
        found: dict[str, tuple[float, Array]] = {"tau": (constants.SOIL_SCATTER, run)}
        for name in points.channels:
            here = points.of_channel(name)
            mine = np.outer(here, here)
            own = constants.CHANNEL_SCATTER
            if told and name in FORCES:  # of what is read, where the level is the load
                own *= float(np.sqrt(np.mean((points.value[here] / level[here]) ** 2)))
            found[f"own:{name}"] = own, mine * run * sizes
            if name not in FORCES:
                middle = float(np.median(level[here]))
                found[f"zero:{name}"] = constants.ZERO_SCATTER, mine * run * middle**2
            if settings_repeated(points) and not (told and name in FORCES):
                found[f"fit:{name}"] = constants.LACK_OF_FIT, mine * _same(points.setting) * sizes
            if stated[here].any():
                found[f"declared:{name}"] = 1.0, np.diag(here * stated)
        if told:
            found |= {name: (1.0, sizes * one) for name, one in _force_law(points).items()}
        both = np.outer(points.swept, points.swept)
        if self.swept:
            curve = both * _same(points.channel)
            found["along"] = constants.CURVE_CORRELATED, curve * run * sizes
        self.names = tuple(found)
        self.log_median = np.log([median for median, _ in found.values()])
        self.start = Scatter(self.names, self.log_median, float(_LENGTHS[1]))
        self._unit = np.array([kernel for _, kernel in found.values()])
        self._gap = _apart(points.path)
        self._given = np.diag(pure + (_RESOLUTION * level) ** 2)
        if working:
            self._unit *= np.where(both, np.eye(len(points)), 1.0)
            return
        if points.forces and law_known:
            self._given += sizes * sum(_force_law(points).values())
        if self.swept:
            self._given += constants.CURVE_SHAPE**2 * sizes * curve * _depth_law(points, level)

    def of_law(self, log_deviation: Array) -> Array:
        """The part of V that is due to the error of the law of pull and torque, shape (values, values)."""
        mine = [i for i, name in enumerate(self.names) if name.startswith(("law:", "wheel:"))]
        return np.asarray(np.tensordot(np.exp(2.0 * log_deviation[mine]), self._unit[mine], 1))

    def suited(self, scatter: Scatter) -> Scatter:
        """The components of these points, with the deviations that a scatter of other points has for them.

        A part of a table may repeat no setting, though the whole does, and then has no lack of fit.
        """
        known = dict(zip(scatter.names, scatter.log_deviation, strict=True))
        middle = zip(self.names, self.log_median, strict=True)
        values = np.array([known.get(name, value) for name, value in middle])
        return Scatter(self.names, values, scatter.log_length)

    def kernels(self, stiffness: Array, log_length: float) -> Array:
        """Covariance of each component at unit deviation.

        Parameters
        ----------
        stiffness
            df / d ln k, shape (values,).
        log_length
            ln of the correlation length along a curve, as a share of the curve.

        Returns
        -------
        ndarray
            Shape (components, values, values).
        """
        found = self._unit.copy()
        found[0] *= np.outer(stiffness, stiffness)
        if self.swept:
            found[-1] *= np.exp(-self._gap / np.exp(log_length))
        return found

    def total(
        self, log_deviation: Array, kernels: Array, spread: Array | None = None
    ) -> Covariance:
        """V, plus U U' where U is given.

        Parameters
        ----------
        log_deviation
            ln of each component's deviation, shape (components,).
        kernels
            As `kernels` returns them.
        spread
            U, what parameters can take up of the errors, shape (values, columns).
        """
        found = self._given + np.tensordot(np.exp(2.0 * log_deviation), kernels, 1)
        return Covariance(found if spread is None else found + spread @ spread.T)

    def covariance(
        self, scatter: Scatter, stiffness: Array, spread: Array | None = None
    ) -> Covariance:
        """Compute V of a scatter; see `total`.

        Parameters
        ----------
        scatter
            The variance components.
        stiffness
            df / d ln k, shape (values,).
        spread
            U, shape (values, columns).
        """
        kernels = self.kernels(stiffness, scatter.log_length)
        return self.total(scatter.log_deviation, kernels, spread)

    def log_prior(self, log_deviation: Array) -> float:
        """Logarithm of the priors' densities, less constants."""
        away = (log_deviation - self.log_median) / constants.SPREAD
        return -0.5 * float(away @ away)

    def fit(
        self,
        error: Array,
        spread: Array,
        stiffness: Array,
        start: Scatter,
        held: Collection[str] = (),
    ) -> Scatter:
        """The variance components that fit the errors best, by restricted likelihood with priors.

        Parameters
        ----------
        error
            Shape (values,), m, N or N m by channel.
        spread
            U, what parameters can take up of the errors, shape (values, columns).
        stiffness
            df / d ln k, shape (values,).
        start
            Where to start.
        held
            Names of components that are not fitted but stay as in `start`.
        """
        tried, lengths = [], _LENGTHS if self.swept and not self.working else _LENGTHS[1:2]
        if "along" in held:
            lengths = np.array([start.log_length])
        for length in lengths:
            kernels = self.kernels(stiffness, float(length))
            free = self._free(held)
            value, ln = self._climb(error, spread, kernels, start.log_deviation, free)
            tried.append((value, Scatter(self.names, ln, float(length))))
        return max(tried, key=lambda one: one[0])[1]

    def _free(self, held: Collection[str]) -> Index:
        return np.array([i for i, name in enumerate(self.names) if name not in held], dtype=np.intp)

    def _climb(
        self, error: Array, spread: Array, kernels: Array, start: Array, free: Index
    ) -> tuple[float, Array]:
        def objective(ln: Array) -> tuple[float, Covariance | None]:
            try:
                s = self.total(ln, kernels, spread)
            except np.linalg.LinAlgError:
                return -np.inf, None
            white = s.whiten(error)
            return self.log_prior(ln) - s.log_root - 0.5 * float(white @ white), s

        ln = start
        value, s = objective(ln)
        for _ in range(_STEPS):
            assert s is not None
            inverse, sizes = s.solve(np.eye(error.size)), 2.0 * np.exp(2.0 * ln)
            rise, information = self._information(s, error, ln, kernels)
            gradient = rise - 0.5 * sizes * np.tensordot(kernels, inverse, 2)
            gradient -= (ln - self.log_median) / constants.SPREAD**2
            step, share = np.zeros_like(ln), 1.0
            towards = np.linalg.solve(information[np.ix_(free, free)], gradient[free])
            step[free] = np.clip(towards, -1.5, 1.5)
            while (tried := objective(ln + share * step))[0] <= value:
                share *= 0.4
                if share <= 0.03:
                    return value, ln
            gain = tried[0] - value
            ln = ln + share * step
            value, s = tried
            if gain < _TOLERANCE:
                break
        return value, ln

    def _information(
        self, s: Covariance, error: Array, ln: Array, kernels: Array
    ) -> tuple[Array, Array]:
        """Slopes of -1/2 |e|^2_S by ln phi, and the average information on it with its prior's precision."""
        pulled = s.solve(error)
        # Of each component dS / d ln phi S^-1 e, shape (values, components).
        moved = (kernels @ pulled).T * (2.0 * np.exp(2.0 * ln))
        white = s.whiten(moved)
        prior = np.eye(len(self.names)) / constants.SPREAD**2
        return 0.5 * pulled @ moved, np.asarray(0.5 * white.T @ white + prior)

    def uncertainty(
        self,
        error: Array,
        spread: Array,
        stiffness: Array,
        scatter: Scatter,
        held: Collection[str] = (),
    ) -> Array:
        """Covariance of the components' ln deviations, by average information and prior.

        Parameters
        ----------
        error
            Shape (values,), m, N or N m by channel.
        spread
            U, what parameters can take up of the errors, shape (values, columns).
        stiffness
            df / d ln k, shape (values,).
        scatter
            The components.
        held
            Names of components that are known: their rows and columns are 0.

        Returns
        -------
        ndarray
            Shape (components, components).
        """
        ln, kernels = scatter.log_deviation, self.kernels(stiffness, scatter.log_length)
        s, free = self.total(ln, kernels, spread), self._free(held)
        information = self._information(s, error, ln, kernels)[1]
        found = np.zeros_like(information)
        found[np.ix_(free, free)] = np.linalg.inv(information[np.ix_(free, free)])
        return found


def _force_law(points: Points) -> dict[str, Array]:
    """What the law of pull and torque is off by, of the levels: covariances, shape (values,) * 2.

    By channel, "law:" within a wheel, from slip to slip, and "wheel:", from wheel to wheel.
    """
    found = {}
    near = np.exp(-_apart(points.column("slip")) / constants.FORCE_SLIP)
    own = wheel_discrepancy(points.conditions)[points.row]
    names = [n for n in ("diameter", "width", "grouser_height") if n in points.conditions]
    wheel = _same(_codes([points.column(name) for name in names]))
    for name in points.forces:
        here = points.of_channel(name)
        mine = np.outer(here, here) * wheel
        found[f"law:{name}"] = mine * constants.FORCE_LAW**2 * near
        found[f"wheel:{name}"] = mine * np.outer(own, own)
    return found


def _depth_law(points: Points, level: Array) -> Array:
    """How alike the errors of a power of depth are: near in depth, and once more of the same body."""
    bodies = _codes([points.column("diameter"), points.column("width")])
    size = np.log(np.maximum(level, 1e-12))
    near, same = np.exp(-_apart(size)), _same(bodies)
    return np.asarray((1.0 + same) * near + (same if bodies.max() > 0 else 0.0))


def settings_repeated(points: Points) -> bool:
    """Whether several runs share a setting; without that, lack of fit and scatter look alike."""
    if points.swept.any():
        return False
    pairs = np.unique(np.column_stack([points.setting, points.run]), axis=0)
    return bool(np.bincount(pairs[:, 0]).max(initial=0) > 1)


def curves_repeated(points: Points) -> bool:
    """Whether several curves differ in nothing but what was varied along them."""
    if not points.swept.all():
        return False
    kept = [c for n, c in points.settings.items() if n != points.order
            and all(np.ptp(c[points.run == run]) < 1e-9 for run in np.unique(points.run))]  # fmt: skip
    soil = points.conditions.soil
    named = (
        [] if soil is None else [np.unique(soil[points.row], return_inverse=True)[1].reshape(-1)]
    )
    if not kept and not named:
        return bool(points.run_count > 1)
    body = _codes([*kept, *(np.asarray(one, dtype=float) for one in named)])
    return any(np.unique(points.run[body == one]).size > 1 for one in np.unique(body))


def _same(codes: Index) -> Array:
    """1 where two values have the same code, else 0, shape (values,) * 2."""
    return np.asarray(np.equal.outer(codes, codes), dtype=float)


def _apart(values: Array) -> Array:
    """How far two values are from each other, shape (values,) * 2."""
    return np.asarray(np.abs(np.subtract.outer(values, values)))


def _codes(columns: Sequence[Array]) -> Index:
    rounded = np.round(np.column_stack(columns), 4)
    return np.asarray(np.unique(rounded, axis=0, return_inverse=True)[1].reshape(-1))
