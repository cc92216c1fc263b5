# SPDX-License-Identifier: Apache-2.0
"""Simulated drives of a small rover: what its sensors record, and the answer apart from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any

import numpy as np

from smallwheel_ros.common.options import Option
from smallwheel_ros.simulate.hidden import (
    FRACTION,
    FormOfHidden,
    Hidden,
    Seed,
    Strength,
    check_form,
    check_hidden,
    check_ranges,
    draw_effects,
    in_drives,
)
from smallwheel_ros.simulate.hidden_effects import HiddenEffect
from smallwheel_ros.simulate.ride import WheelTruth, ride
from smallwheel_ros.simulate.rover import ROVERS, Rover, travel
from smallwheel_ros.simulate.sensors import (
    EPOCH,
    ImuReadings,
    JointReadings,
    LoadReadings,
    OdometryReadings,
    Sensors,
    SinkageReadings,
)
from smallwheel_ros.simulate.terrain import (
    FINISHES,
    TERRAINS,
    Stretch,
    draw_finish,
    draw_ground,
    draw_stretches,
)
from smallwheel_ros.simulate.truth import SimulationError


@dataclass(frozen=True)
class DriveSettings:
    """What drive to simulate: the options of `smallwheel simulate drive`.

    The same seed gives the same drive, to the byte. `wheels` may be a rover of your own, and `stretches`,
    where given, are driven over instead of `terrain`. A `finish` is what the drive ends in after
    `distance`, stuck: a slope that steepens, or slippery ground. With dropouts above 0 one wheel's
    sinkage is also missing for 1.5 s.
    """

    seed: Seed = 0
    distance: Annotated[float, Option("Way, m.", (2.0, 20_000.0, "m"))] = 30.0
    speed: Annotated[float, Option("Middle speed, m/s.", (0.01, 3.0, "m/s"))] = 0.5
    wheels: Annotated[str | Rover, Option(f"{' or '.join(ROVERS)}.")] = "four"
    terrain: Annotated[str, Option(f"{' or '.join(TERRAINS)} soil.")] = "mixed"
    stretches: tuple[Stretch, ...] | None = None
    finish: Annotated[str, Option(f"What it ends in, stuck: {', '.join(FINISHES)}.")] = "none"
    hidden: Hidden = ()
    strength: Strength = 1.0
    form: FormOfHidden = "own"
    noise: Annotated[float, Option("Factor on every sensor's noise.", (0.0, 20.0))] = 1.0
    outliers: Annotated[
        float, Option("Share of measured sinkages that are grossly wrong.", (0.0, 0.5), FRACTION)
    ] = 0.0
    dropouts: Annotated[
        float, Option("Share of load and sinkage messages that are missing.", (0.0, 0.9), FRACTION)
    ] = 0.01

    def rover(self) -> Rover:
        """Return the rover that drives."""
        if isinstance(self.wheels, Rover):
            return self.wheels
        if self.wheels not in ROVERS:
            raise SimulationError(
                f"wheels {self.wheels!r} are unknown: expected {' or '.join(ROVERS)}"
            )
        return ROVERS[self.wheels]

    def check(self) -> DriveSettings:
        """Return the settings without `none` among the hidden effects.

        Raises
        ------
        SimulationError
            Naming the setting, what it was, and what was expected.
        """
        check_ranges(self)
        check_form(self.form)
        if self.finish not in FINISHES:
            raise SimulationError(
                f"finish {self.finish!r} is unknown: expected {', '.join(FINISHES)}"
            )
        self.rover()
        hidden = check_hidden(self.hidden)
        for name in hidden:
            if not in_drives(name):
                raise SimulationError(
                    f"hidden effect {name!r} cannot be in a drive: what it depends on or acts on"
                    " has no sensor there; use `simulate rig`"
                )
        return replace(self, hidden=hidden)


@dataclass(frozen=True)
class Drive:
    """One drive: readings by wheel name and of the whole rover, and what was true."""

    settings: DriveSettings
    rover: Rover
    stretches: tuple[Stretch, ...]
    effects: tuple[HiddenEffect, ...]
    truth: WheelTruth
    load: Mapping[str, LoadReadings]
    sinkage: Mapping[str, SinkageReadings]
    odometry: OdometryReadings
    joints: JointReadings
    imu: ImuReadings

    @property
    def message_count(self) -> int:
        """How many messages the readings are."""
        stamps = [self.odometry.stamp, self.joints.stamp, self.imu.stamp]
        stamps += [readings.stamp for readings in self.load.values()]
        stamps += [readings.stamp for readings in self.sinkage.values()]
        return sum(stamp.size for stamp in stamps)

    def answer(self) -> dict[str, Any]:
        """Return what the bag must not say: soils, hidden effects, true values over time.

        Times are seconds after `epoch_ns`, the zero of the bag's header stamps; otherwise SI units.
        """
        truth, trip = self.truth, self.truth.travel
        time = trip.time
        settings = asdict(self.settings) | {"wheels": [asdict(w) for w in self.rover.wheels]}
        settings.pop("stretches")
        wheels = {}
        for j, wheel in enumerate(self.rover.wheels):
            readings = self.sinkage[wheel.name]
            at = (readings.stamp - EPOCH) / 1e9
            wheels[wheel.name] = {
                "time": _rounded(at, 9),
                "sinkage": _rounded(np.interp(at, time, truth.sinkage[:, j]), 7),
                "load": _rounded(np.interp(at, time, truth.load[:, j]), 4),
                "slip": _rounded(np.interp(at, time, truth.slip), 5),
                "drawbar_pull": _rounded(np.interp(at, time, truth.drawbar_pull[:, j]), 4),
                "torque": _rounded(np.interp(at, time, truth.torque[:, j]), 4),
                "stretch": truth.stretch[np.searchsorted(time, at, side="right") - 1, j].tolist(),
                "moving": (np.interp(at, time, trip.speed) > 1e-3).tolist(),
                "outlier": readings.outlier.tolist(),
            }
        stuck = trip.stuck
        return {
            "kind": "drive",
            "epoch_ns": EPOCH,
            "settings": settings,
            "mass": self.rover.mass,
            "stuck": None
            if stuck is None
            else {"time": round(float(time[stuck]), 3), "way": round(float(trip.way[stuck]), 4)},
            "hidden": [effect.describe() for effect in self.effects],
            "stretches": [{"start": s.start} | asdict(s.soil) for s in self.stretches],
            "wheels": wheels,
            "rover": {
                "time": _rounded(time, 3),
                "way": _rounded(trip.way, 4),
                "speed": _rounded(trip.speed, 4),
                "slip": _rounded(truth.slip, 5),
                "climb": _rounded(trip.climb, 5),
                "x": _rounded(trip.x, 4),
                "y": _rounded(trip.y, 4),
            },
        }


def _rounded(values: Any, digits: int) -> list[float]:
    rounded: list[float] = np.round(values, digits).tolist()
    return rounded


def simulate_drive(settings: DriveSettings) -> Drive:
    """Simulate a drive; the same settings give the same numbers.

    Raises
    ------
    SimulationError
        If a setting is outside its range, or a wheel sinks to its axle.
    """
    settings = settings.check()
    rover = settings.rover()
    # Streams of their own: more outliers do not change the ground, nor another soil the noise.
    effects = draw_effects(
        settings.hidden,
        np.random.default_rng([settings.seed, 10]),
        settings.strength,
        settings.form,
    )
    stretches = settings.stretches or draw_stretches(
        settings.terrain, settings.distance, np.random.default_rng([settings.seed, 11])
    )
    ground = replace(
        draw_ground(settings.distance, np.random.default_rng([settings.seed, 12])),
        finish=draw_finish(
            settings.finish, settings.distance, np.random.default_rng([settings.seed, 13])
        ),
    )
    truth = ride(
        rover, ground, stretches, effects, travel(ground, settings.distance, settings.speed)
    )
    sensors = Sensors(
        truth,
        rover,
        settings.seed,
        noise=settings.noise,
        outliers=settings.outliers,
        dropouts=settings.dropouts,
    )
    names = [wheel.name for wheel in rover.wheels]
    return Drive(
        settings=settings,
        rover=rover,
        stretches=stretches,
        effects=effects,
        truth=truth,
        load={name: sensors.load(j) for j, name in enumerate(names)},
        sinkage={name: sensors.sinkage(j) for j, name in enumerate(names)},
        odometry=sensors.odometry(),
        joints=sensors.joints(),
        imu=sensors.imu(),
    )
