# SPDX-License-Identifier: Apache-2.0
"""A drive with hidden slip-sinkage through the estimator: the alarm, and the effect added.

    python benchmarks/missing_effect.py [--seed N] [--picture FILE]

Nothing is timed: it shows what the alarm is worth on one drive, in numbers and as a picture. The
effect is added as the alarm names it, in the form and with the strength that it finds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

# As a script this file finds its neighbours, as a module of the repository its package.
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))


from benchmarks._drives import measurements
from benchmarks._innovations import Innovations, innovations_picture
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.registry import effect, effect_class
from smallwheel_ros.estimator.soil_estimator import Reading, SoilEstimator, SoilPrior
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.simulate import DriveSettings, simulate_drive


def follow(
    title: str, given: Sequence[Reading], effects: Sequence[Effect]
) -> tuple[SoilEstimator, Innovations]:
    """Run the estimator over a drive."""
    e = SoilEstimator(SoilPrior.from_soil(soil("dry_sand")), effects=effects)
    alarm, results = None, []
    for one in given:
        results.append(e.update(one))
        if alarm is None and e.missing_effect is not None:
            alarm = e.missing_effect.distance
    return e, Innovations.of(title, given, results, alarm)


def both(
    seed: int, distance: float = 30.0
) -> tuple[SoilEstimator, Innovations, SoilEstimator, Innovations]:
    """Without the effect, and with it as named."""
    drive = simulate_drive(
        DriveSettings(seed=seed, distance=distance, terrain="single", hidden=("slip_sinkage",))
    )
    given = measurements(drive)
    e, before = follow("model without effects", given, ())
    best = e.effect_scores[0]
    name = effect_class(best.effect, best.form).parameters()[0].name
    added = effect(best.effect, best.form, **{name: best.strength})
    title = f"with {best.effect}, form {best.form}, {name} = {best.strength:.2f}"
    return e, before, *follow(title, given, (added,))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=4)
    parser.add_argument("--picture", type=Path)
    arguments = parser.parse_args()
    first, before, second, after = both(arguments.seed)
    for e, one in ((first, before), (second, after)):
        found = e.missing_effect
        print(one.title)
        print(
            f"  alarm: {'none' if found is None else f'{found.effect} at {found.distance:.1f} m'}"
        )
        print(
            f"  innovations: mean square {np.mean(np.clip(one.normalised, -6, 6) ** 2):.2f}, "
            f"correlation with the next {one.correlation[0][0]:.3f} "
            f"(chance {one.correlation[1][0]:.3f}), not used {100 * np.mean(~one.accepted):.1f} %, "
            f"changes of soil {e.soil_changes}"
        )
    if arguments.picture is not None:
        innovations_picture(before, after).savefig(arguments.picture, dpi=110)


if __name__ == "__main__":
    main()
