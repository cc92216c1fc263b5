# SPDX-License-Identifier: Apache-2.0
"""Subjects whose trials are drives: soil, traction, priors, field, slip, and what robots taught.

What is scored of a drive is in `drive_trial`; here is what is counted of it, and what that should be.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from benchmarks.drive_trial import NAMES, SIGMAS, THRESHOLDS, TRUE_THRESHOLD, WORLDS, trial
from benchmarks.judges import Judge, Line, Subject, events, middle, ratio, share

# m, within which a fault has to be reported: rules that need ten pieces of 0.5 m look every 0.8 m
SOON = 6.0
METRES, SECONDS = 0.5, 3.0  # ahead of being stuck that is in time
LEAST_HELD = 0.88  # of a drive's truths in a 95 % band
DETECTORS = (
    "first level",
    "second level",
    *(f"slip over {t}" for t in THRESHOLDS),
    f"true slip over {TRUE_THRESHOLD}",
)


def _sum(line: Line, what: str, quantity: str) -> float:
    return float(line[what].get(quantity, 0))


def band(quantity: str, least: float | None = None, each: str = "$^") -> list[Judge]:
    """Share in the 95 % band, error (rms), and how much of it is stated."""
    over = partial(_sum, quantity=quantity)
    squares, counts, inside, stated = (
        lambda one, what=what: over(one, what)
        for what in ("squares", "counts", "inside", "variances")
    )
    return [
        Judge(f"{quantity} in its 95 % band", ratio(inside, counts), least, None, each),
        Judge(f"{quantity}: rms error", ratio(squares, counts, root=True)),
        Judge(f"{quantity}: stated over true error", ratio(stated, squares, root=True)),
    ]


def sharp(quantity: str, least: float | None, most: float | None) -> list[Judge]:
    """As `band`, with limits on how much of the error is stated."""
    inside, error, stated = band(quantity, 0.9)
    return [inside, error, replace(stated, least=least, most=most)]


def held(line: Line, quantity: str) -> float:
    """Share of a drive's truths in their band; 1 where there are none."""
    count = line["counts"].get(quantity, 0)
    return float(line["inside"][quantity] / count) if count else 1.0


def accusations(world: Callable[[Line], str], line: Line) -> int:
    """What is reported about sensors that is not true."""
    said = world(line)
    return sum(not (said and re.search(said, words)) for words in line["findings"])


def in_time(line: Line, detector: str) -> bool:
    """Whether it was warned of early enough."""
    metres, seconds = line["ahead"][detector] or (0.0, 0.0)
    return metres >= METRES or seconds >= SECONDS


def said_soon(line: Line) -> bool:
    """Whether the fault was said in time."""
    return line["said"] is not None and line["said"] <= SOON


def good(line: Line) -> bool:
    """Whether a fault was said in time, or did no harm."""
    return said_soon(line) or all(held(line, name) >= LEAST_HELD for name in ("pull", "margin"))


def checks(subject: str, most: float | None, each: str = "$^") -> list[Judge]:
    """Sensors that are accused, and faults that are said."""

    def expected(line: Line) -> str:
        return WORLDS[subject][line["world"]].said

    def has_fault(line: Line) -> int:
        return int(bool(expected(line)))

    return [
        Judge(
            "good sensors accused",
            share(lambda one: accusations(expected, one) > 0),
            None,
            most,
            each,
        ),
        Judge(
            f"faults reported within {SOON:g} m",
            share(lambda one: has_fault(one) and said_soon(one), has_fault),
            0.75,
            None,
            each,
        ),
        Judge(
            "reported in time, or harmless",
            share(lambda one: has_fault(one) and good(one), has_fault),
            0.75,
            None,
            each,
        ),
    ]


def warnings(least: float | None = None, most: float | None = None) -> list[Judge]:
    """Drives that got stuck and were warned of in time, and warnings that nothing came of, by detector."""
    found = []
    for name in DETECTORS:
        ours = name == "first level"
        found += [
            Judge(
                f"stuck, and in time by {name}",
                share(
                    lambda one, n=name: one["stuck"] and in_time(one, n),
                    lambda one: int(one["stuck"]),
                ),
                least if ours else None,
            ),
            Judge(
                f"false in 500 m by {name}",
                events(lambda one, n=name: one["false"][n], lambda one: one["length"], 500.0),
                None,
                most if ours else None,
            ),
        ]
    return found


def _looks(line: Line) -> int:
    return sum(line["looks"].values())


def _wrong(line: Line) -> int:
    return sum(line["wrong"].values())


def _wrong_at_the_end(line: Line) -> int:
    if "error" not in line:  # of ground that is no power of depth nothing is judged
        return 0
    return sum(
        line["determined"][n] and abs(line["error"][n]) > SIGMAS * line["stated"][n] for n in NAMES
    )


def _determined_at_the_end(line: Line) -> int:
    return sum(line["determined"].values()) if "error" in line else 0


def _n(line: Line, what: str) -> float:
    return float(line[what]["n"]) if what in line else 0.0


def _judged(line: Line) -> int:
    return int("error" in line)


SLIP_KNOWN = Judge(
    "slip known while moving",
    ratio(lambda one: one["known"][0], lambda one: one["known"][1]),
)
FLAGS = [
    Judge(
        "drives with a wrong flag",
        share(lambda one: bool(one["wrong"]), lambda one: int(_looks(one) > 0)),
        None,
        0.05,
    ),
    Judge("flags, each second, that are wrong", ratio(_wrong, _looks), None, 0.01),
]
FLAGS_AT_THE_END = [
    Judge(
        "flags wrong at the end",
        share(_wrong_at_the_end, _determined_at_the_end),
        None,
        0.02,
    ),
    *(
        Judge(f"{name} determined at the end", share(lambda one, n=name: int(one["determined"][n])))
        for name in NAMES
    ),
    Judge("n: rms error at the end", ratio(lambda one: _n(one, "error") ** 2, _judged, root=True)),
    Judge("n: deviation stated", ratio(lambda one: _n(one, "stated"), _judged)),
]


def _borders(line: Line) -> int:
    return int(any(f.what == "modulus" for f in WORLDS["soil"][line["world"]].features))


def _found_soon(line: Line) -> int:
    """Front wheels are 0.35 m ahead, looks a second apart; the border is at 12 m."""
    found = line["found"]
    return int(_borders(line) and found is not None and -0.7 <= found - 12.0 <= 1.0)


def _digs(line: Line) -> int:
    return int(WORLDS["soil"][line["world"]].digging[1] > 0.0)


def _changes(line: Line) -> int:
    return 0 if _borders(line) else int(line["changes"])


def _plain_way(line: Line) -> float:
    return 0.0 if _borders(line) else float(line["length"])


# Where the model has no part for what goes on, bands may be narrower than the errors.
_MODELLED = "^(?!sinkage gain|hard at|pitch|rebound|rough|zero|slip digs|load)"
SOIL_JUDGES = [
    *FLAGS,
    *FLAGS_AT_THE_END,
    *band("sinkage", 0.9, _MODELLED),
    Judge(
        "drives whose band holds under 0.88 of the sinkages",
        share(lambda one: held(one, "sinkage") < LEAST_HELD),
        None,
        0.15,
    ),
    Judge("borders found within a metre", share(_found_soon, _borders), 0.8),
    Judge("changes in 500 m of one soil", events(_changes, _plain_way, 500.0), None, 2.0),
    Judge(
        "effects named where there are none",
        share(lambda one: bool(one["effect"]) and not _digs(one), lambda one: 1 - _digs(one)),
        None,
        0.05,
    ),
    Judge(
        "slip sinkage named where slip digs",
        share(lambda one: _digs(one) and one["effect"].startswith("slip"), _digs),
    ),
    *checks("soil", 0.1),
]


def _risk(k: int) -> Judge:
    return Judge(
        f"too steep within a metre, of risks of {k / 5:.1f} to {(k + 1) / 5:.1f}",
        ratio(lambda one: one["risks"][k][2], lambda one: one["risks"][k][0]),
    )


_KINDS = "balance|nothing|pull"
TRACTION_JUDGES = [
    *band("pull", 0.88, _KINDS),
    *band("margin", 0.88, _KINDS),
    Judge(
        "Brier score of P(pull > 0)",
        ratio(lambda one: one["brier"][0], lambda one: one["brier"][1]),
        None,
        0.15,
    ),
    *map(_risk, range(5)),
    *warnings(),
]
# Faults as drawn from the priors: no sharper and no wider than what is known, in the mean over many drives.
PRIOR_JUDGES = [
    *sharp("sinkage", 0.85, 1.3),
    *sharp("pull", 0.85, 1.3),
    *sharp("margin", 0.85, None),
    *FLAGS,
]
FIELD_JUDGES = [
    *(judge for name in ("sinkage", "resistance", "pull", "margin") for judge in band(name, 0.88)),
    *FLAGS,
    *(judge for judge in warnings(most=10.0) if judge.what == "false in 500 m by first level"),
    SLIP_KNOWN,
    *checks("field", 0.1, "."),
    Judge("metres until it is reported", middle(lambda one: one["said"])),
]
SLIP_JUDGES = [
    *band("slip", 0.88),
    *band("margin", 0.8),
    *band("used grip", 0.85),
    SLIP_KNOWN,
    *checks("slip", 0.1),
    *warnings(0.5, 15.0),
]
_SHOWS_SLIP = "^(?!odometry of wheels|filter of wheels)"
ROBOT_JUDGES = [
    *band("slip", 0.85, _SHOWS_SLIP),
    *band("margin", 0.8, "^(?!firm between|.*floor)"),
    *band("used grip", 0.85, _SHOWS_SLIP),
    Judge(SLIP_KNOWN.what, SLIP_KNOWN.count, 0.85, None, _SHOWS_SLIP),
    *checks("robots", 0.1, "."),
    *warnings(0.5, 15.0),
]
_SUBJECTS = {
    "soil": (SOIL_JUDGES, 3, 8.0),
    "traction": (TRACTION_JUDGES, 3, 7.0),
    "priors": (PRIOR_JUDGES, 8, 8.0),
    "field": (FIELD_JUDGES, 3, 8.0),
    "slip": (SLIP_JUDGES, 3, 5.0),
    "robots": (ROBOT_JUDGES, 3, 5.0),
}


def _tried(subject: str, world: str, seed: int) -> Line:
    return trial(WORLDS[subject][world], seed)


SUBJECTS = [
    Subject(name, list(WORLDS[name]), partial(_tried, name), judges, seeds, seconds)
    for name, (judges, seeds, seconds) in _SUBJECTS.items()
]
