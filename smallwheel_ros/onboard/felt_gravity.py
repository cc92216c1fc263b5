# SPDX-License-Identifier: Apache-2.0
"""Comparison of an imu's mean specific force with gravity, and what may be wrong if they differ."""

from __future__ import annotations

from smallwheel_ros.physics.wheel import GRAVITY

_WEAKEST, _STRONGEST = (
    0.82,
    1.22,
)  # of gravity: accelerometers that nobody calibrated are within 2 %
_UNITS = {"g": GRAVITY, "mg": 1e-3 * GRAVITY, "cm/s^2": 0.01}


def unlike_gravity(strength: float, gravity: float = GRAVITY) -> str:
    """Explain why an imu's mean specific force differs from gravity.

    Parameters
    ----------
    strength
        Length of the mean specific force, m/s^2.
    gravity
        Acceleration of gravity where the vehicle drives, m/s^2.

    Returns
    -------
    str
        What may be wrong, such as a unit, in words; empty if the force is between 0.82 and 1.22 of gravity.
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
