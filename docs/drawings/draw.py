# SPDX-License-Identifier: Apache-2.0
"""Make the drawings of docs, of theory and of effects, as SVG: `PYTHONPATH=. python docs/drawings/draw.py`.

The same bytes each time; text stays text; the background is transparent and the ink half-dark, so that
they can be read on a dark page as well (which inverts them, see _static/site.css).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import curves
import effects
import lab
import matplotlib as mpl
import scenes
from matplotlib.figure import Figure
from style import STYLE

FOLDER = Path(__file__).parent.parent / "images"

DRAWINGS: dict[str, Callable[[], Figure]] = {
    "wheel": scenes.draw_wheel,
    "stresses": curves.draw_stresses,
    "plate": scenes.draw_plate,
    "pressure_sinkage": curves.draw_pressure_sinkage,
    "shear": curves.draw_shear,
    "closed_form": curves.draw_closed_form,
    "effects": scenes.draw_effects,
    "ridge": curves.draw_ridge,
    "lab_plates": lab.draw_plates,
    "lab_bevameter": lab.draw_bevameter,
    "lab_shear": lab.draw_shear_tests,
    "lab_pressed": lab.draw_pressed,
    "lab_lugs": lab.draw_lugs,
}


def draw_all(folder: Path) -> None:
    """Write the drawings of theory and of effects, each as FOLDER/KIND/NAME.svg."""
    theory, small = folder / "theory", folder / "effects"
    for kind in (theory, small):
        kind.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(STYLE):
        for name, draw in DRAWINGS.items():
            draw().savefig(theory / f"{name}.svg", metadata={"Date": None, "Creator": None})
    for name in effects.EFFECTS:
        (small / f"{name}.svg").write_text(effects.drawing(name), encoding="utf-8")


def main() -> None:
    """Draw them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=FOLDER)
    draw_all(parser.parse_args().output)


if __name__ == "__main__":
    main()
