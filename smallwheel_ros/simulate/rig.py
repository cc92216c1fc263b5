# SPDX-License-Identifier: Apache-2.0
"""A single-wheel rig: tables of steady measurements whose true values are known.

The units in the tables' headers are mixed on purpose, as in tables that people make.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from smallwheel_ros.common.files import write_whole
from smallwheel_ros.simulate.hidden import HiddenEffect, shown_by_instrument
from smallwheel_ros.simulate.settings import (
    CHANNELS,
    CONTINUOUS,
    TYPICAL_NOISE,
    RigSettings,
    SimulationError,
    check_range,
    draw_effects,
    extra_column,
)
from smallwheel_ros.simulate.truth import Circumstances, TruthSoil, soil_of_pressure
from smallwheel_ros.simulate.wheel_laws import WheelsOnSoil

SUFFIXES = (".csv", ".parquet")
# Standard deviations of load (relative), slip and speed (relative) from their set values, which sensors see.
_LOAD_CONTROL, _SLIP_CONTROL, _SPEED_CONTROL = 0.01, 0.004, 0.01
# Standard deviations at typical noise: errors of these settings' sensors; absolute noise of channels, SI.
_LOAD_ERROR, _SLIP_ERROR, _SPEED_ERROR = 0.005, 0.004, 0.005
ABSOLUTE_NOISE = {"sinkage": 0.15e-3, "resistance": 0.15, "drawbar_pull": 0.3, "torque": 0.03}
# Lowest and highest value, SI and radians. Values are drawn evenly between them; speeds evenly in ln.
RANGES: dict[str, tuple[float, float]] = {
    "load": (20.0, 150.0),
    "slip": (0.0, 0.6),
    "speed": (0.01, 0.5),
    "slip_angle": (0.0, np.radians(40.0)),
    "grouser_height": (0.0, 0.015),
}
PASSES = (1, 2, 3, 4, 5)
# By name, in the order of the table: header and factor from SI.
SETTINGS = {
    "load": ("load [N]", 1.0),
    "diameter": ("diameter [mm]", 1e3),
    "width": ("width [mm]", 1e3),
    "slip": ("slip", 1.0),
    "slip_angle": ("slip_angle [deg]", 180.0 / np.pi),
    "grouser_height": ("grouser_height [mm]", 1e3),
    "speed": ("speed [mm/s]", 1e3),
}
# m, and diameters: runs whose true sinkage is outside these limits are not measured.
_LEAST_SINKAGE, _DEEPEST = 1e-3, 0.3
_ATTEMPTS = 2000
_TIED_SPREAD = 0.035  # standard deviation over the range: correlation 0.99

RunSettings = dict[str, float]  # of one run, by name, SI units and radians


# --- Which wheels, soil and settings a rig has


@dataclass(frozen=True)
class RigDesign:
    """A rig: its soil, its wheels, and the ranges of its settings.

    Attributes
    ----------
    soil
        The soil.
    diameters, widths
        Diameters and widths that wheels may have, m; they are combined freely.
    ranges
        Lowest and highest value of each setting by name, SI units and radians.
    tie
        The two settings that are varied together, the leading one first; empty for none.
    """

    soil: TruthSoil
    diameters: tuple[float, ...]
    widths: tuple[float, ...]
    ranges: dict[str, tuple[float, float]]
    tie: tuple[str, ...]


def draw_design(
    effects: Sequence[HiddenEffect], tie: Sequence[str], rng: np.random.Generator
) -> RigDesign:
    """Draw wheels and soil of a rig: four diameters, four widths, a sand or loam that carries them.

    Parameters
    ----------
    effects
        Hidden effects. Columns that they need are varied, too; the soil's k is scaled so that effects on its
        stiffness leave it as firm as drawn in the middle of the ranges.
    tie
        The two settings that are varied together, the leading one first; empty for none.
    rng
        Random number generator for the draws.

    Returns
    -------
    RigDesign
        The rig; `typical_run` and `draw_runs` make settings for it.
    """
    diameters = np.array([0.13, 0.2, 0.3, 0.45]) * rng.uniform(0.9, 1.1, 4)
    widths = np.array([0.04, 0.07, 0.11, 0.17]) * rng.uniform(0.9, 1.1, 4)
    ranges = {name: RANGES[name] for name in CONTINUOUS}
    for effect in effects:
        ranges |= {name: RANGES[name] for name in effect.law.needs}
        if effect.name == "skid_sinkage":
            ranges["slip"] = (-0.6, 0.6)
    for numbers in (effect.numbers for effect in effects if effect.name == "column"):
        middle, half = numbers["centre"], numbers["half_range"]
        ranges[numbers["column"]] = (middle - half, middle + half)
    soil = soil_of_pressure(
        "rig_soil",
        np.exp(rng.uniform(np.log(12e3), np.log(32e3))),
        rng.uniform(0.5, 1.1),
        rng.uniform(-0.3, 0.5),
        cohesion=rng.uniform(200.0, 1200.0),
        friction_angle=np.radians(rng.uniform(28.0, 38.0)),
        shear_deformation=rng.uniform(0.010, 0.022),
        unit_weight=rng.uniform(14e3, 17e3),
    )
    design = RigDesign(
        soil=soil,
        diameters=tuple(round(float(d) / 0.005) * 5 / 1000 for d in diameters),
        widths=tuple(round(float(b) / 0.005) * 5 / 1000 for b in widths),
        ranges=ranges,
        tie=tuple(tie),
    )
    # Effects on stiffness change it from run to run, but in a typical run the soil is as firm as drawn.
    firmness = WheelsOnSoil(soil, effects, Circumstances.of(**typical_run(design))).firmness()
    return replace(design, soil=replace(soil, k=soil.k / firmness))


def typical_run(design: RigDesign) -> RunSettings:
    """A run with each setting at the middle of its range (of speed the geometric one), and a middle wheel."""
    middle = {name: (low + high) / 2 for name, (low, high) in design.ranges.items()}
    low, high = design.ranges["speed"]
    return middle | {
        "diameter": design.diameters[2],
        "width": design.widths[2],
        "speed": float(np.sqrt(low * high)),
        "pass_number": float(PASSES[len(PASSES) // 2]),
    }


def draw_runs(
    design: RigDesign, effects: Sequence[HiddenEffect], count: int, rng: np.random.Generator
) -> tuple[RunSettings, ...]:
    """Draw the settings of runs, each setting independent of the others (except for a tie).

    Runs whose true sinkage is less than 1 mm or more than 0.3 diameters, or whose resistance is not above 0,
    are drawn again, as nothing is measured there; load, diameter and width are slightly correlated by that.

    Parameters
    ----------
    design
        The rig.
    effects
        Hidden effects.
    count
        Number of runs.
    rng
        Random number generator for the draws.

    Returns
    -------
    tuple of dict
        Settings of each of `count` runs by name, SI units and radians.

    Raises
    ------
    SimulationError
        If too few of the runs drawn can be measured, as with hidden effects that are too strong.
    """
    runs: list[RunSettings] = []
    tried = 0
    while len(runs) < count:
        if tried > 50 * count + _ATTEMPTS:
            raise SimulationError(
                f"only {len(runs)} of {count} runs have a sinkage between"
                f" {1e3 * _LEAST_SINKAGE:g} mm and {_DEEPEST:g} diameters: take a smaller strength"
            )
        drawn = [_draw_run(design, rng) for _ in range(count)]
        tried += count
        at = Circumstances.of(**{name: [run[name] for run in drawn] for name in drawn[0]})
        response = WheelsOnSoil(design.soil, effects, at).response()
        with np.errstate(invalid="ignore"):
            fine = (response.depth < _DEEPEST * at.diameter) & (response.resistance > 0)
            fine &= np.minimum(response.depth, response.shown_sinkage) > _LEAST_SINKAGE
        runs += [run for run, good in zip(drawn, fine, strict=True) if good]
    return tuple(runs[:count])


def _draw_run(design: RigDesign, rng: np.random.Generator) -> RunSettings:
    share = dict(zip(design.ranges, rng.uniform(size=len(design.ranges)), strict=True))
    if design.tie:
        leader, follower = design.tie
        share[follower] = float(np.clip(share[leader] + rng.normal(0.0, _TIED_SPREAD), 0.0, 1.0))
    run: RunSettings = {}
    for name, (low, high) in design.ranges.items():
        if name == "speed" and name not in design.tie:
            run[name] = float(low * (high / low) ** share[name])
        else:
            run[name] = float(low + (high - low) * share[name])
    if "grouser_height" in run:  # wheels come with a few kinds of grousers
        run["grouser_height"] = 0.005 * round(run["grouser_height"] / 0.005)
    run["diameter"] = float(rng.choice(design.diameters))
    run["width"] = float(rng.choice(design.widths))
    run["pass_number"] = float(rng.choice(PASSES))
    return run


# --- Measurements


@dataclass(frozen=True)
class RigTruth:
    """The true soil, effects and settings of a table; `measure` makes more measurements on the same rig.

    Attributes
    ----------
    settings
        Settings of the simulation, checked.
    soil
        The soil.
    effects
        Hidden effects with their numbers.
    design
        Wheels and ranges of the rig.
    runs
        Set values of each run by name, SI units and radians.
    """

    settings: RigSettings
    soil: TruthSoil
    effects: tuple[HiddenEffect, ...]
    design: RigDesign
    runs: tuple[RunSettings, ...]

    def answer(self) -> dict[str, Any]:
        """The file of the truth, a dict of kind, settings, hidden, soil and runs; SI units and radians."""
        return {
            "kind": "rig",
            "settings": asdict(self.settings),
            "hidden": [effect.describe() for effect in self.effects],
            "soil": asdict(self.soil),
            "runs": [{"run": _run_name(i)} | dict(run) for i, run in enumerate(self.runs)],
        }


@dataclass(frozen=True)
class Rig:
    """A simulated table, and its true soil, effects and settings.

    Attributes
    ----------
    table
        One row for each measurement, ready to be written; headers state the units, which are mixed.
    truth
        The rig and its true values, from which `measure` makes more measurements.
    """

    table: pd.DataFrame
    truth: RigTruth


def simulate_rig(settings: RigSettings) -> Rig:
    """Simulate a table of measurements; the same settings give the same numbers.

    Raises
    ------
    SimulationError
        If a setting is wrong, or hidden effects are so strong that wheels sink too deep to be measured.
    """
    settings = settings.check()
    rng = np.random.default_rng([settings.seed, 20])
    effects = draw_effects(settings.hidden, rng, settings.strength)
    design = draw_design(effects, settings.tie, np.random.default_rng([settings.seed, 21]))
    runs = draw_runs(design, effects, settings.runs, np.random.default_rng([settings.seed, 22]))
    truth = RigTruth(settings, design.soil, effects, design, runs)
    return Rig(measure(truth, runs, first_run=0), truth)


def measure(
    truth: RigTruth,
    runs: Sequence[Mapping[str, float]],
    *,
    first_run: int | None = None,
) -> pd.DataFrame:
    """Measure further runs on a rig: with the same soil and effects, but scatter and noise of their own.

    Parameters
    ----------
    truth
        The rig: its soil, hidden effects and noise.
    runs
        Settings of each run by name, SI units and radians. One that is missing is at the middle of the
        rig's range (`typical_run`).
    first_run
        Number of the first run, from 0, which is in its name and selects its random numbers; None continues
        after the truth's own runs.

    Returns
    -------
    pandas.DataFrame
        `rows_per_run` rows for each run, with the columns of the table of `simulate_rig`.

    Raises
    ------
    SimulationError
        If there are no runs, a setting is unknown or out of range, or the wheel would sink to its axle.
    """
    first = len(truth.runs) if first_run is None else first_run
    blocks = [
        _measure_run(truth, first + i, _complete(truth, run))
        for i, run in enumerate(tqdm(runs, "measuring", unit=" runs", disable=None, delay=1))
    ]
    if not blocks:
        raise SimulationError("no runs to measure: give at least one")
    return pd.concat(blocks, ignore_index=True)


def _complete(truth: RigTruth, run: Mapping[str, float]) -> RunSettings:
    """Add typical values of settings not given. Raises SimulationError for unknown or impossible ones."""
    typical = typical_run(truth.design)
    for name, value in run.items():
        if name not in typical:
            raise SimulationError(
                f"setting {name!r} is none of this rig's: {', '.join(sorted(typical))}"
            )
        if name in ("load", "diameter", "width", "speed"):
            check_range(name, value, 1e-4, 1e5)
        if name == "slip":
            check_range(name, value, -0.99, 0.99)
        if name == "pass_number":
            check_range(name, value, 1, 1e5)
            if value != int(value):
                raise SimulationError(
                    f"pass_number is {value:g}, expected a whole number, 1 or more"
                )
    return {**typical, **run}


def _run_name(number: int) -> str:
    return f"run_{number + 1:03d}"


def _significant(values: Any, digits: int = 6) -> Any:
    """Round as an instrument's display does, so that CSV and Parquet hold the same numbers."""
    return np.array([float(f"{value:.{digits}g}") for value in values])


def _measure_run(truth: RigTruth, number: int, run: RunSettings) -> pd.DataFrame:
    settings, rows = truth.settings, truth.settings.rows_per_run
    size = settings.noise / TYPICAL_NOISE
    rng = np.random.default_rng([settings.seed, 23, number])
    scatter = float(np.exp(rng.normal(0.0, settings.soil_scatter)))
    unrecorded = rng.uniform(-1.0, 1.0)
    control, error = rng.normal(0.0, 1.0, (2, 3, rows))
    real = {name: np.full(rows, value) for name, value in run.items()}
    real["load"] = run["load"] * (1.0 + _LOAD_CONTROL * control[0])
    real["slip"] = np.clip(run["slip"] + _SLIP_CONTROL * control[1], -0.99, 0.99)
    real["speed"] = run["speed"] * (1.0 + _SPEED_CONTROL * control[2])
    if run["slip"] == 0.0:  # a towed wheel
        real["slip"] = np.zeros(rows)
    at = Circumstances.of(**real, hidden=unrecorded)
    response = WheelsOnSoil(truth.soil, truth.effects, at, scatter).response()
    if not np.all(np.isfinite(response.depth)):
        raise SimulationError(
            f"{_run_name(number)}: the wheel (diameter {run['diameter']:g} m) sinks to its axle"
            f" under {run['load']:g} N at slip {run['slip']:g}: take less load, less slip or a"
            " larger wheel"
        )
    true = {
        "sinkage": response.shown_sinkage,
        "resistance": response.shown_resistance,
        "drawbar_pull": response.drawbar_pull,
        "torque": response.torque,
    }
    # Its own stream: tables without torque stay what they were.
    of_torque = np.random.default_rng([settings.seed, 24, number])
    measured = {}
    for name in CHANNELS:  # all of them: what is measured does not change the noise of the rest
        spread = np.hypot(settings.noise * true[name], size * ABSOLUTE_NOISE[name])
        source = of_torque if name == "torque" else rng
        measured[name] = true[name] + spread * source.normal(0.0, 1.0, rows)
    _spoil(measured, settings, rng, run["diameter"])
    load = shown_by_instrument(truth.effects, "load", real["load"], at)
    real["load"] = load * (1.0 + size * _LOAD_ERROR * error[0])
    real["slip"] = np.clip(real["slip"] + size * _SLIP_ERROR * error[1], -1.0, 1.0)
    real["speed"] = real["speed"] * (1.0 + size * _SPEED_ERROR * error[2])
    table: dict[str, Any] = {"run": [_run_name(number)] * rows, "soil": [truth.soil.name] * rows}
    table["wheel"] = [f"d{1e3 * run['diameter']:.0f}_b{1e3 * run['width']:.0f}"] * rows
    for name, (header, factor) in SETTINGS.items():
        if name in real:
            table[header] = _significant(real[name] * factor)
    table["pass_number"] = real["pass_number"].astype(int)
    for name, values in at.covariates.items():
        unit, *_ = extra_column(name)
        table[f"{name} [{unit}]" if unit else name] = _significant(values)
    for name in settings.channels:
        header, factor = CHANNELS[name]
        table[header] = _significant(measured[name] * factor)
    frame: pd.DataFrame = pd.DataFrame(table)
    return frame


def _spoil(
    measured: dict[str, Any], settings: RigSettings, rng: np.random.Generator, diameter: float
) -> None:
    """Multiply some values by 2 to 4, in place, and clip sinkages (m) to what an instrument can show.

    diameter: of the wheel, m, to whose axle it can show them.
    """
    rows = measured["sinkage"].size
    wild = rng.uniform(size=rows) < settings.outliers
    victim = rng.integers(0, len(settings.channels), rows)
    factor = rng.uniform(2.0, 4.0, rows)
    for i, name in enumerate(settings.channels):
        hit = wild & (victim == i)
        measured[name] = np.where(hit, measured[name] * factor, measured[name])
    measured["sinkage"] = np.clip(measured["sinkage"], 5e-5, 0.49 * diameter)


# --- The table's file


def write_table(table: pd.DataFrame, path: Path | str) -> None:
    """Write a table as CSV or Parquet, by the file's suffix, whole or not at all.

    Parameters
    ----------
    table
        The table, with units in its headers as `simulate_rig` makes them; it is written unchanged.
    path
        File to write, ending in .csv or .parquet; an existing one is replaced.

    Raises
    ------
    SimulationError, OutputError
        If the suffix is another one, pyarrow is missing for Parquet, or the file cannot be written.
    """
    path = check_suffix(Path(path))

    def write(part: Path) -> None:
        if path.suffix == ".csv":
            table.to_csv(part, index=False, lineterminator="\n")
            return
        try:
            table.to_parquet(part, index=False, engine="pyarrow")
        except ImportError as error:
            raise SimulationError(
                f"cannot write {path}: Parquet needs pyarrow; install smallwheel_ros[parquet], or"
                " write .csv"
            ) from error

    write_whole(path, write)


def check_suffix(path: Path) -> Path:
    """Return the path; raise SimulationError unless its suffix is .csv or .parquet."""
    if path.suffix not in SUFFIXES:
        raise SimulationError(
            f"cannot write {path}: the suffix {path.suffix!r} is not {' or '.join(SUFFIXES)}"
        )
    return path
