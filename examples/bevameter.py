# SPDX-License-Identifier: Apache-2.0
"""Write what a bevameter would measure of one soil: `python examples/bevameter.py FOLDER`.

plates.csv (three round plates, three runs each), wheel.csv (a wheel pressed into the same soil) and
shear.csv (an annulus at three normal stresses). The soil is p = k z^n D^m with k = 4e6 Pa/m^(n+m),
n = 0.9, m = 0.4, cohesion 1.2 kPa, friction angle 32 deg and K = 12 mm; each run has its own firmness.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np

K, N, M = 4e6, 0.9, 0.4
COHESION, FRICTION, SHEAR_MODULUS = 1200.0, np.tan(np.radians(32.0)), 0.012


def smooth(rng: np.random.Generator, x: np.ndarray, share: float) -> np.ndarray:
    """A factor that strays by that share along a curve, and another level for each run."""
    waves = [
        rng.normal() * np.cos(np.pi * i * x / x[-1] + rng.uniform(0.0, 6.0)) for i in (1, 2, 3)
    ]
    return np.exp(share * (sum(waves) + rng.normal()))


def read_off(rng: np.random.Generator, depth: np.ndarray) -> np.ndarray:
    """Sinkage (mm) as an instrument of 0.02 mm shows it."""
    return depth + 0.02 * rng.normal(size=depth.size)


def write(path: Path, header: str, rows: Iterable[Iterable[object]]) -> None:
    """Write a table."""
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([header.split(","), *rows])


def plates(rng: np.random.Generator) -> list[tuple[object, ...]]:
    """Three round plates."""
    rows: list[tuple[object, ...]] = []
    for diameter in (60, 100, 150):
        for run in "abc":
            z = np.linspace(0.5, 30.0, 40)
            pressure = K * (1e-3 * z) ** N * (1e-3 * diameter) ** M * smooth(rng, z, 0.03)
            for p, s in zip(1e-3 * pressure, read_off(rng, z), strict=True):
                rows.append((f"{diameter}{run}", "plate", diameter, f"{p:.3f}", f"{s:.3f}"))
    return rows


def wheel(rng: np.random.Generator) -> list[tuple[object, ...]]:
    """A wheel pressed straight down, by quadrature over both sides of its lowest point."""
    rows: list[tuple[object, ...]] = []
    diameter, width = 0.2, 0.08
    for run in "abc":
        z = np.linspace(1.0, 25.0, 25)
        factors, shown = smooth(rng, z, 0.03), read_off(rng, z)
        for s, firmness, seen in zip(1e-3 * z, factors, shown, strict=True):
            angle = np.linspace(0.0, np.arccos(1.0 - 2.0 * s / diameter), 2001)
            depth = np.maximum(diameter / 2.0 * (np.cos(angle) - np.cos(angle[-1])), 0.0)
            share = depth**N * np.cos(angle)
            borne = 0.5 * np.sum(np.diff(angle) * (share[1:] + share[:-1]))
            load = 2.0 * width * diameter / 2.0 * K * diameter**M * firmness * borne
            rows.append((f"wheel {run}", "pressed", 200, 80, f"{load:.3f}", f"{seen:.3f}"))
    return rows


def shear(rng: np.random.Generator) -> list[tuple[object, ...]]:
    """An annulus at three normal stresses."""
    rows: list[tuple[object, ...]] = []
    for sigma in (10, 25, 50):
        for run in "ab":
            j = np.linspace(0.0, 60.0, 61)
            share = 1.0 - np.exp(-1e-3 * j / SHEAR_MODULUS)
            stress = (COHESION + 1e3 * sigma * FRICTION) * share * smooth(rng, j, 0.02)
            for x, tau in zip(j, 1e-3 * stress, strict=True):
                rows.append((f"{sigma}{run}", sigma, f"{x:.1f}", f"{tau:.4f}"))
    return rows


def main() -> None:
    """Write the three tables."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(1)
    sizes = "diameter [mm],width [mm]"
    write(
        folder / "plates.csv",
        "run,contact,diameter [mm],pressure [kPa],sinkage [mm]",
        plates(rng),
    )
    write(folder / "wheel.csv", f"run,contact,{sizes},load [N],sinkage [mm]", wheel(rng))
    write(
        folder / "shear.csv",
        "run,normal_stress [kPa],shear_displacement [mm],shear_stress [kPa]",
        shear(rng),
    )
    print(f"{folder}: plates.csv, wheel.csv, shear.csv")


if __name__ == "__main__":
    main()
