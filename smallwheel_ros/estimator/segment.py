# SPDX-License-Identifier: Apache-2.0
"""The mean of a wheel's readings on one stretch of its own path: what the filters are given."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

from smallwheel_ros.estimator.sinkage_measurement import SinkageMeasurement
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Wheel


@dataclass(frozen=True)
class Position:
    """Where a wheel is: in the state (None: it has no place there) and on the vehicle.

    passes: how much of a rut the wheel meets: 0 in fresh soil, 1 behind one wheel; pass_doubt: what that is
    off by where more have passed. side: 1 on the left, -1 on the right, 0 in the middle or not known.
    ahead: of the vehicle's middle, the way it drives, m. leads: no wheel runs ahead of it in its track.
    """

    index: int | None = None
    passes: float = 0.0
    side: float = 0.0
    ahead: float = 0.0
    leads: bool = True
    pass_doubt: float = 0.0

    @classmethod
    def of(cls, index: int, name: str, wheels: Mapping[str, Wheel], forward: bool) -> Position:
        """The position of a wheel among those of a vehicle that drives forward or backward."""
        wheel = wheels.get(name)
        if wheel is None:
            return cls(index)
        way = 1.0 if forward else -1.0
        ahead = [
            other
            for other in wheels.values()
            if other.contact == ROLLING == wheel.contact
            and way * (other.longitudinal_position - wheel.longitudinal_position) > 0.0
            and abs(other.lateral_position - wheel.lateral_position)
            < 0.5 * (wheel.width + other.width)
        ]
        side = math.copysign(1.0, wheel.lateral_position) if wheel.lateral_position else 0.0
        place = way * wheel.longitudinal_position
        found = cls(index, side=side, ahead=place, leads=not ahead)
        return found.on_pass(1.0 + len(ahead))

    @lru_cache(maxsize=64)  # noqa: B019  # of positions there are two a wheel, and of numbers a few
    def on_pass(self, number: float | None) -> Position:
        """The position where the number of the pass is known; None: as the wheels' places say.

        Ruts deepen with a power of the number (Holm 1969), so their logarithm with log2 n; what passes
        compact is mostly done by the first ones, as 2 (1 - 1/n). Ruts are taken to be half way between.
        """
        if number is None:
            return self
        count = max(number, 1.0)
        deepens, compacts = math.log2(count), 2.0 * (1.0 - 1.0 / count)
        doubt = 0.5 * (deepens - compacts)
        return replace(self, passes=compacts + doubt, pass_doubt=abs(doubt))


NOWHERE = Position()


@dataclass(frozen=True)
class Segment(SinkageMeasurement):
    """A mean of readings; time and distance are those of the last one.

    variance: of the mean sinkage, from the sensor's noise. log_load_variance: of ln load, from the
    sensor's. load_rate: d ln load / d time, 1/s. place: of the wheel along the vehicle's path, m.
    count: readings in the mean; dropped: left out as outliers. shown: least and most that was shown, m. step:
    least difference of two readings of this sensor so far, m.
    """

    log_load_variance: float = 0.0
    load_rate: float = 0.0
    place: float = 0.0
    count: int = 1
    dropped: int = 0
    shown: tuple[float, float] = (0.0, 0.0)
    step: float = 0.0
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
