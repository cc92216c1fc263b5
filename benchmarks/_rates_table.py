# SPDX-License-Identifier: Apache-2.0
"""Rates of the diagnosis from single trials, as tables in Markdown."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import binomtest

from benchmarks.worlds import INSTRUMENTS, World

Trial = Mapping[str, Any]

_HEAD = """\
# Rates of the diagnosis

Made by `python benchmarks/diagnosis_rates.py {arguments}` on the worlds of
[worlds.py](../benchmarks/worlds.py), whose truth is that of the simulator: hidden effects act on
the stress in the contact, in forms that the library does not have (`published/`: in forms of the
literature). Truth and model share assumptions, no code: pressure k z^n D^m of the untouched soil, the
vertical balance of the normal stress on a rigid rim, Janosi and Hanamoto's law of shear. A real soil
keeps none of them exactly, so on real wheels expect less. Counts of trials, in brackets the 95 %
interval of the rate in per cent (Wilson).

- right: the verdict is right, and exactly the hidden effects are named where it names any.
- in the set: all hidden effects are among those named or given as candidates.
- cannot tell: `indistinguishable` or `insufficient_data`.
- wrong: a name is given of what is not hidden. soil for instrument: one of those names is an effect
  of the soil, where an instrument is at fault.
- reported / fresh: held-out error that the diagnosis reports for its last model over that model's
  error on fresh runs of the same truth, median over trials; sinkage and resistance.

| world | trials | right | in the set | cannot tell | wrong | soil for instrument | adequate \
| unknown | seconds, median | largest | reported / fresh |
| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |
"""


def rate(count: int, total: int) -> str:
    """A count and the Wilson interval of its rate in per cent; blank without trials."""
    if not total:
        return ""
    interval = binomtest(count, total).proportion_ci(method="wilson")
    return f"{count} [{100 * interval.low:.0f}-{100 * interval.high:.0f}]"


def marks(world: World, trial: Trial) -> dict[str, bool]:
    """What one answer is; every rate of the table counts one of these."""
    names = world.soil | world.instruments
    named, verdict = set(trial["named"]), trial["verdict"]
    listed = named | set(trial["candidates"])
    if verdict == "missing_effect":
        exact = named == names
    elif verdict == "indistinguishable":
        exact = not named and names <= listed
    else:
        exact = not named
    wrong = named - names
    return {
        "right": verdict in world.verdicts and exact,
        "in the set": bool(names) and names <= listed,
        "cannot tell": verdict in ("indistinguishable", "insufficient_data"),
        "wrong": bool(wrong),
        "soil for instrument": bool(world.instruments) and bool(wrong - INSTRUMENTS),
        "adequate": verdict == "adequate",
        "unknown": verdict == "unknown_effect",
    }


def _line(label: str, worlds: Sequence[World], trials: Mapping[str, Sequence[Trial]]) -> str:
    done = [(world, one) for world in worlds for one in trials[world.name] if "verdict" in one]
    failed = sum(len(trials[world.name]) for world in worlds) - len(done)
    found = [(world, marks(world, one)) for world, one in done]
    cells = [label, str(len(done)) + (f" + {failed} failed" if failed else "")]
    # Only where something is hidden can it be in the set, only where an instrument is, be mistaken.
    counted = {
        "in the set": [m for world, m in found if world.soil | world.instruments],
        "soil for instrument": [m for world, m in found if world.instruments],
    }
    names = (
        "right",
        "in the set",
        "cannot tell",
        "wrong",
        "soil for instrument",
        "adequate",
        "unknown",
    )
    for name in names:
        those = counted.get(name, [m for _, m in found])
        cells.append(rate(sum(m[name] for m in those), len(those)))
    seconds = [one["seconds"] for _, one in done]
    cells += [f"{np.median(seconds):.1f}", f"{max(seconds):.1f}"] if seconds else ["", ""]
    ratios = [one["reported_over_fresh"] for _, one in done if "reported_over_fresh" in one]
    middle = []
    for channel in ("sinkage", "resistance"):
        values = [ratio[channel] for ratio in ratios if channel in ratio]
        middle.append(f"{np.median(values):.2f}" if values else "-")
    cells.append(", ".join(middle) if ratios else "")
    return "| " + " | ".join(cells) + " |"


def _densities(worlds: Sequence[World], trials: Mapping[str, Sequence[Trial]]) -> str:
    """How often the same runs get the same answer however densely their rows were taken."""
    families: dict[str, list[World]] = defaultdict(list)
    for world in worlds:
        if world.family:
            families[world.family].append(world)
    lines = []
    for family, members in families.items():
        if len(members) < 2:
            continue
        answers: dict[int, list[tuple[str, tuple[str, ...]]]] = defaultdict(list)
        for world in members:
            for one in trials[world.name]:
                if "verdict" in one:
                    answers[one["seed"]].append((one["verdict"], tuple(sorted(one["named"]))))
        whole = [found for found in answers.values() if len(found) == len(members)]
        same = sum(len(set(found)) == 1 for found in whole)
        lines.append(f"| {family} | {len(members)} | {len(whole)} | {rate(same, len(whole))} |")
    if not lines:
        return ""
    return (
        "\nSame verdict and names at each density of the rows, from the same runs:\n\n"
        "| runs | densities | seeds | same |\n| --- | --- | --- | --- |\n" + "\n".join(lines) + "\n"
    )


def _bad_runs(trials: Sequence[Trial]) -> str:
    """How often runs that were written down wrong are named, and others are."""
    done = [one for one in trials if "bad_runs" in one]
    spoilt = [one for one in done if one["bad"]]
    if not spoilt:
        return ""
    found = sum(bool({*one["bad"]} & {*one["bad_runs"]}) for one in spoilt)
    false = sum(bool({*one["bad_runs"]} - {*one["bad"]}) for one in done)
    return (
        f"\nA run that was written down wrong is named in {rate(found, len(spoilt))} of {len(spoilt)} tables "
        f"with one; a run that was not, in {rate(false, len(done))} of all {len(done)}.\n"
    )


def document(worlds: Sequence[World], trials: Sequence[Trial], arguments: str) -> str:
    """All tables: one line a world, one a group, and the densities."""
    by_world: dict[str, list[Trial]] = defaultdict(list)
    for one in trials:
        by_world[one["world"]].append(one)
    groups: dict[str, list[World]] = defaultdict(list)
    for world in worlds:
        groups[world.name.partition("/")[0]].append(world)
    lines = [_line(world.name, [world], by_world) for world in worlds]
    lines += [_line(f"**all of {name}**", members, by_world) for name, members in groups.items()]
    if len(groups) > 1:
        lines.append(_line("**all**", worlds, by_world))
    text = (
        _HEAD.format(arguments=arguments) + "\n".join(lines) + "\n" + _densities(worlds, by_world)
    )
    text += _bad_runs(trials)
    failed = [one for one in trials if "failed" in one]
    if failed:
        text += "\nFailed:\n\n"
        text += "".join(
            f"- {one['world']}, seed {one['seed']}: {one['failed']}\n" for one in failed
        )
    return text
