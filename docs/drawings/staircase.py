# SPDX-License-Identifier: Apache-2.0
"""The moving picture of README.md: errors on the real rig as one effect after the other is added.

python docs/drawings/staircase.py examples/data/cmu_wheel_rig docs/images/rig_staircase.gif
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure

import smallwheel_ros as sw

STILL, MOVING = 20, 8  # frames of each step at rest, and on the way to the next; 10 a second
BLUE, GREY = "#0072b2", "#999999"


def main(folder: Path, target: Path) -> None:
    """Diagnose, and draw the held-out errors step by step."""
    calibrated = sw.fit(folder / "indentation.csv").model
    rolling = sw.read(folder / "rolling_smooth_wheel.csv")
    straight = rolling.take(np.flatnonzero(rolling.conditions["slip_angle"] == 0.0))
    found = sw.diagnose(straight, model=calibrated)
    slip = straight.conditions["slip"]
    errors = [1e3 * step.errors.error["sinkage"] for step in found.steps]
    names = ["law alone", *(f"+ {step.added.replace('_', ' ')}" for step in found.steps[1:])]
    rms = [float(np.sqrt(np.nanmean(e**2))) for e in errors]

    figure = Figure(figsize=(8.0, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    high = 1.1 * max(np.nanmax(np.abs(e)) for e in errors)
    left.axhline(0.0, color=GREY, lw=1)
    left.set(xlabel="slip", ylabel="measured - predicted sinkage [mm]", ylim=(-0.3 * high, high))
    left.set_title("runs that the fit did not see", fontsize=10)
    points = left.plot(slip, errors[0], "o", color=BLUE)[0]
    bars = right.barh(names, rms, color=BLUE)
    right.invert_yaxis()
    right.set(xlabel="held-out error, rms [mm]", xlim=(0, 1.45 * rms[0]))
    words = [right.text(r, i, f" {r:.3g} mm", va="center") for i, r in enumerate(rms)]
    figure.suptitle("A 116 mm wheel on sand: what the law of pressure lacks, found and added")

    def draw(frame: int) -> None:
        step, within = divmod(frame, STILL + MOVING)
        share = min(max(within - STILL + 1, 0) / MOVING, 1.0) if step + 1 < len(errors) else 0.0
        now = errors[step] + share * (errors[min(step + 1, len(errors) - 1)] - errors[step])
        points.set_ydata(now)
        for i, (bar, word) in enumerate(zip(bars, words, strict=True)):
            seen = i <= step or (i == step + 1 and share == 1.0)
            bar.set_visible(seen)
            word.set_visible(seen)

    frames = len(errors) * (STILL + MOVING)
    FuncAnimation(figure, draw, frames=frames).save(target, writer=PillowWriter(fps=10), dpi=90)
    print(f"{target}: {', '.join(f'{n} {r:.3g} mm' for n, r in zip(names, rms, strict=True))}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
