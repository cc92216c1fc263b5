# SPDX-License-Identifier: Apache-2.0
"""The fit of one model to points, and its evidence.

    y = f(theta) + e,  e ~ N(0, V(phi)),  theta ~ p(theta),  ln phi ~ p(ln phi)

theta by Gauss-Newton steps on  -1/2 |y - f|^2_V + ln p(theta)  with V held, phi by `variance`, in
turns until both rest. The posterior is N(theta, A^-1) with A = J' V^-1 J + P (P the prior's
precision), and the evidence, by Laplace's method,

    ln Z = ln N(y; f, V) + ln p(theta) + ln p(ln phi) + d/2 ln 2 pi - 1/2 ln |A| + ln(inside bounds)

(MacKay 2003, eq. 27.5; the last term for effects' parameters, whose priors end at their bounds).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve
from scipy.special import ndtr
from threadpoolctl import ThreadpoolController

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.effects.base import EffectError
from smallwheel_ros.fitting.covariance import Covariance
from smallwheel_ros.fitting.noise import Repeats
from smallwheel_ros.fitting.parameters import ParameterVector
from smallwheel_ros.fitting.points import FittingError, Points
from smallwheel_ros.fitting.variance import Scatter, VarianceModel
from smallwheel_ros.measurements.columns import FORCES
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]
Index = NDArray[np.intp]

FAILURES = (SmallwheelError, ArithmeticError, ValueError, np.linalg.LinAlgError)  # of a fit
_THREADS = ThreadpoolController()
Function = TypeVar("Function", bound=Callable[..., Any])


def one_thread(function: Function) -> Function:
    """The function with one thread for linear algebra, whatever is set outside of it.

    Matrices here are small: more threads cost more than they bring, many times more on a busy machine.
    """
    return cast(Function, _THREADS.wrap(limits=1, user_api="blas")(function))


_TURNS = 4  # of theta and phi
_STEPS = 10  # of Gauss-Newton in a turn
_RESTS = 0.05  # nats: a gain below which a turn ends
_AT_BOUND = 1e-6  # of the range
_AGREE = 1e-9  # rounding of one model evaluated alone or among copies


class Predictor:
    """Predicts values: of a channel (an index into channels) at a row of the conditions each.

    Keeps the repeated conditions between calls, and which effects take an array of each number.
    """

    def __init__(
        self, conditions: Conditions, channels: Sequence[str], channel: Index, row: Index
    ) -> None:
        self.conditions, self.channels = conditions, tuple(channels)
        self.channel, self.row = channel, row
        self._tiled: dict[int, Conditions] = {}
        self._with_forces = not set(FORCES).isdisjoint(channels)
        self._takes_arrays: dict[tuple[str, ...], bool] = {(): True}
        names = conditions.soil
        codes = np.zeros(len(conditions), dtype=np.intp)
        if names is not None:
            codes = np.unique(names, return_inverse=True)[1].reshape(-1)
        self._soil = codes.astype(str)

    @classmethod
    def of(cls, points: Points) -> Predictor:
        """Predicts these points."""
        return cls(points.conditions, points.channels, points.channel, points.row)

    def __call__(self, vector: ParameterVector, theta: Array) -> Array:
        """Predictions, shape (values,)."""
        return np.asarray(self._values(vector.model(theta), self.conditions, 1)[0])

    def _values(self, model: Model, conditions: Conditions, count: int) -> Array:
        """The values of each copy of the conditions, shape (copies, values)."""
        predicted = predict(model, conditions, with_forces=self._with_forces)
        columns = np.stack([getattr(predicted, n).reshape(count, -1) for n in self.channels])
        return np.asarray(columns[self.channel, :, self.row].T)

    def many(self, vector: ParameterVector, thetas: Array) -> Array:
        """Predictions of each parameter vector, shape (vectors, values).

        An effect that cannot take arrays (a user's own) is evaluated one vector after the other.
        """
        key = tuple(part.id for part in vector.parts)
        if len(thetas) > 1 and self._takes_arrays.get(key, True):
            try:
                model = vector.tiled_model(thetas, len(self.conditions))
                found = self._values(model, self._copies(len(thetas)), len(thetas))
                if key not in self._takes_arrays:
                    alone = self(vector, thetas[-1])
                    same = np.allclose(found[-1], alone, rtol=_AGREE, atol=0.0, equal_nan=True)
                    self._takes_arrays[key] = same
                if self._takes_arrays[key]:
                    return found
            except (EffectError, TypeError, ValueError):
                if not vector.parts:
                    raise
                self._takes_arrays[key] = False
        return np.stack([self(vector, theta) for theta in thetas])

    def _copies(self, count: int) -> Conditions:
        if count not in self._tiled:
            c = self.conditions
            tags = np.concatenate([np.char.add(f"{i}:", self._soil) for i in range(count)])
            self._tiled[count] = Conditions(
                np.tile(c.load, count),
                np.tile(c.diameter, count),
                np.tile(c.width, count),
                np.tile(c.contact, count),
                tags,
                {name: np.tile(column, count) for name, column in c.covariates.items()},
            )
        return self._tiled[count]

    def with_slopes(self, vector: ParameterVector, theta: Array) -> tuple[Array, Array]:
        """Predictions (values,) and their slopes by parameter (values, parameters).

        Raises FittingError where the model has no finite prediction there.
        """
        steps = vector.steps(theta)
        thetas = np.vstack([theta, theta + np.diag(steps)])
        with np.errstate(all="ignore"):  # what is no number is refused below
            found = self.many(vector, thetas)
        bad = np.flatnonzero(~np.isfinite(found).all(axis=0))
        if bad.size:
            raise FittingError(self._no_number(vector, theta, int(bad[0])))
        return found[0], np.asarray((found[1:] - found[0]).T / steps)

    def _no_number(self, vector: ParameterVector, theta: Array, value: int) -> str:
        """Say of which effects the model gives no finite prediction, and at which setting."""
        effects = vector.model(theta).effects
        needs = dict.fromkeys(name for effect in effects for name in effect.needs)
        row = self.row[value]
        setting = [
            f"{n} {self.conditions[n][row]:g}" for n in ("load", "diameter", "width", *needs)
        ]
        return (
            f"the model with {', '.join(e.id for e in effects) or 'no effect'} gives no finite "
            f"{self.channels[self.channel[value]]} at {', '.join(setting)} for the numbers tried"
        )


@dataclass(frozen=True)
class Fit:
    """A fitted model.

    theta, covariance: parameters, shape (parameters,), and their posterior covariance. predicted:
    shape (values,). slopes: J, shape (values, parameters). evidence: ln Z.
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
        """Parameters that sit at a bound, shape (parameters,)."""
        low, high = self.vector.low, self.vector.high
        room = _AT_BOUND * (high - low)
        return np.asarray((self.theta <= low + room) | (self.theta >= high - room))


def inverse(matrix: Array) -> Array:
    """Inverse of a positive definite matrix, scaled to a unit diagonal first.

    Parameters differ by powers of ten in size (1e-8 m/Pa beside 1): the scaled matrix is as well
    conditioned as they can be. Raises FittingError where it is not positive definite.
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

    level: L of `variance`, shape (values,); it is held for all fits, so that their evidence can be
    compared. law: what predicts points, the model if not another. working: pull and torque are
    weighed by their scatter alone, not by what their law is off by. With that in the weights a constant or a
    tilt over slip costs next to nothing, and a fit would leave both to it (Peelle's puzzle); what it does to
    the parameters is in the posterior (`result.posterior_covariance`).
    """

    points: Points
    level: Array
    repeats: Repeats
    law: Callable[[Points], Predictor] = Predictor.of
    working: bool = False

    @cached_property
    def predictor(self) -> Predictor:
        """What predicts the points."""
        return self.law(self.points)

    @cached_property
    def variance(self) -> VarianceModel:
        """The variance that is worked with."""
        known = self.repeats
        return VarianceModel(
            self.points, self.level, known.variance, known.stated, working=self.working
        )

    @cached_property
    def true_variance(self) -> VarianceModel:
        """The variance as it is believed to be."""
        return replace(self, working=False).variance if self.working else self.variance

    def under(self, law: Callable[[Points], Predictor]) -> Fitter:
        """The same points and noise, predicted by another law."""
        return replace(self, law=law)

    def of_runs(self, training: Points) -> Fitter:
        """A fitter of some of the runs, under the same levels and repeatability."""
        return self.of_values(training, np.isin(self.points.run, np.unique(training.run)))

    def of_values(self, training: Points, keep: NDArray[np.bool_]) -> Fitter:
        """A fitter of some of the values, `points.take(keep)`, under the same."""
        known = self.repeats
        part = Repeats(known.channels, known.variance[keep], known.stated[keep])
        return replace(self, points=training, level=self.level[keep], repeats=part)

    @one_thread
    def fit(
        self,
        vector: ParameterVector,
        start: Array | None = None,
        scatter: Scatter | None = None,
        *,
        turns: int = _TURNS,
    ) -> Fit:
        """Fit one model. start: theta to start from. scatter: components to start from.

        turns: 0 fits theta only, under the components given.
        Raises FittingError where the model cannot be evaluated at the start.
        """
        theta = np.clip(vector.start if start is None else start, vector.low, vector.high)
        scatter = self.variance.start if scatter is None else self.variance.suited(scatter)
        predicted, slopes = self.predictor.with_slopes(vector, theta)
        last = -np.inf
        for _ in range(max(turns, 1)):
            v = self.variance.covariance(scatter, stiffness(vector, slopes))
            theta, predicted, slopes = self._climb(vector, theta, predicted, slopes, v)
            if turns > 0:
                away = self.points.value - predicted + slopes @ (theta - vector.centre)
                spread = taken_up(vector, theta, slopes)
                scatter = self.variance.fit(away, spread, stiffness(vector, slopes), scatter)
            evidence, covariance = self._evidence(vector, theta, predicted, slopes, scatter)
            if abs(evidence - last) < _RESTS:
                break
            last = evidence
        return Fit(vector, theta, predicted, slopes, scatter, evidence, covariance)

    def _climb(
        self, vector: ParameterVector, theta: Array, predicted: Array, slopes: Array, v: Covariance
    ) -> tuple[Array, Array, Array]:
        """Gauss-Newton steps with Levenberg's damping, inside the bounds."""
        observed = self.points.value

        def objective(at: Array, f: Array) -> float:
            white = v.whiten(observed - f)
            return float(-0.5 * white @ white) + vector.log_prior(at)

        value, damping = objective(theta, predicted), 1e-3
        for _ in range(_STEPS):
            white = v.whiten(np.column_stack([slopes, observed - predicted]))
            precision = vector.precision(theta)
            normal = white[:, :-1].T @ white[:, :-1] + precision
            pull = white[:, :-1].T @ white[:, -1] - precision @ (theta - vector.centre)
            # What a bound holds does not move, and does not hold back the others.
            held = ((theta <= vector.low) & (pull < 0)) | ((theta >= vector.high) & (pull > 0))
            free = np.flatnonzero(~held)
            improved = False
            for _ in range(6):
                damped = normal[np.ix_(free, free)]
                damped = damped + damping * np.diag(np.diag(damped))
                step = np.zeros(theta.size)
                step[free] = np.linalg.solve(damped, pull[free])
                tried = np.clip(theta + step, vector.low, vector.high)
                try:
                    f, j = self.predictor.with_slopes(vector, tried)
                except (SmallwheelError, ArithmeticError):
                    damping *= 10.0
                    continue
                reached = objective(tried, f)
                if reached > value:
                    improved = True
                    break
                damping = max(8.0 * damping, 1e-2)
            if not improved:
                break
            gain, value = reached - value, reached
            theta, predicted, slopes = tried, f, j
            damping *= 0.2
            if gain < _RESTS:
                break
        return theta, predicted, slopes

    def _evidence(
        self, vector: ParameterVector, theta: Array, predicted: Array, slopes: Array, s: Scatter
    ) -> tuple[float, Array]:
        v = self.variance.covariance(s, stiffness(vector, slopes))
        white = v.whiten(np.column_stack([slopes, self.points.value - predicted]))
        posterior = white[:, :-1].T @ white[:, :-1] + vector.precision(theta)
        covariance = inverse(posterior)
        value = -v.log_root - 0.5 * white[:, -1] @ white[:, -1]
        value += vector.log_prior(theta) + self.variance.log_prior(s)
        value += 0.5 * theta.size * np.log(2.0 * np.pi) - 0.5 * np.linalg.slogdet(posterior)[1]
        for j in range(vector.base_size, theta.size):
            deviation = np.sqrt(covariance[j, j])
            low, high = (b - theta[j] for b in (vector.low[j], vector.high[j]))
            value += np.log(max(ndtr(high / deviation) - ndtr(low / deviation), 1e-9))
        return float(value), covariance


def stiffness(vector: ParameterVector, slopes: Array) -> Array:
    """df / d ln k of each value: each row has one soil."""
    mine = [j for j, p in enumerate(vector.of_soils) if p.field == "log_reference_pressure"]
    return np.asarray(slopes[:, mine].sum(axis=1))


def taken_up(vector: ParameterVector, theta: Array, slopes: Array) -> Array:
    """U with U U' = J P^-1 J': what the parameters can take up of the errors, (values, parameters)."""
    root = np.linalg.cholesky(np.linalg.inv(vector.precision(theta)))
    return np.asarray(slopes @ root)
