# SPDX-License-Identifier: Apache-2.0
"""Markers for RViz and Foxglove: how deep each wheel is, and what it can still hold."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from smallwheel_ros.onboard.result import Result
from smallwheel_ros.ros.conversions import time_message

# A colour for each margin, from stuck to easy: dark red, orange, yellow-green. They differ in
# lightness too, for those who cannot tell red from green.
_MARGINS = (0.0, 0.1, 0.2)  # and the red, green and blue of each
_COLOURS = ((0.55, 0.95, 0.75), (0.0, 0.55, 0.9), (0.1, 0.1, 0.45))
_UNKNOWN = (0.6, 0.6, 0.6)
_EXAGGERATION = 10.0  # sinkages are small beside a vehicle


def markers(newest: Iterable[Result], frame: str) -> MarkerArray:
    """A column under each wheel, ten times as high as it is deep, with its sinkage in words.

    newest: a result of each wheel, always in one order, by which markers are numbered; one without a
    place has none. frame: of the odometry.
    """
    array = MarkerArray()
    for i, result in enumerate(newest):
        array.markers.extend(_of_wheel(i, result, frame))
    return array


def deletion() -> MarkerArray:
    """Take all markers away: viewers keep them for ever otherwise."""
    return MarkerArray(markers=[Marker(action=Marker.DELETEALL)])


def _of_wheel(number: int, result: Result, frame: str) -> Iterator[Marker]:
    instant, place, wheel = result.instant, result.instant.place, result.instant.wheel
    depth = instant.sinkage or result.sinkage_predicted
    if place is None or depth is None:
        return
    margin = result.forces.margin if result.forces is not None else None
    for namespace, kind in (
        ("sinkage", Marker.CYLINDER),
        ("sinkage_text", Marker.TEXT_VIEW_FACING),
    ):
        marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD)
        marker.header.stamp = time_message(instant.stamp)
        marker.header.frame_id = frame
        marker.pose.position.x, marker.pose.position.y = place
        marker.pose.orientation.w = 1.0
        height = max(_EXAGGERATION * depth.value, 1e-3)
        if kind == Marker.CYLINDER:
            marker.pose.position.z = -0.5 * height
            marker.scale.x = marker.scale.y = wheel.width
            marker.scale.z = height
            marker.color = _colour(None if margin is None else margin.value)
        else:
            marker.pose.position.z = wheel.diameter
            marker.scale.z = 0.5 * wheel.width
            marker.color = ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)
            held = "" if margin is None else f"\nholds {math.degrees(math.atan(margin.value)):.0f}°"
            marker.text = f"{wheel.name}\n{1e3 * depth.value:.1f} mm{held}"
        yield marker


def _colour(margin: float | None) -> ColorRGBA:
    if margin is None:
        red, green, blue = _UNKNOWN
    else:
        red, green, blue = (float(np.interp(margin, _MARGINS, part)) for part in _COLOURS)
    return ColorRGBA(r=red, g=green, b=blue, a=0.9)
