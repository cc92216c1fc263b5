# SPDX-License-Identifier: Apache-2.0
"""What an effect means: a drawing, its formula, what to measure to be sure, a command to copy."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.measurements.display import words
from smallwheel_ros.report.drawings import drawing


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
        sure = f"<p>To be sure: {escape(self.next_step)}</p>" if self.next_step else ""
        copy = (
            f'<div class="copy"><code tabindex="0">{escape(self.command)}</code>'
            '<button type="button">copy</button></div>'
        )
        plain = "" if self.svg else " plain"
        return (
            f'<article class="means{plain}" data-index="{index}" hidden>{self.svg}<div>'
            f"<h3>{escape(words(self.name))}</h3><p>{escape(self.summary)}</p>"
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
