# SPDX-License-Identifier: Apache-2.0
"""Effects to set and unset on the page of a diagnosis: every choice was fitted beforehand.

The page has the base model, the steps to the verdict, and the named effects together with each rival and each
effect that comes closest. With `every`, it also has each effect alone and each together with the named ones:
every model that is one click away from the base or from the verdict.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

from smallwheel_ros.diagnosis.apply import Grown
from smallwheel_ros.diagnosis.competitors import Competitor
from smallwheel_ros.diagnosis.document import failing_settings
from smallwheel_ros.diagnosis.pipeline import Diagnosis
from smallwheel_ros.effects.base import EffectError
from smallwheel_ros.fitting import FitResult
from smallwheel_ros.fitting.fit import FAILURES
from smallwheel_ros.fitting.held_out import CvErrors, Score, compare_cv
from smallwheel_ros.measurements.display import listed, sentence, shown_value, words
from smallwheel_ros.views.blocks import (
    Block,
    Callout,
    Choice,
    Column,
    Details,
    Models,
    Table,
    Text,
    of_channel,
    share_of,
)
from smallwheel_ros.views.leftovers import leftovers, settings_of
from smallwheel_ros.views.notes import grouped
from smallwheel_ros.views.parameters import parameter_rows, parameter_table

Names = tuple[str, ...]
Told = Callable[[int, int], object]
_GROUPS = {"soil": "Effects", "instrument": "Errors of the instrument"}


@dataclass(frozen=True)
class View:
    """A model with some effects, fitted to all runs, and its held-out errors.

    Attributes
    ----------
    names
        Ids of its effects, in the order in which they were added; empty for the base model.
    fit
        The fit to all runs.
    errors
        Held-out errors of the rows.
    """

    names: Names
    fit: FitResult
    errors: CvErrors


def models_block(
    found: Diagnosis, every: bool = False, progress: Told = lambda done, needed: None
) -> Models | None:
    """Make the block in which a reader of the page sets and unsets effects, and fit the models for it.

    Parameters
    ----------
    found
        The diagnosis.
    every
        Whether to fit each effect alone and together with the named ones, not only the verdict's rivals.
    progress
        Called with the number of fits done and their total.

    Returns
    -------
    Models or None
        None where nothing could be held out.
    """
    if found.search is None or not found.steps:
        return None
    field, document = found.search.field, found.document
    ids = [name for name, kind in field.kinds.items() if kind != "unknown"]
    forms = {
        n: [c for c in field.competitors if c.family == n] for n in ids if n not in field.blocked
    }
    place = {name: i for i, name in enumerate(ids)}
    views = _views(found, forms, every, progress)
    by_key = {_key(view.names, place): view for view in views}
    chances = {row["effect"]: row.get("probability") for row in document["ranking"]}
    fitted = {name for view in views for name in view.names}
    choices = [
        Choice(str(place[name]), words(name), _GROUPS[field.kinds[name]], chances.get(name))
        for name in sorted(fitted, key=lambda name: -(chances.get(name) or 0.0))
    ]
    floors = {name: c["noise_floor"] for name, c in document["channels"].items()}
    base, data = by_key[""], found.measurements
    failing = [s for _, s in failing_settings(document, settings_of(data))]
    return Models(
        choices,
        True,
        {key: _said(view, base, found, floors) for key, view in by_key.items()},
        leftovers(data, {key: view.errors for key, view in by_key.items()}, "", "base model", floors,
                  next(iter(failing), None)),
        "This combination was not fitted. `smallwheel report` fits each effect alone and together with the "
        "verdict, `smallwheel fit --effects A,B` any combination.",
    )  # fmt: skip


def _views(
    found: Diagnosis, forms: Mapping[str, list[Competitor]], every: bool, progress: Told
) -> list[View]:
    """The base, the steps to the verdict, its rivals and, with `every`, all models one effect away."""
    steps: dict[Names, int] = {}
    names: Names = ()
    for i, step in enumerate(found.steps):
        names += () if step.added is None else (step.added,)
        steps.setdefault(names, i)
    views = [View(n, found.fitted(i), found.steps[i].errors) for n, i in steps.items()]
    likely = [*found.candidates, *found.document["closest"]]
    more = [(*names, one) for one in likely if one in forms and one not in names]
    if every:
        more += [(*start, one) for start in {(): 0, names: 0} for one in forms if one not in start]
    wanted = [choice for choice in dict.fromkeys(more) if set(choice) not in map(set, steps)]
    grown: dict[Names, Grown] = {(): Grown.of(found.problem.judged)}
    for i, choice in enumerate(wanted):
        progress(i, len(wanted))
        try:
            views.append(_fitted(found, choice, forms, grown))
        except (*FAILURES, EffectError):  # it is not in the page, which says so
            continue
    progress(len(wanted), len(wanted))
    return views


def _fitted(
    found: Diagnosis, names: Names, forms: Mapping[str, list[Competitor]], grown: dict[Names, Grown]
) -> View:
    """Fit the base with these effects, added one after the other. grown: models so far, which it extends."""
    problem = found.problem
    for end in range(1, len(names) + 1):
        if names[:end] not in grown:
            before = grown[names[: end - 1]]
            grown[names[:end]] = before.with_effect(problem.judged, forms[names[end - 1]])
    made = grown[names]
    return View(names, problem.result(made.model), made.held_out(problem))


def _key(names: Names, place: Mapping[str, int]) -> str:
    return ",".join(str(i) for i in sorted(place[name] for name in names))


def _said(
    view: View, base: View, found: Diagnosis, floors: Mapping[str, float | None]
) -> list[Block]:
    """Blocks on a model: how its errors differ from those of the base, and its parameters."""
    before, after = base.errors.scores(), view.errors.scores()
    change, name = compare_cv(base.errors, view.errors), f"with {listed(view.names)}"
    falls = ", ".join(
        f"{words(c)} {shown_value(c, s.rmse)}" if view is base else
        f"{words(c)} {shown_value(c, s.rmse)} -> {shown_value(c, after[c].rmse)}"
        for c, s in before.items()
    )  # fmt: skip
    doubts = [] if view is base else _doubts(view, found, change.worse)
    head = Callout(f"{'The base model' if view is base else name.capitalize()}: {falls}",
                   doubts, "warning" if doubts else "result")  # fmt: skip
    errors = []
    for channel, score in before.items():
        top = max(score.rmse, after[channel].rmse)
        shown: list[tuple[str, Score, float | None]] = [("base model", score, None)]
        if view is not base:
            shown.append((name, after[channel], change.reduction[channel]))
        errors += [{"channel": channel, "model": model, "top": top, "fall": fall} | asdict(found_score)
                   for model, found_score, fall in shown]  # fmt: skip
        if floor := floors.get(channel):
            errors.append({"channel": channel, "model": "a true model", "rmse": floor, "top": top})
    columns = [
        Column("held-out error", "channel", words), Column("", "model"),
        of_channel("RMSE", "rmse", bar=lambda row: row["rmse"] / row["top"]),
        of_channel("± s.e.", "rmse_std"), of_channel("bias", "bias"), share_of("fall", "fall"),
    ]  # fmt: skip
    blocks: list[Block] = [head, Table(columns, errors)]
    for effect in view.fit.bare.effects:
        if effect.id in view.names:
            blocks.append(
                Text(f"{words(effect.id).capitalize()}: {effect.summary} `{effect.formula}`")
            )
    blocks.append(Details("Parameters", [
        parameter_table(parameter_rows(view.fit), "Fitted to all runs", strong=view.names),
        Text(items=grouped(note for note in view.fit.notes
                           if view is base or note not in base.fit.notes)),
    ]))  # fmt: skip
    return blocks


def _doubts(view: View, found: Diagnosis, worse: tuple[str, ...]) -> list[str]:
    """Sentences on why the effects of a model are not those that the diagnosis names; empty if they are."""
    document = found.document
    rows = {row["effect"]: row for row in document["ranking"]}
    named = document["missing_effects"]
    lines = [f"the held-out error of {words(channel)} rises" for channel in worse]
    lines += [
        f"{words(n)}: {rows[n]['reason']}; not recommended" for n in view.names if n not in named
    ]
    left_out = [name for name in named if name not in view.names]
    return [sentence(line) for line in lines] + (
        [f"The diagnosis names {listed(named)}."] if left_out else []
    )
