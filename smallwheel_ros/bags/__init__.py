# SPDX-License-Identifier: Apache-2.0
"""Read and write bags: rosbag2 (mcap, sqlite3) and ROS 1.

No ROS installation is needed. The message definitions of the bag are used; if it has none, those of
ROS 2 Jazzy and of this package.
"""

from __future__ import annotations

from smallwheel_ros.bags.reader import (
    BagError,
    BagMessage,
    BagReader,
    BagTopic,
    CopiedTopic,
    Key,
    RawMessage,
    Storage,
)
from smallwheel_ros.bags.types import DefinitionError, message_type, typestore
from smallwheel_ros.bags.writer import STORAGES, BagWriter, Message, check_new_bag, header

__all__ = [
    "STORAGES",
    "BagError",
    "BagMessage",
    "BagReader",
    "BagTopic",
    "BagWriter",
    "CopiedTopic",
    "DefinitionError",
    "Key",
    "Message",
    "RawMessage",
    "Storage",
    "check_new_bag",
    "header",
    "message_type",
    "typestore",
]
