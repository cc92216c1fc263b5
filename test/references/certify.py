# SPDX-License-Identifier: Apache-2.0
"""Certifies the reference files beside it anew: `python test/references/certify.py [NAME ...]`.

Needs mpmath and nothing else. Heads and data stay as the files have them, the certified values are written
anew. All take a quarter of an hour of one core.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial

from precise_paper import paper
from precise_plates import plates, plates_exact, rolling_wheel
from precise_shear import shear_cullinan, shear_exact, shear_noise
from precise_wheel import contact_integral, wheel_forces, wong_reece

PROBLEMS: dict[str, Callable[[], None]] = {
    "contact_integral": contact_integral,
    "paper_2011": paper,
    "plates_cmu": partial(plates, "plates_cmu"),
    "plates_exact": plates_exact,
    "plates_noise": partial(plates, "plates_noise"),
    "shear_cullinan": shear_cullinan,
    "shear_exact": shear_exact,
    "shear_noise": shear_noise,
    "wheel_forces": wheel_forces,
    "wheel_k_n_m": rolling_wheel,
    "wong_reece_1967": wong_reece,
}

if __name__ == "__main__":
    unknown = [name for name in sys.argv[1:] if name not in PROBLEMS]
    if unknown:
        sys.exit(f"no problem '{unknown[0]}', there is: {', '.join(PROBLEMS)}")
    for name in sys.argv[1:] or PROBLEMS:
        PROBLEMS[name]()
