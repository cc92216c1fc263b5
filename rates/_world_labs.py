# SPDX-License-Identifier: Apache-2.0
"""Tables of measurements from the truth simulator: its rig's, and those of rigs that are not its own.

A world of `rates_diagnosis` has two parts from one truth: part 0 is the table to diagnose, part 1 holds fresh
runs. Soil, wheels and hidden effects depend on the seed alone, runs and noise on the seed and the part.
Swept runs last: curves of plates and pressed wheels, and time series, whose rows are no repeats; each is
sampled at four densities from the same runs, fewer rows being a selection of more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from smallwheel_ros.simulate import RigSettings, measure, simulate_rig
from smallwheel_ros.simulate.hidden import HiddenEffect, shown_by_instrument
from smallwheel_ros.simulate.rig import (
    ABSOLUTE_NOISE,
    SETTINGS,
    RigDesign,
    RunSettings,
    draw_design,
    draw_runs,
)
from smallwheel_ros.simulate.sensors import lasting
from smallwheel_ros.simulate.settings import CHANNELS, draw_effects
from smallwheel_ros.simulate.truth import Array, Circumstances, TruthSoil, supported_load
from smallwheel_ros.simulate.wheel_laws import Response, WheelsOnSoil

Pull = Callable[[TruthSoil, Circumstances, Response], Array]
Draw = Callable[[np.random.Generator, int], Array]  # noise of standard deviation 1


def stream(seed: int, part: int, *purpose: int) -> np.random.Generator:
    return np.random.default_rng([seed, part, *purpose])


def correlated(rng: np.random.Generator, rows: int, length: float) -> Array:
    """An Ornstein-Uhlenbeck series of unit variance; its correlation falls over `length` rows."""
    return lasting(rng.standard_normal, rows, np.exp(-1.0 / length))


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
            header, factor = SETTINGS.get(name, (name, 1.0))
            columns[header] = values * factor
        for name in self.channels:
            header, factor = CHANNELS[name]
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


# --- Labs

_SCATTER = 0.05  # of ln k from run to run
_LAB_WHEEL = {"diameter": 0.25, "width": 0.10, "speed": 0.05, "pass_number": 1.0}


def run_scatter(rng: np.random.Generator, number: Array, size: float = _SCATTER) -> Array:
    """Factor on k, one value a run."""
    values = np.exp(rng.normal(0.0, size, int(number.max()) + 1))
    return np.asarray(values[number.astype(np.intp)])


def lab(
    seed: int, part: int, hidden: Sequence[str], loads: Sequence[float], slips: Sequence[float]
) -> pd.DataFrame:
    """One wheel, a full grid of loads and slips, three times, each time in soil prepared anew.

    Fresh runs lie between the grid's points.
    """
    soil = draw_design((), (), stream(seed, 0, 21)).soil
    effects = draw_effects(hidden, stream(seed, 0, 20))
    rng = stream(seed, part, 40)
    pairs = [(load, slip) for load in loads for slip in slips] * 3
    if part:
        between_loads = rng.uniform(loads[0], loads[-1], len(pairs))
        between_slips = rng.uniform(slips[0], slips[-1], len(pairs))
        pairs = list(zip(between_loads, between_slips, strict=True))
    runs = [_LAB_WHEEL | {"load": float(w), "slip": float(i)} for w, i in pairs]
    at, number = repeated(runs, 1)
    return Bench(soil, effects).table(at, number, run_scatter(rng, number), rng)


def drawn(
    seed: int,
    part: int,
    hidden: Sequence[str] = (),
    *,
    purpose: int = 41,
    runs: int = 32,
    rows: int = 3,
    scatter: float = _SCATTER,
    drift: float = 0.0,
    **bench: Any,
) -> pd.DataFrame:
    """The simulator's runs with other scatter or another bench. drift: of k, from run to run."""
    design, effects, settings = designed(seed, part, hidden, runs)
    at, number = repeated(settings, rows)
    rng = stream(seed, part, purpose)
    factor = run_scatter(rng, number, scatter) * (1.0 + drift) ** number
    return Bench(design.soil, effects, **bench).table(at, number, factor, rng)


def rim_stress_pull(soil: TruthSoil, at: Circumstances, response: Response) -> Array:
    """Wong and Reece (1967): shear along the whole rim's displacement, other K for each wheel."""
    radius = at.diameter / 2
    entry = np.arccos(1.0 - response.depth / radius)
    angle = entry[:, None] * np.linspace(0.0, 1.0, 201)
    width = entry / 200
    depth = radius[:, None] * (np.cos(angle) - np.cos(entry)[:, None])
    stress = np.maximum(depth, 0.0) ** soil.n
    carried = at.width * radius * width * np.sum(stress * np.cos(angle), axis=1)
    stress = stress * (at.load / carried)[:, None]
    slip = at.slip[:, None]
    travelled = (entry[:, None] - angle) - (1.0 - slip) * (np.sin(entry)[:, None] - np.sin(angle))
    # A pseudo-random factor from 0.5 to 2 for each size of wheel, the same in every table.
    deformation = soil.shear_deformation * 2.0 ** np.sin(977.0 * (at.diameter + 3.0 * at.width))
    mobilised = -np.expm1(-radius[:, None] * travelled / deformation[:, None])
    shear = (soil.cohesion + stress * np.tan(soil.friction_angle)) * mobilised
    thrust = at.width * radius * width * np.sum(shear * np.cos(angle), axis=1)
    return np.asarray(thrust - response.resistance)


def hump_pull(soil: TruthSoil, at: Circumstances, response: Response) -> Array:
    """A two-parameter hump: thrust has its greatest value at slip 0.3 and falls beyond."""
    x = at.slip / 0.3
    return np.asarray(0.6 * at.load * x * np.exp(1.0 - x) - response.resistance)


def lossy_pull(soil: TruthSoil, at: Circumstances, response: Response) -> Array:
    """The drive train takes a tenth of the load."""
    return np.asarray(response.drawbar_pull - 0.1 * at.load)


def creeping_zero(seed: int, part: int) -> pd.DataFrame:
    """The zero of the sinkage sensor creeps by 0.06 mm a run: 1.9 mm in all."""
    table = drawn(seed, part)
    number = table["run"].str.removeprefix("run_").astype(float) - 1.0
    table["sinkage [mm]"] += 0.06 * number
    return table


def uncertain_settings(seed: int, part: int, hidden: Sequence[str] = ()) -> pd.DataFrame:
    """Load is measured with an error of 8 %, slip with one of 0.04, anew in each row."""
    table = drawn(seed, part, hidden)
    rng = stream(seed, part, 43)
    table["load [N]"] *= 1.0 + 0.08 * rng.normal(size=len(table)).clip(-3.0, 3.0)
    table["slip"] = (table["slip"] + 0.04 * rng.normal(size=len(table))).clip(-0.99, 0.99)
    return table


def declared(seed: int, part: int, factor: float, hidden: Sequence[str] = ()) -> pd.DataFrame:
    """40 runs without repeats; standard deviations are declared, `factor` times the true ones."""
    table = drawn(seed, part, hidden, purpose=44, runs=40, rows=1)
    for name in ("sinkage", "resistance"):
        header, scale = CHANNELS[name]
        spread = np.hypot(Bench.noise * table[header], scale * ABSOLUTE_NOISE[name])
        table[header.replace(name, f"{name}_std")] = factor * spread
    return table


def with_torque(seed: int, part: int, hidden: Sequence[str] = ()) -> pd.DataFrame:
    """The wheel's torque is recorded: it follows slip and load, and sets nothing."""
    design, effects, runs = designed(seed, part, hidden, 32)
    at, number = repeated(runs, 3)
    rng = stream(seed, part, 45)
    bench, scatter = Bench(design.soil, effects), run_scatter(rng, number)
    table = bench.table(at, number, scatter, rng)
    torque = bench.respond(at, scatter).thrust * at.diameter / 2
    table["torque [N m]"] = torque * (1.0 + 0.03 * rng.normal(size=torque.size))
    return table


def load_falls_in_skid(seed: int, part: int, hidden: Sequence[str] = ()) -> pd.DataFrame:
    """Braked wheels, slip -0.6 to 0, that lose up to 27 % of their load as they skid."""
    design, effects, runs = designed(seed, part, hidden, 120)
    braked = [run for run in runs if run["slip"] < 0.0] or list(runs)
    falling = [
        {**run, "slip": -abs(run["slip"]), "load": run["load"] * (1.0 - 0.45 * abs(run["slip"]))}
        for run in braked[:32]
    ]
    at, number = repeated(falling, 3)
    rng = stream(seed, part, 46)
    return Bench(design.soil, effects).table(at, number, run_scatter(rng, number), rng)


# --- Swept runs

DENSITIES = (3, 20, 100, 300)
_DENSEST = max(DENSITIES)
_DEVIATION = 0.06  # standard deviation of ln p along a curve
_SIZES = {"plate": (0.05, 0.10, 0.15), "pressed": (0.15, 0.25, 0.35)}  # diameter, m
_WIDTH = 0.08
_SHALLOWEST, _DEEPEST = 1e-3, 30e-3  # of a curve, m


def selected(rows: int) -> NDArray[np.intp]:
    """Which rows of the densest sampling a thinner one keeps: evenly spread, both ends."""
    return np.round(np.linspace(0, _DENSEST - 1, rows)).astype(np.intp)


def random_fourier(rng: np.random.Generator) -> Callable[[Array], Array]:
    """A smooth random function of unit variance, correlated over about 0.7."""
    count = 40
    frequency = rng.normal(0.0, 1.0 / 0.7, count)
    phase = rng.uniform(0.0, 2.0 * np.pi, count)

    def value(x: Array) -> Array:
        waves = np.cos(x[:, None] * frequency + phase)
        return np.asarray(np.sum(waves, axis=1) * np.sqrt(2.0 / count))

    return value


def ornstein_uhlenbeck(rng: np.random.Generator) -> Callable[[Array], Array]:
    """A rough random function of unit variance, correlated over 0.7."""
    start, step, count = np.log(_SHALLOWEST) - 0.1, 0.01, 400
    series = correlated(rng, count, 0.7 / step)
    return lambda x: np.interp(x, start + step * np.arange(count), series)


def curves(seed: int, part: int, contact: str, rows: int) -> pd.DataFrame:
    """Nine curves, three sizes three times, of p = k z^n D^m; even seeds rough, odd ones smooth."""
    soil = draw_design((), (), stream(seed, 0, 21)).soil
    deviation = random_fourier if seed % 2 else ornstein_uhlenbeck
    depth = np.linspace(_SHALLOWEST, _DEEPEST, _DENSEST)
    blocks = []
    for number, diameter in enumerate(np.repeat(_SIZES[contact], 3)):
        rng = stream(seed, part, 30, number)
        modulus = soil.k * diameter**soil.m * np.exp(rng.normal(0.0, 0.03))

        def law(z: Array, modulus: float = modulus) -> Array:
            return np.asarray(modulus * z**soil.n)

        if contact == "plate":
            width, load = diameter, np.pi / 4.0 * diameter**2 * law(depth)
        else:  # soil on both sides of the lowest point
            width, one = _WIDTH, np.ones(_DENSEST)
            load = 2.0 * supported_load(law, diameter * one, width * one, depth)
        load = load * np.exp(_DEVIATION * deviation(rng)(np.log(depth)))
        load = load * (1.0 + rng.normal(0.0, 0.005, _DENSEST))
        shown = depth + rng.normal(0.0, 0.03e-3, _DENSEST)
        keep = selected(rows)
        block = pd.DataFrame(
            {
                "run": f"curve_{number + 1}",
                "contact": contact,
                "diameter [mm]": 1e3 * diameter,
                "width [mm]": 1e3 * width,
                "load [N]": load[keep],
                "sinkage [mm]": 1e3 * shown[keep],
            }
        )
        blocks.append(block)
    return pd.concat(blocks, ignore_index=True)


def time_series(seed: int, part: int, hidden: tuple[str, ...], rows: int) -> pd.DataFrame:
    """Twenty runs, one setting each; the soil varies along the path, over a tenth of a run."""
    design, effects, runs = designed(seed, part, hidden, 20)
    at, number = repeated(runs, _DENSEST)
    rng = stream(seed, part, 31)
    along = [correlated(rng, _DENSEST, _DENSEST / 10) for _ in runs]
    scatter = np.exp(
        0.06 * np.concatenate(along) + np.repeat(rng.normal(0.0, 0.05, len(runs)), _DENSEST)
    )
    table = Bench(design.soil, effects, noise=0.02).table(at, number, scatter, rng)
    keep = (_DENSEST * np.arange(len(runs))[:, None] + selected(rows)).ravel()
    return table.iloc[keep].reset_index(drop=True)
