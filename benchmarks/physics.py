# SPDX-License-Identifier: Apache-2.0
"""How fast the physics is, against what it cannot beat and against the usual way.

    python benchmarks/physics.py [--json FILE]

1. Closed form: sinkage and compaction resistance (eq. 10, 14) of 10^6 rows, every input an array,
   against the three bare NumPy powers over the same arrays that the equations need. Target: 1.4x.
2. Contact integral: sinkage of 10^5 rows, against scipy's quad inside brentq on a sample of the
   same rows, at equal accuracy (1e-8). Target: 300 times faster per row.
3. A whole prediction (`predict`) of 10^6 rows against the same three powers, for information.

Both sides of a ratio take turns within one run, so that a busy machine slows both; medians.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq

from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.contact import contact_sinkage
from smallwheel_ros.physics.sinkage import closed_form
from smallwheel_ros.physics.soil import soil

ACCURACY = 1e-8


def inputs(rows: int, seed: int = 1) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {
        "load": rng.uniform(10.0, 300.0, rows),
        "diameter": rng.uniform(0.05, 0.6, rows),
        "width": rng.uniform(0.03, 0.3, rows),
        "k": np.exp(rng.uniform(np.log(3e4), np.log(3e6), rows)),
        "n": rng.uniform(0.3, 1.6, rows),
        "m": rng.uniform(-0.6, 0.6, rows),
    }


def in_turn(repeats: int, *functions: Callable[[], Any]) -> list[list[float]]:
    """Seconds of each call, the functions taking turns."""
    for function in functions:
        function()
    times: list[list[float]] = [[] for _ in functions]
    for _ in range(repeats):
        for function, spent in zip(functions, times, strict=True):
            start = time.perf_counter()
            function()
            spent.append(time.perf_counter() - start)
    return times


def bench_closed_form(repeats: int) -> list[dict[str, Any]]:
    x = inputs(1_000_000)
    sinkage, _ = closed_form(**x)
    base = sinkage ** (x["n"] + 0.5)
    first, second, third = x["m"] + 0.5, 2.0 / (2.0 * x["n"] + 1.0), x["n"] + 1.0

    def powers() -> None:
        np.power(x["diameter"], first)
        np.power(base, second)
        np.power(sinkage, third)

    model = Model(soil("dry_sand"), "closed_form")
    conditions = Conditions.of(x["load"], x["diameter"], x["width"])
    limit, ours, whole = in_turn(
        repeats, powers, lambda: closed_form(**x), lambda: predict(model, conditions)
    )
    return [
        _ratio("closed form, 10^6 rows / three bare powers", ours, limit, "at most 1.4"),
        _ratio("predict with closed form, 10^6 rows / three bare powers", whole, limit, "none"),
    ]


def usual_way(load: float, d: float, b: float, modulus: float, n: float) -> float:
    """Sinkage by scipy: quad over the contact's angle inside brentq."""
    radius = 0.5 * d

    def excess(z: float) -> float:
        cos0 = 1.0 - z / radius
        theta0 = np.arccos(cos0)

        def integrand(theta: float) -> float:
            cos = np.cos(theta)
            return float(max(radius * (cos - cos0), 0.0) ** n * cos)

        value = quad(integrand, 0.0, theta0, epsrel=ACCURACY, epsabs=0.0)[0]
        return float(b * radius * modulus * value - load)

    return float(brentq(excess, 1e-9 * radius, radius, rtol=ACCURACY, xtol=1e-12))


def bench_contact(repeats: int, sample: int = 200) -> list[dict[str, Any]]:
    x = inputs(100_000, seed=2)
    modulus = x["k"] * x["diameter"] ** x["m"]
    columns = (x["load"], x["diameter"], x["width"], modulus, x["n"])
    solved = contact_sinkage(*columns)
    rows = np.flatnonzero(~solved.sunk_to_axle)[:sample]
    reference = np.array([usual_way(*(float(c[i]) for c in columns)) for i in rows])
    difference = float(np.max(np.abs(solved.sinkage[rows] / reference - 1.0)))

    def usual() -> None:
        for i in rows[:50]:
            usual_way(*(float(c[i]) for c in columns))

    ours, theirs = in_turn(repeats, lambda: contact_sinkage(*columns), usual)
    per_row = [t / 100_000 for t in ours]
    usual_per_row = [t / 50 for t in theirs]
    result = _ratio(
        "contact integral, per row: scipy quad + brentq / ours",
        usual_per_row, per_row, "at least 300",
    )  # fmt: skip
    result["largest_difference"] = difference
    return [result]


def _ratio(name: str, above: list[float], below: list[float], target: str) -> dict[str, Any]:
    ratios = [a / b for a, b in zip(above, below, strict=True)]
    return {
        "name": name,
        "ratio": statistics.median(ratios),
        "lowest": min(ratios),
        "highest": max(ratios),
        "target": target,
        "seconds": [statistics.median(above), statistics.median(below)],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", metavar="FILE")
    parser.add_argument("--repeats", type=int, default=15)
    options = parser.parse_args()
    results = bench_closed_form(options.repeats) + bench_contact(max(3, options.repeats // 3))
    for r in results:
        print(
            f"{r['name']}: {r['ratio']:.3g} ({r['lowest']:.3g} to {r['highest']:.3g}), "
            f"target {r['target']}; {r['seconds'][0]:.3g} s / {r['seconds'][1]:.3g} s"
        )
        if "largest_difference" in r:
            print(f"  largest relative difference of the two: {r['largest_difference']:.1e}")
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump({"schema": 1, "results": results}, file, indent=1)


if __name__ == "__main__":
    main()
