# SPDX-License-Identifier: Apache-2.0
"""Read and write bags: rosbag2 (mcap, sqlite3) and ROS 1.

No ROS installation is needed. A bag brings its own message definitions; where it does not, those of
ROS 2 Jazzy and of this package are used.
"""

from __future__ import annotations

from smallwheel_ros.bags.definitions import DefinitionError
from smallwheel_ros.bags.files import BagError, BagMessage, BagTopic, RawMessage
from smallwheel_ros.bags.reader import BagReader
from smallwheel_ros.bags.types import message_type, typestore
from smallwheel_ros.bags.writer import BagWriter, Channel, Message, header

__all__ = [
    "BagError",
    "BagMessage",
    "BagReader",
    "BagTopic",
    "BagWriter",
    "Channel",
    "DefinitionError",
    "Message",
    "RawMessage",
    "header",
    "message_type",
    "typestore",
]
