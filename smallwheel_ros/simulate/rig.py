# SPDX-License-Identifier: Apache-2.0
"""A single-wheel rig: tables of steady measurements whose truth is known.

Units in the tables' headers are mixed on purpose, as people's tables are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from smallwheel_ros.common.options import Option
from smallwheel_ros.simulate.hidden import (
    FRACTION,
    FormOfHidden,
    Hidden,
    Seed,
    Strength,
    check_form,
    check_hidden,
    check_ranges,
    column_unit,
    draw_effects,
)
from smallwheel_ros.simulate.hidden_effects import HiddenEffect
from smallwheel_ros.simulate.response import shown_by_instrument, wheel_response
from smallwheel_ros.simulate.rig_design import (
    CONTINUOUS,
    RigDesign,
    RunSettings,
    check_tie,
    draw_design,
    draw_runs,
    typical_run,
)
from smallwheel_ros.simulate.truth import (
    Circumstances,
    SimulationError,
    TruthSoil,
    check_range,
)

CHANNELS = ("sinkage", "resistance", "drawbar_pull", "torque")
_UNITS = {"sinkage": (1e3, "mm"), "torque": (1.0, "N m")}  # the others in N
_TYPICAL_NOISE = 0.03
# How far a rig is from what was asked of it, which its own sensors see (1 sigma).
_LOAD_CONTROL, _SLIP_CONTROL, _SPEED_CONTROL = 0.01, 0.004, 0.01
# At typical noise: errors of the sensors of the settings, and absolute noise of the channels.
_LOAD_ERROR, _SLIP_ERROR, _SPEED_ERROR = 0.005, 0.004, 0.005
_ABSOLUTE_NOISE = {"sinkage": 0.15e-3, "resistance": 0.15, "drawbar_pull": 0.3, "torque": 0.03}


@dataclass(frozen=True)
class RigSettings:
    """What table to simulate: the options of `smallwheel simulate rig`.

    The same seed gives the same table, to the byte. A hidden effect can carry its size:
    ``"load_offset=-4"``. A run is one setting of everything, its rows are repeats of it. Noise and
    scatter are standard deviations: of the channels, relative (their small absolute noise and the
    errors of measured load, slip and speed grow with it), and of ln k from run to run. A tie drives
    two settings together, r about 0.99.
    """

    seed: Seed = 0
    hidden: Hidden = ()
    strength: Strength = 1.0
    form: FormOfHidden = "own"
    runs: Annotated[int, Option(within=(1, 100_000))] = 32
    rows_per_run: Annotated[int, Option("Repeats of each run's setting.", (1, 1000))] = 3
    noise: Annotated[float, Option("Relative noise of the channels.", (0.0, 0.5))] = _TYPICAL_NOISE
    soil_scatter: Annotated[
        float, Option("Relative scatter of the soil's k from run to run.", (0.0, 1.0))
    ] = 0.05
    channels: Annotated[
        tuple[str, ...],
        Option(f"What is measured: {', '.join(CHANNELS)}.", words={"metavar": "NAME[,NAME]"}),
    ] = ("sinkage", "resistance")
    tie: Annotated[
        tuple[str, ...],
        Option(
            f"Two settings driven together: {', '.join(CONTINUOUS)}, an extra column.",
            words={"metavar": "NAME,NAME", "show_default": False},
        ),
    ] = ()
    outliers: Annotated[
        float,
        Option("Share of rows in which one channel is grossly wrong.", (0.0, 0.5), FRACTION),
    ] = 0.0

    def check(self) -> RigSettings:
        """Return the settings without `none` among the hidden effects.

        Raises
        ------
        SimulationError
            Naming the setting, what it was, and what was expected.
        """
        check_ranges(self)
        check_form(self.form)
        wrong = [name for name in self.channels if name not in CHANNELS]
        if wrong or not self.channels or len(set(self.channels)) < len(self.channels):
            raise SimulationError(
                f"channels are {','.join(self.channels) or 'empty'}: expected one or more of"
                f" {', '.join(CHANNELS)}, each once"
            )
        hidden = check_hidden(self.hidden)
        check_tie(self.tie, hidden)
        return replace(self, hidden=hidden)


@dataclass(frozen=True)
class RigTruth:
    """Soil, effects and settings behind a table; `measure` takes more measurements of it."""

    settings: RigSettings
    soil: TruthSoil
    effects: tuple[HiddenEffect, ...]
    design: RigDesign
    runs: tuple[RunSettings, ...]

    def answer(self) -> dict[str, Any]:
        """Return what the table must not say, in SI units and radians."""
        return {
            "kind": "rig",
            "settings": asdict(self.settings),
            "hidden": [effect.describe() for effect in self.effects],
            "soil": asdict(self.soil),
            "runs": [{"run": _run_name(i)} | dict(run) for i, run in enumerate(self.runs)],
        }


@dataclass(frozen=True)
class Rig:
    """A simulated table (headers with units, ready to be written) and the truth behind it."""

    table: pd.DataFrame
    truth: RigTruth


def simulate_rig(settings: RigSettings) -> Rig:
    """Simulate a table of measurements; the same settings give the same numbers.

    Raises
    ------
    SimulationError
        If a setting is outside its range.
    """
    settings = settings.check()
    rng = np.random.default_rng([settings.seed, 20])
    effects = draw_effects(settings.hidden, rng, settings.strength, settings.form)
    design = draw_design(effects, settings.tie, np.random.default_rng([settings.seed, 21]))
    runs = draw_runs(design, effects, settings.runs, np.random.default_rng([settings.seed, 22]))
    truth = RigTruth(settings, design.soil, effects, design, runs)
    return Rig(measure(truth, runs, first_run=0), truth)


def measure(
    truth: RigTruth,
    runs: Sequence[Mapping[str, float]],
    *,
    first_run: int | None = None,
    rows_per_run: int | None = None,
) -> pd.DataFrame:
    """Measure runs on the rig of a truth: same soil, own scatter and noise.

    Parameters
    ----------
    runs
        For each run its settings by column name, SI units and radians. What is not given is as in
        the middle of the rig's range.
    first_run
        Number of the first of them, which also picks its random stream; None goes on after the
        truth's own runs.
    rows_per_run
        None means as in the truth's settings.

    Returns
    -------
    pandas.DataFrame
        Same columns as the table of `simulate_rig`, to be appended to it.

    Raises
    ------
    SimulationError
        If a setting is unknown or out of range, or the wheel would sink to its axle.
    """
    first = len(truth.runs) if first_run is None else first_run
    repeats = truth.settings.rows_per_run if rows_per_run is None else rows_per_run
    blocks = [
        _measure_run(truth, first + i, _complete(truth, run), repeats)
        for i, run in enumerate(tqdm(runs, "measuring", unit=" runs", disable=None, delay=1))
    ]
    if not blocks:
        raise SimulationError("no runs to measure: give at least one")
    return pd.concat(blocks, ignore_index=True)


def _complete(truth: RigTruth, run: Mapping[str, float]) -> RunSettings:
    """Fill in what is not given, and check what is."""
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
    return {**typical, **run}


def _run_name(number: int) -> str:
    return f"run_{number + 1:03d}"


def _significant(values: Any, digits: int = 6) -> Any:
    """Round as an instrument's display does, so that CSV and Parquet hold the same numbers."""
    return np.array([float(f"{value:.{digits}g}") for value in values])


def _measure_run(truth: RigTruth, number: int, run: RunSettings, rows: int) -> pd.DataFrame:
    settings = truth.settings
    size = settings.noise / _TYPICAL_NOISE
    rng = np.random.default_rng([settings.seed, 23, number])
    scatter = float(np.exp(rng.normal(0.0, settings.soil_scatter)))
    unrecorded = rng.uniform(-1.0, 1.0)
    control, error = rng.normal(0.0, 1.0, (2, 3, rows))
    columns = {name: run[name] for name in truth.design.covariates}
    real = {name: np.full(rows, value) for name, value in run.items() if name not in columns}
    real["load"] = run["load"] * (1.0 + _LOAD_CONTROL * control[0])
    real["slip"] = np.clip(run["slip"] + _SLIP_CONTROL * control[1], -0.99, 0.99)
    real["speed"] = run["speed"] * (1.0 + _SPEED_CONTROL * control[2])
    if run["slip"] == 0.0:  # a towed wheel
        real["slip"] = np.zeros(rows)
    at = Circumstances.of(columns, **real, hidden=unrecorded)
    response = wheel_response(truth.soil, truth.effects, at, scatter)
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
        spread = np.hypot(settings.noise * true[name], size * _ABSOLUTE_NOISE[name])
        source = of_torque if name == "torque" else rng
        measured[name] = true[name] + spread * source.normal(0.0, 1.0, rows)
    _spoil(measured, settings, rng, run["diameter"])
    load = shown_by_instrument(truth.effects, "load", real["load"], at)
    real["load"] = load * (1.0 + size * _LOAD_ERROR * error[0])
    real["slip"] = np.clip(real["slip"] + size * _SLIP_ERROR * error[1], -1.0, 1.0)
    real["speed"] = real["speed"] * (1.0 + size * _SPEED_ERROR * error[2])
    table: dict[str, Any] = {"run": [_run_name(number)] * rows, "soil": [truth.soil.name] * rows}
    table["wheel"] = [f"d{1e3 * run['diameter']:.0f}_b{1e3 * run['width']:.0f}"] * rows
    for name, header, factor in truth.design.columns:
        table[header] = _significant(real[name] * factor)
    table["pass_number"] = real["pass_number"].astype(int)
    for name in truth.design.covariates:
        unit = column_unit(name)
        table[f"{name} [{unit}]" if unit else name] = _significant(at.covariates[name])
    for name in settings.channels:
        factor, unit = _UNITS.get(name, (1.0, "N"))
        table[f"{name} [{unit}]"] = _significant(measured[name] * factor)
    frame: pd.DataFrame = pd.DataFrame(table)
    return frame


def _spoil(
    measured: dict[str, Any], settings: RigSettings, rng: np.random.Generator, diameter: float
) -> None:
    """Put in gross errors, and keep readings to what an instrument can show."""
    rows = measured["sinkage"].size
    wild = rng.uniform(size=rows) < settings.outliers
    victim = rng.integers(0, len(settings.channels), rows)
    factor = rng.uniform(2.0, 4.0, rows)
    for i, name in enumerate(settings.channels):
        hit = wild & (victim == i)
        measured[name] = np.where(hit, measured[name] * factor, measured[name])
    measured["sinkage"] = np.clip(measured["sinkage"], 5e-5, 0.49 * diameter)
