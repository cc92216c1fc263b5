# SPDX-License-Identifier: Apache-2.0
"""How fast physics, cost map, diagnosis and replay are, each against what it cannot beat or the usual way.

    python -m rates.speed [replay ...]   # all parts without a name

1. Closed form: sinkage and compaction resistance (eq. 10, 14) of 10^6 rows, against the three bare NumPy
   powers that the equations need; and a whole prediction of them, for information.
2. Contact integral: sinkage of 10^5 rows, against scipy's quad inside brentq at equal accuracy.
3. Cost map: a grid of 10^6 terrain classes to costs, against one numpy table lookup of as many; a map
   of elevations.
4. Diagnosis: processor time of simulated tables, a real rig (where ../shared/data is) and plate curves.
5. Replay: a drive of six wheels whose sensors come at 100 Hz, 1500 messages, 600 readings and 60 estimates
   a second, against real time; deserialising alone and the pipeline without any output beside it; and memory
   over the bag's length, in processes of their own.

Times are of the processor; both sides of a ratio take turns within one run; medians.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pandas as pd
from scipy.integrate import quad
from scipy.optimize import brentq

from rates._world_labs import curves
from rates.diagnosis import read
from smallwheel_ros.api.diagnose import diagnose
from smallwheel_ros.bags import BagReader, BagWriter
from smallwheel_ros.costmap.cost import CostSettings
from smallwheel_ros.costmap.cost_map import CostMap
from smallwheel_ros.costmap.elevation import elevation_from
from smallwheel_ros.costmap.grid import Grid, Pose
from smallwheel_ros.fitting import Base, Problem
from smallwheel_ros.fitting.problem import base_of
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.contact import contact_sinkage
from smallwheel_ros.physics.sinkage import closed_form
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.physics.wheel import Quantity, Wheel
from smallwheel_ros.replay.recording import turns_of
from smallwheel_ros.replay.replay import replay
from smallwheel_ros.replay.spec import ReplaySpec, read_settings
from smallwheel_ros.simulate import (
    DriveSettings,
    RigSettings,
    simulate_drive,
    simulate_rig,
    write_drive_bag,
)
from smallwheel_ros.simulate.settings import SENSORS
from smallwheel_ros.simulate.world import ROVERS

ACCURACY = 1e-8
ROOT = Path(__file__).resolve().parent.parent
RIG = Path(os.environ.get("SMALLWHEEL_SHARED", ROOT.parent / "shared")) / "data" / "cmu_wheel_rig"


def in_turn(
    repeats: int, *works: Callable[[], object], before: Callable[[], object] = lambda: None
) -> list[float]:
    """Median seconds of processor of each; they take turns.

    before: what is done before each turn, untimed.
    """
    taken: list[list[float]] = [[] for _ in works]
    for work in works:
        work()
    for _ in range(repeats):
        before()
        for work, spent in zip(works, taken, strict=True):
            start = time.process_time()
            work()
            spent.append(time.process_time() - start)
    return [float(np.median(spent)) for spent in taken]


def inputs(rows: int, seed: int) -> dict[str, np.ndarray]:
    """Wheels and soils of every kind."""
    rng = np.random.default_rng(seed)
    return {
        "load": rng.uniform(10.0, 300.0, rows),
        "diameter": rng.uniform(0.05, 0.6, rows),
        "width": rng.uniform(0.03, 0.3, rows),
        "k": np.exp(rng.uniform(np.log(3e4), np.log(3e6), rows)),
        "n": rng.uniform(0.3, 1.6, rows),
        "m": rng.uniform(-0.6, 0.6, rows),
    }


def of_closed_form() -> None:
    """The closed form, and a prediction with it, over three powers."""
    x = inputs(1_000_000, seed=1)
    sinkage, _ = closed_form(**x)
    base = sinkage ** (x["n"] + 0.5)

    def powers() -> None:
        np.power(x["diameter"], x["m"] + 0.5)
        np.power(base, 2.0 / (2.0 * x["n"] + 1.0))
        np.power(sinkage, x["n"] + 1.0)

    model = Model(soil("dry_sand"), "closed_form")
    conditions = Conditions.of(x["load"], x["diameter"], x["width"])
    limit, ours, whole = in_turn(
        15, powers, lambda: closed_form(**x), lambda: predict(model, conditions)
    )
    told("closed form, 10^6 rows, over three bare powers", ours / limit, "at most 1.4")
    told("the same by `predict`", whole / limit, "none")


def usual_way(load: float, d: float, b: float, modulus: float, n: float) -> float:
    """Sinkage by scipy: quad over the contact's angle inside brentq."""
    radius = 0.5 * d

    def excess(z: float) -> float:
        cos0 = 1.0 - z / radius
        theta0 = np.arccos(cos0)

        def integrand(theta: float) -> float:
            cos = np.cos(theta)
            return float(max(radius * (cos - cos0), 0.0) ** n * cos)

        value = quad(integrand, 0.0, theta0, epsrel=ACCURACY, epsabs=0.0)[0]
        return float(b * radius * modulus * value - load)

    return float(brentq(excess, 1e-9 * radius, radius, rtol=ACCURACY, xtol=1e-12))


def of_contact() -> None:
    """The usual way over ours, for each row."""
    x = inputs(100_000, seed=2)
    columns = (x["load"], x["diameter"], x["width"], x["k"] * x["diameter"] ** x["m"], x["n"])
    solved = contact_sinkage(*columns)
    rows = np.flatnonzero(~solved.sunk_to_axle)[:50]

    def usual() -> list[float]:
        return [usual_way(*(float(column[i]) for column in columns)) for i in rows]

    off = np.max(np.abs(solved.sinkage[rows] / np.array(usual()) - 1.0))
    ours, theirs = in_turn(5, lambda: contact_sinkage(*columns), usual)
    told(
        f"contact integral, scipy's time over ours (they differ by {off:.0e})",
        (theirs / rows.size) / (ours / 100_000),
        "at least 300",
    )


def of_cost_map() -> None:
    """A grid after each half a metre, with 15 m of crossed ground and more, over a table lookup.

    What is learnt changes each time: of classes, and of what ground ahead gives. In the last row new classes
    and new slopes come with each grid.
    """
    rng = np.random.default_rng(1)
    cells = rng.integers(-1, 12, (1000, 1000)).astype(np.int8)
    table = rng.integers(0, 100, 256).astype(np.int8)
    wheels = [Wheel(name, 0.2, 0.1, lateral_position=y) for name, y in (("a", -0.3), ("b", 0.3))]
    plain = CostSettings(spread=0.0, unknown="none")
    maps = {
        "classes alone": CostMap(plain, wheels),
        "15 m of crossed ground": CostMap(plain, wheels),
        "the same, spread": CostMap(CostSettings(), wheels),
        "the same, with slopes ahead": CostMap(CostSettings(), wheels),
        "the same, all of that new each time": CostMap(CostSettings(), wheels),
    }
    message = elevations(rng)

    def go_on(start: float, end: float) -> None:
        for name, cost_map in maps.items():
            for x in np.arange(start, end, 0.02).tolist() if name != "classes alone" else ():
                for wheel in wheels:
                    margin = Quantity(0.1 + 0.05 * rng.standard_normal(), 0.01)
                    cost_map.add(wheel, "odom", Pose(x - 7.5, 0.0, 0.0), x, margin)
            cost_map.expect(Quantity(0.2 + 0.01 * rng.standard_normal(), 0.1))

    def give(name: str, classes: np.ndarray) -> None:
        maps[name].take_classes(Grid("odom", 0.05, (-25.0, -25.0), classes))
        if not name.endswith(("alone", "ground", "spread")):
            maps[name].take_elevation(elevation_from(message, "elevation", 0.9))

    for name in maps:
        give(name, cells)
    go_on(0.0, 15.0)
    at = 15.0

    def half_a_metre() -> None:
        nonlocal at
        go_on(at, at + 0.5)
        at += 0.5
        give("the same, all of that new each time", rng.permuted(cells, axis=0))

    grids = [cost_map.grids for cost_map in maps.values()]
    limit, *ours = in_turn(
        40, lambda: np.take(table, cells.view(np.uint8)), *grids, before=half_a_metre
    )
    for name, seconds in zip(maps, ours, strict=True):
        told(f"cost map, {name}, over a table lookup", seconds / limit, "at most 4")
    (seconds,) = in_turn(20, lambda: elevation_from(message, "elevation", 0.9))
    told(
        "map of elevations, 200 x 200 cells with holes, a message, ms", 1e3 * seconds, "at most 20"
    )


def elevations(rng: np.random.Generator) -> Any:
    """A grid_map_msgs/GridMap of 200 x 200 cells of 0.1 m, 15 % of them unknown."""
    heights = (0.01 * rng.standard_normal(40_000)).astype(np.float32)
    heights[rng.uniform(size=heights.size) < 0.15] = np.nan
    names = ("column_index", "row_index")
    layout = SimpleNamespace(dim=[SimpleNamespace(label=name, size=200) for name in names])
    place = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    pose = SimpleNamespace(position=place, orientation=place)
    info = SimpleNamespace(resolution=0.1, length_x=20.0, length_y=20.0, pose=pose)
    return SimpleNamespace(
        header=SimpleNamespace(frame_id="odom"), info=info, layers=["elevation"],
        data=[SimpleNamespace(layout=layout, data=heights)], outer_start_index=7, inner_start_index=190,
    )  # fmt: skip


def plates() -> Measurements:
    """Curves of two soils, 4000 rows."""
    tables = []
    for seed in range(2):
        table = curves(seed, 0, "plate", 300)
        tables.append(table.assign(run=[f"{seed}_{name}" for name in table["run"]]))
    return read(pd.concat(tables, ignore_index=True).iloc[:4000])


def tables() -> Iterator[tuple[str, Measurements, Base, float]]:
    """Name, table, base, and the limit in seconds."""
    for hidden in ((), ("slip_sinkage",)):
        table = read(simulate_rig(RigSettings(seed=1, hidden=hidden)).table)
        yield f"simulated, {'+'.join(hidden) or 'nothing hidden'}", table, Base(), 3.0
    if RIG.is_dir():
        whole = read_measurements(RIG / "indentation.csv")
        pressed = whole.take(whole.conditions.contact == "pressed")
        rolling = read_measurements(RIG / "rolling_smooth_wheel.csv")
        some = rolling.take(np.abs(rolling.conditions["slip_angle"]) < np.radians(16.0))
        base = base_of(Problem.of(pressed).result().model, some)
        yield "real rig, slip angle 0 and 15 deg", some, base, 6.0
    yield "plate curves", plates(), Base(), 20.0


def of_diagnosis() -> None:
    """Processor time of a diagnosis."""
    for name, measurements, base, limit in tables():
        found = diagnose(measurements, base).document
        (seconds,) = in_turn(2, partial(diagnose, measurements, base))
        verdict = ", ".join([found["verdict"], *found["missing_effects"]])
        what = f"diagnosis, {name}, {len(measurements)} rows ({verdict}), s"
        told(what, seconds, f"at most {limit:g}")


def six_wheels(folder: Path, distance: float = 15.0) -> tuple[Path, Path, int]:
    """A bag, its parameter file, and the number of messages."""
    rover = ROVERS["two_sizes"]
    front = rover.wheels[:2]
    middle = [replace(w, name=w.name.replace("front", "middle"), x=0.0) for w in front]
    six = replace(rover, wheels=(*front, *middle, *rover.wheels[2:]))
    fast = replace(
        SENSORS, load_rate=100.0, sinkage_rate=100.0, joint_rate=100.0, imu_rate=100.0, odometry_rate=(100.0,)
    )  # fmt: skip
    drive = simulate_drive(DriveSettings(seed=1, distance=distance, wheels=six, sensors=fast))
    bag, config = folder / "drive", folder / "rover.yaml"
    count = write_drive_bag(drive, bag)
    text = (ROOT / "config" / "two_wheel_sizes.yaml").read_text()
    text = text.replace("rear_left,", "middle_left, middle_right, rear_left,", 1)
    more = "".join(
        f"    {w.name}: {{diameter: {w.diameter}, width: {w.width}, lateral_position: {w.y},"
        " longitudinal_position: 0.0}\n"
        for w in middle
    )
    config.write_text(text.replace("    rear_left:\n", f"{more}    rear_left:\n", 1))
    return bag, config, count


def again_and_again(bag: Path, target: Path, times: int) -> Path:
    """The drive so many times, on and on in time."""
    with BagReader(bag) as reader, BagWriter(target) as writer:
        recorded = list(reader.messages())
        length = (reader.end_time or 0) - (reader.start_time or 0) + 10**7
        for turn in range(times):
            for topic, kind, log_time, message in recorded:
                stamp = message.header.stamp
                total = stamp.sec * 10**9 + stamp.nanosec + (length if turn else 0)
                message.header.stamp = type(stamp)(sec=total // 10**9, nanosec=total % 10**9)
                writer.write(topic, kind, log_time + turn * length, message)
    return target


def memory(bag: Path, config: Path, folder: Path) -> float:
    """Largest memory (MB) of a process that replays the bag."""
    code = (
        "import resource, sys; from pathlib import Path; from smallwheel_ros.replay.replay import replay;"
        "from smallwheel_ros.replay.spec import ReplaySpec; replay(ReplaySpec(*map(Path, sys.argv[1:])));"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)"
    )
    command = [sys.executable, "-c", code, *map(str, (bag, config, folder))]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def of_replay() -> None:
    """Processor time of one core, without the page, which takes the same for any bag; and memory."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bag, config, count = six_wheels(folder)

        def deserialise() -> int:
            with BagReader(bag) as reader:
                return sum(1 for _ in reader.messages())

        def estimate() -> None:
            with BagReader(bag) as reader:
                settings, _ = read_settings(ReplaySpec(bag, config, Path()), reader)
            for _ in turns_of(bag, settings):
                pass

        with BagReader(bag) as reader:
            seconds = ((reader.end_time or 0) - (reader.start_time or 0)) / 1e9
        works = {
            "deserialising alone": deserialise,
            "pipeline alone": estimate,
            "with tables and a bag of estimates": lambda: replay(
                ReplaySpec(bag, config, folder / "none", copy="none")
            ),
            "originals copied too": lambda: replay(
                ReplaySpec(bag, config, folder / "all", copy="all")
            ),
        }
        taken = in_turn(3, *works.values())
        for what, spent in zip(works, taken, strict=True):
            limit = "at least 20" if what.startswith("with tables") else "none"
            each = 1e6 * spent / count
            told(f"replay, {what} ({each:.1f} us a message), x real time", seconds / spent, limit)
        bags = bag, again_and_again(bag, folder / "long", 10)
        used = [memory(one, config, folder / f"out{i}") for i, one in enumerate(bags)]
        told(
            f"replay, memory of 10 bags in one over {used[0]:.0f} MB",
            used[1] / used[0],
            "at most 1.1",
        )


def told(what: str, value: float, target: str) -> None:
    """A row of the table."""
    print(f"| {what} | {value:.3g} | {target} |", flush=True)


PARTS = {
    "closed_form": of_closed_form,
    "contact": of_contact,
    "cost_map": of_cost_map,
    "diagnosis": of_diagnosis,
    "replay": of_replay,
}


def main() -> None:
    """Print those parts as one table."""
    parts = sys.argv[1:] or list(PARTS)
    unknown = [part for part in parts if part not in PARTS]
    if unknown:
        sys.exit(f"no part {unknown[0]}: there is {', '.join(PARTS)}")
    print("| | found | target |\n| --- | --- | --- |")
    for part in parts:
        PARTS[part]()


if __name__ == "__main__":
    main()
