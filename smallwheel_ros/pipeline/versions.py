# SPDX-License-Identifier: Apache-2.0
"""What a filter has believed, by number: counted for the whole drive, kept as long as rows need it."""

from __future__ import annotations

from collections.abc import Collection
from typing import TypeVar

T = TypeVar("T")
REMEMBERED = 4  # soils that were met, to which the vehicle may come back


class Versions(dict[int, T]):
    """Versions that are kept, by number. count: of all, the forgotten ones, too; newest: the last."""

    def __init__(self, first: T) -> None:
        super().__init__({0: first})
        self.newest, self.count = first, 1

    def append(self, version: T) -> None:
        """Take over the newest version."""
        self[self.count] = self.newest = version
        self.count += 1

    def forget(self, needed: Collection[int]) -> None:
        """Keep only versions of these numbers, and the newest."""
        for number in self.keys() - {*needed, self.count - 1}:
            del self[number]
