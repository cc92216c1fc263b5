# SPDX-License-Identifier: Apache-2.0
"""Subject: learn. Laws that no library has, hidden in tables of a truth of its own; how often each is found.

The contact of wheel and soil is that of the truth simulator, which shares no code with the model. Its hidden
effects would do no good here: what is asked is at which stage of the model a law acts, so that a law changes
pressure, wheel or outcome as its line below says. Columns that act on nothing (the battery's voltage always,
and whatever the law does not use) are in every table.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from rates.diagnosis import read
from rates.judges import Judge, Line, Subject, middle, share
from smallwheel_ros.api.learn import learn
from smallwheel_ros.learn.law import LearntLaw
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.simulate.truth import Contact, static_sinkage, supported_load

Array = NDArray[np.float64]
Columns = dict[str, Array]

_SCATTER = 0.05  # of ln k from run to run
_ABSOLUTE = {"sinkage": 0.1e-3, "resistance": 0.1}  # noise beside the relative one, m and N
LIMITS = {"load": (20.0, 150.0), "slip": (0.0, 0.6), "moisture": (0.04, 0.18),
          "temperature": (280.0, 315.0), "battery": (11.0, 12.6)}  # fmt: skip


@dataclass(frozen=True)
class Hidden:
    """A law: what it changes, each a function of the columns, and what a right answer is.

    stages: those of the model that say the same; drivers: columns, in one of these sets.
    """

    drivers: tuple[frozenset[str], ...]
    stages: frozenset[str]
    stiffness: Callable[[Columns], Array] | None = None
    deeper: Callable[[Columns], Array] | None = None
    diameter: Callable[[Columns], Array] | None = None
    drag: Callable[[Columns, Array], Array] | None = None
    raised: Callable[[Columns], Array] | None = None  # m, added to the sinkage that is shown
    columns: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # of its own, evenly


def _of(*columns: str) -> tuple[frozenset[str], ...]:
    return (frozenset(columns),)


_K, _Z, _R, _D = (frozenset({s}) for s in "kzRD")
LAWS: dict[str, Hidden] = {
    "nothing": Hidden((), frozenset()),
    "tanh_slip": Hidden(_of("slip"), _Z, deeper=lambda c: 1.0 + 0.5 * np.tanh(4.0 * c["slip"])),
    "moisture_optimum": Hidden(
        _of("moisture"), _K, stiffness=lambda c: 1.0 - 93.8 * (c["moisture"] - 0.1) ** 2
    ),
    "temperature_rate": Hidden(
        _of("temperature", "speed"), _K,
        stiffness=lambda c: (c["speed"] / 0.07) ** (0.25 * (c["temperature"] - 297.0) / 15.0),
    ),
    "speed_threshold": Hidden(
        _of("speed"), _K, stiffness=lambda c: 1.0 + 3.0 * np.maximum(c["speed"] - 0.15, 0.0)
    ),
    "flexible_wheel": Hidden(_of("load"), _D, diameter=lambda c: 1.0 + 0.8 * c["load"] / 100.0),
    "load_slip": Hidden(
        _of("load", "slip"), _Z, deeper=lambda c: 1.0 + 0.9 * c["load"] / 100.0 * c["slip"]
    ),
    "slip_drag": Hidden(
        (frozenset({"slip"}), frozenset({"slip", "load"})), _R,
        drag=lambda c, z: 0.25 * c["slip"] * c["load"],
    ),
    # Families of the library, which the search does not have.
    "slip_sinkage": Hidden(
        _of("slip"), _Z, deeper=lambda c: (1.0 + c["slip"]) / (1.0 - 0.5 * c["slip"])
    ),
    "multipass": Hidden(
        _of("pass_number"), _K, stiffness=lambda c: c["pass_number"] ** 0.45
    ),
    "rate": Hidden(_of("speed"), _K, stiffness=lambda c: (c["speed"] / 0.05) ** 0.15),
    "bulldozing": Hidden(
        (frozenset(), frozenset({"sinkage"}), frozenset({"width"})), _R,
        drag=lambda c, z: 1.2e5 * c["width"] * z**2,
    ),
    "width": Hidden(_of("width"), _K, stiffness=lambda c: (c["width"] / 0.08) ** -0.7),
    "load": Hidden(
        _of("load"), frozenset({"k", "n"}), stiffness=lambda c: (c["load"] / 70.0) ** 0.35
    ),
}  # fmt: skip

_MASS = {"wheel_mass": (2.0, 10.0)}  # kg
_TYRE = {"inflation_pressure": (50e3, 250e3)}  # Pa
_WAIT = {"time_in_box": (0.0, 3600.0)}  # s
# Structures that are not in the grammar, or only nearly: drawn up before any of them was tried.
OUTSIDE: dict[str, Hidden] = {
    "mass_saturating": Hidden(
        _of("wheel_mass"), _Z, columns=_MASS,
        deeper=lambda c: 1.0 + 0.6 * c["wheel_mass"] / (c["wheel_mass"] + 4.0),
    ),
    "tyre_quadratic": Hidden(
        _of("inflation_pressure"), _K, columns=_TYRE,
        stiffness=lambda c: 1.0 + 0.8 * ((c["inflation_pressure"] - 120e3) / 100e3) ** 2,
    ),
    "tyre_flat": Hidden(
        _of("inflation_pressure"), _D, columns=_TYRE,
        diameter=lambda c: 1.0 + 60e3 / c["inflation_pressure"],
    ),
    "settling": Hidden(
        _of("time_in_box"), _K, columns=_WAIT,
        stiffness=lambda c: 2.0 - np.exp(-c["time_in_box"] / 700.0),
    ),
    "settling_threshold": Hidden(
        _of("time_in_box"), _Z, columns=_WAIT,
        deeper=lambda c: np.where(c["time_in_box"] > 1500.0, 1.35, 1.0),
    ),
    "moisture_wave": Hidden(
        _of("moisture"), _Z, deeper=lambda c: 1.0 + 0.3 * np.sin(2.0 * np.pi * c["moisture"] / 0.1)
    ),
    "temperature_drag": Hidden(
        _of("temperature"), _R, drag=lambda c, z: 0.15 * (c["temperature"] - 275.0)
    ),
    "speed_drag": Hidden(
        _of("speed"), _R, drag=lambda c, z: 10.0 * c["speed"] / (c["speed"] + 0.1)
    ),
    "slip_ridge": Hidden(
        _of("slip"), _Z, raised=lambda c: 0.012 * np.minimum(c["slip"], 0.3)
    ),
    "mass_speed": Hidden(
        _of("wheel_mass", "speed"), _Z, columns=_MASS,
        deeper=lambda c: 1.0 + 0.25 * c["wheel_mass"] * c["speed"],
    ),
    "slip_log": Hidden(
        _of("slip"), _K, stiffness=lambda c: 1.0 / (1.0 + 0.5 * np.log1p(c["slip"] / 0.1))
    ),
    "pass_decay": Hidden(
        _of("pass_number"), _K, stiffness=lambda c: 3.0 - 2.0 * np.exp(1.0 - c["pass_number"])
    ),
}  # fmt: skip
# Wheels that drive and brake: slip of either sign.
_SIGNED = {"slip": (-0.7, 0.7)}
SIGNED: dict[str, Hidden] = {
    "drive_and_brake": Hidden(
        _of("slip"), _Z, columns=_SIGNED,
        deeper=lambda c: 1.0 + 0.5 * (1.0 - np.exp(-np.maximum(c["slip"], 0.0) / 0.25))
        + 1.6 * np.maximum(-c["slip"], 0.0) ** 1.6,
    ),
    "braking": Hidden(
        _of("slip"), _Z, columns=_SIGNED,
        deeper=lambda c: 1.0 + 0.9 * np.maximum(-c["slip"], 0.0),
    ),
    "slip_either_way": Hidden(
        _of("slip"), _K, columns=_SIGNED, stiffness=lambda c: 1.0 / (1.0 + 1.5 * c["slip"] ** 2)
    ),
    "signed_nothing": Hidden((), frozenset(), columns=_SIGNED),
}  # fmt: skip
ALL = LAWS | OUTSIDE | SIGNED


def hidden(world: str) -> list[Hidden]:
    """The laws of a world: `rate+slip_drag` has two."""
    return [ALL[name] for name in world.split("+")]


def _factor(laws: Sequence[Hidden], what: str, c: Columns) -> Array:
    """Product of what the laws make of k, of the depth or of the diameter."""
    acting = [function(c) for law in laws if (function := getattr(law, what))]
    return np.asarray(np.prod([np.ones_like(c["load"]), *acting], axis=0))


def _pressure(k: Array, n: float) -> Callable[[Array], Array]:
    """Pressure (Pa) at depths (m), shape (rows, nodes)."""
    return lambda depth: k[:, None] * np.maximum(depth, 0.0) ** n


def respond(
    soil: tuple[float, float, float], laws: Sequence[Hidden], c: Columns, firmness: Array
) -> Columns:
    """Sinkage (m) and resistance (N). soil: k, n, m. firmness: factor on k of each row."""
    k, n, m = soil
    d = c["diameter"] * _factor(laws, "diameter", c)
    pressure = _pressure(k * d**m * firmness * _factor(laws, "stiffness", c), n)
    deepest = 0.499 * d
    z = np.fmin(static_sinkage(pressure, c["load"], d, c["width"]), deepest)
    z = z * _factor(laws, "deeper", c) + sum(law.raised(c) for law in laws if law.raised)
    contact = Contact.at(d, np.minimum(z, deepest))
    back = contact.backward(pressure(contact.depth), c["width"])
    return {"sinkage": z, "resistance": back + sum(law.drag(c, z) for law in laws if law.drag)}


def table(
    world: str,
    seed: int,
    part: int = 0,
    *,
    runs: int = 32,
    rows: int = 3,
    noise: float = 0.03,
    channels: tuple[str, ...] = ("sinkage", "resistance"),
    within: str = "repeats",
) -> pd.DataFrame:
    """A table of a world. part: 0 to learn from, 1 fresh settings. noise 0: the truth itself.

    within: what the rows of a run are: `repeats` of one setting; `settings`, of which each has its own
    load, slip, speed and pass; a `curve`, along which slip rises.
    """
    laws = hidden(world)
    own_columns = {name: limits for law in laws for name, limits in law.columns.items()}
    own = np.random.default_rng([seed, 77])
    n = own.uniform(0.6, 1.1)
    m = own.uniform(-0.3, 0.3)
    diameters = own.choice([0.12, 0.16, 0.20, 0.25, 0.30], 3, replace=False)
    widths = own.choice([0.05, 0.07, 0.09, 0.12], 3, replace=False)
    # A middling wheel sinks by a tenth of its diameter.
    reference = {"load": 70.0, "diameter": float(np.median(diameters)),
                 "width": float(np.median(widths))}  # fmt: skip
    load, d, b = (np.array([value]) for value in reference.values())
    carried = supported_load(_pressure(d**m, n), d, b, own.uniform(0.05, 0.09) * d)
    soil = (float((load / carried)[0]), n, m)
    rng = np.random.default_rng([seed, part, 78])
    kept: list[dict[str, float]] = []
    for _ in range(100 * runs):
        run = {name: rng.uniform(*limits) for name, limits in (LIMITS | own_columns).items()}
        run |= {"speed": float(np.exp(rng.uniform(np.log(0.01), np.log(0.5)))),
                "pass_number": float(rng.integers(1, 6)),
                "diameter": float(rng.choice(diameters)), "width": float(rng.choice(widths))}  # fmt: skip
        c = {name: np.array([value]) for name, value in run.items()}
        z = respond(soil, laws, c, np.ones(1))["sinkage"][0]
        if 1e-3 < z < 0.3 * run["diameter"]:
            kept.append(run)
        if len(kept) == runs:
            break
    c = {name: np.repeat([run[name] for run in kept], rows) for name in kept[0]}
    if within == "settings":
        for name in ("load", "slip"):
            c[name] = rng.uniform(*LIMITS[name], runs * rows)
        c["speed"] = np.exp(rng.uniform(np.log(0.01), np.log(0.5), runs * rows))
        c["pass_number"] = rng.integers(1, 6, runs * rows).astype(float)
    elif within == "curve":
        c["slip"] = np.tile(np.linspace(*LIMITS["slip"], rows), runs)
    quiet = noise == 0.0
    firm = np.exp(rng.normal(0.0, 0.0 if quiet else _SCATTER, runs))
    true = respond(soil, laws, c, np.repeat(firm, rows))
    found: dict[str, object] = {"run": np.repeat([f"r{i + 1:03d}" for i in range(runs)], rows)}
    found |= dict(c)
    for name in channels:
        spread = 0.0 if quiet else np.hypot(noise * true[name], _ABSOLUTE[name])
        found[name] = np.maximum(true[name] + spread * rng.normal(size=runs * rows), 1e-5)
    units = {"load": "N", "diameter": "m", "width": "m", "speed": "m/s", "temperature": "K",
             "battery": "V", "sinkage": "m", "resistance": "N", "wheel_mass": "kg",
             "inflation_pressure": "Pa", "time_in_box": "s"}  # fmt: skip
    return pd.DataFrame(found).rename(columns={k: f"{k} [{u}]" for k, u in units.items()})


# --- The subject

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


def _is_of_one(law: LearntLaw, world: str, *, stage: bool = False) -> bool:
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
