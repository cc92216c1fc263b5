"""Every effect, ranked: what it would explain, whether that is more than chance, and what it is like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from smallwheel_ros.diagnosis.candidates import Family
from smallwheel_ros.diagnosis.held_out import Errors, one_step
from smallwheel_ros.diagnosis.search import Search, best_form, forms_alike, plausible
from smallwheel_ros.diagnosis.table import Lead, Table
from smallwheel_ros.diagnosis.verdict import Finding
from smallwheel_ros.diagnosis.workbench import Explanation

Status = Literal["significant", "not_significant", "not_testable", "confounded"]

_LEAST_LEFT = 0.05  # share of a column that the base cannot imitate
_ALIKE = 0.9


@dataclass(frozen=True)
class FoundParameter:
    """A fitted parameter of an effect. std: None where it is at its bound."""

    name: str
    value: float
    std: float | None
    unit: str
    published: tuple[float, float] | None
    plausible: bool | None


@dataclass(frozen=True)
class Row:
    """One effect. reduction: share of the standardised held-out error that it alone removes."""

    effect: str
    status: Status
    reason: str
    p: float | None = None
    held_out: dict[str, float] | None = None
    reduction: float | None = None
    form: str = ""
    forms_alike: tuple[str, ...] = ()
    parameters: tuple[FoundParameter, ...] = ()
    confounded_with: tuple[tuple[str, float], ...] = ()
    left: float | None = None
    visible: float | None = None
    visible_unit: str = ""


def parameters_of(explanation: Explanation, family: str) -> tuple[FoundParameter, ...]:
    """The fitted parameters of one of an explanation's effects."""
    covariance = explanation.covariance()
    found = []
    for j, slot in enumerate(explanation.layout.slots):
        if not slot.of_effect or explanation.layout.owner_name(slot) != family:
            continue
        effect = explanation.layout.model.effects[slot.owner]
        known = next(p for p in effect.parameters() if p.name == slot.field)
        frozen = bool(explanation.fit.solution.frozen[j])
        std = None if frozen else float(np.sqrt(covariance[j, j]))
        value = float(explanation.theta[j])
        sensible: bool | None = None
        if known.published is not None:
            margin = 2.0 * (std or 0.0)
            sensible = known.published[0] - margin <= value <= known.published[1] + margin
        found.append(FoundParameter(known.name, value, std, known.unit, known.published, sensible))
    return tuple(found)


def _too_small_to_see(lead: Lead) -> str:
    """Why an effect of published size would not have been seen, or an empty string."""
    published = lead.form.parameter.published
    if published is None:
        return ""
    largest = max(abs(bound - lead.form.neutral) for bound in published)
    if lead.visible <= largest:
        return ""
    p = lead.form.parameter
    unit = "" if p.unit == "1" else f" {p.unit}"
    return (
        f"this data would show it only from {p.name} = {lead.visible:.2g}{unit} on; published values "
        f"go to {largest:.2g}"
    )


def _similar(table: Table, family: str) -> tuple[tuple[str, float], ...]:
    if family not in table.names:
        return ()
    i = table.names.index(family)
    found = [
        (name, float(min(abs(table.cosine[i, j]), 1.0)))
        for j, name in enumerate(table.names)
        if j != i and abs(table.cosine[i, j]) >= _ALIKE
    ]
    return tuple(sorted(found, key=lambda pair: -pair[1]))


def rank(search: Search, families: Sequence[Family], finding: Finding) -> list[Row]:
    """All families: those that are named first, then by what they explain alone."""
    base_errors = one_step(search.workbench, search.base)
    rows = [_row(search, family, finding, base_errors) for family in families]
    order = {name: i for i, name in enumerate((*finding.named, *finding.candidates))}

    def place(row: Row) -> tuple[int, int, float]:
        group = {"not_testable": 2}.get(row.status, 1)
        return (
            order.get(row.effect, len(order)) if group == 1 else 10**6,
            group,
            -(row.reduction or 0.0),
        )

    return sorted(rows, key=place)


def _row(search: Search, family: Family, finding: Finding, base_errors: Errors) -> Row:
    if family.blocked:
        return Row(family.name, "not_testable", family.blocked)
    lead = search.first.lead(family.name)
    chosen = (*finding.named, *finding.candidates)
    if lead is None:
        return Row(family.name, "not_testable", "no row is in a condition in which it acts")
    # What this data could show is asked with the named effects in: without them it is all scatter.
    seen = search.last.lead(family.name) or lead
    if family.name not in chosen and lead.p_any >= 0.02:
        reason = _too_small_to_see(seen)
        if seen.left < _LEAST_LEFT:
            share = f"{100 * seen.left:.0f} %"
            reason = f"k, n and m can imitate all but {share} of it with these settings"
        if reason:
            unit = seen.form.parameter.unit
            return Row(
                family.name,
                "not_testable",
                reason,
                left=seen.left,
                visible=seen.visible,
                visible_unit=unit,
            )
    alone = search.workbench.fit(
        (lead.form,), near=search.base, strengths={family.name: lead.strength}
    )
    if lead.gain > 2.0:
        alone = best_form(search.workbench, alone, family)
    errors = one_step(search.workbench, alone)
    shown = search.best if family.name in search.best.families else alone
    form = next(f.effect.form for f in shown.forms if f.family == family.name)
    alike = {f.effect.form for f in forms_alike(search.workbench, shown, family)} - {form}
    status, reason = _status(search, family, finding, lead, shown)
    return Row(
        family.name,
        status,
        reason,
        lead.p_any,
        errors.rmse(),
        1.0 - errors.standardised() / max(base_errors.standardised(), 1e-300),
        form,
        tuple(sorted(alike)),
        parameters_of(shown, family.name),
        _similar(search.first, family.name),
        seen.left,
        seen.visible,
        seen.form.parameter.unit,
    )


def _status(
    search: Search, family: Family, finding: Finding, lead: Lead, shown: Explanation
) -> tuple[Status, str]:
    name = family.name
    if name in finding.named:
        member = next(m for m in search.members if m.family == name)
        return "significant", (
            f"removing it costs {member.gain:.0f} of -2 log likelihood (p {member.p:.1g}), and no other "
            "effect does as well"
        )
    if name in finding.candidates:
        others = [n for pair in finding.pairs if name in pair for n in pair if n != name]
        return "confounded", f"cannot be told from {', '.join(dict.fromkeys(others))}"
    for member in search.members:
        if member.family == name and member.objection:
            return "not_significant", f"not accepted: {member.objection}"
    if lead.p_any >= 0.02:
        return "not_significant", f"explains no more than chance would (p {lead.p_any:.2g})"
    if not plausible(shown, name):
        return "not_significant", "explains something, but only with an implausible strength"
    if finding.named or finding.candidates:
        best = ", ".join((*finding.named, *finding.candidates[:1]))
        return "not_significant", f"explains something alone, but no more once {best} is in"
    return "not_significant", "explains something, but does not help prediction enough"
