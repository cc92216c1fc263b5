# SPDX-License-Identifier: Apache-2.0
"""The truth simulator: data whose true values are known, made without the library's model.

`simulate_drive` makes a rover's drive and `write_drive_bag` its bag; `simulate_rig` makes a table
of single-wheel measurements and `measure` adds runs to it. No code of the physics is shared with the
rest of the package; `truth` lists the assumptions that both share.
"""

from __future__ import annotations

from smallwheel_ros.simulate.drive import Drive, simulate_drive
from smallwheel_ros.simulate.drive_bag import write_drive_bag
from smallwheel_ros.simulate.rig import Rig, RigTruth, measure, simulate_rig, write_table
from smallwheel_ros.simulate.settings import DriveSettings, RigSettings, SimulationError

__all__ = [
    "Drive",
    "DriveSettings",
    "Rig",
    "RigSettings",
    "RigTruth",
    "SimulationError",
    "measure",
    "simulate_drive",
    "simulate_rig",
    "write_drive_bag",
    "write_table",
]
