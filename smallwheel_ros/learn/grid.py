# SPDX-License-Identifier: Apache-2.0
"""The whole grammar at the points of a table: every term's value, and what each costs to describe."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.points import Points
from smallwheel_ros.learn.drivers import Driver, drivers_of
from smallwheel_ros.learn.grammar import Term, terms_of
from smallwheel_ros.learn.law import Place, places_for
from smallwheel_ros.model import Model, predict

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class Grid:
    """Every term, with its values at each point.

    sinkage: of the base model, m, shape (points,). values: shape (points, terms). notes: why settings
    are no drivers.
    """

    drivers: tuple[Driver, ...]
    terms: tuple[Term, ...]
    places: tuple[Place, ...]
    sinkage: Array
    values: Array
    notes: tuple[str, ...]

    @classmethod
    def of(cls, points: Points, base: Model) -> Grid:
        """The whole grammar at points. base: the model without the law."""
        depth = predict(base, points.conditions).true_sinkage
        drivers, notes = drivers_of(points, depth)
        terms = terms_of(drivers, np.unique(points.setting).size)
        values = np.column_stack([term.at(points.conditions, depth) for term in terms])
        places = places_for(points.channels)
        return cls(tuple(drivers), tuple(terms), places, depth, values, tuple(notes))

    @cached_property
    def cost(self) -> Array:
        """Nats of each term, shape (terms,)."""
        return np.array([t.cost for t in self.terms])

    @cached_property
    def _before_depth(self) -> Index:
        return np.flatnonzero([bool(t.factors) and not t.of_depth for t in self.terms])

    def allowed(self, place: Place) -> Index:
        """The terms that make sense at a place: a constant, and what follows the depth, at R only."""
        return np.arange(len(self.terms)) if place.stage == "R" else self._before_depth

    def place_cost(self, place: Place) -> float:
        """Nats that it takes to say where."""
        return float(np.log(len(self.places))) + place.nats
