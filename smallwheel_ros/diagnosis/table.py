"""Look at a fitted explanation: what each further effect would gain, against chance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.candidates import Family, Form
from smallwheel_ros.diagnosis.generic import generic_columns, soil_columns
from smallwheel_ros.diagnosis.score import (
    Columns,
    Scores,
    group_maximum,
    join,
    p_value,
    scores,
    sensitivities,
    simulate,
)
from smallwheel_ros.diagnosis.workbench import Explanation, Workbench

Array = NDArray[np.float64]

_BEST_PAIRS = 3
GENERIC = "generic:"  # groups of columns that no effect of the library stands for
SOIL = "soil:"  # the same, of the soil's stiffness


@dataclass(frozen=True)
class Lead:
    """What one family promises, by its best column: where to start its fit, and how well it shows.

    gain: improvement of -2 log restricted likelihood. p: of a gain this large from this family under
    "nothing is missing"; p_any: from any family. left: share of its column that the base cannot
    imitate. visible: smallest strength that would have been seen (critical gain, half the time).
    """

    family: str
    form: Form
    shape: dict[str, float]
    gain: float
    strength: float
    deviation: float
    left: float
    visible: float
    p: float
    p_any: float


@dataclass(frozen=True)
class Table:
    """All leads at an explanation, the best first.

    p_any: of the largest gain. p_generic, generic: of the largest gain of a column that stands for no
    effect (one channel's error over one setting), and its name. p_soil, soil: the same of the soil's
    stiffness over one setting. critical: gain at p 0.02.
    cosine: of the families' best columns, after the base took its share; shape (families, families).
    """

    leads: tuple[Lead, ...]
    p_any: float
    critical: float
    p_generic: float
    generic: str
    generic_gain: float
    p_soil: float
    soil: str
    soil_gain: float
    names: tuple[str, ...]
    cosine: Array

    def lead(self, family: str) -> Lead | None:
        """The lead of that family."""
        return next((lead for lead in self.leads if lead.family == family), None)


def look(
    workbench: Workbench,
    explanation: Explanation,
    families: Sequence[Family],
    *,
    draws: int,
    seed: int,
    nuisance: Array | None = None,
    generic: bool = False,
    critical: float | None = None,
) -> Table:
    """Score every family at an explanation.

    nuisance: columns (observations, n) that may explain before any effect does, each with a coefficient
    of about 1: other forms of the effects that are in already. critical: used where draws is 0.
    """
    columns = sensitivities(explanation, families, workbench.effects)
    names = tuple(f.name for f in families if columns.of(f.name).size)
    if generic:
        columns = join(columns, generic_columns(explanation, GENERIC))
        columns = join(columns, soil_columns(explanation, SOIL))
    design, precision = explanation.design, explanation.precision
    if nuisance is not None and nuisance.shape[1]:
        design = np.column_stack([design, nuisance])
        size = precision.shape[0]
        wider = np.eye(design.shape[1])
        wider[:size, :size] = precision
        precision = wider
    tau = explanation.fit.scatter.tau
    responses = explanation.residual[:, None]
    if draws:
        generator = np.random.default_rng([seed, 7, len(explanation.forms)])
        null = simulate(workbench.effects, tau, draws, generator)
        responses = np.column_stack([responses, null])
    found = scores(workbench.effects, workbench.typical, tau, design, precision, columns, responses)
    return _table(columns, found, names, draws, critical)


def _table(
    columns: Columns, found: Scores, names: tuple[str, ...], draws: int, critical: float | None
) -> Table:
    gains = group_maximum(found.statistic, columns, names)
    null = gains[:, 1:].max(axis=0) if names and draws else np.zeros(0)
    edge = float(np.quantile(null, 0.98)) if null.size else (critical or 10.0)
    best = []
    leads = []
    for i, name in enumerate(names):
        rows = columns.of(name)
        row = rows[int(np.argmax(found.statistic[rows, 0]))]
        best.append(row)
        form = columns.forms[row]
        assert form is not None
        deviation = float(found.deviation[row])
        leads.append(
            Lead(
                name,
                form,
                columns.shapes[row],
                float(gains[i, 0]),
                form.neutral + float(found.strength[row]),
                deviation,
                float(found.left[rows].max()),
                float(np.sqrt(max(edge, 1.0)) * deviation),
                p_value(gains[i, 0], gains[i, 1:]) if draws else 1.0,
                p_value(gains[i, 0], null) if draws else 1.0,
            )
        )
    order = sorted(range(len(leads)), key=lambda i: -leads[i].gain)
    rows = np.array([best[i] for i in order], dtype=np.intp)
    return Table(
        tuple(leads[i] for i in order),
        min((leads[i].p_any for i in order), default=1.0),
        edge,
        *_largest(columns, found, GENERIC, draws),
        *_largest(columns, found, SOIL, draws),
        tuple(leads[i].family for i in order),
        found.cosine[np.ix_(rows, rows)] if rows.size else np.zeros((0, 0)),
    )


def _largest(columns: Columns, found: Scores, prefix: str, draws: int) -> tuple[float, str, float]:
    """Of the groups with that prefix: p-value of the largest gain, whose it is, and its size."""
    groups = sorted({g for g in columns.groups if g.startswith(prefix)})
    if not groups:
        return 1.0, "", 0.0
    gains = group_maximum(found.statistic, columns, groups)
    gain = float(gains[:, 0].max())
    p = p_value(gain, gains[:, 1:].max(axis=0)) if draws else 1.0
    return p, groups[int(np.argmax(gains[:, 0]))].removeprefix(prefix), gain
