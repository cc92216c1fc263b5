"""Geometry before any effect: a base with the closed form (eq. 10) is judged against the integral.

Seen from data of a round wheel, eq. 10 lacks something that other effects would be blamed for. So the
search runs on the contact integral, and what that rule alone is worth is told beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from smallwheel_ros.diagnosis.held_out import Errors, better, one_step, refitted
from smallwheel_ros.diagnosis.ranking import Row
from smallwheel_ros.diagnosis.search import LEAST_FALL, RIVAL_GAP
from smallwheel_ros.diagnosis.verdict import Finding
from smallwheel_ros.diagnosis.workbench import Base, Explanation, Workbench

NAME = "contact_geometry"
FREE_SOIL = (
    "the base model has the closed form (eq. 10): effects were looked for on the contact integral, with "
    "the soil refitted freely, since its numbers belong to eq. 10"
)


@dataclass(frozen=True)
class Geometry:
    """What the contact integral is worth. missing: whether the base lacks it. p: bound of its chance.

    base: the base with eq. 10, and errors: its held-out errors. row: for the ranking.
    """

    missing: bool
    p: float
    base: Explanation
    errors: Errors
    row: Row


def on_the_integral(base: Base) -> Base:
    """The base with the contact integral and nothing believed of the soil beforehand."""
    return replace(base, geometry="contact_integral", priors=None)


def judge_geometry(workbench: Workbench, asked: Base, exact: Explanation) -> Geometry:
    """Put eq. 10 in the place of the integral in what explains the data best.

    workbench: on the integral. asked: the base with eq. 10. exact: the base with what was named.
    Both have the same free parameters, so the ratio of their likelihoods bounds the chance of it
    (Markov's inequality).
    """
    crude = Workbench(workbench.calibration, replace(asked, priors=None))
    base = crude.fit(())
    without = crude.fit(exact.forms, near=exact) if exact.forms else base
    gap = without.cost - exact.cost
    p = float(np.exp(-0.5 * max(gap, 0.0)))
    first, second = one_step(crude, without), one_step(workbench, exact)
    fall, sigmas = better(first, second)
    missing = gap > RIVAL_GAP and fall >= LEAST_FALL and sigmas >= 1.0
    if missing:
        reason = f"eq. 10 in its place costs {gap:.0f} of -2 log likelihood (p under {p:.1g})"
    else:
        reason = "with this data eq. 10 predicts about as well as the contact integral"
    row = Row(
        NAME,
        "significant" if missing else "not_significant",
        reason,
        p,
        second.rmse(),
        1.0 - second.standardised() / max(first.standardised(), 1e-300),
        "contact_integral",
    )
    return Geometry(missing, p, base, refitted(crude, base), row)


def with_geometry(finding: Finding, geometry: Geometry) -> Finding:
    """The verdict with the missing geometry named first."""
    if not geometry.missing:
        return finding
    if finding.verdict == "unknown_effect":
        reason = f"the contact integral explains a part: {geometry.row.reason}"
        return replace(finding, reasons=(*finding.reasons, reason))
    return replace(finding, verdict="missing_effect", named=(NAME, *finding.named))


def with_row(rows: Sequence[Row], geometry: Geometry) -> list[Row]:
    """The ranking with the geometry's own row, first where it is missing."""
    rest = [row for row in rows if row.effect != NAME]
    if geometry.missing:
        return [geometry.row, *rest]
    at = next((i for i, row in enumerate(rest) if row.status == "not_testable"), len(rest))
    return [*rest[:at], geometry.row, *rest[at:]]
