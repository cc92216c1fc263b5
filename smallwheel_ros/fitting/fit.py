# SPDX-License-Identifier: Apache-2.0
"""The fit of one model to points, and its evidence.

    y = f(theta) + e,  e ~ N(0, V(phi)),  theta ~ p(theta),  ln phi ~ p(ln phi)

The parameters theta are fitted by Gauss-Newton steps on  -1/2 |y - f|^2_V + ln p(theta)  with V held, and
the variance components phi by `variance`, in turns until both have converged. The posterior of theta is
normal with covariance A^-1, where A = J' V^-1 J + P, J = df/dtheta and P is the prior's precision. The
evidence is, by Laplace's method,

    ln Z = ln N(y; f, V) + ln p(theta) + ln p(ln phi) + d/2 ln 2 pi - 1/2 ln |A| + ln(inside bounds)

(MacKay 2003, eq. 27.5; the last term is for effects' parameters, whose priors are cut off at their bounds).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve
from scipy.special import ndtr

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.threads import one_thread
from smallwheel_ros.effects.base import Effect, EffectError
from smallwheel_ros.fitting.noise import Repeats
from smallwheel_ros.fitting.parameters import SOIL_PARAMETERS, ParameterVector
from smallwheel_ros.fitting.points import FittingError, Points
from smallwheel_ros.fitting.variance import Covariance, Scatter, VarianceModel
from smallwheel_ros.measurements.columns import FORCES
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]

FAILURES = (SmallwheelError, ArithmeticError, ValueError, np.linalg.LinAlgError)  # of a fit
_TURNS = 4  # of theta and phi
_STEPS = 10  # of Gauss-Newton in a turn
_RESTS = 0.05  # nats: a gain below which a turn ends
_AT_BOUND = 1e-6  # of the range
_AGREE = 1e-9  # rounding of one model evaluated alone or among copies
# Kinds of effects met so far that take an array of each number, and models with one (a user's own) that does
# not: which of theirs it is does not show.
_TOGETHER: set[type[Effect]] = set()
_ALONE: set[frozenset[type[Effect]]] = set()


class Predictor:
    """Predicts measured values, each of which is one channel at one row of the conditions.

    Parameters
    ----------
    conditions
        Settings, SI units.
    channels
        Names of the channels.
    channel, row
        For each value, index of its channel and row of its conditions, shape (values,).
    """

    def __init__(
        self, conditions: Conditions, channels: Sequence[str], channel: Index, row: Index
    ) -> None:
        self.conditions, self.channels = conditions, tuple(channels)
        self.channel, self.row = channel, row
        self._tiled: dict[int, Conditions] = {}
        self._with_forces = not set(FORCES).isdisjoint(channels)

    @classmethod
    def of(cls, points: Points) -> Predictor:
        """The predictor of these points."""
        return cls(points.conditions, points.channels, points.channel, points.row)

    def __call__(self, vector: ParameterVector, theta: Array) -> Array:
        """Predict the values, shape (values,), m, N or N m by channel; NaN where there is no prediction.

        Parameters
        ----------
        vector
            Names, priors and bounds of the free parameters.
        theta
            Values of the parameters, shape (parameters,).
        """
        return np.asarray(self._together(vector, theta[None, :], vector.effects(theta))[0])

    def many(self, vector: ParameterVector, thetas: Array) -> Array:
        """Predict the values for each of several parameter vectors.

        A user's own effect that cannot take arrays is evaluated for one vector after the other.

        Parameters
        ----------
        vector
            Names, priors and bounds of the free parameters.
        thetas
            Values of the parameters, shape (vectors, parameters).

        Returns
        -------
        ndarray
            Shape (vectors, values), m, N or N m by channel; NaN where the model gives no prediction.
        """
        effects = vector.effects(np.repeat(thetas.T, len(self.conditions), axis=1))
        kinds = frozenset(type(effect) for effect in effects)
        if kinds not in _ALONE:
            try:
                found = self._together(vector, thetas, effects)
                if kinds <= _TOGETHER or np.allclose(
                    found[-1], self(vector, thetas[-1]), rtol=_AGREE, atol=0.0, equal_nan=True
                ):
                    _TOGETHER.update(kinds)
                    return found
            except (EffectError, TypeError, ValueError):
                pass  # of these numbers, or of arrays: each of them alone tells
        found = np.stack([self(vector, theta) for theta in thetas])
        _ALONE.add(kinds)
        return found

    def _together(self, vector: ParameterVector, thetas: Array, effects: Sequence[Effect]) -> Array:
        """Predict copies of the rows, one for each parameter vector, in one call, shape (copies, values).

        Each number of the `effects` is an array with one entry for each row of the copies.
        """
        count, c = len(thetas), self.conditions
        names = [soil.name for soil in vector.soils]
        code: Index = np.zeros(len(c), dtype=np.intp)
        if c.soil is not None and len(names) > 1:
            code = np.array([names.index(str(name)) for name in c.soil], dtype=np.intp)
        model = Model(vector.soils[:1], vector.geometry, effects, vector.thrust_form)
        if count not in self._tiled:
            self._tiled[count] = c.take(np.tile(np.arange(len(c)), count))
        soil = vector.soil_columns(thetas, code)
        said = predict(model, self._tiled[count], with_forces=self._with_forces, soil=soil)
        columns = np.stack([getattr(said, n).reshape(count, -1) for n in self.channels])
        return np.asarray(columns[self.channel, :, self.row].T)

    def with_slopes(self, vector: ParameterVector, theta: Array) -> tuple[Array, Array]:
        """Compute predictions, and their derivatives with respect to the parameters by finite differences.

        Parameters
        ----------
        vector
            Names, priors and bounds of the free parameters.
        theta
            Values of the parameters, shape (parameters,).

        Returns
        -------
        predicted, slopes : ndarray
            Shape (values,), m, N or N m by channel, and (values, parameters), per unit of the parameter.

        Raises
        ------
        FittingError
            If a value has no finite prediction at `theta` or one step away from it.
        """
        steps = vector.steps(theta)
        with np.errstate(all="ignore"):  # what is no number is refused below
            found = self.many(vector, np.vstack([theta, theta + np.diag(steps)]))
        bad = np.flatnonzero(~np.isfinite(found).all(axis=0))
        if bad.size:
            raise FittingError(self._no_number(vector, theta, int(bad[0])))
        return found[0], np.asarray((found[1:] - found[0]).T / steps)

    def _no_number(self, vector: ParameterVector, theta: Array, value: int) -> str:
        """Message that the model gives no finite prediction, with its effects and the setting."""
        effects, row = vector.model(theta).effects, self.row[value]
        needs = dict.fromkeys(name for effect in effects for name in effect.needs)
        names = ("load", "diameter", "width", *needs)
        setting = ", ".join(f"{n} {self.conditions[n][row]:g}" for n in names)
        return (
            f"the model with {', '.join(e.id for e in effects) or 'no effect'} gives no finite "
            f"{self.channels[self.channel[value]]} at {setting} for the numbers tried"
        )


AnyFit = TypeVar("AnyFit", bound="Fit")


@dataclass(frozen=True)
class Fit:
    """A model evaluated at the values of its parameters, and, once fitted, its evidence and covariance.

    Attributes
    ----------
    vector
        Names, priors and bounds of the parameters.
    theta
        Values of the parameters, shape (parameters,).
    predicted
        Predictions, shape (values,), m, N or N m by channel.
    slopes
        J, derivatives of the predictions with respect to the parameters, shape (values, parameters).
    scatter
        Standard deviations of the variance components.
    evidence
        ln Z, nats; -inf before the fit.
    covariance
        Posterior covariance A^-1 of the parameters, shape (parameters, parameters); (0, 0) before the fit.
    """

    vector: ParameterVector
    theta: Array
    predicted: Array
    slopes: Array
    scatter: Scatter
    evidence: float
    covariance: Array

    @property
    def model(self) -> Model:
        """The model with these parameters."""
        return self.vector.model(self.theta)

    @property
    def at_bound(self) -> NDArray[np.bool_]:
        """Mask of the parameters at a bound, within a millionth of their range, shape (parameters,)."""
        low, high = self.vector.bounds
        room = _AT_BOUND * (high - low)
        return np.asarray((self.theta <= low + room) | (self.theta >= high - room))

    @property
    def stiffness(self) -> Array:
        """df / d ln k of each value, for the soil of its row, shape (values,)."""
        mine = [
            j for j, p in enumerate(self.vector.of_soils) if p.field == "log_reference_pressure"
        ]
        return np.asarray(self.slopes[:, mine].sum(axis=1))

    @property
    def taken_up(self) -> Array:
        """U, with U U' = J P^-1 J' the covariance that the prior gives to the predictions.

        Shape (values, parameters).
        """
        precision = self.vector.precision(self.theta)
        return np.asarray(self.slopes @ np.linalg.cholesky(np.linalg.inv(precision)))

    def take(self: AnyFit, keep: NDArray[np.bool_]) -> AnyFit:
        """Return the fit with the predictions and slopes of those values where a mask is true."""
        return replace(self, predicted=self.predicted[keep], slopes=self.slopes[keep])

    def away(self, observed: Array) -> Array:
        """Return measured values minus predictions at the centres of the priors, shape (values,).

        The predictions there are extrapolated from theta to first order.
        """
        return observed - self.predicted + self.slopes @ (self.theta - self.vector.centre)


def inverse(matrix: Array) -> Array:
    """Invert a positive definite matrix, scaled to a unit diagonal first.

    Parameters differ by powers of ten in size (1e-8 m/Pa beside 1); scaling gives about the best
    conditioning that is possible. Raises FittingError where the matrix is not positive definite.
    """
    size = np.sqrt(np.diag(matrix))
    if not (np.isfinite(size).all() and (size > 0).all()):
        raise FittingError(
            "a parameter has no influence and no prior: its deviation is not defined"
        )
    try:
        factor = np.linalg.cholesky(matrix / np.outer(size, size))
    except np.linalg.LinAlgError as error:
        raise FittingError("the parameters cannot be told apart at all by this data") from error
    unit = cho_solve((factor, True), np.eye(len(matrix)))
    return np.asarray(unit / np.outer(size, size))


@dataclass(frozen=True, eq=False)
class Fitter:
    """Fits models to one set of points under one variance model.

    Attributes
    ----------
    points
        Measured values, each a mean over rows of one run and setting.
    level
        Size of each value (L in the module `variance`), shape (values,), m, N or N m; the same for all
        fits, so that their evidence can be compared.
    repeats
        Repeatability of the values.
    law
        Function that makes the predictor of the points; by default that of the model itself.
    working
        Whether values are weighted without the errors that many of them share, which would otherwise absorb
        what the parameters can describe (`variance`). The effect of these errors on the parameters is in
        the posterior (`posterior.posterior_covariance`).
    apart
        Whether pull and torque determine only the strength of the soil (`blocks`).
    """

    points: Points
    level: Array
    repeats: Repeats
    law: Callable[[Points], Predictor] = Predictor.of
    working: bool = False
    apart: bool = False

    @cached_property
    def predictor(self) -> Predictor:
        """The predictor of the points."""
        return self.law(self.points)

    @cached_property
    def variance(self) -> VarianceModel:
        """The variance used for the weights."""
        r = self.repeats
        return VarianceModel(self.points, self.level, r.variance, r.stated, working=self.working)

    @cached_property
    def true_variance(self) -> VarianceModel:
        """The variance believed to be true, including the error of the law as this table shows it."""
        if not self.working:
            return self.variance
        r = self.repeats
        return VarianceModel(self.points, self.level, r.variance, r.stated, law_known=False)

    def blocks(self, fit: Fit) -> list[tuple[Mask, Mask]]:
        """Divide parameters and values into blocks that are fitted one after the other.

        There is one block of all, unless `apart`. With it, the error of the law of pull and torque must not
        bend k, n and m: these, and the effects that act on sinkage or resistance, are fitted to sinkage and
        resistance alone, and then the strength to pull and torque (the cut of modular Bayesian models,
        Plummer 2015).

        Parameters
        ----------
        fit
            A fit at any parameters; its slopes show which parameters act on which values.

        Returns
        -------
        list of (ndarray, ndarray)
            For each block, masks of its parameters, shape (parameters,), and of its values, shape
            (values,).
        """
        points = self.points
        forces = np.isin(points.channel, [points.channels.index(name) for name in points.forces])
        if not self.apart or forces.all() or not forces.any():
            return [(np.ones(fit.theta.size, dtype=bool), np.ones(forces.size, dtype=bool))]
        strength = ~np.any(fit.slopes[~forces], axis=0)
        of_soils = fit.vector.of_soils
        strength[: len(of_soils)] |= [p.field not in SOIL_PARAMETERS for p in of_soils]
        return [(~strength, ~forces), (strength, forces)]

    def weights(self, fit: Fit) -> Array:
        """G: weight of each value for each parameter, shape (values, parameters).

        At convergence G' (y - f) = P (theta - centre).
        """
        found, v = np.zeros_like(fit.slopes), self.covariance(fit)
        for mine, seen in self.blocks(fit):
            found[np.ix_(seen, mine)] = v.of(seen).solve(fit.slopes[np.ix_(seen, mine)])
        return found

    @cached_property
    def _apart(self) -> tuple[Fitter, Mask] | None:
        """A fitter of all but pull and torque, and the mask of its values; None without `apart`."""
        points = self.points
        kept = [name for name in points.channels if name not in points.forces]
        if not self.apart or not kept or len(kept) == len(points.channels):
            return None
        mask = np.isin(points.channel, [points.channels.index(name) for name in kept])
        part = self.of_values(mask)
        return replace(part, points=part.points.only(kept), apart=False), mask

    def _components(self, model: VarianceModel, fit: Fit, alone: VarianceModel | None) -> Scatter:
        """Estimate the components of `model` that suit the errors of a fit best.

        `alone` is the variance of all values but pull and torque. Components that it has are estimated from
        these values only, so that the error of the law of pull and torque does not affect the estimated
        firmness of the soil.
        """
        away, start = fit.away(self.points.value), model.suited(fit.scatter)
        if alone is None or self._apart is None:
            return model.fit(away, fit.taken_up, fit.stiffness, start)
        mine = self._apart[1]
        first = alone.fit(away[mine], fit.taken_up[mine], fit.stiffness[mine], alone.suited(start))
        return model.fit(
            away, fit.taken_up, fit.stiffness, start.with_those_of(first), held=first.names
        )

    def true_scatter(self, fit: Fit) -> Scatter:
        """Estimate the components of the true variance (`true_variance`) from the errors of a fit."""
        if not self.working:
            return fit.scatter
        alone = None if self._apart is None else self._apart[0].true_variance
        return self._components(self.true_variance, fit, alone)

    def scatter_covariance(self, fit: Fit, scatter: Scatter) -> Array:
        """Covariance of the estimated logarithms of the variance components.

        Parameters
        ----------
        fit
            A converged fit.
        scatter
            Estimated variance components: `Fitter.true_scatter`.

        Returns
        -------
        ndarray
            Shape (components, components), in the order of `scatter.names`.
        """
        model, given = (
            self.true_variance,
            (fit.away(self.points.value), fit.taken_up, fit.stiffness),
        )
        if self._apart is None:
            return model.uncertainty(*given, scatter)
        part, mine = self._apart
        alone = part.true_variance
        found = model.uncertainty(*given, scatter, held=alone.names)
        places = [scatter.names.index(name) for name in alone.names]
        away, taken_up, stiffness = (one[mine] for one in given)
        own = alone.uncertainty(away, taken_up, stiffness, alone.suited(scatter))
        found[np.ix_(places, places)] = own
        return found

    def under(self, law: Callable[[Points], Predictor]) -> Fitter:
        """Return a fitter of the same points and noise with another law (`law`) for its predictions."""
        return replace(self, law=law)

    def of_values(self, keep: NDArray[np.bool_]) -> Fitter:
        """Return a fitter of the values where a mask is true, with the same levels and repeatability."""
        known = self.repeats
        part = Repeats(known.channels, known.variance[keep], known.stated[keep])
        return replace(self, points=self.points.take(keep), level=self.level[keep], repeats=part)

    def covariance(self, fit: Fit, spread: Array | None = None) -> Covariance:
        """Compute the covariance V by which a fit weights the values' errors, plus U U' if U is given.

        Parameters
        ----------
        fit
            The fit, with its variance components.
        spread
            U, such that U U' is the covariance that the prior of the parameters gives to the predictions
            (`Fit.taken_up`), shape (values, columns).

        Returns
        -------
        Covariance
            Shape (values, values), in the products of the values' units.
        """
        return self.variance.covariance(fit.scatter, fit.stiffness, spread)

    @one_thread
    def at(
        self, vector: ParameterVector, theta: Array | None = None, scatter: Scatter | None = None
    ) -> Fit:
        """Evaluate a model at given parameters, from which a fit can start.

        Parameters
        ----------
        vector
            Names, priors and bounds of the free parameters.
        theta
            Values of the parameters, shape (parameters,), clipped to their bounds; the vector's start if
            not given.
        scatter
            Variance components; those at the medians of their priors if not given.

        Returns
        -------
        Fit
            The model at these parameters, with evidence -inf and an empty covariance.

        Raises
        ------
        FittingError
            If the model has no finite prediction there.
        """
        theta = np.clip(vector.start if theta is None else theta, *vector.bounds)
        predicted, slopes = self.predictor.with_slopes(vector, theta)
        scatter = scatter or self.variance.start
        return Fit(vector, theta, predicted, slopes, scatter, -np.inf, np.zeros((0, 0)))

    @one_thread
    def fit(self, start: Fit, *, turns: int = _TURNS) -> Fit:
        """Fit a model, starting from the parameters and variance components of another fit.

        Parameters
        ----------
        start
            Where to start, as from `at`.
        turns
            Largest number of turns, each of which fits theta and then the variance components; it stops
            early once the evidence changes by less than 0.05 nats. 0 fits theta once and leaves the
            variance components.

        Returns
        -------
        Fit
            With evidence and covariance; perhaps not yet converged (`problem.settled`).
        """
        now, last = replace(start, scatter=self.variance.suited(start.scatter)), -np.inf
        for _ in range(max(turns, 1)):
            now = self._climb(now)
            if turns > 0:
                alone = None if self._apart is None else self._apart[0].variance
                now = replace(now, scatter=self._components(self.variance, now, alone))
            now = self._with_evidence(now)
            if abs(now.evidence - last) < _RESTS:
                break
            last = now.evidence
        return now

    def _climb(self, now: Fit) -> Fit:
        """Fit theta by Gauss-Newton steps with Levenberg's damping, inside the bounds, in each block."""
        for mine, seen in self.blocks(now):
            now = self._climb_of(now, mine, seen)
        return now

    def _climb_of(self, now: Fit, mine: Mask, seen: Mask) -> Fit:
        """Fit the parameters in the mask `mine` to the values in the mask `seen`."""
        observed, vector, v = self.points.value[seen], now.vector, self.covariance(now).of(seen)
        low, high = vector.bounds

        def objective(fit: Fit) -> float:
            white = v.whiten(observed - fit.predicted[seen])
            return float(-0.5 * white @ white) + vector.log_prior(fit.theta)

        value, damping = objective(now), 1e-3
        for _ in range(_STEPS):
            white = v.whiten(np.column_stack([now.slopes[seen], observed - now.predicted[seen]]))
            precision = vector.precision(now.theta)
            normal = white[:, :-1].T @ white[:, :-1] + precision
            pull = white[:, :-1].T @ white[:, -1] - precision @ (now.theta - vector.centre)
            # What a bound holds does not move, and does not hold back the others.
            held = ((now.theta <= low) & (pull < 0)) | ((now.theta >= high) & (pull > 0))
            free = np.flatnonzero(mine & ~held)
            for _ in range(6):
                damped = normal[np.ix_(free, free)]
                damped = damped + damping * np.diag(np.diag(damped))
                tried = now.theta.copy()
                tried[free] += np.linalg.solve(damped, pull[free])
                tried = np.clip(tried, low, high)
                try:
                    f, j = self.predictor.with_slopes(vector, tried)
                except (SmallwheelError, ArithmeticError):
                    damping *= 10.0
                    continue
                there = replace(now, theta=tried, predicted=f, slopes=j)
                reached = objective(there)
                if reached > value:
                    break
                damping = max(8.0 * damping, 1e-2)
            else:
                break
            gain, value, now = reached - value, reached, there
            damping *= 0.2
            if gain < _RESTS:
                break
        return now

    def _with_evidence(self, fit: Fit) -> Fit:
        v, vector = self.covariance(fit), fit.vector
        white = v.whiten(np.column_stack([fit.slopes, self.points.value - fit.predicted]))
        posterior = white[:, :-1].T @ white[:, :-1] + vector.precision(fit.theta)
        covariance = inverse(posterior)
        value = -v.log_root - 0.5 * white[:, -1] @ white[:, -1] + vector.log_prior(fit.theta)
        value += self.variance.log_prior(fit.scatter.log_deviation)
        value += 0.5 * fit.theta.size * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(posterior)[1]
        of_effects = slice(vector.base_size, None)
        deviation = np.sqrt(np.diag(covariance))
        low, high = ((bound - fit.theta) / deviation for bound in vector.bounds)
        inside = (ndtr(high) - ndtr(low))[of_effects]
        value += np.sum(np.log(np.maximum(inside, 1e-9)))
        return replace(fit, evidence=float(value), covariance=covariance)
