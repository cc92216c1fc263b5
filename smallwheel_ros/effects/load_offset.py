# SPDX-License-Identifier: Apache-2.0
"""load_offset: the load cell's zero is off.

What it shows is at least a twentieth load (see `_LEAST_SHARE`): a zero error as large as the reading
is a broken cell, and a wheel without a load has no sinkage to fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, parameter
from smallwheel_ros.physics.conditions import Conditions

_LEAST_SHARE = 0.05  # of the reading that is load, whatever the offset


@dataclass(frozen=True)
class Constant(Effect):
    id = "load_offset"
    kind = "instrument"
    summary = "The load cell's zero is off: every load is shown too large or too small by as much."
    formula = "shown W = W + offset, W at least 5 % of what is shown"
    source = "instrument, not soil: a cell that was not set to zero with the wheel lifted"
    next_step = "Lift the wheel clear of the soil and read the load cell; it should show zero."

    offset: float = parameter(2.0, (-1e3, 1e3), "what is shown at zero load", unit="N")

    def corrected_load(self, load: Array, conditions: Conditions) -> Array:
        return np.maximum(load - self.offset, _LEAST_SHARE * load)
