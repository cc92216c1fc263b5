# SPDX-License-Identifier: Apache-2.0
"""How many random examples a test tries: few in the fast tests, many in the slow ones."""

from __future__ import annotations

from hypothesis import settings

FAST = 100  # hypothesis's own number, which the profile "fast" in conftest.py leaves alone


def examples(count: int) -> int:
    """Return `count` in the fast tests, and in the slow ones as much more as their profile has."""
    return count * settings().max_examples // FAST
