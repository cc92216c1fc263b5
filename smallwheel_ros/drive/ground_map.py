# SPDX-License-Identifier: Apache-2.0
"""Writes estimates into the cost map of the ground under the vehicle."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.stamps import NEVER
from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.costmap.grid import Pose
from smallwheel_ros.onboard.settings import NodeSettings
from smallwheel_ros.physics.wheel import Quantity, Wheel
from smallwheel_ros.pipeline.mobility.answer import STALE
from smallwheel_ros.pipeline.mobility.status import Condition, MarginSource, Status
from smallwheel_ros.pipeline.mobility.vehicle import VehicleEstimates
from smallwheel_ros.pipeline.tables import Array, Estimates, Flags, Integers
from smallwheel_ros.pipeline.warning.hazard import risk_of
from smallwheel_ros.pipeline.warning.margin import LAW, information, scatter_ahead

from .messages import margin_before_driving

_SURELY = 2.0  # standard deviations
# Columns of a row of the vehicle that a terrain class gives.
_OF_MARGIN = ("margin", "margin_std", "margin_source", "information")


def cost_map_of(settings: NodeSettings) -> CostMap:
    """Make the cost map of a vehicle that has not driven yet."""
    onboard = settings.onboard
    prior, names = margin_before_driving(onboard), settings.terrain.names or ()
    return CostMap(settings.cost, onboard.wheels, prior, names, settings.reference_slip)


class GroundMapper:
    """Writes estimates into the map at the places where the wheels were.

    A cell has the vehicle's margin, not that of a single wheel: a wheel that cannot move by itself is
    dragged along by the others. At a border between soils, wheels on the other soil are left out.

    Parameters
    ----------
    cost_map
        The map.
    wheels
        All wheels, in the order of their numbers.

    Attributes
    ----------
    map
        The cost map given.
    """

    def __init__(self, cost_map: CostMap, wheels: tuple[Wheel, ...]) -> None:
        self.map, self._wheels = cost_map, wheels
        self._reference_slip = cost_map.reference_slip
        self.clear()

    def clear(self) -> None:
        """Forget the ground."""
        self.map.clear()
        count = len(self._wheels)
        self._was_shown: Array = np.full(count, -np.inf)  # at each wheel's newest row
        # Of the newest row of each wheel: stamp; load, margin, its deviation, gain beyond the reference slip;
        # whether the wheel is on another soil than the others.
        self._newest: list[NDArray[Any]] = [
            np.full(count, NEVER), *np.full((4, count), np.nan), np.zeros(count, dtype=bool)
        ]  # fmt: skip
        # Recent places of the vehicle: stamps of rows with a place, x and y (m).
        self._places: tuple[Integers, Array] = np.empty(0, dtype=np.int64), np.empty((2, 0))

    def take(self, found: Estimates, vehicle: VehicleEstimates, frame: str) -> VehicleEstimates:
        """Write estimates into the map, and return the vehicle's rows with the margin of their terrain class.

        A row of the vehicle is changed only if its margin is that of any ground. It then gets the margin of
        the class under the vehicle just before its stamp, learnt from all wheels' rows before that stamp.

        Parameters
        ----------
        found
            Rows of the wheels since the last call, in the order of their stamps.
        vehicle
            Rows of the vehicle over the same time, in the order of their stamps.
        frame
            Name of the frame of both rows' places; empty if unknown.

        Returns
        -------
        VehicleEstimates
            A copy of the vehicle's rows; `vehicle` itself if there is no grid of terrain classes.
        """
        if self.map.ahead.class_grid is None:
            self.add(found, frame)
            return vehicle
        asking = np.flatnonzero(vehicle.margin_source == MarginSource.ANY_GROUND)
        ends = np.searchsorted(found.stamp, vehicle.stamp[asking], side="left")
        columns = {name: np.array(getattr(vehicle, name)) for name in _OF_MARGIN}
        begin = 0
        for row, end in zip(asking.tolist(), ends.tolist(), strict=True):
            if end > begin:
                self.add(found.take(slice(begin, end)), frame)
                begin = end
            margin = self._of_class(int(vehicle.stamp[row]))
            if margin is not None:
                spread = margin.standard_deviation
                known = information(spread, self._reference_slip)
                values = margin.value, spread, MarginSource.CLASS, known
                for name, value in zip(_OF_MARGIN, values, strict=True):
                    columns[name][row] = value
        self.add(found.take(slice(begin, None)), frame)
        return replace(vehicle, **columns)

    def _of_class(self, stamp: int) -> Quantity | None:
        """Margin expected of the terrain class where the vehicle was just before a stamp (ns)."""
        stamps, places = self._places
        k = int(np.searchsorted(stamps, stamp, side="left")) - 1
        if k < 0 or stamps[k] < stamp - STALE:
            return None
        ahead = self.map.ahead
        terrain = ahead.class_at(self.map.frame, float(places[0, k]), float(places[1, k]))
        return ahead.classes.margins().get(terrain)

    def add(self, found: Estimates, frame: str) -> None:
        """Write rows of estimates into the map.

        Every margin counts, with its standard deviation: without a measured sinkage, it rests on the balance
        of forces and the torque, or on the prior. A row whose measured sinkage did not fit has no margin. A
        vehicle is stuck if it certainly does not move although its rims turn, or if a wheel was measured to
        be sunk to its axle; where only the soil's law predicts that depth, the risk of getting stuck is 1.

        Parameters
        ----------
        found
            Estimates of wheels, in the order of their stamps.
        frame
            Name of the odometry's frame; empty if unknown: then nothing is written.
        """
        self._keep_places(found)
        stuck = found.spins | self._seen_sunk(found)
        level = np.where(
            found.digging_in, 2, ((found.conditions & Condition.WARNED) > 0).astype(int)
        )
        risk = risk_of(np.where(found.status == Status.SUNK_TO_AXLE, 1.0, 0.0), level)
        refused = found.status == Status.REJECTED
        columns = (
            found.wheel,
            found.x,
            found.y,
            found.heading,
            found.distance,
            refused,
            stuck,
            risk,
            found.tilt,
            found.demand,
            self._shown(found, stuck | (risk > 0.0)),
            found.course,
            (found.conditions & Condition.MARGIN_OF_PRIOR) == 0,
        )
        margins, beyond = self._margins(found)
        rows = zip(*(column.tolist() for column in columns), margins, beyond, strict=True)
        for (
            wheel,
            x,
            y,
            heading,
            distance,
            unknown,
            held,
            likely,
            slope,
            demand,
            shown,
            course,
            measured,
            margin,
            more,
        ) in rows if frame else ():
            if math.isfinite(x + y + heading):
                self.map.add(
                    self._wheels[wheel], frame, Pose(x, y, heading), distance,
                    None if unknown else margin, stuck=held, risk=likely, slope=slope, demand=demand,
                    shown=shown, beyond=more, course=course, measured=measured,
                )  # fmt: skip
        known = [k for k, one in enumerate(margins) if one is not None]
        if known:
            newest, more = margins[known[-1]], beyond[known[-1]]
            assert newest is not None
            # For ground ahead, the spread between places of one field is added.
            spread = math.hypot(newest.standard_deviation, float(scatter_ahead(newest.value)))
            self.map.expect(Quantity(newest.value + more, spread))

    def _keep_places(self, found: Estimates) -> None:
        known = np.flatnonzero(np.isfinite(found.x + found.y))
        if not known.size:
            return
        first, newest = found.stamp[known[[0, -1]]].tolist()
        stamps, places = self._places
        # Later stamps are there if time has jumped back.
        kept = (stamps > newest - 2 * STALE) & (stamps <= first)
        stamps = np.concatenate([stamps[kept], found.stamp[known]])
        places = np.hstack([places[:, kept], np.stack([found.x, found.y])[:, known]])
        self._places = stamps, places

    def _seen_sunk(self, found: Estimates) -> Flags:
        """Whether each row's measured sinkage is beyond the axle, by two standard deviations."""
        radius = np.array([0.5 * wheel.diameter for wheel in self._wheels])[found.wheel]
        spread = np.nan_to_num(found.sinkage_measured_std)
        return np.asarray(found.sinkage_measured - _SURELY * spread > radius)

    def _shown(self, found: Estimates, trouble: Flags) -> Array:
        """Lower limit of the margin at each row: the pull over load required where the vehicle went on.

        -inf where there is none: with unknown slip, at or over the reference slip, or in `trouble`. If the
        pull required is unknown, it is taken to be that of driving down the slope there. A wheel that stands
        keeps the limit from before it stood.
        """
        asked = np.where(np.isnan(found.demand), -found.tilt, found.demand)
        gets_on = ~trouble & (found.slip < self._reference_slip)
        shown: Array = np.where(gets_on, asked - _SURELY * LAW, -np.inf)
        stands = ~trouble & ((found.conditions & Condition.STANDS) > 0)
        for number in range(len(self._wheels)):
            own = np.flatnonzero(found.wheel == number)
            if own.size:
                before = np.concatenate([self._was_shown[[number]], shown[own]])
                newest = np.maximum.accumulate(np.where(stands[own], 0, 1 + np.arange(own.size)))
                shown[own] = before[newest]
                self._was_shown[number] = shown[own[-1]]
        return shown

    def _margins(self, found: Estimates) -> tuple[list[Quantity | None], list[float]]:
        """Margin of the vehicle at each row, from the wheels on the same soil as the row's, weighted by load.

        Returns its median with the standard deviation of its lower half, for costs (None where unknown), and
        the gain beyond the reference slip, 0 where unknown.
        """
        count, rows = len(self._wheels), np.arange(len(found))
        margins = found.margin_median, found.margin_lower_std, found.margin_beyond
        columns = (found.stamp, found.load, *margins, found.elsewhere)
        # The newest row of each wheel before these, then these; `at`: the newest of each wheel at each row.
        stamp, load, margin, deviation, beyond, elsewhere = (
            np.concatenate([before, column])
            for before, column in zip(self._newest, columns, strict=True)
        )
        at = np.tile(np.arange(count), (rows.size, 1))
        at[rows, found.wheel] = rows + count
        at = np.maximum.accumulate(at, axis=0)
        if rows.size:
            self._newest = [
                column[at[-1]] for column in (stamp, load, margin, deviation, beyond, elsewhere)
            ]
        known = np.isfinite(margin[at]) & (stamp[at] >= found.stamp[:, None] - STALE)
        known &= elsewhere[at] == found.elsewhere[:, None]
        weight = np.where(known, load[at], 0.0)
        weighed = np.isfinite(weight).all(axis=1, keepdims=True)
        weight = np.where(weighed, weight, known)
        total = weight.sum(axis=1)
        # All wheels stand on one estimated soil, so their errors are taken to be fully correlated.
        value, spread, more = (
            (weight * np.where(known, column[at], 0.0)).sum(axis=1)
            / np.where(total > 0.0, total, 1.0)
            for column in (margin, deviation, beyond)
        )
        found_there = zip(value.tolist(), spread.tolist(), total.tolist(), strict=True)
        return [Quantity(v, s) if whole else None for v, s, whole in found_there], more.tolist()
