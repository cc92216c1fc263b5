# SPDX-License-Identifier: Apache-2.0
"""What came of the instant of one wheel."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.mobility import WheelForces
from smallwheel_ros.physics.wheel import Quantity


class Status(IntEnum):
    """The most serious of the conditions that apply; numbered as in MobilityEstimate.msg."""

    OK = 0
    PRIOR_ONLY = 1
    SLIP_UNKNOWN = 2
    REJECTED = 3
    LOAD_MISSING = 4
    SUNK_TO_AXLE = 5


@dataclass(frozen=True)
class Result:
    """One wheel at one instant: what was measured, and what the model makes of it; SI units.

    Attributes
    ----------
    status_text
        All conditions that apply, in words.
    sinkage_predicted, forces
        Of the soil as estimated before this sinkage was used, and after; None where load is missing
        or the wheel is sunk to its axle.
    digging_in
        Slip and sinkage grow while the wheel travels slower and slower.
    risk
        Probability that the vehicle gets stuck within the next metre (see `stuck_warning`); None
        where no margin is known.
    slope
        Tangent of the steepest slope of the ground there, whichever way the vehicle looks; 0 where none is
        measured.
    soil
        After the instant: the one that a wheel came to last; the forces are those on the wheel's own.
    rejected
        Measured sinkages that were not used for the soil since the start or the last reset.
    elsewhere
        Wheels that are on another soil than this one, just before or after a border.
    """

    instant: Instant
    status: Status
    status_text: str
    sinkage_predicted: Quantity | None
    forces: WheelForces | None
    digging_in: bool
    risk: float | None
    soil: SoilEstimate
    rejected: int
    elsewhere: tuple[str, ...]
    slope: float = 0.0

    @property
    def wheel(self) -> str:
        """Name of the wheel."""
        return self.instant.wheel.name
