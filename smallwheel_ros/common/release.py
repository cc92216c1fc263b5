# SPDX-License-Identifier: Apache-2.0
"""Which version this is: pages and records of replays say it."""

from __future__ import annotations

__version__ = "0.4.0"
