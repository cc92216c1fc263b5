"""What belongs together at one instant of one wheel."""

from __future__ import annotations

from typing import NamedTuple

from smallwheel_ros.physics.wheel import Quantity, Wheel


class Instant(NamedTuple):
    """What is known of one wheel at one instant; None where it is not.

    Attributes
    ----------
    stamp
        ns.
    load, slip, sinkage, drawbar_pull
        N, 1, m, N; sinkage and drawbar pull as measured.
    speed, rim_speed
        Of the wheel's place over ground, and of its rim, m/s.
    distance, path
        That the vehicle and this wheel have travelled so far, m; for the wheel turning counts.
    place, vehicle
        x and y (m) of the wheel and of the vehicle's middle in the frame of the odometry; the latter
        is known also where nobody knows which way the vehicle looks.
    load_is_static
        Nobody measures it.
    pitch
        rad, positive nose down.
    """

    wheel: Wheel
    stamp: int
    load: Quantity | None
    slip: Quantity | None
    sinkage: Quantity | None
    speed: float | None
    distance: float
    path: float
    place: tuple[float, float] | None = None
    load_is_static: bool = False
    vehicle: tuple[float, float] | None = None
    drawbar_pull: Quantity | None = None
    pitch: float = 0.0
    rim_speed: float | None = None
