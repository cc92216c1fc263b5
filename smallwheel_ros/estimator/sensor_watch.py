# SPDX-License-Identifier: Apache-2.0
"""What a technician should look at: sensors that are stuck, off, late, or at odds with the others."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from smallwheel_ros.estimator.identifiability import DETERMINED
from smallwheel_ros.estimator.law_filter import LawFilter
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

_STUCK = 2  # segments in a row with one number throughout
_WINDOW = 30  # segments of one wheel: 6 m
_SURE = 3.0  # standard deviations
_TOLD = 1e-6  # deviation of a nuisance that is taken to be there
# In the order in which they are said.
_FAULTS = (ZERO, DELAY, PITCH, PASS, LOAD_SCALE, SIDE, LOAD_ZERO, SLIP)
# Mean normalised innovation of a wheel: five standard deviations of the mean of so many neighbours
# that are alike by the soil's texture.
_AT_ODDS = 1.2


def _fault(place: int, x: float) -> str:
    """What a number of the state that stands for a fault says, in words."""
    return {
        ZERO: f"all sinkage sensors show {1e3 * x:+.1f} mm too much: set their zero on firm ground",
        DELAY: f"sinkage comes {abs(x):.2f} s {'behind' if x > 0 else 'before'} the load: check the "
        "stamps of both topics",
        PITCH: f"sinkage is shown {1e3 * x * math.radians(1.0):+.2f} mm per degree of pitch too deep: "
        "check how the sensor is mounted",
        PASS: f"wheels that follow in a rut sink {math.exp(x):.2f} times as deep as the first ones",
        LOAD_SCALE: f"the load cells show {math.exp(x):.2f} times the load: calibrate them",
        SIDE: f"the ground under the {'left' if x > 0 else 'right'} wheels is "
        f"{math.exp(2.0 * abs(x)):.1f} times as stiff as that under the others",
        LOAD_ZERO: f"the load cells show {100 * x:+.0f} % of a wheel's load too much whatever the load: "
        "set their zero",
        SLIP: f"wheels sink by {100 * x:.0f} % of their slip deeper: slip sinkage",
    }[place]


def _fault_of(wheel: str, zero: float, scale: float) -> tuple[str, str]:
    """The same of the zero and the scale of one wheel's sensors."""
    return (
        f"wheel '{wheel}': the sinkage sensor shows {1e3 * zero:+.1f} mm more than those of the other "
        "wheels: set its zero",
        f"wheel '{wheel}': the load cell shows {math.exp(scale):.2f} times what those of the other "
        "wheels say: calibrate it",
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

    def findings(self, law: LawFilter, names: Sequence[str]) -> tuple[str, ...]:
        """What seems wrong, in words. names: of the wheels, in the order of the law's state."""
        mean, covariance, prior = law.mean, law.covariance, law.prior_deviations
        deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        known = (prior > _TOLD) & (deviation < DETERMINED * prior)
        sure = known & (np.abs(mean) > _SURE * deviation)
        of_all = [_fault(place, float(mean[place])) for place in _FAULTS if sure[place]]
        of_one = []
        for i, name in enumerate(names):
            own = slice(WHEELS + EACH * i, WHEELS + EACH * (i + 1))
            words = _fault_of(name, *mean[own].tolist())
            of_one += [text for text, is_sure in zip(words, sure[own], strict=True) if is_sure]
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
