"""How often is the estimator right on robots as they are? Rates over the worlds of `robot_worlds`.

    python benchmarks/robot_rates.py --seeds 0:12 --jobs 2 --output docs/estimator_rates.md

Each drive is 24 m, sinkage at 10 Hz. A flag is wrong where a parameter is said to be determined and is
over three of its stated deviations off. Intervals are Wilson's, 95 %.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Sequence
from multiprocessing import Pool
from pathlib import Path

import numpy as np
from scipy.stats import binomtest
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.robot_worlds import WORLDS, Score, make_drive, run

NAMES = ("reference_pressure", "n", "m", "effective_modulus")
_WITHIN = 1.0  # m behind the border
_LEAD = 0.35  # m that the front wheels are ahead


def drive_and_score(task: tuple[str, int]) -> Score:
    """Make and run one drive."""
    name, seed = task
    _, score = run(make_drive(WORLDS[name], seed))
    score.seed = seed
    return score


def interval(found: int, of: int) -> str:
    """A share in per cent with Wilson's 95 % interval and its count."""
    if of == 0:
        return "none"
    bounds = binomtest(found, of).proportion_ci(method="wilson")
    return f"{100 * found / of:.1f} % ({found} of {of}; {100 * bounds.low:.1f} to {100 * bounds.high:.1f})"


def rms(values: Sequence[float]) -> float:
    """Root mean square."""
    return math.sqrt(float(np.mean(np.square(values))))


def table(scores: Sequence[Score], worlds: Sequence[str]) -> list[str]:
    """One line a world."""
    lines = [
        "| world | 95 % band holds (lowest drive) | determined: pressure, n, m, K | wrong |"
        " n: rms error (stated) | changes found | named, or found |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name in worlds:
        mine = [score for score in scores if score.world == name]
        held = [score.held for score in mine]
        flags = " ".join(str(sum(s.determined[key] for s in mine)) for key in NAMES)
        wrong = sum(len(s.wrong) for s in mine)
        n = f"{rms([s.error['n'] for s in mine]):.3f} ({np.mean([s.deviation['n'] for s in mine]):.3f})"
        if WORLDS[name].change != 1.0:
            soon = sum(0.0 <= s.found + _LEAD <= _WITHIN + _LEAD for s in mine)
            changes = f"{soon} of {len(mine)} within 1 m"
        else:
            changes = str(sum(s.changes for s in mine))
        words = sorted({s.effect for s in mine if s.effect})
        named = ", ".join(f"{w} {sum(s.effect == w for s in mine)}" for w in words)
        said = sum(bool(s.findings) for s in mine)
        found = f"{named or 'no name'}; {said} with a finding"
        lines.append(
            f"| {name} | {np.mean(held):.2f} ({min(held):.2f}) | {flags} of {len(mine)} | {wrong} |"
            f" {n} | {changes} | {found} |"
        )
    return lines


def summary(scores: Sequence[Score]) -> list[str]:
    """The rates over all worlds."""
    flags = sum(sum(s.determined.values()) for s in scores)
    wrong = sum(len(s.wrong) for s in scores)
    still = [s for s in scores if WORLDS[s.world].change == 1.0]
    metres = sum(WORLDS[s.world].distance for s in still)
    false = sum(s.changes for s in still)
    plain = [s for s in still if WORLDS[s.world].slip_sinkage == 0.0]
    names = sum(bool(s.effect) for s in plain)
    return [
        f"- determined and over 3 deviations off: {interval(wrong, flags)}",
        f"- changes of soil found where there are none: {false} in {metres:.0f} m",
        f"- an effect named where there is none: {interval(names, len(plain))} drives",
    ]


def main() -> None:
    """Run the worlds and print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--worlds", default="", help="regular expression; all without it")
    parser.add_argument("--seeds", default="0:12", help="first and end")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--output", type=Path, help="Markdown file")
    given = parser.parse_args()
    first, end = (int(part) for part in given.seeds.split(":"))
    worlds = [name for name in WORLDS if re.search(given.worlds, name)]
    tasks = [(name, seed) for seed in range(first, end) for name in worlds]
    with Pool(given.jobs) as pool:
        found = pool.imap_unordered(drive_and_score, tasks)
        scores = list(tqdm(found, total=len(tasks), disable=not sys.stderr.isatty()))
    text = "\n".join(
        [
            "# How often the estimator is right, by world",
            "",
            f"`python benchmarks/robot_rates.py --seeds {given.seeds}`: {len(scores)} drives of 24 m.",
            "The truth is a contact integral by quadrature, composed with ground, ruts and sensors of",
            "its own (`benchmarks/robot_worlds.py`). A flag is wrong where a parameter is said to be",
            "determined and is over three of its stated deviations off. Brackets after a rate: count",
            "and Wilson's 95 % interval. The prior is off by 0.5 in ln pressure, 0.2 in n and 0.3 in m",
            "(standard deviations over the drives).",
            "",
            *summary(scores),
            "",
            *table(scores, worlds),
            "",
        ]
    )
    if given.output is None:
        print(text)
    else:
        given.output.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
