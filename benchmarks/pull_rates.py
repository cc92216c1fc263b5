# SPDX-License-Identifier: Apache-2.0
"""How good is the law of pull and torque where the truth is another? Rates over truths of other kinds.

    python benchmarks/pull_rates.py --seeds 0:12 --output docs/pull_rates.md

Each truth integrates stresses of its own over the rim (trapezoids, its own sinkage, its own form of what
moves, presses and shears), none of which is the model's. A model with digging by slip, skid and lugs is
fitted to a rig's table and held against the truth at settings of the same wheels that it did not have,
and at a wheel that it did not have; the last row has plates' and shear tests' numbers instead of a wheel's.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import least_squares
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from smallwheel_ros.effects.registry import effect
from smallwheel_ros.fitting import Base, Problem
from smallwheel_ros.fitting.noise import of_load
from smallwheel_ros.fitting.parameters import part_of
from smallwheel_ros.measurements.wheels import read_measurements
from smallwheel_ros.model.model import Model
from smallwheel_ros.model.model_file import CalibratedModel
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.prediction.prediction import predict_conditions

Array = NDArray[np.float64]
FORCES = ("drawbar_pull", "torque")
_NODES = 801


@dataclass(frozen=True)
class Sand:
    """A sand and a rim as they really are; SI units."""

    k: float
    n: float
    c: float
    phi: float
    K: float
    rim: float
    dug: float
    skid: float
    lugs: float


@dataclass(frozen=True)
class Rows:
    """Settings, shape (rows,)."""

    load: Array
    diameter: Array
    width: Array
    slip: Array
    lug: Array


def sand_of(rng: np.random.Generator) -> Sand:
    return Sand(
        k=float(np.exp(rng.uniform(np.log(4e5), np.log(2e6)))),
        n=rng.uniform(0.8, 1.2), c=float(np.exp(rng.normal(np.log(300), 0.7))), phi=rng.normal(0.57, 0.07),
        K=float(np.exp(rng.normal(np.log(0.012), 0.4))), rim=rng.normal(0.8, 0.08),
        dug=rng.uniform(0.06, 0.14), skid=rng.uniform(1.5, 3.0), lugs=rng.uniform(0.25, 0.65),
    )  # fmt: skip


def depth(s: Sand, at: Rows) -> Array:
    """Sinkage: a parabola's static one, and what slip digs and skid ploughs, in forms of their own."""
    still = (1.5 * at.load / (at.width * s.k * np.sqrt(at.diameter))) ** (1.0 / (s.n + 0.5))
    i, j = np.maximum(at.slip, 0.0), np.maximum(-at.slip, 0.0)
    dug = s.dug * at.diameter * np.sinh(1.2 * i) / np.sinh(1.2) + s.lugs * at.lug * i / (1.05 - i)
    return np.minimum(still * (1.0 + s.skid * j**1.3) + dug, 0.45 * at.diameter)


def stresses(
    s: Sand, at: Rows, *, peak: tuple[float, float] = (0.0, 0.0), rear: float = 0.0, moved: float = 1.0,
    hump: float = 0.0, bias: float = 0.0,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Sinkage, pull and torque.

    peak: c1, c2. rear: of the entry angle, behind. moved: share of its pressure that soil carries which the
    wheel dug. hump: how far shear falls after its peak. bias: of the load.
    """
    z, r = depth(s, at), 0.5 * at.diameter
    still = depth(s, replace(at, slip=0.0 * at.slip))
    first, last = np.arccos(1.0 - z / r), -rear * np.arccos(1.0 - z / r)
    t = first[:, None] + (last - first)[:, None] * np.linspace(0.0, 1.0, _NODES)
    top = (peak[0] + peak[1] * np.abs(at.slip))[:, None] * first[:, None]
    down = np.where(t >= top, (first[:, None] - t) / (first[:, None] - top), (t - last[:, None]) / np.where(
        top > last[:, None], top - last[:, None], 1.0))  # fmt: skip
    if rear == 0.0 and peak == (0.0, 0.0):
        down = 1.0 - t / first[:, None]
    equal = first[:, None] * (1.0 - np.clip(down, 0.0, 1.0))
    share = np.maximum(np.cos(equal) - np.cos(first)[:, None], 0.0) / (1.0 - np.cos(first)[:, None])
    below = share * z[:, None]
    press = share**s.n * np.where(below < (z - still)[:, None], moved, 1.0)
    shoe = r + 0.5 * at.lug
    driven, braked = 1.0 - np.minimum(at.slip, 0.98), 1.0 / np.maximum(1.0 + at.slip, 0.02)
    u = np.where(at.slip >= 0, driven, braked)[:, None]
    slid = shoe[:, None] * ((first[:, None] - t) - u * (np.sin(first)[:, None] - np.sin(t)))
    x = np.abs(slid) / s.K
    called = np.sign(slid) * (1.0 - np.exp(-x)) * (1.0 + hump * x * np.exp(1.0 - x))
    mu = np.where((at.lug > 0) | (at.slip < 0), 1.0, s.rim)[:, None]

    def total(f: Array) -> Array:
        return np.asarray(-np.trapezoid(f, t, axis=1))

    rub, held = mu * np.tan(s.phi) * press * called, mu * s.c * called
    lift = r * total(press * np.cos(t)) + shoe * total(rub * np.sin(t))
    p = (at.load / at.width - shoe * total(held * np.sin(t))) / lift
    shear = p[:, None] * rub + held
    push = at.width * (shoe * total(shear * np.cos(t)) - r * p * total(press * np.sin(t)))
    return z, push + bias * at.load, at.width * shoe**2 * total(shear)


TRUTHS: dict[str, dict[str, Any]] = {
    "pressure peaks ahead (Wong and Reece)": {"peak": (0.35, 0.2)},
    "support behind the lowest point": {"rear": 0.2},
    "moved soil carries half": {"moved": 0.5},
    "shear peaks and falls": {"hump": 0.25, "peak": (0.1, 0.1)},
    "peak ahead, and pull 5 % of the load too high": {"peak": (0.2, 0.3), "bias": 0.05},
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


def rows_of(
    wheels: Sequence[tuple[float, float, float]], loads: Sequence[float], slips: Sequence[float]
) -> Rows:
    grid = [(w, *wheel, i) for wheel in wheels for w in loads for i in slips]
    load, d, b, h, slip = np.array(grid).T
    return Rows(load, d, b, slip, h)


def table(
    s: Sand, truth: dict[str, Any], at: Rows, repeats: int, rng: np.random.Generator, torque: bool
) -> pd.DataFrame:
    """What a rig writes down, with 3 % of scatter in the soil and of noise."""
    parts = []
    for repeat in range(repeats):
        soils = [replace(s, k=s.k * float(np.exp(0.05 * rng.normal()))) for _ in at.load]
        found = [
            stresses(one, Rows(*(v[i : i + 1] for v in vars(at).values())), **truth)
            for i, one in enumerate(soils)
        ]
        z, pull, turn = np.array(found)[:, :, 0].T
        parts.append(pd.DataFrame({
            "run": [f"{repeat}-{i}" for i in range(len(z))], "load [N]": at.load,
            "diameter [m]": at.diameter, "width [m]": at.width, "grouser_height [m]": at.lug, "slip": at.slip,
            "sinkage [m]": np.maximum(z * (1 + 0.03 * rng.normal(size=z.size)), 1e-4),
            "drawbar_pull [N]": pull + 0.01 * at.load * rng.normal(size=z.size),
        } | ({"torque [N m]": turn * (1 + 0.02 * rng.normal(size=z.size))} if torque else {})))  # fmt: skip
    return pd.concat(parts, ignore_index=True)


@dataclass(frozen=True)
class Outcome:
    """Of one table and one kind of fresh rows. off: error over the load (rms). inside: rows in the band."""

    what: str
    channel: str
    off: float
    inside: int
    rows: int


def effects_of(at: Rows) -> list[Any]:
    found = [effect("slip_sinkage", "added_depth")]
    found += [effect("skid_sinkage", "quadratic")] if (at.slip < 0).any() else []
    return found + ([effect("grouser", "lug_digging")] if (at.lug > 0).any() else [])


def judged(
    what: str, model: CalibratedModel, s: Sand, truth: dict[str, Any], at: Rows
) -> Iterator[Outcome]:
    conditions = Conditions.of(at.load, at.diameter, at.width, slip=at.slip, grouser_height=at.lug)
    found, _ = predict_conditions(model, conditions)
    _, pull, torque = stresses(s, at, **truth)
    for name, true in zip(FORCES, (pull, torque), strict=True):
        error = np.asarray(getattr(found.prediction, name)) - true
        share = float(np.sqrt(np.mean((error / of_load(conditions, name)) ** 2)))
        inside = int(np.sum(np.abs(error) <= 1.96 * found.standard_deviation[name]))
        yield Outcome(what, name, share, inside, error.size)


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


def run(truth: str, design: str, seed: int) -> tuple[list[Outcome], tuple[float, float]]:
    """One rig: outcomes, and the fit's error beside that of least squares."""
    rng = np.random.default_rng([seed, list(TRUTHS).index(truth), list(DESIGNS).index(design)])
    s, law = sand_of(rng), TRUTHS[truth]
    wheels, loads, slips, repeats = DESIGNS[design]
    at = rows_of(wheels, loads, slips)
    data = read_measurements(table(s, law, at, repeats, rng, torque=seed % 2 == 0))
    effects = effects_of(at)
    fit = Problem.of(data, Base(parts=tuple(part_of(e) for e in effects))).result()
    fresh = rows_of(wheels, [0.8 * loads[0], 1.2 * loads[-1]], (min(slips) * 0.8, 0.05, 0.25, 0.5))
    other = rows_of([(0.3, 0.13, 0.0)], loads, (0.05, 0.25, 0.5))
    sand = Soil("sand", s.k, s.n, 0.0, s.c, s.phi, s.K)
    names = ("log_reference_pressure", "n", "cohesion", "friction_angle", "log_shear_displacement")
    deviations = np.array([0.05, 0.05, 100.0, 0.02, 0.1])
    lab = CalibratedModel(
        Model(sand), tuple(f"sand.{name}" for name in names), np.diag(deviations**2)
    )
    found = [
        *judged("the same wheels", fit.model, s, law, fresh),
        *judged("another wheel", fit.model, s, law, other),
        *judged("from plates and shear tests", lab, s, law, other),
    ]
    problem = Problem.of(data, Base(parts=tuple(part_of(e) for e in effects)))
    return found, beside_least_squares(problem)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seeds", default="0:12", help="first:last, last not included")
    parser.add_argument("--output", type=Path, help="table for docs/")
    options = parser.parse_args(arguments)
    first, last = (int(part) for part in options.seeds.split(":"))
    tasks = [(t, d, seed) for t in TRUTHS for d in DESIGNS for seed in range(first, last)]
    outcomes: dict[str, list[Outcome]] = {}
    errors: dict[str, list[tuple[float, float]]] = {}
    for truth, design, seed in tqdm(tasks):
        found, pair = run(truth, design, seed)
        outcomes.setdefault(truth, []).extend(found)
        errors.setdefault(truth, []).append(pair)
    lines = [
        "| truth | of | pull off, of load | in its band | torque off | in its band | fit; least squares |"
    ]
    lines += ["| --- | --- | --- | --- | --- | --- | --- |"]
    for truth, made in outcomes.items():
        for what in dict.fromkeys(o.what for o in made):
            mine = {c: [o for o in made if (o.what, o.channel) == (what, c)] for c in FORCES}
            cells = [
                f"{np.sqrt(np.mean([o.off**2 for o in listed])):.3f} | "
                f"{sum(o.inside for o in listed) / sum(o.rows for o in listed):.2f}"
                for listed in mine.values()
            ]
            fit, least = np.sqrt(np.mean(np.square(errors[truth]), axis=0))
            beside = f"{fit:.4f}; {least:.4f}" if what == "the same wheels" else ""
            lines.append(f"| {truth} | {what} | {cells[0]} | {cells[1]} | {beside} |")
    text = "\n".join(lines)
    print(text)
    if options.output:
        head = (
            "# Pull and torque where the truth is another law\n\n"
            f"`python benchmarks/pull_rates.py --seeds {options.seeds}`: {len(tasks)} rigs, "
            f"{len(TRUTHS)} truths, {len(DESIGNS)} designs, every other one with torque. Last column: errors "
            "in sample, of the load, of the fit and of least squares in the same strengths.\n\n"
        )
        options.output.write_text(head + text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
