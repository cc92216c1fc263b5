# SPDX-License-Identifier: Apache-2.0
"""Subject: tables. Names and numbers of `diagnose` on tables of a rig that another author simulates.

    table = make("slip sinkage", seed)      # of `bench_truth`: nothing of the package is in it

Each world hides one thing, or nothing. Of the model that a diagnosis writes, at settings that were held back
and at 1.0 to 1.3 times the largest load: does the truth lie in the law's 95 % band, and a fresh row in that
of one run?
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

import smallwheel_ros as sw
from rates.bench_truth import BenchSoil, BenchWheel, Rolled, rolled
from rates.judges import Judge, Line, Rate, Subject, middle, ratio, share

_WITHIN = 1.96
_HEADERS = {
    "load": ("load [N]", 1.0), "diameter": ("diameter [mm]", 1e3), "width": ("width [mm]", 1e3),
    "slip": ("slip [%]", 100.0), "pass_number": ("pass_number", 1.0), "speed": ("speed [mm/s]", 1e3),
    "grouser_height": ("grouser_height [mm]", 1e3), "moisture": ("moisture [%]", 1.0),
    "time": ("time [min]", 1.0), "sinkage": ("sinkage [mm]", 1e3), "resistance": ("resistance [N]", 1.0),
    "drawbar_pull": ("drawbar_pull [N]", 1.0), "torque": ("torque [N m]", 1.0),
}  # fmt: skip
_WIDTHS = {0.15: 0.06, 0.20: 0.10, 0.28: 0.12, 0.24: 0.10}
_LOADS = (20.0, 130.0)
Setting = dict[str, float]
Draw = Callable[[np.random.Generator, int], float]
SOIL = BenchSoil()


@dataclass(frozen=True)
class Noise:
    """Standard deviations: of ln k of a run, of each channel of a run, of a row; relative, m and N."""

    soil: float = 0.05
    run: float = 0.02
    row: float = 0.02
    sinkage: float = 1.5e-4
    force: float = 0.2


@dataclass(frozen=True)
class BenchWorld:
    """A kind of table. right: effects of which naming or listing one is right; empty: nothing is missing.

    at: what is there at a setting, in a soil so many times as firm. shown: what the load cell shows.
    """

    at: Callable[[Setting, float], Rolled]
    right: frozenset[str] = frozenset()
    open: bool = False  # no law of the library is right: a name is wrong, anything else is fair
    runs: int = 20
    rows: int = 2
    channels: tuple[str, ...] = ("sinkage", "resistance")
    slips: tuple[float, float] | None = None
    widths: tuple[float, ...] = ()
    more: Mapping[str, Draw] = field(default_factory=dict)
    noise: Noise = Noise()
    shown: Callable[[float], float] = lambda load: load
    tied: bool = False  # slip to load


def wheel(at: Setting, **other: float) -> BenchWheel:
    """The wheel of a setting. other: in its place."""
    sizes = {name: at[name] for name in ("load", "diameter", "width")}
    return BenchWheel(**sizes | other, slip=at.get("slip", 0.0))


def plain(soil: BenchSoil = SOIL) -> Callable[[Setting, float], Rolled]:
    return lambda at, firmer: rolled(soil, wheel(at), firmer)


def firmed(factor: Callable[[Setting], float]) -> Callable[[Setting, float], Rolled]:
    return lambda at, firmer: rolled(SOIL, wheel(at), firmer * factor(at))


def digging(dug: Callable[[Setting, float], float]) -> Callable[[Setting, float], Rolled]:
    return lambda at, firmer: rolled(SOIL, wheel(at), firmer, dug=lambda z: dug(at, z))


def adding(
    resistance: Callable[[Setting, Rolled], float] = lambda at, there: 0.0,
    sinkage: Callable[[Setting], float] = lambda at: 0.0,
) -> Callable[[Setting, float], Rolled]:
    def at_setting(at: Setting, firmer: float) -> Rolled:
        there = rolled(SOIL, wheel(at), firmer)
        return replace(
            there,
            resistance=there.resistance + resistance(at, there),
            sinkage=there.sinkage + sinkage(at),
        )

    return at_setting


def _bulldozed(at: Setting, there: Rolled) -> float:
    z, passive = there.sinkage, SOIL.passive
    earth = 0.5 * SOIL.unit_weight * z**2 * passive + 2.0 * SOIL.cohesion * z * np.sqrt(passive)
    return float(1.6 * at["width"] * earth)


def _speed(rng: np.random.Generator, _i: int) -> float:
    return float(np.exp(rng.uniform(np.log(0.01), np.log(0.4))))


_PULLED = ("sinkage", "drawbar_pull", "torque")
_WONG = replace(SOIL, lift=True, peak=(0.25, 0.15), rear=0.1)


def _hyperbolic(at: Setting, z: float) -> float:
    return z * (1.0 + 1.1 * at["slip"] / (1.0 - 0.55 * at["slip"]))


WORLDS: dict[str, BenchWorld] = {
    "slip sinkage": BenchWorld(digging(_hyperbolic), frozenset({"slip_sinkage"}), runs=15, rows=3,
                               channels=_PULLED, slips=(0.0, 0.5)),
    "load cell 9 N off": BenchWorld(plain(), frozenset({"load_offset"}), shown=lambda load: load + 9.0),
    "hardpan": BenchWorld(
        lambda at, firmer: rolled(
            replace(SOIL, k=1.2e6), wheel(at), firmer,
            layer=lambda p, z: p * (1.0 + np.maximum(z - 0.010, 0.0) / 0.006)),
        frozenset({"hardpan"}), runs=18),
    "passes": BenchWorld(digging(lambda at, z: z * (1.0 + 0.30 * np.log(at["pass_number"]))),
                         frozenset({"multipass"}), runs=24, channels=("sinkage",),
                         more={"pass_number": lambda _, i: float(1 + i % 4)}),
    "bulldozing": BenchWorld(adding(_bulldozed), frozenset({"bulldozing"}), widths=(0.06, 0.10, 0.15)),
    "lugs": BenchWorld(digging(lambda at, z: z + 0.9 * at["grouser_height"] * at["slip"] ** 0.7),
                       frozenset({"grouser"}), runs=24, channels=("sinkage", "drawbar_pull"),
                       slips=(0.0, 0.5), more={"grouser_height": lambda _, i: (0.0, 0.006, 0.012)[i % 3]}),
    "speed": BenchWorld(firmed(lambda at: 1.0 + 0.20 * np.log10(at["speed"] / 0.05)),
                        frozenset({"penetration_rate"}), runs=22, more={"speed": _speed}),
    "a wheel measured wrong": BenchWorld(
        lambda at, firmer: rolled(
            SOIL, wheel(at, diameter=0.16 if at["diameter"] == 0.20 else at["diameter"]), firmer),
        open=True, runs=24),
    "nothing": BenchWorld(plain(), runs=18, rows=3, channels=_PULLED, slips=(0.0, 0.5)),
    "nothing, noisy": BenchWorld(plain(), runs=50, channels=("sinkage",), slips=(0.0, 0.4),
                                 noise=Noise(0.10, 0.03, 0.04)),
    "nothing, few rows": BenchWorld(plain(), rows=1),
    "zero of 2.8 mm": BenchWorld(adding(sinkage=lambda _: 0.0028), frozenset({"sinkage_offset"})),
    "moisture, optimal at 8 %": BenchWorld(
        firmed(lambda at: 1.0 + 0.8 * np.exp(-(((at["moisture"] - 8.0) / 3.0) ** 2))),
        frozenset({"moisture"}), runs=30, rows=1,
        more={"moisture": lambda rng, _: float(rng.uniform(2.0, 14.0))}),
    "flexible wheel": BenchWorld(
        lambda at, firmer: rolled(
            SOIL, wheel(at, diameter=at["diameter"] * (1.0 + 0.0045 * at["load"])), firmer),
        frozenset({"load_dependent_modulus"}), open=True, runs=24),
    "friction of the rig": BenchWorld(adding(lambda at, _: 0.07 * at["load"]), frozenset({"rig_friction"})),
    "nothing, stresses peak ahead": BenchWorld(plain(_WONG), runs=18, rows=3, channels=_PULLED,
                                               slips=(0.0, 0.5)),
    "Bekker's soil": BenchWorld(plain(BenchSoil(bekker=(9e4, 6e5))), frozenset({"width_dependent_modulus"}),
                                runs=24, widths=(0.05, 0.10, 0.16)),
    "two soils mixed": BenchWorld(firmed(lambda at: at.get("batch", 1.0)), open=True, runs=24,
                                  more={"batch": lambda rng, _: 1.0 if rng.random() < 0.5 else 0.5}),
    "zero that drifts": BenchWorld(adding(sinkage=lambda at: 1.2e-4 * at["time"] / 7.0),
                                   frozenset({"sinkage_drift:time"}), runs=26,
                                   more={"time": lambda _, i: 7.0 * (i + 1)}),
    "slip tied to load": BenchWorld(digging(_hyperbolic), frozenset({"slip_sinkage"}), runs=18,
                                    channels=("sinkage",), slips=(0.0, 0.5), tied=True),
    "slip sinkage, weak and noisy": BenchWorld(
        digging(lambda at, z: z * (1.0 + 1.2 * at["slip"])), frozenset({"slip_sinkage"}), rows=1,
        channels=("sinkage", "drawbar_pull"), slips=(0.0, 0.5), noise=Noise(0.08, row=0.05)),
    "slip sinkage and skid": BenchWorld(
        digging(lambda at, z: z + 0.10 * at["diameter"] * max(at["slip"], 0.0) ** 2
                / (max(at["slip"], 0.0) ** 2 + 0.09)),
        frozenset({"slip_sinkage"}), runs=24, channels=("sinkage", "drawbar_pull"), slips=(-0.3, 0.6)),
}  # fmt: skip


def _settings(
    world: BenchWorld, rng: np.random.Generator, count: int, loads: tuple[float, float] = _LOADS,
    sizes: Sequence[float] = (0.15, 0.20, 0.28), ordered: bool = False,
) -> list[Setting]:  # fmt: skip
    """Settings as a student would choose them: sizes in turn, loads at random with both ends."""
    found = []
    for i in range(count):
        size = sizes[i % len(sizes)]
        width = (
            world.widths[(i // len(sizes) + i) % len(world.widths)]
            if world.widths
            else _WIDTHS[size]
        )
        load = loads[i] if i < 2 else float(rng.uniform(*loads))
        one = {"load": load, "diameter": size, "width": width}
        if world.slips is not None:
            one["slip"] = float(rng.uniform(*world.slips))
        found.append(one)
    if not ordered:
        found = [found[i] for i in rng.permutation(count)]
    for i, one in enumerate(found):
        one.update({name: draw(rng, i) for name, draw in world.more.items()})
    return found


def _rows(
    world: BenchWorld, settings: Sequence[Setting], rng: np.random.Generator, rows: int
) -> pd.DataFrame:
    """What the rig shows."""
    noise, made = world.noise, []
    for run, at in enumerate(settings):
        there = world.at(at, float(np.exp(rng.normal(0.0, noise.soil))))
        own = {name: 1.0 + rng.normal(0.0, noise.run) for name in world.channels}
        for _ in range(rows):
            row: dict[str, Any] = {"run": f"R{run + 1}", **at}
            row["load"] = world.shown(at["load"]) * (1.0 + rng.normal(0.0, 0.004))
            for name in world.channels:
                arm = at["diameter"] / 2 if name == "torque" else 1.0
                least = noise.sinkage if name == "sinkage" else noise.force * arm
                value = getattr(there, name) * own[name] * (1.0 + rng.normal(0.0, noise.row))
                row[name] = value + rng.normal(0.0, least)
            made.append(row)
    return pd.DataFrame(made)


def headed(frame: pd.DataFrame) -> pd.DataFrame:
    """With headers and units as a table has them; what nobody recorded is not there."""
    found = {"run": frame["run"]} if "run" in frame else {}
    found |= {head: frame[n] * factor for n, (head, factor) in _HEADERS.items() if n in frame}
    return pd.DataFrame(found)


def make(name: str, seed: int) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """A table, settings that were held back with the truth there, and a fresh row at each."""
    world = WORLDS[name]
    rng = np.random.default_rng([seed, sorted(WORLDS).index(name), 68])
    settings = _settings(world, rng, world.runs)
    later = _settings(world, rng, 22)
    later += _settings(world, rng, 6, (_LOADS[1], 1.3 * _LOADS[1]), (0.24,))
    for one in later:
        one.pop("batch", None)
        one |= {"time": 7.0} if "time" in one else {}
    if world.tied:
        for one in settings:
            one["slip"] = 0.05 + 0.45 * (one["load"] - 20.0) / 110.0 + float(rng.normal(0.0, 0.004))
    truth = pd.DataFrame(
        [{**at, **vars(world.at(at, 1.0)), "load": world.shown(at["load"])} for at in later]
    )
    fresh = _rows(world, later, rng, 1)
    return headed(_rows(world, settings, rng, world.rows)), truth, fresh


def trial(name: str, seed: int) -> Line:
    """One table: what was named, and how the numbers of the written model hold."""
    world = WORLDS[name]
    table, truth, fresh = make(name, seed)
    found = sw.diagnose(table)
    asked = headed(truth.drop(columns=["sinkage", "resistance", "drawbar_pull", "torque"]))
    rows = sw.predict(found.model, data=asked).to_frame()
    bands: dict[str, Any] = {}
    for channel in world.channels:
        said, law, run = (rows[f"{channel}{end}"] for end in ("", "_std", "_run_std"))
        off = said - truth[channel]
        bands[channel] = {
            "rows": int(off.notna().sum()),
            "law": int((off.abs() <= _WITHIN * law).sum()),
            "run": int(((said - fresh[channel]).abs() <= _WITHIN * run).sum()),
            "std": float(law.median()),
            "rmse": float(np.sqrt((off**2).mean())),
        }
    return {"verdict": found.verdict, "named": found.missing_effects, "listed": found.candidates,
            "bands": bands}  # fmt: skip


# --- Judges


def _of(line: Line) -> BenchWorld:
    return WORLDS[line["world"]]


def _wrong(line: Line) -> int:
    return int(bool(set(line["named"]) - _of(line).right))


def _right(line: Line) -> int:
    """The name, or that there is none; of what no law has, anything but a name."""
    world = _of(line)
    if world.open or world.tied:
        return int(not _wrong(line))
    nothing = bool(world.right) or line["verdict"] == "adequate"
    return int(set(line["named"]) == world.right and nothing)


_DECIDED, _UNDECIDED = ("missing_effect", "adequate"), ("indistinguishable", "unknown_effect")


def _held(
    channel: str, band: str, verdicts: Sequence[str]
) -> Callable[[Sequence[Line]], Rate | None]:
    """Share of rows within a band, over tables of these verdicts that nothing ties."""

    def part(key: str) -> Callable[[Line], float]:
        def of_line(line: Line) -> float:
            fits = line["verdict"] in verdicts and not _of(line).tied
            return float(line["bands"][channel][key]) if fits and channel in line["bands"] else 0.0

        return of_line

    return ratio(part(band), part("rows"))


def _median(channel: str) -> Callable[[Sequence[Line]], Rate | None]:
    return middle(lambda line: line["bands"].get(channel, {}).get("std")
                  if line["verdict"] in _DECIDED else None)  # fmt: skip


_MOST = {"sinkage": 0.98, "resistance": 0.98, "drawbar_pull": 0.995, "torque": 0.995}
JUDGES = [
    Judge("right", share(_right), least=0.85),
    Judge("wrong names", share(_wrong), most=0.02),
    *(
        Judge(f"{name.replace('_', ' ')}, decided: {words}", _held(name, band, _DECIDED), 0.93, most)
        for name, of_run in _MOST.items()
        for band, words, most in (("run", "fresh rows in the band of one run", of_run),
                                  ("law", "truths in the law's band", 0.99))
    ),
    *(
        Judge(f"{name}, undecided: {words}", _held(name, band, _UNDECIDED), 0.93, 0.995)
        for name in ("sinkage", "resistance")
        for band, words in (("run", "fresh rows in the band of one run"), ("law", "truths in the law's band"))
    ),
    Judge("deviation of pull, N, median", _median("drawbar_pull"), most=0.8),
]  # fmt: skip
SUBJECTS = [Subject("tables", tuple(WORLDS), trial, JUDGES, 2, 4.0)]
