# SPDX-License-Identifier: Apache-2.0
"""What the node logs as it starts: its parameters, what it waits for, what it then estimates."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Mapping

from smallwheel_ros.onboard.feed import Topic
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.physics.conditions import ROLLING

_WIDTH = 148  # characters: of 200, less what ROS puts before a line
# What a stream measures; those of a wheel are `<wheel>/load` and so on.
_MEASURED = {
    "wheel_speed": "wheel speed",
    "drawbar_pull": "drawbar pull",
    "odom": "odometry",
    "velocity": "velocity over ground",
    "imu": "slope",
}


def parameter_lines(changed: Mapping[str, object]) -> list[str]:
    """The parameters that are not at their defaults, by name, in lines of at most 148 characters.

    A single word that is longer (a path) stays whole.
    """
    words = ", ".join(f"{name}={value}" for name, value in changed.items())
    return textwrap.wrap(
        f"effective parameters, the others have their defaults: {words}",
        _WIDTH,
        subsequent_indent="  ",
        break_long_words=False,
        break_on_hyphens=False,
    )


def input_lines(topics: Iterable[Topic], resolved: Callable[[str], str]) -> list[str]:
    """What is waited for: a line for each group of topics that measure the same.

    resolved: gives the full name of a topic.
    """
    groups: dict[tuple[str, str], list[str]] = {}
    for topic in topics:
        measured = (stream.rpartition("/")[2] for stream in topic.streams)
        what = " and ".join(dict.fromkeys(_MEASURED.get(name, name) for name in measured))
        groups.setdefault((what, topic.type), []).append(resolved(topic.name))
    return [
        f"waits for {what}: {', '.join(names)} ({kind})" for (what, kind), names in groups.items()
    ]


def estimates(onboard: Onboard) -> str:
    """What is estimated, and of which wheels, once all inputs are here."""
    return f"estimates {_of_the_soil(onboard)}; {'; '.join(_of_wheels(onboard))}"


def _of_the_soil(onboard: Onboard) -> str:
    settings = onboard.settings
    if len(settings.without_sinkage) == len(settings.wheels):
        law = "nothing of the soil's law (no sinkage is measured)"
    elif onboard.undeterminable:
        law = "n and k D^m of the soil"  # why not m has been said as a warning
    else:
        law = "k, n and m of the soil"
    ways = {
        "the balance of the vehicle's forces": settings.mass and settings.velocity != "none",
        "torque": settings.with_torque,
        "drawbar pull": settings.with_drawbar_pull,
    }
    by = " and ".join(way for way, there in ways.items() if there)
    strength = f" and its strength by {by}" if by else "; its strength stays as configured"
    return f"{law}{strength}"


def _of_wheels(onboard: Onboard) -> list[str]:
    settings = onboard.settings
    what = "sinkage, resistance, thrust and drawbar pull of"
    if settings.velocity == "none":
        what = "sinkage and resistance (no slip, thrust, pull: odometry comes from the wheels) of"
    rolling = [wheel.name for wheel in settings.wheels if wheel.contact == ROLLING]
    pressed = [wheel.name for wheel in settings.wheels if wheel.contact != ROLLING]
    found = [f"{what} {', '.join(rolling)}"] if rolling else []
    found += [f"sinkage of {', '.join(pressed)}"] if pressed else []
    return found
