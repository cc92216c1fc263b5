# SPDX-License-Identifier: Apache-2.0
"""The commands `predict`, `effects` and `paper`."""

from __future__ import annotations

from collections import Counter
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from smallwheel_ros.api.predict import predict as predict_wheel
from smallwheel_ros.commands.command import command, options_of
from smallwheel_ros.commands.outputs import JSON, PATH, Options, finish, output
from smallwheel_ros.common.console import tell
from smallwheel_ros.common.files import check_targets

# `--help` of a command needs none of what the command computes and draws with.
if TYPE_CHECKING:
    from smallwheel_ros.effects.base import Effect
    from smallwheel_ros.physics.paper import PaperLine


def _drawn(result: Any, asked: Options) -> None:
    path = asked["plot"]
    if path is not None:
        from smallwheel_ros.views.plots import write_picture
        from smallwheel_ros.views.prediction import panels

        write_picture(panels(result), path)
    finish(result, asked, written=[] if path is None else [path])


predict = command(
    predict_wheel,
    output("Write the rows as a table (CSV)."),
    JSON,
    click.option("--plot", type=PATH, help="Draw into this file (PNG, SVG, PDF)."),
    words="For example a table of seven loads, and the rows of a table of your own.\n\n"
    "smallwheel predict --load 20:140:20 --diameter 0.2 --width 0.1 --slip 0.2 --soil dry_sand\n\n"
    "smallwheel predict --data planned.csv --model rig.yaml -o predicted.csv",
    finish=_drawn,
)


@click.command()
@click.argument("effect", required=False)
@options_of(predict_wheel, "effects")
@JSON
def effects(effect: str | None, effects: Path | None, json_file: str | None) -> None:
    """List the effects that a model may lack, or explain one: its forms, sources and parameters."""
    from smallwheel_ros.common.tables import text_table
    from smallwheel_ros.effects.registry import default_registry, families, load_effects

    check_targets([json_file], [effects])
    user = load_effects(effects) if effects else None
    shown = (
        families(user)
        if effect is None
        else {effect: default_registry().with_families(user or {}).family(effect)}
    )
    if effect is None:
        rows = [[i, ", ".join(f[0].needs) or "-", f[0].summary] for i, f in shown.items()]
        rows.append(["covariate:NAME", "NAME", "The modulus follows any recorded column."])
        text = text_table(["effect", "needs", "what it says"], rows)
    else:
        text = _explained(shown[effect])
    listing = {id: [_described(form) for form in family] for id, family in shown.items()}
    document = {"schema": 1, "effects": listing}
    tell(document, text, json_file)


_FORM = ("form", "kind", "summary", "formula", "source", "needs", "drivers", "channels", "stage",
         "next_step")  # fmt: skip


def _described(form: type[Effect]) -> dict[str, object]:
    return {name: getattr(form, name) for name in _FORM} | {
        "parameters": [
            {
                "name": p.name,
                "start": p.start,
                "bounds": p.bounds,
                "published_range": p.published,
                "neutral": p.neutral,
                "unit": p.unit,
                "description": p.description,
            }
            for p in form.parameters()
        ],
        "constants": [
            {"name": c.name, "value": c.start, "unit": c.unit, "description": c.description}
            for c in form.constants()
        ],
    }


def _explained(family: tuple[type[Effect], ...]) -> str:
    first = family[0]
    needed = ", ".join(first.needs) or "nothing beyond load, diameter and width"
    lines = [
        f"{first.id} ({first.kind})",
        f"  {first.summary}",
        f"  needs: {needed}",
        f"  follows: {', '.join(first.drivers) or 'no setting'}",
        f"  changes: {', '.join(first.channels)}",
    ]
    if first.next_step:
        lines.append(f"  to be sure: {first.next_step}")
    for form in family:
        lines += ["", f"  form '{form.form}': {form.formula}"]
        lines += [f"    source: {form.source}"] if form.source else []
        lines.append(f"    acts at: {form.stage}")
        for p in form.parameters():
            published = (
                f"published {p.published[0]:g} to {p.published[1]:g}"
                if p.published
                else "no published range"
            )
            bounds = f"bounds {p.bounds[0]:g} to {p.bounds[1]:g}"
            lines.append(f"    {p.name} [{p.unit}]: {p.description}; {published}; {bounds}")
        for c in form.constants():
            lines.append(
                f"    {c.name} = {c.start:g} [{c.unit}]: {c.description}; given, not fitted"
            )
    return "\n".join(lines)


@click.command()
@JSON
def paper(json_file: str | None) -> None:
    """Compute the tables and equations that the paper prints, and say which of them reproduce."""
    from smallwheel_ros.physics.paper import paper_lines

    check_targets([json_file])
    lines = paper_lines()
    shown = []
    for place, of_place in groupby(lines, key=_heading):
        shown += ["", place, *(f"  {text}" for line in of_place for text in _judged(line))]
    counts = Counter(line.status for line in lines)
    shown += ["", ", ".join(f"{n} {_COUNTED.get(status, status)}" for status, n in counts.items())]
    document = {"schema": 1, "lines": [vars(line) for line in lines]}
    tell(document, "\n".join(shown[1:]), json_file)


_MARKS = {"reproduced": "=", "taken over": "=", "not reproduced": "x", "follows": ">"}
_COUNTED = {"follows": "that follow from these", "taken over": "taken over by the library"}
_EQUATIONS = "Equations for the paper's wheel, written out, and by the library"


def _heading(line: PaperLine) -> str:
    return line.place if line.place.startswith("Table") else _EQUATIONS


def _judged(line: PaperLine) -> list[str]:
    """A line of the paper: printed, computed, and on the next line the verdict and the reading."""
    unit = "" if line.unit == "1" else f" {line.unit}"
    mark = _MARKS.get(line.status, "~")
    if line.status == "taken over":
        return [f"{mark} {line.quantity}: {line.computed:.6g}{unit}, {line.reading}"]
    if line.place.startswith("eq."):
        numbers = f"{line.printed:#.4g}{unit}, library {line.computed:#.4g}{unit}"
        return [f"{mark} {line.place}, {line.quantity}: {numbers}", f"    {line.reading}"]
    printed = "" if line.printed is None else f"printed {line.printed:g}{unit}, "
    return [
        f"{mark} {line.quantity}: {printed}computed {line.computed:.2f}{unit}",
        f"    {line.status}; {line.reading}",
    ]
