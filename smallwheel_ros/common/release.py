# SPDX-License-Identifier: Apache-2.0
"""The version of this package, which pages and records of replays state."""

from __future__ import annotations

__version__ = "0.4.0"
