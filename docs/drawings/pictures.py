# SPDX-License-Identifier: Apache-2.0
"""Make the pictures of docs that show results anew, all or those named: `make images IMAGES="learnt.png"`.

They take from seconds to minutes, and some are of random drives of fixed seeds. Drawings are those of
`draw.py`.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import smallwheel_ros as sw

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs" / "images"


def run(*command: str | Path) -> None:
    """Run a Python script or module of this repository from its root."""
    subprocess.run([sys.executable, *map(str, command)], cwd=ROOT, check=True)


def draw_learnt(target: Path, folder: Path) -> None:
    """The law of the tutorial in docs/learn.md."""
    from rates.learn_worlds import table

    path = folder / "tanh_slip.csv"
    table("tanh_slip", 1, 0, runs=32).to_csv(path, index=False)
    sw.learn(path, without="slip_sinkage", name="slip_law").save(target)


def draw_rig(target: Path, folder: Path) -> None:
    """The real rig, measured over predicted, before and after."""
    run("docs/drawings/rig.py")


def draw_cost_detour(target: Path, folder: Path) -> None:
    """A path past where a robot got stuck."""
    run("-m", "rates.cost_detours", "round", target)


def draw_cost_home(target: Path, folder: Path) -> None:
    """The way home from where a robot got stuck."""
    run("-m", "rates.cost_detours", "home", target)


def draw_cost_hill(target: Path, folder: Path) -> None:
    """A path round a ridge ahead."""
    run("-m", "rates.cost_detours", "hill", target)


def draw_odometry(target: Path, folder: Path) -> None:
    """Errors of wheel odometry after 30 s without fixes."""
    run("-m", "rates.twist", "--figure", target)


def draw_real_drive(target: Path, folder: Path) -> None:
    """Slip of a real drive with its truth; of recorded data beside the repository."""
    data = ROOT.parent / "shared" / "data" / "real_drives"
    run("-m", "rates.real_drives", data, "--picture", "warthog_sand1", target)


def draw_demo(target: Path, folder: Path) -> None:
    """What the node finds in the demo's drive, and what its soil costs: pictures of one run. Needs ROS."""
    run("-m", "smallwheel_ros", "demo", "-o", folder)
    for name, made in {"demo.png": "drive.png", "cost_map.png": "cost.png"}.items():
        shutil.copy(folder / made, target.with_name(name))


PICTURES: dict[str, Callable[[Path, Path], None]] = {
    "learnt.png": draw_learnt,
    "rig_sinkage.png": draw_rig,
    "cost_detour.png": draw_cost_detour,
    "cost_home.png": draw_cost_home,
    "cost_hill.png": draw_cost_hill,
    "odometry.png": draw_odometry,
    "demo.png": draw_demo,
    "cost_map.png": draw_demo,
    "real_drive.png": draw_real_drive,
}


def main(names: list[str]) -> None:
    """Make the pictures of these names, all if there is none."""
    unknown = [name for name in names if name not in PICTURES]
    if unknown:
        sys.exit(f"no picture {unknown[0]}: there is {', '.join(PICTURES)}")
    # Two that are of one run are drawn once.
    for draw, name in {PICTURES[name]: name for name in names or PICTURES}.items():
        print(f"{IMAGES / name}", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            draw(IMAGES / name, Path(folder))


if __name__ == "__main__":
    main(sys.argv[1:])
