# SPDX-License-Identifier: Apache-2.0
"""Margin over the soil's stiffness, for three friction angles: docs/images/margin.png."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from smallwheel_ros.estimator.path_steps import Sample
from smallwheel_ros.estimator.reading import Reading
from smallwheel_ros.estimator.settings import SoilPrior
from smallwheel_ros.estimator.soil_filter import LocalLaw
from smallwheel_ros.estimator.traction import TractionEstimator
from smallwheel_ros.onboard.mobility import wheel_forces
from smallwheel_ros.onboard.wheel_on_soil import wheels_on_soil
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.physics.wheel import Quantity, Strength, Wheel

WHEEL, LOAD = Wheel("wheel", 0.25, 0.10), Quantity(60.0, 0.0)
READING = Reading(WHEEL, 0, LOAD, None, None, None, 0.0, 0.0)


def main() -> None:
    """Draw it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/images/margin.png"))
    given = parser.parse_args()
    sand = soil("dry_sand")
    figure, axes = plt.subplots(figsize=(7.0, 4.0), layout="constrained")
    for angle in (0.35, 0.48, 0.6):
        strength = Strength(Quantity(0.0, 0.0), Quantity(angle, 0.0), Quantity(0.012, 0.0))
        traction = TractionEstimator(strength, [WHEEL])
        rows = []
        for factor in np.geomspace(0.03, 100.0, 60):
            kind = replace(sand, k=float(factor) * sand.k)
            law = LocalLaw.of(SoilPrior.from_soil(kind).law)
            (on,) = wheels_on_soil([Sample(READING, law, LOAD)])
            if on is not None:
                margin = wheel_forces(on, traction, None, reference=on).margin
                rows.append((1e3 * on.sinkage, margin.value if margin else math.nan))
        sinkage, margin = np.array(rows).T
        axes.semilogx(sinkage, margin, label=f"friction angle {math.degrees(angle):.0f} degrees")
    axes.invert_xaxis()
    axes.set_xlabel("sinkage of a wheel of 0.25 m under 60 N [mm]: softer, to harder ground")
    axes.set_ylabel("mobility margin at slip 0.4")
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")
    figure.savefig(given.output, dpi=110)


if __name__ == "__main__":
    main()
