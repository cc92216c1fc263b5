# SPDX-License-Identifier: Apache-2.0
"""Speed limit for a vehicle that may get stuck, as in nav2_msgs/SpeedLimit."""

from __future__ import annotations

import numpy as np

from smallwheel_ros.pipeline.mobility.status import Condition
from smallwheel_ros.pipeline.tables import Estimates

NO_LIMIT = 0.0  # as Nav2 has it: it cannot say stop
_MAY_GET_STUCK, _GETS_STUCK = 50.0, 20.0  # percent of the speed
_WITHOUT = 2.0  # m without a warning after which there is no limit any more


class SpeedLimit:
    """The speed limit: 50 % from a warning until 2 m pass without one, 20 % while the vehicle gets stuck.

    Attributes
    ----------
    percent
        The limit, in per cent of the controller's speed; `NO_LIMIT` for none.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all warnings."""
        self.percent = NO_LIMIT
        self._warned_at = -np.inf  # m of travel

    def take(self, found: Estimates) -> bool:
        """Process rows of estimates; return whether the limit has changed."""
        if not len(found):
            return False
        gets_stuck = found.digging_in | found.spins
        warned = gets_stuck | ((found.conditions & Condition.WARNED) > 0)
        if warned.any():
            self._warned_at = float(found.distance[warned].max())
        before, now = self.percent, float(found.distance[-1])
        if gets_stuck[found.stamp == found.stamp[-1]].any():
            self.percent = _GETS_STUCK
        else:
            self.percent = _MAY_GET_STUCK if now - self._warned_at < _WITHOUT else NO_LIMIT
        return self.percent != before
