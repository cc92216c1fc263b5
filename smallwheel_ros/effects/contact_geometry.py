# SPDX-License-Identifier: Apache-2.0
"""contact_geometry: the exact contact integral in place of the paper's closed form (eq. 10).

A rule, not a number: adding it to a model sets the model's geometry.
"""

from __future__ import annotations

from dataclasses import dataclass

from smallwheel_ros.effects.base import Effect


@dataclass(frozen=True)
class ContactIntegral(Effect):
    id = "contact_geometry"
    summary = "The wheel's true outline carries the load, not eq. 10's parabola and two terms."
    formula = "W = b r int p(z(theta)) cos(theta) d(theta), z = r (cos(theta) - cos(theta0))"
    source = "Bekker 1956; Wong 2008, ch. 2"
    channels = ("sinkage", "resistance", "drawbar_pull", "torque")
    stage = "geometry"
    next_step = "Compare both rules on the same data: smallwheel compare."
    geometry = "contact_integral"
