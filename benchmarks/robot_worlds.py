"""Worlds for the robot half: ground and sensors with the faults that robots have.

The truth is a contact integral of its own (`simulate.truth`, quadrature), with ground, ruts, digging
and sensors composed here and nowhere in the estimator. A world is one structure; a seed draws its
soil, its ground and its noise.

    world = WORLDS["zero +3 mm"]
    drive = make_drive(world, seed=1)
    score = evaluate(drive)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.soil_estimator import (
    EstimatorSettings,
    SinkageMeasurement,
    SoilEstimate,
    SoilEstimator,
    SoilPrior,
)
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE, soil
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.simulate.truth import static_sinkage

Array = NDArray[np.float64]

RATE = 10.0  # Hz, of sinkage with its load
SPEED = 0.3  # m/s
STD = (0.5, 0.2, 0.3)  # of ln pressure, n and m about the prior, for the truth
_LOCAL = 0.25  # m, over which the soil's texture is correlated


def _corners(
    front: tuple[float, float], rear: tuple[float, float], rear_track: float = 0.5
) -> tuple[Wheel, ...]:
    return tuple(
        Wheel(
            f"{end}_{side}",
            *size,
            longitudinal_position=x,
            lateral_position=y if end == "front" else rear_track * y,
        )
        for end, x, size in (("front", 0.35, front), ("rear", -0.35, rear))
        for side, y in (("left", 0.28), ("right", -0.28))
    )


VEHICLES = {
    "two sizes": _corners((0.25, 0.10), (0.40, 0.12)),
    "equal": _corners((0.25, 0.10), (0.25, 0.10)),
    "two sizes, one track": _corners((0.25, 0.10), (0.40, 0.12), 1.0),
    "equal, one track": _corners((0.25, 0.10), (0.25, 0.10), 1.0),
}


@dataclass(frozen=True)
class World:
    """What is in a world besides the nominal. Lengths m, shares as 1 = 100 %.

    told: the load noise that the estimator is told, over the true one. rut: factors on k and z of
    the rear wheels, which then run in the front ones' tracks. change: factors on k at half way, over
    `change_over` m. prior: what the prior is off by, in ln pressure and n.
    """

    name: str
    vehicle: str = "two sizes"
    distance: float = 24.0
    load_noise: float = 0.012
    told: float = 1.0
    zero: float = 0.0
    zero_std: float = 0.002  # that the estimator is told
    load_scale: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)
    delay: float = 0.0
    rough: float = 0.0
    rut_modulus: float = 1.0
    rut_sinkage: float = 1.0
    scatter: float = 0.05
    drift: float = 0.0  # of ln k, standard deviation after 5 m
    correlated: float = 0.0  # m, noise of sinkage that lasts for a second
    step: float = 0.0  # m, quantisation
    outliers: float = 0.0
    turns: int = 0  # on the spot, a full circle each
    firm: bool = False
    stuck: int | None = None  # wheel whose sinkage sensor sticks from a third of the way on
    rebound: float = 0.0  # m/Pa
    pitch_error: float = 0.0  # m/rad
    slip_sinkage: float = 0.0
    prior: tuple[float, float] = (0.0, 0.0)
    change: float = 1.0
    change_over: float = 0.0
    noise: float = 5e-4


def _worlds() -> dict[str, World]:
    found = [World("nominal"), World("nominal, equal", "equal")]
    found += [
        World("zero known", zero_std=3e-4),
        World("zero known, equal", "equal", zero_std=3e-4),
        World("load noise 5 %", load_noise=0.05),
        World("load noise 10 %", load_noise=0.10),
        World("load noise 10 %, told half", load_noise=0.10, told=0.5),
        World("zero +1 mm", zero=1e-3),
        World("zero +3 mm", zero=3e-3),
        World("zero -1 mm", zero=-1e-3),
        World("zero +3 mm, equal", "equal", zero=3e-3),
        World("load +10 %", load_scale=(1.1,) * 4),
        World("load -20 %", load_scale=(0.8,) * 4),
        World("load +20 %, one wheel", load_scale=(1.2, 1.0, 1.0, 1.0)),
        World("delay 50 ms", delay=0.05),
        World("delay 200 ms", delay=0.2),
        World("rough 3 mm", rough=3e-3),
        World("one track", "two sizes, one track"),
        World("one track, equal", "equal, one track"),
        World("ruts k x1.6", "two sizes, one track", rut_modulus=1.6),
        World("ruts z x1.23, equal", "equal, one track", rut_sinkage=1.23),
        World("scatter 15 %", scatter=0.15),
        World("drift 20 %", drift=0.2),
        World("correlated noise", correlated=1e-3),
        World("quantised 1 mm", step=1e-3),
        World("outliers 5 %", outliers=0.05),
        World("turning", turns=3),
        World("firm", firm=True, noise=1e-3),
        World("stuck sensor", stuck=0),
        World("rebound", rebound=1e-7),
        World("pitch error", pitch_error=0.03),
        World("slip sinkage 1", slip_sinkage=1.0),
        World("slip sinkage 3", slip_sinkage=3.0),
        World("prior far off", prior=(1.5, 0.4)),
    ]
    for factor in (1.3, 1.5, 2.0, 3.0):
        found += [
            World(f"soil x{factor:g}", change=factor),
            World(f"soil x{1 / factor:.2g}", change=1.0 / factor),
            World(f"soil x{factor:g} over 1 m", change=factor, change_over=1.0),
        ]
    return {world.name: world for world in found}


WORLDS = _worlds()


@dataclass(frozen=True)
class RobotDrive:
    """Readings in order, and of each the true sinkage (m) and whether the wheel is past the change.

    truth: ln pressure, n and m where the drive ends. border: m along the path, or None.
    """

    world: World
    prior: SoilPrior
    readings: list[SinkageMeasurement]
    sinkage: Array
    truth: Array
    border: float | None


def _smooth(rng: np.random.Generator, count: int, std: float, keep: float) -> Array:
    values = std * rng.standard_normal(count)
    for i in range(1, count):
        values[i] = keep * values[i - 1] + math.sqrt(1.0 - keep * keep) * values[i]
    return values


def _texture(world: World, rng: np.random.Generator) -> tuple[Array, Array]:
    """Ln of the factor on k in steps of 1 cm along the way, for the left and the right track."""
    count = int((world.distance + 4.0) / 0.01)
    way = 0.01 * np.arange(count) - 2.0
    common = np.cumsum(rng.standard_normal(count)) * world.drift * math.sqrt(0.01 / 5.0)
    if world.change != 1.0:
        over = max(world.change_over, 1e-6)
        common = common + math.log(world.change) * np.clip(
            (way - 0.5 * world.distance) / over, 0.0, 1.0
        )
    tracks = [_smooth(rng, count, world.scatter, math.exp(-0.01 / _LOCAL)) for _ in range(4)]
    return way, common + np.array(tracks)


def make_drive(world: World, seed: int) -> RobotDrive:
    """Draw a drive; a soil that does not carry the wheels is drawn again."""
    rng = np.random.default_rng([seed, 4711])
    base = soil("dry_sand")
    wheels = VEHICLES[world.vehicle]
    way, texture = _texture(world, rng)
    driving = int(world.distance / SPEED * RATE)
    path = np.cumsum(SPEED / RATE * (1.0 + 0.3 * np.sin(0.7 * np.arange(driving) / RATE)))
    path *= world.distance / path[-1]
    turning = np.zeros(driving)  # rad/s
    standing = int(8.0 * RATE)
    for i in range(world.turns):
        at = int((i + 1) / (world.turns + 1) * len(path))
        path = np.insert(path, at, np.full(standing, path[at]))
        turning = np.insert(turning, at, np.full(standing, 2.0 * math.pi / 8.0))
    time = np.arange(len(path)) / RATE
    speed = np.gradient(path, time)
    climb = sum(
        a * np.sin(2.0 * np.pi * path / length + rng.uniform(0.0, 6.28))
        for a, length in ((0.06, 9.0), (0.06, 4.0))
    )
    bumps = 3.0 if world.delay else 1.0
    twist = sum(
        a * np.sin(2.0 * np.pi * path / length + rng.uniform(0.0, 6.28))
        for a, length in ((0.22, 2.6 / bumps), (0.18, 1.4 / bumps))
    )
    grip = (
        0.06
        + 0.9 * np.clip(climb, -0.03, 1.0)
        + 0.3
        * np.clip(np.sin(2.0 * np.pi * path / 6.0 + rng.uniform(0.0, 6.28)) - 0.8, 0.0, 1.0)
        / 0.2
    )
    while True:
        off = [std * rng.standard_normal() for std in STD]
        pressure, n, m = (
            mean + part
            for mean, part in zip((base.log_reference_pressure, base.n, base.m), off, strict=True)
        )
        if world.firm:
            pressure += 3.2
        if not 0.25 < n < 1.8:
            continue
        parts = _truth(world, wheels, (pressure, n, m), way, texture, path, climb, twist, grip)
        if all(_carried(z, w) for (z, *_), w in zip(parts, wheels, strict=True)):
            break
    readings, true = [], []
    for j, (wheel, (z, load, slip)) in enumerate(zip(wheels, parts, strict=True)):
        shown, weighed = _sensors(world, rng, j, wheel, z, load, climb, time)
        own = np.concatenate(
            [[0.0], np.cumsum(np.abs(speed - turning * wheel.lateral_position)[1:] / RATE)]
        )
        moving = np.abs(speed) > 0.02
        for i in range(len(time)):
            readings.append(
                SinkageMeasurement(
                    float(time[i] + 0.001 * j),
                    wheel.name,
                    float(shown[i]),
                    world.noise**2,
                    float(weighed[i]),
                    float((world.told * world.load_noise * weighed[i]) ** 2),
                    wheel.diameter,
                    wheel.width,
                    float(path[i]),
                    slip=float(np.clip(slip[i] + 0.02 * rng.standard_normal(), -1, 1))
                    if moving[i]
                    else None,
                    speed=float(abs(speed[i])),
                    path=float(own[i]),
                    pitch=float(-climb[i]),
                )
            )
            true.append(float(z[i]))
    order = sorted(range(len(readings)), key=lambda i: readings[i].time)
    end = float(np.interp(path[-1], way, texture.mean(axis=0)))
    law = np.array([pressure + end, n, m])
    prior = replace(
        SoilPrior.from_soil(base),
        log_reference_pressure=base.log_reference_pressure - world.prior[0],
        n=max(base.n - world.prior[1], 0.2),
    )
    border = 0.5 * world.distance if world.change != 1.0 else None
    return RobotDrive(
        world, prior, [readings[i] for i in order], np.array([true[i] for i in order]), law, border
    )


def _carried(sinkage: Array, wheel: Wheel) -> bool:
    return bool(np.isfinite(sinkage).all() and sinkage.max() < 0.4 * wheel.diameter)


def _truth(
    world: World,
    wheels: tuple[Wheel, ...],
    law: tuple[float, float, float],
    way: Array,
    texture: Array,
    path: Array,
    climb: Array,
    twist: Array,
    grip: Array,
) -> list[tuple[Array, Array, Array]]:
    """True sinkage, load and slip of each wheel."""
    pressure, n, m = law
    parts = []
    for j, wheel in enumerate(wheels):
        place = path + wheel.longitudinal_position
        track = j % 2 if "one track" in world.vehicle else j
        local = np.interp(place, way, texture[track])
        side = 1.0 if j in (0, 3) else -1.0
        end = 1.0 if wheel.longitudinal_position > 0 else -1.0
        load = 58.0 * (1.0 - 0.9 * end * climb) * np.maximum(1.0 + side * twist, 0.15)
        modulus = np.exp(
            pressure
            + local
            - n * math.log(REFERENCE_SINKAGE)
            + m * math.log(wheel.diameter / REFERENCE_DIAMETER)
        )
        rear = wheel.longitudinal_position < 0
        if rear:
            modulus = modulus * world.rut_modulus
        z = static_sinkage(
            lambda depth, K=modulus: K[:, None] * np.maximum(depth, 0.0) ** n,
            load,
            np.full(len(path), wheel.diameter),
            np.full(len(path), wheel.width),
        )
        slip = np.clip(grip, -0.05, 0.5)
        # Soil that is carried out from under the wheel: deeper with the square root at little slip.
        dig = np.where(slip > 0, slip * (1.0 + 0.4 * slip), 0.0)
        z = z * (1.0 + world.slip_sinkage * dig)
        if rear:
            z = z * world.rut_sinkage
        parts.append((z, load, slip))
    return parts


def _sensors(
    world: World,
    rng: np.random.Generator,
    j: int,
    wheel: Wheel,
    z: Array,
    load: Array,
    climb: Array,
    time: Array,
) -> tuple[Array, Array]:
    """What the sensors of sinkage and load show."""
    count = len(z)
    late = np.interp(time - world.delay, time, z)
    length = np.sqrt(np.maximum(z, 1e-6) * wheel.diameter)
    shown = late - world.rebound * load / (wheel.width * length)
    shown = shown + world.zero - world.pitch_error * climb
    if world.rough:
        # The surface that the sensor looks at, correlated over 5 cm.
        keep = math.exp(-SPEED / RATE / 0.05)
        shown = shown + _smooth(rng, count, world.rough, keep)
    if world.correlated:
        shown = shown + _smooth(rng, count, world.correlated, math.exp(-1.0 / RATE))
    shown = shown + np.hypot(world.noise, 0.03 * z) * rng.standard_normal(count)
    wild = rng.uniform(size=count) < world.outliers
    shown = np.where(wild, z * rng.uniform(2.0, 5.0, count) + rng.uniform(0, 0.02, count), shown)
    if world.step:
        shown = world.step * np.round(shown / world.step)
    if world.stuck == j:
        third = count // 3
        shown[third:] = shown[third]
    weighed = load * world.load_scale[j] * (1.0 + world.load_noise * rng.standard_normal(count))
    weighed = np.maximum(weighed + 0.4 * rng.standard_normal(count), 0.1)
    return shown, weighed


@dataclass
class Score:
    """What came of a drive.

    wrong: flags that said determined and were over 3 deviations off; determined: all such flags.
    held: share of readings whose true sinkage was inside the 95 % band. found: m after the border.
    """

    world: str
    seed: int
    determined: dict[str, bool] = field(default_factory=dict)
    wrong: dict[str, float] = field(default_factory=dict)
    error: dict[str, float] = field(default_factory=dict)
    deviation: dict[str, float] = field(default_factory=dict)
    held: float = math.nan
    changes: int = 0
    found: float = math.nan
    effect: str = ""
    findings: tuple[str, ...] = ()


def run(drive: RobotDrive) -> tuple[SoilEstimator, Score]:
    """Let the estimator drive, and score it."""
    world = drive.world
    settings = EstimatorSettings(sinkage_zero_std=world.zero_std)
    estimator = SoilEstimator(drive.prior, settings, wheels=VEHICLES[world.vehicle])
    score = Score(world.name, 0)
    held: list[bool] = []
    for reading, true in zip(drive.readings, drive.sinkage, strict=True):
        result = estimator.update(reading)
        if result.predicted_sinkage is not None and result.predicted_variance is not None:
            off = abs(result.predicted_sinkage - true)
            held.append(bool(off <= 1.96 * math.sqrt(result.predicted_variance)))
        if drive.border is not None and math.isnan(score.found) and estimator.soil_changes:
            score.found = reading.distance - drive.border
    estimate = estimator.estimate()
    score.held = float(np.mean(held))
    score.changes = estimator.soil_changes
    score.findings = estimator.findings
    alarm = estimator.missing_effect
    score.effect = "" if alarm is None else alarm.effect
    _judge(estimate, drive.truth, score)
    return estimator, score


def _judge(estimate: SoilEstimate, truth: Array, score: Score) -> None:
    pressure, n, m = truth
    across = math.log(estimate.reference_diameter / REFERENCE_DIAMETER)
    log_modulus = pressure - n * math.log(REFERENCE_SINKAGE) + m * across
    modulus, deviation = estimate.effective_modulus()
    covariance = estimate.log_covariance
    values = {
        "reference_pressure": (estimate.log_reference_pressure, pressure, covariance[0, 0] ** 0.5),
        "n": (estimate.n, n, covariance[1, 1] ** 0.5),
        "m": (estimate.m, m, covariance[2, 2] ** 0.5),
        "effective_modulus": (math.log(modulus), log_modulus, deviation / modulus),
    }
    for name, (value, true, std) in values.items():
        score.error[name], score.deviation[name] = value - true, std
        score.determined[name] = bool(getattr(estimate.identifiable, name))
        sigmas = abs(value - true) / std
        if score.determined[name] and sigmas > 3.0:
            score.wrong[name] = sigmas
