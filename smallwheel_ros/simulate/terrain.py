# SPDX-License-Identifier: Apache-2.0
"""The ground of a drive: stretches of soil, slopes, slippery patches, and what ends it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smallwheel_ros.simulate.contact import Array
from smallwheel_ros.simulate.truth import Places, SimulationError, TruthSoil

TERRAINS = ("mixed", "single")
FINISHES = ("none", "slope", "slippery")
_GROUND_STEP = 0.02  # m, step of the soil's texture
_REFERENCE_SINKAGE, _REFERENCE_DIAMETER = 0.01, 0.25
_STEEPEST = 0.6  # rad, steeper than any soil here is climbed


@dataclass(frozen=True)
class Stretch:
    """A soil from `start` (m along the way) to the next stretch."""

    start: float
    soil: TruthSoil


def soil_of_pressure(name: str, pressure: float, n: float, m: float, **rest: float) -> TruthSoil:
    """Make a soil from its pressure (Pa) at 10 mm sinkage of a wheel of 0.25 m diameter."""
    k = pressure / (_REFERENCE_SINKAGE**n * _REFERENCE_DIAMETER**m)
    return TruthSoil(name, k, n, m, **rest)


def draw_stretches(terrain: str, distance: float, rng: np.random.Generator) -> tuple[Stretch, ...]:
    """Draw what the rover drives over: `single` is one soil, `mixed` changes about every 10 m."""
    if terrain not in TERRAINS:
        raise SimulationError(f"terrain {terrain!r} is unknown: expected {' or '.join(TERRAINS)}")

    def draw(name: str, pressure: float, n: float, m: float, **rest: float) -> TruthSoil:
        return soil_of_pressure(
            name, pressure * np.exp(rng.normal(0.0, 0.08)), n + rng.normal(0.0, 0.03), m, **rest
        )

    soils = (
        draw("dry_sand", 19e3, 0.85, 0.35, friction_angle=0.54, cohesion=600.0),
        draw("loose_sand", 9.5e3, 0.95, 0.35, friction_angle=0.52, cohesion=300.0),
        draw("compacted_sand", 36e3, 0.75, 0.30, friction_angle=0.60, cohesion=1200.0),
    )
    if terrain == "single":
        return (Stretch(0.0, soils[0]),)
    count = max(3, round(distance / 10.0))
    # Borders are not at round numbers, nor at equal distances.
    starts = (np.arange(count) + rng.uniform(-0.15, 0.15, count)) * distance / count
    starts[0] = 0.0
    return tuple(Stretch(float(start), soils[i % 3]) for i, start in enumerate(starts))


def stretch_index(stretches: Sequence[Stretch], way: Array) -> Places:
    """Which stretch each place (m along the way) is on; the first one reaches back without end."""
    starts = [stretch.start for stretch in stretches]
    return np.maximum(np.searchsorted(starts, way, side="right") - 1, 0)


@dataclass(frozen=True)
class Finish:
    """Ground at the end of a drive that gets worse until the rover is stuck.

    From `start` (m along the way) on it rises by `rise` (rad/m) more and more, or over `edge` (m) the
    grip falls to the factor `grip`.
    """

    start: float
    rise: float = 0.0
    grip: float = 1.0
    edge: float = 1.0


def draw_finish(name: str, distance: float, rng: np.random.Generator) -> Finish | None:
    """Draw the end of a drive, one of `FINISHES`: a slope of 2.5 to 4.5 degrees more in each metre."""
    if name == "none":
        return None
    if name == "slope":
        return Finish(distance, rise=float(np.radians(rng.uniform(2.5, 4.5))))
    return Finish(distance, grip=rng.uniform(0.05, 0.15), edge=rng.uniform(0.8, 1.6))


@dataclass(frozen=True)
class Ground:
    """Everything that depends on the place along the way."""

    way: Array  # m, of the texture
    texture: Array  # (2, places): factor on k in the left and the right track
    unrecorded: Array  # (places,): -1 .. 1, drives the effect `unrecorded`
    climb_waves: Array  # (waves, 3): amplitude, wavelength (m), phase
    roll_waves: Array
    twist_waves: Array
    speed_waves: Array
    turn_wave: Array  # (1, 3): heading (rad)
    patches: Array  # (patches, 2): start and end of slippery places (m)
    finish: Finish | None = None


def draw_ground(distance: float, rng: np.random.Generator) -> Ground:
    """Draw slopes up to about 9 degrees, uneven ground, and a slippery patch every 6 m or so."""
    way: Array = np.arange(-2.0, distance + 3.0, _GROUND_STEP, dtype=np.float64)

    def smooth(length: float, spread: float) -> Array:
        """Noise whose correlation falls exponentially over a length (m)."""
        steps = length / _GROUND_STEP
        kernel = np.exp(-np.arange(round(8 * steps)) / steps)
        kernel *= spread / np.sqrt(np.sum(kernel**2))
        noise = rng.normal(0.0, 1.0, way.size + kernel.size - 1)
        return np.convolve(noise, kernel, mode="valid")

    def waves(amplitude: float, lengths: Sequence[float]) -> Array:
        count = len(lengths)
        size = amplitude * rng.uniform(0.7, 1.3, count) / np.sqrt(count)
        length = np.asarray(lengths) * rng.uniform(0.85, 1.15, count)
        return np.stack([size, length, rng.uniform(0.0, 2.0 * np.pi, count)], axis=1)

    patches = max(1, round(distance / 6.0))
    starts = (np.arange(patches) + rng.uniform(0.3, 0.8, patches)) * distance / patches
    return Ground(
        way=way,
        texture=np.exp([smooth(0.25, 0.05), smooth(0.25, 0.05)]),
        unrecorded=np.tanh(smooth(5.0, 1.0)),
        climb_waves=waves(np.radians(5.5), (17.0, 8.5)),
        roll_waves=waves(np.radians(5.5), (13.0, 6.0)),
        twist_waves=waves(0.24, (2.6, 1.4)),
        speed_waves=waves(0.25, (9.0, 5.0)),
        turn_wave=waves(0.25, (15.0,)),
        patches=np.stack([starts, starts + rng.uniform(0.9, 1.5, patches)], axis=1),
    )


def wave_value(waves: Array, way: Array) -> Array:
    """Sum of waves at places along the way."""
    size, length, phase = waves.T[:, :, None]
    total: Array = np.sum(size * np.sin(2.0 * np.pi * way / length + phase), axis=0)
    return total


def climb(ground: Ground, way: Array) -> Array:
    """Slope in the direction of travel (rad), positive uphill."""
    slope = wave_value(ground.climb_waves, way)
    if ground.finish is not None:
        slope = slope + ground.finish.rise * np.maximum(way - ground.finish.start, 0.0)
    return np.minimum(slope, _STEEPEST)


def grip(ground: Ground, way: Array) -> Array:
    """Factor on the thrust: 1, and 0.5 on slippery patches, with soft edges."""
    edge = 0.08
    inside = np.zeros_like(way)
    for start, end in ground.patches:
        inside = inside + (np.tanh((way - start) / edge) - np.tanh((way - end) / edge)) / 2
    factor: Array = 1.0 - 0.5 * np.clip(inside, 0.0, 1.0)
    if (finish := ground.finish) is not None:
        factor = factor * finish.grip ** np.clip((way - finish.start) / finish.edge, 0.0, 1.0)
    return factor
