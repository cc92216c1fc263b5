# SPDX-License-Identifier: Apache-2.0
"""Conditions that apply to an estimate of a wheel, and their numbers in messages.

A test compares the constants of the messages, and their comments, with these.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import TYPE_CHECKING

import numpy as np

from smallwheel_ros.pipeline.tables import Integers

if TYPE_CHECKING:
    from typing_extensions import Self


class Condition(IntFlag):
    """A condition that applies to a row; each is a bit in `Estimates.conditions`."""

    PRIOR_ONLY = 1  # no sinkage has been used yet: the soil is the configured one
    LAW_UNKNOWN = 2  # the same, and no soil is configured: the law predicts nothing
    SLIP_UNKNOWN = 4  # the wheel stands, or a speed is not known
    STANDS = 8  # of these: the wheel stands
    DOES_NOT_FIT = 16  # the measured sinkage is far from those before it and from the predicted one
    NOT_USED = 32  # the wheel has a sinkage sensor, and no usable sinkage for this row
    LOAD_MISSING = 64  # no usable load for this row
    NOTHING_PREDICTED = 128  # the model gives no sinkage, although all that it needs is known
    SUNK_TO_AXLE = 256  # the soil does not carry the load before the axle reaches it
    LOAD_STATIC = 512  # the load is configured, not measured
    DIGS = 1024  # the rolling wheel digs itself in: the second level of the warning holds
    WARNED = 2048  # any level of the warning holds, and the wheel rolls
    MARGIN_OF_PRIOR = 4096  # the margin is essentially that of any ground
    STRENGTH_OF_PRIOR = 8192  # thrust and pull rest on a strength that nothing here has measured
    ANGLE_UNKNOWN = 16384  # slip is unknown since the steering angle is


class _Explained(IntEnum):
    """A number with its meaning, in the words of the message's comment and of docs/node.md."""

    meaning: str

    def __new__(cls, number: int, meaning: str = "") -> Self:
        one = int.__new__(cls, number)
        one._value_, one.meaning = number, meaning
        return one


class Status(_Explained):
    """The most serious of the conditions that apply; numbers of MobilityEstimate.msg."""

    OK = 0, "nothing of what follows"
    PRIOR_ONLY = 1, "no sinkage has been used yet: the soil is the configured one"
    SLIP_UNKNOWN = 2, "the wheel stands, or a speed is not known: no thrust, no drawbar pull"
    REJECTED = 3, "the measured sinkage does not fit, or its sensor is doubted"
    LOAD_MISSING = 4, "no usable load near this instant: no sinkage, no forces"
    SUNK_TO_AXLE = 5, "the soil does not carry the load before the axle reaches it"
    NOTHING_PREDICTED = 6, "the model gives no sinkage for this wheel"


class SoilStatus(_Explained):
    """Numbers of SoilEstimate.msg."""

    OK = 0, "at least one measurement was accepted"
    PRIOR_ONLY = 1, "no measurement yet: the configured soil and its uncertainty"


class MarginSource(_Explained):
    """Basis of the vehicle's margin; numbers of VehicleMobility.msg."""

    ANY_GROUND = 0, "prior: nothing of this ground"
    CLASS = 1, "prior of a terrain class"
    MEASURED = 2, "slip and accelerometer"
    SOIL = 3, "soil and strength"


# From the least to the most serious. A condition that is not listed has no status.
_STATUS_OF = (
    (Condition.PRIOR_ONLY, Status.PRIOR_ONLY),
    (Condition.SLIP_UNKNOWN, Status.SLIP_UNKNOWN),
    (Condition.DOES_NOT_FIT, Status.REJECTED),
    (Condition.NOT_USED, Status.REJECTED),
    (Condition.NOTHING_PREDICTED, Status.NOTHING_PREDICTED),
    (Condition.LOAD_MISSING, Status.LOAD_MISSING),
    (Condition.SUNK_TO_AXLE, Status.SUNK_TO_AXLE),
)


def status_of(conditions: Integers) -> Integers:
    """Return the most serious status of each row, from its conditions.

    Parameters
    ----------
    conditions
        Bits of `Condition`, shape (rows,).

    Returns
    -------
    ndarray
        Numbers of `Status`, shape (rows,).
    """
    found = np.full(conditions.shape, int(Status.OK), dtype=np.int64)
    for condition, status in _STATUS_OF:
        found[conditions & int(condition) != 0] = int(status)
    return found
