# SPDX-License-Identifier: Apache-2.0
"""A recorded indentation trial through the node, next to direct fits of the same trial.

    .venv/bin/python examples/press_trial.py FOLDER [-o out/press_trial]

FOLDER holds force-displacement_6.bag, force-displacement_6_zero.bag and force-displacement_6.txt
of the single-wheel rig of Carnegie Mellon University (github.com/robomechanics/3d-terramechanics).
The trial becomes a ROS 2 bag, is played over DDS into the node, and what the node believes at the
end is printed next to three fits that share no code with it.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.demo.demo import recorded
from smallwheel_ros.replay.trial import Trial, TrialSettings, read_trial, write_trial
from smallwheel_ros.ros import config_file

Array = NDArray[np.float64]

NAME = "force-displacement_6"
# What is known of this rig: its log lags 4 h behind (a time zone), and when the wheel went down.
RIG = TrialSettings(log_behind=14400.0, start=6.42, end=19.8)
COMPLIANCE = 0.013e-3  # m/N
DIAMETER, WIDTH = 0.116, 0.050
AT = 0.010  # m: the pressure at this sinkage is what data determines well

# As in config/press_rig.yaml, and the node's prior.
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


def direct_fits(trial: Trial) -> dict[str, Fit]:
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


def run_node(trial: Trial, settings: TrialSettings, folder: Path) -> tuple[Fit, int, int]:
    """Play the trial into the node; give its belief at the end, and its counts."""
    bag = folder / "trial"
    shutil.rmtree(bag, ignore_errors=True)
    write_trial(trial, bag, settings)
    recording = recorded(bag, [config_file("press_rig.yaml")], folder, rate=4.0)
    last = recording.soil[-1]
    # ln of the pressure at the reference sinkage and the wheel's own diameter, with n
    k, n, m = last["k"], last["n"], last["m"]
    x = np.array([np.log(k * AT**n * DIAMETER**m), n])
    jacobian = np.array([[1.0 / k, np.log(AT), np.log(DIAMETER)], [0.0, 1.0, 0.0]])
    covariance = jacobian @ np.reshape(last["covariance"], (3, 3)) @ jacobian.T
    return Fit(x, covariance), last["measurements_accepted"], last["measurements_rejected"]


def line(name: str, fit: Fit) -> str:
    """One line of the table; k D^m is the pressure over AT^n."""
    (log_pressure, n), covariance = fit
    modulus = np.exp(log_pressure) / AT**n
    by_modulus = np.array([1.0, -np.log(AT)])
    spread = modulus * np.sqrt(by_modulus @ covariance @ by_modulus)
    pressure = np.exp(log_pressure)
    deviation = pressure * np.sqrt(covariance[0, 0])
    return (
        f"{name:<30} {modulus:>10.3e} +- {spread:.1e}   {n:.3f} +- {np.sqrt(covariance[1, 1]):.3f}"
        f"   {pressure / 1e3:>6.2f} +- {deviation / 1e3:.2f}"
    )


def main() -> int:
    """Convert, run the node, fit, print; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("out") / "press_trial")
    options = parser.parse_args()
    files = [options.folder / f"{NAME}{end}" for end in (".bag", "_zero.bag", ".txt")]
    try:
        options.output.mkdir(parents=True, exist_ok=True)
        for title, settings in (
            ("as recorded", RIG),
            ("the rig's 0.013 mm/N taken off", replace(RIG, compliance=COMPLIANCE)),
        ):
            trial = read_trial(files[0], files[1], files[2], settings)
            deepest, heaviest = trial.sinkage.max() * 1e3, trial.load.max()
            print(f"{title}: sinkage to {deepest:.1f} mm, load to {heaviest:.0f} N")
            print(f"{'':<30} {'k D^m [Pa/m^n]':>21}   {'n':^14}   p at 10 mm [kPa]")
            fit, accepted, rejected = run_node(trial, settings, options.output)
            print(line(f"node ({accepted} used, {rejected} not)", fit))
            for name, direct in direct_fits(trial).items():
                print(line(name, direct))
            print()
    except SmallwheelError as error:
        print(f"press_trial: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
