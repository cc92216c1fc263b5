# SPDX-License-Identifier: Apache-2.0
"""Subject: pull. The law of pull and torque where the truth is another: rigs of `simulate.wheel_laws`.

A model with digging by slip, skid and lugs is fitted to a rig's table and held against the truth at settings
of the same wheels that it did not have, and at a wheel that it did not have; a third model has plates' and
shear tests' numbers instead of a wheel's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import least_squares

from rates.judges import Judge, Line, Subject, ratio
from smallwheel_ros.effects.registry import effect
from smallwheel_ros.fitting import Base, Problem
from smallwheel_ros.fitting.noise import of_load
from smallwheel_ros.fitting.parameters import part_of
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.model.model import CalibratedModel, Model
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.prediction.prediction import predict_conditions
from smallwheel_ros.simulate.truth import Circumstances
from smallwheel_ros.simulate.wheel_laws import RimStrength, Sand, Stresses, response_of

Array = NDArray[np.float64]
Sums = tuple[float, int, int]
FORCES = ("drawbar_pull", "torque")
OF = ("the same wheels", "another wheel", "from plates and shear tests")
TRUTHS = {
    "pressure peaks ahead (Wong and Reece)": Stresses(peak=(0.35, 0.2)),
    "support behind the lowest point": Stresses(rear=0.2),
    "moved soil carries half": Stresses(moved=0.5),
    "shear peaks and falls": Stresses(hump=0.25, peak=(0.1, 0.1)),
    "peak ahead, and pull 5 % of the load too high": Stresses(peak=(0.2, 0.3), bias=0.05),
}
# Wheels (diameter, width, lug height, m), loads (N), slips, runs of each.
DESIGNS: dict[str, tuple[list[tuple[float, float, float]], list[float], Sequence[float], int]] = {
    "one wheel": ([(0.25, 0.10, 0.0)], [80.0], (-0.5, -0.2, -0.1, 0.0, 0.1, 0.2, 0.4, 0.6), 2),
    "smooth and lugs": (
        [(0.2, 0.08, 0.0), (0.2, 0.08, 0.008)], [60.0], (0.0, 0.1, 0.2, 0.3, 0.45, 0.6), 1
    ),
    "three wheels": (
        [(0.15, 0.07, 0.0), (0.25, 0.10, 0.0), (0.35, 0.12, 0.01)], [40.0, 90.0], (0.0, 0.15, 0.3, 0.5), 1
    ),
}  # fmt: skip


def sand_of(rng: np.random.Generator) -> Sand:
    """Draw a sand and a rim."""
    k, n = float(np.exp(rng.uniform(np.log(4e5), np.log(2e6)))), rng.uniform(0.8, 1.2)
    strength = RimStrength(
        cohesion=float(np.exp(rng.normal(np.log(300), 0.7))),
        friction_angle=rng.normal(0.57, 0.07),
        shear_deformation=float(np.exp(rng.normal(np.log(0.012), 0.4))),
    )
    return Sand(
        k, n, strength, rim=rng.normal(0.8, 0.08), dug=rng.uniform(0.06, 0.14),
        skid=rng.uniform(1.5, 3.0), lugs=rng.uniform(0.25, 0.65),
    )  # fmt: skip


def rows_of(
    wheels: Sequence[tuple[float, float, float]], loads: Sequence[float], slips: Sequence[float]
) -> Circumstances:
    grid = [(w, *wheel, i) for wheel in wheels for w in loads for i in slips]
    load, d, b, h, slip = np.array(grid).T
    return Circumstances.of(load=load, diameter=d, width=b, slip=slip, grouser_height=h)


def table(
    s: Sand,
    truth: Stresses,
    at: Circumstances,
    repeats: int,
    rng: np.random.Generator,
    torque: bool,
) -> pd.DataFrame:
    """What a rig writes down, with 3 % of scatter in the soil and of noise."""
    parts = []
    for repeat in range(repeats):
        soil = replace(s, k=s.k * np.exp(0.05 * rng.normal(size=at.load.size)))
        z, pull, turn = response_of(soil, at, truth)
        parts.append(pd.DataFrame({
            "run": [f"{repeat}-{i}" for i in range(len(z))], "load [N]": at.load,
            "diameter [m]": at.diameter, "width [m]": at.width, "grouser_height [m]": at.grouser_height,
            "slip": at.slip,
            "sinkage [m]": np.maximum(z * (1 + 0.03 * rng.normal(size=z.size)), 1e-4),
            "drawbar_pull [N]": pull + 0.01 * at.load * rng.normal(size=z.size),
        } | ({"torque [N m]": turn * (1 + 0.02 * rng.normal(size=z.size))} if torque else {})))  # fmt: skip
    return pd.concat(parts, ignore_index=True)


def effects_of(at: Circumstances) -> list[Any]:
    found = [effect("slip_sinkage", "added_depth")]
    found += [effect("skid_sinkage", "quadratic")] if (at.slip < 0).any() else []
    return found + ([effect("grouser", "lug_digging")] if (at.grouser_height > 0).any() else [])


def sums(model: CalibratedModel, s: Sand, truth: Stresses, at: Circumstances) -> dict[str, Sums]:
    """By channel: squares of the error over the load, rows in the band, rows."""
    conditions = Conditions.of(
        at.load, at.diameter, at.width, slip=at.slip, grouser_height=at.grouser_height
    )
    predicted, _ = predict_conditions(model, conditions)
    _, pull, torque = response_of(s, at, truth)
    found = {}
    for name, true in zip(FORCES, (pull, torque), strict=True):
        error = np.asarray(getattr(predicted.prediction, name)) - true
        inside = np.abs(error) <= 1.96 * predicted.standard_deviation[name]
        squares = float(np.sum((error / of_load(conditions, name)) ** 2))
        found[name] = squares, int(inside.sum()), error.size
    return found


def beside_least_squares(problem: Problem) -> tuple[float, float]:
    """Errors of pull and torque, of the load: of the fit, and of least squares in the same strengths."""
    fit, fitter, vector = problem.fit, problem.fitter, problem.vector
    points = problem.points
    free = [i for i, p in enumerate(vector.free) if p.field in (
        "cohesion", "friction_angle", "log_shear_displacement", "rolling_share", "rim_friction")]  # fmt: skip
    mine = np.any([points.of_channel(name) for name in points.forces], axis=0)

    def errors(x: Array) -> Array:
        theta = fit.theta.copy()
        theta[free] = x
        return np.asarray(((points.value - fitter.predictor(vector, theta)) / fitter.level)[mine])

    low, high = (bound[free] for bound in vector.bounds)
    start = np.clip(fit.theta[free], low + 1e-6 * (high - low), high - 1e-6 * (high - low))
    best = least_squares(errors, start, bounds=(low, high), x_scale=vector.scale[free])
    return float(np.sqrt(np.mean(errors(fit.theta[free]) ** 2))), float(
        np.sqrt(np.mean(best.fun**2))
    )


WORLDS = {f"{truth}; {design}": (truth, design) for truth in TRUTHS for design in DESIGNS}


def trial(world: str, seed: int) -> Line:
    """One rig: sums by channel and kind of fresh rows, and the fit's error beside that of least squares."""
    truth, design = WORLDS[world]
    rng = np.random.default_rng([seed, list(TRUTHS).index(truth), list(DESIGNS).index(design)])
    s, law = sand_of(rng), TRUTHS[truth]
    wheels, loads, slips, repeats = DESIGNS[design]
    at = rows_of(wheels, loads, slips)
    data = read_measurements(table(s, law, at, repeats, rng, torque=seed % 2 == 0))
    problem = Problem.of(data, Base(parts=tuple(part_of(e) for e in effects_of(at))))
    fit = problem.result()
    fresh = rows_of(wheels, [0.8 * loads[0], 1.2 * loads[-1]], (min(slips) * 0.8, 0.05, 0.25, 0.5))
    other = rows_of([(0.3, 0.13, 0.0)], loads, (0.05, 0.25, 0.5))
    held = s.strength
    sand = Soil(
        "sand", float(s.k), s.n, 0.0, held.cohesion, held.friction_angle, held.shear_deformation
    )
    names = ("log_reference_pressure", "n", "cohesion", "friction_angle", "log_shear_displacement")
    deviations = np.array([0.05, 0.05, 100.0, 0.02, 0.1])
    lab = CalibratedModel(
        Model(sand), tuple(f"sand.{name}" for name in names), np.diag(deviations**2)
    )
    ours, least = beside_least_squares(problem)
    found: Line = {"fit": ours, "least": least}
    for what, model, rows in zip(
        OF, (fit.model, fit.model, lab), (fresh, other, other), strict=True
    ):
        of = sums(model, s, law, rows)
        found |= {f"{channel}, {what}": counts for channel, counts in of.items()}
    return found


def _judges(channel: str, what: str) -> list[Judge]:
    key, least = f"{channel}, {what}", 0.85 if what != OF[2] else None
    most = 0.07 if (channel, what) in (("drawbar_pull", OF[0]), ("drawbar_pull", OF[1])) else None
    return [
        Judge(f"{key}: in the 95 % band", ratio(lambda one: one[key][1], lambda one: one[key][2]), least),
        Judge(
            f"{key}: rms error over the load",
            ratio(lambda one: one[key][0], lambda one: one[key][2], root=True), None, most,
        ),
    ]  # fmt: skip


JUDGES = [
    *(judge for what in OF for channel in FORCES for judge in _judges(channel, what)),
    Judge(
        "error over that of least squares",
        ratio(lambda one: one["fit"] ** 2, lambda one: one["least"] ** 2, root=True), None, 1.4,
    ),
]  # fmt: skip
SUBJECTS = [Subject("pull", list(WORLDS), trial, JUDGES, 3, 12.0)]
