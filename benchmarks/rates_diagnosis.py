# SPDX-License-Identifier: Apache-2.0
"""Subject: diagnosis. Every table of `worlds` is written, read and diagnosed as a user would."""

from __future__ import annotations

import tempfile
import warnings
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.judges import Judge, Line, Rate, Subject, middle, share
from benchmarks.worlds import INSTRUMENTS, WORLDS, World
from smallwheel_ros.diagnosis.diagnose import diagnose
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.measurements.wheels import read_measurements
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.simulate import write_table


def read(table: pd.DataFrame) -> Measurements:
    """A table as a user's file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.csv"
        write_table(table, path)
        return read_measurements(path)


def fresh_errors(model: Model, fresh: Measurements) -> dict[str, float]:
    """Root mean square error (SI) of a model on runs that it never saw, by channel."""
    prediction = predict(model, fresh.conditions)
    return {
        name: float(np.sqrt(np.nanmean((getattr(prediction, name) - measured) ** 2)))
        for name, measured in fresh.channels.items()
    }


def marks(world: World, answer: Mapping[str, Any]) -> dict[str, bool]:
    """What one answer is.

    right: the verdict is right, and exactly the hidden effects are named where it names any. listed: all
    hidden effects are among those named or given as candidates. wrong: a name is given of what is not
    hidden. blamed: that name is an effect of the soil, where an instrument is at fault.
    """
    names, verdict = world.soil | world.instruments, answer["verdict"]
    named = set(answer["missing_effects"])
    listed = named | set(answer["candidates"])
    exact = not named
    if verdict == "missing_effect":
        exact = named == names
    elif verdict == "indistinguishable":
        exact = not named and names <= listed
    wrong = named - names
    return {
        "right": verdict in world.verdicts and exact,
        "listed": bool(names) and names <= listed,
        "wrong": bool(wrong),
        "blamed": bool(world.instruments) and bool(wrong - INSTRUMENTS),
    }


def trial(world: str, seed: int) -> Line:
    """Diagnose one table."""
    known = WORLDS[world]
    table, expected = known(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        diagnosis = diagnose(read(table), seed=0)
        answer = diagnosis.document
        result: Line = marks(known, answer) | {
            "verdict": answer["verdict"],
            "named": answer["missing_effects"],
            "bad": table.attrs.get("bad", []),
            "bad_runs": [one["run"] for one in answer.get("bad_runs", [])],
        }
        steps = answer["steps"]
        few = answer["verdict"] == "insufficient_data"  # a verdict without a model
        if few or not steps or expected.truth_fresh is None:
            return result
        model = diagnosis.fitted(len(steps) - 1).model
        fresh = fresh_errors(model, read(expected.truth_fresh()))
    reported = steps[-1]["held_out_rmse"]
    ratios = {name: reported[name] / fresh[name] for name in fresh if reported.get(name)}
    return result | {"reported_over_fresh": ratios}


def same_answer(lines: Sequence[Line]) -> Rate | None:
    """How often the same runs get the same answer however densely their rows were taken."""
    answers: dict[tuple[str, int], list[tuple[str, ...]]] = defaultdict(list)
    for one in lines:
        if family := WORLDS[one["world"]].family:
            answers[family, one["seed"]].append((one["verdict"], *sorted(one["named"])))
    whole = [found for found in answers.values() if len(found) > 1]
    return share(lambda one: one["same"])([{"same": len(set(found)) == 1} for found in whole])


def _hides(line: Line) -> int:
    world = WORLDS[line["world"]]
    return int(bool(world.soil | world.instruments))


def _instrument(line: Line) -> int:
    return int(bool(WORLDS[line["world"]].instruments))


def _of_group(name: str) -> Judge:
    def inside(line: Line) -> int:
        return int(line["world"].startswith(f"{name}/"))

    return Judge(f"right, of {name}/", share(lambda one: one["right"] and inside(one), inside))


def _names_a_bad_run(line: Line) -> bool:
    return bool({*line["bad"]} & {*line["bad_runs"]})


def _names_a_good_run(line: Line) -> bool:
    return bool({*line["bad_runs"]} - {*line["bad"]})


def _reported(channel: str) -> Judge:
    return Judge(
        f"reported over fresh error: {channel}",
        middle(lambda one: one.get("reported_over_fresh", {}).get(channel)),
    )


GROUPS = tuple(dict.fromkeys(name.partition("/")[0] for name in WORLDS))
JUDGES = [
    Judge("right", share(lambda one: one["right"]), 0.8),
    Judge("all hidden effects are listed", share(lambda one: one["listed"], _hides), 0.8),
    Judge("wrong: named what is not hidden", share(lambda one: one["wrong"]), None, 0.05, "."),
    Judge(
        "the soil blamed for an instrument",
        share(lambda one: one["blamed"], _instrument),
        None,
        0.05,
    ),
    Judge("same answer at each density of rows", same_answer, 0.8),
    Judge("bad runs named", share(_names_a_bad_run, lambda one: int(bool(one["bad"]))), 0.8),
    Judge("tables with a good run named bad", share(_names_a_good_run), None, 0.05),
    _reported("sinkage"),
    _reported("resistance"),
    *map(_of_group, GROUPS),
]
SUBJECTS = [Subject("diagnosis", list(WORLDS), trial, JUDGES, 2, 8.0)]
