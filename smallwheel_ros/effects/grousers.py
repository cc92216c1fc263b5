# SPDX-License-Identifier: Apache-2.0
"""grouser: lugs of height h dig where they slip, reach deeper, and pull more."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, WheelState, parameter, partly_dug
from smallwheel_ros.effects.slip import BySlip
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.traction import contact_length

_LARGEST_SLIP = 0.95  # for laws that have a pole at slip 1


class _Grouser(Effect):
    id = "grouser"
    summary = "Grousers dig where they slip, reach deeper, and pull more."
    drivers: ClassVar[tuple[str, ...]] = ("grouser_height",)
    side: ClassVar[Literal[-1, 0, 1]] = 1
    next_step = (
        "Run the same wheel with and without grousers at one load, over slips from 0 to 0.6."
    )


class _Digging(_Grouser, BySlip):
    needs: ClassVar[tuple[str, ...]] = ("slip", "grouser_height")
    drivers = ("grouser_height", "slip")


@dataclass(frozen=True)
class Digging(_Digging):
    """Grousers of height h dig a depth that is proportional to slip."""

    formula = "z = z0 + a h i, i > 0"
    source = "empirical: soil carried away in proportion to height and slip"

    a: float = parameter(1.0, (0.0, 20.0), "sinkage over height at slip 1", published=(0.0, 5.0))

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage + self.a * conditions["grouser_height"] * self.slip(conditions)


@dataclass(frozen=True)
class LugDigging(_Digging):
    """Grousers of height h dig a depth by Reece's law, which grows without bound towards slip 1."""

    formula = "z = z0 + a h i / (1 - i), i > 0 (i up to 0.95)"
    source = (
        "Reece 1965-66 with a = 1 (unverified); range from the sinkages of three rigs, 0.3 to 0.6"
    )

    a: float = parameter(0.5, (0.0, 20.0), "strength; Reece's law is 1", published=(0.2, 0.7))

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        i = np.minimum(self.slip(conditions), _LARGEST_SLIP)
        return np.asarray(sinkage + self.a * conditions["grouser_height"] * i / (1.0 - i))


PartlyDugDigging = partly_dug(Digging)


@dataclass(frozen=True)
class Traction(_Grouser):
    """Thrust of a wheel with grousers of height h, by Bekker's law for a track with spuds."""

    formula = "H0 = b l c (1 + a 2 h/b) + W tan(phi) [1 + a 0.64 (h/b) arctan(b/h)]"
    source = "Bekker 1956 for a track, a = 1, as rover calculations quote it (original not seen)"
    needs = ("grouser_height",)

    a: float = parameter(1.0, (0.0, 10.0), "strength; Bekker's own law is 1")

    def thrust_factor(self, state: WheelState, conditions: Conditions) -> Array:
        """Ratio of the maximal thrust with grousers to that without them, H0 = b l c + W tan(phi).

        The part due to cohesion grows most.

        Parameters
        ----------
        state
            Load (N), sinkage, diameter, width (m) and strength of each row.
        conditions
            Settings, with `grouser_height` (m), shape (rows,).

        Returns
        -------
        ndarray
            Factor on thrust and torque, at least 1, shape (rows,); 1 where the soil has no strength.
        """
        height, width = conditions["grouser_height"], state.width
        ratio = height / width
        length = contact_length(state.sinkage, state.diameter)
        cohesive = width * length * state.cohesion
        frictional = state.load * np.tan(state.friction_angle)
        more = 2.0 * ratio * cohesive + 0.64 * ratio * np.arctan2(width, height) * frictional
        plain = cohesive + frictional
        # Soil without any strength gives no thrust that could grow.
        growth = np.divide(more, plain, out=np.zeros_like(more), where=plain > 0.0)
        return np.asarray(1.0 + self.a * growth)
