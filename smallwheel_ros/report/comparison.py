# SPDX-License-Identifier: Apache-2.0
"""A comparison: the data, the models, where they fail, what to keep in mind."""

from __future__ import annotations

from html import escape

import numpy as np

from smallwheel_ros.compare.comparison import Comparison, ModelResult
from smallwheel_ros.fitting.held_out import Score
from smallwheel_ros.measurements.columns import CHANNEL_UNITS
from smallwheel_ros.measurements.display import (
    brief,
    column_display,
    display,
    number,
    percent,
    sentence,
    shown_value,
    words,
)
from smallwheel_ros.measurements.settings import Part, setting_columns, varied_settings, varies
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.pictures.layers import ratio_plot
from smallwheel_ros.report.blocks import Block, Callout, Details, Drawing, Section, Table, Text
from smallwheel_ros.report.page import Page
from smallwheel_ros.report.table_data import TableData
from smallwheel_ros.report.wording import in_words

_WORST = 8  # parts shown before the rest is folded away
_SCORE_HEADER = ("model", "rows", "held-out RMSE", "± s.e.", "held-out bias", "in-sample RMSE",
                 "in-sample bias", "against the best")  # fmt: skip
_CLEAR = 2.0  # times its standard error that a bias must be to be called one
_BEST, _WITHIN = "best", "within s.e."
_LEGEND = (
    "± s.e.: standard error over runs.",
    f"{_WITHIN[0].upper()}{_WITHIN[1:]}: worse than the best model by no more than the standard error of "
    "the difference.",
)
_RATIO = (
    "A check free of k and m: compaction alone puts every point on the line of its n. Points above the "
    "lines are a resistance that compaction does not make, or a wheel that digs itself deeper than its "
    "load presses it."
)


def comparison_page(comparison: Comparison) -> Page:
    """The comparison in order."""
    data = comparison.measurements
    return Page(
        "Models against measurements",
        [
            Section("In short", [_summary(comparison)]),
            Section("The data", data_blocks(comparison)),
            Section("The models", model_blocks(comparison)),
            Section("What they leave", model_plots(comparison)),
            Section("Where it fails", failure_blocks(comparison)),
            Section("What to keep in mind", [Text(items=caveats(comparison))]),
        ],
        f"{data.source}: {len(data)} rows, {data.runs.size} runs, {comparison.folds} folds",
        f"Data: SHA-256 {data.sha256}." if data.sha256 else "",
    )


def _summary(comparison: Comparison) -> Callout:
    sentences = summary(comparison)
    if not sentences:
        return Callout("No model could predict any of the measurements.", kind="warning")
    return Callout("The smallest error of each channel", sentences)


def summary(comparison: Comparison) -> list[str]:
    """Say which model is best, one sentence a channel."""
    sentences = []
    for channel in comparison.channels:
        if useless := comparison.useless(channel):
            sentences.append(f"{words(channel).capitalize()}: {useless}.")
            law = comparison.best(channel, laws=True)
            score = law and comparison.shown_score(law, channel)
            if law and score and (above := _above_floor(comparison, channel, score)):
                sentences.append(f"The error of {law.contender.name} is {above}.")
            continue
        model = comparison.best(channel)
        if model is None:
            continue
        held_out = model.held_out is not None
        best = comparison.score(model, channel, held_out)
        assert best is not None
        kind = "held-out" if held_out else "remaining"
        line = (
            f"{words(channel).capitalize()}: {model.contender.name} has the smallest {kind} error, "
            f"{shown_value(channel, best.rmse)} RMSE over {best.rows} rows"
        )
        changes = comparison.differences(channel)
        ties = [name for name, change in changes.items() if channel not in change.worse]
        if ties:
            line += f" (the difference to {', '.join(ties)} is within its standard error)"
        if above := _above_floor(comparison, channel, best):
            line += f"; that is {above}"
        sentences.append(line + ".")
    return sentences


def _above_floor(comparison: Comparison, channel: str, score: Score) -> str:
    """How many times the error of a true model an error is; "" where that is not known."""
    floor = comparison.noise[channel].value
    if not floor:
        return ""
    times = number(score.rmse / floor, 2)
    return f"{times} times the expected error of a true model, {shown_value(channel, floor)}"


def data_blocks(comparison: Comparison) -> list[Block]:
    """What was measured, over which ranges, how well it repeats, and what is odd about it."""
    data = comparison.measurements
    runs = (
        f"{data.runs.size} runs" if data.runs_given else f"no runs named, {data.runs.size} settings"
    )
    lines = f"{len(data)} rows, {runs}."
    rows = [
        [column_display(data, name).label, *_range(comparison, name),
         "varied" if varies(values) else "one value"]
        for name, values in setting_columns(data).items()
    ]  # fmt: skip
    known = any(floor.value is not None for floor in comparison.noise.values())
    expected = ["expected of a true model", "known from"] if known else []
    blocks: list[Block] = [
        Text(lines),
        Table(["condition", "from", "to", ""], rows, "Conditions", numbers=(1, 2)),
        Table(
            ["channel", "rows", "from", "to", "repeats differ by", *expected],
            [_channel_row(comparison, name, bool(expected)) for name in comparison.noise],
            "Measured channels",
            numbers=range(1, 6),
        ),
    ]
    odd = [f"{lines.size} rows left out: {why} (first in {data.place} {lines[0]})."
           for why, lines in comparison.left_out]  # fmt: skip
    odd += data.warnings
    if odd:
        blocks.append(Callout("Worth a second look", [sentence(o) for o in odd], "warning"))
    notes = [sentence(note) for note in (*data.notes, *comparison.notes)]
    if notes:
        blocks.append(Text("What was assumed:", notes))
    return blocks


def _range(comparison: Comparison, name: str) -> list[str]:
    data = comparison.measurements
    scale = column_display(data, name).scale
    values = data.conditions[name]
    known = values[np.isfinite(values)]
    if known.size == 0:
        return ["-", "-"]
    return [brief(scale * known.min()), brief(scale * known.max())]


def _channel_row(comparison: Comparison, name: str, expected: bool) -> list[str]:
    shown = display(name, CHANNEL_UNITS[name])
    values = comparison.measurements.channels[name]
    known = values[np.isfinite(values)]
    floor = comparison.noise[name]
    found = [known.min(), known.max(), floor.repeatability, floor.value]
    low, high, repeats, value = (number(None if v is None else v * shown.scale) for v in found)
    source = {"repeats": "repeated rows", "declared": "the table's own figures", None: "unknown"}
    of_truth = [value, f"{source[floor.source]}: {floor.reason}"] if expected else []
    return [shown.label, str(known.size), low, high, repeats, *of_truth]


def model_blocks(comparison: Comparison) -> list[Block]:
    """What each model is, its errors, and what it could not predict."""
    blocks: list[Block] = [
        Text(items=[f"{m.contender.name}: {m.contender.description}." for m in comparison.models])
    ]
    for channel in comparison.channels:
        shown = display(channel, CHANNEL_UNITS[channel])
        rows = [_score_row(comparison, model, channel) for model in comparison.models]
        best = [i for i, m in enumerate(comparison.models) if m is comparison.best(channel)]
        repeats = comparison.noise[channel].repeatability
        known = "repeatability unknown" if repeats is None else (
            f"repeats of one run differ by {shown_value(channel, repeats)}"
        )  # fmt: skip
        caption = f"{words(channel).capitalize()} [{shown.unit}], {known}; bias is measured minus predicted"
        blocks.append(Table(_SCORE_HEADER, rows, caption, range(1, 7), best))
    if comparison.channels:
        blocks.append(Text(items=_LEGEND))
    table = comparison.measurements
    reasons = [
        f"{m.contender.name}, {rows.size} rows not predicted (first in {table.place} "
        f"{table.line[rows[0]]}): {why}."
        for m in comparison.models
        for why, rows in m.not_predicted
    ]
    if reasons:
        blocks.append(Callout("Not predicted", reasons, "warning"))
    notes = [f"{m.contender.name} {note}." for m in comparison.models for note in m.notes]
    return blocks + ([Text(items=notes)] if notes else [])


def _score_row(comparison: Comparison, model: ModelResult, channel: str) -> list[str]:
    scale = display(channel, CHANNEL_UNITS[channel]).scale
    inside = comparison.score(model, channel)
    outside = comparison.score(model, channel, held_out=True)
    shown = outside or inside

    def cell(score: Score | None, name: str) -> str:
        value = None if score is None else getattr(score, name)
        return "-" if value is None else number(value * scale)

    rows = 0 if shown is None else shown.rows
    return [
        model.contender.name,
        str(rows),
        cell(outside, "rmse"),
        cell(outside, "rmse_std"),
        cell(outside, "bias"),
        cell(inside, "rmse"),
        cell(inside, "bias"),
        _against_best(comparison, channel, model),
    ]


def _against_best(comparison: Comparison, channel: str, model: ModelResult) -> str:
    """The best model, no clear difference to it, or how much larger the error is; "-" unknown."""
    change = comparison.differences(channel).get(model.contender.name)
    if model is comparison.best(channel):
        return _BEST
    if change is None:
        return "-"
    more = -change.reduction[channel]
    return percent(more, signed=True) if channel in change.worse else _WITHIN


def model_plots(comparison: Comparison) -> list[Block]:
    """Measured against predicted, and residuals over any setting: the best model beside another."""
    errors = [m.held_out or m.in_sample for m in comparison.models]
    table = TableData(comparison.measurements, errors, settings_of(comparison.measurements))
    if not table.rows:
        return []
    channel = next(iter(table.rows))
    best = comparison.best(channel)
    at = next((i for i, m in enumerate(comparison.models) if m is best), 0)
    shown = len(errors) - (2 if at == len(errors) - 1 and at else 1)
    names = [in_words(m.contender.name) for m in comparison.models]
    models = "".join(
        f'<option value="{i}"{" selected" if i == shown else ""}>{escape(name)}</option>'
        for i, name in enumerate(names)
    )
    over = "".join(
        f'<option value="{escape(name, quote=True)}">'
        f"{escape(column_display(comparison.measurements, name).label)}</option>"
        for name in table.settings
    )
    inside = (
        f'<p><label>Model <select name="model">{models}</select></label> '
        f'<label>Residuals over <select name="over">{over}</select></label></p>'
    )
    data = {
        "table": table.data({n: f.value for n, f in comparison.noise.items()}),
        "models": [{"name": name, "residual": table.residual(e)}
                   for name, e in zip(names, errors, strict=True)],
        "best": at,
    }  # fmt: skip
    known = any(f.value is not None for f in comparison.noise.values())
    band = "Grey band: twice the expected error of a true model; tinted" if known else "Tinted"
    caption = (
        f"Grey: {names[at]}, the best of {words(channel)}. Held out where a model was fitted to this "
        f"data. {band}: 95 % of the smooth, rows of a run taken together. An error that follows two "
        "conditions which were varied together shows in both."
    )
    return [Drawing("models", data, caption, inside)]


def settings_of(measurements: Measurements) -> list[str]:
    """The settings that were varied, or the load where none was."""
    return list(varied_settings(measurements)) or ["load"]


def failure_blocks(comparison: Comparison) -> list[Block]:
    """What the last model leaves in the worst parts of the data."""
    blocks: list[Block] = ratio_blocks(comparison.measurements)
    focus = comparison.models[-1]
    for channel in comparison.channels:
        rows = _part_rows(comparison, focus, channel)
        if rows:
            unit = display(channel, CHANNEL_UNITS[channel]).unit
            header = ["where", "rows", f"RMSE [{unit}]", f"bias [{unit}]", "RMSE elsewhere", ""]
            caption = f"{words(channel).capitalize()}, {focus.contender.name}, worst first"
            blocks.append(Table(header, rows[:_WORST], caption, numbers=(1, 2, 3, 4)))
            if rows[_WORST:]:
                more = Table(header, rows[_WORST:], numbers=(1, 2, 3, 4))
                blocks.append(Details(f"{len(rows) - _WORST} more parts", [more]))
    return blocks


def ratio_blocks(measurements: Measurements) -> list[Block]:
    """Resistance over load against sqrt(sinkage / diameter), where both were measured together."""
    plot = ratio_plot(measurements)
    return [] if plot is None else [Drawing("xy", plot, _RATIO)]


def _part_rows(comparison: Comparison, model: ModelResult, channel: str) -> list[list[str]]:
    scale = display(channel, CHANNEL_UNITS[channel]).scale
    held_out = model.held_out is not None
    found: list[tuple[float, list[str]]] = []
    for part in comparison.parts:
        here = comparison.score(model, channel, held_out, part.rows)
        elsewhere = comparison.score(model, channel, held_out, ~part.rows)
        if here is None:
            continue
        spread = np.sqrt(max(here.rmse**2 - here.bias**2, 0.0) / max(here.runs, 1))
        clear = abs(here.bias) > _CLEAR * spread and here.runs > 2
        word = "" if not clear else "predicts too little" if here.bias > 0 else "predicts too much"
        rest = None if elsewhere is None else elsewhere.rmse * scale
        row = [_where(comparison, part), str(here.rows), number(here.rmse * scale),
               number(here.bias * scale), number(rest), word]  # fmt: skip
        found.append((here.rmse, row))
    return [row for _, row in sorted(found, key=lambda pair: -pair[0])]


def _where(comparison: Comparison, part: Part) -> str:
    if part.by in ("soil", "wheel", "contact"):
        return f"{part.by}: {part.label}"
    shown = column_display(comparison.measurements, part.by)
    ends = [brief(end * shown.scale) for end in part.range]
    return f"{words(part.by)} {' to '.join(dict.fromkeys(ends))} {shown.unit}".rstrip()


def caveats(comparison: Comparison) -> list[str]:
    """What to keep in mind of a comparison."""
    lines = [
        "The run, not the row, is the unit of evidence: rows of one run are repeats and are held "
        "out together.",
        "A smaller error does not prove the physics: parameters that were fitted to the data can "
        "absorb an effect that the model lacks. `smallwheel diagnose` looks for such an effect.",
    ]
    if comparison.folds:
        lines.insert(
            1, f"Held-out errors come from {comparison.folds} parts that the runs were dealt into."
        )
    unknown = [f.reason for f in comparison.noise.values() if f.value is None]
    lines += [sentence(reason) for reason in dict.fromkeys(unknown)]
    if not comparison.measurements.runs_given:
        lines.append(
            "The table names no runs. If rows belong together (one filling of the bin, one drive), "
            "the held-out errors are too small: name them in the column 'run'."
        )
    return lines
