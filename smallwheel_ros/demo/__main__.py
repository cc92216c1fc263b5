# SPDX-License-Identifier: Apache-2.0
"""`python -m smallwheel_ros.demo`."""

from __future__ import annotations

from smallwheel_ros.demo.command import demo

demo()
