# SPDX-License-Identifier: Apache-2.0
"""Tables of measurements from the truth simulator, made as a world of `worlds.py` asks for them.

A world has two parts from one truth: part 0 is the table to diagnose, part 1 holds fresh runs. Soil,
wheels and hidden effects depend on the seed alone, runs and noise on the seed and the part.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.signal import lfilter

from smallwheel_ros.simulate import RigSettings, measure, simulate_rig
from smallwheel_ros.simulate.hidden import draw_effects
from smallwheel_ros.simulate.rig import RigDesign, RunSettings, draw_design, draw_runs
from smallwheel_ros.simulate.truth import (
    Circumstances,
    HiddenEffect,
    Response,
    TruthSoil,
    WheelsOnSoil,
    shown_by_instrument,
)

Array = NDArray[np.float64]
Pull = Callable[[TruthSoil, Circumstances, Response], Array]
Draw = Callable[[np.random.Generator, int], Array]  # noise of standard deviation 1

HEADERS = {
    "load": ("load [N]", 1.0),
    "diameter": ("diameter [mm]", 1e3),
    "width": ("width [mm]", 1e3),
    "slip": ("slip", 1.0),
    "speed": ("speed [mm/s]", 1e3),
    "pass_number": ("pass_number", 1.0),
    "sinkage": ("sinkage [mm]", 1e3),
    "resistance": ("resistance [N]", 1.0),
    "drawbar_pull": ("drawbar_pull [N]", 1.0),
}
# Absolute noise beside the relative one, in m and N.
ABSOLUTE_NOISE = {"sinkage": 0.15e-3, "resistance": 0.15, "drawbar_pull": 0.3}


def stream(seed: int, part: int, *purpose: int) -> np.random.Generator:
    return np.random.default_rng([seed, part, *purpose])


def correlated(rng: np.random.Generator, rows: int, length: float) -> Array:
    """An Ornstein-Uhlenbeck series of unit variance; its correlation falls over `length` rows."""
    keep = np.exp(-1.0 / length)
    shocks = rng.normal(0.0, np.sqrt(1.0 - keep**2), rows)
    shocks[0] = rng.normal()
    series: Array = lfilter([1.0], [1.0, -keep], shocks)
    return series


def gaussian(rng: np.random.Generator, size: int) -> Array:
    return rng.normal(0.0, 1.0, size)


def heavy_tailed(rng: np.random.Generator, size: int) -> Array:
    """Student's t with three degrees of freedom, scaled to unit variance."""
    return rng.standard_t(3, size) / np.sqrt(3.0)


def rig_table(seed: int, part: int, hidden: Sequence[str] = (), **settings: object) -> pd.DataFrame:
    """The table of `smallwheel simulate rig`, or (part 1) as many fresh runs of the same truth."""
    rig = simulate_rig(RigSettings(seed=seed, hidden=tuple(hidden), **settings))  # type: ignore[arg-type]
    if part == 0:
        return rig.table
    truth = rig.truth
    runs = draw_runs(truth.design, truth.effects, len(truth.runs), stream(seed, part, 22))
    return measure(truth, runs)


@dataclass(frozen=True)
class Bench:
    """A soil with hidden effects and what measures in it."""

    soil: TruthSoil
    effects: tuple[HiddenEffect, ...]
    noise: float = 0.03
    channels: tuple[str, ...] = ("sinkage", "resistance")
    pull: Pull | None = None
    draw: Draw = gaussian

    def respond(self, at: Circumstances, scatter: Array) -> Response:
        response = WheelsOnSoil(self.soil, self.effects, at, scatter).response()
        if not np.all(np.isfinite(response.depth)):
            raise ValueError("a wheel sinks to its axle: this world asks too much of its soil")
        return response

    def table(
        self, at: Circumstances, runs: Array, scatter: Array, rng: np.random.Generator
    ) -> pd.DataFrame:
        """Measure every row: `runs` numbers its run, `scatter` multiplies k; shapes (rows,)."""
        response = self.respond(at, scatter)
        pull = response.drawbar_pull
        if self.pull is not None:
            pull = self.pull(self.soil, at, response)
        true = {
            "sinkage": response.shown_sinkage,
            "resistance": response.shown_resistance,
            "drawbar_pull": pull,
        }
        columns: dict[str, object] = {"run": [f"run_{int(run) + 1:03d}" for run in runs]}
        load = shown_by_instrument(self.effects, "load", at.load, at)
        settings = {"load": load, "diameter": at.diameter, "width": at.width, "slip": at.slip}
        settings |= {"speed": at.speed, "pass_number": at.pass_number}
        for name, values in settings.items():
            header, factor = HEADERS[name]
            columns[header] = values * factor
        for name in self.channels:
            header, factor = HEADERS[name]
            spread = np.hypot(self.noise * true[name], ABSOLUTE_NOISE[name])
            measured = true[name] + spread * self.draw(rng, len(runs))
            if name == "sinkage":
                measured = np.maximum(measured, 5e-5)
            columns[header] = measured * factor
        return pd.DataFrame(columns)


def designed(
    seed: int, part: int, hidden: Sequence[str], runs: int
) -> tuple[RigDesign, tuple[HiddenEffect, ...], tuple[RunSettings, ...]]:
    """Soil, effects and drawn runs as the simulator's rig has them."""
    effects = draw_effects(hidden, stream(seed, 0, 20))
    design = draw_design(effects, (), stream(seed, 0, 21))
    return design, effects, draw_runs(design, effects, runs, stream(seed, part, 22))


def repeated(runs: Sequence[Mapping[str, float]], rows: int) -> tuple[Circumstances, Array]:
    """Circumstances with `rows` rows of each run, and the number of each row's run."""
    names = runs[0]
    settings = {name: np.repeat([run[name] for run in runs], rows) for name in names}
    return Circumstances.of(**settings), np.repeat(np.arange(float(len(runs))), rows)
