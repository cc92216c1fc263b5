"""Read and write bags: rosbag2 (mcap, sqlite3) and ROS 1; rosbags is imported in `library` only.

No ROS installation is needed. A bag brings its own message definitions; where it does not,
those of ROS 2 Jazzy and of this package are used.
"""

from __future__ import annotations

from smallwheel_ros.bag_files import BagError, BagMessage, BagTopic, RawMessage
from smallwheel_ros.bags.field_reader import FieldError, FieldReader
from smallwheel_ros.bags.library import Channel, Nodetype, message_type, typestore
from smallwheel_ros.bags.packer import packer
from smallwheel_ros.bags.reader import BagReader
from smallwheel_ros.bags.writer import BagWriter

__all__ = [
    "BagError",
    "BagMessage",
    "BagReader",
    "BagTopic",
    "BagWriter",
    "Channel",
    "FieldError",
    "FieldReader",
    "Nodetype",
    "RawMessage",
    "message_type",
    "packer",
    "typestore",
]
