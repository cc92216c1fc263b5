# SPDX-License-Identifier: Apache-2.0
"""Columns of serialised messages: whatever padding holds, either end first, and what is no message."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rows_of_drives import SECOND, START, static_rover

from smallwheel_ros.bags import BagWriter
from smallwheel_ros.bags.types import typestore
from smallwheel_ros.drive.feed import feed
from smallwheel_ros.pipeline.intake.decoder import Decoder
from smallwheel_ros.pipeline.intake.inputs import JOINTS, ODOM, topics_of
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Readings
from smallwheel_ros.replay.recording import turns_of

NAMES = [f"{wheel}_joint" for wheel in ("fl", "fr", "rl", "rr")]


def _header(k: int, frame: str = "odom") -> Any:
    types = typestore().types
    seconds, rest = divmod(START + k * SECOND // 20, SECOND)
    time = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest)
    return types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def _joints(k: int, names: list[str] = NAMES, frame: str = "") -> Any:
    turns = np.full(len(names), 2.0 + 0.01 * k)  # rad/s, of which the position is the integral
    angle = 2.0 * (k / 20.0) + 0.1 * (k / 20.0) ** 2 + 0.0 * turns
    kind = typestore().types[JOINTS]
    return kind(header=_header(k, frame), name=names, position=angle, velocity=turns, effort=turns)


def _odometry(k: int) -> Any:
    types = typestore().types

    def of(name: str, **parts: Any) -> Any:
        return types[f"geometry_msgs/msg/{name}"](**parts)

    none = np.zeros(36)
    zero = of("Vector3", x=0.0, y=0.0, z=0.0)
    pose = of(
        "Pose",
        position=of("Point", x=0.01 * k, y=0.0, z=0.0),
        orientation=of("Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
    )
    twist = of("Twist", linear=of("Vector3", x=0.2 + 0.01 * np.sin(k), y=0.0, z=0.0), angular=zero)
    return types[ODOM](
        header=_header(k), child_frame_id="base", pose=of("PoseWithCovariance", pose=pose, covariance=none),
        twist=of("TwistWithCovariance", twist=twist, covariance=none),
    )  # fmt: skip


def _raw(message: Any, kind: str, *, little: bool = True) -> bytes:
    return bytes(typestore().serialize_cdr(message, kind, little_endian=little))


def test_padding_that_is_not_zero_makes_no_group_of_its_own() -> None:
    random = np.random.default_rng(0)
    raws = []
    plain = Decoder(typestore(), JOINTS)
    [(_, layout, _)] = plain.columns([_raw(_joints(0), JOINTS)])
    used = layout.fixed.copy()
    for at, kind, count in layout.places.values():
        used[at : at + np.dtype(kind).itemsize * count] = True
    used[2:4] = True  # options of the encapsulation
    assert not used.all()
    for k in range(20):
        raw = np.frombuffer(_raw(_joints(k), JOINTS), np.uint8).copy()
        raw[~used] = random.integers(1, 256, int((~used).sum()))
        raws.append(raw.tobytes())
    [(index, _, columns)] = Decoder(typestore(), JOINTS).columns(raws)
    np.testing.assert_array_equal(index, np.arange(20))
    np.testing.assert_allclose(columns["velocity"][:, 2], 2.0 + 0.01 * np.arange(20))


def test_either_end_of_a_number_may_come_first() -> None:
    raws = [_raw(_odometry(k), ODOM, little=k % 2 == 0) for k in range(10)]
    groups = Decoder(typestore(), ODOM).columns(raws)
    found = np.full(10, np.nan)
    stamps = np.zeros(10, dtype=np.int64)
    for index, layout, columns in groups:
        assert layout.strings["child_frame_id"] == ["base"]
        found[index] = columns["pose.pose.position.x"][:, 0]
        stamps[index] = columns["header.stamp.sec"][:, 0] * SECOND
    np.testing.assert_allclose(found, 0.01 * np.arange(10))
    assert (stamps == START).all()


def test_strings_of_other_lengths_and_other_joints_are_told_apart() -> None:
    raws = [
        _raw(_joints(k, NAMES if k % 3 else NAMES[::-1], "x" * (k % 2)), JOINTS) for k in range(12)
    ]
    seen = set()
    for index, layout, columns in Decoder(typestore(), JOINTS).columns(raws):
        for i, row in zip(index.tolist(), columns["velocity"], strict=True):
            assert layout.strings["name"] == (NAMES if i % 3 else NAMES[::-1])
            assert row[0] == pytest.approx(2.0 + 0.01 * i)
            seen.add(i)
    assert seen == set(range(12))


@pytest.mark.parametrize("bad", [b"", b"\x00\x01", b"\xff" * 300, _raw(_joints(3), JOINTS)[:60]])
def test_what_is_no_message_is_counted_and_the_others_are_read(bad: bytes) -> None:
    decoder = Decoder(typestore(), JOINTS)
    raws = [_raw(_joints(0), JOINTS), bad, _raw(_joints(2), JOINTS)]
    found = [i for index, _, _ in decoder.columns(raws) for i in index.tolist()]
    assert sorted(found) == [0, 2]
    assert sum(decoder.problems.values()) == 1
    assert "bytes" in next(iter(decoder.problems))


def test_a_bag_is_replayed_the_same_in_blocks_of_any_size(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive") as writer:
        for k in range(200):
            stamp = START + k * SECOND // 20
            writer.write_raw("/joint_states", JOINTS, stamp, _raw(_joints(k), JOINTS))
            writer.write_raw("/odom", ODOM, stamp, _raw(_odometry(k), ODOM))
    settings = static_rover(imu_topic=None)
    found = [
        Readings.joined([t.readings for t in turns_of(tmp_path / "drive", settings, block)])
        for block in (4096, 17)
    ]
    assert len(found[0]) > 300
    assert np.isfinite(found[0].slip).mean() > 0.95
    for name in ("stamp", "slip", "path", "load", "speed_std"):
        one, two = (getattr(each, name) for each in found)
        np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("chunk", [2, 11])
def test_joint_states_of_wheels_and_of_an_arm_are_both_good(chunk: int) -> None:
    settings = static_rover(imu_topic=None)
    pipeline = Pipeline(settings.onboard)
    topics = {topic.name: topic for topic in topics_of(settings)}
    decoders = {"joint_states": Decoder(typestore(), JOINTS)}

    def give(names: list[str], *numbers: int) -> None:
        messages = [("joint_states", _raw(_joints(k, names), JOINTS), 0) for k in numbers]
        feed(pipeline, topics, decoders, messages)

    give(NAMES, 0, 1)
    for k in range(2, 40, chunk):
        give(["elbow"], *range(k, k + chunk))
        give(NAMES, *range(k, k + chunk))
    assert not pipeline.problems
    give(["elbow"], 100)
    feed(pipeline, topics, decoders, [("joint_states", _raw(_halved(101), JOINTS), 0)])
    assert set(pipeline.problems.values()) == {1}  # fewer values than names
    assert {reason for _, reason in pipeline.problems} == {"no_value"}


def _halved(k: int) -> Any:
    whole = _joints(k)
    whole.velocity = whole.velocity[:2]
    return whole
