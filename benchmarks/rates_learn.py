# SPDX-License-Identifier: Apache-2.0
"""Subject: learn. Laws that no library has, hidden in tables of `learn_worlds`; how often they are found."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.judges import Judge, Line, Subject, middle, share
from benchmarks.learn_worlds import LAWS, OUTSIDE, SIGNED, hidden, table
from benchmarks.rates_diagnosis import read
from smallwheel_ros.learn.law import Law
from smallwheel_ros.learn.learn import learn
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model.model import Model, predict

_PAIRS = (
    "tanh_slip+multipass", "rate+slip_drag", "moisture_optimum+flexible_wheel",
    "speed_threshold+load_slip", "temperature_rate+tanh_slip", "width+slip_sinkage",
)  # fmt: skip
_CONDITIONS: dict[str, dict[str, Any]] = {
    "": {},
    "; 20 runs": {"runs": 20},
    "; 6 % noise": {"noise": 0.06},
    "; sinkage alone": {"channels": ("sinkage",)},
    "; several settings a run": {"within": "settings", "rows": 4},
    "; curves of slip": {"within": "curve", "rows": 12},
}
_OTHER = ("tanh_slip", "nothing")  # worlds that are tried under the other conditions
WORLDS = {
    f"{name}{condition}": (name, how)
    for condition, how in _CONDITIONS.items()
    for name in ((*LAWS, *OUTSIDE, *SIGNED, *_PAIRS) if not condition else _OTHER)
}


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


def _is_of_one(law: Law, world: str, *, stage: bool = False) -> bool:
    """Whether a law follows what one of the world's laws follows, and acts at its stage."""
    return any(
        law.columns in one.drivers and (not stage or law.place.stage[0] in one.stages)
        for one in hidden(world)
    )


def trial(name: str, seed: int) -> Line:
    """One table: what is said of it, and what is true of that."""
    world, how = WORLDS[name]
    laws = hidden(world)
    hides = [one for one in laws if one.drivers]
    learnt = learn(read(table(world, seed, 0, **how)), most=len(laws))
    found: Line = {"hides": len(hides), "drafted": False, "p": learnt.sought[0].p}
    if learnt.verdict != "law":
        return found
    base = learnt.sought[0].problem
    assert base is not None
    best = [s.best for s in learnt.sought if s.best is not None and s.verdict == "law"]
    drafted = [b.law.law for b in best]
    more = {key: value for key, value in how.items() if key in ("noise", "channels")}
    fresh = read(table(world, seed, 1, runs=60, rows=1, **more))
    quiet = read(table(world, seed, 1, runs=60, rows=1, **more | {"noise": 0.0}))
    matched = all(_is_of_one(law, world) for law in drafted) and len(drafted) == len(laws)
    return found | {
        "drafted": True,
        "formula": [b.law.law.formula(b.law.numbers) for b in best],
        "driver": matched,
        "right": matched
        and all(_is_of_one(law, world, stage=True) for law in drafted)
        and len({law.columns for law in drafted}) == len(laws),
        "battery": any("battery" in law.columns for law in drafted),
        "gone": share_gone(base.fit.model, best[-1].law.fit.model, fresh, quiet),
    }


def _hides(line: Line) -> int:
    return int(line["hides"] > 0)


def _drafted(line: Line) -> int:
    return int(line["drafted"] and line["hides"] > 0)


def _drafted_for_nothing(line: Line) -> bool:
    return bool(line["drafted"] and not line["hides"])


JUDGES = [
    Judge("law drafted where one is hidden", share(_drafted, _hides), 0.6),
    Judge(
        "driver right, of those", share(lambda one: _drafted(one) and one["driver"], _drafted), 0.8
    ),
    Judge(
        "driver and stage right", share(lambda one: _drafted(one) and one["right"], _drafted), 0.7
    ),
    Judge(
        "law drafted where nothing is hidden",
        share(_drafted_for_nothing, lambda one: 1 - _hides(one)),
        None,
        0.05,
    ),
    Judge("a dummy column drafted", share(lambda one: one.get("battery", False)), None, 0.05),
    Judge(
        "share of the error taken away",
        middle(lambda one: one.get("gone") if _hides(one) else None),
        0.7,
    ),
]
SUBJECTS = [Subject("learn", list(WORLDS), trial, JUDGES, 1, 30.0)]
