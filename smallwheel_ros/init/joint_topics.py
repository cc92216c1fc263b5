# SPDX-License-Identifier: Apache-2.0
"""Which of several topics of joint states has the wheels, and which topics belong to one robot."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from smallwheel_ros.bags import BagReader
from smallwheel_ros.init.absent import absent
from smallwheel_ros.init.recorded import JointSpeeds, joint_speeds
from smallwheel_ros.init.rover import InitError
from smallwheel_ros.onboard.wheel_names import PLACES, best_match, words_of

USUAL = "/joint_states"
# Words of joints that turn no wheel.
_NO_WHEEL = (
    "steer", "steering", "corner", "arm", "caster", "castor", "pan", "tilt", "camera", "rocker", "bogie",
)  # fmt: skip
_SHOWN = 6  # joints of a topic that are named


def of_robot(namespace: str, topics: Sequence[str]) -> list[str]:
    """Select the topics in the namespace of one robot.

    Parameters
    ----------
    namespace
        Namespace of the robot, with or without slashes.
    topics
        Names of all topics of the bag.

    Raises
    ------
    InitError
        If no topic is in that namespace.
    """
    begin = f"/{namespace.strip('/')}/"
    found = [topic for topic in topics if topic.startswith(begin)]
    if not found:
        spaces = sorted({topic.split("/")[1] for topic in topics if topic.count("/") > 1})
        words = f"expected one of {', '.join(spaces)}" if spaces else "the bag has no namespace"
        raise InitError(f"no topic is in the namespace {begin.strip('/')!r}, {words}")
    return found


def joint_states_of(
    reader: BagReader, topics: Sequence[str], wanted: Collection[str], asked: str | None
) -> tuple[str | None, JointSpeeds | None, str]:
    """Choose the topic with the wheels' joint states.

    Parameters
    ----------
    reader, topics
        The bag, and its topics of JointState.
    wanted
        Joints that turn wheels according to the robot description: the topic with most of them is chosen.
    asked
        The topic that --joint-states names; None: it is chosen.

    Returns
    -------
    topic : str or None
        Name of the topic; None if there is none, or it is ambiguous.
    joints : JointSpeeds or None
        Speeds of its joints; None without a topic.
    note : str
        A sentence for the user on how it was chosen; empty if there is nothing to say.

    Raises
    ------
    InitError
        If the topic that was asked for is missing, or several robots are in the bag.
    """
    if asked is not None:
        name = f"/{asked.strip('/')}"
        if name not in topics:
            raise InitError(
                f"no topic {name} of joint states, expected one of {', '.join(topics) or 'none'}"
            )
        return name, joint_speeds(reader, name), ""
    if len(topics) < 2:
        if not topics or topics[0] == USUAL:
            return _only(reader, topics)
        words = f"assumed: {topics[0]} is joint_states, the only one like it of its type"
        return topics[0], joint_speeds(reader, topics[0]), words
    _one_robot(topics)
    each = {topic: joint_speeds(reader, topic) for topic in topics}
    found = _most_likely(each, wanted)
    others = "; ".join(
        f"{topic} has {_shown(joints.names)}" for topic, joints in each.items() if topic != found
    )
    if found is None:
        words = (
            f"which topic has the joints of the wheels is not clear ({others}): name it with"
            " --joint-states TOPIC"
        )
        return None, None, words
    words = f"{found} is joint_states, with the joints of the wheels; {others} (or say --joint-states TOPIC)"
    return found, each[found], words


def _only(reader: BagReader, topics: Sequence[str]) -> tuple[str | None, JointSpeeds | None, str]:
    if topics:
        return topics[0], joint_speeds(reader, topics[0]), ""
    why = absent(reader, "sensor_msgs/msg/JointState")
    return None, None, f"{why}: without joint_states there is no slip and no thrust"


def _one_robot(topics: Sequence[str]) -> None:
    """Refuse a bag in which several namespaces have a topic of one name."""
    spaces: dict[str, list[str]] = {}
    for topic in topics:
        _, first, *rest = topic.split("/")
        if rest:
            spaces.setdefault("/".join(rest), []).append(first)
    for name, of in spaces.items():
        if len(of) > 1:
            raise InitError(
                f"the bag has joint states of {len(of)} robots, {', '.join(f'/{one}/{name}' for one in of)}:"
                f" --namespace {of[0]} says which"
            )


def _most_likely(each: Mapping[str, JointSpeeds], wanted: Collection[str]) -> str | None:
    """The topic with most of the `wanted` joints, else with most joints that turn and are named like wheels.

    Of equal ones the usual name is taken, then the most similar name; None if that is ambiguous.
    """
    known = {topic: len({*joints.names} & {*wanted}) for topic, joints in each.items()}
    turning = {topic: len(turning_wheels(joints)) for topic, joints in each.items()}
    for count in (known, turning):
        best = [topic for topic, number in count.items() if number == max(count.values()) > 0]
        if len(best) == 1:
            return best[0]
        if USUAL in best:
            return USUAL
        if best:
            return best_match("joint_states", "", best)
    return USUAL if USUAL in each else best_match("joint_states", "", each)


def _shown(names: Sequence[str]) -> str:
    more = f" and {len(names) - _SHOWN} others" if len(names) > _SHOWN else ""
    return (", ".join(names[:_SHOWN]) or "no joint") + more


def free_joints(joints: JointSpeeds) -> list[str]:
    """Names of the joints that may turn a wheel: without words of steering, arms, cameras and the like."""
    return [joint for joint in joints.names if not words_of(joint) & {*_NO_WHEEL}]


def turning_wheels(joints: JointSpeeds) -> list[str]:
    """Names of the joints that turn and are named like wheels; if none is, those named by wheels' places."""
    turning = [name for name in joints.turning() if not words_of(name) & {*_NO_WHEEL}]
    named = [name for name in turning if "wheel" in name.lower()]
    placed = [name for name in turning if words_of(name) & {*PLACES}]
    return named or placed
