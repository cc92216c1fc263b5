"""What belongs together at one instant of one wheel."""

from __future__ import annotations

from typing import NamedTuple

from smallwheel_ros.physics.wheel import Quantity, Wheel


class Instant(NamedTuple):
    """What is known of one wheel at one instant; None where it is not.

    stamp: ns. load: N. slip: 1. sinkage: measured, m. speed: of the wheel's place over ground, m/s.
    distance: that the vehicle has travelled so far, m. place: of the wheel in the frame of the
    odometry, x and y in m. load_is_static: nobody measures it. vehicle: place of the vehicle's middle,
    as `place`; known also where nobody knows which way the vehicle looks. drawbar_pull: measured, N.
    """

    wheel: Wheel
    stamp: int
    load: Quantity | None
    slip: Quantity | None
    sinkage: Quantity | None
    speed: float | None
    distance: float
    place: tuple[float, float] | None = None
    load_is_static: bool = False
    vehicle: tuple[float, float] | None = None
    drawbar_pull: Quantity | None = None
