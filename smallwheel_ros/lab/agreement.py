# SPDX-License-Identifier: Apache-2.0
"""Whether plates, pressed and rolling wheels agree on one soil, by its pressure at one depth.

k of one D cannot be compared with k of another, nor k alone where n differs. What can be compared is
ln p(z, D) = ln k + n ln z + m ln D, at a depth that both have reached and for the size of one of them.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.parameters import SOIL_PARAMETERS, ParameterPrior
from smallwheel_ros.fitting.points import FittingError
from smallwheel_ros.fitting.problem import Base, Problem
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.physics.conditions import CONTACTS
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE

Array = NDArray[np.float64]

_TWO_SIDED = 1.96  # standard deviations, 95 %
_WORDS = {"plate": "plates", "pressed": "pressed wheels", "rolling": "rolling wheels"}


@dataclass(frozen=True)
class Belief:
    """The pressure-sinkage law of a soil as one kind of test, or a model, determines it.

    Attributes
    ----------
    of
        What determines it, in words, as "plates".
    known
        The law's parameters (ln p_ref, n, m) and their covariance, shape (3, 3).
    diameters
        Diameter of the body at each measured value, m; empty for a model.
    depths
        Measured sinkages, m, shape (values,); empty for a model.
    """

    of: str
    known: ParameterPrior
    diameters: Array
    depths: Array

    def log_pressure(self, depth: float, diameter: float) -> tuple[float, float]:
        """ln of the pressure k z^n D^m (Pa), and its variance.

        Parameters
        ----------
        depth
            Sinkage z, m.
        diameter
            Diameter D of the body, m.
        """
        soil = self.known.soil
        deep, wide = np.log([depth / REFERENCE_SINKAGE, diameter / REFERENCE_DIAMETER]).tolist()
        at = np.array([1.0, deep, wide])
        log_pressure = soil.log_reference_pressure + soil.n * deep + soil.m * wide
        return log_pressure, float(at @ self.known.covariance @ at)


@dataclass(frozen=True)
class Agreement:
    """Two determinations of one soil's law, compared by their pressures at one depth under one diameter.

    Attributes
    ----------
    soil
        Name of the soil.
    first, second
        What determined each (`Belief.of`).
    depth, diameter
        Depth and diameter for which they are compared, m.
    pressures
        k z^n D^m of the first and of the second, Pa.
    ratio
        Pressure of the second over that of the first.
    low, high
        95 % interval of the ratio.
    """

    soil: str
    first: str
    second: str
    depth: float
    diameter: float
    pressures: tuple[float, float]
    ratio: float
    low: float
    high: float

    @property
    def agrees(self) -> bool:
        """Whether the interval of the ratio contains 1."""
        return self.low <= 1.0 <= self.high

    def sentence(self) -> str:
        """The comparison in words."""
        first, second = (f"{1e-3 * p:.3g} kPa" for p in self.pressures)
        where = f"At {1e3 * self.depth:.3g} mm under {1e3 * self.diameter:.4g} mm"
        said = (
            f"{where} {self.first} give k D^m z^n = {first}, {self.second} {second}: "
            f"{self.ratio:.2f} times (95 %: {self.low:.2f} to {self.high:.2f}). "
        )
        if self.agrees:
            return f"{said}They agree about {self.soil}"
        return (
            f"{said}They disagree about {self.soil}: the law of one does not carry over to the other as it "
            "stands. Check zero of the sinkage, sizes and preparation of both; fit each alone where it is "
            "to be used"
        )

    def to_dict(self) -> dict[str, Any]:
        """The comparison as plain values, SI."""
        found = asdict(self)
        interval = [found.pop("low"), found.pop("high")]
        return found | {"interval": interval, "agrees": self.agrees}


def belief_of(measurements: Measurements, base: Base, soil: str, words: str) -> Belief | None:
    """Determine the law of one soil from these rows alone; None if they are too few for a fit.

    If they have one diameter only, the variance includes that of m's prior at other diameters.

    Parameters
    ----------
    measurements
        Rows of one kind of contact in that soil.
    base
        The model to fit; its priors are not used.
    soil
        Name of the soil in the model.
    words
        What the rows are, for people, as "plates".
    """
    try:
        problem = Problem.of(measurements, replace(base, priors={}))
        result = problem.result()
    except FittingError:
        return None
    found = next(s for s in result.model.soils if s.name == soil)
    names = [f"{soil}.{name}" for name in SOIL_PARAMETERS]
    free = [i for i, name in enumerate(names) if name in result.names]
    at = [result.names.index(names[i]) for i in free]
    covariance = np.zeros((3, 3))
    covariance[np.ix_(free, free)] = result.covariance[np.ix_(at, at)]
    points = problem.points
    diameters = points.column("diameter")
    if f"{soil}.m" not in result.names:
        # Held: the pressure is known under the one size, and elsewhere as far as m is.
        away = np.array([-np.log(float(diameters.mean()) / REFERENCE_DIAMETER), 0.0, 1.0])
        covariance += SOIL_PARAMETERS["m"][1].deviation ** 2 * np.outer(away, away)
    sunk = (np.array(points.channels)[points.channel] == "sinkage") & (points.value > 0)
    return Belief(words, ParameterPrior(found, covariance), diameters, points.value[sunk])


def compare_beliefs(soil: str, first: Belief, second: Belief) -> Agreement:
    """Compare the pressures of two laws of one soil at one depth and diameter.

    The diameter is the geometric mean of the diameters of `second`. The depth is the geometric mean of the
    least and the greatest depth that both reached; if `first` is a model, that of all depths of `second`.

    Parameters
    ----------
    soil
        Name of the soil.
    first, second
        Two determinations of its law; the second is from tests.
    """
    diameter = float(np.exp(np.mean(np.log(second.diameters))))
    if first.depths.size:
        low = max(float(b.depths.min()) for b in (first, second))
        high = min(float(b.depths.max()) for b in (first, second))
        depth = float(np.sqrt(low * high))
    else:
        depth = float(np.exp(np.mean(np.log(second.depths))))
    (a, va), (b, vb) = (belief.log_pressure(depth, diameter) for belief in (first, second))
    width = _TWO_SIDED * np.sqrt(va + vb)
    ratio, low, high = np.exp([b - a, b - a - width, b - a + width]).tolist()
    pressures = (float(np.exp(a)), float(np.exp(b)))
    return Agreement(soil, first.of, second.of, depth, diameter, pressures, ratio, low, high)


def agreements(measurements: Measurements, base: Base) -> tuple[Agreement, ...]:
    """Compare the laws that the kinds of contact in a table imply for each soil, and that of a known model.

    In each soil the first of plate, pressed and rolling that can be fitted is compared with the remaining
    kinds, and the known model with all kinds. Empty if no soil has two laws to compare.

    Parameters
    ----------
    measurements
        The table.
    base
        The model that was fitted. Its priors, if it has any, are the soils of a known model.
    """
    contact = measurements.conditions.contact
    found: list[Agreement] = []
    for name in dict.fromkeys(measurements.soil.tolist()):
        soil = name or "soil"
        here = measurements.soil == name
        kinds = [kind for kind in reversed(CONTACTS) if np.any(here & (contact == kind))]
        known = base.priors.get(soil)
        if len(kinds) < 2 and known is None:
            continue
        beliefs = [
            belief_of(measurements.take(here & (contact == kind)), base, soil, _WORDS[kind])
            for kind in kinds
        ]
        usable = [b for b in beliefs if b is not None and b.depths.size]
        if known is not None:
            of_model = Belief("the model's soil", known, np.zeros(0), np.zeros(0))
            found += [compare_beliefs(soil, of_model, b) for b in usable]
        found += [compare_beliefs(soil, usable[0], b) for b in usable[1:]]
    return tuple(found)
