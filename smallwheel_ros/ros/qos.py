"""Quality of service of every topic."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

# Matches reliable and best-effort publishers alike.
INPUT = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
ESTIMATE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
# A late subscriber gets the newest.
LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
