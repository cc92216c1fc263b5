# SPDX-License-Identifier: Apache-2.0
"""Which wheels, soil and settings a simulated rig has."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from smallwheel_ros.simulate.hidden import hidden_column
from smallwheel_ros.simulate.hidden_effects import HiddenEffect
from smallwheel_ros.simulate.response import firmness, wheel_response
from smallwheel_ros.simulate.terrain import soil_of_pressure
from smallwheel_ros.simulate.truth import Circumstances, SimulationError, TruthSoil

RunSettings = dict[str, float]

# Low, high, SI and radians. What is drawn between them: evenly, or (speed) evenly in its logarithm.
RANGES: dict[str, tuple[float, float]] = {
    "load": (20.0, 150.0),
    "slip": (0.0, 0.6),
    "speed": (0.01, 0.5),
    "slip_angle": (0.0, np.radians(40.0)),
    "grouser_height": (0.0, 0.015),
}
CONTINUOUS = ("load", "slip", "speed")
PASSES = (1, 2, 3, 4, 5)
_HEADERS = {
    "load": ("load [N]", 1.0),
    "diameter": ("diameter [mm]", 1e3),
    "width": ("width [mm]", 1e3),
    "slip": ("slip", 1.0),
    "slip_angle": ("slip_angle [deg]", 180.0 / np.pi),
    "grouser_height": ("grouser_height [mm]", 1e3),
    "speed": ("speed [mm/s]", 1e3),
}
# A rig's wheels stay visible: truth sinkages outside these limits are not measured.
_LEAST_SINKAGE, _DEEPEST = 1e-3, 0.3
_ATTEMPTS = 2000
_TIED_SPREAD = 0.035  # of the range: correlation 0.99


@dataclass(frozen=True)
class RigDesign:
    """The rig: wheel sizes (m), soil, ranges of the settings, extra columns."""

    soil: TruthSoil
    diameters: tuple[float, ...]
    widths: tuple[float, ...]
    ranges: dict[str, tuple[float, float]]
    covariates: tuple[str, ...]
    tie: tuple[str, ...]

    @property
    def columns(self) -> tuple[tuple[str, str, float], ...]:
        """Settings in the order of the table: name, header, factor from SI."""
        there = {"diameter", "width", *self.ranges}
        return tuple((name, *_HEADERS[name]) for name in _HEADERS if name in there)


def check_tie(tie: Sequence[str], hidden: Sequence[str]) -> None:
    """Raise `SimulationError` unless the two tied settings can be driven together."""
    if not tie:
        return
    extra = [column for name in hidden if (column := hidden_column(name)) is not None]
    possible = [*CONTINUOUS, *extra]
    for name in tie:
        if name not in possible:
            close = difflib.get_close_matches(name, possible, n=1)
            hint = f"did you mean {close[0]!r}? " if close else ""
            raise SimulationError(
                f"tied setting {name!r} cannot be tied; {hint}It can be: {', '.join(possible)}"
            )
    if len(tie) != 2 or tie[0] == tie[1]:
        raise SimulationError(f"tie is {','.join(tie)}: expected two different settings")


def draw_design(
    effects: Sequence[HiddenEffect], tie: Sequence[str], rng: np.random.Generator
) -> RigDesign:
    """Draw wheels and soil: four diameters, four widths, a sand or loam that carries them."""
    diameters = np.array([0.13, 0.2, 0.3, 0.45]) * rng.uniform(0.9, 1.1, 4)
    widths = np.array([0.04, 0.07, 0.11, 0.17]) * rng.uniform(0.9, 1.1, 4)
    ranges = {name: RANGES[name] for name in CONTINUOUS}
    for effect in effects:
        ranges |= {name: RANGES[name] for name in effect.law.needs}
        if effect.name == "skid_sinkage":
            ranges["slip"] = (-0.6, 0.6)
    columns = {}
    for numbers in (effect.numbers for effect in effects if effect.name == "column"):
        middle, half = numbers["centre"], numbers["half_range"]
        columns[numbers["column"]] = (middle - half, middle + half)
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
        ranges=ranges | columns,
        covariates=tuple(columns),
        tie=tuple(tie),
    )
    # Effects on stiffness keep their ratios, but on the whole the soil stays as firm as it was drawn.
    middle = _circumstances(design, [typical_run(design)])
    return replace(design, soil=replace(soil, k=soil.k / firmness(soil, effects, middle)))


def typical_run(design: RigDesign) -> RunSettings:
    """Everything in the middle of its range."""
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
    """Draw runs, each setting independent of the others (but for a tie).

    Settings at which the truth sinks by less than 1 mm or more than 0.3 diameters are drawn
    again, as nobody measures there; that leaves slight correlations of load, diameter and width.

    Raises
    ------
    SimulationError
        If hardly any setting is left: the hidden effects are too strong.
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
        at = _circumstances(design, drawn)
        response = wheel_response(design.soil, effects, at)
        with np.errstate(invalid="ignore"):
            fine = (response.depth < _DEEPEST * at.diameter) & (response.resistance > 0)
            fine &= np.minimum(response.depth, response.shown_sinkage) > _LEAST_SINKAGE
        runs += [run for run, good in zip(drawn, fine, strict=True) if good]
    return tuple(runs[:count])


def _circumstances(design: RigDesign, runs: Sequence[RunSettings]) -> Circumstances:
    arrays = {name: np.array([run[name] for run in runs]) for name in runs[0]}
    extra = {name: arrays.pop(name) for name in design.covariates}
    return Circumstances.of(extra, **arrays)


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
