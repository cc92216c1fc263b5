# SPDX-License-Identifier: Apache-2.0
"""Whether a law is drafted: what chance, settings that the search never saw, and the vault say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.learn.folds import HeldOut, setting_of
from smallwheel_ros.learn.law import Law
from smallwheel_ros.learn.tangent import Yardstick

Array = NDArray[np.float64]

SURE = 0.02  # p of a draft
_LEAST_FALL = 0.05  # of the held-out error
_LEAST_Z = 1.28  # standard errors of the held-out gain: one in ten by chance
_MAJORITY = 0.5  # of the folds
_STUDENT = 4.0  # degrees of freedom of the loss: one bad extrapolation does not decide


@dataclass(frozen=True)
class Judgement:
    """What held-out errors say.

    reduction: relative fall of the whitened rms. z: mean gain of settings over its standard error.
    agreeing: share of the folds that chose the same drivers.
    """

    reduction: float
    z: float
    agreeing: float

    @classmethod
    def of(cls, held_out: HeldOut, law: Law, fitter: Fitter, fit: Fit) -> Judgement:
        """Judge a law. fit: with the law; its scatter is the yardstick."""
        points = fitter.points
        yardstick = Yardstick(fitter, fit)
        before, after = (
            _by_point(yardstick, points, errors) for errors in (held_out.before, held_out.after)
        )
        row = np.unique(points.row, return_index=True)[1]
        setting = np.unique(setting_of(points)[row], return_inverse=True)[1].reshape(-1)
        gap = np.bincount(setting, _loss(before) - _loss(after))
        error = float(np.std(gap, ddof=1)) / np.sqrt(gap.size)
        most = max(3.0 * float(np.sqrt(np.mean(before**2))), 4.0)
        first, second = (
            float(np.sqrt(np.mean(np.minimum(np.abs(e), most) ** 2))) for e in (before, after)
        )
        same = [_agrees(choice, law) for choice in held_out.choices]
        z = float(gap.mean()) / max(error, 1e-12)
        return cls(1.0 - second / first, z, float(np.mean(same)))

    def verdict(self, p: float) -> tuple[str, tuple[str, ...]]:
        """The verdict, and what speaks against a law. p: of the permutations."""
        against = []
        if p > SURE:
            against.append(f"such a gain comes by chance with p {p:.2g}, and a law needs {SURE:g}")
        if self.reduction <= _LEAST_FALL:
            against.append("on settings that the search never saw the error hardly falls")
        elif self.z <= _LEAST_Z:
            against.append(
                "the fall of the error on settings never seen is within its standard error"
            )
        if against:
            return "weak", tuple(against)
        if self.agreeing < _MAJORITY:
            share = f"{100 * self.agreeing:.0f} %"
            return "unstable", (f"only {share} of the folds choose what it follows",)
        return "law", ()


def _agrees(choice: Law | None, law: Law) -> bool:
    """Whether a fold's law follows the same settings; a constant has its stage only."""
    if choice is None or choice.columns != law.columns:
        return False
    return bool(law.columns) or choice.place.stage == law.place.stage


def _by_point(yardstick: Yardstick, points: Points, errors: dict[str, Array]) -> Array:
    """Whitened errors of the points, shape (channels, points)."""
    names = [points.channels[c] for c in points.channel]
    mean = np.array(
        [np.mean(errors[name][rows]) for name, rows in zip(names, points.rows, strict=True)]
    )
    return np.array([part[:, 0] for part in yardstick.by_channel(yardstick.white(mean)[:, None])])


def _loss(white: Array) -> Array:
    return np.asarray((_STUDENT + 1) / 2 * np.log1p(white**2 / _STUDENT).sum(axis=0))
