# SPDX-License-Identifier: Apache-2.0
"""From measurements to laws in a file; `verdict.seek` searches for each law."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.arguments import unheard
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.files import write_bytes
from smallwheel_ros.common.result import Result, Writer
from smallwheel_ros.diagnosis.document import plain
from smallwheel_ros.diagnosis.next_measurement import Limits, Proposal, Runs, propose
from smallwheel_ros.diagnosis.pipeline import Start
from smallwheel_ros.effects.registry import Registry, load_effects
from smallwheel_ros.fitting import Problem
from smallwheel_ros.fitting.constants import TIE
from smallwheel_ros.fitting.fit import FAILURES, Fitter
from smallwheel_ros.fitting.parameters import EffectPart, part_of
from smallwheel_ros.learn.document import document, grows, headline, origin, shape_of
from smallwheel_ros.learn.draft import class_text, default_name, file_text, name_problem, numbers_of
from smallwheel_ros.learn.search import LawCandidate
from smallwheel_ros.learn.tangent import Yardstick
from smallwheel_ros.learn.verdict import Progress, Sought, seek
from smallwheel_ros.measurements.measurements import Measurements

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

_COMPARED = 6  # tied laws at most that the next measurements are to tell the draft from


class LearnError(SmallwheelError):
    """A request to `learn` that is impossible."""


@dataclass(frozen=True, repr=False)
class Learnt(Result, shown="views.learnt"):
    """What was learnt: the answer, the laws if there are any, and the searches for them.

    Attributes
    ----------
    document
        The content of the JSON that `smallwheel learn --json` writes.
    source
        Text of the Python file that defines the laws as effects; None if there are none.
    sought
        The searches, one for each law; the last one has no law if there are fewer laws than requested.
    measurements
        The table.
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

    def to_dict(self) -> dict[str, Any]:
        """The document that `smallwheel learn --json` writes."""
        return dict(plain(self.document))

    def rows(self) -> list[dict[str, Any]]:
        """The formulas that fit equally well, best first: formula, stage, drivers, nats above the best."""
        return [{**t, "drivers": ", ".join(t["drivers"])} for t in self.document["tied"]]

    @property
    def tied_curves(self) -> list[Array] | None:
        """Curves of the other tied laws at `x` of the document's `shape`, (x,) each; None without it."""
        problem, best = self.sought[0].problem, self.sought[0].best
        shape = shape_of(problem.fitter, best) if problem and best else None
        return shape and shape[1]

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the correction that each setting needs, and the law. Raises LearnError without a formula."""
        if self.tied_curves is None:
            raise LearnError(f"there is no law of one setting to draw: {self.headline()}")
        return self._drawn(ax)

    def _writers(self) -> dict[str, Writer]:
        def law(path: Path) -> None:
            if self.source is None:
                raise LearnError(f"{path}: no law was drafted, so there is none to save")
            write_bytes(path, self.source.encode())

        return super()._writers() | {".py": law}


def learnt(
    start: Start, name: str | None = None, most: int = 1, progress: Progress = unheard
) -> Learnt:
    """Learn from measurements the laws that a model lacks, if there is evidence for any.

    Parameters
    ----------
    start
        Measurements, and the model without the law.
    name
        Id of the law, with `_2` added for a second one. If None, it is made from the settings on which the
        law depends.
    most
        Largest number of laws to learn, each with those before it in the model.
    progress
        Called with the name of each step, the number of its parts done, and their total (0: not known).

    Raises
    ------
    LearnError
        If the name cannot be an id or is taken, or `most` is under 1.
    """
    measurements, known, without, base = (
        start.measurements,
        start.registry,
        start.without,
        start.base,
    )
    if name is not None and (problem := name_problem(name, known.families)):
        raise LearnError(f"the name of a law: {problem}")
    if most < 1:
        raise LearnError(f"most is {most}, expected the number of laws to learn: 1 or more")
    model = replace(
        base,
        effects=tuple(e for e in base.effects if e.id not in without),
        parts=tuple(p for p in base.parts if p.id not in without),
    )
    searches: list[Sought] = []
    documents: list[dict[str, Any]] = []
    classes: list[str] = []
    for number in range(1, most + 1):
        sought = seek(measurements, model, seed=start.seed, progress=progress)
        id = _id(sought, name, number, known)
        said = document(measurements, sought, id)
        searches.append(sought)
        documents.append(said)
        if sought.problem is None or sought.best is None:
            break
        fitter, law, tied = sought.problem.fitter, sought.best.law, sought.best.tied
        progress("what to measure next", 0, 1)
        said["measure_next"] = _measure_next(fitter, law, tied, start.limits)
        if sought.verdict != "law":
            break
        said["notes"] += _published(sought.problem, law, known, without)
        settings, summary = said["data"]["settings"], f"{grows(said)} {origin(said)}."
        numbers = numbers_of(fitter, law)
        classes.append(class_text(law.law, numbers, id, measurements, settings, len(tied), summary))
        model = replace(model, parts=(*model.parts, _as_loaded(classes[-1], id)))
    first, last = documents[0], documents[-1]
    first["more"] = [d for d in documents[1:] if d["verdict"] == "law"]
    if last is not first and last["verdict"] != "law":
        first["notes"].append(f"a further law: {last['verdict']}; {'; '.join(last['reasons'])}")
    source = file_text(classes) if classes else None
    return Learnt(first, source, tuple(searches), measurements)


def _id(sought: Sought, name: str | None, number: int, registry: Registry) -> str:
    if name is not None:
        return name if number == 1 else f"{name}_{number}"
    made = "learnt" if sought.best is None else default_name(sought.best.law.law)
    return made if number == 1 and made not in registry.families else f"{made}_{number}"


def _as_loaded(written: str, id: str) -> EffectPart:
    """The law as an effect that is loaded from its file. written: text of its class."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "law.py"
        path.write_text(file_text([written]))
        return part_of(load_effects(path)[id][0]())


def _measure_next(
    fitter: Fitter, draft: LawCandidate, tied: Sequence[LawCandidate], limits: Limits
) -> dict[str, Any] | None:
    """The proposal of runs that best tells the draft from a tied law; None if there is none."""
    runs, made = Runs.of(fitter.points, limits), list[Proposal]()
    for other in [c for c in tied if c.law.key != draft.law.key][:_COMPARED]:
        names = draft.law.formula(draft.numbers), other.law.formula(other.numbers)
        with suppress(*FAILURES):
            proposal = propose(fitter, runs, draft.fit, other.fit, names)
            made += [proposal] if proposal else []
    best = max(made, key=lambda proposal: proposal.expected_power, default=None)
    return asdict(best) if best else None


def _published(
    problem: Problem, law: LawCandidate, registry: Registry, without: Collection[str]
) -> list[str]:
    """Notes, one for each published effect of the same settings that fits as well as the draft."""
    fitter, base = problem.fitter, problem.fit.vector
    yardstick = Yardstick(fitter, law.fit)
    observed, conditions = fitter.points.value, fitter.points.conditions
    ours = yardstick.score(observed - law.fit.predicted) + law.cost
    present = {p.id for p in base.parts} | {e.id for e in base.fixed} | set(without)
    forms = [f for id, forms in registry.families.items() for f in forms
             if id not in present and set(f.drivers) == set(law.law.columns) and f.drivers]  # fmt: skip
    as_good = []
    for form in forms:
        if form.never_acts(conditions) or not form.parameters():
            continue
        cost = float(np.log(len(forms)) + 0.5 * len(form.parameters()) * np.log(yardstick.count))
        with suppress(*FAILURES):
            effect = form.suited_to(conditions)
            if effect.objection(conditions):
                continue
            vector = replace(base, parts=(*base.parts, part_of(effect)))
            start = vector.begun_at(law.fit.vector, law.fit.theta)
            fit = fitter.fit(fitter.at(vector, start, law.fit.scatter), turns=0)
            if yardstick.score(observed - fit.predicted) + cost < ours + TIE:
                as_good.append(form.id)
    return [
        f"the library's {id} fits as well, and is published: add it (`smallwheel add`) before this law"
        for id in dict.fromkeys(as_good)
    ]
