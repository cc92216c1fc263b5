"""contact_geometry: the closed form (eq. 10) replaced by the contact integral."""

from __future__ import annotations

from dataclasses import dataclass

from smallwheel_ros.effects.base import Effect


@dataclass(frozen=True)
class ContactGeometry(Effect):
    id = "contact_geometry"
    form = "contact integral"
    summary = "The wheel's round outline instead of a parabola and two terms of a series."
    formula = "W = b r integral of p cos(theta), instead of eq. 10"
    source = "Bekker 1956; Wong 2008, ch. 2"
    stage = "geometry"

    def geometry(self, rule: str) -> str:
        return "contact_integral"
