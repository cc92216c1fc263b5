# SPDX-License-Identifier: Apache-2.0
"""The laws of the table: fits to the training rows of a fold, and predictions of the rest.

Laws of size are fitted to sinkage by the closed form (Meirion-Griffith and Spenko 2011, eq. 7),
with its noise model. With them resistance, pull and torque are predicted from compaction (Bekker
1956) and the thrust of Janosi and Hanamoto (1961), fitted to all channels. A law of your own is
fitted to all that it predicts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from smallwheel_ros.compare.own_law import LawError, OwnLaw
from smallwheel_ros.diagnosis.pipeline import decided, start_of
from smallwheel_ros.fitting.fit import FAILURES, Fit
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.fitting.problem import Base, Problem
from smallwheel_ros.lab.plates import UnderLaw, law_vector, reference_size
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.physics.contact import AXLE_RATIO
from smallwheel_ros.physics.plates import BERNSTEIN_GORIATCHKIN, LAWS, PlateLaw

Array = NDArray[np.float64]

CONSTANT = "The mean of the other parts"
SIZE_LAWS = (BERNSTEIN_GORIATCHKIN, *LAWS[1:], LAWS[0])
ONE_SIZE = "Any of the four laws of size (one size)"
WONG_REECE = "Wong and Reece, peak moves with slip"
INTEGRAL = "Meirion-Griffith & Spenko, integral"
OURS = "Ours, with what it names"
NAMES = (CONSTANT, *(law.name for law in SIZE_LAWS), ONE_SIZE, WONG_REECE, INTEGRAL, OURS)

_CLOSED_FORM = Base(geometry="closed_form", thrust_form="integrated")
_EDGE = 1e-6  # of a range: a share that is nearer to a bound is at it
_TRIED = 3  # starts from which a fit is run: a law may have several minima


@dataclass(frozen=True)
class LawPrediction:
    """Predictions of a law that was fitted to one fold's training rows.

    Attributes
    ----------
    law
        Name of the law.
    value
        Predictions of all measured values of the table, SI, shape (values,); NaN where there is none.
    at_bound
        Names of parameters that are at a bound after the fit.
    effects
        Ids of the effects that a diagnosis added to the law.
    """

    law: str
    value: Array
    at_bound: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()


@dataclass(frozen=True)
class Fold:
    """A table divided into training rows, to which laws are fitted, and rows that they predict.

    Attributes
    ----------
    points
        Points of the whole table.
    seen
        Mask of the training values, shape (values,).
    others
        Table of the training rows.
    """

    points: Points
    seen: NDArray[np.bool_]
    others: Measurements

    @cached_property
    def whole(self) -> Problem:
        """The closed form on all training points; its noise model is also used for laws of your own."""
        return Problem(self.points.take(self.seen), _CLOSED_FORM)

    @cached_property
    def depths(self) -> Problem:
        """The closed form on the training points of sinkage; its noise model is that of the laws of size."""
        return Problem(self.points.take(self.seen).only(("sinkage",)), _CLOSED_FORM)


def predictions(fold: Fold, own: tuple[OwnLaw, ...]) -> Iterator[LawPrediction]:
    """Yield the predictions of every law of the table on one fold; a fit that fails ends the sequence.

    Parameters
    ----------
    fold
        Training rows, and rows that the laws predict.
    own
        Laws of the user's own; one that needs a column that the table lacks is skipped.

    Raises
    ------
    LawError
        If one of `own` fails.
    """
    points = fold.points
    yield _constant(fold)
    there = {"load", "diameter", "width", *points.conditions.covariates}
    one = not {"diameter", "width"} & set(points.varied)
    of_size = SIZE_LAWS[-1:] if one else SIZE_LAWS
    try:
        yield from (_of_size(law, ONE_SIZE if one else law.name, fold) for law in of_size)
        if points.forces:
            fit = Problem.of(fold.others, Base(thrust_form="wong_reece")).fit
            yield LawPrediction(WONG_REECE, _of_model(fit.model, points), _at_bound(fit))
        said = decided(start_of(fold.others))
        for name, result in ((INTEGRAL, said.problem.result()), (OURS, said.fit())):
            held = tuple(p.full_name for p in result.parameters if p.status == "at its bound")
            effects = said.named if name == OURS else ()
            yield LawPrediction(name, _of_model(result.model.model, points), held, effects)
        yield from (_own(law, fold) for law in own if law.needs <= there)
    except LawError:
        raise
    except FAILURES:  # the laws that are left say nothing of this fold, and no law is judged on it
        return


def _constant(fold: Fold) -> LawPrediction:
    points, found = fold.points, np.full(len(fold.points), np.nan)
    for c in range(len(points.channels)):
        mine = points.channel == c
        if (mine & fold.seen).any():
            found[mine] = points.value[mine & fold.seen].mean()
    return LawPrediction(CONSTANT, found)


def _of_size(law: PlateLaw, name: str, fold: Fold) -> LawPrediction:
    """Sinkage by one of the four laws of size; other channels, for the last law alone, by the closed form."""
    points, held = fold.points, Counter[str]()
    found: Array = np.full(len(points), np.nan)
    if law is SIZE_LAWS[-1] and points.channels != ("sinkage",):
        fit = fold.whole.fit
        found = _of_model(fit.model, points)
        held.update(_at_bound(fit))
    if "sinkage" in points.channels:
        problem = fold.depths
        fitter, fit = problem.fitter, problem.fit
        reference = reference_size(law, fitter.points)
        under = fitter.under(partial(UnderLaw, law, reference))
        vector = law_vector(law, fit.vector.of_soils[0].owner)
        start = under.at(vector, vector.begun_at(fit.vector, fit.theta), fit.scatter)
        best = under.fit(start, turns=0)
        depth = law.sinkage(points.conditions, reference, *best.theta.tolist())
        found = np.where(points.of_channel("sinkage"), _values({"sinkage": depth}, points), found)
        held.update(_at_bound(best))
    return LawPrediction(name, found, tuple(held))


def _own(law: OwnLaw, fold: Fold) -> LawPrediction:
    """Fit a user's law by least squares to the training values that it predicts at its best start."""

    def said(shares: Array, points: Points) -> Array:
        """The law's predictions, shape (values,)."""
        return _values(law.predict(shares, points.conditions), points)

    fitter, fit = fold.whole.fitter, fold.whole.fit
    points, starts = fitter.points, law.starts()
    tried = np.array([said(shares, points) for shares in starts])
    off = np.mean(np.abs(np.nan_to_num(tried) - points.value) / fitter.level, axis=1)
    order = np.argsort(off)
    keep = np.isfinite(tried[order[0]])
    if not keep.any() or not law.parameters:
        return LawPrediction(law.name, said(starts[order[0]], fold.points))
    known = points.take(keep)
    known = known.only([points.channels[c] for c in np.unique(known.channel)])
    variance = replace(fitter.of_values(keep), points=known).variance
    noise = variance.covariance(variance.suited(fit.scatter), fit.stiffness[keep])

    def errors(shares: Array) -> Array:
        return noise.whiten(known.value - np.nan_to_num(said(shares, known)))

    ends = [
        least_squares(errors, starts[i], bounds=(0.0, 1.0))  # type: ignore[operator]  # see lab.shear
        for i in order[:_TRIED]
    ]
    shares = min(ends, key=lambda end: float(end.cost)).x
    near = np.minimum(shares, 1.0 - shares) < _EDGE
    held = tuple(p.name for p, at in zip(law.parameters, near, strict=True) if at)
    return LawPrediction(law.name, said(shares, fold.points), held)


def _of_model(model: Model, points: Points) -> Array:
    """Predictions of a model for all values of the points, shape (values,)."""
    said = predict(model, points.conditions, with_forces=bool(points.forces))
    return _values({name: np.asarray(getattr(said, name)) for name in points.channels}, points)


def _values(said: dict[str, Array], points: Points) -> Array:
    """Predictions, by channel, arranged as the measured values, shape (values,); NaN where there is none.

    The sinkage of a wheel is limited to the height of its axle. said: by channel, shape (points,).
    """
    limit = np.where(points.conditions.plate, np.inf, AXLE_RATIO * points.conditions.diameter)
    found = np.full(len(points), np.nan)
    for c, name in enumerate(points.channels):
        if name in said:
            values = np.minimum(said[name], limit) if name == "sinkage" else said[name]
            found[points.channel == c] = values[points.row[points.channel == c]]
    return np.where(np.isfinite(found), found, np.nan)


def _at_bound(fit: Fit) -> tuple[str, ...]:
    return tuple(p.name for p, at in zip(fit.vector.free, fit.at_bound, strict=True) if at)
