"""The page as HTML: the effects on the left, what the model with them says on the right."""

from __future__ import annotations

from collections.abc import Collection
from html import escape
from pathlib import Path

from smallwheel_ros.display import column_display, display, listed, number, shown_value, words
from smallwheel_ros.explore.pictures import view_picture
from smallwheel_ros.explore.session import Session, View
from smallwheel_ros.explore.style import CSS
from smallwheel_ros.fitting import FittedParameter
from smallwheel_ros.measurements.columns import CHANNEL_UNITS
from smallwheel_ros.report.page import Block, Callout, Details, Picture, Table, Text
from smallwheel_ros.report.verdict_section import (
    parameter_cells,
    per_cent,
    said,
    verdict_block,
)

_KINDS = {"soil": "Effects", "instrument": "Errors of the instrument"}


def whole_page(session: Session, names: Collection[str], over: str, shown: str) -> str:
    """The page with these effects set and `shown` on the right; its script asks for others."""
    name = escape(Path(session.measurements.source).name)
    rows, runs = len(session.measurements), session.measurements.runs.size
    over_options = "".join(
        f'<option value="{escape(s)}"{" selected" if s == over else ""}>'
        f"{escape(column_display(session.measurements, s).label)}</option>"
        for s in session.settings
    )
    effects = "".join(
        f"<fieldset><legend>{title}</legend>{lines}</fieldset>"
        for kind, title in _KINDS.items()
        if (lines := _effects(session, names, kind))
    )
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>{name}: explore</title>'
        f"<style>{CSS}</style></head><body><form>"
        f"<h1>{name}</h1><p>{rows} rows, {runs} runs</p>{effects}"
        "<p class=hint>The number: probability, from the diagnosis of this data, that the base model "
        "lacks the effect.</p>"
        f"<label>Residuals over<select name=over>{over_options}</select></label>"
        "<noscript><button>Show</button></noscript>"
        '<button formaction="model.yaml">Save this model file</button>'
        f"{_learn(session)}"
        f"<fieldset>{_blocked(session)}</fieldset></form>"
        f"<main aria-live=polite>{shown}</main>"
        '<script src="explore.js"></script></body></html>\n'
    )


def _learn(session: Session) -> str:
    """The way to a law, where no known effect explains what is missing."""
    if session.document["verdict"] != "unknown_effect":
        return ""
    return (
        "<p class=hint>No known effect explains what is missing.</p>"
        '<button formaction="learn.html" formtarget="_blank">Learn a law (half a minute)</button>'
    )


def _effects(session: Session, names: Collection[str], kind: str) -> str:
    lines = []
    chances = {row["effect"]: row.get("probability") for row in session.document["ranking"]}
    for name, forms in session.forms.items():
        if session.kinds[name] == kind:
            mark = " checked" if name in names else ""
            chance = chances.get(name)
            summary = forms[0].effect.summary if forms[0].effect else ""
            lines.append(
                f'<label title="{escape(summary)}"><input type=checkbox '
                f'name=effects value="{escape(name)}"{mark}>'
                f"<span>{escape(words(name))}</span>"
                f'<b style="--share:{100.0 * (chance or 0.0):.0f}%">'
                f"{'-' if chance is None else f'{chance:.2f}'}</b></label>"
            )
    return "".join(lines)


def _blocked(session: Session) -> str:
    """The effects that cannot be set, each with the reason; those that are in the model are ticked."""
    lines = [
        f"<label class=off><input type=checkbox disabled{' checked' if n in session.present else ''}>"
        f"<span>{escape(words(n))}<small>{escape(why)}</small></span></label>"
        for n, why in session.blocked.items()
    ]
    return "<legend>Not testable with this data</legend>" + "".join(lines) if lines else ""


def view_html(session: Session, view: View, over: str) -> str:
    """What is drawn anew with each change."""
    picture = Picture(
        view_picture(session, view, over),
        "Held out: each run predicted by a fit without it. Grey band: twice the noise floor.",
        f"measured against predicted, and residuals over {words(over)}",
    )
    notes = [said(note) for note in view.fit.notes]
    blocks: list[Block] = [
        _headline(session, view),
        _errors(session, view),
        picture,
        _parameters(session, view),
        _soils(view),
        *([Details("Notes on the fit", [Text(items=notes)])] if notes else []),
    ]
    return "".join(block.html() for block in blocks)


def problem_html(message: str) -> str:
    """A fit or a picture that could not be made."""
    return Callout("This cannot be shown", [said(message)], "warning").html()


def _headline(session: Session, view: View) -> Callout:
    """What the model with these effects gains, and what the diagnosis says of them."""
    found = verdict_block(session.document)
    if view.names == session.chosen:
        return Callout(f"The base model. {found.headline}.", found.items, found.kind)
    before, after = view.before.rmse(), view.after.rmse()
    falls = ", ".join(
        f"{words(c)} {shown_value(c, before[c])} → {shown_value(c, after[c])}" for c in before
    )
    doubts = _doubts(session, view)
    items = [said(line) for line in doubts] or ["This is what the diagnosis names."]
    if doubts:
        items.append(f"The diagnosis: {found.headline[:1].lower() + found.headline[1:]}.")
    return Callout(f"With {listed(view.names) if view.names else 'no effect'}: {falls}", items,
                   "warning" if doubts else "result")  # fmt: skip


def _doubts(session: Session, view: View) -> list[str]:
    """Why these effects are not what the diagnosis of this data names; empty where they are."""
    document = session.document
    rows = {row["effect"]: row for row in document["ranking"]}
    named = {*session.chosen, *document["missing_effects"]}
    lines = [f"the held-out error of {words(c)} rises" for c in view.change.worse]
    if document["verdict"] == "insufficient_data":
        return [*lines, f"{document['reason']}; not recommended"]
    lines += [f"{words(n)}: {rows[n]['reason']}; not recommended"
              for n in view.names if n not in named]  # fmt: skip
    left_out = [n for n in session.forms if n in named and n not in view.names]
    return lines + (
        [f"{listed(left_out)} {'are' if left_out[1:] else 'is'} left out"] if left_out else []
    )


def _errors(session: Session, view: View) -> Table:
    before, after = view.before.rmse(), view.after.scores()
    channels = session.document["channels"]
    base = view.names == session.chosen
    rows = []
    for channel, known in channels.items():
        how = display(channel, CHANNEL_UNITS[channel])
        now = after[channel]
        scaled = (before[channel], now.rmse, now.rmse_std, now.bias,
                  known["noise_floor"], known["repeatability"])  # fmt: skip
        cells = [number(None if v is None else v * how.scale) for v in scaled]
        if not base:
            cells.insert(2, per_cent(view.change.reduction[channel]))
        rows.append([how.label, *cells[base:]])
    header = ["held-out", *(["RMSE"] if base else ["RMSE of the base", "with these", "fall"]), "± s.e.",
              "bias", "noise floor", "repeats differ by"]  # fmt: skip
    caption = "Noise floor: the held-out error that the true model would leave"
    if not any(known["noise_floor"] for known in channels.values()):
        caption += "; not known here: no run was repeated row by row, and no noise is stated"
    return Table(header, rows, caption + ".", numbers=range(1, 8))


def _parameters(session: Session, view: View) -> Table:
    known = {e.id: {p.name: p for p in e.parameters()} for e in view.fit.model.effects}
    forms = {e.id: e.form for e in view.fit.model.effects}
    rows = []
    for p in view.fit.parameters:
        about = known.get(p.owner, {}).get(p.name)
        published = about.published if about is not None else None
        owner = p.owner
        if owner in forms:
            fault = ", instrument" if session.kinds.get(owner) == "instrument" else ""
            owner = f"{words(owner)} ({forms[owner]}{fault})"
        cells = parameter_cells(p.unit, p.value, p.std, published)
        rows.append([owner, p.name, *cells, _status(p)])
    header = ["", "parameter", "value", "std", "unit", "published", ""]
    strong = [i for i, p in enumerate(view.fit.parameters) if p.owner in view.names]
    caption = (
        "Fitted to all runs. log_reference_pressure is ln of the pressure at 10 mm of sinkage under "
        "a wheel of 0.2 m."
    )
    return Table(header, rows, caption, numbers=(2, 3), strong=strong)


def _status(parameter: FittedParameter) -> str:
    if parameter.status == "determined":
        return ""
    return parameter.status + (f": {parameter.remedy}" if parameter.remedy else "")


def _soils(view: View) -> Text:
    return Text(
        items=[
            f"{s.name}: k = {s.k:.4g} Pa/m^(n+m), n = {s.n:.4g}, m = {s.m:.4g}"
            for s in view.fit.model.soils
        ]
    )
