# SPDX-License-Identifier: Apache-2.0
"""The page of a comparison: the data, the models, where they fail, and caveats."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from smallwheel_ros.common.result import name_to_draw
from smallwheel_ros.compare.comparison import Comparison, ModelResult
from smallwheel_ros.compare.reasons import MISSING
from smallwheel_ros.compare.shown import comparison_document
from smallwheel_ros.fitting.held_out import Score
from smallwheel_ros.measurements.display import (
    brief,
    column_display,
    number,
    percent,
    sentence,
    shown_value,
    words,
)
from smallwheel_ros.measurements.settings import Part, setting_columns, varies
from smallwheel_ros.views.blocks import (
    Block,
    Callout,
    Choice,
    Column,
    Details,
    Figure,
    Models,
    Row,
    Section,
    Table,
    Text,
    count,
    of_channel,
    plain_number,
)
from smallwheel_ros.views.leftovers import (
    Left,
    leftovers,
    measured_panel,
    residual_panel,
    settings_of,
    shown_channel,
)
from smallwheel_ros.views.page import Page
from smallwheel_ros.views.plots import CYCLE, Bar, Panel
from smallwheel_ros.views.plots import draw as draw_panel
from smallwheel_ros.views.ratio import ratio_blocks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WORST = 8  # parts shown before the rest is folded away
_CLEAR = 2.0  # times its standard error that a bias must be to be called one
_ERROR = "± s.e.: standard error over runs."
_WITHIN = (
    "Within s.e.: worse than the best model by no more than the standard error of the difference."
)
_CAVEATS = (
    "The run, not the row, is the unit of evidence: rows of one run are repeats and are held out together.",
    "A smaller error does not prove the physics: parameters that were fitted to the data can absorb an "
    "effect that the model lacks.",
)
_MISSING = MISSING.replace("is missing", "is missing (`smallwheel diagnose`)")
_DIAGNOSE = "`smallwheel diagnose` looks for an effect that a model lacks."
_NO_FLOOR = "the diagnosis could not tell noise from misfit: repeat runs"
_NO_RUNS = (
    "The table names no runs. If rows belong together (one filling of the bin, one drive), the held-out "
    "errors are too small: name them in the column 'run'."
)


def page(found: Comparison, pictures: bool = True) -> Page:
    """Make the page of a comparison.

    Parameters
    ----------
    found
        The comparison.
    pictures
        Whether the page has the block in which residuals of a chosen model are drawn.
    """
    data = found.measurements
    best = best_sentences(found)
    short = Callout("The smallest error of each channel", best) if best else Callout(
        "No model could predict any of the measurements.", tone="warning")  # fmt: skip
    return Page(
        "Models against measurements",
        [
            Section("In short", [short]),
            Section("The data", data_blocks(found)),
            Section("The models", model_blocks(found)),
            Section("What they leave", left_blocks(found) if pictures else []),
            Section(
                "Where it fails", [*_part_blocks(found, found.models[-1]), *ratio_blocks(data)]
            ),
            Section("What to keep in mind", [Text(items=caveats(found))]),
        ],
        f"{data.source}: {len(data)} rows, {data.runs.size} runs, {found.folds} folds",
        f"Data: SHA-256 {data.sha256}." if data.sha256 else "",
    )


def draw(axes: Axes, found: Comparison, channel: str | None = None) -> None:
    """Draw measured over predicted values, one series of points for each model.

    Parameters
    ----------
    axes
        Axes to draw on.
    found
        The comparison.
    channel
        Name of the channel, such as `sinkage`; the first one if not given.

    Raises
    ------
    ResultError
        If there is no such channel.
    """
    draw_panel(axes, _measured_panel(found, name_to_draw(channel, found.channels)))


def document(found: Comparison) -> dict[str, Any]:
    """The comparison as JSON, in SI units."""
    return comparison_document(found)


def _differences(found: Comparison, channel: str) -> list[dict[str, Any]]:
    best = found.best(channel)
    return [
        {"channel": channel, "best": best.contender.name, "other": name,
         "increase": -change.reduction[channel], "z_score": change.z_score[channel],
         "within_standard_error": channel not in change.worse}
        for name, change in found.differences(channel).items()
        if best is not None
    ]  # fmt: skip


def best_sentences(found: Comparison, diagnosed: bool = False) -> list[str]:
    """Say which model has the smallest error, in one or two sentences for each channel.

    Parameters
    ----------
    found
        The comparison.
    diagnosed
        Whether a diagnosis stands on the same page; otherwise the reader is referred to the command.
    """
    sentences = []
    for channel in found.channels:
        if useless := found.useless(channel):
            for one in found.models:  # names as people write them
                useless = useless.replace(one.contender.name, words(one.contender.name))
            said = useless if diagnosed else useless.replace(MISSING, _MISSING)
            sentences.append(f"{words(channel).capitalize()}: {said}.")
            law = found.best(channel, laws=True)
            score = law and found.shown_score(law, channel)
            if law and score and (above := _above_floor(found, channel, score)):
                sentences.append(f"The error of this law is {above}.")
        elif (model := found.best(channel)) and (score := found.shown_score(model, channel)):
            kind = "held-out" if model.held_out is not None else "remaining"
            line = (
                f"{words(channel).capitalize()}: {words(model.contender.name)} has the smallest {kind} "
                f"error, {shown_value(channel, score.rmse)} RMSE over {score.rows} rows"
            )
            ties = [words(d["other"]) for d in _differences(found, channel)
                    if d["within_standard_error"]]  # fmt: skip
            if ties:
                line += f" (the difference to {', '.join(ties)} is within its standard error)"
            if above := _above_floor(found, channel, score):
                line += f"; that is {above}"
            sentences.append(line + ".")
    return sentences


def _above_floor(found: Comparison, channel: str, score: Score) -> str:
    """A clause on how many times the expected error of a true model an error is; empty if that is unknown."""
    floor = found.noise[channel].value
    if not floor:
        return ""
    times = number(score.rmse / floor, 2)
    return f"{times} times the expected error of a true model, {shown_value(channel, floor)}"


def data_blocks(found: Comparison) -> list[Block]:
    """Blocks on the data: ranges of conditions and channels, repeatability, warnings and assumptions."""
    data = found.measurements
    runs = f"{data.runs.size} runs" if data.runs_given else (
        f"no runs named, {data.runs.size} settings")  # fmt: skip
    conditions = [
        {"label": (how := column_display(data, name)).label, "varied": varies(values)}
        | _ends(values, how.scale)
        for name, values in setting_columns(data).items()
    ]
    channels = [
        {"channel": name, "label": shown_channel(name).label, "rows": data.channel_rows(name).size}
        | _ends(data.channels[name], shown_channel(name).scale)
        | asdict(floor)
        for name, floor in found.noise.items()
    ]
    blocks: list[Block] = [
        Text(f"{len(data)} rows, {runs}."),
        Table([Column("condition", "label"), _brief("from"), _brief("to"),
               Column("", lambda row: "varied" if row["varied"] else "one value")],
              conditions, "Conditions"),
        Table([Column("channel", "label"), count("rows", "rows"), plain_number("from", "from"),
               plain_number("to", "to"), of_channel("repeats differ by", "repeatability"),
               of_channel("expected of a true model", "value")], channels, "Measured channels"),
    ]  # fmt: skip
    odd = [f"{lines.size} rows left out: {why} (first in {data.place} {lines[0]})"
           for why, lines in found.left_out]  # fmt: skip
    if odd := [sentence(line) for line in (*odd, *data.warnings)]:
        blocks.append(Callout("Worth a second look", odd, "warning"))
    if notes := [sentence(note) for note in (*data.notes, *found.notes)]:
        blocks.append(Text("What was assumed:", notes))
    return blocks


def _ends(values: Any, scale: float) -> dict[str, float | None]:
    known = scale * values[np.isfinite(values)]
    return dict(zip(("from", "to"), (known.min(), known.max()) if known.size else (None, None),
                    strict=True))  # fmt: skip


def _brief(header: str) -> Column:
    return Column(header, header, lambda v: "-" if v is None else brief(v), right=True)


def model_blocks(found: Comparison) -> list[Block]:
    """Blocks on the models: description, errors on each channel, and rows that could not be predicted."""
    models, place, line = found.models, found.measurements.place, found.measurements.line
    blocks: list[Block] = [
        Text(items=[f"{words(m.contender.name)}: {m.contender.description}." for m in models]),
        Figure("errors", [_error_panel(found, channel) for channel in found.channels],
               "Solid: held out, with its standard error; pale: in sample."),
        Figure("measured_predicted", [_measured_panel(found, channel) for channel in found.channels],
               "Held out where there are several runs; points beyond the axes are only counted."),
    ]  # fmt: skip
    columns = [
        Column("model", "model", words), count("rows", "rows"), of_channel("held-out RMSE", "held_out_rmse"),
        of_channel("± s.e.", "held_out_rmse_std"), of_channel("held-out bias", "held_out_bias"),
        of_channel("in-sample RMSE", "in_sample_rmse"), Column("against the best", "against"),
    ]  # fmt: skip
    shown: list[Row] = []
    for channel in found.channels:
        best = found.best(channel)
        against = {d["other"]: "within s.e." if d["within_standard_error"] else
                   percent(d["increase"], signed=True)
                   for d in _differences(found, channel)}  # fmt: skip
        against |= {best.contender.name: "best"} if best else {}
        rows = [row | {"against": against.get(row["model"], "-")}
                for row in found.rows() if row["channel"] == channel]  # fmt: skip
        repeats = found.noise[channel].repeatability
        known = "repeatability unknown" if repeats is None else (
            f"repeats of one run differ by {shown_value(channel, repeats)}")  # fmt: skip
        caption = f"{words(channel).capitalize()}, {known}; bias is measured minus predicted"
        blocks.append(Table(columns, rows, caption, strong=lambda row: row["against"] == "best"))
        shown += rows
    within = any(row["against"] == "within s.e." for row in shown)
    blocks += [Text(items=[_ERROR, *([_WITHIN] if within else [])])] if found.channels else []
    reasons = [
        f"{words(m.contender.name)}, {rows.size} rows not predicted (first in {place} "
        f"{line[rows[0]]}): {why}."
        for m in models for why, rows in m.not_predicted
    ]  # fmt: skip
    if reasons:
        blocks.append(Callout("Not predicted", reasons, "warning"))
    notes = [f"{words(m.contender.name)} {note}." for m in models for note in m.notes]
    return blocks + ([Text(items=notes)] if notes else [])


def _measured_panel(found: Comparison, channel: str) -> Panel:
    series = [
        Left(m.held_out or m.in_sample, words(m.contender.name), CYCLE[i % len(CYCLE)] if i else "base")
        for i, m in enumerate(found.models)
    ]  # fmt: skip
    return measured_panel(found.measurements.channels[channel], series, channel)


def _error_panel(found: Comparison, channel: str) -> Panel:
    how, bars = shown_channel(channel), []
    for i, row in enumerate(r for r in found.rows() if r["channel"] == channel):
        value, std, pale = (None if row[key] is None else how.scale * row[key] for key in
                            ("held_out_rmse", "held_out_rmse_std", "in_sample_rmse"))  # fmt: skip
        colour = CYCLE[i % len(CYCLE)] if i else "base"
        bars.append(Bar(words(row["model"]), value, colour, std, pale))
    level = found.noise[channel].value
    return Panel(f"RMSE [{how.unit}]", "", words(channel), bars=bars,
                 level=None if level is None else how.scale * level)  # fmt: skip


def left_blocks(found: Comparison) -> list[Block]:
    """Residuals of a model that the reader picks, beside those of the best model that predicts every channel.

    A model that does not predict every channel, such as a regression without pull, is not the best one here.
    """
    errors = {str(i): m.held_out or m.in_sample for i, m in enumerate(found.models)}
    if not found.channels:
        return []
    first, least = found.channels[0], {key: e.rmse() for key, e in errors.items()}
    whole = [key for key in errors if least[key].keys() >= {*found.channels}]
    best = min(whole or errors, key=lambda key: least[key].get(first, np.inf))
    names = {str(i): words(m.contender.name) for i, m in enumerate(found.models)}
    others = [key for key in errors if key != best]
    choices = [
        Choice(key, name, chosen=key == (others or [best])[-1]) for key, name in names.items()
    ]
    floors = {name: floor.value for name, floor in found.noise.items()}
    views: dict[str, list[Block]] = {
        key: [
            Details(
                f"Where {names[key]} is worst", _part_blocks(found, found.models[int(key)], False)
            )
        ]
        for key in errors
    }
    of_all = ", of those that predict every channel" if len(whole) < len(errors) else ""
    base_name = f"{names[best]}, the best of {words(first)}{of_all}"
    leaves = leftovers(found.measurements, errors, best, base_name, floors)
    pair = [Left(errors[best], base_name, "base")]
    pair += [Left(errors[others[-1]], names[others[-1]], "with")] if others else []
    settings = settings_of(found.measurements)
    stills = [
        Figure(f"{channel}_residuals", [residual_panel(found.measurements, pair, channel, name)
                                        for name in settings])
        for channel in found.channels
    ]  # fmt: skip
    return [Models(choices, False, views, leaves, stills=stills)]


def _part_blocks(found: Comparison, model: ModelResult, rest: bool = True) -> list[Block]:
    """The parts of the data in which a model is worst; with `rest`, all others in a block that opens."""
    blocks: list[Block] = []
    for channel in found.channels:
        rows = sorted(_part_rows(found, model, channel), key=lambda row: -row["rmse"])
        columns = [
            Column("where", "where"), count("rows", "rows"), of_channel("RMSE", "rmse"),
            of_channel("bias", "bias"), of_channel("RMSE elsewhere", "elsewhere"), Column("", "said"),
        ]  # fmt: skip
        caption = f"{words(channel).capitalize()}, {words(model.contender.name)}, worst first"
        if rows:
            blocks.append(Table(columns, rows[:_WORST], caption))
        if rest and rows[_WORST:]:
            blocks.append(
                Details(f"{len(rows) - _WORST} more parts", [Table(columns, rows[_WORST:])])
            )
    return blocks


def _part_rows(found: Comparison, model: ModelResult, channel: str) -> list[Row]:
    held_out = model.held_out is not None
    rows: list[Row] = []
    for part in found.parts:
        here = found.score(model, channel, held_out, part.rows)
        rest = found.score(model, channel, held_out, ~part.rows)
        if here is None:
            continue
        spread = np.sqrt(max(here.rmse**2 - here.bias**2, 0.0) / max(here.runs, 1))
        clear = abs(here.bias) > _CLEAR * spread and here.runs > 2
        said = f"predicts too {'little' if here.bias > 0 else 'much'}" if clear else ""
        rows.append({"channel": channel, "where": _where(found, part), "said": said,
                     "elsewhere": rest and rest.rmse} | asdict(here))  # fmt: skip
    return rows


def _where(found: Comparison, part: Part) -> str:
    if part.by in ("soil", "wheel", "contact"):
        return f"{part.by}: {part.label}"
    shown = column_display(found.measurements, part.by)
    ends = [brief(end * shown.scale) for end in part.range]
    return f"{words(part.by)} {' to '.join(dict.fromkeys(ends))} {shown.unit}".rstrip()


def caveats(found: Comparison, diagnosed: bool = False) -> list[str]:
    """List sentences that a reader of a comparison should keep in mind.

    Parameters
    ----------
    found
        The comparison.
    diagnosed
        Whether a diagnosis stands on the same page; otherwise the reader is referred to the command.
    """
    unknown = dict.fromkeys(floor.reason for floor in found.noise.values() if floor.value is None)
    folds = f"Held-out errors are those of a {found.folds}-fold cross-validation by runs."
    return [
        *_CAVEATS,
        *([] if diagnosed else [_DIAGNOSE]),
        *([folds] if found.folds else []),
        *map(sentence, unknown),
        *([] if found.measurements.runs_given else [_NO_RUNS]),
    ]


def with_floors(found: Comparison, diagnosed: Mapping[str, Any]) -> Comparison:
    """Replace the errors expected of a true model by those of a diagnosis of the same data.

    Parameters
    ----------
    found
        The comparison.
    diagnosed
        Document of the diagnosis, as its `to_dict` returns it.

    Returns
    -------
    Comparison
        A copy with the other `noise`; where the diagnosis knows no such error, its value is None.
    """
    from dataclasses import replace

    noise = {}
    for name, floor in found.noise.items():
        channel = diagnosed["channels"].get(name, {})
        value, repeats = channel.get("noise_floor"), channel.get("repeatability")
        noise[name] = replace(
            floor,
            value=value,
            source=channel.get("noise_floor_source"),
            reason=_NO_FLOOR if value is None else "",
            repeatability=floor.repeatability if repeats is None else repeats,
        )
    return replace(found, noise=noise)
