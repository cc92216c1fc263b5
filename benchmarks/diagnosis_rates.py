"""How often the diagnosis is right: rates over seeds of the truth simulator, as a table for docs/.

    python benchmarks/diagnosis_rates.py --seeds 0:40 --output docs/diagnosis_rates.md

Every case is simulated, written, read and diagnosed as a user would. Results of single trials are
kept in a JSON file beside the table, so that an interrupted run goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from smallwheel_ros.diagnosis import diagnose
from smallwheel_ros.effects.registry import effect
from smallwheel_ros.fitting import fit_model
from smallwheel_ros.measurements.table import Measurements, read_measurements
from smallwheel_ros.simulate import RigSettings, measure, simulate_rig, write_table


@dataclass(frozen=True)
class Case:
    """One line of the table.

    then: after the first diagnosis make the proposed runs and ask again. friction: share of the load that
    the rig itself resists, which is no effect of the soil.
    """

    name: str
    hidden: tuple[str, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)
    then: bool = False
    friction: float = 0.0

    @property
    def expected(self) -> set[str]:
        """Names that a right answer has; none for what nothing recorded explains."""
        names = {h.replace("column:", "covariate:") for h in self.hidden}
        return names - {"unrecorded"}


MAIN = (
    "slip_sinkage",
    "bulldozing",
    "penetration_rate",
    "load_dependent_modulus",
    "width_dependent_modulus",
    "multipass",
    "sinkage_offset",
)
POOR = {"runs": 10, "noise": 0.10}
CASES = (
    Case("nothing hidden", ()),
    *(Case(name, (name,)) for name in MAIN),
    Case("hardpan", ("hardpan",)),
    Case("elastic_rebound", ("elastic_rebound",)),
    Case("skid_sinkage", ("skid_sinkage",)),
    Case("column:density", ("column:density",)),
    Case("unrecorded", ("unrecorded",)),
    Case("friction of the rig, 6 % of the load", (), friction=0.06),
    Case("slip_sinkage + multipass", ("slip_sinkage", "multipass")),
    Case("bulldozing + penetration_rate", ("bulldozing", "penetration_rate")),
    Case("slip_sinkage + width_dependent_modulus", ("slip_sinkage", "width_dependent_modulus")),
    Case("slip_sinkage, slip tied to load", ("slip_sinkage",), {"tie": ("slip", "load")}, True),
    Case(
        "load_dependent_modulus, slip tied to load",
        ("load_dependent_modulus",),
        {"tie": ("slip", "load")},
        True,
    ),
    Case("nothing hidden, 10 runs, 10 %", (), POOR),
    *(Case(f"{name}, 10 runs, 10 %", (name,), POOR) for name in MAIN),
    Case("hardpan, 10 runs, 10 %", ("hardpan",), POOR),
    Case("unrecorded, 10 runs, 10 %", ("unrecorded",), POOR),
    Case("slip_sinkage, 2 % outliers", ("slip_sinkage",), {"outliers": 0.02}),
    Case("nothing hidden, 2 % outliers", (), {"outliers": 0.02}),
    Case("slip_sinkage, sinkage only", ("slip_sinkage",), {"channels": ("sinkage",)}),
    Case("width_dependent_modulus, sinkage only", ("width_dependent_modulus",),
         {"channels": ("sinkage",)}),
    Case("slip_sinkage, 5 runs", ("slip_sinkage",), {"runs": 5}),
)  # fmt: skip

# Where the form is known to both sides, the fitted parameter can be compared with the truth.
COVERED = {
    "slip_sinkage": ("exponential", "a"),
    "penetration_rate": ("power", "mu"),
    "load_dependent_modulus": ("power", "g"),
    "multipass": ("power", "p"),
    "sinkage_offset": ("constant", "offset"),
}


def read(table: pd.DataFrame, folder: Path) -> Measurements:
    path = folder / "rig.csv"
    write_table(table, path)
    return read_measurements(path)


def gone(document: Mapping[str, Any]) -> float | None:
    """Share of the held-out error above the noise floor that the named effects took away."""
    first, last = document["steps"][0]["held_out_rmse"], document["steps"][-1]["held_out_rmse"]
    before = after = 0.0
    for name, channel in document["channels"].items():
        floor = channel["noise_floor"]
        if floor is None:
            return None
        before += max(first[name] - floor, 0.0) / floor
        after += max(last[name] - floor, 0.0) / floor
    return 1.0 - after / before if before > 0 else None


def trial(case: Case, seed: int, folder: Path) -> dict[str, Any]:
    rig = simulate_rig(RigSettings(seed=seed, hidden=case.hidden, **case.settings))
    if case.friction:
        rig.table["resistance [N]"] += case.friction * rig.table["load [N]"]
    measurements = read(rig.table, folder)
    started = time.process_time()
    document = diagnose(measurements).document
    result = summary(document) | {"seconds": time.process_time() - started}
    proposals = document["next_measurements"]
    if case.then and proposals:
        runs = [proposals[0]["settings"]] * proposals[0]["runs"]
        more = pd.concat([rig.table, measure(rig.truth, runs)], ignore_index=True)
        result["then"] = summary(diagnose(read(more, folder)).document)
    return result


def summary(document: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "verdict": document["verdict"],
        "named": document["missing_effects"],
        "candidates": document["candidates"],
        "gone": gone(document),
    }


def coverage(seeds: Sequence[int], folder: Path) -> dict[str, tuple[int, int]]:
    """By effect, how many of the 95 % intervals hold the true value, and how many there were."""
    found = {}
    for name, (form, parameter) in COVERED.items():
        inside = 0
        for seed in tqdm(seeds, desc=f"intervals of {name}", disable=None, leave=False):
            rig = simulate_rig(RigSettings(seed=seed, hidden=(name,), form="published"))
            start = effect(name, form)
            fit = fit_model(read(rig.table, folder), [start])
            fitted = next(p for p in fit.parameters if p.full_name == f"{name}.{parameter}")
            truth = rig.truth.effects[0].amplitude
            inside += fitted.std is not None and abs(fitted.value - truth) < 1.96 * fitted.std
        found[name] = (inside, len(seeds))
    return found


def line(case: Case, trials: Sequence[Mapping[str, Any]]) -> str:
    n = len(trials)
    expected = case.expected

    def share(count: int) -> str:
        return f"{100 * count / n:.0f}"

    alone = sum(bool(expected) and set(t["named"]) == expected for t in trials)
    inside = sum(
        bool(expected) and expected <= set(t["named"]) | set(t["candidates"]) for t in trials
    )
    wrong = sum(bool(set(t["named"]) - expected) for t in trials)
    only_wrong = sum(bool(t["named"]) and not set(t["named"]) & expected for t in trials)
    verdicts = {
        v: sum(t["verdict"] == v for t in trials)
        for v in ("adequate", "unknown_effect", "indistinguishable", "insufficient_data")
    }
    removed = [t["gone"] for t in trials if t["gone"] is not None and t["named"]]
    middle = f"{100 * float(np.median(removed)):.0f}" if removed else ""
    then = [t["then"] for t in trials if "then" in t]
    after = ""
    if case.then:
        right = sum(set(t["named"]) == expected for t in then)
        after = f"{100 * right / n:.0f}"
    cells = [
        case.name, str(n), share(alone) if expected else "", share(inside) if expected else "",
        share(only_wrong), share(wrong), *(share(v) for v in verdicts.values()), middle, after,
    ]  # fmt: skip
    return "| " + " | ".join(cells) + " |"


HEAD = """\
# Rates of the diagnosis

Made by `python benchmarks/diagnosis_rates.py --seeds {seeds} --output docs/diagnosis_rates.md`,
on the truth simulator (`smallwheel simulate rig`), whose effects have other functional forms than
the library's. 32 runs of 3 rows, sinkage and resistance, 3 % noise and 5 % run-to-run scatter of k
unless the case says otherwise. Per cent of trials.

- named alone: exactly the hidden effects are named. in the set: they are among what is named or
  given as candidates.
- wrong alone: names are given and none of them is right. any wrong: one of the names is wrong.
- error gone: median share of the held-out error above the noise floor that is gone after adding.
- then: named alone after the first proposed measurement was simulated and added.

| case | trials | named alone | in the set | wrong alone | any wrong | adequate | unknown effect \
| indistinguishable | insufficient data | error gone | then |
| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seeds", default="0:40", help="first:last, last not included")
    parser.add_argument("--output", type=Path, default=Path("diagnosis_rates.md"))
    parser.add_argument("--trials", type=Path, help="JSON of the single trials; kept and resumed")
    parser.add_argument("--cases", default="", help="only cases whose name has this in it")
    parser.add_argument("--no-coverage", action="store_true")
    options = parser.parse_args()
    first, last = (int(v) for v in options.seeds.split(":"))
    seeds = range(first, last)
    store = options.trials or options.output.with_suffix(".trials.json")
    known: dict[str, Any] = json.loads(store.read_text()) if store.exists() else {}
    warnings.simplefilter("ignore", RuntimeWarning)
    lines = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for case in (c for c in CASES if options.cases in c.name):
            for seed in tqdm(seeds, desc=case.name, disable=None):
                key = f"{case.name}|{seed}"
                if key not in known:
                    known[key] = trial(case, seed, folder)
                    store.write_text(json.dumps(known, indent=0))
            trials = [known[f"{case.name}|{seed}"] for seed in seeds]
            lines.append(line(case, trials))
            print(lines[-1], flush=True)
        covered = {} if options.no_coverage else coverage(seeds, folder)
    seconds = [t["seconds"] for t in known.values()]
    text = HEAD.format(seeds=options.seeds) + "\n".join(lines) + "\n"
    text += f"\nProcessor time per diagnosis: median {np.median(seconds):.1f} s, "
    text += f"largest {np.max(seconds):.1f} s.\n"
    if covered:
        text += "\n95 % intervals of an effect's parameter that hold the true value, the form known:\n\n"
        text += "| effect | inside | of |\n| --- | --- | --- |\n"
        text += "".join(f"| {n} | {i} | {of} |\n" for n, (i, of) in covered.items())
        total = sum(i for i, _ in covered.values()) / sum(of for _, of in covered.values())
        text += f"\nAll together: {100 * total:.0f} %.\n"
    options.output.write_text(text)
    print(f"written: {options.output}")


if __name__ == "__main__":
    main()
