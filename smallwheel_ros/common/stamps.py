# SPDX-License-Identifier: Apache-2.0
"""Stamps of messages: whole nanoseconds since 1970."""

from __future__ import annotations

SECOND = 1_000_000_000  # ns
NEVER = -(1 << 62)  # a stamp before any other
