# SPDX-License-Identifier: Apache-2.0
"""Plates of several sizes under three laws of size: constants, covariance, and error of a size left out.

The points, their noise and the fit are those of the model (`fit`), so a curve of a thousand rows is no
more evidence than one of ten. The laws (`physics.plates`) share ln p_ref and n; all have the same
prior of the slope d ln p / d ln size at the middle size, 0 +- `_SLOPE`, so that none is favoured:

    theta = (ln p_ref, n, s),  s = slope for the power of D,  -slope for Bekker's,  slope + n for Reece's
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from smallwheel_ros.fitting.constants import ALARM, DETERMINED
from smallwheel_ros.fitting.fit import Fit, Fitter, Predictor
from smallwheel_ros.fitting.held_out import leave_out
from smallwheel_ros.fitting.named import FittedParameter, Status
from smallwheel_ros.fitting.parameters import SOIL_PARAMETERS, FreeParameter, ParameterVector, Prior
from smallwheel_ros.fitting.points import FittingError, Points
from smallwheel_ros.fitting.posterior import posterior_covariance
from smallwheel_ros.fitting.problem import settled
from smallwheel_ros.measurements.display import listed, number
from smallwheel_ros.measurements.settings import cluster
from smallwheel_ros.physics.plates import LAWS, PlateLaw
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_SLOPE = SOIL_PARAMETERS["m"][1].deviation
_BOUNDS = 5.0  # of s: a slope of eight prior deviations
_SAME_SIZE = 0.02  # of ln size: plates are machined to better than that
_RANGES = 4  # of depth, with as many points each: shallow, two between, deep
_ANY = (-np.inf, np.inf)
_REMEDY = "press plates whose sizes differ by a factor of 2 or more"
_HOLDS = 2.0  # expected deviations within which a law holds


@dataclass(frozen=True)
class FittedLaw:
    """One law, fitted to all plates.

    Attributes
    ----------
    law
        The law.
    constants
        Fitted values of the published law's constants. If the unit of one depends on an exponent, it contains
        the exponent's letter, as Pa/m^n.
    covariance
        Covariance of the constants, shape (constants, constants).
    held_out
        Relative error (rms) of the predicted sinkage of plates whose size was left out of the fit; None with
        two sizes, too few to leave one out.
    by_size, by_depth
        The same error by diameter (m), and in each range of `PlateLaws.depths`; empty with two sizes.
    """

    law: PlateLaw
    constants: tuple[FittedParameter, ...]
    covariance: Array
    held_out: float | None = None
    by_size: Mapping[float, float] = field(default_factory=dict)
    by_depth: tuple[float, ...] = ()


@dataclass(frozen=True)
class DepthRange:
    """A range of sinkage in which laws are judged.

    Attributes
    ----------
    low, high
        Ends of the range, m.
    expected
        Relative error (rms) of the sinkage that the true law would have there in a new run.
    """

    low: float
    high: float
    expected: float


@dataclass(frozen=True)
class PlateLaws:
    """The laws of size, fitted to the plates of one soil.

    Attributes
    ----------
    soil
        Name of the soil.
    diameters
        (Equivalent) diameters of the plates, m, rising.
    runs
        Number of runs.
    laws
        Each law, fitted.
    depths
        Ranges of sinkage in which the laws are judged.
    """

    soil: str
    diameters: tuple[float, ...]
    runs: int
    laws: tuple[FittedLaw, ...]
    depths: tuple[DepthRange, ...]

    @property
    def best(self) -> FittedLaw | None:
        """The law with the smallest held-out error; None if no size could be left out."""
        judged = [law for law in self.laws if law.held_out is not None]
        return min(judged, key=lambda law: law.held_out or 0.0) if judged else None

    def better(self, first: FittedLaw, second: FittedLaw) -> bool:
        """Whether the first law predicts left-out sizes better than the second, beyond chance.

        The cases of the test are sizes, not runs.

        Parameters
        ----------
        first, second
            Two of `laws`, with errors by size.
        """
        errors = (np.array([law.by_size[d] for d in first.by_size]) for law in (first, second))
        return clearly_less(*errors)

    def holds(self, law: FittedLaw, at: int) -> bool:
        """Whether the law's error in a range of depth is at most twice what the true law's would be.

        Parameters
        ----------
        law
            One of `laws`, with errors by depth.
        at
            Index of the range in `depths`.
        """
        return law.by_depth[at] <= _HOLDS * self.depths[at].expected


def clearly_less(errors: Array, others: Array) -> bool:
    """Whether errors are smaller than others of the same cases, by more than chance explains.

    It is a paired one-sided t test of their logarithms.

    Parameters
    ----------
    errors, others
        Positive errors of two laws, both in one unit, shape (cases,); two cases or more.
    """
    gain = np.log(others / errors)
    error = max(float(gain.std(ddof=1)) / np.sqrt(gain.size), 1e-300)
    return bool(stdtr(gain.size - 1, -float(gain.mean()) / error) < ALARM)


class UnderLaw(Predictor):
    """Predicts sinkage by one law of size, for a `Fitter`.

    Parameters
    ----------
    law
        Law of size.
    reference
        Size to which its p_ref refers (`reference_size`), m.
    points
        Points of sinkage.
    """

    def __init__(self, law: PlateLaw, reference: float, points: Points) -> None:
        super().__init__(points.conditions, points.channels, points.channel, points.row)
        self.law, self.reference = law, reference

    def sinkage(self, theta: Array) -> Array:
        """Sinkage of each value, m, shape (values,). theta: as in the module's docstring, shape (3,)."""
        found = self.law.sinkage(self.conditions, self.reference, *theta.tolist())
        return np.asarray(found[self.row])

    def with_slopes(self, vector: ParameterVector, theta: Array) -> tuple[Array, Array]:
        """Predicted sinkage (m) and its derivatives, shape (values,) and (values, parameters).

        Parameters
        ----------
        vector
            The law's parameters (`law_vector`), with the steps of the numerical derivatives.
        theta
            Values of the parameters, shape (parameters,).
        """
        base, steps = self.sinkage(theta), vector.steps(theta)
        moved = [self.sinkage(theta + step) for step in np.diag(steps)]
        return base, np.column_stack(moved) / steps - base[:, None] / steps


def law_vector(law: PlateLaw, soil: str) -> ParameterVector:
    """The free parameters of a law of size, theta = (ln p_ref, n, s), with their joint prior.

    Parameters
    ----------
    law
        Law of size.
    soil
        Name of the soil, which owns the parameters.
    """
    (unit, p), (_, n) = SOIL_PARAMETERS["log_reference_pressure"], SOIL_PARAMETERS["n"]
    centre = law.tied_to_n * n.centre
    deviation = float(np.hypot(_SLOPE, law.tied_to_n * n.deviation))
    s = Prior(centre, deviation, -_BOUNDS, _BOUNDS)
    covariance = np.diag([p.deviation**2, n.deviation**2, s.deviation**2])
    covariance[1, 2] = covariance[2, 1] = law.tied_to_n * n.deviation**2
    free = (
        FreeParameter(soil, "log_reference_pressure", p.centre, unit, p),
        FreeParameter(soil, "n", n.centre, "1", n),
        FreeParameter(soil, "size", centre, "1", s),
    )
    precision = np.asarray(np.linalg.inv(covariance))
    return ParameterVector((), "contact_integral", "integrated", (), (), free, precision)


def plate_laws(fitter: Fitter, fit: Fit, soil: str) -> PlateLaws:
    """Fit the laws of size to plates in one soil; with three sizes or more, leave out each in turn.

    Parameters
    ----------
    fitter, fit
        Fitter of these plates' points, and the model fitted to them; its scatter is used for all laws.
    soil
        Name of the soil.

    Raises
    ------
    FittingError
        If the plates are of one size, or all have one sinkage.
    """
    points = fitter.points
    diameter = points.column("diameter")
    size = cluster(np.log(diameter), _SAME_SIZE)
    diameters = [float(diameter[size == i].min()) for i in range(size.max() + 1)]
    if len(diameters) < 2:
        raise FittingError(
            f"all plates have a diameter of {1e3 * diameters[0]:.4g} mm: m, and kc apart from kphi, need "
            "plates of two sizes, and three to check the laws"
        )
    edges = np.unique(np.quantile(points.value, np.linspace(0.0, 1.0, _RANGES + 1)))
    if edges.size < 2:
        raise FittingError(
            f"all plates show a sinkage of {1e3 * edges[0]:.4g} mm, whatever the load: does the gauge move?"
        )
    where = np.searchsorted(edges[1:-1], points.value, side="right")
    # What a value of a new run is off the right law, relative: the root of V.
    believed = fitter.true_variance.covariance(fitter.true_scatter(fit), fit.stiffness)
    variance = np.diag(believed.matrix)
    expected = _rms(np.sqrt(variance) / fitter.level, where)
    laws = []
    for law in LAWS:
        reference = reference_size(law, points)
        under = fitter.under(partial(UnderLaw, law, reference))
        vector = law_vector(law, soil)
        start = under.at(vector, vector.begun_at(fit.vector, fit.theta), fit.scatter)
        # Once more and on: the stiffness in the covariance is that of this law, where it came to rest.
        best = settled(under.fit(start, turns=0), partial(under.fit, turns=0))
        fitted = FittedLaw(law, *_constants(law, under, best, reference))
        if len(diameters) > 2:
            error = left_out(under, best, size)
            fitted = replace(
                fitted,
                held_out=float(np.sqrt(np.mean(error**2))),
                by_size=dict(zip(diameters, _rms(error, size), strict=True)),
                by_depth=tuple(_rms(error, where)),
            )
        laws.append(fitted)
    depths = tuple(map(DepthRange, edges[:-1].tolist(), edges[1:].tolist(), expected))
    return PlateLaws(soil, tuple(diameters), points.run_count, tuple(laws), depths)


def reference_size(law: PlateLaw, points: Points) -> float:
    """Size (m) to which a law's p_ref refers.

    For the law of Meirion-Griffith and Spenko it is the reference diameter of soils, for the others the
    geometric mean of the plates' sizes, diameter or width as the law has it.

    Parameters
    ----------
    law
        Law of size.
    points
        Points of the plates.
    """
    if law.id == "meirion_griffith_spenko":
        return REFERENCE_DIAMETER
    return float(np.exp(np.mean(np.log(law.size(points.conditions)))))


def _rms(values: Array, group: Index) -> list[float]:
    """Root mean square of each group's values. group: code of each value, shape (values,)."""
    squares: list[float] = np.sqrt(np.bincount(group, values**2) / np.bincount(group)).tolist()
    return squares


def left_out(fitter: Fitter, fit: Fit, group: Index) -> Array:
    """Held-out errors: ln of predicted over measured sinkage, shape (values,).

    Each value is predicted by a fit without the runs of its group.

    Parameters
    ----------
    fitter, fit
        Fitter of a law of size, and its fit to all values.
    group
        Number of each value's group, such as the index of its plate's size, shape (values,).
    """
    points = fitter.points
    error = np.full(len(points), np.nan)
    for out in leave_out(group):
        mine = np.isin(points.run, points.run[out])
        alone = fitter.of_values(~mine).fit(fit.take(~mine))
        predicted = fitter.predictor.with_slopes(fit.vector, alone.theta)[0]
        error[mine] = np.log(predicted[mine] / points.value[mine])
    return error


def _constants(
    law: PlateLaw, fitter: Fitter, fit: Fit, reference: float
) -> tuple[tuple[FittedParameter, ...], Array]:
    """The published constants, and their covariance (constants, constants), to first order in theta."""

    def of(theta: Array) -> Array:
        log_pressure, n, s = theta.tolist()
        return np.array(law.constants(law.modulus(log_pressure, n), reference, n, s))

    steps = fit.vector.steps(fit.theta)
    columns = [(of(fit.theta + step) - of(fit.theta - step)) for step in np.diag(steps)]
    slopes = np.column_stack(columns) / (2.0 * steps)
    posterior = posterior_covariance(fitter, fit, fitter.true_scatter(fit))
    covariance = np.asarray(slopes @ posterior @ slopes.T)
    sized = np.sqrt(posterior[2, 2]) <= DETERMINED * _SLOPE
    soil = fit.vector.of_soils[0].owner
    found = []
    for (name, unit), value, std in zip(
        law.names, of(fit.theta).tolist(), np.sqrt(np.diag(covariance)).tolist(), strict=True
    ):
        known: tuple[Status, str] = ("determined", "")
        if not sized and name != "n":
            known = "not determined", _REMEDY
        found.append(FittedParameter(soil, name, value, std, unit, _ANY, *known))
    return tuple(found), covariance


def laws_text(laws: PlateLaws) -> str:
    """Report for people on the laws of size: constants, errors, and which law holds at which depths."""
    sizes = listed([f"{1e3 * d:.4g}" for d in laws.diameters])
    lines = [f"Plates of {sizes} mm in {laws.soil}, {laws.runs} runs"]
    for law in laws.laws:
        lines.append(f"  {law.law.name}: {law.law.formula}")
        off = (
            ""
            if law.held_out is None
            else (f"; the sinkage of a size left out is off by {percent(law.held_out)}")
        )
        lines.append(f"    {', '.join(_constant(c) for c in law.constants)}{off}")
    return "\n".join([*lines, *(f"  {said}" for said in which_law(laws))])


def _constant(c: FittedParameter) -> str:
    unit = "" if c.unit == "1" else f" {c.unit}"
    doubt = "" if c.status == "determined" else " (not determined)"
    return f"{c.name} = {number(c.value)} +- {number(c.std, 2)}{unit}{doubt}"


def percent(share: float) -> str:
    """A share in per cent, two digits."""
    return f"{number(100.0 * share, 2)} %"


def which_law(laws: PlateLaws) -> list[str]:
    """Sentences on which law predicts a new plate size best, and which laws hold at which depths."""
    best = laws.best
    if best is None:
        return [
            f"Two sizes fit every law: which of them holds cannot be told. Press a third size, outside "
            f"{1e3 * laws.diameters[0]:.4g} to {1e3 * laws.diameters[1]:.4g} mm."
        ]
    said = [_comparison(laws, best)]
    everywhere = tuple(law.law.name for law in laws.laws)
    ranges: list[tuple[tuple[str, ...], int, int]] = []
    for at in range(len(laws.depths)):
        holding = tuple(law.law.name for law in laws.laws if laws.holds(law, at))
        first = at
        if ranges and ranges[-1][0] == holding:
            first = ranges.pop()[1]
        ranges.append((holding, first, at))
    if ranges == [(everywhere, 0, len(laws.depths) - 1)]:
        return [
            *said,
            "All hold at all depths that were reached, within what such curves stray by.",
        ]
    return said + [_where_holds(laws, *found) for found in ranges]


def _where_holds(laws: PlateLaws, holding: tuple[str, ...], first: int, last: int) -> str:
    depths = f"From {1e3 * laws.depths[first].low:.2g} to {1e3 * laws.depths[last].high:.2g} mm"
    if len(holding) == len(laws.laws):
        return f"{depths} all hold."
    if holding:
        return f"{depths} {listed(list(holding))} {'holds' if len(holding) == 1 else 'hold'}."
    off = min(max(law.by_depth[first : last + 1]) for law in laws.laws)
    expected = max(d.expected for d in laws.depths[first : last + 1])
    return (
        f"{depths} none holds: the best is off by {percent(off)}, where curves of the right law stray by "
        f"{percent(expected)}."
    )


def _comparison(laws: PlateLaws, best: FittedLaw) -> str:
    others = [law for law in laws.laws if law is not best]
    said = ", ".join(f"{law.law.name}'s {percent(law.held_out or 0.0)}" for law in others)
    first = (
        f"{best.law.name}'s law predicts the sinkage of the size left out within "
        f"{percent(best.held_out or 0.0)}, {said}"
    )
    close = [law.law.name for law in others if not laws.better(best, law)]
    if close:
        return f"{first}; {len(laws.diameters)} sizes do not tell it from {listed(close, 'or')}."
    return f"{first}."


def laws_document(laws: PlateLaws) -> dict[str, Any]:
    """The laws of size as plain values, SI."""
    return {
        "soil": laws.soil,
        "diameters": list(laws.diameters),
        "runs": laws.runs,
        "laws": {
            law.law.id: {
                "formula": law.law.formula,
                "source": law.law.source,
                "constants": {
                    c.name: {"value": c.value, "std": c.std, "unit": c.unit, "status": c.status}
                    for c in law.constants
                },
                "covariance": law.covariance.tolist(),
                "held_out_by_size": law.held_out,
                "by_diameter": [{"diameter": d, "error": e} for d, e in law.by_size.items()],
                "by_depth": [
                    {"from": r.low, "to": r.high, "error": e, "expected": r.expected,
                     "holds": laws.holds(law, at)}
                    for at, (r, e) in enumerate(zip(laws.depths, law.by_depth, strict=False))
                ],
            }
            for law in laws.laws
        },
        "says": which_law(laws),
    }  # fmt: skip
