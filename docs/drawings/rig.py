# SPDX-License-Identifier: Apache-2.0
"""The picture of README.md: sinkage of the real rig, measured over predicted, before and after the diagnosis.

    PYTHONPATH=. python docs/drawings/rig.py

Both are held out: each run was predicted by a fit that did not see it.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib.figure import Figure

import smallwheel_ros as sw

ROOT = Path(__file__).resolve().parents[2]
TARGET = ROOT / "docs" / "images" / "rig_sinkage.png"
BLUE, ORANGE, GREY = "#0072b2", "#d55e00", "#777777"


def main() -> None:
    """Diagnose the table of README.md, and draw its first and its last step."""
    folder = ROOT / "examples" / "data" / "cmu_wheel_rig"
    rolling = sw.read(folder / "rolling_smooth_wheel.csv")
    found = sw.diagnose(rolling, model=sw.fit(folder / "indentation.csv").model)
    errors = [1e3 * step.errors.error["sinkage"] for step in found.steps]
    rms = [float(np.sqrt(np.nanmean(error**2))) for error in errors]
    names = ["the law alone", *(f"+ {s.added.replace('_', ' ')}" for s in found.steps[1:])]
    measured = 1e3 * rolling.channels["sinkage"]

    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1))
    high = 1.05 * float(np.nanmax(measured[np.isfinite(errors[0])]))
    left.axline((0.0, 0.0), slope=1.0, color=GREY, lw=1)
    for error, colour, marker, name in (
        (errors[0], ORANGE, "x", "the law alone"),
        (errors[-1], BLUE, "o", "with what was named"),
    ):
        left.plot(measured - error, measured, marker, color=colour, ms=4, alpha=0.8, label=name)
    left.set(xlim=(0.0, high), ylim=(0.0, high), aspect="equal")
    left.set(xlabel="predicted sinkage [mm]", ylabel="measured sinkage [mm]")
    left.legend(frameon=False, loc="lower right", fontsize=9)
    bars = right.barh(names, rms, color=[ORANGE, *[BLUE] * (len(rms) - 1)])
    right.bar_label(bars, [f"{r:.3g} mm" for r in rms], padding=3)
    right.invert_yaxis()
    right.set(xlabel="held-out error, rms [mm]", xlim=(0.0, 1.3 * rms[0]))
    right.spines[["top", "right"]].set_visible(False)
    left.spines[["top", "right"]].set_visible(False)
    figure.savefig(TARGET, dpi=110)
    print(f"{TARGET}: {', '.join(f'{n} {r:.3g} mm' for n, r in zip(names, rms, strict=True))}")


if __name__ == "__main__":
    main()
