# SPDX-License-Identifier: Apache-2.0
"""Recognition of messages that have a joint at 0 among others in which it turns: from another publisher.

joint_state_publisher fills in 0 for joints without a value; if the driver uses the same topic, both arrive.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.stamps import NEVER, SECOND

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_AWAY = 0.1  # rad from 0: more than an encoder that stands flickers by
_TURNS = 0.05  # rad/s: faster than the noise of a joint that stands
# ns: an encoder that begins anew at 0 and stands is believed after that, since no others come any more
_BETWEEN = SECOND

IDLE = "its joint is at 0 between messages in which it turns: is there more than one publisher?"


class IdlePublisher:
    """Recognises, among the messages of one joint, those of a publisher that does not measure it."""

    def __init__(self) -> None:
        self._away = NEVER  # ns, of the last message in which the joint was away from 0

    def idle(self, stamps: Integers, velocity: Array, position: Array) -> NDArray[np.bool_]:
        """Tell which further messages are from a publisher that does not measure the joint.

        Parameters
        ----------
        stamps
            Stamps in the order in which the messages arrived, shape (messages,), ns.
        velocity, position
            rad/s and rad, NaN where a message has none, shape (messages,).

        Returns
        -------
        ndarray
            Shape (messages,), bool: True where the joint is at exactly 0, within 1 s of the last message in
            which it turned or was away from 0.
        """
        zero = (position == 0.0) & ((velocity == 0.0) | np.isnan(velocity))
        turns = (np.abs(position) > _AWAY) | ((np.abs(velocity) > _TURNS) & (position != 0.0))
        away = np.where(turns, stamps, NEVER)
        newest = np.maximum.accumulate(np.concatenate([[self._away], away]))[1:]
        if stamps.size:
            self._away = int(newest[-1])
        # Before a message that is far ahead time has gone back: that is another drive.
        return np.asarray(zero & (np.abs(stamps - newest) <= _BETWEEN))
