# SPDX-License-Identifier: Apache-2.0
"""Which drive to simulate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

from smallwheel_ros.common.options import Option
from smallwheel_ros.simulate.hidden import (
    FRACTION,
    FormOfHidden,
    Hidden,
    Seed,
    Strength,
    check_settings,
    in_drives,
)
from smallwheel_ros.simulate.stretches import FINISHES, TERRAINS, Stretch
from smallwheel_ros.simulate.truth import SimulationError
from smallwheel_ros.simulate.world import ROVERS, Rover


@dataclass(frozen=True)
class DriveSettings:
    """What drive to simulate: the options of `smallwheel simulate drive`.

    The same seed gives the same drive, to the byte. `wheels` may be a rover of your own, and `stretches`,
    where given, are driven over instead of `terrain`. A `finish` is what the drive ends in after
    `distance`, stuck: a slope that steepens, or slippery ground. With dropouts above 0 one wheel's
    sinkage is also missing for 1.5 s.
    """

    seed: Seed = 0
    distance: Annotated[float, Option("Distance, m.", (2.0, 20_000.0, "m"))] = 30.0
    speed: Annotated[float, Option("Mean speed, m/s.", (0.01, 3.0, "m/s"))] = 0.5
    wheels: Annotated[str | Rover, Option(f"{' or '.join(ROVERS)}.", tuple(ROVERS))] = "four"
    terrain: Annotated[str, Option(f"{' or '.join(TERRAINS)} soil.", TERRAINS)] = "mixed"
    stretches: tuple[Stretch, ...] | None = None
    finish: Annotated[
        str, Option(f"What the drive gets stuck on at its end:  {', '.join(FINISHES)}.", FINISHES)
    ] = "none"
    hidden: Hidden = ()
    strength: Strength = 1.0
    form: FormOfHidden = "own"
    noise: Annotated[float, Option("Factor on every sensor's noise.", (0.0, 20.0))] = 1.0
    outliers: Annotated[
        float, Option("Share of measured sinkages that are grossly wrong.", (0.0, 0.5), FRACTION)
    ] = 0.0
    dropouts: Annotated[
        float, Option("Share of load and sinkage messages that are missing.", (0.0, 0.9), FRACTION)
    ] = 0.01

    def check(self) -> DriveSettings:
        """Return the settings without `none` among the hidden effects.

        Raises SimulationError, naming the setting, what it was, and what was expected.
        """
        hidden = check_settings(self)
        for name in hidden:
            if not in_drives(name):
                raise SimulationError(
                    f"hidden effect {name!r} cannot be in a drive: what it depends on or acts on"
                    " has no sensor there; use `simulate rig`"
                )
        return replace(self, hidden=hidden)
