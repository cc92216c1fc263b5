# SPDX-License-Identifier: Apache-2.0
"""Numbered states of a filter: each has the next number, and those that rows still need are kept."""

from __future__ import annotations

from collections.abc import Collection
from typing import TypeVar

T = TypeVar("T")
REMEMBERED = 4  # number of earlier soils that are kept, since the vehicle may come back to them


class Versions(dict[int, T]):
    """The states that are still kept, by number.

    Parameters
    ----------
    first
        State of number 0.

    Attributes
    ----------
    newest
        The state that was added last.
    count
        Number of states so far, dropped ones included; the newest has the number `count` - 1.
    """

    def __init__(self, first: T) -> None:
        super().__init__({0: first})
        self.newest, self.count = first, 1

    def append(self, version: T) -> None:
        """Add a state under the number `count`; it becomes the newest."""
        self[self.count] = self.newest = version
        self.count += 1

    def forget(self, needed: Collection[int]) -> None:
        """Drop all states except the newest and those of the numbers `needed`."""
        for number in self.keys() - {*needed, self.count - 1}:
            del self[number]
