# SPDX-License-Identifier: Apache-2.0
"""Quality of service of every topic, and what parameters `qos_overrides.*` make of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import copy
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions

# Deep enough for a second at 200 Hz in which the processor is busy with something else: what does not
# fit is lost, and nobody is told. That goes for reliable topics too.
_DEEP = 200
# Matches reliable and best-effort publishers alike.
INPUT = QoSProfile(depth=_DEEP, reliability=ReliabilityPolicy.BEST_EFFORT)
ESTIMATE = QoSProfile(depth=_DEEP, reliability=ReliabilityPolicy.RELIABLE)
# A late subscriber gets the newest.
LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

OVERRIDES = "qos_overrides."
_DEEPEST = 10_000  # messages
_VALUES: dict[str, tuple[str, ...]] = {
    name: tuple(policy.name.lower() for policy in kind if policy.name.lower() != "unknown")
    for name, kind in (
        ("history", HistoryPolicy),
        ("reliability", ReliabilityPolicy),
        ("durability", DurabilityPolicy),
    )
}
_POLICIES = (*_VALUES, "depth")


def no_events() -> PublisherEventCallbacks:
    """Return callbacks for a publisher that waits for no event.

    Each event costs time at every wait, and the diagnostics find the same out once a second.
    """
    return PublisherEventCallbacks(use_default_callbacks=False)


def overridable(profile: QoSProfile, entity: str | None = None) -> dict[str, Any]:
    """Return arguments for a publisher or subscription whose quality of service users may override.

    entity: tells two of the same topic apart.
    """
    kinds = [QoSPolicyKind[name.upper()] for name in _POLICIES]
    return {
        "qos_profile": copy(profile),  # rclpy writes the overrides into it
        "qos_overriding_options": QoSOverridingOptions(kinds, entity_id=entity),
    }


def override_problems(
    values: Mapping[str, object], listened: Iterable[str], published: Iterable[str]
) -> tuple[list[str], list[str]]:
    """Say which parameters `qos_overrides.*` are wrong, and which nobody uses.

    values: of these parameters. listened, published: resolved names of topics.
    """
    kinds = [(t, kind) for t in listened for kind in ("subscription", "subscription_latched")]
    kinds += [(topic, "publisher") for topic in published]
    known = {f"{OVERRIDES}{topic}.{kind}.{name}" for topic, kind in kinds for name in _POLICIES}
    wrong, unused = [], []
    for name, value in values.items():
        if name not in known:
            unused.append(
                f"parameter {name} is not used: expected {OVERRIDES}TOPIC.KIND.POLICY, with the full"
                " name of a topic of this node, KIND subscription or publisher, and POLICY one of"
                f" {', '.join(_POLICIES)}"
            )
        elif name.endswith(".depth"):
            if type(value) is not int or not 1 <= value <= _DEEPEST:
                wrong.append(
                    f"parameter {name} is {value!r}, expected an integer from 1 to {_DEEPEST}"
                )
        elif not isinstance(value, str) or value.lower() not in _VALUES[name.rsplit(".", 1)[1]]:
            choices = " or ".join(_VALUES[name.rsplit(".", 1)[1]])
            wrong.append(f"parameter {name} is {value!r}, expected {choices}")
    return wrong, unused
