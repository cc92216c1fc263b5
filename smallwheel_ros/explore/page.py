"""The page as HTML: the effects on the left, what the model with them says on the right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from smallwheel_ros.compare.scores import UNITS
from smallwheel_ros.diagnosis.pipeline import FEWEST_RUNS
from smallwheel_ros.diagnosis.search import LEAST_FALL
from smallwheel_ros.display import brief, column_display, display, number, words
from smallwheel_ros.explore.pictures import view_picture
from smallwheel_ros.explore.session import CLEAR, Session, View
from smallwheel_ros.explore.style import CSS
from smallwheel_ros.fitting.result import FittedParameter
from smallwheel_ros.report.page import Block, Callout, Details, Picture, Table, Text
from smallwheel_ros.report.verdict_section import listed, said, shown_value


def whole_page(
    session: Session, names: Sequence[str], over: str, worth: Mapping[str, float], shown: str
) -> str:
    """The page with these effects set and `shown` on the right; its script asks for others."""
    name = escape(Path(session.measurements.source).name)
    rows, runs = len(session.measurements), session.measurements.runs.size
    over_options = "".join(
        f'<option value="{escape(d)}"{" selected" if d == over else ""}>'
        f"{escape(column_display(session.measurements, d).label)}</option>"
        for d in session.drivers
    )
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>{name}: explore</title>'
        f"<style>{CSS}</style></head><body><form>"
        f"<h1>{name}</h1><p>{rows} rows, {runs} runs</p>"
        f"<fieldset><legend>Effects</legend>{_effects(session, names, worth)}</fieldset>"
        "<p class=hint>The number: what the effect is worth beside the others that are set, as a "
        f"fall of -2 log likelihood (estimated until it is set). Up to about {CLEAR:g} may be "
        "chance.</p>"
        f"<label>Residuals over<select name=over>{over_options}</select></label>"
        "<noscript><button>Show</button></noscript>"
        '<button formaction="model.yaml">Save this model file</button>'
        f"<fieldset>{_blocked(session)}</fieldset></form>"
        f"<main aria-live=polite>{shown}</main>"
        '<script src="explore.js"></script></body></html>\n'
    )


def _effects(session: Session, names: Sequence[str], worth: Mapping[str, float]) -> str:
    lines = []
    for family in session.families.values():
        if not family.blocked:
            mark = " checked" if family.name in names else ""
            value = worth.get(family.name, 0.0)
            lines.append(
                f'<label title="{escape(family.forms[0].effect.summary)}"><input type=checkbox '
                f'name=effects value="{escape(family.name)}"{mark}>'
                f"<span>{escape(words(family.name))}</span><b data-effect="
                f'"{escape(family.name)}" style="--worth:{value:.0f}%">{value:.0f}</b></label>'
            )
    return "".join(lines)


def _blocked(session: Session) -> str:
    """The effects that cannot be set, each with the reason; those that are in the model are ticked."""
    lines = [
        f"<label class=off><input type=checkbox disabled{' checked' if n in session.present else ''}>"
        f"<span>{escape(words(n))}<small>{escape(family.blocked)}</small></span></label>"
        for n, family in session.families.items()
        if family.blocked
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
        _parameters(view),
        _soils(view),
        *([Details("Notes on the fit", [Text(items=notes)])] if notes else []),
    ]
    return "".join(block.html() for block in blocks)


def problem_html(message: str) -> str:
    """A fit or a picture that could not be made."""
    return Callout("This cannot be shown", [said(message)], "warning").html()


def _headline(session: Session, view: View) -> Callout:
    few = []
    if session.runs < FEWEST_RUNS:
        few.append(
            f"{session.runs} runs: under {FEWEST_RUNS} nothing can be told from the scatter of the soil"
        )
    if not view.names:
        lines = ["Set an effect on the left: everything is fitted and drawn anew."]
        return Callout("The base model, without any effect", [*lines, *few],
                       "warning" if few else "result")  # fmt: skip
    before, after = view.before.rmse(), view.after.rmse()
    falls = ", ".join(
        f"{words(c)} {shown_value(c, before[c])} → {shown_value(c, after[c])}" for c in before
    )
    lines = few + [
        f"the fitted strength of {words(name)} is at a bound or outside the published range"
        for name in view.implausible
    ]
    lines += [
        f"{words(name)} is worth no more than chance beside the others"
        for name in view.names
        if view.worth[name] < CLEAR and name not in view.implausible
    ]
    if view.fall <= 0.0:
        lines.insert(0, "the error did not fall: not recommended")
    elif view.fall < LEAST_FALL:
        lines.insert(0, f"the error fell by {100 * view.fall:.1f} % only: not recommended")
    elif view.sigmas < 1.0:
        lines.insert(0, "the error fell by less than its own uncertainty: not recommended")
    headline = f"With {listed(view.names)}: {falls}"
    return Callout(headline, [said(line) for line in lines], "warning" if lines else "result")


def _errors(session: Session, view: View) -> Table:
    before, after = view.before.rmse(), view.after.rmse()
    stds, bias = view.after.rmse_std(), view.after.bias()
    rows = []
    for channel in before:
        how = display(channel, UNITS[channel])
        std, repeats = stds[channel], session.repeats.get(channel)
        fall = 100.0 * (1.0 - after[channel] / before[channel]) if before[channel] > 0 else 0.0
        scaled = (
            before[channel],
            after[channel],
            std,
            bias[channel],
            view.floor.get(channel),
            repeats,
        )
        cells = [number(None if v is None else v * how.scale) for v in scaled]
        rows.append([how.label, *cells[:2], f"{fall:.0f} %" if view.names else "-", *cells[2:]])
    header = ["held-out RMSE", "without effects", "with", "fall", "± s.e.", "bias", "noise floor",
              "repeats differ by"]  # fmt: skip
    caption = "Noise floor: the held-out error that the true model would leave"
    if not view.floor:
        caption += "; not known here, since no setting was repeated and no noise is stated"
    elif session.floor_with:
        seen = listed(session.floor_with)
        caption += f", as seen with {seen} in; lower, if something else is missing still"
    return Table(header, rows, caption + ".", numbers=range(1, 8))


def _parameters(view: View) -> Table:
    known = {e.id: {p.name: p for p in e.parameters()} for e in view.fit.model.effects}
    forms = {e.id: e.form for e in view.fit.model.effects}
    rows = []
    for p in view.fit.parameters:
        about = known.get(p.owner, {}).get(p.name)
        published = about.published if about is not None else None
        owner = f"{words(p.owner)} ({forms[p.owner]})" if p.owner in forms else p.owner
        unit = "" if p.unit == "1" else p.unit.replace(" ", "\u00a0")  # on one line
        rows.append([
            owner, p.name, number(p.value, 4), number(p.std), unit,
            "-" if published is None else f"{brief(published[0])} to {brief(published[1])}",
            _status(p),
        ])  # fmt: skip
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
