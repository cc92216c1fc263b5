# SPDX-License-Identifier: Apache-2.0
"""What sums over drives say of pull, margin and warnings: a table and a picture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, chi2

Array = NDArray[np.float64]

KINDS = ("nothing", "balance", "torque", "balance and torque", "pull sensor")
_DRAWS = 1000  # of the bootstrap
AHEAD = {
    "slope": 1.0,
    "slow slope": 1.0,
    "other shear": 1.0,
    "even slope": 1.0,
    "even patch": 0.3,
    "patch": 0.3,
    "patch, equal": 0.3,
}  # m


@dataclass
class Row:
    """Sums over a drive: of readings of wheels, in fifths of the stated probability, of margins."""

    world: str
    seed: int
    kind: str
    readings: int
    squared: float
    inside: int
    brier: float
    fifths: list[list[float]]  # readings, sum of what was stated, and how often it came
    risks: list[list[float]]  # the same of the risk of getting stuck
    margins: int
    margin_squared: float
    margin_inside: int
    wheel_margins: int
    wheel_margins_inside: int
    ahead: float | None
    left: list[float]
    length: float


def _ratio(rows: list[Row], over: str, under: str) -> tuple[float, float, float]:
    """A mean over drives, and its interval by the bootstrap over seeds."""
    sums: dict[int, Array] = {}
    for row in rows:
        at = sums.setdefault(row.seed, np.zeros(2))
        at += (getattr(row, over), getattr(row, under))
    return _bootstrap(np.array(list(sums.values())))


def _bootstrap(pairs: Array) -> tuple[float, float, float]:
    """Ratio of the sums of two columns, shape (seeds, 2), and its 95 % interval; NaN without any."""
    if not pairs[:, 1].sum() > 0.0:
        return math.nan, math.nan, math.nan
    rng = np.random.default_rng(1)
    drawn = pairs[rng.integers(len(pairs), size=(_DRAWS, len(pairs)))].sum(axis=1)
    drawn = drawn[drawn[:, 1] > 0.0]
    low, high = np.quantile(drawn[:, 0] / drawn[:, 1], (0.025, 0.975))
    return float(pairs[:, 0].sum() / pairs[:, 1].sum()), float(low), float(high)


def rates(rows: list[Row]) -> dict[str, tuple[float, float, float]]:
    """Brier score, coverage of the 95 % bands and rms of pull and margin, each with its interval."""
    square = {"pull rms": ("squared", "readings"), "margin rms": ("margin_squared", "margins")}
    plain = {
        "Brier": ("brier", "readings"),
        "pull in band": ("inside", "readings"),
        "margin in band": ("margin_inside", "margins"),
        "wheel's margin in band": ("wheel_margins_inside", "wheel_margins"),
    }
    found = {name: _ratio(rows, *columns) for name, columns in plain.items()}
    for name, columns in square.items():
        value, low, high = np.sqrt(_ratio(rows, *columns)).tolist()
        found[name] = value, low, high
    return found


def reliability(
    rows: list[Row], of: str = "fifths"
) -> list[tuple[float, float, float, float, int]]:
    """For each fifth: stated, what came with its interval, and how many drives it is from."""
    table = []
    for i in range(5):
        sums: dict[int, Array] = {}
        for row in rows:
            count, stated, came = getattr(row, of)[i]
            at = sums.setdefault(row.seed, np.zeros(3))
            at += (came, count, stated)
        all_of = np.array(list(sums.values()))
        came, low, high = _bootstrap(all_of[:, :2])
        stated = all_of[:, 2].sum() / max(all_of[:, 1].sum(), 1.0)
        table.append((float(stated), came, low, high, sum(getattr(r, of)[i][0] > 0 for r in rows)))
    return table


def _print_warnings(rows: list[Row]) -> None:
    for world in dict.fromkeys(row.world for row in rows):
        stuck = sorted(r.ahead for r in rows if r.world == world and r.ahead is not None)
        need = AHEAD.get(world)
        if stuck and need is not None:
            good = sum(ahead >= need for ahead in stuck)
            low, high = binomtest(good, len(stuck)).proportion_ci(0.95)
            print(
                f"{world}: {good} of {len(stuck)} ({low:.2f} to {high:.2f}) warned of {need} m ahead;"
                f" {' '.join(f'{ahead:.2f}' for ahead in stuck)}"
            )
    left = [each for row in rows for each in row.left]
    print(in_words(left, sum(row.length for row in rows)))


def in_words(left: list[float], length: float) -> str:
    """Warnings that nothing came of, by the true reserve that was left near them; length: driven, m."""
    found = []
    for least in (0.03, 0.05, 0.07, 0.1):
        count, each = sum(one > least for one in left), 500.0 / length
        low = 0.5 * chi2.ppf(0.025, 2 * count) if count else 0.0
        high = 0.5 * chi2.ppf(0.975, 2 * count + 2)
        found.append(
            f"over {least:.2f} left {count}, in 500 m {count * each:.1f}"
            f" ({low * each:.1f} to {high * each:.1f})"
        )
    return f"false in {length:.0f} m: " + "; ".join(found)


def table(rows: list[Row]) -> None:
    """Print what the samples say."""
    for kind in dict.fromkeys(row.kind for row in rows):
        of_kind = [row for row in rows if row.kind == kind]
        seeds = len({row.seed for row in of_kind})
        print(f"\n{kind}: {len(of_kind)} drives, {seeds} seeds")
        for name, (value, low, high) in rates(of_kind).items():
            print(f"  {name} {value:.3f} ({low:.3f} to {high:.3f})")
        for stated, came, low, high, drives in reliability(of_kind):
            print(f"  stated {stated:.2f}: {came:.2f} ({low:.2f} to {high:.2f}), {drives} drives")
        for world in dict.fromkeys(row.world for row in of_kind):
            of_world = rates([row for row in of_kind if row.world == world])
            print(f"    {world}: " + ", ".join(f"{n} {v[0]:.3f}" for n, v in of_world.items()))
    print()
    of_balance = [row for row in rows if row.kind == "balance"]
    if not of_balance:
        return
    for stated, came, low, high, drives in reliability(of_balance, "risks"):
        print(f"risk stated {stated:.2f}: {came:.2f} ({low:.2f} to {high:.2f}), {drives} drives")
    _print_warnings(of_balance)


def draw(rows: list[Row], path: Path) -> None:
    """Draw what came over what was stated."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.0, 4.6), layout="constrained")
    axes.plot([0, 1], [0, 1], color="black", linewidth=0.8)
    for lift in (-0.07, 0.07):
        axes.plot([0, 1], [lift, 1 + lift], color="grey", linewidth=0.8, linestyle=":")
    kinds = [kind for kind in KINDS if any(row.kind == kind for row in rows)]
    for i, kind in enumerate(kinds):
        stated, came, low, high, _ = np.array(
            reliability([row for row in rows if row.kind == kind])
        ).T
        axes.errorbar(
            stated + 0.006 * (i - 2),
            came,
            (came - low, high - came),
            fmt="o-",
            label=kind,
            capsize=3,
        )
    axes.set(xlabel="stated P(drawbar pull > 0)", ylabel="what came", xlim=(0, 1), ylim=(0, 1))
    axes.legend()
    figure.savefig(path, dpi=110)
