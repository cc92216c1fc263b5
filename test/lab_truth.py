# SPDX-License-Identifier: Apache-2.0
"""A lab that knows its soil: plates, a pressed wheel and shear tests, by formulas of their own."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from scipy.integrate import quad

from smallwheel_ros.measurements.measurements import ShearTests

HEADER = ["run", "contact", "diameter", "width", "load", "sinkage"]
N = 0.9
TRUTHS = {  # modulus by diameter, of laws whose sizes differ
    "meirion_griffith_spenko": lambda d: 5e6 * d**0.5,
    "bekker": lambda d: 2e4 / (d / 2) + 8e5,
    "reece": lambda d: (3e3 + 2e5 * d / 2) * (d / 2) ** -N,
}


def wavy(rng: np.random.Generator, share: float, x: np.ndarray) -> np.ndarray:
    """A factor that strays smoothly from 1 along a curve."""
    waves = [np.cos(np.pi * (i + 1) * x / x[-1] + rng.uniform(0, 6)) for i in range(3)]
    return np.exp(share * sum(rng.normal() * wave for wave in waves))


def plate_rows(
    rng: np.random.Generator,
    law: str = "meirion_griffith_spenko",
    sizes: tuple[float, ...] = (0.04, 0.08, 0.16),
    *,
    runs: int = 2,
    rows: int = 40,
    stray: float = 0.03,
) -> list[list[object]]:
    """Rows of `HEADER`: curves of load over sinkage, runs with soils of their own firmness."""
    found: list[list[object]] = []
    for diameter in sizes:
        for run in range(runs):
            # the same curve, whatever the number of rows
            fine = np.linspace(0.001, 0.03, 2000)
            pressure = TRUTHS[law](diameter) * fine**N * wavy(rng, stray, fine)
            pressure *= np.exp(0.04 * rng.normal())
            z = np.linspace(0.001, 0.03, rows)
            load = np.interp(z, fine, pressure) * np.pi / 4 * diameter**2
            name = f"plate {1e3 * diameter:.0f} {run}"
            found += [[name, "plate", diameter, "", w, s] for w, s in zip(load, z, strict=True)]
    return found


def pressed_rows(
    rng: np.random.Generator, factor: float = 1.0, diameter: float = 0.1, width: float = 0.05
) -> list[list[object]]:
    """Rows of a wheel pressed into the soil of Meirion-Griffith & Spenko's law, by quadrature."""
    modulus = factor * TRUTHS["meirion_griffith_spenko"](diameter)
    found: list[list[object]] = []
    for run in range(2):
        firm = np.exp(0.04 * rng.normal())
        for z in np.linspace(0.003, 0.025, 30):
            front = np.arccos(1 - 2 * z / diameter)

            def borne(angle: float, front: float = front) -> float:
                depth = diameter / 2 * (np.cos(angle) - np.cos(front))
                return float(max(depth, 0.0) ** N * np.cos(angle))

            load = 2 * width * diameter / 2 * modulus * firm * quad(borne, 0, front)[0]
            found.append([f"wheel {run}", "pressed", diameter, width, load, z])
    return found


def write(path: Path, rows: list[list[object]], header: list[str] | None = None) -> Path:
    """Write a CSV table."""
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([header or HEADER, *rows])
    return path


def shear(
    rng: np.random.Generator,
    *,
    cohesion: float = 1500.0,
    friction: float = 0.65,
    modulus: float = 0.012,
    residual: float | None = None,
    stresses: tuple[float, ...] = (10e3, 30e3, 60e3),
    runs: int = 2,
    rows: int = 150,
    travel: float = 0.06,
    scatter: float = 0.04,
) -> ShearTests:
    """Shear curves; with a residual ratio they rise to a peak and fall."""
    columns: list[np.ndarray] = []
    names: list[str] = []
    for sigma in stresses:
        for run in range(runs):
            fine = np.linspace(0.0, travel, 3000)
            x = fine / (modulus * np.exp(2 * scatter * rng.normal()))
            share = 1 - np.exp(-x)
            if residual is not None:
                hump = 1 / (residual * (1 - np.exp(-1))) - 1
                share = residual * (1 + hump * np.exp(1 - x)) * share
            strength = (cohesion + sigma * friction) * np.exp(scatter * rng.normal())
            stress = strength * share * wavy(rng, scatter / 3, fine)
            j = np.linspace(0.0, travel, rows)
            columns.append(np.array([np.full(rows, sigma), np.interp(j, fine, stress), j]))
            names += [f"{1e-3 * sigma:.0f} kPa {run}"] * rows
    normal, tangential, j = np.hstack(columns)
    count = len(names)
    return ShearTests(normal, tangential, j, np.array(names), np.full(count, ""), np.arange(count))
