# SPDX-License-Identifier: Apache-2.0
"""Puts terrain classes and elevation maps that others publish into the cost map."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.costmap.elevation import elevation_from
from smallwheel_ros.costmap.grid import CostMapError, grid_from
from smallwheel_ros.onboard.settings import NodeSettings

CLASSES, ELEVATION = "nav_msgs/msg/OccupancyGrid", "grid_map_msgs/msg/GridMap"

# Called with the topic, the reason and the description of something that went wrong.
Report = Callable[[str, str, str], None]


class AheadInputs:
    """Gives messages about the ground ahead to a cost map, and reports those that cannot be used.

    Parameters
    ----------
    settings
        The node's settings, for the names of topics, layers and terrain classes.
    cost_map
        Map that takes terrain classes and slopes.
    report
        Called with the topic, the reason and the problem in words, for each message that cannot be used.

    Attributes
    ----------
    grids, elevations
        Number of terrain class grids and of elevation maps received.
    """

    def __init__(self, settings: NodeSettings, cost_map: CostMap, report: Report) -> None:
        self._settings, self._map, self._report = settings, cost_map, report
        self.grids = self.elevations = 0

    @property
    def topics(self) -> dict[str, tuple[str, Callable[[Any], bool]]]:
        """By the name of each topic to listen to, its type and the function that takes its messages."""
        found = {
            self._settings.terrain_classes_topic: (CLASSES, self.take_classes),
            self._settings.elevation_topic: (ELEVATION, self.take_elevation),
        }
        return {name: one for name, one in found.items() if name}

    def take_classes(self, message: Any) -> bool:
        """Take a grid of terrain classes (nav_msgs/OccupancyGrid); return whether it is valid."""
        self.grids += 1
        topic = self._settings.terrain_classes_topic
        try:
            self._map.take_classes(grid_from(message))
        except CostMapError as error:
            self._report(topic, "malformed_grid", f"not used: {error}")
            return False
        if self._map.in_other_frame:
            self._report(topic, "other_frame", self._map.problem)
        return True

    def take_elevation(self, message: Any) -> bool:
        """Take a map of elevations (grid_map_msgs/GridMap); return whether it is valid."""
        self.elevations += 1
        settings, length = self._settings, self._map.outline.length
        topic, names = settings.elevation_topic, settings.terrain.names or ()
        try:
            elevation = elevation_from(message, settings.elevation_layer, length, names)
        except CostMapError as error:
            self._report(topic, "malformed_grid", f"not used: {error}")
            return False
        self._map.take_elevation(elevation)
        if not self._map.is_placed(elevation.frame):
            self._report(topic, "other_frame", self._map.problem)
        return True
