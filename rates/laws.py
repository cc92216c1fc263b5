# SPDX-License-Identifier: Apache-2.0
"""Subject: laws. How often the table of laws says that one law is better than another, and how often wrongly.

Worlds are sets of plates whose soil follows one of four laws of size, by its formula: three to eight
sizes, one to three runs of each, exponents, firmness from run to run and strays along a curve of their
own. Each size is left out. The law of the soil is in the place of ours: where another law is said to be
better than it, that is wrong. Where size does nothing the three laws that know size are all right, and any
verdict between two of them is wrong.
"""

from __future__ import annotations

import itertools
import tempfile
from pathlib import Path

import numpy as np

from rates.judges import Judge, Line, Subject, share
from smallwheel_ros.compare.fitted_laws import CONSTANT, SIZE_LAWS, Fold, predictions
from smallwheel_ros.compare.law_table import Errors, difference
from smallwheel_ros.compare.left_out import Task, tasks_of
from smallwheel_ros.fitting.points import points_of
from smallwheel_ros.measurements.from_file import read_measurements

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


def make_world(law: str, seed: int, folder: Path) -> Task:
    """Plates of a soil of a law, with sizes left out."""
    rng = np.random.default_rng([seed, NAMES.index(law), 34])
    n, share = rng.uniform(0.6, 1.3), rng.uniform(0.2, 0.8)
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
    return next(task for task in tasks_of(read_measurements(file)) if task.what == "size")


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


SIZES = {"3 to 5 sizes": (0, 5), "6 to 8 sizes": (6, 99)}
OTHERS = ("another law", "the mean", "two laws that are both right")


def trial(law: str, seed: int) -> Line:
    """Verdicts of one set of plates, by what they are between."""
    with tempfile.TemporaryDirectory() as folder:
        task = make_world(law, seed, Path(folder))
        found = errors_by_part(task)
    said: dict[str, list[str]] = {kind: [] for kind in OTHERS}
    for other in (name for name in found if name != law):
        kind = OTHERS[1] if other == CONSTANT else OTHERS[0]
        said[kind].append(verdict(found[other], found[law]))
    if law == NAMES[0]:
        said[OTHERS[2]] = [
            verdict(found[other], found[one]) for one, other in itertools.combinations(NAMES[1:], 2)
        ]
    return {"sizes": len(task.names), "said": said}


def _verdicts(kind: str, sizes: str, line: Line) -> list[str]:
    low, high = SIZES[sizes]
    return list(line["said"][kind]) if low <= line["sizes"] <= high else []


def _judge(
    text: str, words: tuple[str, ...], kind: str, sizes: str, most: float | None = None
) -> Judge:
    """How often one of these verdicts is given."""

    def hits(line: Line) -> int:
        return sum(one in words for one in _verdicts(kind, sizes, line))

    def total(line: Line) -> int:
        return len(_verdicts(kind, sizes, line))

    return Judge(f"{text} {kind}, {sizes}", share(hits, total), most=most)


_WINS, _LOSES = ("wins",), ("loses",)
JUDGES = [
    judge
    for sizes in SIZES
    for judge in (
        _judge("called worse than", _LOSES, OTHERS[0], sizes, 0.05),
        _judge("called better than", _WINS, OTHERS[0], sizes),
        _judge("called worse than", _LOSES, OTHERS[1], sizes, 0.05),
        _judge("called better than", _WINS, OTHERS[1], sizes),
        _judge("one called better of", _WINS + _LOSES, OTHERS[2], sizes, 0.05),
    )
]
SUBJECTS = [Subject("laws", NAMES, trial, JUDGES, 40, 1.0)]
