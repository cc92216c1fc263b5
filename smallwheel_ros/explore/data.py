# SPDX-License-Identifier: Apache-2.0
"""What a page shows of a session: its table, its effects, and each model that was fitted."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

from smallwheel_ros.compare.comparison import Comparison
from smallwheel_ros.diagnosis import Diagnosis
from smallwheel_ros.explore.session import Count, ExploreError, Names, Session, View
from smallwheel_ros.fitting import FittedParameter
from smallwheel_ros.measurements.columns import CHANNEL_UNITS
from smallwheel_ros.measurements.display import (
    brief,
    display,
    listed,
    number,
    percent,
    sentence,
    shown_value,
    words,
)
from smallwheel_ros.report.diagnosis import diagnosis_page, parameter_cells, verdict_block
from smallwheel_ros.report.effects_section import EffectsPage, Label, Meaning, meaning_of
from smallwheel_ros.report.page import Page
from smallwheel_ros.report.table_data import TableData
from smallwheel_ros.report.wording import in_words, powers

_CAPTION = (
    "Fitted to all runs. log reference pressure is ln of the pressure at 10 mm of sinkage under a wheel "
    "of 0.2 m."
)
_FLOOR = "Expected of a true model: the held-out error that the true model would leave."
_NO_FLOOR = (
    _FLOOR[:-1] + "; not known here: no run was repeated row by row, and no noise is stated."
)
_ERRORS = ["± s.e.", "bias", "expected of a true model", "repeats differ by"]
_PARAMETERS = ["", "parameter", "value", "std", "unit", "bounds", "published", ""]
_KEY = ","


class SessionData:
    """Plain values of a session, for its page. chosen at first: over, the setting of the residuals."""

    def __init__(self, session: Session, over: str | None = None) -> None:
        self.session = session
        self.over = session.setting(over)
        self.base = session.view(session.chosen)
        self.table = TableData(session.measurements, [self.base.after], session.settings)
        self.names = list(session.forms)

    def page(
        self, views: Iterable[Names], first: Collection[str] = (), served: bool = False
    ) -> EffectsPage:
        """What the page's block needs. views: those that are in it. first: what is set at first."""
        session = self.session
        document = session.document
        chances = {row["effect"]: row.get("probability") for row in document["ranking"]}
        floors = {name: known["noise_floor"] for name, known in document["channels"].items()}
        labels = [
            Label(n, session.kinds[n], self._summary(n), chances.get(n), n in first)
            for n in self.names
        ]
        source = session.measurements.source
        file = Path(source).name
        held = document["verdict"] != "insufficient_data"
        table = self.table.data(floors)
        data = {
            "served": served,
            "command": f"smallwheel explore {file}",
            "error": "held-out error" if held else "error on runs left out",
            "effects": [words(name) for name in self.names],
            "base": self.key(session.chosen),
            "table": table,
            "headers": {"base": ["held-out", "RMSE", *_ERRORS], "parameters": _PARAMETERS,
                        "with": ["held-out", "RMSE of the base", "with these", "fall", *_ERRORS]},
            "captions": {"errors": _FLOOR if any(floors.values()) else _NO_FLOOR,
                         "parameters": _CAPTION},
            "views": {self.key(names): self.view(session.view(names)) for names in views},
        }  # fmt: skip
        settings = [(s, table["settings"][s]["label"]) for s in session.settings]
        blocked = [(n, why, n in session.present) for n, why in session.blocked.items()]
        unknown = session.document["verdict"] == "unknown_effect"
        return EffectsPage(data, labels, blocked, settings, self.over, self._meanings(file), served,
                           unknown)  # fmt: skip

    def key(self, names: Collection[str]) -> str:
        """How the page calls a choice of effects."""
        return _KEY.join(str(i) for i, name in enumerate(self.names) if name in names)

    def _summary(self, name: str) -> str:
        effect = self.session.forms[name][0].effect
        return "" if effect is None else effect.summary

    def _meanings(self, file: str) -> list[Meaning]:
        found = []
        for name in self.names:
            effects = [c.effect for c in self.session.forms[name] if c.effect is not None]
            found.append(meaning_of(name, [type(effect) for effect in effects], file))
        return found

    def view(self, view: View) -> dict[str, Any]:
        """One model: what it gains, its errors, what it leaves, its numbers."""
        scores = view.after.scores()
        return {
            "name": f"with {listed(view.names) if view.names else 'no effect'}",
            **self._headline(view),
            "rmse": {name: self._rmse(name, score.rmse, score.rmse_std)
                     for name, score in scores.items()},
            "residual": self.table.residual(view.after),
            "errors": self._errors(view),
            "parameters": self._parameters(view),
            "soils": [
                powers(f"{s.name}: k = {s.k:.4g} Pa/m^(n+m), n = {s.n:.4g}, m = {s.m:.4g}")
                for s in view.fit.bare.soils
            ],
            "formulas": {
                str(i): effect.formula
                for i, name in enumerate(self.names)
                for effect in view.fit.bare.effects
                if effect.id == name
            },
            "notes": [in_words(sentence(note)) for note in view.fit.notes],
        }  # fmt: skip

    def _rmse(self, channel: str, value: float, std: float | None) -> dict[str, Any]:
        scale = display(channel, CHANNEL_UNITS[channel]).scale
        known = None if std is None else std * scale
        return {"value": value * scale, "std": known, "text": number(value * scale)}

    def _headline(self, view: View) -> dict[str, Any]:
        """What the model with these effects gains, and what the diagnosis says of them."""
        before, after = view.before.rmse(), view.after.rmse()
        if view.names == self.session.chosen:
            errors = ", ".join(f"{words(c)} {shown_value(c, after[c])}" for c in after)
            few = self.session.document["verdict"] == "insufficient_data"
            items = [sentence(str(self.session.document["reason"]))] if few else []
            kind = "warning" if few else "result"
            return {"headline": f"The base model: {errors}", "items": items, "kind": kind}
        found = verdict_block(self.session.document)
        falls = ", ".join(
            f"{words(c)} {shown_value(c, before[c])} → {shown_value(c, after[c])}" for c in before
        )
        doubts = self._doubts(view)
        items = [in_words(sentence(line)) for line in doubts] or [
            "This is what the diagnosis names."
        ]
        if doubts:
            items.append(f"The diagnosis: {found.headline[:1].lower() + found.headline[1:]}.")
        return {
            "headline": f"With {listed(view.names) if view.names else 'no effect'}: {falls}",
            "items": items,
            "kind": "warning" if doubts else "result",
        }

    def _doubts(self, view: View) -> list[str]:
        """Why these effects are not what the diagnosis of this data names; empty where they are."""
        session = self.session
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

    def _errors(self, view: View) -> list[list[str]]:
        before, after = view.before.rmse(), view.after.scores()
        channels = self.session.document["channels"]
        base = view.names == self.session.chosen
        rows = []
        for channel, known in channels.items():
            how = display(channel, CHANNEL_UNITS[channel])
            now = after[channel]
            scaled = (before[channel], now.rmse, now.rmse_std, now.bias,
                      known["noise_floor"], known["repeatability"])  # fmt: skip
            cells = [number(None if v is None else v * how.scale) for v in scaled]
            if not base:
                cells.insert(2, percent(view.change.reduction[channel]))
            rows.append([how.label, *cells[base:]])
        return rows

    def _parameters(self, view: View) -> dict[str, Any]:
        known = {e.id: {p.name: p for p in e.parameters()} for e in view.fit.bare.effects}
        forms = {e.id: e.form for e in view.fit.bare.effects}
        rows = []
        for p in view.fit.parameters:
            about = known.get(p.owner, {}).get(p.name)
            published = about.published if about is not None else None
            owner = p.owner
            if owner in forms:
                fault = ", instrument" if self.session.kinds.get(owner) == "instrument" else ""
                owner = f"{words(owner)} ({words(forms[owner])}{fault})"
            cells = parameter_cells(p.unit, p.value, p.std, published)
            rows.append([owner, words(p.name), *cells[:3], _bounds(p), cells[3], _status(p)])
        return {
            "rows": rows,
            "strong": [i for i, p in enumerate(view.fit.parameters) if p.owner in view.names],
        }


def _bounds(parameter: FittedParameter) -> str:
    scale = display("", parameter.unit).scale
    return " to ".join(brief(bound * scale) for bound in parameter.bounds)


def _status(parameter: FittedParameter) -> str:
    if parameter.status == "determined":
        return ""
    return parameter.status + (f": {parameter.remedy}" if parameter.remedy else "")


def explored_page(
    diagnosis: Diagnosis,
    session: Session | None = None,
    comparison: Comparison | None = None,
    progress: Count = lambda done, needed: None,
    pairs: bool = True,
) -> Page:
    """The diagnosis with its effects to set and unset.

    session: where every effect and every pair shall be in it, and not only the steps to the verdict;
    progress: told how many of these fits are done; pairs: whether pairs shall.
    """
    return diagnosis_page(
        diagnosis.document,
        effects=_effects(diagnosis, session, progress, pairs),
        comparison=comparison,
        measurements=diagnosis.measurements,
    )


def _effects(
    diagnosis: Diagnosis, session: Session | None, progress: Count, pairs: bool
) -> EffectsPage | None:
    """What can be set and unset; None where nothing could be held out."""
    try:
        opened = session or Session(diagnosis)
        data = SessionData(opened)
    except ExploreError:
        return None
    views = opened.steps() if session is None else opened.fit_beforehand(progress, pairs)
    return data.page(views, opened.chosen)
