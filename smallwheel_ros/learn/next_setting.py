# SPDX-License-Identifier: Apache-2.0
"""What to measure next: where the tied laws, each fitted to all that there is, disagree most."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from smallwheel_ros.diagnosis.candidate import FAILURES, CandidateFit
from smallwheel_ros.diagnosis.next_measurement import Proposal, propose
from smallwheel_ros.fitting.fit import Fitter
from smallwheel_ros.learn.candidate import Candidate

_COMPARED = 6  # tied laws that the draft is told from


def measure_next(
    fitter: Fitter,
    draft: Candidate,
    tied: Sequence[Candidate],
    limits: Mapping[str, Sequence[float]],
) -> dict[str, Any] | None:
    """The runs that tell the draft from a tied law best; None where none would."""
    best: Proposal | None = None
    others = [c for c in tied if c.law.key != draft.law.key][:_COMPARED]
    for other in others:
        names = draft.law.formula(draft.numbers), other.law.formula(other.numbers)
        models = [CandidateFit((), c.fit, -c.score) for c in (draft, other)]
        try:
            made = propose(fitter, models[0], models[1], names, limits=limits)
        except FAILURES:
            continue
        if made is not None and (best is None or made.expected_power > best.expected_power):
            best = made
    return None if best is None else asdict(best)
