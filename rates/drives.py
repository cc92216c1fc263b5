# SPDX-License-Identifier: Apache-2.0
"""Subjects whose trials are drives: soil, traction, priors, field, slip, and what robots taught.

What is scored of a drive is in `drive_trial`; here is what is counted of it, and what that should be.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import partial

from rates.drive_trial import NAMES, SIGMAS, THRESHOLDS, TRUE_THRESHOLD, trial
from rates.drive_worlds import WORLDS
from rates.judges import Judge, Line, Subject, events, middle, ratio, share

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
Limits = tuple[float | None, float | None]


# --- Bands


def band(
    quantity: str, least: float | None = None, each: str = "$^", stated: Limits = (None, None)
) -> list[Judge]:
    """Share in the 95 % band, error (rms), and how much of it is stated."""

    def total(what: str, line: Line) -> float:
        return float(line[what].get(quantity, 0))

    squares, counts, inside, variances = (
        partial(total, what) for what in ("squares", "counts", "inside", "variances")
    )
    return [
        Judge(f"{quantity} in its 95 % band", ratio(inside, counts), least, each=each),
        Judge(f"{quantity}: rms error", ratio(squares, counts, root=True)),
        Judge(f"{quantity}: stated over true error", ratio(variances, squares, root=True), *stated),
    ]


def held(line: Line, quantity: str) -> float:
    """Share of a drive's truths in their band; 1 where there are none."""
    count = line["counts"].get(quantity, 0)
    return float(line["inside"][quantity] / count) if count else 1.0


# --- What is reported of sensors


def said_soon(line: Line) -> bool:
    """Whether the fault was said in time."""
    return line["said"] is not None and line["said"] <= SOON


def checks(subject: str, each: str = "$^") -> list[Judge]:
    """Sensors that are accused, and faults that are said, or do no harm."""

    def expected(line: Line) -> str:
        return WORLDS[subject][line["world"]].said

    def faulty(line: Line) -> int:
        return int(bool(expected(line)))

    def accused(line: Line) -> bool:
        true = expected(line)
        return not all(true and re.search(true, words) for words in line["findings"])

    def soon(line: Line) -> int:
        return faulty(line) and said_soon(line)

    def harmless(line: Line) -> int:
        held_both = all(held(line, name) >= LEAST_HELD for name in ("pull", "margin"))
        return faulty(line) and (said_soon(line) or held_both)

    return [
        Judge("good sensors accused", share(accused), most=0.1, each=each),
        Judge(f"faults reported within {SOON:g} m", share(soon, faulty), 0.75, each=each),
        Judge("reported in time, or harmless", share(harmless, faulty), 0.75, each=each),
    ]


# --- Warnings


def _stuck(line: Line) -> int:
    return int(line["stuck"])


def _length(line: Line) -> float:
    return float(line["length"])


def in_time(detector: str, line: Line) -> bool:
    """Whether it got stuck and was warned of early enough."""
    metres, seconds = line["ahead"][detector] or (0.0, 0.0)
    return line["stuck"] and (metres >= METRES or seconds >= SECONDS)


def _false(detector: str, line: Line) -> int:
    return int(line["false"][detector])


def warnings(least: float | None = None, most: float | None = None) -> list[Judge]:
    """Drives that got stuck and were warned of in time, and warnings that nothing came of, by detector."""
    found = []
    for name in DETECTORS:
        if name != DETECTORS[0]:  # limits are of our first level
            least = most = None
        warned, false = partial(in_time, name), partial(_false, name)
        found += [
            Judge(f"stuck, and in time by {name}", share(warned, _stuck), least),
            Judge(f"false in 500 m by {name}", events(false, _length, 500.0), most=most),
        ]
    return found


# --- Flags of the soil


def _looks(line: Line) -> int:
    return sum(line["looks"].values())


def _wrong(line: Line) -> int:
    return sum(line["wrong"].values())


def _looked_at(line: Line) -> int:
    return int(_looks(line) > 0)


def _any_wrong(line: Line) -> bool:
    return bool(line["wrong"])


def _judged(line: Line) -> int:
    """Of ground that is no power of depth nothing is judged."""
    return int(bool(line.get("error")))


def _determined_at_the_end(line: Line) -> int:
    return _judged(line) and sum(line["determined"].values())


def _wrong_at_the_end(line: Line) -> int:
    return _judged(line) and sum(
        line["determined"][n] and abs(line["error"][n]) > SIGMAS * line["stated"][n] for n in NAMES
    )


def _numbers_at_the_end(line: Line) -> int:
    return _judged(line) * len(NAMES)


def _inside_at_the_end(line: Line) -> int:
    """Numbers of the soil in their 95 % bands, whether flagged as determined or not."""
    return _judged(line) and sum(abs(line["error"][n]) <= 1.96 * line["stated"][n] for n in NAMES)


def _determined(name: str, line: Line) -> int:
    return int(line["determined"][name])


def _square_of_n(line: Line) -> float:
    return float(line["error"]["n"] ** 2) if _judged(line) else 0.0


def _stated_of_n(line: Line) -> float:
    return float(line["stated"]["n"]) if _judged(line) else 0.0


FLAGS = [
    Judge("drives with a wrong flag", share(_any_wrong, _looked_at), most=0.05),
    Judge("flags, each second, that are wrong", ratio(_wrong, _looks), most=0.01),
]
FLAGS_AT_THE_END = [
    Judge("flags wrong at the end", share(_wrong_at_the_end, _determined_at_the_end), most=0.02),
    Judge(
        "pressure, n, m and modulus in their 95 % bands at the end, flagged or not",
        ratio(_inside_at_the_end, _numbers_at_the_end),
        least=0.88,
    ),
    *(Judge(f"{name} determined at the end", share(partial(_determined, name))) for name in NAMES),
    Judge("n: rms error at the end", ratio(_square_of_n, _judged, root=True)),
    Judge("n: deviation stated", ratio(_stated_of_n, _judged)),
]


# --- Borders, and effects that the soil lacks


def _borders(line: Line) -> int:
    return int(any(f.what == "modulus" for f in WORLDS["soil"][line["world"]].features))


def _border_of(least: float, most: float, line: Line) -> int:
    """Whether k changes by a factor in that range, or by one over it."""
    sizes = [f.size[0] for f in WORLDS["soil"][line["world"]].features if f.what == "modulus"]
    return int(bool(sizes) and least <= math.exp(abs(sizes[0])) < most)


def _found_soon_of(least: float, most: float, line: Line) -> int:
    return _found_soon(line) * _border_of(least, most, line)


def _found_soon(line: Line) -> int:
    """Front wheels are 0.35 m ahead, looks a second apart; the border is at 12 m."""
    found = line["found"]
    return int(_borders(line) and found is not None and -0.7 <= found - 12.0 <= 1.0)


def _changes(line: Line) -> int:
    return 0 if _borders(line) else int(line["changes"])


def _plain_way(line: Line) -> float:
    return 0.0 if _borders(line) else _length(line)


def _digs(line: Line) -> int:
    return int(WORLDS["soil"][line["world"]].digging[1] > 0.0)


def _does_not_dig(line: Line) -> int:
    return 1 - _digs(line)


def _named_for_nothing(line: Line) -> bool:
    return bool(line["effect"]) and not _digs(line)


def _digging_named(line: Line) -> bool:
    return _digs(line) and line["effect"].startswith("slip")


def _not_held(line: Line) -> bool:
    return held(line, "sinkage") < LEAST_HELD


# --- The subjects

# Where the model has no part for what goes on, bands may be narrower than the errors.
_MODELLED = "^(?!sinkage gain|hard at|pitch|rebound|rough|zero|slip digs|load)"
SOIL_JUDGES = [
    *FLAGS,
    *FLAGS_AT_THE_END,
    *band("sinkage", 0.9, _MODELLED),
    Judge("drives whose band holds under 0.88 of the sinkages", share(_not_held), most=0.15),
    Judge("borders found within a metre", share(_found_soon, _borders), 0.8),
    *(
        Judge(
            f"borders found within a metre, k by a factor of {words}",
            share(partial(_found_soon_of, *of), partial(_border_of, *of)),
        )
        for words, of in (("1.5", (1.4, 1.6)), ("2", (1.9, 2.1)), ("3", (2.9, 3.1)))
    ),
    Judge("changes in 500 m of one soil", events(_changes, _plain_way, 500.0), most=2.0),
    Judge(
        "effects named where there are none", share(_named_for_nothing, _does_not_dig), most=0.05
    ),
    Judge("slip sinkage named where slip digs", share(_digging_named, _digs)),
    *checks("soil"),
]


def _risk(k: int) -> Judge:
    return Judge(
        f"too steep within a metre, of risks of {k / 5:.1f} to {(k + 1) / 5:.1f}",
        ratio(lambda one: one["risks"][k][2], lambda one: one["risks"][k][0]),
    )


_KINDS = "balance|nothing|pull"
_BRIER = ratio(lambda one: one["brier"][0], lambda one: one["brier"][1])
TRACTION_JUDGES = [
    *band("pull", 0.88, _KINDS),
    *band("margin", 0.88, _KINDS),
    Judge("Brier score of P(pull > 0)", _BRIER, most=0.15),
    *map(_risk, range(5)),
    *warnings(),
]
# Faults as drawn from the priors: no sharper and no wider than what is known, in the mean over many drives.
PRIOR_JUDGES = [
    *band("sinkage", 0.9, stated=(0.85, 1.3)),
    *band("pull", 0.9, stated=(0.85, 1.3)),
    *band("margin", 0.9, stated=(0.85, None)),
    *FLAGS,
]
SLIP_KNOWN = Judge(
    "slip known while moving",
    ratio(lambda one: one["known"][0], lambda one: one["known"][1]),
)
_, _FALSE, *_ = warnings(most=10.0)  # of our first level
FIELD_JUDGES = [
    *(judge for name in ("sinkage", "resistance", "pull", "margin") for judge in band(name, 0.88)),
    *FLAGS,
    _FALSE,
    SLIP_KNOWN,
    *checks("field", "."),
    Judge("metres until it is reported", middle(lambda one: one["said"])),
]
SLIP_JUDGES = [
    *band("slip", 0.88),
    *band("margin", 0.8),
    *band("used grip", 0.85),
    SLIP_KNOWN,
    *checks("slip"),
    *warnings(0.5, 15.0),
]
_SHOWS_SLIP = "^(?!odometry of wheels|filter of wheels)"
ROBOT_JUDGES = [
    *band("slip", 0.85, _SHOWS_SLIP),
    *band("margin", 0.8, "^(?!firm between|.*floor)"),
    *band("used grip", 0.85, _SHOWS_SLIP),
    replace(SLIP_KNOWN, least=0.85, each=_SHOWS_SLIP),
    *checks("robots", "."),
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
