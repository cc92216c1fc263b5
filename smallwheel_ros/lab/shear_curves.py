# SPDX-License-Identifier: Apache-2.0
"""Shear curves, and the laws fitted to one of them: a few numbers of each run, and how well it knows them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from smallwheel_ros.measurements.settings import LOAD_TOLERANCE
from smallwheel_ros.measurements.shear import ShearTests
from smallwheel_ros.physics.shear import peaked_share, rising_share

Array = NDArray[np.float64]

_BINS = 40  # of a curve, evenly and again in logarithms of displacement: time only
_FEWEST = 5  # rows of a curve: three numbers, and two to check them
# Misfit of a smooth curve is correlated along it: as in `variance`, over a quarter of its length.
STRETCHES = 4.0
_RESOLUTION = 1e-3  # of the strength: no instrument shows more than three digits


class ShearLaw(NamedTuple):
    """One law of shear stress over displacement.

    share: tau / tau_max of (j, ln K [, K_r]). start, low, high: of (ln K / j_max [, K_r]).
    """

    id: str
    name: str
    formula: str
    source: str
    share: Callable[[Array, Array], Array]
    start: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


JANOSI_HANAMOTO = ShearLaw(
    "janosi_hanamoto",
    "Janosi-Hanamoto",
    "tau = (c + sigma tan phi) (1 - exp(-j/K))",
    "Janosi and Hanamoto 1961",
    lambda j, shape: rising_share(j, float(np.exp(shape[0]))),
    (np.log(0.1),),
    (np.log(1e-4),),
    (np.log(100.0),),
)
PEAK_RESIDUAL = ShearLaw(
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
class Curve:
    """One run, averaged in bins of displacement. width: of the bins, m, all of shape (bins,)."""

    run: str
    normal_stress: float
    displacement: Array
    stress: Array
    width: Array

    @property
    def travel(self) -> float:
        """How far it was sheared, m."""
        return float(self.displacement[-1])


@dataclass(frozen=True)
class RunFit:
    """A law fitted to one run. numbers: strength (Pa), ln K, [K_r]; covariance of these.

    misfit: rms over displacement, of the strength.
    """

    curve: Curve
    numbers: Array
    covariance: Array
    misfit: float


def curves_of(tests: ShearTests) -> tuple[list[Curve], list[str]]:
    """The runs as curves, in order of the table; and what was left out."""
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


def _binned(name: str, sigma: float, j: Array, stress: Array) -> Curve:
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
    return Curve(name, sigma, mean_j, mean, np.maximum(width, 1e-6 * end))


def fit_curve(law: ShearLaw, curve: Curve) -> RunFit:
    """Least squares over displacement of one run."""
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
    information = found.jac.T @ found.jac * STRETCHES + 1e-9 * np.eye(found.x.size)
    covariance = (mean_square / free + (_RESOLUTION * found.x[0]) ** 2) * np.linalg.inv(information)
    size = np.ones(found.x.size)
    size[0] = scale
    numbers = found.x * size
    numbers[1] += log_end
    misfit = np.sqrt(mean_square) / abs(found.x[0])
    return RunFit(curve, numbers, covariance * np.outer(size, size), float(misfit))


def normal_stresses(curves: list[Curve]) -> list[float]:
    """The different normal stresses, Pa, in order."""
    found: list[float] = []
    for sigma in sorted(curve.normal_stress for curve in curves):
        if not found or sigma > (1.0 + LOAD_TOLERANCE) * found[-1]:
            found.append(sigma)
    return found
