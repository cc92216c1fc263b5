# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis costs: processor time on one core, by table.

    python benchmarks/diagnosis_cost.py

96 simulated rows, 54 rows of a real rig (where ../shared/data is) from soil known by indentation, and
4000 rows of plate curves.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pandas as pd

# As a script this file finds its neighbours, as a module of the repository its package.
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks._world_curves import curves
from smallwheel_ros.diagnosis.diagnose import diagnose
from smallwheel_ros.fitting import Base, Problem
from smallwheel_ros.fitting.problem import base_of
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.measurements.wheels import read_measurements
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table

REPEATS = 3
ROOT = Path(__file__).resolve().parent.parent
RIG = Path(os.environ.get("SMALLWHEEL_SHARED", ROOT.parent / "shared")) / "data" / "cmu_wheel_rig"


def read(table: pd.DataFrame) -> Measurements:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.csv"
        write_table(table, path)
        return read_measurements(path)


def thousands_of_rows() -> Measurements:
    tables = []
    for seed in range(2):
        table = curves(seed, 0, "plate", 300)
        tables.append(table.assign(run=[f"{seed}_{name}" for name in table["run"]]))
    return read(pd.concat(tables, ignore_index=True).iloc[:4000])


def cases() -> Iterator[tuple[str, Measurements, Base, float]]:
    """Name, table, base, and the limit in seconds."""
    for hidden in ((), ("slip_sinkage",)):
        table = simulate_rig(RigSettings(seed=1, hidden=hidden)).table
        yield f"simulated, {'+'.join(hidden) or 'nothing hidden'}", read(table), Base(), 3.0
    if RIG.is_dir():
        whole = read_measurements(RIG / "indentation.csv")
        pressed = whole.take(whole.conditions.contact == "pressed")
        rolling = read_measurements(RIG / "rolling_smooth_wheel.csv")
        some = rolling.take(np.abs(rolling.conditions["slip_angle"]) < np.radians(16.0))
        base = base_of(Problem.of(pressed).result().model, some)
        yield "real rig, slip angle 0 and 15 deg", some, base, 6.0
    yield "plate curves", thousands_of_rows(), Base(), 20.0


def main() -> None:
    print(
        "| table | rows | verdict | s of processor time | limit, s |\n| --- | --- | --- | --- | --- |"
    )
    for name, measurements, base, limit in cases():
        seconds = []
        for _ in range(REPEATS):
            started = time.process_time()
            found = diagnose(measurements, base).document
            seconds.append(time.process_time() - started)
        said = ", ".join([found["verdict"], *found["missing_effects"]])
        print(f"| {name} | {len(measurements)} | {said} | {np.median(seconds):.1f} | {limit:g} |")


if __name__ == "__main__":
    main()
