# SPDX-License-Identifier: Apache-2.0
"""What every command starts from: a table reduced to points, the model to fit, and its fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.fitting.fit import Fit, Fitter, Predictor
from smallwheel_ros.fitting.held_out import CvErrors, cross_validate
from smallwheel_ros.fitting.noise import levels_of, outlier_rows, repeats_of
from smallwheel_ros.fitting.parameters import (
    SOIL_PARAMETERS,
    STRENGTH_PARAMETERS,
    USUAL_STRENGTH,
    WHEEL_PARAMETERS,
    Array,
    EffectPart,
    FreeParameter,
    ParameterPrior,
    ParameterVector,
    Prior,
    part_of,
    soil_from,
    soil_numbers,
)
from smallwheel_ros.fitting.points import FittingError, Points, points_of
from smallwheel_ros.fitting.posterior import pull_may_bend
from smallwheel_ros.fitting.result import FitResult, result_of
from smallwheel_ros.measurements.columns import FORCES
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.model.mixture import rivals_text
from smallwheel_ros.model.model import CalibratedModel, Model
from smallwheel_ros.physics.sinkage import Geometry
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.physics.traction import ThrustForm

# A soil is never met again exactly as it was: no prior is tighter than this (standard deviations).
_LEAST = np.array([0.10, 0.05, 0.05])
_MOST_FITS = 6  # of one model from where it was
_FIT_RESTS = 3e-3  # of its deviation: by less no number of a fit moves any more
_ONE_SIZE = 1.02  # wheels that differ by less are of one diameter: m is then not determined
# What a fit begins from a grid in: ln p_ref and n.
_GRID = [(p, n) for n in (0.3, 0.5, 0.7, 1.0, 1.4, 1.9) for p in np.arange(7.0, 15.1, 1.0)]


@dataclass(frozen=True)
class Base:
    """A model to fit, independent of the data.

    Attributes
    ----------
    effects
        Effects that are in the model and not fitted.
    geometry, thrust_form
        Rules of the model for load from sinkage, and for thrust.
    soils
        Soils to start from; their names are those of the table.
    priors
        Priors of soils known beforehand, by name.
    parts
        Effects that are fitted.
    fixed_m
        Value at which m of every soil is held (0 is the law of Bernstein and Goriatchkin); None fits it
        where bodies of several diameters were measured in the soil.
    informed
        Parts that replace those of the same id in `parts` in fits without pull and torque; their priors are
        the posteriors that pull and torque gave. By id; empty unless a fault of the sinkage gauge was found
        by pull and torque (`diagnosis.faults`).
    notes
        Sentences on what the model given by the user has and this one lacks.
    """

    effects: tuple[Effect, ...] = ()
    geometry: Geometry = "contact_integral"
    thrust_form: ThrustForm = "stress_integral"
    soils: tuple[Soil, ...] = ()
    priors: Mapping[str, ParameterPrior] = field(default_factory=dict)
    parts: tuple[EffectPart, ...] = ()
    fixed_m: float | None = None
    informed: Mapping[str, EffectPart] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Ids of the base's effects, those held first."""
        return (*(e.id for e in self.effects), *(part.id for part in self.parts))

    def vector(self, points: Points) -> ParameterVector:
        """The free parameters on these points. Raises FittingError where an effect is given twice."""
        twice = [name for name in self.names if self.names.count(name) > 1]
        if twice:
            raise FittingError(f"effect '{twice[0]}' is given twice: name it once")
        given = {s.name: s for s in self.soils} | {n: p.soil for n, p in self.priors.items()}
        start: list[Soil] = []
        free: list[FreeParameter] = []
        precision: list[Array] = []
        for name in soil_names(points):
            soil = given.get(name) or soil_from(Soil(name, 1e6, 0.9, 0.0), USUAL_STRENGTH)
            if self.fixed_m is not None:
                soil = soil_from(soil, {"m": self.fixed_m})
            start.append(soil)
            numbers, known = soil_numbers(soil), dict(SOIL_PARAMETERS)
            covariance = np.diag([p.deviation**2 for _, p in known.values()])
            if name in self.priors:
                covariance = self.priors[name].covariance
                deviations = np.sqrt(np.diag(covariance)).tolist()
                for (number, (unit, p)), deviation in zip(known.items(), deviations, strict=True):
                    prior = replace(p, centre=numbers[number], deviation=deviation)
                    known[number] = unit, prior
            if self.fixed_m is not None or one_diameter(points, name):
                del known["m"]
                covariance = covariance[:2, :2]
            strength = self._strength(points)
            precision.append(np.linalg.inv(covariance))
            precision += [np.array([[p.deviation**-2]]) for _, p in strength.values()]
            for number, (unit, prior) in (known | strength).items():
                value = numbers[number] if name in given else prior.centre
                value = float(np.clip(value, prior.low, prior.high))
                free.append(FreeParameter(name, number, value, unit, prior))
        return ParameterVector(
            tuple(start), self.geometry, self.thrust_form, self.effects, self.parts, tuple(free),
            np.asarray(block_diag(*precision)),
        )  # fmt: skip

    def _strength(self, points: Points) -> dict[str, tuple[str, Prior]]:
        """Unit and prior of each number of a soil's strength that the measured channels could depend on.

        Without drawbar pull and torque a strength acts only through an effect that uses it (bulldozing, on
        resistance); where no effect does, its posterior is its prior.
        """
        if points.forces:
            own = WHEEL_PARAMETERS if self.thrust_form == "stress_integral" else {}
            return STRENGTH_PARAMETERS | own
        if "resistance" not in points.channels:
            return {}
        return {n: p for n, p in STRENGTH_PARAMETERS.items() if n != "log_shear_displacement"}


def soil_names(points: Points) -> list[str]:
    """Names of the soils of these points; `soil` where the rows name none."""
    named = points.conditions.soil
    return ["soil"] if named is None else [str(name) for name in np.unique(named)]


def one_diameter(points: Points, soil: str) -> bool:
    """Whether all bodies in a soil have the same diameter, within 2 %.

    Parameters
    ----------
    points
        Measured values, each a mean over rows of one run and setting.
    soil
        Name of the soil.
    """
    rows, named = np.unique(points.row), points.conditions.soil
    if named is not None:
        rows = rows[named[rows] == soil]
    sizes = points.conditions.diameter[rows]
    return sizes.size == 0 or bool(sizes.max() <= _ONE_SIZE * sizes.min())


# --- A model file as what is known before


def base_of(known: CalibratedModel, measurements: Measurements, *, free: bool = False) -> Base:
    """Return the model to fit for a user who starts from a known model.

    The prior of its soils has the model's covariance, widened (`soil_priors`), and that of its effects the
    stated standard deviations. If the model states no covariance or was fitted to this very data, its soils
    are only starting values under the usual prior; in the latter case the numbers of its effects are free.

    Parameters
    ----------
    known
        The model with its covariance, as from a model file.
    measurements
        The table to fit.
    free
        Whether to fit those numbers of effects for which the model states no standard deviation; otherwise
        they are held, unless the model was fitted to this very data.
    """
    model = known.model
    return Base(
        geometry=model.geometry,
        thrust_form=model.thrust_form,
        soils=tuple(replace(s, name=name) for name, s in _matched(model, measurements).items()),
        priors=soil_priors(known, measurements),
        parts=tuple(_part(effect, known, measurements, free) for effect in model.effects),
        notes=_of_rivals(known),
    )


def _of_rivals(known: CalibratedModel) -> tuple[str, ...]:
    """Note that of a model of several rivals only their common base is fitted; empty if it has none."""
    if not known.rivals:
        return ()
    return (
        f"the model given is several that its data could not tell apart: {rivals_text(known)}. Their base is "
        "fitted here, without what they differ by; `diagnose` weighs them against each other on this data",
    )


def soil_priors(known: CalibratedModel, measurements: Measurements) -> dict[str, ParameterPrior]:
    """Return the priors that a known model gives to the soils of a table.

    Each covariance is widened, since a soil is never met again exactly as it was.

    Parameters
    ----------
    known
        The model with its covariance, as from a model file.
    measurements
        The table to fit.

    Returns
    -------
    dict
        Prior of each soil by its name in the table; empty where the model was fitted to this very data, or
        states no standard deviations.
    """
    if not known.names or _fitted_to(known, measurements):
        return {}
    priors = {}
    for name, soil in _matched(known.model, measurements).items():
        covariance = np.diag([prior.deviation**2 for _, prior in SOIL_PARAMETERS.values()])
        names = [f"{soil.name}.{number}" for number in SOIL_PARAMETERS]
        there = [i for i, full_name in enumerate(names) if full_name in known.names]
        at = [known.names.index(names[i]) for i in there]
        covariance[np.ix_(there, there)] = known.covariance[np.ix_(at, at)]
        priors[name] = ParameterPrior(replace(soil, name=name), covariance + np.diag(_LEAST**2))
    return priors


def _matched(model: Model, measurements: Measurements) -> dict[str, Soil]:
    """The model's soils by the names that the rows use.

    One soil in the model and one in the rows are the same soil, whatever they are called.
    """
    named = measurements.conditions.soil
    wanted = ["soil"] if named is None else sorted({str(name) for name in named})
    known = {s.name: s for s in model.soils}
    if len(wanted) == 1 and len(known) == 1:
        return dict(zip(wanted, known.values(), strict=True))
    return {name: known[name] for name in wanted if name in known}


def _fitted_to(known: CalibratedModel, measurements: Measurements) -> bool:
    """Whether the model was fitted to this very data: the same evidence must not count twice."""
    return known.provenance.get("sha256") == measurements.sha256


def _part(
    effect: Effect, known: CalibratedModel, measurements: Measurements, unknown_free: bool
) -> EffectPart:
    """Make a part of a fit from an effect, with the standard deviations that the model states as priors.

    A number without one stays where it is, as near as a fit can hold it, or is free if `unknown_free`. All
    are free where the model was fitted to this very data.
    """
    priors, values = {}, dict(effect.values())
    for p in effect.parameters():
        std = known.standard_deviation(f"{effect.id}.{p.name}")
        wide = p.bounds[1] - p.bounds[0]
        free = _fitted_to(known, measurements) or (unknown_free and std is None)
        deviation = wide if free else max(std or 0.0, 1e-4 * wide)
        priors[p.name] = Prior(float(values[p.name]), deviation, *p.bounds)
    return part_of(effect, priors)


# --- Fits


def opening(points: Points, vector: ParameterVector) -> Array:
    """Find a starting point for a fit: for each soil the best of a coarse grid in ln p_ref and n.

    Gauss-Newton steps would not converge from a start that is wrong by a factor of ten. The best point has
    the smallest mean error of ln sinkage, or else of ln resistance.

    Parameters
    ----------
    points
        Measured values, each a mean over rows of one run and setting.
    vector
        Names, priors and bounds of the free parameters.

    Returns
    -------
    ndarray
        Values of the parameters, shape (parameters,); the vector's start where there is neither sinkage nor
        resistance.
    """
    theta = vector.start.copy()
    channel = next((n for n in points.channels if n not in FORCES), None)
    if channel is None:
        return theta
    places = {soil.name: [next(j for j, p in enumerate(vector.of_soils)
                               if (p.owner, p.field) == (soil.name, number))
                          for number in ("log_reference_pressure", "n")]
              for soil in vector.soils}  # fmt: skip
    thetas = np.tile(theta, (len(_GRID), 1))
    for at in places.values():
        thetas[:, at] = _GRID
    thetas = np.clip(thetas, *vector.bounds)
    mask = points.of_channel(channel) & (points.value > 0)
    said = np.maximum(Predictor.of(points).many(vector, thetas)[:, mask], 1e-9)
    off = np.abs(np.log(said) - np.log(points.value[mask]))
    named = points.conditions.soil
    for soil, at in places.items():
        here = np.ones(off.shape[1], bool) if named is None else named[points.row[mask]] == soil
        if here.any():
            theta[at] = thetas[np.argmin(off[:, here].mean(axis=1)), at]
    return theta


def settled(fit: Fit, again: Callable[[Fit], Fit]) -> Fit:
    """Repeat a fit until no parameter moves by more than 0.003 of its standard deviation, at most six times.

    Parameters
    ----------
    fit
        The fit to continue from.
    again
        Function that continues a fit.

    Returns
    -------
    Fit
        The last fit.
    """
    for _ in range(_MOST_FITS):
        last, fit = fit, again(fit)
        deviation = np.sqrt(np.diag(fit.covariance))
        if (np.abs(fit.theta - last.theta) < _FIT_RESTS * deviation).all():
            break
    return fit


@dataclass(frozen=True)
class Problem:
    """The points of a table, and the model to fit to them.

    Attributes
    ----------
    points
        Measured values, reduced from the table.
    base
        The model to fit, with its priors.
    outliers
        Numbers of the table's rows that were left out.
    judging
        Whether models are to be compared, for which values are weighted by the full covariance of their
        errors; otherwise a fit's weights leave out errors that many values share (`Fitter.working`).
    folds
        Results of `fold` that were computed before, by the runs of the training points.
    """

    points: Points
    base: Base = field(default_factory=Base)
    outliers: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    judging: bool = False
    folds: dict[bytes, tuple[Fitter, Fit]] = field(
        default_factory=dict, init=False, compare=False, repr=False
    )

    @classmethod
    def of(cls, measurements: Measurements, base: Base | None = None) -> Problem:
        """Reduce a table to points, without gross outliers.

        Parameters
        ----------
        measurements
            The table of measurements.
        base
            The model to fit; the law without effects if not given.

        Raises
        ------
        FittingError
            If nothing usable is measured.
        """
        problem = cls(points_of(measurements), base or Base())
        return problem.without(outlier_rows(problem.points))

    def without(self, rows: NDArray[np.intp]) -> Problem:
        """Return the same problem with more rows left out; `rows` are numbers of the table's rows."""
        if not rows.size:
            return self
        outliers = np.union1d(self.outliers, rows)
        points = points_of(self.points.measurements, outliers)
        points = points.only([n for n in points.channels if n in self.points.channels])
        return replace(self, points=points, outliers=outliers)

    def with_part(self, part: EffectPart, informed: EffectPart) -> Problem:
        """Return the same problem with one more fitted effect in the base model.

        Parameters
        ----------
        part
            The effect as fits of all channels use it.
        informed
            The same effect as fits without pull and torque use it: its prior is the posterior that pull and
            torque gave (`Base.informed`).
        """
        parts, known = (*self.base.parts, part), {**self.base.informed, part.id: informed}
        return replace(self, base=replace(self.base, parts=parts, informed=known))

    @cached_property
    def vector(self) -> ParameterVector:
        """The free parameters of the base."""
        return self.base.vector(self.points)

    @property
    def fitter(self) -> Fitter:
        """The fitter of the points. Raises FittingError for a single value."""
        return self._fitted[0]

    @property
    def fit(self) -> Fit:
        """The fit of the base, converged."""
        return self._fitted[1]

    @cached_property
    def _fitted(self) -> tuple[Fitter, Fit]:
        points = self.points
        if len(points) < 2:
            raise FittingError("one measurement cannot be fitted: measure at least a few loads")
        level = levels_of(points)
        working = points.share_errors and not self.judging
        # A fault of the shown sinkage that was found by pull and torque is fitted to them, too.
        apart = bool(points.forces) and len(points.forces) < len(points.channels)
        apart = working and apart and not self.base.informed
        fitter = Fitter(points, level, repeats_of(points, level), working=working, apart=apart)
        fit = self._rested(fitter, opening(points, self.vector))
        if apart and pull_may_bend(fitter, fit):
            fitter = replace(fitter, apart=False)
            fit = self._rested(fitter, fit.theta)
        return fitter, fit

    def _rested(self, fitter: Fitter, theta: Array) -> Fit:
        return settled(fitter.fit(fitter.at(self.vector, theta), turns=1), fitter.fit)

    def fold(self, training: Points) -> tuple[Fitter, Fit]:
        """Fit the base to the training points of a fold, starting from its fit to all points.

        Returns a fitter of these points, and the fit. Results are kept in `folds`.
        """
        key = np.unique(training.run).tobytes()
        if key not in self.folds:
            fitter = self.fitter.of_values(self.points.of_runs(training))
            vector = self.base.vector(training)
            theta = vector.begun_at(self.vector, self.fit.theta)
            start = fitter.at(vector, theta, self.fit.scatter)
            self.folds[key] = fitter, fitter.fit(start, turns=2)
        return self.folds[key]

    def held_out(self, done: Callable[[], object] = lambda: None) -> CvErrors | None:
        """Compute held-out errors of the base model; None with one run only.

        `done` is called after the fit of each fold.
        """
        if self.points.run_count < 2:
            return None

        def choose(training: Points) -> list[Model]:
            fit = self.fold(training)[1]
            done()
            return [fit.model]

        return cross_validate(self.points, choose, 1, known=self.base.priors)[0]

    @cached_property
    def deciding(self) -> Problem:
        """The problem with the channels that decide about effects.

        These are all channels, or all but pull and torque if there are others.
        """
        if len(self.points.forces) in (0, len(self.points.channels)):
            return self
        points = self.points.only([n for n in self.points.channels if n not in FORCES])
        parts = tuple(self.base.informed.get(part.id, part) for part in self.base.parts)
        return replace(self, points=points, base=replace(self.base, parts=parts))

    @cached_property
    def judged(self) -> Problem:
        """The problem in which effects are compared: `deciding`, with `judging` where errors are shared."""
        found = self.deciding
        if found.judging or not found.points.share_errors:
            return found
        return replace(found, judging=True)

    def refitted(self, fit: Fit, training: Points | None = None) -> Fit:
        """Refit a model that was selected on `judged` to all channels of this problem.

        Parameters
        ----------
        fit
            Fit of that model on `judged`; returned unchanged where this problem is its own `judged`.
        training
            Training points of a fold, to be fitted alone; all points if not given.

        Returns
        -------
        Fit
            With the weights of this problem; not refitted if the model is the base.
        """
        if self.judged is self:
            return fit
        fitter, base = (self.fitter, self.fit) if training is None else self.fold(training)
        own = {part.id: part for part in self.base.parts}
        parts = tuple(own.get(part.id, part) for part in fit.vector.parts)
        geometry = fit.vector.geometry
        if parts == base.vector.parts and geometry == base.vector.geometry:
            return base
        vector = replace(base.vector, parts=parts, geometry=geometry)
        known = [dict(zip(m.vector.names, m.theta, strict=True)) for m in (base, fit)]
        theta = np.array([(known[0] | known[1]).get(p.name, p.start) for p in vector.free])
        return fitter.fit(fitter.at(vector, theta, base.scatter))

    def result(self, fit: Fit | None = None) -> FitResult:
        """Return the result of a model that was selected on `judged`, refitted; of the base if None."""
        fit = self.fit if fit is None else self.refitted(fit)
        found = result_of(self.fitter, fit, self.outliers)
        return replace(found, notes=(*self.base.notes, *found.notes))
