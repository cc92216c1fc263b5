# SPDX-License-Identifier: Apache-2.0
"""The indentation trial of a real rig, and fits of it that share no code with the library."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]
Recorded = Any  # `Recorded` of examples/cmu_rig.py

NAME = "force-displacement_6"
DIAMETER, WIDTH = 0.116, 0.050
AT = 0.010  # m: the pressure at this sinkage is what data determines well


def recorded_trial(repository: Path, folder: Path) -> Recorded:
    """Load and sinkage while the wheel goes down. folder: the rig's raw files."""
    spec = spec_from_file_location("cmu_rig", repository / "examples" / "cmu_rig.py")
    assert spec is not None
    assert spec.loader is not None
    rig = module_from_spec(spec)
    sys.modules[spec.name] = rig
    spec.loader.exec_module(rig)
    # Its log lags 4 h behind (a time zone); 6.42 to 19.8 s is when the wheel goes down.
    trial = rig.Press("", NAME, 0, 6.42, 19.8, behind=4)
    bag, zero, log = (folder / f"{NAME}{end}" for end in (".bag", "_zero.bag", ".txt"))
    return rig.recorded(bag, zero, log, trial)


# The noise of config/press_rig.yaml, what this rig scatters by, and the node's prior.
SINKAGE_STD, LOAD_STD, LOAD_RELATIVE = 0.0003, 0.05, 0.01
SCATTER, SCATTER_LENGTH = 0.06, 0.005
PRIOR = (np.log(1604e3 * AT**0.8 * DIAMETER**0.39), 0.8)
PRIOR_STD = (np.hypot(0.7, 0.4 * np.log(DIAMETER / 0.2)), 0.3)


class Fit(NamedTuple):
    """ln of the pressure at `AT`, n, and their covariance."""

    x: Array
    covariance: Array


def load_of(sinkage: Array, log_pressure: float, n: float) -> Array:
    """Load (N) on a pressed wheel: the contact integral over both sides, by quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    radius = DIAMETER / 2
    entry = np.arccos(1.0 - sinkage / radius)
    angle = entry[:, None] * (nodes + 1.0) / 2.0
    depth = np.maximum(radius * (np.cos(angle) - np.cos(entry)[:, None]), 0.0)
    pressure = np.exp(log_pressure) * (depth / AT) ** n
    sums = np.sum(pressure * np.cos(angle) * weights, axis=1)
    return np.asarray(WIDTH * radius * sums * entry)


def sinkage_of(load: Array, x: Array) -> Array:
    """Sinkage (m) under a load (N): the same turned around, by a table."""
    table = np.asarray(np.geomspace(1e-5, DIAMETER / 2, 4000), dtype=float)
    return np.exp(np.interp(np.log(load), np.log(load_of(table, *x)), np.log(table)))


def slopes(model: Callable[[Array], Array], x: Array) -> Array:
    """Derivatives by the parameters, by differences."""
    steps = 1e-5 * np.eye(len(x))
    return np.stack([(model(x + h) - model(x - h)) / 2e-5 for h in steps], axis=1)


def fit_plain(residual: Callable[[Array], Array]) -> Fit:
    """Least squares that take every sample for an independent one."""
    found = least_squares(residual, PRIOR)
    variance = found.fun @ found.fun / (found.fun.size - 2)
    covariance = variance * np.linalg.inv(found.jac.T @ found.jac)
    return Fit(np.asarray(found.x), np.asarray(covariance))


def fit_correlated(sinkage: Array, load: Array) -> Fit:
    """What the node assumes, all at once: ln k scatters along the depth, and the prior counts."""
    spread = np.hypot(LOAD_STD, LOAD_RELATIVE * load) / load
    depth = np.maximum.accumulate(sinkage)
    apart = np.abs(depth[:, None] - depth)
    scatter = SCATTER**2 * np.exp(-apart / SCATTER_LENGTH)
    x = np.array(PRIOR)
    for _ in range(30):
        by_load = (
            load * (sinkage_of(load * 1.001, x) - sinkage_of(load * 0.999, x)) / (0.002 * load)
        )
        noise = np.diag(SINKAGE_STD**2 + (by_load * spread) ** 2)
        covariance = noise + by_load[:, None] * scatter * by_load
        jacobian = slopes(lambda p: sinkage_of(load, p), x)
        weighted = np.linalg.solve(covariance, jacobian)
        information = jacobian.T @ weighted + np.diag(1.0 / np.square(PRIOR_STD))
        gradient = weighted.T @ (sinkage - sinkage_of(load, x))
        step = np.linalg.solve(information, gradient - (x - PRIOR) / np.square(PRIOR_STD))
        x = x + step
        if np.max(np.abs(step)) < 1e-9:
            break
    return Fit(x, np.asarray(np.linalg.inv(information)))


def direct_fits(trial: Recorded) -> dict[str, Fit]:
    """Fit the trial without the library."""
    load = np.interp(trial.sinkage_time, trial.load_time, trial.load)
    sinkage = trial.sinkage
    good = (sinkage > 0) & (load > 0)
    sinkage, load = sinkage[good], load[good]
    return {
        "least squares in sinkage": fit_plain(lambda x: 1e3 * (sinkage_of(load, x) - sinkage)),
        "least squares in ln load": fit_plain(lambda x: np.log(load_of(sinkage, *x) / load)),
        "correlated scatter and prior": fit_correlated(sinkage, load),
    }
