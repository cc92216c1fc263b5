"""Drawbar pull as predicted in simulated drives, with the strength configured and measured.

On slippery patches the simulator halves the thrust, and that is where its wheels slip most: what is
learnt from high slip is learnt there. So the errors stand apart for patches and the ground between.
"""

from __future__ import annotations

import argparse

import numpy as np
from _drives import measurements

from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.estimator.soil_estimator import SoilEstimator, SoilPrior
from smallwheel_ros.onboard.mobility import wheel_forces
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.physics.wheel import Quantity, Wheel
from smallwheel_ros.simulate.drive import DriveSettings, simulate_drive
from smallwheel_ros.simulate.terrain import draw_ground, grip

_BEGIN = 8.0  # s: before, little has been measured


def errors(seed: int, terrain: str, pulls: bool) -> np.ndarray:
    """Predicted less true pull (N), its deviation, and the grip; shape (predictions, 3)."""
    drive = simulate_drive(DriveSettings(seed=seed, terrain=terrain))
    ground = draw_ground(drive.settings.distance, np.random.default_rng([seed, 12]))
    prior = SoilPrior.from_soil(soil("dry_sand"))
    estimator, truth = SoilEstimator(prior), drive.truth
    places = {wheel.name: (j, wheel.x) for j, wheel in enumerate(drive.rover.wheels)}
    rows = []
    for one in measurements(drive, pulls):
        j, ahead = places[one.wheel]
        load, slip, pull, speed, way = (
            float(np.interp(one.time, truth.travel.time, values))
            for values in (
                truth.load[:, j],
                truth.slip,
                truth.drawbar_pull[:, j],
                truth.travel.speed,
                truth.travel.way,
            )
        )
        if one.time > _BEGIN and speed > 0.1:
            made = wheel_forces(
                Wheel(one.wheel, one.diameter, one.width),
                estimator.estimate(one.wheel),
                prior.strength_or_usual,
                Quantity(load, 0.0),
                Quantity(slip, 0.0),
            )
            if made is not None and made.drawbar_pull is not None:
                found = made.drawbar_pull
                held = float(grip(ground, np.array([way + ahead]))[0])
                rows.append((found.value - pull, found.standard_deviation, held))
        estimator.update(one)
    return np.array(rows)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=5)
    given = parser.parse_args()
    print("soils   strength    ground    bias [N]  rms [N]  rms over its deviation")
    for terrain in ("single", "mixed"):
        for pulls in (False, True):
            table = []
            for seed in range(given.drives):
                try:
                    table.append(errors(seed, terrain, pulls))
                except SmallwheelError as error:
                    print(f"drive {seed} left out: {error}")
            off, std, held = np.concatenate(table).T
            for name, rows in (
                ("all", held > 0),
                ("firm", held > 0.97),
                ("slippery", held < 0.97),
            ):
                rms, over = (np.sqrt(np.mean(x[rows] ** 2)) for x in (off, off / std))
                words = "measured" if pulls else "configured"
                print(
                    f"{terrain:7} {words:11} {name:9} {off[rows].mean():8.2f} {rms:8.2f} {over:8.2f}"
                )


if __name__ == "__main__":
    main()
