"""What the estimate on board rests on besides the measurements: vehicle, soil, sensors, time."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import Enum

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior
from smallwheel_ros.onboard.force_gradients import REFERENCE_SLIP
from smallwheel_ros.physics.conditions import PRESSED, ROLLING
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel


class OnboardError(SmallwheelError):
    """Settings that nothing can be estimated with, or a wheel that is not of this vehicle."""


class VelocitySource(Enum):
    """Where the speed over ground comes from that slip is worked out with."""

    ODOMETRY = "odometry"  # which the wheels do not measure
    TOPIC = "topic"  # a sensor of its own: radar, optical flow, visual odometry
    NONE = "none"  # odometry is made from the wheels: it cannot show slip


@dataclass(frozen=True)
class DiggingInRules:
    """When a wheel is taken to dig itself in: all of these at once, and for some time.

    Attributes
    ----------
    slip
        Slip of at least this, 1.
    sinkage_rise
        Measured sinkage above that of ordinary driving by this share of it.
    speed_drop
        Speed over ground below that of ordinary driving by this share of it.
    time
        For so long, s.
    """

    slip: float = 0.5
    sinkage_rise: float = 0.3
    speed_drop: float = 0.3
    time: float = 1.0


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of measurements whose messages do not carry them.

    Attributes
    ----------
    load, load_relative
        N, and as a share of the load; both together.
    speed
        m/s, of the odometry.
    drawbar_pull
        N.
    wheel_speed_relative
        Share of the rim's speed, the error of the wheel's effective radius included.
    """

    load: float = 0.5
    load_relative: float = 0.02
    speed: float = 0.01
    drawbar_pull: float = 0.6
    wheel_speed_relative: float = 0.01


@dataclass(frozen=True)
class Timing:
    """What is expected of stamps; s.

    Attributes
    ----------
    reorder_time
        How long a measured sinkage waits for those of other wheels that belong before it. 0: it
        waits for nothing; then the result depends on which message happens to come first.
    silent_after
        It also waits for load, odometry and wheel speed of its own instant, from topics that have
        not been silent for so long. Behind a node that has no time for all its messages those may
        be much behind, since they are more.
    maximum_gap
        Load, speed and odometry are interpolated or held over at most so long.
    future_tolerance, maximum_age
        How far a stamp may be ahead of and behind the clock.
    jump_tolerance
        How far a stamp may be behind the newest before it counts as a jump of time, not as late.
    """

    reorder_time: float = 0.2
    silent_after: float = 1.0
    maximum_gap: float = 0.2
    future_tolerance: float = 0.5
    maximum_age: float = 5.0
    jump_tolerance: float = 1.0


@dataclass(frozen=True)
class OnboardSettings:
    """Everything that `Onboard` needs to know before the first message.

    Attributes
    ----------
    wheels
        The vehicle's wheels, with names of their own.
    prior, strength
        The soil's law before any measurement, and its shear strength.
    estimator, noise, timing
        See there.
    standstill_speed
        m/s; at or below it vehicle and wheels count as standing.
    without_sinkage
        Names of wheels whose sinkage nobody measures; they get predictions at the times of loads.
    with_drawbar_pull
        Names of rolling wheels whose drawbar pull is measured.
    reference_slip
        Slip at which the margin is worked out (`mobility.WheelForces`), 0 .. 1.
    effects
        Effects of the model beside pressure and sinkage, in their order.
    static_loads
        Loads (N) of wheels whose load nobody measures, by name.
    velocity
        Where the speed over ground comes from.
    digging_in
        When a wheel is taken to dig itself in.
    velocity_lateral_position
        m left of the vehicle's middle, of the sensor of the velocity: in a turn it is faster or slower.
    maximum_speed
        m/s; a vehicle with small wheels is not faster: a message that says so is refused.

    Raises OnboardError where something is outside its domain.
    """

    wheels: tuple[Wheel, ...]
    prior: SoilPrior
    strength: Strength
    estimator: EstimatorSettings = field(default_factory=EstimatorSettings)
    noise: SensorNoise = field(default_factory=SensorNoise)
    timing: Timing = field(default_factory=Timing)
    standstill_speed: float = 0.01
    without_sinkage: frozenset[str] = frozenset()
    reference_slip: float = REFERENCE_SLIP
    effects: tuple[Effect, ...] = ()
    static_loads: Mapping[str, Quantity] = field(default_factory=dict)
    velocity: VelocitySource = VelocitySource.ODOMETRY
    digging_in: DiggingInRules = field(default_factory=DiggingInRules)
    with_drawbar_pull: frozenset[str] = frozenset()
    velocity_lateral_position: float = 0.0
    maximum_speed: float = 10.0

    def __post_init__(self) -> None:
        """Check everything that no other class checks."""
        if not self.wheels:
            raise OnboardError("there are no wheels: name at least one")
        twice = [name for name, count in Counter(w.name for w in self.wheels).items() if count > 1]
        if twice:
            raise OnboardError(f"wheel {twice[0]} is there twice: each needs a name of its own")
        for wheel in self.wheels:
            for name in ("diameter", "width"):
                value = getattr(wheel, name)
                if not (math.isfinite(value) and value > 0):
                    raise OnboardError(
                        f"wheel {wheel.name}: {name} is {value!r} m, expected more than 0"
                    )
            for name in ("lateral_position", "longitudinal_position"):
                value = getattr(wheel, name)
                if not math.isfinite(value):
                    raise OnboardError(
                        f"wheel {wheel.name}: {name} is {value!r} m, expected a number"
                    )
            if wheel.contact not in (ROLLING, PRESSED):
                raise OnboardError(
                    f"wheel {wheel.name}: contact is {wheel.contact!r}, expected '{ROLLING}' or"
                    f" '{PRESSED}'"
                )
        for name, load in self.static_loads.items():
            if not (math.isfinite(load.value) and load.value > 0):
                raise OnboardError(
                    f"wheel {name}: static load is {load.value!r} N, expected over 0"
                )
        for group in (self.noise, self.timing, self.digging_in):
            for entry in fields(group):
                value = getattr(group, entry.name)
                if not (math.isfinite(value) and value >= 0):
                    raise OnboardError(f"{entry.name} is {value!r}, expected 0 or more")
        if not (math.isfinite(self.standstill_speed) and self.standstill_speed >= 0):
            raise OnboardError(
                f"standstill_speed is {self.standstill_speed!r} m/s, expected 0 or more"
            )
        if not (math.isfinite(self.maximum_speed) and self.maximum_speed > 0):
            raise OnboardError(f"maximum_speed is {self.maximum_speed!r} m/s, expected over 0")
        if not math.isfinite(self.velocity_lateral_position):
            raise OnboardError(
                f"velocity_lateral_position is {self.velocity_lateral_position!r} m, expected a number"
            )
        if not 0.0 < self.reference_slip < 1.0:
            raise OnboardError(f"reference_slip is {self.reference_slip!r}, expected 0 to 1")
        for name, quantity in (
            ("cohesion", self.strength.cohesion),
            ("friction_angle", self.strength.friction_angle),
            ("shear_displacement", self.strength.shear_displacement),
        ):
            if not (math.isfinite(quantity.value) and math.isfinite(quantity.standard_deviation)):
                raise OnboardError(f"{name} is {quantity!r}, expected numbers")
            if quantity.standard_deviation < 0:
                raise OnboardError(
                    f"{name}_standard_deviation is {quantity.standard_deviation!r},"
                    " expected 0 or more"
                )
