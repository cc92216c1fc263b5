# SPDX-License-Identifier: Apache-2.0
"""The result of a fit: a model, the uncertainty of each parameter, and what the data cannot determine."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.result import Result, Writer
from smallwheel_ros.common.threads import one_thread
from smallwheel_ros.fitting.constants import DETERMINED, FORCE_LAW, HIDE, SPREAD
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.held_out import CvErrors, in_sample
from smallwheel_ros.fitting.measured import measured_of
from smallwheel_ros.fitting.named import (
    FittedParameter,
    Status,
    WithParameters,
    derived_parameters,
)
from smallwheel_ros.fitting.noise import RowNoise, of_load, wheel_discrepancy
from smallwheel_ros.fitting.parameters import (
    SOIL_PARAMETERS,
    STRENGTH_PARAMETERS,
    WHEEL_PARAMETERS,
)
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.fitting.posterior import posterior_covariance
from smallwheel_ros.fitting.remedies import remedy_of
from smallwheel_ros.fitting.variance import Scatter, curves_repeated, settings_repeated
from smallwheel_ros.measurements.display import listed, percent, shown_value, words
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.model.measured import Measured
from smallwheel_ros.model.model import CalibratedModel, Model, Prediction, predict
from smallwheel_ros.physics.conditions import Conditions

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from smallwheel_ros.effects.base import Effect

Array = NDArray[np.float64]

_FURTHEST = 0.95  # |slip| up to which the law is held to be so good: a locked wheel is another case
_FAR_OFF = 2.0  # of what the law is usually off by, from which it is wrong where it was measured
_ALIKE = 0.98  # correlation from which two numbers are reported as tied

_STRENGTH = STRENGTH_PARAMETERS | WHEEL_PARAMETERS


@dataclass(frozen=True, repr=False)
class FitResult(WithParameters, Result, shown="views.fit"):
    """A fitted model. `fit["n"]` or `fit.k` is one parameter with its standard deviation.

    Attributes
    ----------
    bare
        The model without its uncertainty, which `model` has.
    measurements
        The data of the fit.
    parameters
        The parameters, each with its standard deviation and status.
    names, covariance
        Names of the parameters that the data influences, as `dry_sand.n`, and their covariance, shape
        (parameters, parameters), as the fit uses them: `log_reference_pressure` in place of k. Parameters
        that are held are in neither.
    noise
        Repeatability of one row, by channel.
    run_scatter
        Standard deviations from run to run: of the soil's `ln k`, and of each channel, relative to its
        values.
    errors
        Measured minus predicted in sample, by channel, shape (rows,).
    outliers
        Numbers of the rows that were left out.
    evidence
        ln of the probability of the data under the model.
    notes
        Sentences on what to know besides the numbers, such as what is not determined.
    held_out
        Root mean square error on runs left out of the fit, by channel, m, N or N m; empty if it was not
        computed.
    measured
        Ranges and scatter of the data, which predictions need.
    """

    bare: Model
    measurements: Measurements
    parameters: tuple[FittedParameter, ...]
    names: tuple[str, ...]
    covariance: Array
    noise: Mapping[str, RowNoise]
    run_scatter: Mapping[str, float]
    errors: CvErrors
    outliers: NDArray[np.intp]
    evidence: float
    notes: tuple[str, ...] = ()
    held_out: Mapping[str, float] = field(default_factory=dict)
    measured: Measured = field(default_factory=Measured)

    @cached_property
    def model(self) -> CalibratedModel:
        """The model with the covariance of its parameters, and its provenance with today's date."""
        data = self.measurements
        provenance: dict[str, object] = {
            "data": data.source,
            "sha256": data.sha256,
            "date": datetime.date.today().isoformat(),
            "rows": len(data),
            "runs": int(data.runs.size),
        }
        if self.held_out:
            provenance["held_out_rmse"] = {name: float(v) for name, v in self.held_out.items()}
        provenance["run_scatter"] = {name: float(v) for name, v in self.run_scatter.items()}
        # A strength that the fit pushed against its bound has no deviation: that is not known, not zero.
        keep = [
            i
            for i, name in enumerate(self.names)
            if name.rsplit(".", 1)[1] not in _STRENGTH or self.covariance[i, i] > 0.0
        ]
        names = tuple(self.names[i] for i in keep)
        covariance = self.covariance[np.ix_(keep, keep)]
        return CalibratedModel(self.bare, names, covariance, provenance, self.measured)

    def __add__(self, effect: Effect | type[Effect] | str) -> CalibratedModel:
        """The model with one more effect, to be fitted or predicted with."""
        return self.model + effect

    def headline(self) -> str:
        """One line: rows kept, the model, how many parameters are determined, and the held-out error."""
        known = sum(p.status == "determined" for p in self.parameters)
        errors = ", ".join(f"{words(n)} {shown_value(n, v)}" for n, v in self.held_out.items())
        said = f"; held-out error: {errors}" if errors else ""
        return (
            f"{rows_kept(self)}{self.bare.headline()}, {known} of {len(self.parameters)} parameters"
            f" determined{said}"
        )

    @cached_property
    def derived(self) -> tuple[FittedParameter, ...]:
        """k of each soil, and its shear deformation modulus where pull or torque was measured."""
        return derived_parameters(self.bare.soils, self.parameters, self.names, self.covariance)

    def named(self) -> Mapping[str, FittedParameter]:
        """Parameters and derived numbers by full name."""
        return {p.full_name: p for p in (*self.parameters, *self.derived)}

    def rows(self) -> list[dict[str, Any]]:
        """The parameters and derived numbers, one mapping each."""
        return [p.row(p.owner) for p in (*self.parameters, *self.derived)]

    def to_dict(self) -> dict[str, Any]:
        """The fit as plain values in SI units."""
        matrix = [[float(f"{v:.6g}") for v in row] for row in self.correlation]
        return {
            "schema": 1,
            "parameters": {p.full_name: p.to_dict() for p in self.parameters},
            "derived": {p.full_name: p.to_dict() for p in self.derived},
            "correlation": {"names": list(self.names), "matrix": matrix},
            "soils": {s.name: {"k": s.k, "n": s.n, "m": s.m} for s in self.bare.soils},
            "noise": {
                name: {"absolute": n.absolute, "relative": n.relative, "source": n.source}
                for name, n in self.noise.items()
            },
            "run_scatter": dict(self.run_scatter),
            "outliers": self.outliers.tolist(),
            "notes": list(self.notes),
            "held_out_rmse": dict(self.held_out),
        }

    def plot(self, ax: Axes | None = None, channel: str | None = None) -> Axes:
        """Draw measured over predicted values, in sample.

        Parameters
        ----------
        ax
            Axes to draw on; new ones if not given.
        channel
            Channel to draw; the first one if not given.

        Returns
        -------
        matplotlib.axes.Axes
            The axes drawn on.
        """
        return self._drawn(ax, channel)

    def _writers(self) -> dict[str, Writer]:
        return super()._writers() | self.model._writers()

    @property
    def residuals(self) -> Mapping[str, Array]:
        """Measured minus predicted in sample, by channel, shape (rows,), NaN where not measured."""
        return self.errors.error

    @property
    def correlation(self) -> Array:
        """Correlations of the parameters, shape (parameters, parameters)."""
        std = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        return np.asarray(self.covariance / np.outer(std, std))

    @property
    def not_determined(self) -> tuple[FittedParameter, ...]:
        """The parameters that this data does not determine, without those at a bound; see `remedy`."""
        return tuple(p for p in self.parameters if p.status in ("not determined", "held"))

    def predict(self, conditions: Conditions) -> Prediction:
        """Predict other conditions with the fitted model, without standard deviations."""
        return predict(self.bare, conditions)


def expected_error(fitter: Fitter, fit: Fit) -> dict[str, float]:
    """Compute the held-out error that the true model would have on a row of a new run.

    It follows from repeatability, and from how soil and instruments differ between runs. A channel whose
    repeatability is not known from repeats or stated deviations is left out, since misfit would count as
    noise.

    Parameters
    ----------
    fitter
        Holds the measured points and their noise.
    fit
        A converged fit by `fitter`.

    Returns
    -------
    dict
        Root mean square error by channel, m, N or N m.
    """
    deviations, found = fit.scatter.deviations, {}
    for name in fitter.points.channels:
        noise = fitter.repeats.channels[name]
        if noise.source == "residuals":
            continue
        mine = fitter.points.of_channel(name)
        level, count = fitter.level[mine], fitter.points.count[mine]
        rows = noise.variance(level) * deviations.get(f"declared:{name}", 1.0) ** 2
        runs = (deviations["tau"] * fit.stiffness[mine]) ** 2
        runs += (deviations[f"own:{name}"] * level) ** 2
        runs += (deviations.get(f"zero:{name}", 0.0) * np.median(level)) ** 2
        found[name] = float(np.sqrt(np.average(rows + runs, weights=count)))
    return found


def unusual(fitter: Fitter, scatter: Scatter) -> dict[str, float]:
    """Return the variance components that are larger than soils and rigs usually have.

    That is, over `HIDE` prior deviations above the median: 95 % of tables have less.

    Parameters
    ----------
    fitter
        Holds the measured points and their noise.
    scatter
        Estimated variance components: `Fitter.true_scatter`.

    Returns
    -------
    dict
        Standard deviation by name of the component, relative (see `Scatter`); empty if none is unusual.
    """
    far = scatter.log_deviation > fitter.true_variance.log_median + HIDE * SPREAD
    return {n: v for (n, v), is_far in zip(scatter.deviations.items(), far, strict=True) if is_far}


def runs_differ(scatter: Mapping[str, float]) -> str:
    """Return a clause that runs differ more than those of one soil, and what to do; empty if they do not.

    Parameters
    ----------
    scatter
        The components that `unusual` returned.
    """
    apart = [f"{percent(size)} in {words(name.removeprefix('own:')) if name != 'tau' else 'firmness'}"
             for name, size in scatter.items() if name == "tau" or name.startswith("own:")]  # fmt: skip
    said = (
        f"runs differ by {listed(apart)}, more than those of one soil: name the soils (column soil)"
    )
    return said if apart else ""


@one_thread
def result_of(fitter: Fitter, fit: Fit, outliers: NDArray[np.intp]) -> FitResult:
    """Make the result of a fit, for users and for model files.

    Parameters
    ----------
    fitter
        Holds the measured points and their noise.
    fit
        A converged fit by `fitter`.
    outliers
        Numbers of the table's rows that were left out.

    Returns
    -------
    FitResult
        Without held-out errors.
    """
    points, model = fitter.points, fit.model
    scatter = fitter.true_scatter(fit)
    covariance = posterior_covariance(fitter, fit, scatter)
    # Strength that nothing reads is no part of the result.
    used = [j for j, p in enumerate(fit.vector.free)
            if p.field not in _STRENGTH or np.any(fit.slopes[:, j])]  # fmt: skip
    parameters = [_parameter(fit, covariance, j, points, scatter) for j in used]
    names = tuple(fit.vector.free[j].name for j in used)
    bounds = SOIL_PARAMETERS["m"][1].low, SOIL_PARAMETERS["m"][1].high
    parameters += [
        FittedParameter(
            soil.name, "m", soil.m, None, "1", bounds, "held", remedy_of("m", points, scatter)
        )
        for soil in fit.vector.soils
        if f"{soil.name}.m" not in names
    ]
    deviations = scatter.deviations
    run_scatter = {"ln k": deviations["tau"]}
    run_scatter |= {
        n.removeprefix("own:"): v for n, v in deviations.items() if n.startswith("own:")
    }
    found = FitResult(
        model,
        points.measurements,
        tuple(parameters),
        names,
        covariance[np.ix_(used, used)],
        dict(fitter.repeats.channels),
        run_scatter,
        in_sample(points, model),
        outliers,
        fit.evidence,
        measured=measured_of(fitter, fit, scatter),
    )
    return replace(found, notes=tuple(_notes(found, points, unusual(fitter, scatter))))


def _parameter(
    fit: Fit, covariance: Array, j: int, points: Points, scatter: Scatter
) -> FittedParameter:
    free, of_soil = fit.vector.free[j], j < fit.vector.base_size
    # Before any data at all, also where this fit began from a known soil.
    before = (SOIL_PARAMETERS | _STRENGTH)[free.field][1] if of_soil else free.prior
    std = float(np.sqrt(covariance[j, j]))
    status: Status = "determined" if std <= DETERMINED * before.deviation else "not determined"
    if fit.at_bound[j]:
        status = "at its bound"
    remedy = f"vary what '{free.owner}' depends on over a wider range, with the rest held"
    if of_soil:
        remedy = remedy_of(free.field, points, scatter)
    return FittedParameter(
        free.owner,
        free.field,
        float(fit.theta[j]),
        None if fit.at_bound[j] else std,
        free.unit,
        (free.prior.low, free.prior.high),
        status,
        "" if status == "determined" else remedy,
    )


def rows_kept(found: FitResult) -> str:
    """Return "N of M rows kept; " for a fit that left rows out as outliers, else an empty text."""
    count, there = found.outliers.size, len(found.measurements)
    return f"{there - count} of {there} rows kept; " if count else ""


def strays(found: FitResult) -> list[str]:
    """Return one sentence on which rows a fit left out and why; empty list if none."""
    if not found.outliers.size:
        return []
    data = found.measurements
    lines = ", ".join(str(line) for line in data.line[found.outliers][:20])
    count = found.outliers.size
    place = data.place + ("" if count == 1 else "s")
    few = "1 row lies far off the others of its run and is" if count == 1 else (
        f"{count} rows lie far off the others of their run and are"
    )  # fmt: skip
    return [f"{rows_kept(found)}{few} left out: {place} {lines}"]


def _notes(found: FitResult, points: Points, scatter: Mapping[str, float]) -> list[str]:
    """Return what to know of a fit besides its numbers; `scatter` has the components that are `unusual`."""
    notes = [*strays(found), *points.notes]
    said = {
        "held": "{0} is held at {1:g}: only k D^m is determined with one wheel diameter; {2}",
        "at its bound": "{0} is at its bound, {1:g}: the data favours values beyond it",
        "not determined": "{0} is not determined by this data: {2}",
    }
    notes += [
        said[p.status].format(p.full_name, p.value, p.remedy)
        for p in found.parameters
        if p.status in said
    ]
    if apart := runs_differ(scatter):
        notes.append(f"{apart}, or record what else differs")
    for a, b in np.argwhere(np.tril(np.abs(found.correlation) > _ALIKE, -1)):
        notes.append(
            f"{found.names[b]} and {found.names[a]} are tied (correlation {found.correlation[a, b]:.3f}): "
            "only a combination of them is determined"
        )
    for name in points.forces:
        off, far = off_by(found.errors.error[name], points.measurements.conditions, name)
        notes += [f"{words(name)} is {off}"] if far else []
    notes += found.bare.cautions(points.conditions)
    if not (settings_repeated(points) or curves_repeated(points)):
        notes.append(
            "no setting was repeated in another run: lack of fit of the law and scatter from run to "
            "run cannot be told apart"
        )
    return notes


def off_by(error: Array, conditions: Conditions, channel: str) -> tuple[str, bool]:
    """Describe how wrong a model's pull or torque is, and whether that is more than usual for its law.

    Parameters
    ----------
    error
        Measured minus predicted, shape (rows,), N or N m; NaN where not measured.
    conditions
        Conditions of the rows, with slip.
    channel
        The channel, `drawbar_pull` or `torque`.

    Returns
    -------
    text, is_far : str, bool
        A clause with the rms error as a share of the load (of torque, load times radius), and advice where
        it is larger than usual; whether it is over twice what is usual. Slips over 0.95 are reported but
        not judged.
    """
    share, known = error / of_load(conditions, channel), np.isfinite(error)
    beyond = known & (np.abs(conditions["slip"]) > _FURTHEST)
    if (beyond == known).all():
        beyond = np.zeros_like(known)
    judged = known & ~beyond
    usual = _rms(np.hypot(FORCE_LAW, wheel_discrepancy(conditions)[judged]))
    off = _rms(share[judged])
    said = f"off by {percent(off)} of the load"
    if beyond.any():
        said += f" ({percent(_rms(share[beyond]))} at slips over {_FURTHEST:g})"
    if off <= _FAR_OFF * usual:
        return f"{said}, about as far as its law usually is ({percent(usual)})", False
    return (
        f"{said}, where its law is usually off by {percent(usual)}: look at its sign and zero, at the zero "
        "of sinkage, and at what else pulls"
    ), True


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
