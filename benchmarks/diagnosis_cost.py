"""What a diagnosis costs: 96 rows on one core, and a record of 10^5 rows against plain fits of it.

    python benchmarks/diagnosis_cost.py

The peer for the long record is the usual way: for each effect one scipy least_squares fit with
numerical Jacobian over all rows, through the same model.
"""

from __future__ import annotations

import argparse
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from tqdm import tqdm

from smallwheel_ros.diagnosis import diagnose
from smallwheel_ros.diagnosis.candidates import Form, list_families
from smallwheel_ros.fitting.layout import make_layout
from smallwheel_ros.fitting.observations import Observations, observe
from smallwheel_ros.measurements.table import Measurements, read_measurements
from smallwheel_ros.model import predict
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table


def simulated(settings: RigSettings, runs_named: bool) -> Measurements:
    table = simulate_rig(settings).table
    if not runs_named:
        table = table.drop(columns=["run"])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.csv"
        write_table(table, path)
        return read_measurements(path)


def plain_fit(observations: Observations, form: Form) -> float:
    """Seconds of one least_squares fit of soil and effect to every row."""
    layout = make_layout(observations, (form.effect,))
    size = np.abs(observations.value) + 0.05 * np.median(np.abs(observations.value))

    def residual(theta: np.ndarray) -> np.ndarray:
        model = layout.model_at(np.clip(theta, layout.low, layout.high))
        predicted = observations.pick(predict(model, observations.conditions))
        return (observations.value - predicted) / size

    started = time.perf_counter()
    least_squares(residual, layout.start, bounds=(layout.low - 1e-9, layout.high + 1e-9))
    return time.perf_counter() - started


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rows", type=int, default=100_000)
    options = parser.parse_args()
    warnings.simplefilter("ignore", RuntimeWarning)
    small = simulated(RigSettings(seed=1, hidden=("slip_sinkage",)), True)
    diagnose(small)  # imports and caches
    seconds = []
    for _ in range(5):
        started = time.process_time()
        diagnose(small)
        seconds.append(time.process_time() - started)
    print(f"96 rows: median {np.median(seconds):.2f} s of processor time (limit 10 s)")

    runs = options.rows // 37
    large = simulated(
        RigSettings(seed=1, hidden=("slip_sinkage",), runs=runs, rows_per_run=37), False
    )
    started = time.perf_counter()
    found = diagnose(large).document
    own = time.perf_counter() - started
    observations = observe(large)
    families = [f for f in list_families(observations) if not f.blocked]
    plain = [plain_fit(observations, f.forms[0]) for f in tqdm(families, disable=None, leave=False)]
    print(f"{len(large)} rows: diagnosis {own:.1f} s, names {found['missing_effects']}")
    print(f"  one least_squares fit for each of {len(plain)} effects: {sum(plain):.1f} s")
    print(f"  ratio {own / sum(plain):.3f} (limit 0.1)")


if __name__ == "__main__":
    main()
