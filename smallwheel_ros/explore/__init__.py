# SPDX-License-Identifier: Apache-2.0
"""A local page on which effects are set and unset, and everything is fitted and drawn anew."""

from __future__ import annotations

from smallwheel_ros.explore.server import ExploreServer
from smallwheel_ros.explore.session import ExploreError, Session

__all__ = ["ExploreError", "ExploreServer", "Session"]
