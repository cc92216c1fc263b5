# SPDX-License-Identifier: Apache-2.0
"""Levels of the warning: their numbers in messages, and their words.

Messages, log, diagnostics, replay's list and pages all read them here.
"""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Self


class WarningLevel(IntEnum):
    """Level of the warning that the vehicle gets stuck; the values are the numbers in VehicleMobility.msg.

    Attributes
    ----------
    meaning
        What the level means, as in the message's comment and docs/node.md.
    sentence
        The warning at that level.
    """

    meaning: str
    sentence: str

    def __new__(cls, number: int, meaning: str = "", sentence: str = "") -> Self:
        """Make a level of a number with its words; without a sentence the meaning serves as one."""
        one = int.__new__(cls, number)
        one._value_, one.meaning, one.sentence = number, meaning, sentence or meaning
        return one

    UNKNOWN = 0, "slip is not known: no speed of wheels or over ground"
    OK = 1, "no sign of getting stuck"
    MAY_GET_STUCK = (
        2,
        "slow down, or go another way",
        "the wheels slip by {slip:.2f}: the vehicle may get stuck",
    )
    GETS_STUCK = (
        3,
        "stop: it slips, and more is asked for than the ground gives",
        "the wheels slip by {slip:.2f}: the vehicle gets stuck, its wheels dig in: stop",
    )
    STUCK = (
        4,
        "rims run, the vehicle does not",
        "the rims run, and the vehicle does not move: it is stuck",
    )

    @classmethod
    def warned(cls, level: int) -> WarningLevel:
        """Return the level for a `Warned.level` of 0, 1 or 2: OK, MAY_GET_STUCK or GETS_STUCK."""
        return cls(cls.OK + level)

    def said(self, slip: float) -> str:
        """Return the warning in words, with the slip (1) of the middle wheel filled in."""
        return self.sentence.format(slip=slip)

    @property
    def short(self) -> str:
        """The level in one to three words, such as "may get stuck"."""
        return self.name.lower().replace("_", " ")
