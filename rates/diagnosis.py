# SPDX-License-Identifier: Apache-2.0
"""Subject: diagnosis. Tables whose answer is known, written, read and diagnosed as a user would.

    table = WORLDS["soil/slip_sinkage"].table(seed, 0)

Names are `group/what`; a world that holds the same runs as others at another sampling density says
so in `family`. All truth is from `smallwheel_ros.simulate`; nothing of the model is in it.
"""

from __future__ import annotations

import tempfile
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from rates import _world_labs as labs
from rates import _world_misfits as misfits
from rates._world_labs import rig_table
from rates.judges import Judge, Line, Rate, Subject, middle, share
from smallwheel_ros.api.diagnose import diagnose
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.simulate import write_table

Table = Callable[..., pd.DataFrame]  # (seed, part)
# Verdicts that are right, by what there is to find.
NOTHING, NAMED = frozenset({"adequate"}), frozenset({"missing_effect"})
TIED, TOO_FEW = frozenset({"indistinguishable"}), frozenset({"insufficient_data"})
# Something is wrong that no name covers: to say so and not to notice are both no lie.
OPEN = frozenset({"adequate", "unknown_effect"})
# Something is wrong, and any way to say so is right.
SAID = frozenset({"missing_effect", "indistinguishable", "unknown_effect"})


@dataclass(frozen=True)
class World:
    """A kind of table, and what a right answer is.

    table: of a seed, with headers as a user's: part 0 to diagnose, part 1 fresh runs of the same truth, where
    there are any (`fresh`). soil, instruments: ids of the hidden effects. verdicts: which are right.
    """

    name: str
    table: Table
    soil: frozenset[str] = frozenset()
    instruments: frozenset[str] = frozenset()
    verdicts: frozenset[str] = NOTHING
    fresh: bool = True
    family: str = ""

    @property
    def names(self) -> frozenset[str]:
        """All hidden effects."""
        return self.soil | self.instruments


INSTRUMENTS = frozenset(
    f"{channel}_{fault}"
    for channel in ("sinkage", "load", "resistance")
    for fault in ("gain", "offset")
) | {"rig_friction", "slip_resistance"}
INSTRUMENTS |= {
    f"{c}_drift:{w}" for c in ("sinkage", "resistance") for w in ("time", "index", "trial")
}


def _world(name: str, table: Table, hidden: tuple[str, ...] = (), **more: object) -> World:
    """A world that hides effects by the names that `--hidden` takes, sizes included."""
    ids = {text.partition("=")[0].replace("column:", "covariate:") for text in hidden}
    ids -= {"unrecorded"}
    settings = {"verdicts": NAMED if ids else NOTHING} | more
    return World(
        name,
        table,
        soil=frozenset(ids - INSTRUMENTS),
        instruments=frozenset(ids & INSTRUMENTS),
        **settings,  # type: ignore[arg-type]
    )


_SINGLE = (
    "slip_sinkage",
    "skid_sinkage",
    "bulldozing",
    "penetration_rate",
    "load_dependent_modulus",
    "width_dependent_modulus",
    "multipass",
    "hardpan",
    "sinkage_offset",
    "column:density",
    "moisture",
)
_PAIRS = (
    ("slip_sinkage", "multipass"),
    ("bulldozing", "penetration_rate"),
    ("slip_sinkage", "width_dependent_modulus"),
    ("slip_sinkage", "sinkage_offset"),
    ("load_dependent_modulus", "multipass"),
    ("skid_sinkage", "bulldozing"),
)
_FAULTS = (
    *(f"sinkage_gain={size}" for size in ("0.1", "-0.1")),
    *(f"sinkage_offset={size}" for size in ("0.001", "-0.001", "0.002", "-0.002")),
    *(f"load_gain={size}" for size in ("0.1", "-0.1")),
    *(f"load_offset={size}" for size in ("4", "-4")),
    *(f"resistance_gain={size}" for size in ("0.1", "-0.1")),
    *(f"resistance_offset={size}" for size in ("2", "-2")),
    "rig_friction=0.06",
    "slip_resistance=0.5",
)
_PULL_LAWS = {
    "rim": labs.rim_stress_pull,
    "hump": labs.hump_pull,
    "loss": labs.lossy_pull,
}
_LAB_GRIDS = {
    "2x5": ((40.0, 80.0), (-0.1, 0.0, 0.15, 0.35, 0.6)),
    "3x4": ((30.0, 55.0, 80.0), (0.0, 0.2, 0.4, 0.6)),
}


def _soils() -> Iterator[World]:
    for hidden in ((), *((name,) for name in _SINGLE), *_PAIRS, ("unrecorded",)):
        label = "+".join(hidden) or "nothing"
        more = {"verdicts": OPEN} if hidden == ("unrecorded",) else {}
        yield _world(f"soil/{label}", partial(rig_table, hidden=hidden), hidden, **more)
        if len(hidden) < 2:
            poor = partial(rig_table, hidden=hidden, runs=10, noise=0.09)
            yield _world(f"poor/{label}", poor, hidden, **more)


def _designs() -> Iterator[World]:
    """Data that cannot decide, however much the effect shows."""
    for name in ("slip_sinkage", "load_dependent_modulus"):
        table = partial(rig_table, hidden=(name,), tie=("slip", "load"))
        yield _world(f"tie/slip-load-{name}", table, (name,), verdicts=TIED)
    table = partial(rig_table, hidden=("slip_sinkage",), runs=5)
    yield _world("few/5-runs-slip_sinkage", table, ("slip_sinkage",), verdicts=TOO_FEW)


def _faults() -> Iterator[World]:
    for text in _FAULTS:
        yield _world(f"fault/{text}", partial(rig_table, hidden=(text,)), (text,))


def _curves() -> Iterator[World]:
    for rows in labs.DENSITIES:
        for contact in ("plate", "pressed"):
            table = partial(labs.curves, contact=contact, rows=rows)
            yield _world(f"curve/{contact}-{rows}", table, family=f"curve/{contact}")
        for hidden in ((), ("slip_sinkage",)):
            label = "series/" + ("+".join(hidden) or "nothing")
            table = partial(labs.time_series, hidden=hidden, rows=rows)
            yield _world(f"{label}-{rows}", table, hidden, family=label)


def _labs() -> Iterator[World]:
    for grid, (loads, slips) in _LAB_GRIDS.items():
        for hidden in ((), ("slip_sinkage",), ("load_offset=-4",)):
            table = partial(labs.lab, hidden=hidden, loads=loads, slips=slips)
            yield _world(f"lab/{grid}-{'+'.join(hidden) or 'nothing'}", table, hidden)


def _pulls() -> Iterator[World]:
    for law, pull in _PULL_LAWS.items():
        for channels in (("sinkage", "drawbar_pull"), ("sinkage", "resistance", "drawbar_pull")):
            for hidden in ((), ("slip_sinkage",)):
                table = partial(labs.drawn, hidden=hidden, channels=channels, pull=pull)
                label = "+".join(hidden) or "nothing"
                with_r = "with-R" if "resistance" in channels else "without-R"
                # A pull that follows another law may be said to be unexplained.
                verdicts = NAMED if hidden else OPEN
                yield _world(f"pull/{law}-{with_r}-{label}", table, hidden, verdicts=verdicts)


def _odd() -> Iterator[World]:
    compacts = partial(labs.drawn, purpose=42, drift=0.01)  # 1 % a run
    yield _world("odd/drifting-soil", compacts, verdicts=OPEN, fresh=False)
    yield _world("odd/creeping-zero", labs.creeping_zero, verdicts=OPEN, fresh=False)
    tables: dict[str, Table] = {
        "scatter-18%": partial(labs.drawn, scatter=0.18),
        "heavy-tails": partial(labs.drawn, draw=labs.heavy_tailed),
        "outliers-2%": partial(rig_table, outliers=0.02),
        "uncertain-settings": labs.uncertain_settings,
        "declared-x3": partial(labs.declared, factor=3.0),
        "declared-x0.33": partial(labs.declared, factor=1.0 / 3.0),
        "torque": labs.with_torque,
    }
    for name, table in tables.items():
        for hidden in ((), ("slip_sinkage",)):
            label = "+".join(hidden) or "nothing"
            yield _world(f"odd/{name}-{label}", partial(table, hidden=hidden), hidden)
    for hidden in ((), ("skid_sinkage",)):
        label = "+".join(hidden) or "nothing"
        table = partial(labs.load_falls_in_skid, hidden=hidden)
        yield _world(f"odd/load-falls-{label}", table, hidden)


_GROSS: dict[str, Table] = {
    "one-slip-60%-deeper": misfits.deeper_at_one,
    "one-load-60%-deeper": partial(misfits.deeper_at_one, setting="load"),
    "sinkage-saturates": partial(misfits.saturated, hidden=("slip_sinkage",)),
    "resistance-saturates": partial(
        misfits.saturated, hidden=("slip_sinkage",), column="resistance [N]"
    ),
}


def _misfits() -> Iterator[World]:
    """What no effect of the library explains, and mistakes of one run; labs of any grid."""
    for name, table in _GROSS.items():
        verdicts = frozenset({"unknown_effect"}) if "saturates" in name else SAID
        yield World(f"gross/{name}", table, verdicts=verdicts, fresh=False)
    for hidden in ((), ("slip_sinkage",)):
        label = "+".join(hidden) or "nothing"
        for design in ("drawn", "lab"):
            for fault in misfits.FAULTS:
                table = partial(misfits.bad_run, fault=fault, hidden=hidden, design=design)
                yield _world(f"bad/{fault}-{design}-{label}", table, hidden, fresh=False)
    drifts = {"none": "", "k": "covariate", "zero": "sinkage_drift", "force": "resistance_drift"}
    for what, id in drifts.items():
        for column in ("time [s]", "index", "trial"):
            table = partial(misfits.drifting, what=what, column=column)
            hidden = (f"{id}:{column.partition(' ')[0]}",) if id else ()
            yield _world(f"drift/{what}-{column}", table, hidden, fresh=False)
    for hidden in ((), *((name,) for name in _SINGLE[:9]), *_PAIRS):
        label = "+".join(hidden) or "nothing"
        yield _world(f"any-lab/{label}", partial(misfits.any_lab, hidden=hidden), hidden)


WORLDS: dict[str, World] = {
    world.name: world
    for group in (_soils, _designs, _faults, _curves, _labs, _pulls, _odd, _misfits)
    for world in group()
}


# --- Trials and what is judged


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
    names, verdict = world.names, answer["verdict"]
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
    table = known.table(seed, 0)
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
        if few or not steps or not known.fresh:
            return result
        model = diagnosis.fitted(len(steps) - 1).model
        fresh = fresh_errors(model, read(known.table(seed, 1)))
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
    return int(bool(WORLDS[line["world"]].names))


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
