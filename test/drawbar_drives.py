"""Wheels whose drawbar pull is measured at varied slip, by the truth simulator's own thrust."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from smallwheel_ros.estimator.soil_estimator import SinkageMeasurement
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.simulate.response import wheel_response
from smallwheel_ros.simulate.truth import Circumstances, TruthSoil

Array = NDArray[np.float64]

SAND = soil("dry_sand")
_STEP = 0.05  # m from stop to stop


@dataclass(frozen=True)
class PullPlan:
    """A kind of drive. slips: lowest and highest. scatter: of the thrust from spot to spot."""

    stops: int = 120
    wheels: tuple[tuple[float, float], ...] = ((0.25, 0.10),) * 4
    slips: tuple[float, float] = (-0.1, 0.5)
    varied: float = 0.4
    scatter: float = 0.1
    pull_std: float = 0.6
    slip_std: float = 0.01


def _walk(rng: np.random.Generator, steps: int, std: float) -> Array:
    """A stationary random process that fades over 0.2 m."""
    keep, values = math.exp(-_STEP / 0.2), std * rng.standard_normal(steps)
    for i in range(1, steps):
        values[i] = keep * values[i - 1] + math.sqrt(1.0 - keep**2) * values[i]
    return values


def _waves(rng: np.random.Generator, way: Array, lengths: tuple[float, float]) -> Array:
    one, two = (np.sin(2 * np.pi * way / length + rng.uniform(0, 2 * np.pi)) for length in lengths)
    return 0.5 * (one + two)


def pull_drive(
    seed: int, plan: PullPlan = PullPlan()
) -> tuple[TruthSoil, list[SinkageMeasurement]]:
    """Draw a soil around dry sand, and what is measured on it; one that carries the wheels."""
    rng = np.random.default_rng([seed, 5])
    while True:
        n, pressure = SAND.n + 0.2 * rng.standard_normal(), 0.4 * rng.standard_normal()
        truth = TruthSoil(
            "truth",
            math.exp(
                SAND.log_reference_pressure + pressure + n * math.log(100) + 0.39 * math.log(5)
            ),
            n,
            0.39,
            abs(500.0 * rng.standard_normal()),
            SAND.friction_angle + 0.1 * rng.standard_normal(),
            0.015 * math.exp(0.4 * rng.standard_normal()),
        )
        if n < 0.3 or truth.friction_angle < 0.2:
            continue
        found = drive_on(truth, rng, plan)
        if found is not None:
            return truth, found


def drive_on(
    truth: TruthSoil, rng: np.random.Generator, plan: PullPlan = PullPlan()
) -> list[SinkageMeasurement] | None:
    """Measure on a soil; None where a wheel sinks to its axle."""
    way, rows = _STEP * np.arange(plan.stops), []
    (low, high), noise = plan.slips, rng.standard_normal
    for j, (diameter, width) in enumerate(plan.wheels):
        scatter, grip = (np.exp(_walk(rng, plan.stops, std)) for std in (0.06, plan.scatter))
        load = 55.0 * np.exp(1.4 * plan.varied * _waves(rng, way, (2.3, 7.0)))
        slip = low + (high - low) * 0.5 * (1.0 + _waves(rng, way, (1.7, 5.0)))
        at = Circumstances.of(load=load, diameter=diameter, width=width, slip=slip)
        real = wheel_response(truth, (), at, scatter)
        if not np.isfinite(real.depth).all():
            return None
        std = np.hypot(5e-4, 0.03 * real.depth)
        shown = np.maximum(real.depth + std * noise(plan.stops), 1e-4)
        pull = grip * real.thrust - real.resistance + plan.pull_std * noise(plan.stops)
        weighed = load * (1.0 + 0.012 * noise(plan.stops))
        slip = np.clip(slip + plan.slip_std * noise(plan.stops), -1.0, 1.0)
        rows += [
            SinkageMeasurement(
                0.1 * i + 0.01 * j,
                f"wheel {j}",
                float(shown[i]),
                float(np.hypot(5e-4, 0.03 * shown[i]) ** 2),
                float(weighed[i]),
                float((0.012 * weighed[i]) ** 2),
                diameter,
                width,
                float(way[i]),
                slip=float(slip[i]),
                drawbar_pull=float(pull[i]),
                drawbar_pull_variance=plan.pull_std**2,
                slip_variance=plan.slip_std**2,
            )
            for i in range(plan.stops)
        ]
    return sorted(rows, key=lambda one: (one.time, one.wheel))


def true_pulls(truth: TruthSoil, slips: tuple[float, float]) -> tuple[Array, Array, Array]:
    """Load, slip and drawbar pull of the first wheel over what the drives cover; shapes (65,)."""
    load, slip = (a.ravel() for a in np.meshgrid(np.linspace(35, 75, 5), np.linspace(*slips, 13)))
    at = Circumstances.of(load=load, diameter=0.25, width=0.10, slip=slip)
    return load, slip, wheel_response(truth, (), at).drawbar_pull


def with_pulls(rover: Path, folder: Path) -> Path:
    """The rover's parameters, with drawbar pull from the load cells."""
    content = yaml.safe_load(rover.read_text())
    (node,) = content.values()
    values = node["ros__parameters"]
    for wheel in values["wheels"]:
        values.setdefault(wheel, {})["drawbar_pull_topic"] = f"{wheel}/load"
    path = folder / "with_pulls.yaml"
    path.write_text(yaml.safe_dump(content))
    return path
