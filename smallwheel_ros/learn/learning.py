# SPDX-License-Identifier: Apache-2.0
"""Laws one after the other, and all that is said of them: `learn`."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from smallwheel_ros.diagnosis.candidate import FAILURES
from smallwheel_ros.diagnosis.document import plain
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.registry import Registry, default_registry, load_effects
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.fitting import Base
from smallwheel_ros.fitting.constants import TIE
from smallwheel_ros.fitting.parameters import part_of
from smallwheel_ros.learn.document import Shape, document, shape_of
from smallwheel_ros.learn.draft import (
    class_text,
    default_name,
    file_name_problem,
    file_text,
    numbers_of,
)
from smallwheel_ros.learn.next_setting import measure_next
from smallwheel_ros.learn.pipeline import Judged, Progress, Sought, seek, silent
from smallwheel_ros.learn.tangent import Yardstick
from smallwheel_ros.learn.text import headline, learnt_text, summary
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.output import write_bytes
from smallwheel_ros.results import Result, Writer, axes_or_new, picture_writers

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class LearnError(SmallwheelError):
    """Something that is asked of `learn` and makes no sense."""


@dataclass(frozen=True, repr=False)
class Learnt(Result):
    """What was learnt. document: as the JSON. source: the file of the laws, None without any.

    sought: each search, the last one without a law where fewer than asked for were found.
    """

    document: dict[str, Any]
    source: str | None
    sought: tuple[Sought, ...]
    measurements: Measurements

    @property
    def verdict(self) -> str:
        """law, unstable, weak, nothing or refused."""
        return str(self.document["verdict"])

    @property
    def law(self) -> dict[str, Any] | None:
        """The first law as the document has it: id, stage, drivers, formula, constants, range."""
        law: dict[str, Any] | None = self.document["law"]
        return law

    def headline(self) -> str:
        """The answer in a sentence."""
        return headline(self.document)

    def text(self) -> str:
        """As `smallwheel learn` prints it."""
        return learnt_text(self.document)

    def to_dict(self) -> dict[str, Any]:
        """As `smallwheel learn --json` writes it."""
        return dict(plain(self.document))

    def rows(self) -> list[dict[str, Any]]:
        """The formulas that fit, the best first."""
        return [{**t, "drivers": ", ".join(t["drivers"])} for t in self.document["tied"]]

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw what each setting asks for, and the law. Raises LearnError without a formula."""
        from smallwheel_ros.pictures.learnt import draw_learnt

        shape = self.shape
        if shape is None:
            raise LearnError(f"there is no law of one setting to draw: {self.headline()}")
        return draw_learnt(axes_or_new(ax), self.document, shape.tied)

    @property
    def shape(self) -> Shape | None:
        """The first law over what it follows; None where that is not one setting."""
        best = self.sought[0].best
        return None if best is None else shape_of(best)

    def _writers(self) -> dict[str, Writer]:
        def page(path: Path) -> None:
            from smallwheel_ros.report.learn_report import learn_page
            from smallwheel_ros.report.page import write_page

            write_page(path, learn_page(self))

        def law(path: Path) -> None:
            if self.source is None:
                raise LearnError(f"{path}: no law was drafted, so there is none to save")
            write_bytes(path, self.source.encode())

        return picture_writers(self.plot) | {".html": page, ".py": law}


def learn(
    measurements: Measurements,
    base: Base | None = None,
    *,
    registry: Registry | None = None,
    without: Collection[str] = (),
    name: str | None = None,
    most: int = 1,
    seed: int = 0,
    limits: Mapping[str, Sequence[float]] | None = None,
    progress: Progress = silent,
) -> Learnt:
    """Learn a law that a model lacks from measurements, as far as they can tell.

    Parameters
    ----------
    measurements
        The table.
    base
        What the model has already; the contact integral and nothing else where None.
    registry
        Published effects that a law is held against; those of the library where None.
    without
        Ids of effects that are taken out of the model, and that the law is not held against.
    name
        Id of the law; made of what it follows where None. A second law has `_2` after it.
    most
        Laws to learn, one after the other, each with those before it in the model.
    seed
        The same seed gives the same answer, to the byte.
    limits
        By setting (SI), the levels that the user can set, for what to measure next.
    progress
        Told each step in words, how many are done, and of how many (0: not known).

    Raises
    ------
    LearnError
        Where name or most make no sense.
    """
    known = registry or default_registry()
    if name is not None and (problem := file_name_problem(name) or _taken(name, known)):
        raise LearnError(f"the name of a law: {problem}")
    if most < 1:
        raise LearnError(f"most is {most}, expected the number of laws to learn: 1 or more")
    model = _without(base or Base(), without)
    searches: list[Sought] = []
    documents: list[dict[str, Any]] = []
    classes: list[str] = []
    for number in range(1, most + 1):
        sought = seek(measurements, model, seed=seed, progress=progress)
        id = _id(sought, name, number, known)
        said = document(measurements, sought, id)
        searches.append(sought)
        documents.append(said)
        best = sought.best
        if best is None:
            break
        progress("what to measure next", 0, 1)
        said["measure_next"] = measure_next(best.problem.fitter, best.law, best.tied, limits or {})
        if sought.verdict != "law":
            break
        said["notes"] += _published(best, known, without)
        written = class_text(
            best.law.law, numbers_of(best.problem.fitter, best.law), id, measurements,
            said["data"]["settings"], len(best.tied), summary(said),
        )  # fmt: skip
        classes.append(written)
        model = replace(model, parts=(*model.parts, part_of(_effect(written, id))))
    first = documents[0]
    first["more"] = [d for d in documents[1:] if d["verdict"] == "law"]
    first["notes"] += _after_first(documents)
    source = file_text(classes) if classes else None
    return Learnt(first, source, tuple(searches), measurements)


def _without(base: Base, ids: Collection[str]) -> Base:
    """The base without these effects."""
    return replace(
        base,
        effects=tuple(e for e in base.effects if e.id not in ids),
        parts=tuple(p for p in base.parts if p.id not in ids),
    )


def _taken(name: str, registry: Registry) -> str:
    taken = name in registry.families
    return f"'{name}' is the id of an effect that exists already" if taken else ""


def _id(sought: Sought, name: str | None, number: int, registry: Registry) -> str:
    if name is not None:
        return name if number == 1 else f"{name}_{number}"
    made = "learnt" if sought.best is None else default_name(sought.best.law.law)
    return made if number == 1 and made not in registry.families else f"{made}_{number}"


def _effect(written: str, id: str) -> Effect:
    """The law as whoever loads its file gets it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "law.py"
        path.write_text(file_text([written]))
        return load_effects(path)[id][0]()


def _after_first(documents: Sequence[Mapping[str, Any]]) -> list[str]:
    if len(documents) < 2 or documents[-1]["verdict"] == "law":
        return []
    return [f"a further law: {documents[-1]['verdict']}; {'; '.join(documents[-1]['reasons'])}"]


def _published(best: Judged, registry: Registry, without: Collection[str]) -> list[str]:
    """Published effects of the same settings that fit as well as the draft, in words."""
    law, fitter, base = best.law, best.problem.fitter, best.problem.fit
    yardstick = Yardstick(fitter, law.fit)
    observed, conditions = fitter.points.value, fitter.points.conditions
    ours = yardstick.score(observed - law.fit.predicted) + law.cost
    present = {p.id for p in base.vector.parts} | {e.id for e in base.vector.fixed} | set(without)
    forms = [f for id, forms in registry.families.items() for f in forms
             if id not in present and set(f.drivers) == set(law.law.columns) and f.drivers]  # fmt: skip
    as_good = []
    for form in forms:
        if form.never_acts(conditions) or not form.parameters():
            continue
        try:
            effect = form.suited_to(conditions)
            if effect.objection(conditions):
                continue
            vector = base.vector.with_parts([*base.vector.parts, part_of(effect)])
            start = vector.begun_at(law.fit.vector, law.fit.theta)
            fit = fitter.fit(vector, start, law.fit.scatter, turns=0)
        except FAILURES:
            continue
        cost = float(np.log(len(forms)) + 0.5 * len(form.parameters()) * np.log(yardstick.count))
        score = yardstick.score(observed - fit.predicted) + cost
        if score < ours + TIE:
            as_good.append(form.id)
    return [
        f"the library's {id} fits as well, and is published: `smallwheel add {id}` before this law"
        for id in dict.fromkeys(as_good)
    ]
