# SPDX-License-Identifier: Apache-2.0
"""Slip tests that the node proposes: do they tell more than driving on, and do the deviations hold.

    python benchmarks/slip_tests.py --first 100 --seeds 40

Each seed is a rover on a soil of its own on level ground (the truth of `traction_worlds`: stresses by
quadrature, grip in blocks, sensors with errors of their own). It drives 4 m; then the same drive goes on for
1 m, or makes the slip test of the axle that is proposed, its braked wheels at the slip that balances the
vehicle. Printed: how often one was proposed, the deviations after both, and how often the truth is within
1.96 of them.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.robot_worlds import VEHICLES
from benchmarks.traction_rates import settings_of
from benchmarks.traction_worlds import GRAVITY, MASS, RATE, WORLDS, drawn, make_truth
from smallwheel_ros.estimator.reading import Reading
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.physics.wheel import Quantity, wheel_slip

Array = NDArray[np.float64]
_SLIPS = np.array([-0.6, -0.45, -0.3, -0.2, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5])
_TRAVEL, _WAY, _TEST = 0.2, 4.0, 1.0  # m/s, m, m
_NUMBERS = {"friction angle": math.degrees(1.0), "shear displacement": 100.0}
KINDS = ("balance", "torque", "balance and torque", "pull sensor")


class Rover:
    """The truth along a path, and the sensors; feeds an assessor."""

    def __init__(self, world: str, seed: int) -> None:
        self.wheels = VEHICLES[WORLDS[world].vehicle]
        rng = np.random.default_rng([seed, 816])
        found = None
        while found is None:
            law, self.strength = drawn(WORLDS[world], rng)
            found = make_truth(
                WORLDS[world], rng, self.wheels, law, self.strength, _SLIPS, level=True
            )
        self._way, _, self._loads, self._sinkages, self._nets, self._torques = found
        self._radius, self._scale = (
            1.0 + 0.01 * rng.standard_normal(4),
            1.0 + 0.03 * rng.standard_normal(4),
        )
        self._tilt, self._rng = math.radians(0.3) * rng.standard_normal(), rng
        self.at, self.time = 0.0, 0.0

    def drive(
        self, assessor: Onboard, kind: str, length: float, slips: Callable[[Array], Array]
    ) -> None:
        """slips: of the wheels, from their pulls by `_SLIPS` here, shape (wheels, slips)."""
        end = self.at + length
        while self.at < end:
            cell = int(np.searchsorted(self._way, self.at))
            there = slips(self._nets[:, cell])
            self._show(assessor, kind, cell, there)
            self.time += 1.0 / RATE
            self.at += _TRAVEL / RATE

    def _show(self, assessor: Onboard, kind: str, cell: int, slips: Array) -> None:
        normal = self._rng.standard_normal
        speed = _TRAVEL + 0.008 * normal() / math.sqrt(5.0)
        tilt = GRAVITY * math.sin(self._tilt + math.radians(0.3) * normal())
        for j, wheel in enumerate(self.wheels):
            slip = slips[j]
            rim = _TRAVEL / (1.0 - slip) if slip >= 0.0 else _TRAVEL * (1.0 + slip)
            rim = rim * self._radius[j] + 0.002 * normal()
            torque = float(np.interp(slip, _SLIPS, self._torques[j, cell]))
            pull = float(np.interp(slip, _SLIPS, self._nets[j, cell]))
            noise = Quantity(speed, 0.01), Quantity(float(rim), 0.01 * abs(float(rim)))
            assessor.assess(
                Reading(
                    wheel, int(1e9 * self.time) + j,
                    Quantity(max(float(self._loads[j, cell]) * (1.0 + 0.02 * normal()), 1.0), 1.2),
                    wheel_slip(*noise, 0.01),
                    Quantity(float(self._sinkages[j, cell]) + 1e-3 * normal(), 1e-3),
                    speed, self.at, self.at, rim_speed=float(rim),
                    speed_std=noise[0].standard_deviation, rim_std=noise[1].standard_deviation,
                    slope_force=tilt if "balance" in kind else None, gained_force=0.0,
                    torque=(torque + 0.05 + 0.03 * normal()) * self._scale[j] if "torque" in kind else None,
                    drawbar_pull=Quantity(pull + 0.6 * normal(), 0.6) if kind == "pull sensor" else None,
                )
            )  # fmt: skip


def plain(pulls: Array) -> Array:
    """All wheels at the slip that balances the vehicle."""
    total = np.maximum.accumulate(pulls.sum(axis=0))
    return np.full(len(pulls), np.interp(0.0, total, _SLIPS))


def testing(axle: list[int], slip: float) -> Callable[[Array], Array]:
    """An axle at a slip, the others at the one that holds it."""

    def slips(pulls: Array) -> Array:
        held = sum(np.interp(slip, _SLIPS, pulls[j]) for j in axle)
        braked = [j for j in range(len(pulls)) if j not in axle]
        found = np.full(len(pulls), slip)
        found[braked] = np.interp(-held, np.maximum.accumulate(pulls[braked].sum(axis=0)), _SLIPS)
        return found

    return slips


def driven(
    world: str, seed: int, kind: str, testing_axle: list[int] | None
) -> tuple[Rover, Onboard]:
    """The same 4 m, and then 1 m more: as before, or the slip test of an axle."""
    rover = Rover(world, seed)
    mass = MASS if "balance" in kind else 0.0
    assessor = Onboard(settings_of(WORLDS[world].vehicle, mass))
    rover.drive(assessor, kind, _WAY, plain)
    assessor.find_slip_tests()
    way = plain if testing_axle is None else testing(testing_axle, 0.4)
    rover.drive(assessor, kind, _TEST, way)
    return rover, assessor


def share(held: Array) -> str:
    """Count, and the lower end of Wilson's 95 % interval."""
    count = int(held.sum())
    least = binomtest(count, len(held)).proportion_ci(method="wilson").low
    return f"{count} of {len(held)} ({least:.2f} up)"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--worlds", nargs="*", default=["cruise", "cruise, equal", "other shear"])
    given = parser.parse_args()
    print(
        "| measured | proposed | number | deviation: before, driving on, slip test | expected |"
        " in 1.96 of it: driving on, slip test |"
    )
    print("| --- | --- | --- | --- | --- | --- |")
    for kind in KINDS:
        rows, proposed = defaultdict(list), 0
        for i in range(given.seeds):
            world = given.worlds[i % len(given.worlds)]
            rover, on = driven(world, given.first + i, kind, None)
            if not on.slip_tests:
                continue
            proposed += 1
            best = min(on.slip_tests, key=lambda one: one.after / one.driving_on)
            front = "front" in best.what
            axle = [
                j for j, w in enumerate(rover.wheels) if (w.longitudinal_position > 0.0) == front
            ]
            _, tested = driven(world, given.first + i, kind, axle)
            truth = rover.strength[1], math.log(rover.strength[2])
            expected = {one.quantity: one for one in on.slip_tests}
            for k, (name, by) in enumerate(_NUMBERS.items()):
                if name not in expected:
                    continue
                row = [expected[name].now, expected[name].after]
                for one in (on, tested):
                    mean, covariance = one.traction.reserve.strength
                    deviation = math.sqrt(covariance[k + 1, k + 1])
                    row += [by * deviation, abs(mean[k + 1] - truth[k]) < 1.96 * deviation]
                rows[name].append(row)
        for name, found in rows.items():
            table = np.array(found, dtype=float)
            now, expected, on, held_on, after, held = table.T
            before_and_after = f"{now.mean():.1f}, {on.mean():.1f}, {after.mean():.1f}"
            print(
                f"| {kind} | {proposed} of {given.seeds} | {name} | {before_and_after};"
                f" smaller in {int((after < on).sum())} of {len(on)} | {expected.mean():.1f} |"
                f" {share(held_on)}, {share(held)} |"
            )


if __name__ == "__main__":
    main()
