"""Fields read from bytes, against rosbags' own deserialisation of the same bytes."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import cache, partial
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from smallwheel_ros.bags import FieldError, FieldReader, typestore
from smallwheel_ros.interfaces import message_definitions
from smallwheel_ros.onboard.feed import Feed, Topic
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.parameters import settings_from

SINKAGE = "smallwheel_ros/msg/WheelSinkage"
SETTINGS = (
    {"front.drawbar_pull_topic": "front/load", "velocity_topic": "radar"},
    {"front.drawbar_pull_topic": "front/pull", "front.sinkage_source": "Range"},
)


def topics() -> dict[str, Topic]:
    """Every way of input, by type and what is read."""
    found = {}
    for changes in SETTINGS:
        wheel = {"front.diameter": 0.25, "front.width": 0.1, "front.range_height": 0.3}
        values = settings_from({"wheels": ["front"], **wheel, **changes})
        for topic in Feed(Onboard(values.onboard), values).topics:
            name = "-".join((topic.type.split("/")[-1], *topic.fields[2:3], str(len(topic.fields))))
            found[name] = topic
    return found


TOPICS = topics()


@cache
def noetic() -> Typestore:
    """Types of ROS 1: a header has a number, a range no variance."""
    store = get_typestore(Stores.ROS1_NOETIC)
    own = get_types_from_msg(message_definitions()[SINKAGE], SINKAGE)
    store.register({SINKAGE: own[SINKAGE]})
    return store


Encode = Callable[[Any, str], bytes]
# Store, whether of ROS 2, and what serialises.
FORMATS: dict[str, tuple[Callable[[], Typestore], bool, Callable[[Typestore], Encode]]] = {
    "little": (typestore, True, lambda s: partial(s.serialize_cdr, little_endian=True)),
    "big": (typestore, True, lambda s: partial(s.serialize_cdr, little_endian=False)),
    "ros1": (noetic, False, lambda s: s.serialize_ros1),
}


def test_all_types_are_here() -> None:
    assert {topic.type.split("/")[-1] for topic in TOPICS.values()} == {
        "WrenchStamped",
        "WheelSinkage",
        "Range",
        "Odometry",
        "JointState",
        "TwistStamped",
    }


def numbers(kind: str) -> st.SearchStrategy[Any]:
    if kind.startswith("float"):
        return st.floats(width=int(kind[5:]))
    if kind == "bool":
        return st.booleans()
    limits = np.iinfo({"byte": "int8", "char": "uint8"}.get(kind, kind))
    return st.integers(int(limits.min), int(limits.max))


# Few of them, so that messages of one layout come up often.
TEXTS = st.sampled_from(["", "odom", "räder", "abcd"])


@cache
def messages(store: Typestore, kind: str) -> st.SearchStrategy[Any]:
    """Any message of a type."""
    fields = {name: values(store, *desc) for name, desc in store.get_msgdef(kind).fields}
    return st.builds(store.types[kind], **fields)


def values(store: Typestore, node: Nodetype, what: Any) -> st.SearchStrategy[Any]:
    if node == Nodetype.NAME:
        return messages(store, what)
    if node == Nodetype.BASE:
        return TEXTS if what[0] == "string" else numbers(what[0])
    (item, inner), count = what
    least, most = (count, count) if node == Nodetype.ARRAY else (0, 3)
    listed = st.lists(values(store, item, inner), min_size=least, max_size=most)
    if item == Nodetype.NAME or inner[0] == "string":
        return listed
    kind = {"byte": "int8", "char": "uint8"}.get(inner[0], inner[0])
    return listed.map(lambda found: np.array(found, dtype=kind))


def plain(found: Any) -> Any:
    """Values to compare: arrays as lists, numbers with nan as text."""
    if isinstance(found, tuple | list | np.ndarray):
        return [plain(value) for value in found]
    return found if isinstance(found, str) else repr(float(found))


def outcome(read: Callable[[bytes], Any], data: bytes) -> Any:
    try:
        return plain(read(data))
    except Exception:
        return "refused"


class Asked:
    """Gives fields of messages that rosbags has made, and counts them."""

    def __init__(self, values_of: Callable[[Any], Any]) -> None:
        self.values_of, self.count = values_of, 0

    def __call__(self, message: Any) -> Any:
        self.count += 1
        return self.values_of(message)


class Case(NamedTuple):
    """A topic in one format: its reader, the same by rosbags, and what makes bytes for them."""

    reader: FieldReader
    slow: Callable[[bytes], Any]
    encode: Callable[[Any], bytes]
    store: Typestore
    kind: str
    asked: Asked  # by the reader


def case(name: str, how: str) -> Case:
    topic, (store_of, ros2, encoder) = TOPICS[name], FORMATS[how]
    store, asked = store_of(), Asked(topic.values_of)
    decode = store.deserialize_cdr if ros2 else store.deserialize_ros1
    return Case(
        FieldReader(store, topic.type, ros2, topic.fields + topic.newer, asked),
        lambda data: topic.values_of(decode(data, topic.type)),
        lambda message: bytes(encoder(store)(message, topic.type)),
        store,
        topic.type,
        asked,
    )


@pytest.mark.parametrize("how", FORMATS)
@pytest.mark.parametrize("name", TOPICS)
@settings(max_examples=examples(25))
@given(data=st.data())
def test_any_message_gives_what_rosbags_gives(name: str, how: str, data: st.DataObject) -> None:
    reader, slow, encode, store, kind, asked = case(name, how)
    drawn = data.draw(st.lists(messages(store, kind), min_size=1, max_size=6))
    for raw in map(encode, drawn):
        for _ in range(3):  # by rosbags, then by the layout
            assert plain(reader(raw)) == plain(slow(raw))
    assert asked.count <= len(drawn)


@pytest.mark.parametrize("how", FORMATS)
@pytest.mark.parametrize("name", TOPICS)
@settings(max_examples=examples(40))
@given(data=st.data())
def test_damaged_bytes_are_refused_where_rosbags_refuses_them(
    name: str, how: str, data: st.DataObject
) -> None:
    reader, slow, encode, store, kind, _ = case(name, how)
    raw = encode(data.draw(messages(store, kind)))
    reader(raw)
    for _ in range(6):
        at, byte = data.draw(st.integers(0, len(raw) - 1)), data.draw(st.integers(0, 255))
        flipped = raw[:at] + bytes([byte]) + raw[at + 1 :]
        for damaged in (flipped, raw[:at], raw + bytes(byte % 9), flipped[at:]):
            assert outcome(reader, damaged) == outcome(slow, damaged)
    assert outcome(reader, raw) == outcome(slow, raw) != "refused"


@pytest.mark.parametrize("how", FORMATS)
@pytest.mark.parametrize("name", TOPICS)
def test_every_shorter_message_is_refused(name: str, how: str) -> None:
    reader, _, encode, store, kind, _ = case(name, how)
    raw = encode(example(store, kind))
    reader(raw)
    shortest = 3 if FORMATS[how][1] else 0  # in ROS 2 up to so many bytes may follow
    for size in range(len(raw) - shortest):
        with pytest.raises(Exception, match=r".") as raised:
            reader(raw[:size])
        assert not isinstance(raised.value, FieldError)


def example(store: Typestore, kind: str) -> Any:
    """A message with something everywhere."""
    made = {}
    for name, (node, what) in store.get_msgdef(kind).fields:
        if node == Nodetype.NAME:
            made[name] = example(store, what)
        elif node == Nodetype.BASE:
            made[name] = "frame" if what[0] == "string" else 1
        else:
            (_, (inner, *_)), count = what
            many = count or 2
            made[name] = ["a", "bc"][:many] if inner == "string" else np.full(many, 2.0)
    return store.types[kind](**made)


@pytest.mark.parametrize("how", FORMATS)
@pytest.mark.parametrize("name", TOPICS)
def test_rosbags_is_asked_only_for_the_first_message(name: str, how: str) -> None:
    reader, _, encode, store, kind, asked = case(name, how)
    message = example(store, kind)
    padding = bytes(3) if FORMATS[how][1] else b""
    for sec in range(5):
        message.header.stamp.sec = sec
        assert reader(encode(message) + padding)[0] == sec
    assert asked.count == 1


def test_layouts_of_several_publishers_are_all_known() -> None:
    reader, _, encode, store, kind, asked = case("JointState-name-5", "little")
    message = example(store, kind)
    message.effort = np.array([])
    turns = [["a", "bc"], ["d", "ef"], ["a", "bc"], ["bc", "a"], ["d", "ef"]]
    for i, names in enumerate(turns * 3):
        message.name, message.velocity = names, np.array([float(i), -1.0])
        sec, _, found, speeds, efforts = reader(encode(message))
        assert (sec, list(found), list(speeds)) == (1, names, [float(i), -1.0])
        assert len(efforts) == 0
    assert asked.count == 3


def test_messages_that_are_all_different_are_read_in_bounded_memory() -> None:
    reader, slow, encode, store, kind, asked = case("Odometry-header.frame_id-11", "little")
    message = example(store, kind)
    for x in (1.0, 2.0):
        for i in range(200):
            message.header.frame_id, message.pose.pose.position.x = f"frame{i:03d}", x
            raw = encode(message)
            assert reader(raw) == slow(raw)
            assert reader(raw)[2:4] == (f"frame{i:03d}", x)
    assert asked.count == 64 + 4 * (200 - 64)


# --- Types that a bag defines otherwise

AROUND = """
uint8 first
string[] words
vendor_msgs/Part[] parts
std_msgs/Header header
bool[3] flags
vendor_msgs/Nothing nothing
vendor_msgs/Part[2] pair
uint16[] shorts
float64 sinkage
string[2] last
float32 variance
================================================================================
MSG: vendor_msgs/Part
uint8 number
string name
float64 value
================================================================================
MSG: vendor_msgs/Nothing
"""


@cache
def other(text: str, ros1: bool = False) -> Typestore:
    """The types of ROS with a sinkage message that is none of ours."""
    store = get_typestore(Stores.EMPTY)
    known = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY).fielddefs
    found = {k: v for k, v in get_types_from_msg(text, SINKAGE).items() if k not in known}
    store.register({**copy.deepcopy(known), **found})
    return store


@pytest.mark.parametrize("ros2", [True, False], ids=["ros2", "ros1"])
@settings(max_examples=examples(60))
@given(data=st.data())
def test_fields_are_found_among_others(ros2: bool, data: st.DataObject) -> None:
    store = other(AROUND, not ros2)
    names = ("variance", "header.stamp.sec", "flags", "sinkage", "last", "words", "shorts")
    asked = Asked(attrgetter(*names))
    reader = FieldReader(store, SINKAGE, ros2, names, asked)
    encode = store.serialize_cdr if ros2 else store.serialize_ros1
    decode = store.deserialize_cdr if ros2 else store.deserialize_ros1
    drawn = data.draw(st.lists(messages(store, SINKAGE), min_size=1, max_size=3))
    for message in drawn:
        raw = bytes(encode(message, SINKAGE))
        for _ in range(3):
            assert plain(reader(raw)) == plain(attrgetter(*names)(decode(raw, SINKAGE)))
    assert asked.count <= len(drawn)


def test_a_field_that_the_definition_lacks_is_named() -> None:
    store = other("std_msgs/Header header\nfloat64 sinkage\n")
    topic = TOPICS["WheelSinkage-sinkage-4"]
    reader = FieldReader(store, topic.type, True, topic.fields, topic.values_of)
    raw = bytes(store.serialize_cdr(example(store, SINKAGE), SINKAGE))
    for _ in range(2):
        with pytest.raises(FieldError, match="variance"):
            reader(raw)


@pytest.mark.parametrize("text", ["std_msgs/Header sinkage", "std_msgs/Header[2] sinkage"])
def test_what_is_neither_a_number_nor_a_string_is_named(text: str) -> None:
    store, names = other(f"std_msgs/Header header\n{text}\n"), ("header.frame_id", "sinkage")
    reader = FieldReader(store, SINKAGE, True, names, attrgetter(*names))
    header = example(store, "std_msgs/msg/Header")
    found = [header, header] if "[" in text else header
    raw = store.serialize_cdr(store.types[SINKAGE](header=header, sinkage=found), SINKAGE)
    with pytest.raises(FieldError, match="sinkage is neither a number nor a string"):
        reader(bytes(raw))


def test_an_older_range_has_no_variance() -> None:
    topic, store = TOPICS["Range-range-5"], noetic()
    assert topic.newer == ("variance",)
    reader = FieldReader(store, topic.type, False, topic.fields + topic.newer, topic.values_of)
    message = example(store, topic.type)
    for distance in (0.25, 0.5):
        message.range = distance
        raw = bytes(store.serialize_ros1(message, topic.type))
        assert reader(raw) == (1, 1, distance, 1.0, 1.0, 0.0)
