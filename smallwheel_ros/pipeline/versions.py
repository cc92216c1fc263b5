# SPDX-License-Identifier: Apache-2.0
"""What a filter has believed, by number: counted for the whole drive, kept as long as rows need it."""

from __future__ import annotations

from collections.abc import Collection
from typing import Generic, TypeVar

from smallwheel_ros.pipeline.tables import Integers

T = TypeVar("T")
REMEMBERED = 4  # soils that were met, to which the vehicle may come back


class Versions(Generic[T]):
    """Versions by number, the newest last. Its length counts those that are forgotten, too."""

    def __init__(self, first: T) -> None:
        self._kept = {0: first}
        self._count = 1

    def __len__(self) -> int:
        """Return how many there have been."""
        return self._count

    def __getitem__(self, number: int) -> T:
        """Return a version that is kept; -1: the newest."""
        return self._kept[number if number >= 0 else self._count + number]

    def at(self, numbers: Integers) -> list[T]:
        """Return the version of each number, all of versions that are kept."""
        return [self._kept[number] for number in numbers.tolist()]

    def append(self, version: T) -> None:
        """Take over the newest version."""
        self._kept[self._count] = version
        self._count += 1

    def forget(self, needed: Collection[int]) -> None:
        """Keep only versions of these numbers, and the newest."""
        keep = {*needed, self._count - 1}
        self._kept = {number: one for number, one in self._kept.items() if number in keep}
