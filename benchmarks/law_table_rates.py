# SPDX-License-Identifier: Apache-2.0
"""How often the table of laws says that one law is better than another, and how often it is wrong.

    python benchmarks/law_table_rates.py --worlds 150

Worlds are sets of plates whose soil follows one of four laws of size, by its formula: three to eight
sizes, one to three runs of each, exponents, firmness from run to run and strays along a curve of their own.
Each size is left out. The law of the soil is in the place of ours: where another law is said to be
better than it, that is wrong. Where size does nothing the three laws that know size are all right, and any
verdict between two of them is wrong.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from smallwheel_ros.benchmark.laws import CONSTANT, SIZE_LAWS, Fold, predictions
from smallwheel_ros.benchmark.parts import Task, tasks_of
from smallwheel_ros.benchmark.table import Errors, difference
from smallwheel_ros.fitting.points import points_of
from smallwheel_ros.measurements.wheels import read_measurements

NAMES = [law.name for law in SIZE_LAWS]
FIRST = 1 + len(NAMES)  # laws of the table that need no diagnosis: the mean, and those of size


def modulus(law: str, diameter: float, n: float, share: float) -> float:
    """Pressure over z^n, Pa/m^n: formulas of physics.plates, 60 kPa at 10 mm under 100 mm."""
    rho = diameter / 0.1
    factor = {
        "Bernstein-Goriatchkin": 1.0,
        "Bekker": 1.0 - share + share / rho,
        "Reece": (1.0 - share + share * rho) * rho**-n,
        "Meirion-Griffith & Spenko": rho ** (share - 0.5),
    }[law]
    return 60e3 / 0.01**n * factor


def make_world(seed: int, folder: Path) -> tuple[str, Task]:
    """The law of the soil, and its plates with sizes left out."""
    rng = np.random.default_rng([seed, 34])
    law, n, share = NAMES[seed % len(NAMES)], rng.uniform(0.6, 1.3), rng.uniform(0.2, 0.8)
    sizes = np.geomspace(rng.uniform(0.03, 0.06), rng.uniform(0.12, 0.3), rng.integers(3, 9))
    runs, firm, stray = rng.integers(1, 4), rng.uniform(0.02, 0.06), rng.uniform(0.01, 0.05)
    lines = ["run,contact,diameter,load,sinkage"]
    for diameter, run in itertools.product(sizes.tolist(), range(runs)):
        z = np.linspace(0.001, 0.03, 10)
        waves = sum(
            rng.normal() * np.cos(np.pi * i * z / 0.03 + rng.uniform(0, 6)) for i in (1, 2, 3)
        )
        pressure = (
            modulus(law, diameter, n, share) * z**n * np.exp(stray * waves + firm * rng.normal())
        )
        load = pressure * np.pi / 4 * diameter**2
        lines += [
            f"{diameter:.4f} {run},plate,{diameter},{w},{s}" for w, s in zip(load, z, strict=True)
        ]
    file = folder / "plates.csv"
    file.write_text("\n".join(lines))
    return law, next(task for task in tasks_of(read_measurements(file)) if task.what == "size")


def errors_by_part(task: Task) -> dict[str, list[float | None]]:
    """Rms of each law on each size left out, as the table has them."""
    points = points_of(task.measurements)
    row = np.array([rows[0] for rows in points.rows])
    found: dict[str, list[float | None]] = {}
    for out, seen in task.folds():
        fold = Fold(points, np.isin(row, seen), task.measurements.take(seen))
        for said in itertools.islice(predictions(fold, ()), FIRST):
            off = (said.value - points.value)[out[row]]
            found.setdefault(said.law, []).append(float(np.sqrt(np.mean(off**2))))
    return found


def verdict(other: list[float | None], ours: list[float | None]) -> str:
    """What the table would say of ours."""
    errors = Errors("", "sinkage", 1.0, {}, 0, {}, {}, difference(other, ours))
    return str(errors.verdict)


def share_of(count: int, of: int) -> str:
    """`3 of 120: 2.5 % (0.5 to 7.1)`."""
    if not of:
        return "none"
    low, high = binomtest(count, of).proportion_ci(method="exact")
    return f"{count} of {of}: {100 * count / of:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def main() -> int:
    """Count over worlds, print the rates."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--worlds", type=int, default=150)
    options = parser.parse_args()
    words: dict[str, Counter[str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(options.worlds):
            law, task = make_world(seed, Path(folder))
            found = errors_by_part(task)
            parts = "3 to 5 sizes" if len(task.names) <= 5 else "6 to 8 sizes"
            for other in (name for name in found if name != law):
                kind = "the mean" if other == CONSTANT else "another law"
                key = f"the soil's law against {kind}, {parts}"
                words.setdefault(key, Counter())[verdict(found[other], found[law])] += 1
            if law == NAMES[0]:
                for one, other in itertools.combinations(NAMES[1:], 2):
                    key = f"two laws that are both right, {parts}"
                    words.setdefault(key, Counter())[verdict(found[other], found[one])] += 1
            print(f"{seed + 1} of {options.worlds}", end="\r", file=sys.stderr)
    for key, count in sorted(words.items()):
        total = count.total()
        wrong = total - count["cannot tell"] if key.startswith("two") else count["loses"]
        print(f"{key}: wrong {share_of(wrong, total)}", end="")
        print("" if key.startswith("two") else f"; better {share_of(count['wins'], total)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
