# SPDX-License-Identifier: Apache-2.0
"""Shear tests: cohesion, friction angle and shear modulus with their covariance, from runs, not rows.

Each run (a curve at one normal stress) is reduced to a few numbers y_i (strength, ln K and, for the
peaked law, the residual ratio) by least squares over displacement, so that the sampling density
does not matter. Differences between runs are then due to the uncertainty of the fit of each curve (C_i),
and to the soil, which is prepared anew for each run (S):

    y_i = X_i theta + e_i,   e_i ~ N(0, C_i + S),   theta = (c, tan phi, ln K [, K_r])

theta by generalised least squares, ln S by its restricted likelihood with log-normal priors, as in
`variance`. theta has no prior if the runs have several normal stresses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import least_squares, minimize

from smallwheel_ros.fitting.constants import SOIL_SCATTER, SPREAD
from smallwheel_ros.fitting.fit import inverse
from smallwheel_ros.fitting.held_out import leave_out
from smallwheel_ros.fitting.parameters import STRENGTH_PARAMETERS
from smallwheel_ros.fitting.points import FittingError
from smallwheel_ros.fitting.variance import Covariance
from smallwheel_ros.lab.plates import clearly_less
from smallwheel_ros.measurements.measurements import ShearTests
from smallwheel_ros.measurements.settings import LOAD_TOLERANCE, cluster
from smallwheel_ros.physics.shear import peaked_share, rising_share, shear_strength

Array = NDArray[np.float64]

_BINS = 40  # of a curve, evenly and again in logarithms of displacement: time only
_FEWEST = 5  # rows of a curve: three numbers, and two to check them
# Misfit of a smooth curve is correlated along it: as in `variance`, over a quarter of its length.
_STRETCHES = 4.0
_RESOLUTION = 1e-3  # of the strength: no instrument shows more than three digits
# Medians of the priors of the scatter between runs of one soil: of strength, ln K (published K of one soil
# differ by 10 to 40 %) and residual ratio.
_SCATTER = np.array([SOIL_SCATTER, 0.2, SOIL_SCATTER])


class ShearForm(NamedTuple):
    """A law of shear stress over displacement.

    Attributes
    ----------
    id, name, formula, source
        Its id, and for people its name, formula and source.
    share
        Function of displacements j (m), shape (n,), and of the shape parameters (ln K [, K_r]), K in m; it
        returns the stress over its maximum, tau / tau_max, shape (n,).
    start, low, high
        Starting values and bounds of (ln (K / j_max) [, K_r]), where j_max is the largest displacement.
    """

    id: str
    name: str
    formula: str
    source: str
    share: Callable[[Array, Array], Array]
    start: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


JANOSI_HANAMOTO = ShearForm(
    "janosi_hanamoto",
    "Janosi-Hanamoto",
    "tau = (c + sigma tan phi) (1 - exp(-j/K))",
    "Janosi and Hanamoto 1961",
    lambda j, shape: rising_share(j, float(np.exp(shape[0]))),
    (np.log(0.1),),
    (np.log(1e-4),),
    (np.log(100.0),),
)
PEAK_RESIDUAL = ShearForm(
    "peak_residual",
    "peak and residual",
    "tau = (c + sigma tan phi) K_r {1 + [1/(K_r (1 - 1/e)) - 1] exp(1 - j/K_w)} [1 - exp(-j/K_w)]",
    "Wong and Preston-Thomas 1983",
    lambda j, shape: peaked_share(j, float(np.exp(shape[0])), float(np.clip(shape[1], 0.1, 1.0))),
    (np.log(0.2), 0.7),
    (np.log(1e-4), 0.1),
    (np.log(100.0), 1.0),
)


@dataclass(frozen=True)
class ShearCurve:
    """One run, averaged in bins of displacement; arrays of shape (bins,).

    Attributes
    ----------
    run
        Name of the run.
    normal_stress
        Mean normal stress of the run, Pa.
    displacement, stress
        Mean displacement (m) and shear stress (Pa) in each bin.
    width
        Length of displacement that each bin stands for, m: its weight in a fit.
    """

    run: str
    normal_stress: float
    displacement: Array
    stress: Array
    width: Array

    @property
    def travel(self) -> float:
        """Largest displacement, m."""
        return float(self.displacement[-1])


@dataclass(frozen=True)
class RunFit:
    """A law fitted to one run.

    Attributes
    ----------
    curve
        The run.
    numbers, covariance
        Strength (Pa), ln of K in m and, for the peaked law, K_r, shape (2,) or (3,); and their
        covariance, shape (2, 2) or (3, 3).
    misfit
        Root mean square error along the curve, as a fraction of the strength.
    """

    curve: ShearCurve
    numbers: Array
    covariance: Array
    misfit: float


def curves_of(tests: ShearTests) -> tuple[list[ShearCurve], list[str]]:
    """The runs as curves, in the order of the table; and notes on what was left out or averaged.

    Only rows whose displacement is over 0 and does not fall are used.
    """
    curves, notes = [], []
    for name in dict.fromkeys(tests.run.tolist()):
        rows = np.flatnonzero(tests.run == name)
        j, stress = tests.displacement[rows], tests.shear_stress[rows]
        used = (j > 0.0) & (j >= np.maximum.accumulate(j))
        if used.sum() < _FEWEST:
            notes.append(
                f"run '{name}' is left out: {int(used.sum())} rows of rising displacement over 0, "
                f"expected {_FEWEST}"
            )
            continue
        j, stress = j[used], stress[used]
        if not stress.max() > 0.0:
            notes.append(
                f"run '{name}' is left out: its shear stress is nowhere over 0; is its sign reversed?"
            )
            continue
        sigma = tests.normal_stress[rows][used]
        if np.ptp(sigma) > LOAD_TOLERANCE * sigma.mean():
            notes.append(
                f"run '{name}': the normal stress varies from {1e-3 * sigma.min():.4g} to "
                f"{1e-3 * sigma.max():.4g} kPa along the curve; its mean is taken"
            )
        curves.append(_binned(name, float(sigma.mean()), j, stress))
    return curves, notes


def _binned(name: str, sigma: float, j: Array, stress: Array) -> ShearCurve:
    end = float(j[-1])
    edges = np.union1d(np.linspace(0.0, end, _BINS + 1), np.geomspace(1e-3 * end, end, _BINS + 1))
    place = np.clip(np.searchsorted(edges, j, side="left"), 1, edges.size - 1)
    count = np.bincount(place, minlength=edges.size)
    kept = np.flatnonzero(count)
    mean_j = np.bincount(place, j)[kept] / count[kept]
    mean = np.bincount(place, stress)[kept] / count[kept]
    # each bin stands for the displacement up to halfway to its neighbours
    middle = 0.5 * (mean_j[1:] + mean_j[:-1])
    width = np.diff(np.concatenate([[0.0], middle, [end]]))
    return ShearCurve(name, sigma, mean_j, mean, np.maximum(width, 1e-6 * end))


def fit_curve(law: ShearForm, curve: ShearCurve) -> RunFit:
    """Fit a law to one run by least squares over displacement: its strength, ln K and, if it has one, K_r.

    Parameters
    ----------
    law
        Law of shear stress over displacement.
    curve
        The run.
    """
    weight = np.sqrt(curve.width / curve.width.sum())
    scale, log_end = float(np.max(np.abs(curve.stress))), np.log(curve.travel)

    def predicted(x: Array) -> Array:
        shape = x[1:].copy()
        shape[0] += log_end
        return np.asarray(x[0] * law.share(curve.displacement, shape))

    def off(x: Array) -> Array:
        return np.asarray(weight * (predicted(x) - curve.stress / scale))

    found = least_squares(  # type: ignore[operator]  # the stubs take it for its module
        off,
        (1.0, *law.start),
        bounds=((-10.0, *law.low), (1e3, *law.high)),
        x_scale=np.array([1.0, 1.0, 0.3][: 1 + len(law.start)]),
    )
    mean_square = 2.0 * float(found.cost)
    free = max(1.0 - (1 + len(law.start)) / curve.displacement.size, 0.1)
    information = found.jac.T @ found.jac * _STRETCHES + 1e-9 * np.eye(found.x.size)
    covariance = (mean_square / free + (_RESOLUTION * found.x[0]) ** 2) * np.linalg.inv(information)
    size = np.ones(found.x.size)
    size[0] = scale
    numbers = found.x * size
    numbers[1] += log_end
    misfit = np.sqrt(mean_square) / abs(found.x[0])
    return RunFit(curve, numbers, covariance * np.outer(size, size), float(misfit))


def normal_stresses(runs: Sequence[RunFit]) -> list[float]:
    """The different normal stresses, Pa, rising; those that differ by less than 10 % count as one."""
    sigma = np.array([run.curve.normal_stress for run in runs])
    same = cluster(np.log(sigma), LOAD_TOLERANCE)
    return [float(sigma[same == i].min()) for i in range(same.max() + 1)]


@dataclass(frozen=True)
class FittedShearLaw:
    """A law fitted to all runs of one soil.

    Attributes
    ----------
    law
        The law.
    names, values
        Names and values of c (Pa), tan phi, ln K (K in m) and, for the peaked law, K_r; shape (3,) or (4,).
    covariance
        Covariance of `values`, shape (3, 3) or (4, 4).
    held_out
        Error (rms) on curves that were left out when the shape was fitted, as a fraction of the strength;
        None with one run.
    scatter
        Standard deviation from run to run of the strength (relative), ln K and, for the peaked law, K_r;
        shape (2,) or (3,).
    runs
        The law fitted to each run alone.
    """

    law: ShearForm
    names: tuple[str, ...]
    values: Array
    covariance: Array
    held_out: float | None
    scatter: Array
    runs: tuple[RunFit, ...]


def fit_law(law: ShearForm, curves: list[ShearCurve]) -> FittedShearLaw:
    """Fit one law to all runs of one soil: c, tan phi, ln K and, if the law has one, K_r.

    Parameters
    ----------
    law
        Law of shear stress over displacement.
    curves
        The runs, at least one.
    """
    runs = tuple(fit_curve(law, curve) for curve in curves)
    # the size of the scatter from the line through all runs, not from each run's own value
    first = _Regression(runs, np.array([run.numbers[0] for run in runs]))
    c, friction = first.solved(first.medians)[0][:2]
    stresses = np.array([curve.normal_stress for curve in curves])
    problem = _Regression(runs, shear_strength(stresses, c, friction))
    # the scatter is known to a factor of two: no more digits than that asks for
    log_scatter = minimize(
        problem.cost, problem.medians, method="Nelder-Mead", options={"xatol": 1e-2, "fatol": 1e-3}
    ).x
    theta = problem.solved(log_scatter)[0]
    return FittedShearLaw(
        law,
        ("c", "tan phi", "ln K", "K_r")[: theta.size],
        theta,
        problem.averaged(log_scatter),
        float(np.sqrt(np.mean(_shape_errors(law, runs) ** 2))) if len(runs) > 1 else None,
        np.exp(log_scatter),
        runs,
    )


class _Regression:
    """Regression of the runs' numbers y on theta (module's docstring); V has a block C_i + S for each run.

    level: strength of each run, Pa, shape (runs,), to which the scatter of strengths is relative.

    `_design` is X, shape (values, parameters); `_centre` and `_precision` are the prior of theta, 0 for none;
    `medians` are those of the prior of ln scatter.
    """

    def __init__(self, runs: Sequence[RunFit], level: Array) -> None:
        count, size = len(runs), runs[0].numbers.size
        self.medians = np.log(_SCATTER[:size])
        self._known = np.array([run.covariance for run in runs])
        self._unit = np.ones((count, size))
        self._unit[:, 0] = np.maximum(np.abs(level), 1e-3 * np.max(np.abs(level))) ** 2
        self._number = np.concatenate([run.numbers for run in runs])
        self._design = np.tile(np.eye(size, size + 1, 1), (count, 1))
        self._design[::size, :2] = [(1.0, run.curve.normal_stress) for run in runs]
        self._centre, self._precision = np.zeros((2, size + 1))
        if len(normal_stresses(runs)) < 2:
            # Only c + sigma tan phi is measured: the prior of soils gives the rest.
            c, phi = (STRENGTH_PARAMETERS[n][1] for n in ("cohesion", "friction_angle"))
            self._centre[:2] = c.centre, np.tan(phi.centre)
            self._precision[:2] = c.deviation**-2, (phi.deviation / np.cos(phi.centre) ** 2) ** -2

    def _covariance(self, log_scatter: Array) -> Covariance:
        between = self._unit * np.exp(2.0 * log_scatter)
        parts = self._known + between[:, :, None] * np.eye(log_scatter.size)
        return Covariance(np.asarray(block_diag(*parts)))

    def solved(self, log_scatter: Array) -> tuple[Array, Array]:
        """Theta and its covariance by generalised least squares, for a given ln of the scatter."""
        weighted = self._covariance(log_scatter).solve(self._design)
        covariance = inverse(weighted.T @ self._design + np.diag(self._precision))
        return covariance @ (weighted.T @ self._number + self._precision * self._centre), covariance

    def cost(self, log_scatter: Array) -> float:
        """Minus ln of the restricted likelihood of the scatter times its prior, but for a constant."""
        theta, covariance = self.solved(log_scatter)
        v = self._covariance(log_scatter)
        white = v.whiten(self._number - self._design @ theta)
        away = np.sqrt(self._precision) * (theta - self._centre)
        off = (log_scatter - self.medians) / SPREAD
        squares = float(white @ white + away @ away + off @ off)
        return 0.5 * squares + v.log_root - 0.5 * float(np.linalg.slogdet(covariance)[1])

    def averaged(self, log_scatter: Array) -> Array:
        """Covariance of theta, averaged over the uncertainty of the scatter, as in `posterior_covariance`."""
        size, h = log_scatter.size, 0.1
        curvature = np.empty((size, size))
        for a, b in np.ndindex(size, size):
            corners = [i * j * self.cost(log_scatter + h * (i * np.eye(size)[a] + j * np.eye(size)[b]))
                       for i in (1, -1) for j in (1, -1)]  # fmt: skip
            curvature[a, b] = sum(corners) / (4.0 * h * h)
        # of one run it is the prior's alone: rounding must not choose the axes
        values, vectors = np.linalg.eigh(np.round(curvature, 9))
        # nowhere less sure than the prior alone
        root = np.sqrt(size) * vectors / np.sqrt(np.maximum(values, SPREAD**-2))
        points = log_scatter + np.vstack([root.T, -root.T])
        return np.asarray(np.mean([self.solved(at)[1] for at in points], axis=0))


def _shape_errors(law: ShearForm, runs: Sequence[RunFit]) -> Array:
    """Error (rms) of the other runs' shape on each run's curve, as a fraction of that run's strength.

    Shape (runs,).
    """
    numbers = np.array([run.numbers[1:] for run in runs])
    between = _SCATTER[1 : 1 + numbers.shape[1]] ** 2
    weight = 1.0 / (np.array([np.diag(run.covariance)[1:] for run in runs]) + between)
    found = []
    for out, run in zip(leave_out(np.arange(len(runs))), runs, strict=True):
        shape = np.average(numbers[~out], axis=0, weights=weight[~out])
        curve = run.curve
        share = law.share(curve.displacement, shape)
        width = curve.width / curve.width.sum()
        strength = float(width @ (share * curve.stress) / (width @ share**2))
        error = (curve.stress - strength * share) / strength
        found.append(float(np.sqrt(width @ error**2)))
    return np.array(found)


def _shows_peak(plain: FittedShearLaw, peaked: FittedShearLaw) -> bool:
    """Whether the curves show a peak: the law with a peak must predict runs that were left out better.

    A single run is judged by Schwarz's criterion instead. In addition, the stress must by that law fall from
    the peak by more than the law's misfit.
    """
    travel = np.asarray(
        max(run.curve.travel for run in plain.runs) * np.arange(1, 201) / 200.0, dtype=np.float64
    )
    share = peaked.law.share(travel, peaked.values[2:])
    if share.max() - share[-1] <= np.mean([run.misfit for run in peaked.runs]):
        return False
    if len(plain.runs) == 1:
        first, second = plain.runs[0].misfit, peaked.runs[0].misfit
        return bool(2.0 * _STRETCHES * np.log(first / second) > np.log(_STRETCHES))
    return clearly_less(*(_shape_errors(fit.law, fit.runs) for fit in (peaked, plain)))


@dataclass(frozen=True)
class ShearFit:
    """The shear tests of one soil, fitted by both laws.

    Attributes
    ----------
    soil
        Name of the soil; empty if the table names none.
    plain
        Fit of Janosi and Hanamoto's law, which has no peak.
    peaked
        Fit of the law with a peak and a residual strength.
    shows_peak
        Whether the curves show a peak.
    notes
        Sentences on runs that were left out or averaged.
    """

    soil: str
    plain: FittedShearLaw
    peaked: FittedShearLaw
    shows_peak: bool
    notes: tuple[str, ...]

    @property
    def chosen(self) -> FittedShearLaw:
        """`peaked` if the curves show a peak, else `plain`."""
        return self.peaked if self.shows_peak else self.plain


def fit_shear(tests: ShearTests) -> tuple[ShearFit, ...]:
    """Fit both laws to the shear tests of each soil of a table; one result for each soil.

    Raises FittingError if no run of a soil can be used.
    """
    found = []
    for soil in dict.fromkeys(tests.soil.tolist()):
        curves, notes = curves_of(tests.take(tests.soil == soil))
        if not curves:
            raise FittingError(
                f"{tests.source}: no shear test can be used: {'; '.join(notes) or 'no rows'}"
            )
        plain, peaked = (fit_law(law, curves) for law in (JANOSI_HANAMOTO, PEAK_RESIDUAL))
        found.append(ShearFit(soil, plain, peaked, _shows_peak(plain, peaked), tuple(notes)))
    return tuple(found)
