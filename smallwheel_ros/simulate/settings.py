# SPDX-License-Identifier: Apache-2.0
"""Settings that rigs and drives have alike."""

from __future__ import annotations

from typing import Annotated, Any

from smallwheel_ros.common.options import Option, options_of
from smallwheel_ros.simulate.truth import check_range

Seed = Annotated[int, Option("Same seed, same data.", (0, 2**63 - 1))]
Strength = Annotated[float, Option("Factor on the size of the hidden effects.", (0.0, 10.0))]
FRACTION = {"metavar": "FRACTION"}


def check_ranges(settings: Any) -> None:
    """Raise `SimulationError` for the first setting that is outside its range."""
    for name, option in options_of(type(settings)).items():
        if option.within:
            check_range(name.replace("_", " "), getattr(settings, name), *option.within)
