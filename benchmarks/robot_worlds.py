# SPDX-License-Identifier: Apache-2.0
"""Worlds for the robot half: ground and sensors with the faults that robots have.

A world is one structure; a seed draws its soil, its ground and its noise.

    world = WORLDS["zero +3 mm"]
    drive = make_drive(world, seed=1)   # of `robot_drives`
    soils, score = run(drive)           # of `robot_scores`
"""

from __future__ import annotations

from dataclasses import dataclass

from smallwheel_ros.physics.wheel import Wheel


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
    the rear wheels, which then run in the front ones' tracks. borders: m along the way, the factor on
    k and what n is more by from there on, over `border_length` m. prior: what the prior is off by, in
    ln pressure and n. exponent: the true n, else drawn. back: the second half goes back over the own
    ruts, with this factor on k. right: factor on k under the right wheels. silent: a wheel whose
    sinkage is not heard for 3 m. bedrock: m, of soil over something that is 30 times as hard.
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
    borders: tuple[tuple[float, float, float], ...] = ()
    border_length: float = 0.0
    noise: float = 5e-4
    exponent: float | None = None
    load_swing: float = 1.0
    load_tare: float = 0.0  # N that each load cell shows too much
    gain: float = 1.0  # of the sinkage sensors
    zero_drift: float = 0.0  # m, from the start of the drive to its end
    odometry: float = 1.0  # scale of distances and speeds
    silent: int | None = None
    back: float = 1.0
    right: float = 1.0
    bedrock: float | None = None


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
        once, back = ((12.0, factor, 0.0),), ((12.0, 1.0 / factor, 0.0),)
        found += [
            World(f"soil x{factor:g}", borders=once),
            World(f"soil x{1 / factor:.2g}", borders=back),
            World(f"soil x{factor:g} over 1 m", borders=once, border_length=1.0),
        ]
    # Of other kinds: what somebody else might think of.
    found += [
        World("two borders in 4 m", borders=((10.0, 2.0, 0.0), (14.0, 0.5, 0.0))),
        World("soil x2, n +0.3", borders=((12.0, 2.0, 0.3),)),
        World("soil x0.5, n -0.2", borders=((12.0, 0.5, -0.2),)),
        World("soil x1.3, equal, zero known", "equal", zero_std=3e-4, borders=((12.0, 1.3, 0.0),)),
        World("load hardly varies", load_swing=0.1),
        World("load hardly varies, equal, zero known", "equal", zero_std=3e-4, load_swing=0.1),
        World("zero +5 mm", zero=5e-3),
        World("load tare +3 N, zero known", load_tare=3.0, zero_std=3e-4),
        World("load tare +6 N, zero known", load_tare=6.0, zero_std=3e-4),
        World("sinkage gain 1.1, zero known", gain=1.1, zero_std=3e-4),
        World("zero drifts by 2 mm", zero_drift=2e-3),
        World("silent for 3 m", silent=0),
        World("odometry 3 % long", odometry=1.03),
        World("noise 3 mm, equal", "equal", noise=3e-3),
        World("n 0.3", exponent=0.3),
        World("n 1.3", exponent=1.3),
        World("n 1.3, zero known", exponent=1.3, zero_std=3e-4),
        World("back over own ruts", back=1.4),
        World("right x1.5", right=1.5),
        World("right x3, equal", "equal", right=3.0),
        World("bedrock at 8 mm", bedrock=8e-3),
        World("scatter 15 %, zero known", scatter=0.15, zero_std=3e-4),
        World("load +20 %, one wheel, zero known", load_scale=(1.2, 1, 1, 1), zero_std=3e-4),
        World("ruts k x1.6, zero known", "two sizes, one track", rut_modulus=1.6, zero_std=3e-4),
    ]
    return {world.name: world for world in found}


WORLDS = _worlds()
