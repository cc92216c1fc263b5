# SPDX-License-Identifier: Apache-2.0
"""What belongs together at one instant: of one wheel, and of the vehicle."""

from __future__ import annotations

import math
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
    speed_std, rim_std
        Standard deviations of the two, m/s.
    stands
        Whether the wheel stands, by both of them.
    heading
        rad, the way the vehicle looks in the frame of the odometry.
    pass_number
        1 and how often a wheel has rolled over this place before (see `passes`); None: not known.
    onward
        Which way the vehicle goes as a whole: True forward.
    rim_held
        s, since which the rim has shown exactly this speed.
    speed_repeats
        Whether the messages of the speed over ground are one and the same while the vehicle moves:
        it is not known then.
    distance, path
        That the vehicle and this wheel have travelled so far, m; for the wheel turning counts.
    place, vehicle
        x and y (m) of the wheel and of the vehicle's middle in the frame of the odometry; the latter
        is known also where nobody knows which way the vehicle looks.
    load_is_static
        Nobody measures it.
    pitch
        rad, positive nose down.
    slope_force, gained_force
        m/s^2, of the vehicle the way it drives: g sin(slope), and dv/dt.
    across_force
        m/s^2, g sin(slope across), positive where the left side is higher.
    torque
        N m, at the wheel.
    forward
        Which way the wheel drives, see `drives_forward`.
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
    slope_force: float | None = None
    torque: float | None = None
    forward: bool = True
    gained_force: float | None = None
    speed_std: float = 0.0
    rim_std: float = 0.0
    stands: bool = False
    across_force: float | None = None
    heading: float | None = None
    rim_held: float = 0.0
    speed_repeats: bool = False
    pass_number: int | None = None
    onward: bool = True

    @property
    def specific_force(self) -> float | None:
        """What the wheels pull per mass of the vehicle, the way it drives, m/s^2."""
        if self.slope_force is None or self.gained_force is None:
            return None
        return self.slope_force + self.gained_force


def drives_forward(speed: float | None, rim_speed: float | None) -> bool:
    """Whether a wheel drives forward; speeds of its place over ground and of its rim, m/s.

    The faster of them tells: the speed over ground of a wheel that spins on one place is noise of
    either sign, and so is the rim of one that is dragged.
    """
    if speed is None:
        return True
    return (rim_speed if rim_speed is not None and abs(rim_speed) > abs(speed) else speed) >= 0.0


class Motion(NamedTuple):
    """Of a vehicle: forward speed (m/s), yaw rate (rad/s), place (m), cosine and sine of the yaw.

    Between two messages the latter two are not of unit length; they are NaN where yaw is not known.
    speed_variance, yaw_rate_variance: as the message has them, 0 where it does not. pitch: rad,
    positive nose down, and roll, positive left side up; 0 where not known.
    """

    speed: float
    yaw_rate: float
    x: float
    y: float
    cosine: float = math.nan
    sine: float = math.nan
    speed_variance: float = 0.0
    yaw_rate_variance: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0

    @classmethod
    def of(
        cls,
        x: float,
        y: float,
        speed: float,
        yaw_rate: float,
        yaw: float | None,
        pitch: float,
        variances: tuple[float, float],
        roll: float = 0.0,
    ) -> Motion:
        """Return the motion in an odometry; what of it may be unknown is so where it is no number."""
        turn = (math.nan, math.nan)
        if yaw is not None and math.isfinite(yaw):
            turn = (math.cos(yaw), math.sin(yaw))
        of_speed, of_yaw = (value if 0.0 < value < math.inf else 0.0 for value in variances)
        angles = (angle if math.isfinite(angle) else 0.0 for angle in (pitch, roll))
        return cls(speed, yaw_rate, x, y, *turn, of_speed, of_yaw, *angles)

    @property
    def heading(self) -> float | None:
        """Yaw (rad); None where it is not known."""
        known = math.isfinite(self.cosine + self.sine)
        return math.atan2(self.sine, self.cosine) if known else None

    def place(self, wheel: Wheel) -> tuple[float, float] | None:
        """Where a wheel is; None where nobody knows which way the vehicle looks."""
        length = math.hypot(self.cosine, self.sine)
        if not length > 0.0:
            return None
        cosine, sine = self.cosine / length, self.sine / length
        ahead, left = wheel.longitudinal_position, wheel.lateral_position
        return self.x + cosine * ahead - sine * left, self.y + sine * ahead + cosine * left
