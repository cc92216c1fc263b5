# SPDX-License-Identifier: Apache-2.0
"""Definitions of this package's ROS messages, readable without ROS.

There is one copy of the ``.msg`` files in the source, in ``msg/``, from which rosidl generates the
message classes. Every kind of installation puts them into ``smallwheel_ros/definitions`` too (a
folder of that name must not be called ``msg``: it would collide with the generated module), so
that bags can be written and read on machines without ROS.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from smallwheel_ros.common.errors import SmallwheelError

PACKAGE = "smallwheel_ros"


class InterfacesError(SmallwheelError):
    """The message definitions are missing from this installation."""


def message_directory() -> Path:
    """Return the folder with the ``.msg`` files: of the installation, or of the checkout.

    Raises
    ------
    InterfacesError
        If neither exists, which means that the installation is incomplete.
    """
    module = Path(__file__)
    # With symlinked installs (colcon --symlink-install, make) this file is a link next to the
    # installed definitions; the checkout is where it leads to.
    candidates = (module.parents[1] / "definitions", module.resolve().parents[2] / "msg")
    for folder in candidates:
        if any(folder.glob("*.msg")):
            return folder
    places = " nor in ".join(str(folder) for folder in candidates)
    raise InterfacesError(
        f"no message definitions (*.msg) in {places}: this installation of {PACKAGE} is"
        " incomplete, install it again"
    )


@cache
def _definitions() -> tuple[tuple[str, str], ...]:
    files = sorted(message_directory().glob("*.msg"))
    return tuple((f"{PACKAGE}/msg/{file.stem}", file.read_text(encoding="utf-8")) for file in files)


def message_definitions() -> dict[str, str]:
    """Return the text of each message definition by its full type name.

    The keys are names as bags use them, such as ``smallwheel_ros/msg/WheelSinkage``.

    Raises
    ------
    InterfacesError
        If the definitions are missing from this installation.
    """
    return dict(_definitions())
