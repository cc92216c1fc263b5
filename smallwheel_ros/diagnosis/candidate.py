# SPDX-License-Identifier: Apache-2.0
"""A law that could be missing, and a fitted model with some of them; how one is made from another."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.diagnosis.curves import Span
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.parameters import EffectPart, ParameterVector
from smallwheel_ros.model.model import Geometry

Array = NDArray[np.float64]
Kind = Literal["soil", "instrument", "unknown"]
Key = tuple[tuple[str, str], ...]

FAILURES = (SmallwheelError, ArithmeticError, ValueError, np.linalg.LinAlgError)  # of a fit


@dataclass(frozen=True)
class Competitor:
    """One law that could be missing.

    family: the physical idea; its forms share it. effect: of the library, None for a curve.
    geometry: the contact rule that it brings. replaces: the model has another law of the family. stage,
    span: of a curve; stands_for: stages of effects of which it is the most general form. share: prior
    odds against its absence.
    """

    family: str
    form: str
    kind: Kind
    part: EffectPart
    effect: Effect | None = None
    geometry: Geometry | None = None
    replaces: bool = False
    stage: str = ""
    span: Span | None = None
    stands_for: tuple[str, ...] = ()
    share: float = 1.0

    @property
    def key(self) -> tuple[str, str]:
        """What tells it from all others."""
        return self.family, self.form

    @property
    def strength(self) -> int:
        """Index of the parameter at whose neutral value it is absent."""
        if self.effect is None:
            return 0
        known = self.effect.parameters()
        return next((i for i, p in enumerate(known) if p.neutral is not None), 0)

    @property
    def drivers(self) -> tuple[str, ...]:
        """Settings that it follows."""
        if self.span is not None:
            return () if self.stage == "pressure" else (self.span.column,)
        return () if self.effect is None else self.effect.drivers

    def generalises(self, other: Competitor) -> bool:
        """Whether this curve is the most general form of that named effect."""
        if self.span is None or other.effect is None:
            return False
        kind = type(other.effect)
        if self.stage == "pressure":
            return kind.overrides("pressure_factor")
        if self.span.column not in other.drivers or self.span.side * kind.side < 0:
            return False
        return any(kind.overrides(stage) for stage in self.stands_for)


@dataclass(frozen=True)
class CandidateFit:
    """A fitted model with some competitors. weight: ln of evidence times prior odds."""

    competitors: tuple[Competitor, ...]
    fit: Fit
    weight: float

    @property
    def key(self) -> Key:
        """What tells the model from others."""
        return tuple(sorted(c.key for c in self.competitors))

    @property
    def families(self) -> frozenset[str]:
        """Families of its competitors."""
        return frozenset(c.family for c in self.competitors)


def changed(vector: ParameterVector, put_in: Competitor) -> ParameterVector:
    """The vector with a competitor, in the place of what it replaces."""
    parts = [part for part in vector.parts if part.id != put_in.part.id]
    if put_in.geometry is not None:  # no effect with numbers
        return replace(vector.with_parts(parts), geometry=put_in.geometry)
    return vector.with_parts([*parts, put_in.part])


def refit(
    fitter: Fitter,
    model: CandidateFit,
    put_in: Competitor | None = None,
    start: Array | None = None,
    out: Competitor | None = None,
    turns: int = 4,
) -> CandidateFit | None:
    """A model fitted from where it was, with one competitor more, or less, or another in its place.

    start: of the new competitor's numbers. None where it cannot be fitted.
    """
    near, vector = model.fit, model.fit.vector
    competitors = [c for c in model.competitors if out is None or c.key != out.key]
    if out is not None:
        vector = vector.with_parts([part for part in vector.parts if part.id != out.part.id])
    if put_in is not None:
        competitors.append(put_in)
        vector = changed(vector, put_in)
    theta = vector.begun_at(near.vector, near.theta)
    if put_in is not None:
        theta[vector.places(put_in.part.id)] = put_in.part.start if start is None else start
    # A missing effect inflates the scatter, under which no effect is needed: start without.
    usual, scatter = fitter.variance.start.log_deviation, fitter.variance.suited(near.scatter)
    scatter = replace(scatter, log_deviation=np.minimum(scatter.log_deviation, usual))
    try:
        fit = fitter.fit(vector, theta, scatter, turns=turns)
    except FAILURES:
        return None
    odds = sum(float(np.log(c.share)) for c in competitors)
    return CandidateFit(tuple(competitors), fit, fit.evidence + odds)
