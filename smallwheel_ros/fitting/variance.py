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
    """Covariance matrix S = L L' of values, with L its Cholesky factor.

    Parameters
    ----------
    matrix
        S, shape (values, values).

    Attributes
    ----------
    root
        L, lower triangular, shape (values, values).
    log_root
        ln |L|, which is half of ln |S|.

    Raises
    ------
    LinAlgError
        If S is not positive definite.
    """

    def __init__(self, matrix: Array) -> None:
        self.matrix = matrix
        self.root = np.linalg.cholesky(matrix)
        self.log_root = float(np.log(np.diag(self.root)).sum())

    def of(self, kept: NDArray[np.bool_]) -> Covariance:
        """Return the covariance of the values where a mask of shape (values,) is true."""
        return self if kept.all() else Covariance(self.matrix[np.ix_(kept, kept)])

    def whiten(self, columns: Array) -> Array:
        """Return L^-1 columns, shape as given, (values, ...).

        Scalar products of the result are those under S^-1: (L^-1 a)' (L^-1 b) = a' S^-1 b.
        """
        return np.asarray(solve_triangular(self.root, columns, lower=True, check_finite=False))

    def solve(self, columns: Array) -> Array:
        """Return S^-1 columns, shape as given, (values,) or (values, columns)."""
        return np.asarray(cho_solve((self.root, True), columns, check_finite=False))


@dataclass(frozen=True)
class Scatter:
    """The variance components of measurements, as ln of their standard deviations.

    Attributes
    ----------
    names
        Names of the components as in the module's docstring: `tau`, `along`, and by channel `own:CHANNEL`,
        `zero:CHANNEL`, `fit:CHANNEL`, `declared:CHANNEL`, and `law:CHANNEL` and `wheel:CHANNEL` for pull
        and torque.
    log_deviation
        ln of their standard deviations, shape (components,). These are relative: `tau` to k, most others to
        the size of a value; `declared:`, `law:` and `wheel:` are factors on given deviations.
    log_length
        ln of the correlation length along a curve, as a share of the curve.
    """

    names: tuple[str, ...]
    log_deviation: Array
    log_length: float

    def with_those_of(self, other: Scatter) -> Scatter:
        """Return these components with the deviations of another scatter for the components that both have.

        The correlation length is that of `other`.
        """
        known = dict(zip(other.names, other.log_deviation, strict=True))
        values = [known.get(n, v) for n, v in zip(self.names, self.log_deviation, strict=True)]
        return Scatter(self.names, np.array(values), other.log_length)

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviations by the name of the component."""
        return dict(zip(self.names, np.exp(self.log_deviation).tolist(), strict=True))


class VarianceModel:
    """The variance components of one set of points: their covariances, priors and estimation.

    Parameters
    ----------
    points
        Measured values, each a mean over rows of one run and setting.
    level
        L, size of each value (`levels_of`), shape (values,), m, N or N m.
    pure
        Variance of each value due to the repeatability of its rows, shape (values,).
    stated
        Variance of each value by the deviations that the table declares, shape (values,); 0 where it
        declares none, or repeats are used.
    working
        Whether to leave out the errors that many values share, for the weights of a fit (`Fitter.working`).
    law_known
        Whether the error of the law of pull and torque has the given size (`FORCE_LAW`, `FORCE_WHEEL`);
        else two factors on it are fitted for each channel, `law:` within a wheel and `wheel:` between
        wheels. Has no effect with `working`.

    Attributes
    ----------
    names
        Names of the components, as in `Scatter`.
    log_median
        ln of the medians of their priors, shape (components,).
    start
        The components at these medians.
    swept
        Whether any value belongs to a swept run.
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
        """Part of V due to the fitted components `law:` and `wheel:`, shape (values, values); else 0."""
        mine = [i for i, name in enumerate(self.names) if name.startswith(("law:", "wheel:"))]
        return np.asarray(np.tensordot(np.exp(2.0 * log_deviation[mine]), self._unit[mine], 1))

    def suited(self, scatter: Scatter) -> Scatter:
        """Return the components of these points, with the deviations of `scatter` where it has them.

        `scatter` may belong to other points: a part of a table may repeat no setting, though the whole
        does, and then has no lack of fit. Components that `scatter` lacks are at their prior's median.
        """
        known = dict(zip(scatter.names, scatter.log_deviation, strict=True))
        middle = zip(self.names, self.log_median, strict=True)
        values = np.array([known.get(name, value) for name, value in middle])
        return Scatter(self.names, values, scatter.log_length)

    def kernels(self, stiffness: Array, log_length: float) -> Array:
        """Compute the covariance of each component at unit standard deviation.

        Parameters
        ----------
        stiffness
            df / d ln k of each value (`Fit.stiffness`), shape (values,).
        log_length
            ln of the correlation length along a curve, as a share of the curve.

        Returns
        -------
        ndarray
            Shape (components, values, values), in the products of the values' units.
        """
        found = self._unit.copy()
        found[0] *= np.outer(stiffness, stiffness)
        if self.swept:
            found[-1] *= np.exp(-self._gap / np.exp(log_length))
        return found

    def total(
        self, log_deviation: Array, kernels: Array, spread: Array | None = None
    ) -> Covariance:
        """Compute the covariance V of the values' errors from each component's, plus U U' if U is given.

        Parameters
        ----------
        log_deviation
            ln of each component's standard deviation, shape (components,).
        kernels
            Covariance of each component at unit deviation, as `kernels` returns it.
        spread
            U, such that U U' is the covariance that the prior of the parameters gives to the predictions
            (`Fit.taken_up`), shape (values, columns).

        Returns
        -------
        Covariance
            Shape (values, values), in the products of the values' units.

        Raises
        ------
        LinAlgError
            If the sum is not positive definite.
        """
        found = self._given + np.tensordot(np.exp(2.0 * log_deviation), kernels, 1)
        return Covariance(found if spread is None else found + spread @ spread.T)

    def covariance(
        self, scatter: Scatter, stiffness: Array, spread: Array | None = None
    ) -> Covariance:
        """Compute the covariance V of the values' errors, plus U U' if U is given (see `total`).

        Parameters
        ----------
        scatter
            Standard deviations of the variance components.
        stiffness
            df / d ln k of each value (`Fit.stiffness`), shape (values,).
        spread
            U (`Fit.taken_up`), shape (values, columns).

        Returns
        -------
        Covariance
            Shape (values, values), in the products of the values' units.
        """
        kernels = self.kernels(stiffness, scatter.log_length)
        return self.total(scatter.log_deviation, kernels, spread)

    def log_prior(self, log_deviation: Array) -> float:
        """Logarithm of the density of the components' priors at `log_deviation`, up to a constant."""
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
        """Estimate the variance components from the errors of a fit, by restricted likelihood with priors.

        Newton steps with the average information (Gilmour, Thompson and Cullis 1995), from `start`. With
        swept runs they are repeated for three correlation lengths, and the most likely one is kept.

        Parameters
        ----------
        error
            Measured minus predicted at the centres of the parameters' priors (`Fit.away`), shape (values,),
            m, N or N m by channel.
        spread
            U, such that U U' is the covariance that the prior of the parameters gives to the predictions
            (`Fit.taken_up`), shape (values, columns).
        stiffness
            df / d ln k of each value (`Fit.stiffness`), shape (values,).
        start
            Components to start from, of these points (`suited`).
        held
            Names of components that stay as in `start`; with `along` its correlation length stays, too.

        Returns
        -------
        Scatter
            The components with the highest restricted likelihood times prior.
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
        """Gradient of -1/2 |e|^2_S by ln phi, and average information on it plus the prior's precision."""
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
        """Covariance of the estimated ln deviations, from the average information and the prior.

        Parameters
        ----------
        error
            Measured minus predicted at the centres of the parameters' priors (`Fit.away`), shape (values,),
            m, N or N m by channel.
        spread
            U, such that U U' is the covariance that the prior of the parameters gives to the predictions
            (`Fit.taken_up`), shape (values, columns).
        stiffness
            df / d ln k of each value (`Fit.stiffness`), shape (values,).
        scatter
            The estimated components.
        held
            Names of components that count as exactly known: their rows and columns are 0.

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
    """Covariances of the error of the law of pull and torque, relative to the levels.

    For each channel, `law:CHANNEL` within a wheel, correlated from slip to slip, and `wheel:CHANNEL`,
    common to all slips of a wheel; shape (values, values) each.
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
    """Covariance of the errors of a power law of depth, relative to `shape^2` and the levels.

    Shape (values, values). One part is shared by values near in depth on all bodies, one more by those of
    the same body.
    """
    bodies = _codes([points.column("diameter"), points.column("width")])
    size = np.log(np.maximum(level, 1e-12))
    near, same = np.exp(-_apart(size)), _same(bodies)
    return np.asarray((1.0 + same) * near + (same if bodies.max() > 0 else 0.0))


def settings_repeated(points: Points) -> bool:
    """Whether several runs share a setting; otherwise lack of fit and scatter of the runs look alike.

    Always false with swept runs.
    """
    if points.swept.any():
        return False
    pairs = np.unique(np.column_stack([points.setting, points.run]), axis=0)
    return bool(np.bincount(pairs[:, 0]).max(initial=0) > 1)


def curves_repeated(points: Points) -> bool:
    """Whether at least two swept runs differ only in what was varied along them.

    False where any value does not belong to a swept run.
    """
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
    """1 where two values have the same code, else 0, shape (values, values)."""
    return np.asarray(np.equal.outer(codes, codes), dtype=float)


def _apart(values: Array) -> Array:
    """Absolute differences of all pairs of values, shape (values, values)."""
    return np.asarray(np.abs(np.subtract.outer(values, values)))


def _codes(columns: Sequence[Array]) -> Index:
    rounded = np.round(np.column_stack(columns), 4)
    return np.asarray(np.unique(rounded, axis=0, return_inverse=True)[1].reshape(-1))
