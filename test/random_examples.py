# SPDX-License-Identifier: Apache-2.0
"""How many random examples a test tries: few in the fast tests, many in the slow ones."""

from __future__ import annotations

from hypothesis import settings

USUAL = 100  # hypothesis's own number


def examples(count: int) -> int:
    """Return as many of `count` as a profile has of hypothesis's own number: a third fast, ten times slow."""
    return max(1, count * settings().max_examples // USUAL)
