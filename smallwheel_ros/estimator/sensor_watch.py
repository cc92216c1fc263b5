# SPDX-License-Identifier: Apache-2.0
"""What a technician should look at: sensors that are stuck, off, late, or at odds with the others."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.identifiability import DETERMINED
from smallwheel_ros.estimator.law_model import (
    DELAY,
    EACH,
    LOAD_SCALE,
    LOAD_ZERO,
    PASS,
    PITCH,
    SIDE,
    SLIP,
    WHEELS,
    ZERO,
)
from smallwheel_ros.estimator.segment import Segment

Array = NDArray[np.float64]

_STUCK = 2  # segments in a row with one number throughout
_WINDOW = 30  # segments of one wheel: 6 m
_SURE = 3.0  # standard deviations
# Mean normalised innovation of a wheel: five standard deviations of the mean of so many neighbours
# that are alike by the soil's texture.
_AT_ODDS = 1.2


class _Nuisance(NamedTuple):
    """A part of the state that stands for a fault, and what to say of it."""

    place: int
    words: Callable[[float], str]


_NUISANCES = (
    _Nuisance(
        ZERO,
        lambda x: (
            f"all sinkage sensors show {1e3 * x:+.1f} mm too much: set their zero on firm ground"
        ),
    ),
    _Nuisance(
        DELAY,
        lambda x: (
            f"sinkage comes {abs(x):.2f} s {'behind' if x > 0 else 'before'} the load: check the "
            "stamps of both topics"
        ),
    ),
    _Nuisance(
        PITCH,
        lambda x: (
            f"sinkage is shown {1e3 * x * math.radians(1.0):+.2f} mm per degree of pitch too deep: "
            "check how the sensor is mounted"
        ),
    ),
    _Nuisance(
        PASS,
        lambda x: (
            f"wheels that follow in a rut sink {math.exp(x):.2f} times as deep as the first ones"
        ),
    ),
    _Nuisance(
        LOAD_SCALE,
        lambda x: f"the load cells show {math.exp(x):.2f} times the load: calibrate them",
    ),
    _Nuisance(
        SIDE,
        lambda x: (
            f"the ground under the {'left' if x > 0 else 'right'} wheels is "
            f"{math.exp(2.0 * abs(x)):.1f} times as stiff as that under the others"
        ),
    ),
    _Nuisance(
        LOAD_ZERO,
        lambda x: (
            f"the load cells show {100 * x:+.0f} % of a wheel's load too much whatever the load: set "
            "their zero"
        ),
    ),
    _Nuisance(SLIP, lambda x: f"wheels sink by {100 * x:.0f} % of their slip deeper: slip sinkage"),
)


class SensorWatch:
    """Follows the segments of each wheel and the nuisances of the state."""

    def __init__(self) -> None:
        self._stuck: dict[str, tuple[int, float]] = {}  # segments in a row, and what is shown
        self._off: dict[str, deque[float]] = {}

    def add(self, segment: Segment) -> None:
        """Take a segment, whatever becomes of it."""
        count, shown = self._stuck.get(segment.wheel, (0, 0.0))
        same = count == 0 or segment.sinkage == shown
        count = count + 1 if segment.stuck and same else int(segment.stuck)
        self._stuck[segment.wheel] = count, segment.sinkage

    def judge(self, segment: Segment, normalised: float) -> None:
        """Take a segment's normalised innovation."""
        self._off.setdefault(segment.wheel, deque(maxlen=_WINDOW)).append(normalised)

    def is_stuck(self, wheel: str) -> bool:
        """Whether a wheel's sinkage sensor has shown one number for some way."""
        return self._stuck.get(wheel, (0, 0.0))[0] >= _STUCK

    def findings(
        self, mean: Array, covariance: Array, prior: Array, names: Sequence[str]
    ) -> tuple[str, ...]:
        """What seems wrong, in words.

        mean, covariance: of the state; prior: its deviations. names: of the wheels, in its order.
        """
        of_all = [
            nuisance.words(float(mean[nuisance.place]))
            for nuisance in _NUISANCES
            if _is_sure(mean, covariance, prior, nuisance.place)
        ]
        of_one = []
        for i, name in enumerate(names):
            zero, scale = WHEELS + EACH * i, WHEELS + EACH * i + 1
            if _is_sure(mean, covariance, prior, zero):
                of_one.append(
                    f"wheel '{name}': the sinkage sensor shows {1e3 * mean[zero]:+.1f} mm more than "
                    "those of the other wheels: set its zero"
                )
            if _is_sure(mean, covariance, prior, scale):
                of_one.append(
                    f"wheel '{name}': the load cell shows {math.exp(mean[scale]):.2f} times what those "
                    "of the other wheels say: calibrate it"
                )
        return (*self.of_wheels(), *of_all, *of_one)

    def of_wheels(self) -> tuple[str, ...]:
        """Sensors that are stuck, and wheels that disagree with the others, in words."""
        found = [
            f"wheel '{wheel}': the sinkage sensor shows {1e3 * shown:.2f} mm without change while "
            "the wheel rolls: it is stuck, and not used; check its driver"
            for wheel, (count, shown) in self._stuck.items()
            if count >= _STUCK
        ]
        means = {w: sum(off) / len(off) for w, off in self._off.items() if len(off) == _WINDOW}
        for wheel, mean in means.items():
            others = [value for name, value in means.items() if name != wheel]
            if len(others) < 2:
                continue
            rest = float(np.median(others))
            if abs(mean - rest) > _AT_ODDS and abs(mean) > 2.0 * abs(rest):
                side = "more" if mean > 0 else "less"
                found.append(
                    f"wheel '{wheel}': for {_WINDOW} stretches it has shown {side} sinkage than the "
                    "other wheels agree on: check its load cell and its sinkage sensor"
                )
        return tuple(found)


def _is_sure(mean: Array, covariance: Array, prior: Array, index: int) -> bool:
    deviation = math.sqrt(max(float(covariance[index, index]), 0.0))
    told = float(prior[index])
    return (
        told > 1e-6
        and deviation < DETERMINED * told
        and abs(float(mean[index])) > _SURE * deviation
    )
