"""The file that the node's soil is saved to, and that it goes on from after a restart."""

from __future__ import annotations

from pathlib import Path

from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.onboard.onboard import Onboard


class SoilFile:
    """The file of the parameter soil.file; an empty name is none.

    problem: why the saved soil is not used, in words; empty where it is, or where there is none.
    """

    def __init__(self, name: str) -> None:
        self._path = Path(name).expanduser() if name else None
        self.problem = ""

    def restore(self, onboard: Onboard) -> str:
        """Let the estimate go on from the file; return in words what came of it."""
        self.problem = ""
        if self._path is None or not self._path.exists():
            return ""
        try:
            onboard.restore(self._path)
        except SmallwheelError as error:
            self.problem = f"the saved soil is not used: {error}"
            return self.problem
        return f"soil restored from {self._path}: {onboard.soil.accepted} measurements"

    def save(self, onboard: Onboard) -> tuple[bool, str]:
        """Save the soil; return whether that worked, and in words what came of it."""
        if self._path is None:
            return False, "nothing saved: parameter soil.file says where to, and is empty"
        if onboard.soil.accepted == 0:
            return False, "nothing saved: the soil has not been measured yet"
        try:
            onboard.save(self._path)
        except SmallwheelError as error:
            return False, f"nothing saved: {error}"
        return True, f"{self._path}: {onboard.soil.accepted} measurements"
