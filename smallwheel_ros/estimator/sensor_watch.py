# SPDX-License-Identifier: Apache-2.0
"""What a technician should look at: sensors that are stuck, off, late, or at odds with the others."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

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
from smallwheel_ros.estimator.soil_filter import LawFilter
from smallwheel_ros.estimator.stretches import Segment

_STUCK = 5  # segments: 1 m
_TEXTURE = 0.03  # of ln k from place to place at least: half of what is usual
# A fault is named where as much way as it took to be sure of it, within bounds, has agreed with it since.
_LEAST, _MOST = 40, 150  # segments
_SAME = 0.6  # of what it was, at least
_ALIKE = 0.7  # correlation
_WINDOW = 30  # segments of one wheel: 6 m
_SURE = 3.0  # standard deviations
_TOLD = 1e-6  # deviation of a nuisance that is taken to be there
# In the order in which they are said.
_FAULTS = (ZERO, DELAY, PITCH, PASS, LOAD_SCALE, SIDE, LOAD_ZERO, SLIP)
# Mean normalised innovation of a wheel: five standard deviations of the mean of so many neighbours
# that are alike by the soil's texture.
_AT_ODDS = 1.2

_NAMES = {
    ZERO: "the zero of the sinkage sensors",
    DELAY: "a delay",
    PITCH: "how the sinkage sensors are mounted",
    PASS: "ruts",
    LOAD_SCALE: "the scale of the load cells",
    SIDE: "the ground under one side",
    LOAD_ZERO: "the zero of the load cells",
    SLIP: "slip sinkage",
}


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

    def __init__(self, loads_measured: bool = True) -> None:
        self._loads_measured = loads_measured
        self._shown: dict[str, deque[Segment]] = {}
        self._off: dict[str, deque[float]] = {}
        self._segments = 0
        # Of a nuisance that is sure: at which segment it became so, and what it was then.
        self._first: dict[int, tuple[int, float]] = {}

    def add(self, segment: Segment) -> None:
        """Take a segment, whatever becomes of it."""
        self._shown.setdefault(segment.wheel, deque(maxlen=_STUCK)).append(segment)

    def judge(self, segment: Segment, normalised: float) -> None:
        """Take a segment's normalised innovation."""
        self._off.setdefault(segment.wheel, deque(maxlen=_WINDOW)).append(normalised)

    def resume(self, law: LawFilter) -> None:
        """Go on from what was known of the sensors: the way before agrees with it."""
        self._segments = _MOST
        self._first = {i: (0, float(law.mean[i])) for i in np.flatnonzero(self._sure(law)).tolist()}

    def follow(self, law: LawFilter) -> None:
        """Look at the nuisances after a segment."""
        self._segments += 1
        mean, sure = law.mean, self._sure(law)
        for i in [i for i in self._first if i >= len(mean) or not sure[i]]:
            del self._first[i]
        for i in np.flatnonzero(sure).tolist():
            value = float(mean[i])
            if i not in self._first or value / self._first[i][1] < _SAME:
                self._first[i] = self._segments, value

    def is_stuck(self, wheel: str) -> bool:
        """Whether a wheel's sinkage sensor shows what no wheel does that rolls over soil.

        Its readings over the last metre differ by less than a fifth of what the loads and the texture of the
        ground make sinkage vary by; not where that is less than the steps of the sensor.
        """
        rows = self._shown.get(wheel, deque())
        if len(rows) < _STUCK or sum(row.count for row in rows) < _STUCK:
            return False
        most = max(row.shown[1] for row in rows) - min(row.shown[0] for row in rows)
        loads = float(np.std(np.log([row.load for row in rows])))
        # A sinkage goes with the load to the power 1/(n + 1/2), which is 0.7 for ordinary sand.
        varies = 0.7 * abs(rows[-1].sinkage) * math.hypot(loads, _TEXTURE)
        step = rows[-1].step if math.isfinite(rows[-1].step) else 0.0
        return bool(most + (step if step > most else 0.0) < 0.2 * varies)

    def _sure(self, law: LawFilter) -> NDArray[np.bool_]:
        """Which numbers of the state are known, and away from nothing."""
        deviation, prior = np.sqrt(np.maximum(np.diag(law.covariance), 0.0)), law.prior_deviations
        known = (prior > _TOLD) & (deviation < DETERMINED * prior)
        sure: NDArray[np.bool_] = known & (np.abs(law.mean) > _SURE * deviation)
        return sure

    def _agreed(self, place: int) -> bool:
        """Whether the way since a nuisance became sure, as long as that before it, agrees with it."""
        if place not in self._first:
            return False
        first, _ = self._first[place]
        return self._segments - first >= min(max(first, _LEAST), _MOST)

    def findings(self, law: LawFilter, names: Sequence[str]) -> tuple[str, ...]:
        """What seems wrong, in words. names: of the wheels, in the order of the law's state."""
        found = [
            _fault(place, float(law.mean[place])) + self._rivals(law, place)
            for place in _FAULTS
            # Wheels that sink less where they slip more do not dig: something else follows the slip.
            if self._agreed(place) and not (place == SLIP and law.mean[SLIP] < 0.0)
        ]
        for i, name in enumerate(names):
            own = WHEELS + EACH * i
            words = _fault_of(name, *law.mean[own : own + EACH].tolist())
            found += [text for j, text in enumerate(words) if self._agreed(own + j)]
        return (*self.of_wheels(), *found)

    def _rivals(self, law: LawFilter, place: int) -> str:
        """What else the drive cannot tell a fault from, in words; empty where there is nothing."""
        deviation = np.sqrt(np.maximum(np.diag(law.covariance), 1e-18))
        alike = np.abs(law.covariance[place] / deviation / deviation[place])
        rivals = [
            words for other, words in _NAMES.items() if other != place and alike[other] > _ALIKE
        ]
        return (
            f" (or it is {', or '.join(rivals)}: this drive hardly tells them apart)"
            if rivals
            else ""
        )

    def of_wheels(self) -> tuple[str, ...]:
        """Sensors that are stuck, and wheels that disagree with the others, in words."""
        found = [
            f"wheel '{wheel}': the sinkage sensor shows {1e3 * rows[-1].sinkage:.2f} mm without change while "
            "the wheel rolls: it is stuck, and not used; check its driver"
            for wheel, rows in self._shown.items()
            if self.is_stuck(wheel)
        ]
        half = _WINDOW // 2
        means = {
            wheel: (sum(list(off)[:half]) / half, sum(list(off)[half:]) / (_WINDOW - half))
            for wheel, off in self._off.items()
            if len(off) == _WINDOW and self._loads_measured
        }
        for wheel, mean in means.items():
            others = [value for name, value in means.items() if name != wheel]
            if len(others) < 2:
                continue
            rest = np.median(others, axis=0)
            off = np.array(mean) - rest
            sides = np.sign(off)
            if (
                sides[0] == sides[1]
                and abs(off.mean()) > _AT_ODDS
                and min(abs(off)) > 0.5 * _AT_ODDS
            ):
                side = "more" if sides[0] > 0 else "less"
                found.append(
                    f"wheel '{wheel}': for {_WINDOW} stretches it has shown {side} sinkage than the "
                    "other wheels agree on: check its load cell and its sinkage sensor"
                )
        return tuple(found)
