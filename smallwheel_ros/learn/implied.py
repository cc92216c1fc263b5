# SPDX-License-Identifier: Apache-2.0
"""What each setting asks of a place: the factor on k, sinkage, ... that makes its measurement right.

Sinkage and resistance ask apart. Where a law acts at that place, both ask for the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.fit import Fit, Fitter, stiffness
from smallwheel_ros.learn.candidate import Candidate
from smallwheel_ros.learn.law import SOUGHT, Place, asked, places_for
from smallwheel_ros.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]

_STEPS = 12  # of Newton's method
_STRIDE = 0.25  # of the furthest shift: longest step
_FAR = 3.0  # ln factor that no setting may ask for: its measurement says nothing of the place
_ENOUGH = 0.5  # share of the points that must say both
_DULL = 0.02  # slope of ln value by ln factor, under which the channel does not show the place


@dataclass(frozen=True)
class Implied:
    """Shifts that the points ask for: ln factors, of n and resistance as they are.

    value, std: by channel, shape (points,), NaN where a channel does not say. row: of each point in
    the conditions.
    """

    row: NDArray[np.intp]
    value: dict[str, Array]
    std: dict[str, Array]

    @property
    def disagreement(self) -> float | None:
        """Mean squared difference of the channels over its variance; None where few points say both."""
        if len(self.value) < 2:
            return None
        a, b = self.value.values()
        sa, sb = self.std.values()
        with np.errstate(invalid="ignore"):
            off = (a - b) ** 2 / (sa**2 + sb**2)
        known = off[np.isfinite(off)]
        return float(np.mean(known)) if known.size >= _ENOUGH * off.size else None


def implied(fitter: Fitter, fit: Fit, place: Place) -> Implied:
    """What each point asks of a place of a model that has no law there.

    fit: the model with its law; the law is taken out and the soil kept, so that what is asked is
    what the law should be.
    """
    points, with_law = fitter.points, fit.model
    others = [e for e in with_law.effects if e.id != SOUGHT]
    model = Model(with_law.soils, with_law.geometry, others, with_law.thrust_form)
    v = fitter.variance.covariance(fit.scatter, stiffness(fit.vector, fit.slopes))
    deviation = np.sqrt(v.variance())
    # A resistance is added to, as it is; any other answer is linear in a ln factor only nearby.
    far, dull = (np.inf, 0.0) if place.stage == "R" else (_FAR, _DULL)
    rows = np.unique(points.row)
    value, std = {}, {}
    for c, name in enumerate(points.channels):
        mine = points.channel == c
        measured, spread = np.full((2, len(points.conditions)), np.nan)
        measured[points.row[mine]] = points.value[mine]
        spread[points.row[mine]] = deviation[mine]
        shift, slope = _solve(model, points.conditions, place, name, measured, far)
        with np.errstate(invalid="ignore"):
            says = (np.abs(slope) > dull * np.abs(measured)) & (np.abs(shift) < far)
        if says.any():
            size = np.where(says, np.abs(slope), np.nan)
            value[name], std[name] = np.where(says, shift, np.nan)[rows], (spread / size)[rows]
    return Implied(rows, value, std)


def _solve(
    model: Model, conditions: Conditions, place: Place, channel: str, measured: Array, far: float
) -> tuple[Array, Array]:
    """Shift at which each row's prediction is as measured, and the prediction's slope by it."""

    def at(shift: Array) -> Array:
        predicted = predict(model + asked(place, shift), conditions)
        return np.asarray(getattr(predicted, channel))

    step = 1.0 if place.stage == "R" else 1e-3
    most = far * _STRIDE
    shift: Array = np.zeros(measured.size)
    for _ in range(_STEPS):
        now = at(shift)
        slope = (at(shift + step) - now) / step
        with np.errstate(all="ignore"):
            move = np.nan_to_num((measured - now) / slope, posinf=0.0, neginf=0.0)
        move = np.clip(move, -most, most)
        shift = np.clip(shift + move, -far, far)
        if np.all(np.abs(move) < 1e-8 * np.maximum(np.abs(shift), 1.0)):
            break
    return shift, slope


def disagreements(
    fitter: Fitter, tied: Sequence[Candidate], best: Candidate
) -> dict[str, float | None]:
    """By stage, how much the channels disagree on what they ask of it: 1 where it is that stage.

    Each stage is judged with its own best law's soil where one is known, else with that of `best`.
    """
    found: dict[str, float | None] = {}
    for place in places_for(fitter.points.channels):
        if place.stage in ("R", "z without resistance") or place.stage in found:
            continue
        mine = next((c for c in tied if c.law.place.stage == place.stage), best)
        found[place.stage] = implied(fitter, mine.fit, place).disagreement
    return found
