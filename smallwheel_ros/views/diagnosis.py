# SPDX-License-Identifier: Apache-2.0
"""The page of a diagnosis, from its document and from the models that can be chosen."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from smallwheel_ros.common.result import name_to_draw
from smallwheel_ros.diagnosis.document import failing_settings
from smallwheel_ros.diagnosis.pipeline import Diagnosis
from smallwheel_ros.diagnosis.text import verdict_sentences
from smallwheel_ros.measurements.columns import CHANNEL_UNITS, unit_of
from smallwheel_ros.measurements.display import (
    ADDED,
    LAW,
    display,
    effect_words,
    listed,
    number,
    percent,
    region_words,
    setting_words,
    shown_value,
    to_tell,
    words,
)
from smallwheel_ros.views.blocks import (
    Block,
    Callout,
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
    p_value,
    probability,
    share_of,
)
from smallwheel_ros.views.effects import models_block
from smallwheel_ros.views.leftovers import Left, residual_panel, settings_of
from smallwheel_ros.views.notes import grouped
from smallwheel_ros.views.page import Page
from smallwheel_ros.views.parameters import parameter_table
from smallwheel_ros.views.plots import Bar, Layer, Panel
from smallwheel_ros.views.plots import draw as draw_panel
from smallwheel_ros.views.ratio import ratio_blocks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Document = dict[str, Any]

_STATUS = {"significant": "significant", "not_significant": "not significant",
           "confounded": "cannot be told apart"}  # fmt: skip
_SHOWN = 0.01  # probability under which an effect is counted, not shown
_SURE = 0.05  # p up to which a region is sure
_TOLD = 3.0  # standard errors by which a part's residual must differ to be stressed
_MOST_PANELS = 3
_SCREEN = 25  # lines that the command prints
_PROPOSALS = 2  # measurements among them
_OF_LAW = re.compile(r"\.(k|n|m|log_reference_pressure)\b")
_CURVES = "The factor, or what is added, over the setting, with its 95 % band."
_FLOOR = (
    "; expected of a true model: the held-out error that the true model would leave, with the noise of each "
    "row and the scatter from run to run"
)
_OVER_CHANNELS = (
    "; over all channels that decide, as 1 minus the root mean square of the ratios of their errors with and "
    "without it: one channel's error may rise while another's falls (where an effect can be set, its errors "
    "are given by channel)"
)
_MAY_BE_LOWER = (
    "; with something still missing, part of it may be taken for scatter, and a true model's error be "
    "lower"
)


def page(found: Diagnosis, pictures: bool = True, models: Models | None = None) -> Page:
    """Make the page of a diagnosis.

    Parameters
    ----------
    found
        The diagnosis.
    pictures
        Whether to make the block `models`, which takes some fits, if it is None.
    models
        Block in which effects can be set and unset; None: the one that `models_block` makes, or none without
        `pictures`.
    """
    document, data = found.document, found.measurements
    models = models_block(found) if pictures and models is None else models
    return Page(
        "Which effect is missing?",
        [
            Section("In short", [verdict_block(found)]),
            Section("Set and unset effects", [] if models is None else [models]),
            Section("The data", channel_blocks(document)),
            Section("Where the model fails", [*region_blocks(document), *left_figure(found),
                                              *ratio_blocks(data)]),
            Section("Which effect is missing", ranking_blocks(document)),
            Section("Held-out error, step by step", step_blocks(document)),
            Section("What this data cannot tell", unknowable_blocks(document)),
            Section("What to measure next", next_blocks(document)),
            Section("What to keep in mind", [Text(items=caveats(document))]),
        ],
        footer=f"Data: {data.source}, SHA-256 {data.sha256}." if data.sha256 else "",
    )  # fmt: skip


def draw(axes: Axes, found: Diagnosis, channel: str | None = None) -> None:
    """Draw the held-out error of a channel after each effect that was added, as bars.

    Parameters
    ----------
    axes
        Axes to draw on.
    found
        The diagnosis.
    channel
        Name of the channel, such as `sinkage`; the first one if not given.

    Raises
    ------
    ResultError
        If there is no such channel.
    """
    document = found.document
    panels = dict(zip(_steps_by_channel(document), stairs(document), strict=True))
    draw_panel(axes, panels[name_to_draw(channel, panels)])


def text(found: Diagnosis) -> str:
    """The answer on one screen: the verdict, errors before and after, what to do next."""
    document = found.document
    blocks = [verdict_block(found), *_before_and_after(document)]
    lines = [line for block in blocks for line in ("", *block.lines())][1:]
    if proposals := document["next_measurements"][:_PROPOSALS]:
        lines += ["", "What to measure next"]
        for row in proposals:
            what = to_tell(row["separates"] or ())
            lines.append(f"  {row['runs']} runs at {_settings(row['settings'])}: to tell {what}")
    notes = Text("What to keep in mind", grouped(document["notes"])).lines()
    left = max(_SCREEN - len(lines) - 4, 0)
    if len(notes) > 1 and left > 1:
        lines += ["", *notes[:left]]
    more = max(len(notes) - max(left, 1), 0)
    rest = f"{more} more notes, where it fails, every effect tested" if more else (
        "Where it fails, every effect tested")  # fmt: skip
    return "\n".join(
        [*lines, "", f"{rest}, what this data cannot tell: `--full`, or `--html FILE`."]
    )


def _before_and_after(document: Document) -> list[Block]:
    """Held-out errors of the base model, of the last step, and of a true model."""
    rows = [
        {"channel": name, "before": steps[0], "after": steps[-1] if steps[1:] else None,
         "floor": document["channels"].get(name, {}).get("noise_floor")}
        for name, found in _steps_by_channel(document).items()
        if (steps := list(found.values()))
    ]  # fmt: skip
    if document["verdict"] == "insufficient_data" or not rows:
        return []
    columns = [
        Column("held-out error", "channel", words), of_channel("base model", "before"),
        of_channel("with what is named", "after"), of_channel("expected of a true model", "floor"),
    ]  # fmt: skip
    return [Table(columns, rows)]


def verdict_block(found: Diagnosis) -> Callout:
    """The verdict, the evidence for it, and what to do next."""
    document = found.document
    first, *lines = verdict_sentences(document, found.following)
    clear = document["verdict"] in ("missing_effect", "adequate")
    return Callout(first.removesuffix("."), lines, "result" if clear else "warning")


def channel_blocks(document: Document) -> list[Block]:
    """The measured channels, and the residuals of the base model."""
    rows = [{"channel": name} | found for name, found in document["channels"].items()]
    columns = [
        Column("channel", "channel", words), count("rows", "rows"),
        of_channel("base model's RMSE", "rmse"), of_channel("bias", "bias"),
        of_channel("repeats differ by", "repeatability"),
        of_channel("expected of a true model", "noise_floor"),
        Column("known from", "noise_floor_source"),
    ]  # fmt: skip
    caption = "What was measured, and the error of the base model; bias is measured - predicted"
    blocks: list[Block] = [Table(columns, rows, caption)] if rows else []
    if document["warnings"]:
        blocks.append(Callout("Worth a second look", document["warnings"], "warning"))
    return blocks


def region_blocks(document: Document) -> list[Block]:
    """A table of the regions of the settings where the base model fails."""
    columns = [
        Column("where", "region", region_words), Column("channel", "channel", words),
        count("rows", "rows"), of_channel("bias", "bias"), of_channel("RMSE", "rmse"),
        of_channel("RMSE elsewhere", "rmse_elsewhere"), p_value("p", "p_value"),
        Column("", lambda r: "too few runs to be sure" if (r["p_value"] or 0.0) > _SURE else ""),
    ]  # fmt: skip
    caption = "Held-out errors of the base model; user-defined columns in SI units"
    regions = document["where_it_fails"]
    return [Table(columns, regions, caption)] if regions else []


def left_figure(found: Diagnosis) -> list[Block]:
    """Held-out errors over the settings at which the model fails, without and with the named effects."""
    if not found.steps:
        return []
    first, *added = found.steps
    models = [Left(first.errors, "base model", "base")]
    if added:
        names = listed([str(step.added) for step in added])
        models.append(Left(added[-1].errors, f"with {names}", "with"))
    settings = settings_of(found.measurements)
    places = failing_settings(found.document, settings)[:_MOST_PANELS]
    places = places or [(name, settings[0]) for name in first.errors.error]
    floors = {name: c["noise_floor"] for name, c in found.document["channels"].items()}
    panels = [residual_panel(found.measurements, models, c, s, floors.get(c)) for c, s in places]
    caption = (
        "Held-out errors; squares: means of eight parts with twice their standard error over runs; grey: "
        "twice the error that a true model would leave."
    )
    return [Figure("residuals", panels, caption)]


def ranking_blocks(document: Document) -> list[Block]:
    """Blocks on every effect tested, with its fitted parameters, and on curves without a known effect."""
    tested = [row for row in document["ranking"] if row["status"] != "not_testable"]
    likely = [
        r for r in tested if r["status"] != "not_significant" or (r["probability"] or 0.0) >= _SHOWN
    ]
    others = [row for row in tested if row not in likely]
    named = document["missing_effects"]
    blocks: list[Block] = []
    if document["verdict"] == "unknown_effect" and document.get("curves"):
        panels = [_curve(curve) for curve in document["curves"]]
        blocks.append(Figure("curves", panels, _CURVES))
    for rows, fitted in ((likely, [r for r in likely if r["status"] != "not_significant"]),
                         (others, others)):  # fmt: skip
        tables: list[Block] = [_ranking(rows, named)] if rows else []
        if numbers := _numbers(fitted):
            tables.append(parameter_table(numbers))
        if rows is others and others:
            title = f"{len(others)} others, each with a probability under {_SHOWN:g}"
            tables = [Details(title, tables)]
        blocks += tables
    return blocks


def _ranking(rows: Sequence[Row], named: Sequence[str]) -> Table:
    columns = [
        Column("effect", "effect", effect_words), Column("kind", "kind"),
        Column("verdict", "status", lambda status: str(_STATUS.get(status, status))),
        probability("probability", "probability"),
        share_of("error removed", "reduction"), Column("", "reason", _doubts),
    ]  # fmt: skip
    caption = "Probability: against all others. Error removed: by the effect alone, added to the base model"
    if any(len(row.get("held_out_rmse") or {}) > 1 for row in rows):
        caption += _OVER_CHANNELS
    return Table(columns, rows, caption, strong=lambda row: row["effect"] in named)


def _doubts(reason: str) -> str:
    """The parts of a reason other than probability and verdict, which have their own columns."""
    parts = [
        part.partition(": ")[2] if part.startswith("probability") else part
        for part in (reason or "").split("; ")
        if not part.startswith("this data cannot tell")
    ]
    return "; ".join(part for part in parts if part)


def _numbers(ranking: Sequence[Row]) -> list[Row]:
    """Rows of the fitted numbers of effects; curves that stand for no known effect have a figure instead."""
    return [
        {"owner": row["effect"], "form": row["form"], "name": name} | p
        for row in ranking
        if row["kind"] != "unknown"
        for name, p in (row.get("parameters") or {}).items()
    ]


def stairs(document: Document) -> list[Panel]:
    """The held-out error after each added effect, a panel for each channel."""
    panels = []
    for name, steps in _steps_by_channel(document).items():
        how = display(name, CHANNEL_UNITS[name])
        floor = document["channels"].get(name, {}).get("noise_floor")
        bars = [Bar(label, None if value is None else value * how.scale, "with" if i else "base")
                for i, (label, value) in enumerate(steps.items())]  # fmt: skip
        level = None if floor is None else floor * how.scale
        panels.append(Panel(f"held-out RMSE [{how.unit}]", "", words(name), bars=bars, level=level))
    return panels


def _steps_by_channel(document: Document) -> dict[str, dict[str, float | None]]:
    """Held-out error after each step, by channel and by the step's name."""
    found: dict[str, dict[str, float | None]] = {}
    for name in CHANNEL_UNITS:
        for step in document["steps"]:
            label = "base model" if step["added"] is None else f"+ {words(step['added'])}"
            if name in step["held_out_rmse"]:
                found.setdefault(name, {})[label] = step["held_out_rmse"][name]
    return found


def step_blocks(document: Document) -> list[Block]:
    """Blocks on the held-out error after each added effect, and on residuals of the best explanation."""
    channels, steps = _steps_by_channel(document), document["steps"]
    # With too little data nothing was held out: there is one error, in sample, and no stairs.
    if document["verdict"] == "insufficient_data" or not channels:
        return []
    rows = [{"model": "base model" if s["added"] is None else f"+ {words(s['added'])}"}
            | s["held_out_rmse"] for s in steps]  # fmt: skip
    floors = {n: document["channels"].get(n, {}).get("noise_floor") for n in channels}
    caption = "Held-out error of the base model"
    caption += " and after each effect that was added" if len(steps) > 1 else ""
    if any(floor is not None for floor in floors.values()):
        rows.append({"model": "expected of a true model"} | floors)
        caption += _FLOOR + (_MAY_BE_LOWER if document["verdict"] == "unknown_effect" else "")
    columns = [Column("", "model"), *(_of(name) for name in channels)]
    blocks: list[Block] = [
        Figure("staircase", stairs(document)),
        Table(columns, rows, f"{caption}."),
    ]
    scatter = document.get("run_scatter") or {}
    if scatter.get("tau") is not None:
        text = f"From run to run the soil's stiffness differs by {percent(scatter['tau'])}"
        own = [f"{words(n)} by {percent(v)}" for name, v in scatter.items()
               if (n := name.removeprefix("own:")) != name]  # fmt: skip
        blocks.append(Text(f"{text}; in addition, {' and '.join(own)}." if own else f"{text}."))
    return blocks + _what_is_left(document)


def _of(channel: str) -> Column:
    return Column(words(channel), lambda row: shown_value(channel, row.get(channel)), right=True)


def _what_is_left(document: Document) -> list[Block]:
    """Mean residuals of the best explanation over each setting and in each group of rows."""
    if document["verdict"] not in ("unknown_effect", "adequate"):
        return []
    rows = [
        {"channel": entry["channel"], "over": entry.get("setting") or entry.get("group"),
         "parts": entry["parts"]}
        for entry in document.get("residuals_left") or []
    ]  # fmt: skip
    columns = [
        Column("channel", "channel", words), Column("over", "over", words),
        Column("at: mean residual", lambda row: ", ".join(
            f"{setting_words(row['over'], p['at'])}: {_off(p)}" for p in row["parts"])),
    ]  # fmt: skip
    caption = (
        "Residuals of the best explanation: mean of (measured - predicted) / size, with its standard error "
        f"over runs; bold where a part is off by more than {_TOLD:g} of them"
    )
    return [Table(columns, rows, caption, strong=_clearly_off)] if rows else []


def _clearly_off(row: Row) -> bool:
    return any(p["std"] and abs(p["mean"]) > _TOLD * p["std"] for p in row["parts"])


def _off(part: Row) -> str:
    mean = 100.0 * part["mean"]
    shown = f"{mean:+.1f}" if abs(mean) >= 0.05 else "0.0"
    return shown + ("" if part["std"] is None else f" ± {100.0 * part['std']:.1f}") + " %"


def _curve(curve: Row) -> Panel:
    """A plot of a fitted curve that stands for no known effect, over the setting that it depends on."""
    across = display(curve["setting"], unit_of(curve["setting"]))
    x = [across.scale * value for value in curve["x"]]
    if "factor" in curve:
        middle, idle, scale, label = curve["factor"], 1.0, 1.0, f"factor on {curve['stage']}"
    else:
        up = display(ADDED[curve["stage"]], curve["unit"])
        middle, idle, scale, label = curve["added"], 0.0, up.scale, up.label
    none = Layer("line", (x[0], x[-1]), (idle, idle), colour="base")
    y, low, high = ([scale * value for value in c] for c in (middle, curve["low"], curve["high"]))
    return Panel(across.label, label, "", [none, Layer("line", x, y, low, high)])


def unknowable_blocks(document: Document) -> list[Block]:
    """Blocks on effects that could not be tested, and on pairs that the data cannot tell apart."""
    blind = [row for row in document["ranking"] if row["status"] == "not_testable"]
    columns = [Column("effect", "effect", words), Column("why not", "reason")]
    blocks: list[Block] = [Table(columns, blind, "Not testable with this data")] if blind else []
    ties = {
        frozenset((row["effect"], other["effect"])):
        f"{listed([row['effect'], other['effect']])}: {number(other['similarity'], 2)}"
        for row in document["ranking"]
        for other in row.get("confounded_with") or []
    }  # fmt: skip
    if ties:
        about = "Cosine of their changes to the predictions; 1: exactly alike:"
        pairs = "1 pair of effects acts" if len(ties) == 1 else f"{len(ties)} pairs of effects act"
        title = f"{pairs} alike on this data"
        blocks.append(Details(title, [Text(about, [*ties.values()])]))
    return blocks


def next_blocks(document: Document) -> list[Block]:
    """Blocks on the measurements that would decide between effects, and on how to confirm a suspected one."""
    columns = [
        Column("settings", "settings", _settings),
        Column("to tell", "separates", lambda names: to_tell(names or ())),
        count("runs", "runs"), share_of("chance to decide", "expected_power"),
        Column("", "text", lambda text: (text or "").partition("; ")[2]),
    ]  # fmt: skip
    proposals = document["next_measurements"]
    blocks: list[Block] = [Table(columns, proposals)] if proposals else []
    steps = [
        f"{effect_words(row['effect'])}: {row['next_step']}"
        for row in document["ranking"]
        if row["status"] in ("significant", "confounded") and row.get("next_step")
    ]
    return blocks + ([Text("To confirm what is suspected:", steps)] if steps else [])


def _settings(settings: Row | None) -> str:
    return ", ".join(f"{words(n)} {setting_words(n, v)}" for n, v in (settings or {}).items())


def caveats(document: Document) -> list[str]:
    """List sentences that a reader of a diagnosis should keep in mind."""
    notes = [str(note) for note in document["notes"]]
    held_out = "Errors of the diagnosis are held out: each run was predicted by a fit without it."
    return [
        "A named effect is the best explanation among those in the library, not a proof: another cause that "
        "follows the same condition would look the same.",
        *([] if document["verdict"] == "insufficient_data" else [held_out]),
        *grouped(notes),
        *([LAW] if any(_OF_LAW.search(note) for note in notes) else []),
    ]
