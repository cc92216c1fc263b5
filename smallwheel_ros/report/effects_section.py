# SPDX-License-Identifier: Apache-2.0
"""The part of a page in which effects are set and unset, and what each of them means."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any, NamedTuple

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.measurements.display import probability_text, words
from smallwheel_ros.report.blocks import Drawing
from smallwheel_ros.report.drawings import drawing
from smallwheel_ros.report.wording import inline

_KINDS = {"soil": "Effects", "instrument": "Errors of the instrument"}
_HINT = "The number: probability, from the diagnosis of this data, that the base model lacks the effect."


_PARTS = ("progress", "headline", "stairs", "errors", "residuals", "point")
_PARAMETERS = '<h3>Parameters</h3><div data-part="parameters"></div>'


class Label(NamedTuple):
    """An effect that can be set. kind: soil or instrument. chance: None where none was worked out."""

    name: str
    kind: str
    summary: str
    chance: float | None
    ticked: bool


@dataclass(frozen=True)
class Meaning:
    """One effect in words and in a picture.

    formulas: of its forms; the script says which one was fitted. svg: "" where there is none.
    """

    name: str
    summary: str
    formulas: tuple[str, ...]
    source: str
    next_step: str
    command: str
    svg: str

    def html(self, index: int) -> str:
        """A card that the page's script shows while the effect of that number is set."""
        formulas = '<p class="formula"><code></code></p>'
        if len(self.formulas) > 1:
            listed = "".join(
                f"<li><code>{escape(formula)}</code></li>" for formula in self.formulas
            )
            title = f"The {len(self.formulas)} forms that compete"
            formulas += f"<details><summary>{title}</summary><ul>{listed}</ul></details>"
        source = f'<p class="hint">{escape(self.source)}</p>' if self.source else ""
        sure = f"<p>To be sure: {inline(self.next_step)}</p>" if self.next_step else ""
        copy = (
            f'<div class="copy"><code tabindex="0">{escape(self.command)}</code>'
            '<button type="button">copy</button></div>'
        )
        plain = "" if self.svg else " plain"
        return (
            f'<article class="means{plain}" data-index="{index}" hidden>{self.svg}<div>'
            f"<h3>{escape(words(self.name))}</h3><p>{inline(self.summary)}</p>"
            f"{formulas}{source}{sure}{copy}</div></article>"
        )


def meaning_of(name: str, forms: Sequence[type[Effect]], file: str) -> Meaning:
    """The meaning of an effect by its forms, the best known first. file: of the measurements."""
    first = forms[0] if forms else Effect
    return Meaning(
        name,
        first.summary,
        tuple(dict.fromkeys(form.formula for form in forms if form.formula)),
        first.source,
        first.next_step,
        shlex.join(["smallwheel", "fit", file, "--effects", name, "-o", "model.yaml"]),
        drawing(name, first.summary or words(name)),
    )


class EffectsPage(NamedTuple):
    """What the block shows.

    data: what the script draws. blocked: effects that cannot be set, why, and whether the model has
    them. settings: names and labels; over: the one of the residuals at first. served: a server fits
    what is not in the data. unknown: no known effect explains what is missing, and the server can
    look for a law.
    """

    data: Mapping[str, Any]
    labels: Sequence[Label]
    blocked: Sequence[tuple[str, str, bool]]
    settings: Sequence[tuple[str, str]]
    over: str
    meanings: Sequence[Meaning]
    served: bool = False
    unknown: bool = False

    def block(self) -> Drawing:
        """The block of a page."""
        parts = "".join(f'<div data-part="{name}" class="{name}"></div>' for name in _PARTS)
        cards = "".join(m.html(i) for i, m in enumerate(self.meanings))
        inside = (
            f'<div class="play">{self._form()}<div class="view" data-part="view">{parts}'
            f"{_PARAMETERS}{cards}</div></div>"
        )
        return Drawing("effects", self.data, inside=inside)

    def _form(self) -> str:
        over = "".join(
            f'<option value="{escape(s, quote=True)}"{" selected" if s == self.over else ""}>'
            f"{escape(label)}</option>"
            for s, label in self.settings
        )
        effects = "".join(
            f"<fieldset><legend>{title}</legend>{lines}</fieldset>"
            for kind, title in _KINDS.items()
            if (lines := self._effects(kind))
        )
        save = (
            '<button data-save="1" formaction="model.yaml">Save this model file</button>'
            if self.served
            else ""
        )
        if self.served and self.unknown:
            save += (
                '<button data-save="1" formaction="learn.html" formtarget="_blank">No known effect '
                "explains it: learn a law</button>"
            )
        return (
            f'<form aria-label="effects of the model">{effects}<p class="hint">{_HINT}</p>'
            f'<label>Residuals over <select name="over">{over}</select></label>{save}'
            f"{self._blocked()}</form>"
        )

    def _effects(self, kind: str) -> str:
        lines = []
        for i, label in enumerate(self.labels):
            if label.kind != kind:
                continue
            name, ticked = escape(label.name, quote=True), " checked" if label.ticked else ""
            share = 100.0 * (label.chance or 0.0)
            lines.append(
                f'<label title="{escape(label.summary, quote=True)}"><input type="checkbox" '
                f'name="effects" value="{name}" data-index="{i}"{ticked}>'
                f"<span>{escape(words(label.name))}</span>"
                f'<b style="--part:{share:.0f}%">'
                f"{probability_text(label.chance)}</b></label>"
            )
        return "".join(lines)

    def _blocked(self) -> str:
        """The effects that cannot be set, each with the reason; those in the model are ticked."""
        lines = [
            f'<label class="off"><input type="checkbox" disabled{" checked" if there else ""}>'
            f"<span>{escape(words(name))}<small>{inline(why)}</small></span></label>"
            for name, why, there in self.blocked
        ]
        if not lines:
            return ""
        title = f"{len(lines)} not testable with this data"
        return f"<details><summary>{title}</summary><fieldset>{''.join(lines)}</fieldset></details>"
