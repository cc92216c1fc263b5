"""What replay raises."""

from __future__ import annotations

from smallwheel_ros.errors import SmallwheelError


class ReplayError(SmallwheelError):
    """A bag that nothing can be estimated from, options that do not go together, or no place."""
