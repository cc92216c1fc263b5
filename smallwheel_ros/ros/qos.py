"""Quality of service of every topic."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

# Matches reliable and best-effort publishers alike. Deep enough for a second at 200 Hz in which the
# processor is busy with something else: what does not fit is lost, and nobody is told.
INPUT = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
ESTIMATE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
# A late subscriber gets the newest.
LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
