# SPDX-License-Identifier: Apache-2.0
"""Which error of sensors or ground limits the accuracy of a parameter of the soil.

Errors of sensors and ground are part of the filter's state. If a group g of them were known exactly, the
variance v of a parameter would fall by the share

    share = c^T C_gg^-1 c / v,    c = C_g. a

with C the covariance of the state, and a the gradient of the parameter in the state. The group with
the largest share is the limit if its share is over a third; otherwise the amount of data is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from smallwheel_ros.pipeline.tables import Array

from .model import (
    DELAY,
    EACH,
    LOAD_SCALE,
    LOAD_ZERO,
    PASS,
    PITCH,
    SCALE,
    SIDE,
    SLIP,
    WHEELS,
    ZERO,
)

_LIMITS = 1.0 / 3.0  # share of the variance above which a group is a limit
_SHOWS = 2.5  # deviations from 0 above which slip sinkage is reported
# Groups of the state: indices of what all wheels share, and offsets in the numbers of each wheel; the words
# where the group is the limit, and the advice.
_GROUPS = (
    ((ZERO,), (0,), "the zero of the sinkage sensors is known to {mm:.1f} mm",
     "take it with the wheels lifted, and give its deviation as sinkage_zero_std"),
    ((PASS,), (), "how much less a wheel sinks in the rut of another is known to {percent:.0f} %",
     "drive a bend, in which their tracks differ"),
    ((LOAD_SCALE, LOAD_ZERO), (1,), "the scale of the load cells is known to {percent:.0f} %",
     "give vehicle.mass, or check a cell with a known weight"),
    ((SIDE,), (), "the ground under the left and the right wheels may differ by {percent:.0f} %",
     "drive where both are alike"),
    ((SLIP,), (), "what slip adds to the sinkage is known to {value:.1f} times the slip",
     "drive at other slips"),
    ((PITCH,), (), "the sinkage sensors' error with pitch is known to {mm:.1f} mm/rad",
     "drive on level ground"),
    ((DELAY,), (), "the delay of sinkage against load is known to {value:.2f} s", "drive more slowly"),
    ((SCALE,), (), "the scale of the sinkage sensors is known to {percent:.0f} %",
     "check one with a gauge block"),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class StateBelief:
    """State of the soil's filter, with the estimated errors of sensors and ground.

    Attributes
    ----------
    slopes
        Derivatives of (ln pressure at the estimate's reference, n, m) with respect to the state, shape
        (3, size).
    mean, covariance
        Mean and covariance of the state (`soil/model.py`), (size,) and (size, size).
    """

    slopes: Array
    mean: Array
    covariance: Array

    def limits(self, rows: Array) -> list[str]:
        """Describe the error that limits each of some parameters, and what would reduce it.

        Parameters
        ----------
        rows
            Derivatives of the parameters with respect to (ln pressure, n, m), shape (parameters, 3).

        Returns
        -------
        list of str
            In words, one for each parameter; empty where the amount of data is the limit.
        """
        by_state = rows @ self.slopes
        across = by_state @ self.covariance
        whole = np.einsum("ij,ij->i", across, by_state)
        groups = self._groups()
        shares = np.array([self._removed(across, index) for index, _ in groups]) / whole
        largest, limited = shares.argmax(axis=0), shares.max(axis=0) > _LIMITS
        both = zip(largest.tolist(), limited.tolist(), strict=True)
        return [groups[group][1] if known else "" for group, known in both]

    def _groups(self) -> list[tuple[list[int], str]]:
        """Indices in the state of each group, and its words with the deviation of its first number."""
        wheels = range(WHEELS, self.mean.size, EACH)
        groups = []
        for common, each, words, advice in _GROUPS:
            index = [*common, *(first + own for own in each for first in wheels)]
            std = math.sqrt(max(self.covariance[common[0], common[0]], 0.0))
            said = words.format(mm=1e3 * std, percent=100.0 * std, value=std)
            groups.append((index, f"{said}; {advice}"))
        return groups

    def _removed(self, across: Array, index: list[int]) -> Array:
        """By how much the variance of each parameter would fall if a group were known, (parameters,).

        across: gradients of the parameters in the state, times the covariance, (parameters, size). index: of
        the group in the state.
        """
        own, shared = self.covariance[np.ix_(index, index)], across[:, index]
        inverse = np.linalg.pinv(own, hermitian=True)
        return np.asarray(np.einsum("ij,jk,ik->i", shared, inverse, shared))

    @property
    def slip_sinkage(self) -> str:
        """How much sinkage grows with slip, in words; empty where that is below 2.5 standard deviations."""
        value, variance = float(self.mean[SLIP]), float(self.covariance[SLIP, SLIP])
        if value <= _SHOWS * math.sqrt(max(variance, 0.0)):
            return ""
        return f"sinkage grows with slip, s = {value:.1f} +- {math.sqrt(variance):.1f}"
