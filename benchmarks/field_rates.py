# SPDX-License-Identifier: Apache-2.0
"""How often is the robot right in the field, and does it say what is wrong? Rates over worlds.

python benchmarks/field_rates.py --seeds 0:12 --jobs 2 --scores out/field.jsonl
python benchmarks/field_rates.py --seeds 0:0 --scores out/field.jsonl
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.field_drives import make_drive
from benchmarks.field_scores import QUANTITIES, SOON, FieldScore, run
from benchmarks.field_worlds import WORLDS
from benchmarks.robot_rates import run_worlds


def drive_and_score(task: tuple[str, int]) -> FieldScore:
    """Make and run one drive."""
    name, seed = task
    return run(make_drive(WORLDS[name], seed), seed)[1]


def held(scores: Sequence[FieldScore], name: str) -> tuple[float, float, float]:
    """Share inside the band, with its 95 % interval by the bootstrap over drives."""
    pairs = np.array([(s.inside.get(name, 0), s.counts.get(name, 0)) for s in scores], dtype=float)
    if not pairs[:, 1].sum():
        return math.nan, math.nan, math.nan
    rng = np.random.default_rng(1)
    drawn = pairs[rng.integers(len(pairs), size=(1000, len(pairs)))].sum(axis=1)
    drawn = drawn[drawn[:, 1] > 0]
    low, high = np.quantile(drawn[:, 0] / drawn[:, 1], (0.025, 0.975))
    whole = pairs.sum(axis=0)
    return float(whole[0] / whole[1]), float(low), float(high)


def width(scores: Sequence[FieldScore], name: str) -> float:
    """Root mean square of what was stated over that of the error."""
    squares = sum(s.squares.get(name, 0.0) for s in scores)
    return math.sqrt(sum(s.variances.get(name, 0.0) for s in scores) / squares) if squares else 0.0


def interval(found: int, of: int) -> str:
    """A count with Wilson's 95 % interval."""
    if not of:
        return "none"
    bounds = binomtest(found, of).proportion_ci(method="wilson")
    return f"{found} of {of} ({100 * bounds.low:.0f} to {100 * bounds.high:.0f} %)"


def good(score: FieldScore) -> bool:
    """Whether a fault was said rightly in time, or did no harm."""
    return score.said <= SOON or all(score.held(name) >= 0.88 for name in ("pull", "margin"))


def table(scores: Sequence[FieldScore], worlds: Sequence[str]) -> list[str]:
    """One line a world."""
    lines = [
        "| world | drives | " + " | ".join(f"{q} in band (width)" for q in QUANTITIES) + " |"
        " warnings | said, m | findings besides | wrong flags |",
        "| --- | --- " + "| --- " * (len(QUANTITIES) + 4) + "|",
    ]
    for name in worlds:
        mine = [score for score in scores if score.world == name]
        if not mine:
            continue
        cells = []
        for quantity in QUANTITIES:
            share, low, high = held(mine, quantity)
            cells.append(f"{share:.2f} ({low:.2f}..{high:.2f}; {width(mine, quantity):.1f})")
        metres = sum(s.length for s in mine)
        said = "-"
        expected = WORLDS[name].said
        if expected:
            soon = sorted(s.said for s in mine if s.said <= SOON)
            said = f"{len(soon)} of {len(mine)}" + (
                f", {soon[len(soon) // 2]:.1f} m" if soon else ""
            )
            said += f"; good {sum(map(good, mine))}"
        besides = sum(
            any(not (expected and re.search(expected, w)) for w in s.findings) for s in mine
        )
        off = [s for s in mine if s.wrong]
        worst = max((max(s.wrong.values()) for s in off), default=0.0)
        cells += [
            f"{sum(s.warned for s in mine)} in {metres:.0f} m",
            said,
            str(besides),
            f"{len(off)}" + (f", {worst:.1f}" if off else ""),
        ]
        lines.append(f"| {name} | {len(mine)} | " + " | ".join(cells) + " |")
    return lines


def main() -> None:
    """Run the worlds and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--words", action="store_true", help="what was said in each drive, too")
    given, worlds, scores = run_worlds(parser, WORLDS, FieldScore, drive_and_score)
    print("\n".join(table(scores, worlds)))
    if given.words:
        for score in scores:
            said = {**score.findings, **score.warnings, **score.wrong}
            print(f"\n{score.world}, seed {score.seed}: said {score.said:.1f}")
            for words, at in said.items():
                print(f"  {at:6.1f}  {words}")


if __name__ == "__main__":
    main()
