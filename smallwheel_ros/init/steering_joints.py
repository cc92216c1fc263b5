# SPDX-License-Identifier: Apache-2.0
"""Which recorded joints steer which wheels, by the robot description or else by their names."""

from __future__ import annotations

from collections.abc import Mapping

from smallwheel_ros.bags import BagReader
from smallwheel_ros.common.node_parameter import Value
from smallwheel_ros.init.recorded import first_messages
from smallwheel_ros.onboard.wheel_names import best_match, words_of

# Words in the names of joints that steer (`joint_STR_LF`).
_STEERS = {"steer", "steering", "corner", "str"}
_LOOKED_AT = 20  # messages of a topic: joint states come in parts


def joints_of(reader: BagReader, topics: list[str]) -> dict[str, list[str]]:
    """Names of the joints in the first messages of each topic, by topic, in their order of appearance.

    In a damaged bag these are messages before the damage.

    Parameters
    ----------
    reader
        The bag.
    topics
        Topics of type JointState.
    """
    found: dict[str, list[str]] = {}
    for topic in topics:
        messages = first_messages(reader, topic, _LOOKED_AT)
        names = [str(name) for one in messages for name in one.name]
        found[topic] = list(dict.fromkeys(names))
    return found


def steering_values(
    values: Mapping[str, Value],
    wheels: list[str],
    joints: Mapping[str, list[str]],
    main: str | None,
) -> tuple[dict[str, Value], list[str]]:
    """Find which recorded joints steer wheels: those of the robot description, else by their names.

    Parameters
    ----------
    values
        Parameters by full name, with those that the robot description gives.
    wheels
        Names of the wheels.
    joints
        Names of the recorded joints by topic, as returned by `joints_of`.
    main
        The topic of the joints that turn wheels; None: there is none.

    Returns
    -------
    parameters : dict
        Parameters by full name that `values` lacks or has otherwise: `<wheel>.steering_joint`,
        `steering_topic`.
    notes : list of str
        Sentences for the user.
    """
    found: dict[str, Value] = {}
    notes: list[str] = []
    recorded = [name for names in joints.values() for name in names]
    taken = {values.get(f"{wheel}.steering_joint") for wheel in wheels} & {*recorded}
    steering = [name for name in recorded if words_of(name) & _STEERS and name not in taken]
    for wheel in wheels:
        key = f"{wheel}.steering_joint"
        described = values.get(key)
        if described in recorded:
            continue
        named = best_match(wheel, "steering", steering)
        if named is not None:
            found[key] = named
            steering.remove(named)
            why = (
                f"there is no {described}" if described else "check steering_sign and steering_zero"
            )
            notes.append(f"{named} steers {wheel}, by its name; {why}")
        elif described:
            notes.append(
                f"{described} steers {wheel}, and is in no joint states: its slip is not known until"
                f" {key} names a joint that is there ({', '.join(steering) or 'none is called so'})"
            )
    chosen = {
        str(found.get(f"{w}.steering_joint", values.get(f"{w}.steering_joint"))) for w in wheels
    }
    of = [topic for topic, names in joints.items() if chosen & {*names}]
    if of and main not in of:
        found["steering_topic"] = of[0]
        notes.append(f"{of[0]} is steering_topic, with the joints that steer")
    return found, notes
