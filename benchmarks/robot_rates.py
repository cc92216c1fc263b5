# SPDX-License-Identifier: Apache-2.0
"""How often are the pipeline's soils right on robots as they are? Rates over the worlds of `robot_worlds`.

    python benchmarks/robot_rates.py --seeds 0:12 --jobs 2 --scores out/scores.jsonl
    python benchmarks/robot_rates.py --seeds 0:0 --scores out/scores.jsonl --output docs/estimator_rates.md

Each drive is 24 m, sinkage at 10 Hz. What is said to be determined is judged every 0.1 m of it: a flag
is wrong where the parameter is over three of its stated deviations off. Intervals are Wilson's, 95 %,
of shares of drives: what is said at two places of one drive is one thing said twice.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
from collections.abc import Callable, Collection, Sequence
from multiprocessing import Pool
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.stats import binomtest
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.robot_drives import make_drive
from benchmarks.robot_scores import NAMES, Score, run
from benchmarks.robot_worlds import WORLDS

ScoreT = TypeVar("ScoreT", bound=Any)  # of a drive: has world, seed and as_dict

_WITHIN = 1.0  # m behind the border
_LEAD = 0.35  # m that the front wheels are ahead
_LEAST_HELD = 0.88  # of a drive's true sinkages in the 95 % band

_HEAD = """\
# How often the estimator is right, by world

`python benchmarks/robot_rates.py`: {drives} drives of 24 m, {least} to {most} of each world.
The truth is a contact integral by quadrature, composed with ground, ruts and sensors of its own
(`benchmarks/robot_drives.py`). A flag is wrong where a parameter is said to be determined and is over
three of its stated deviations off; it is judged every 0.1 m, and for 1 m behind a border the soil before
it counts as right too. Brackets after a rate: count and Wilson's 95 % interval, drives being what is
counted. The prior is off by 0.5 in ln pressure, 0.2 in n and 0.3 in m (standard deviations over the
drives).

"""


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


def share_wrong(score: Score) -> float:
    """Share of a drive's flags that were wrong."""
    return sum(score.wrong.values()) / max(sum(score.judged.values()), 1)


def wrong_at_the_end(score: Score) -> int:
    """Flags of a drive that were wrong where it ended."""
    return sum(
        score.determined[name] and abs(score.error[name]) > 3.0 * score.deviation[name]
        for name in NAMES
    )


def table(scores: Sequence[Score], worlds: Sequence[str]) -> list[str]:
    """One line a world."""
    lines = [
        "| world | drives | 95 % band holds (lowest drive) | determined at the end: pressure, n, m, K |"
        " wrong anywhere: drives, share of flags, worst | n at the end: rms error (stated) |"
        " changes found | named |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name in worlds:
        mine = [score for score in scores if score.world == name]
        if not mine:
            continue
        held = [score.held for score in mine]
        flags = " ".join(str(sum(s.determined[key] for s in mine)) for key in NAMES)
        off = [s for s in mine if s.wrong]
        wrong = "0"
        if off:
            worst, which, seed, at = max(
                (sigmas, key, s.seed, at) for s in off for key, (sigmas, at) in s.worst.items()
            )
            share = np.mean([share_wrong(s) for s in mine])
            wrong = f"{len(off)}, {100 * share:.1f} %, {which} {worst:.1f} sigma (seed {seed}, {at:.0f} m)"
        n = f"{rms([s.error['n'] for s in mine]):.3f} ({np.mean([s.deviation['n'] for s in mine]):.3f})"
        if WORLDS[name].borders:
            soon = sum(0.0 <= s.found + _LEAD <= _WITHIN + _LEAD for s in mine)
            changes = f"{soon} within 1 m; {sum(s.changes for s in mine)} in all"
        else:
            changes = str(sum(s.changes for s in mine))
        words = sorted({s.effect for s in mine if s.effect})
        named = ", ".join(f"{w} {sum(s.effect == w for s in mine)}" for w in words) or "-"
        lines.append(
            f"| {name} | {len(mine)} | {np.mean(held):.2f} ({min(held):.2f}) | {flags} | {wrong} |"
            f" {n} | {changes} | {named} |"
        )
    return lines


def summary(scores: Sequence[Score]) -> list[str]:
    """The rates over all worlds."""
    flags = sum(sum(s.judged.values()) for s in scores)
    wrong = sum(sum(s.wrong.values()) for s in scores)
    said = [s for s in scores if sum(s.judged.values())]
    ends = sum(sum(s.determined.values()) for s in scores)
    still = [s for s in scores if not WORLDS[s.world].borders and WORLDS[s.world].back == 1.0]
    metres = sum(WORLDS[s.world].distance for s in still)
    false = sum(s.changes for s in still)
    plain = [s for s in scores if WORLDS[s.world].slip_sinkage == 0.0]
    off = sum(bool(s.wrong) for s in said)
    off_at_end = sum(map(wrong_at_the_end, scores))
    return [
        f"- drives with a flag that was wrong anywhere: {interval(off, len(said))}",
        f"- share of all flags, every 0.1 m, that were wrong: {100 * wrong / max(flags, 1):.2f} % "
        f"({wrong} of {flags})",
        f"- flags that were wrong at the end of a drive: {interval(off_at_end, ends)}",
        "- drives in which the 95 % band holds less than 0.88 of the true sinkages: "
        f"{interval(sum(s.held < _LEAST_HELD for s in scores), len(scores))}",
        f"- changes of soil found where there are none: {false} in {metres:.0f} m",
        f"- drives with an effect named where there is none: "
        f"{interval(sum(bool(s.effect) for s in plain), len(plain))}",
    ]


def run_worlds(
    parser: argparse.ArgumentParser,
    known: Collection[str],
    kind: Callable[..., ScoreT],
    drive_and_score: Callable[[tuple[str, int]], ScoreT],
) -> tuple[argparse.Namespace, list[str], list[ScoreT]]:
    """The options that every such benchmark has, the worlds meant by them, and the scores of their drives."""
    parser.add_argument("--worlds", default="", help="regular expression; all without it")
    parser.add_argument("--seeds", default="0:12", help="first and end")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--scores", type=Path, help="file of scores: more are added, all are shown")
    given = parser.parse_args()
    first, end = (int(part) for part in given.seeds.split(":"))
    worlds = [name for name in known if re.search(given.worlds, name)]
    scores: list[ScoreT] = []
    if given.scores is not None and given.scores.exists():
        scores = [kind(**json.loads(line)) for line in given.scores.read_text().splitlines()]
    done = {(score.world, score.seed) for score in scores}
    tasks = [(name, seed) for seed in range(first, end) for name in worlds]
    tasks = [task for task in tasks if task not in done]
    with Pool(given.jobs) as pool:
        found = pool.imap_unordered(drive_and_score, tasks)
        for score in tqdm(found, total=len(tasks), disable=not sys.stderr.isatty()):
            scores.append(score)
            if given.scores is not None:
                with given.scores.open("a") as stream:
                    stream.write(json.dumps(score.as_dict()) + "\n")
    return given, worlds, [score for score in scores if score.world in worlds]


def main() -> None:
    """Run the worlds and print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--output", type=Path, help="Markdown file")
    given, worlds, scores = run_worlds(parser, WORLDS, Score, drive_and_score)
    counts = [sum(score.world == name for score in scores) for name in worlds]
    head = _HEAD.format(drives=len(scores), least=min(counts), most=max(counts))
    text = head + "\n".join([*summary(scores), "", *table(scores, worlds), ""])
    if given.output is None:
        print(text)
    else:
        given.output.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
