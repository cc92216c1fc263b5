# SPDX-License-Identifier: Apache-2.0
"""How often `smallwheel learn` is right over the worlds of `learn_worlds.py`.

    PYTHONPATH=. python benchmarks/learn_rates.py --worlds tanh_slip,multipass --seeds 0:5
    PYTHONPATH=. python benchmarks/learn_rates.py --summary results.jsonl

Each table is one line of JSON; `--out` appends, so that several runs add up.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.learn_worlds import ALL, LAWS, OUTSIDE, table
from smallwheel_ros.fitting import Base
from smallwheel_ros.learn.draft import formula
from smallwheel_ros.learn.pipeline import Sought, seek
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.measurements.wheels import read_measurements
from smallwheel_ros.model import predict


def read(world: str, seed: int, part: int, **more: object) -> Measurements:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.csv"
        table(world, seed, part, **more).to_csv(path, index=False)  # type: ignore[arg-type]
        return read_measurements(path)


def share_gone(sought: Sought, fresh: Measurements, quiet: Measurements) -> float:
    """Share of the base's error above the floor that the law takes away, on fresh settings.

    quiet: the same settings without noise and scatter; what these make is the floor.
    """
    assert sought.best is not None
    shares = []
    for name, measured in fresh.channels.items():
        floor = float(np.sqrt(np.mean((measured - quiet.channels[name]) ** 2)))
        before, after = (
            float(np.sqrt(np.mean((getattr(predict(m, fresh.conditions), name) - measured) ** 2)))
            for m in (sought.best.base.model, sought.best.law.fit.model)
        )
        if before > 1.1 * floor:  # else the law does not act on this channel
            shares.append((before - after) / (before - floor))
    return float(np.mean(shares)) if shares else float("nan")


def one(
    world: str, seed: int, runs: int, noise: float, channels: tuple[str, ...]
) -> dict[str, object]:
    start = time.process_time()
    sought = seek(read(world, seed, 0, runs=runs, noise=noise, channels=channels), Base())
    found: dict[str, object] = {
        "world": world, "seed": seed, "runs": runs, "noise": noise, "channels": len(channels),
        "verdict": sought.verdict, "p": sought.p, "seconds": round(time.process_time() - start, 1),
    }  # fmt: skip
    if sought.best is not None:
        hidden, law = ALL[world], sought.best.law.law
        found |= {
            "stage": law.place.name, "drivers": list(law.drivers),
            "formula": formula(law, sought.best.law.numbers), "tied": len(sought.best.tied),
            "stage_right": law.place.stage[0] in hidden.stages,
            "driver_right": law.columns in hidden.drivers,
            "gone": share_gone(
                sought,
                read(world, seed, 1, runs=60, rows=1, noise=noise, channels=channels),
                read(world, seed, 1, runs=60, rows=1, noise=0.0, channels=channels),
            ),
        }  # fmt: skip
    return found


def wilson(hits: int, count: int) -> str:
    """A rate with its 95 % interval (Wilson 1927)."""
    if count == 0:
        return "-"
    z, p = 1.96, hits / count
    middle = (p + z * z / (2 * count)) / (1 + z * z / count)
    half = z * np.sqrt(p * (1 - p) / count + z * z / (4 * count**2)) / (1 + z * z / count)
    low, high = max(0.0, middle - half), min(1.0, middle + half)
    return f"{hits} of {count}, {100 * p:.0f} ({100 * low:.0f} to {100 * high:.0f}) %"


def summary(lines: list[dict[str, object]]) -> str:
    """Rates by condition."""
    text = []
    for key in sorted(
        {(x["world"] == "nothing", x["runs"], x["noise"], x["channels"]) for x in lines}
    ):
        mine = [x for x in lines
                if (x["world"] == "nothing", x["runs"], x["noise"], x["channels"]) == key]  # fmt: skip
        law = [x for x in mine if x["verdict"] == "law"]
        right = sum(bool(x["stage_right"] and x["driver_right"]) for x in law)
        dummy = sum("battery" in str(x["drivers"]) for x in law)
        text.append(
            f"{key[1]} runs, {100 * float(str(key[2])):g} % noise, {key[3]} channels, "
            f"{'nothing hidden' if key[0] else 'a law hidden'}: "
            f"drafted {wilson(len(law), len(mine))}; stage and driver right {wilson(right, len(law))}; "
            f"driver right {wilson(sum(bool(x['driver_right']) for x in law), len(law))}; "
            f"battery drafted {wilson(dummy, len(mine))}"
        )
        if law and not key[0]:
            gone = np.array([float(str(x["gone"])) for x in law])
            text.append(f"    share of the error gone on new settings: median {np.median(gone):.3f}, "
                        f"lowest {gone.min():.3f}")  # fmt: skip
            for world in sorted({str(x["world"]) for x in mine}):
                here = [x for x in mine if x["world"] == world]
                drafted = [x for x in here if x["verdict"] == "law"]
                hits = sum(bool(x["stage_right"] and x["driver_right"]) for x in drafted)
                text.append(
                    f"    {world:18s} {len(here)} tables, {len(drafted)} drafted, {hits} right"
                )
    return "\n".join(text)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--worlds", default="all")
    parser.add_argument("--seeds", default="0:2")
    parser.add_argument("--runs", type=int, default=32)
    parser.add_argument("--noise", type=float, default=0.03)
    parser.add_argument("--channels", default="sinkage,resistance")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--summary", type=Path, nargs="*")
    given = parser.parse_args()
    if given.summary:
        lines = [json.loads(t) for p in given.summary for t in p.read_text().splitlines()]
        print(summary(lines))
        return
    groups = {"all": [w for w in LAWS if w != "nothing"], "outside": list(OUTSIDE)}
    worlds = groups.get(given.worlds) or given.worlds.split(",")
    first, last = map(int, given.seeds.split(":"))
    lines = []
    for seed in range(first, last):
        for world in worlds:
            found = one(world, seed, given.runs, given.noise, tuple(given.channels.split(",")))
            lines.append(found)
            print(json.dumps(found), flush=True)
            if given.out:
                with given.out.open("a") as file:
                    file.write(json.dumps(found) + "\n")
    print(summary(lines))


if __name__ == "__main__":
    main()
