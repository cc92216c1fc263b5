# SPDX-License-Identifier: Apache-2.0
"""Laws that a tangent speaks for, before they are fitted in the model."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

from smallwheel_ros.fitting.fit import Fit
from smallwheel_ros.learn.law import Law

T = TypeVar("T")


@dataclass(frozen=True)
class Proposal:
    """A law that a tangent speaks for, not yet fitted. expected: its score there.

    numbers: where its fit starts. near: the fit that the tangent is of.
    """

    law: Law
    numbers: Mapping[str, float]
    cost: float
    expected: float
    near: Fit


def start(law: Law, number: int, strength: float) -> dict[str, float]:
    """Where the numbers of a law's one term start, as those of its term of that number."""
    (term,) = law.terms
    return {f"a{number}": strength} | ({f"c{number}": term.constant} if term.free else {})


def both(
    law: Law, numbers: Mapping[str, float], second: Proposal, cost: float, expected: float
) -> Proposal:
    """A law with a second term, that of a proposal, which is of the same tangent."""
    (term,) = second.law.terms
    two = replace(law, terms=(*law.terms, term))
    started = {**numbers, **start(second.law, 2, second.numbers["a1"])}
    return Proposal(two, started, cost, expected, second.near)


def first_of_each(items: Iterable[T], key: Callable[[T], Hashable]) -> Iterator[T]:
    """The first item of each kind, in their order."""
    seen: set[Hashable] = set()
    for item in items:
        kind = key(item)
        if kind not in seen:
            seen.add(kind)
            yield item
