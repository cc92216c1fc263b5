# SPDX-License-Identifier: Apache-2.0
"""The mean of a wheel's readings on one stretch of its own path: what the filters are given."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from smallwheel_ros.estimator.sinkage_measurement import SinkageMeasurement
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Wheel


@dataclass(frozen=True)
class Position:
    """Where a wheel is: in the state (None: it has no place there) and on the vehicle.

    passes: log2(1 + wheels ahead in its rut). side: 1 on the left, -1 on the right, 0 in the middle or
    not known. ahead: of the vehicle's middle, m.
    """

    index: int | None = None
    passes: float = 0.0
    side: float = 0.0
    ahead: float = 0.0

    @classmethod
    def of(cls, index: int, name: str, wheels: Mapping[str, Wheel]) -> Position:
        """The position of a wheel among those of a vehicle."""
        wheel = wheels.get(name)
        if wheel is None:
            return cls(index)
        ahead = [
            other
            for other in wheels.values()
            if other.contact == ROLLING == wheel.contact
            and other.longitudinal_position > wheel.longitudinal_position
            and abs(other.lateral_position - wheel.lateral_position)
            < 0.5 * (wheel.width + other.width)
        ]
        side = math.copysign(1.0, wheel.lateral_position) if wheel.lateral_position else 0.0
        return cls(index, math.log2(1.0 + len(ahead)), side, wheel.longitudinal_position)

    @property
    def leads(self) -> bool:
        """Whether the wheel runs in nobody's rut."""
        return self.passes == 0.0


NOWHERE = Position()


@dataclass(frozen=True)
class Segment(SinkageMeasurement):
    """A mean of readings; time and distance are those of the last one.

    variance: of the mean sinkage, from the sensor's noise. log_load_variance: of ln load, from the
    sensor's. load_rate: d ln load / d time, 1/s. place: of the wheel along the vehicle's path, m.
    count: readings in the mean; dropped: left out as outliers. stuck: the sensor showed one number
    throughout.
    """

    log_load_variance: float = 0.0
    load_rate: float = 0.0
    place: float = 0.0
    count: int = 1
    dropped: int = 0
    stuck: bool = False
    position: Position = NOWHERE

    @classmethod
    def of(cls, reading: SinkageMeasurement, **means: Any) -> Segment:
        """What a reading says, but for these means."""
        return cls(**{name: getattr(reading, name) for name in _OF_READINGS} | means)

    @classmethod
    def single(
        cls,
        reading: SinkageMeasurement,
        load: float,
        log_load_variance: float,
        position: Position = NOWHERE,
    ) -> Segment:
        """One reading, to predict by. load: N, without its noise."""
        slip, speed = (
            None if value is None or not math.isfinite(value) else value
            for value in (reading.slip, reading.speed)
        )
        return cls.of(
            reading,
            variance=0.0,
            load=load,
            log_load_variance=log_load_variance,
            slip=slip,
            speed=speed,
            position=position,
        )


_OF_READINGS = tuple(field.name for field in fields(SinkageMeasurement))
