# SPDX-License-Identifier: Apache-2.0
"""Checks that the numbers of a message are plausible: a `fault` makes all of it unusable, a `flaw` a part."""

from __future__ import annotations

import math

import numpy as np

from smallwheel_ros.pipeline.tables import Array

_LARGEST = 1e9  # in SI units nothing on a vehicle is larger
_STRONGEST = 160.0  # m/s^2: the widest range of usual accelerometers is 16 g
_LIGHTEST = 1e-6  # N: what presses less is in the air
FASTEST = 10.0  # m/s: no vehicle on small wheels drives on soil at 36 km/h


def sound(kind: str, values: Array) -> bool:
    """Tell whether no row has a fault or a flaw; the quick test for many rows.

    Parameters
    ----------
    kind
        Last part of the stream's name: `load`, `sinkage`, `odom`, `imu` and so on.
    values
        Rows of the stream, shape (rows, width), SI.

    Returns
    -------
    bool
        False if any row may have one; `fault` and `flaw` then tell which and why.
    """
    if kind == "imu":
        alone = np.isnan(values) | (np.abs(values) < _LARGEST)
        felt = (np.abs(values[:, 1:4]) <= _STRONGEST).all(axis=1)
        return bool(alone.all() and (felt | ~np.isnan(values[:, 4])).all())
    many = {"odom": 6, "velocity": 2}.get(kind, 1)
    if not (np.abs(values[:, :many]) < _LARGEST).all():
        return False
    if kind in ("odom", "velocity"):
        return bool((np.abs(values[:, 0]) <= FASTEST).all())
    return kind != "load" or bool((values[:, 0] >= _LIGHTEST).all())


def fault(kind: str, values: tuple[float, ...]) -> tuple[str, str] | None:
    """Return why a message cannot be used at all.

    Parameters
    ----------
    kind
        Last part of the stream's name: `load`, `sinkage`, `odom`, `imu` and so on.
    values
        The message's row, SI.

    Returns
    -------
    (str, str) or None
        Key under which it is counted, such as `not_finite`, and an explanation in words; None if the message
        can be used.
    """
    if kind == "imu":
        known = [value for value in values if not math.isnan(value)]
        felt = all(abs(value) <= _STRONGEST for value in values[1:4])
        if any(not abs(value) < _LARGEST for value in known) or not (
            felt or not math.isnan(values[4])
        ):
            turns = max(values[0], values[7], key=abs)
            one = next((v for v in values[1:4] if not abs(v) <= _STRONGEST), turns)
            text = f"it feels {one:g}, expected at most {_STRONGEST:g} m/s^2, or an orientation"
            return ("not_plausible" if math.isfinite(one) else "not_finite"), text
        return None
    names = {
        "odom": ("speed", "yaw rate", "x", "y"),
        "velocity": ("speed", "yaw rate"),
    }.get(kind, (kind,))
    if kind == "sinkage" and math.isnan(values[0]):
        return (
            "not_finite",
            "sinkage is nan: no reading, or a distance at or beyond the sensor's limits (REP 117)",
        )
    for name, value in zip(names, values, strict=False):
        if not abs(value) < _LARGEST:
            reason = "not_plausible" if math.isfinite(value) else "not_finite"
            return reason, f"{name} is {value:g}, expected a number smaller than {_LARGEST:g}"
    if kind in ("odom", "velocity") and abs(values[0]) > FASTEST:
        text = f"speed is {values[0]:g} m/s, expected at most {FASTEST:g}"
        return "not_plausible", text
    return None


def flaw(kind: str, values: tuple[float, ...]) -> tuple[str, str] | None:
    """Return why a part of a message cannot be used, although the message is kept.

    Parameters
    ----------
    kind
        Last part of the stream's name: `load`, `sinkage`, `odom`, `imu` and so on.
    values
        The message's row, SI.

    Returns
    -------
    (str, str) or None
        Key under which it is counted, such as `no_orientation`, and an explanation in words; None if all of
        it can be used.
    """
    if kind == "odom" and not all(abs(value) < _LARGEST for value in values[4:6]):
        return (
            "no_orientation",
            "the orientation is not a unit quaternion: the wheels have no position",
        )
    if kind == "load" and values[0] < _LIGHTEST:
        return "load_not_positive", (
            f"load is {values[0]:g} N, expected more than 0: the wheel is in the air, or the sensor's"
            " sign is the other one (parameter <wheel>.load_sign)"
        )
    return None
