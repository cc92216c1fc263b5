# SPDX-License-Identifier: Apache-2.0
"""Raw rows of a small drive with known truth, for the tests of checks, warnings and margin."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.onboard.settings import IMU, ODOMETRY, OnboardSettings

Array = NDArray[np.float64]
Rows = dict[str, tuple[NDArray[np.int64], Array]]
START = 1_700_000_000_300_000_000
GRAVITY = 9.80665
NAMES = ("front_left", "front_right", "rear_left", "rear_right")
RADIUS, HALF, MASS = 0.125, 0.3, 24.0

_REAL = (folder / "shared" / "data" / "real_drives" for folder in Path(__file__).resolve().parents)
REAL = next((folder for folder in _REAL if folder.is_dir()), None)


def real_folder() -> Path:
    """Where the real drives are; without them the test is skipped, and says why."""
    if REAL is None:
        pytest.skip(
            "needs the real drives, which are not in the repository: shared/data/real_drives"
        )
    return REAL


def settings(**given: Any) -> OnboardSettings:
    """Four wheels with load cells, sinkage sensors and an imu."""
    values: dict[str, Any] = {"wheels": list(NAMES), "vehicle.mass": MASS, "imu_topic": "imu"}
    values["soil.name"] = "dry_sand"
    for i, name in enumerate(NAMES):
        values |= {f"{name}.diameter": 2 * RADIUS, f"{name}.width": 0.1}
        values[f"{name}.lateral_position"] = HALF if i % 2 == 0 else -HALF
        values[f"{name}.longitudinal_position"] = 0.3 if i < 2 else -0.3
    return settings_from(values | given).onboard


def drive(
    seconds: float = 90.0,
    seed: int = 0,
    slips: tuple[float, ...] = (0.1,) * 4,
    uneven: float = 0.0,
) -> Rows:
    """Bends and straights at 0.6 m/s and a little, with a stop each 20 s; all sensors good.

    slips: of the wheels; uneven: by how much of themselves rims wander, each by itself. Loads come one by
    one, each with stamps of its own.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.01)
    moves = np.clip(np.minimum((t % 20.0) * 0.5, (17.0 - t % 20.0) * 0.5), 0.0, 1.0)
    speed = moves * (0.6 + 0.1 * np.sin(0.7 * t))
    turn = np.where((t % 40.0 > 10.0) & (t % 40.0 < 15.0), 0.6, 0.0) * (moves > 0.9)
    turn = np.where((t % 40.0 > 28.0) & (t % 40.0 < 31.0), -0.6, turn) * (moves > 0.9)
    heading = np.cumsum(turn) * 0.01
    x, y = np.cumsum(speed * np.cos(heading)) * 0.01, np.cumsum(speed * np.sin(heading)) * 0.01
    way = np.cumsum(speed) * 0.01
    gained = np.gradient(speed, 0.01)

    def at(rate: float, shift: float = 0.0) -> tuple[NDArray[np.int64], Array]:
        times = np.arange(shift, seconds - 0.1, 1.0 / rate)
        return START + np.round(times * 1e9).astype(np.int64), times

    def of(times: Array, values: Array) -> Array:
        return np.interp(times, t, values)

    rows: Rows = {}
    stamps, times = at(30.0, 0.003)
    for i, name in enumerate(NAMES):
        side = 1.0 if i % 2 == 0 else -1.0
        place = of(times, speed) - side * HALF * of(times, turn)
        # Slip wanders along the way, of all wheels alike: else odometry would look made of them.
        wander = 1.0 + 0.03 * np.sin(2.0 * np.pi * of(times, way) / 2.3)
        wander = wander * (1.0 + uneven * np.sin(of(times, way) * (2.1 + 0.7 * i) + i))
        rim = place * wander / (1.0 - slips[i]) / RADIUS
        noise = np.where(np.abs(rim) > 1e-6, 0.02, 0.0) * rng.standard_normal(times.size)
        rows[f"{name}/wheel_speed"] = stamps, (rim + noise)[:, None]
    # A wheel's load goes up and down with the ground, and its sinkage with that.
    waves = [1.0 + 0.25 * np.sin(2.0 * np.pi * way / (0.9 + 0.17 * i) + i) for i in range(4)]
    total = np.sum(waves, axis=0)
    for i, name in enumerate(NAMES):
        share = waves[i] / total
        stamps, times = at(20.0, 0.005 + 0.007 * i)
        load = MASS * GRAVITY * of(times, share) * (1.0 + 0.01 * rng.standard_normal(times.size))
        rows[f"{name}/load"] = stamps, load[:, None]
        stamps, times = at(10.0, 0.011 + 0.003 * i)
        sunk = 0.012 * of(times, 4.0 * share) * (1.0 + 0.02 * rng.standard_normal(times.size))
        rows[f"{name}/sinkage"] = stamps, np.stack([sunk, np.zeros(times.size)], axis=1)
    stamps, times = at(15.0, 0.02)
    noise = 0.01 * rng.standard_normal((2, times.size)) * (of(times, speed) > 0.0)
    columns = [of(times, speed) + noise[0], of(times, turn) + noise[1]]
    columns += [of(times, x), of(times, y), np.cos(of(times, heading)), np.sin(of(times, heading))]
    columns += list(np.zeros((4, times.size)))
    rows[ODOMETRY] = stamps, np.stack(columns, axis=1)
    stamps, times = at(50.0, 0.001)
    noise = rng.standard_normal((4, times.size))
    felt = of(times, gained) + 0.1 * noise[1], 0.1 * noise[2], GRAVITY + 0.1 * noise[3]
    up = np.zeros(times.size), np.zeros(times.size), np.ones(times.size)
    pitch_rate = np.zeros(times.size)
    turns = of(times, turn) + 0.005 * noise[0]
    rows[IMU] = stamps, np.stack([turns, *felt, *up, pitch_rate], axis=1)
    return rows


def cut(rows: Rows, edges: NDArray[np.int64]) -> list[tuple[Rows, int]]:
    """Blocks of rows up to each edge (ns), the last one up to the end."""
    found, before = [], -(1 << 62)
    last = max(int(stamps[-1]) for stamps, _ in rows.values())
    for until in [*edges.tolist(), last]:
        block = {}
        for name, (stamps, values) in rows.items():
            here = (stamps > before) & (stamps <= until)
            block[name] = stamps[here], values[here]
        found.append((block, until))
        before = until
    return found
