# SPDX-License-Identifier: Apache-2.0
"""Whether the mean specific force of an imu is gravity, and what it may be if it is not."""

from __future__ import annotations

from smallwheel_ros.physics.wheel import GRAVITY

_WEAKEST, _STRONGEST = (
    0.82,
    1.22,
)  # of gravity: accelerometers that nobody calibrated are within 2 %
_UNITS = {"g": GRAVITY, "mg": 1e-3 * GRAVITY, "cm/s^2": 0.01}


def unlike_gravity(strength: float, gravity: float = GRAVITY) -> str:
    """Explain a mean specific force that is not gravity; empty if it is gravity.

    Parameters
    ----------
    strength
        Length of the mean specific force, m/s^2.
    gravity
        Acceleration of gravity where the vehicle drives, m/s^2.
    """
    if _WEAKEST < strength / gravity < _STRONGEST:
        return ""
    expected = f"expected {gravity:.3g} m/s^2"
    if strength == 0.0:
        return "its accelerations are all 0: they show no slope"
    units = [u for u, f in _UNITS.items() if _WEAKEST < strength * f / gravity < _STRONGEST]
    if units:
        return f"it feels {strength:.4g} on average, gravity in {' or '.join(units)}? {expected}"
    if strength < gravity:
        what = "gravity has been taken out, they show no slope"
        return f"its accelerations are {strength:.2g} m/s^2 on average: {what}"
    return f"it feels {strength:.4g} m/s^2 on average, {expected}"
