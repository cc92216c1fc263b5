# SPDX-License-Identifier: Apache-2.0
"""How often the diagnosis is right: rates over worlds whose answer is known, as a table for docs/.

    python benchmarks/diagnosis_rates.py --worlds 'soil/*,fault/*' --seeds 0:10 --jobs 2 \
        --output docs/diagnosis_rates.md

Every table is written, read and diagnosed as a user would (worlds.py has the list). Single trials
are kept in a JSON-lines file beside the output, so that an interrupted run goes on where it was;
trials that failed are tried again. After a change of the diagnosis give `--again`.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

# One thread a job: numpy's own threads would compete with the other jobs.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pandas as pd
from tqdm import tqdm

# As a script this file finds its neighbours, as a module of the repository its package.
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks._rates_table import document
from benchmarks.worlds import WORLDS, matching
from smallwheel_ros.diagnosis.diagnose import diagnose
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.measurements.wheels import read_measurements
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.simulate import write_table

Trial = dict[str, Any]


def read(table: pd.DataFrame, folder: Path) -> Measurements:
    path = folder / "table.csv"
    write_table(table, path)
    return read_measurements(path)


def fresh_errors(model: Model, fresh: Measurements) -> dict[str, float]:
    """Root mean square error (SI) of a model on runs that it never saw, by channel."""
    prediction = predict(model, fresh.conditions)
    errors = {}
    for name, measured in fresh.channels.items():
        error = getattr(prediction, name) - measured
        errors[name] = float(np.sqrt(np.nanmean(error**2)))
    return errors


def trial(world: str, seed: int) -> Trial:
    """Diagnose one table.

    Errors are kept as text: the rest of a night's run is not lost.
    """
    result: Trial = {"world": world, "seed": seed}
    table, expected = WORLDS[world](seed)
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folder = Path(name)
        measurements = read(table, folder)
        started = time.process_time()
        try:
            diagnosis = diagnose(measurements, seed=0)
        except Exception as error:  # whatever it is, it is a finding about this table
            return result | {"failed": f"{type(error).__name__}: {error}"}
        seconds = time.process_time() - started
        answer = diagnosis.document
        result |= {
            "verdict": answer["verdict"],
            "named": answer["missing_effects"],
            "candidates": answer["candidates"],
            "p_value": answer.get("lack_of_fit", {}).get("p_value"),
            "seconds": seconds,
            "bad": table.attrs.get("bad", []),
            "bad_runs": [one["run"] for one in answer.get("bad_runs", [])],
        }
        steps = answer["steps"]
        if not steps or expected.truth_fresh is None or not hasattr(diagnosis, "fitted"):
            return result
        try:
            model = diagnosis.fitted(len(steps) - 1).model
            fresh = fresh_errors(model, read(expected.truth_fresh(), folder))
        except Exception as error:  # a verdict without a model, as where there are too few runs
            return result | {"no_fresh": f"{type(error).__name__}: {error}"}
    reported = steps[-1]["held_out_rmse"]
    ratios = {name: reported[name] / fresh[name] for name in fresh if reported.get(name)}
    return result | {"reported_over_fresh": ratios}


def stored(path: Path) -> dict[tuple[str, int], Trial]:
    """Trials of an earlier run that came to an end; a last line cut short is left out."""
    found: dict[tuple[str, int], Trial] = {}
    if not path.exists():
        return found
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            one = json.loads(line)
        except json.JSONDecodeError:
            continue
        if "failed" not in one:
            found[one["world"], one["seed"]] = one
    return found


def run(
    tasks: Sequence[tuple[str, int]], known: Mapping[tuple[str, int], Trial], store: Path, jobs: int
) -> list[Trial]:
    """Do the trials that are not known, each appended to the store as soon as it is done."""
    results = {task: known[task] for task in tasks if task in known}
    missing = [task for task in tasks if task not in known]
    with store.open("a", encoding="utf-8") as file:
        # Behind a line that was cut short a new one begins.
        file.write("\n" if store.stat().st_size else "")
        for one in tqdm(_done(missing, jobs), "trials", len(missing), disable=None):
            results[one["world"], one["seed"]] = one
            file.write(json.dumps(one) + "\n")
            file.flush()
    return [results[task] for task in tasks]


def _done(tasks: Sequence[tuple[str, int]], jobs: int) -> Iterable[Trial]:
    if jobs == 1:
        yield from (trial(*task) for task in tasks)
        return
    with ProcessPoolExecutor(jobs) as pool:
        for future in as_completed([pool.submit(trial, *task) for task in tasks]):
            yield future.result()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--worlds", default="*", help="shell patterns, separated by commas")
    parser.add_argument("--seeds", default="0:10", help="first:last, last not included")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--output", type=Path, default=Path("diagnosis_rates.md"))
    parser.add_argument("--trials", type=Path, help="file of single trials; default: the output's")
    parser.add_argument("--again", action="store_true", help="do known trials anew")
    parser.add_argument("--list", action="store_true", help="list the worlds and stop")
    options = parser.parse_args()
    try:
        worlds = matching(options.worlds)
        first, last = (int(value) for value in options.seeds.split(":"))
    except ValueError as error:
        parser.error(str(error))
    if options.list:
        print("\n".join(world.name for world in worlds))
        return
    store = options.trials or options.output.with_suffix(".trials.jsonl")
    known = {} if options.again else stored(store)
    tasks = [(world.name, seed) for world in worlds for seed in range(first, last)]
    trials = run(tasks, known, store, options.jobs)
    text = document(worlds, trials, " ".join(sys.argv[1:]))
    options.output.write_text(text, encoding="utf-8")
    print(text)
    print(f"written: {options.output}, single trials: {store}")


if __name__ == "__main__":
    main()
