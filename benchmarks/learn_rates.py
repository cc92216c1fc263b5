# SPDX-License-Identifier: Apache-2.0
"""How often `smallwheel learn` is right over the worlds of `learn_worlds.py`.

    PYTHONPATH=. python benchmarks/learn_rates.py --worlds all --seeds 0:5 --out rates.jsonl
    PYTHONPATH=. python benchmarks/learn_rates.py --summary rates.jsonl --write docs/learn.md

Each table is one line of JSON; `--out` appends, so that several runs add up. The names `all`,
`outside`, `signed` and `pairs` stand for groups of worlds; as many laws are learnt as a world hides.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from benchmarks.learn_worlds import LAWS, OUTSIDE, SIGNED, hidden, table
from smallwheel_ros.learn.law import Law
from smallwheel_ros.learn.learn import learn
from smallwheel_ros.learn.verdict import VAULT_FROM
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.measurements.wheels import read_measurements
from smallwheel_ros.model.model import Model, predict

ROWS = {"repeats": 3, "settings": 4, "curve": 12}  # of a run, by what they are
GROUPS = {
    "all": [w for w in LAWS if w != "nothing"],
    "outside": list(OUTSIDE),
    "signed": list(SIGNED),
    "pairs": ["tanh_slip+multipass", "rate+slip_drag", "moisture_optimum+flexible_wheel",
              "speed_threshold+load_slip", "temperature_rate+tanh_slip", "width+slip_sinkage"],
}  # fmt: skip
BEGIN, END = "<!-- rates: begin -->\n", "<!-- rates: end -->\n"
Line = dict[str, Any]


def read(world: str, seed: int, part: int, **more: object) -> Measurements:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.csv"
        table(world, seed, part, **more).to_csv(path, index=False)  # type: ignore[arg-type]
        return read_measurements(path)


def share_gone(base: Model, law: Model, fresh: Measurements, quiet: Measurements) -> float | None:
    """Share of the base's error above the floor that the law takes away, on fresh settings.

    quiet: the same settings without noise and scatter; what these make is the floor. None where no
    channel's error is above it.
    """
    shares = []
    for name, measured in fresh.channels.items():
        floor = float(np.sqrt(np.mean((measured - quiet.channels[name]) ** 2)))
        before, after = (
            float(np.sqrt(np.mean((getattr(predict(m, fresh.conditions), name) - measured) ** 2)))
            for m in (base, law)
        )
        if before > 1.1 * floor:  # else the law does not act on this channel
            shares.append((before - after) / (before - floor))
    return float(np.mean(shares)) if shares else None


def one(
    world: str, seed: int, runs: int, noise: float, channels: tuple[str, ...], within: str
) -> Line:
    """One table of a world: what was said of it, and what is true of that."""
    how: Line = {"noise": noise, "channels": channels}
    laws = hidden(world)
    start = time.process_time()
    data = read(world, seed, 0, runs=runs, rows=ROWS[within], within=within, **how)
    learnt = learn(data, most=len(laws))
    found: Line = {
        "world": world, "seed": seed, "runs": runs, "noise": noise,
        "channels": len(channels), "within": within,
        "verdict": learnt.verdict, "p": learnt.sought[0].p,
        "seconds": round(time.process_time() - start, 1),
    }  # fmt: skip
    if learnt.verdict != "law":
        return found
    base = learnt.sought[0].problem
    assert base is not None
    best = [s.best for s in learnt.sought if s.best is not None and s.verdict == "law"]
    drafted = [b.law.law for b in best]
    fresh = read(world, seed, 1, runs=60, rows=1, **how)
    quiet = read(world, seed, 1, runs=60, rows=1, **how | {"noise": 0.0})
    matched = all(_is_of_one(law, world) for law in drafted) and len(drafted) == len(laws)
    return found | {
        "formula": [b.law.law.formula(b.law.numbers) for b in best],
        "tied": len(best[0].tied),
        "driver_right": matched,
        "right": matched and all(_is_of_one(law, world, stage=True) for law in drafted)
        and len({law.columns for law in drafted}) == len(laws),
        "battery": any("battery" in law.columns for law in drafted),
        "gone": share_gone(base.fit.model, best[-1].law.fit.model, fresh, quiet),
    }  # fmt: skip


def _is_of_one(law: Law, world: str, *, stage: bool = False) -> bool:
    """Whether a law follows what one of the world's laws follows, and acts at its stage."""
    return any(
        law.columns in one.drivers and (not stage or law.place.stage[0] in one.stages)
        for one in hidden(world)
    )


def rate(hits: int, count: int) -> str:
    """A rate with its 95 % interval (Wilson 1927)."""
    if count == 0:
        return "-"
    interval = binomtest(hits, count).proportion_ci(method="wilson")
    ends = f"{100 * interval.low:.0f} to {100 * interval.high:.0f}"
    return f"{hits} of {count}, {100 * hits / count:.0f} ({ends}) %"


def _condition(line: Line) -> tuple[int, str]:
    """Order and name of the condition that a table is of."""
    noise = f"{line['runs']} runs, {100 * line['noise']:g} % noise"
    if line["channels"] == 1:
        noise += ", sinkage alone"
    within = line.get("within", "repeats")
    if within != "repeats":
        noise += ", several settings a run" if within == "settings" else ", curves of slip"
    if line["runs"] >= VAULT_FROM:
        noise += ", with a vault"
    if not hidden(line["world"])[0].drivers:
        return 4, f"nothing hidden, {noise}"
    if "+" in line["world"]:
        return 3, f"two laws hidden, {noise}"
    if line["world"] in SIGNED:
        return 2, f"slip of either sign, {noise}"
    if line["world"] in OUTSIDE:
        return 2, f"other structures, {noise}"
    return int(line["runs"] < 32), noise


def summary(lines: Sequence[Line]) -> str:
    """Rates by condition as a table in Markdown, and the answers that were wrong."""
    text = [
        "| condition | a law drafted | stage and driver right, of those drafted | driver right | gone: "
        "median, lowest | a dummy column drafted | seconds |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    wrong = []
    for condition in sorted({_condition(x) for x in lines}):
        mine = [x for x in lines if _condition(x) == condition]
        law = [x for x in mine if x["verdict"] == "law"]
        gone = [x["gone"] for x in law if x["gone"] is not None] or [np.nan]
        nothing = condition[1].startswith("nothing")
        counts = [
            rate(len(law), len(mine)),
            "" if nothing else rate(sum(x["right"] for x in law), len(law)),
            "" if nothing else rate(sum(x["driver_right"] for x in law), len(law)),
            "" if nothing else f"{np.median(gone):.2f}, {min(gone):.2f}",
            rate(sum(x["battery"] for x in law), len(mine)),
            f"{np.median([x['seconds'] for x in mine]):.0f}, most {max(x['seconds'] for x in mine):.0f}",
        ]
        text.append(f"| {condition[1]} | {' | '.join(counts)} |")
        if nothing:
            under = sum(x["p"] is not None and x["p"] <= 0.02 for x in mine)
            text.append(f"| the same: p of 0.02 or less | {rate(under, len(mine))} | | | | | |")
            wrong += [(condition[1], x) for x in law]
        else:
            wrong += [(condition[1], x) for x in mine if not x.get("right")]
    text += ["", "Not right:", ""]
    text += [
        f"- {x['world']} ({condition}, seed {x['seed']}): {x['verdict']}"
        + (f", `{'`, `'.join(x['formula'])}`" if x["verdict"] == "law" else f", p {x['p']}")
        for condition, x in wrong
    ]
    return "\n".join(text) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", default="all")
    parser.add_argument("--seeds", default="0:2")
    parser.add_argument("--runs", type=int, default=32)
    parser.add_argument("--noise", type=float, default=0.03)
    parser.add_argument("--channels", default="sinkage,resistance")
    parser.add_argument("--within", choices=sorted(ROWS), default="repeats")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--summary", type=Path, nargs="*", help="results to sum up")
    parser.add_argument("--write", type=Path, help="page whose table of rates is made anew")
    given = parser.parse_args()
    if given.summary:
        lines = [json.loads(t) for p in given.summary for t in p.read_text().splitlines()]
    else:
        lines = []
        first, last = map(int, given.seeds.split(":"))
        for seed in range(first, last):
            for world in GROUPS.get(given.worlds) or given.worlds.split(","):
                channels = tuple(given.channels.split(","))
                found = one(world, seed, given.runs, given.noise, channels, given.within)
                lines.append(found)
                print(json.dumps(found), flush=True)
                if given.out:
                    with given.out.open("a") as file:
                        file.write(json.dumps(found) + "\n")
    print(summary(lines))
    if given.write:
        before, rest = given.write.read_text().split(BEGIN)
        given.write.write_text(before + BEGIN + summary(lines) + END + rest.split(END)[1])


if __name__ == "__main__":
    main()
