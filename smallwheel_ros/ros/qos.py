"""Quality of service of every topic."""

from __future__ import annotations

from rclpy.event_handler import PublisherEventCallbacks
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


def no_events() -> PublisherEventCallbacks:
    """Return callbacks for a publisher that waits for no event.

    Each event costs time at every wait, and the diagnostics find the same out once a second.
    """
    return PublisherEventCallbacks(use_default_callbacks=False)
