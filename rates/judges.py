# SPDX-License-Identifier: Apache-2.0
"""What rates are of, and how they are counted: subjects, judges, and rates with their 95 % intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import binomtest, chi2

Line = dict[str, Any]
_DRAWS = 1000  # of the bootstrap


@dataclass(frozen=True)
class Rate:
    """A rate with its 95 % interval. count: of what, as a judge says."""

    value: float
    low: float
    high: float
    count: int


@dataclass(frozen=True)
class Judge:
    """Counts over the lines of some worlds.

    least, most: what the rate should be; where its whole interval is beyond, it fails. each: a pattern of the
    names of worlds of which that holds singly, too.
    """

    what: str
    count: Callable[[Sequence[Line]], Rate | None]
    least: float | None = None
    most: float | None = None
    each: str = "$^"

    def fails(self, rate: Rate) -> bool:
        """Whether a rate is beyond its limit, interval and all."""
        too_low = self.least is not None and rate.high < self.least
        return too_low or (self.most is not None and rate.low > self.most)

    @property
    def limit(self) -> str:
        """The limit in words; empty without one."""
        parts = [f"at least {self.least:g}"] if self.least is not None else []
        return ", ".join(parts + ([f"at most {self.most:g}"] if self.most is not None else []))


@dataclass(frozen=True)
class Subject:
    """What rates are of. seconds: of processor that a trial takes, about."""

    name: str
    worlds: Sequence[str]
    trial: Callable[[str, int], Line]
    judges: Sequence[Judge]
    seeds: int
    seconds: float


# --- Rates with their intervals


Counter = Callable[[Sequence[Line]], "Rate | None"]


def share(found: Callable[[Line], int], of: Callable[[Line], int] = lambda _: 1) -> Counter:
    """A share of counts that are independent, with Wilson's interval."""

    def count(lines: Sequence[Line]) -> Rate | None:
        hits, total = sum(found(one) for one in lines), sum(of(one) for one in lines)
        if not total:
            return None
        bounds = binomtest(int(hits), int(total)).proportion_ci(method="wilson")
        return Rate(hits / total, float(bounds.low), float(bounds.high), int(total))

    return count


def ratio(
    over: Callable[[Line], float], under: Callable[[Line], float], root: bool = False
) -> Counter:
    """A ratio of sums over lines, with its interval by the bootstrap over them. root: the root of it."""

    def count(lines: Sequence[Line]) -> Rate | None:
        pairs = np.array([(over(one), under(one)) for one in lines], dtype=float).reshape(-1, 2)
        pairs = pairs[pairs[:, 1] > 0.0]
        if not len(pairs):
            return None
        rng = np.random.default_rng(1)
        drawn = pairs[rng.integers(len(pairs), size=(_DRAWS, len(pairs)))].sum(axis=1)
        low, high = np.quantile(drawn[:, 0] / drawn[:, 1], (0.025, 0.975))
        whole = pairs.sum(axis=0)
        found = np.array([whole[0] / whole[1], low, high])
        value, low, high = (np.sqrt(found) if root else found).tolist()
        return Rate(value, low, high, len(pairs))

    return count


def pooled(over: Callable[[Line], float], under: Callable[[Line], float]) -> Counter:
    """A sum over all lines over another one, with its interval by the bootstrap over lines.

    Lines count of which the lower sum is 0, too, as with what was expected on a drive on which it never came.
    The count is the lower sum.
    """

    def count(lines: Sequence[Line]) -> Rate | None:
        pairs = np.array([(over(one), under(one)) for one in lines], dtype=float).reshape(-1, 2)
        whole = pairs.sum(axis=0)
        if not whole[1]:
            return None
        rng = np.random.default_rng(1)
        drawn = pairs[rng.integers(len(pairs), size=(_DRAWS, len(pairs)))].sum(axis=1)
        drawn = drawn[drawn[:, 1] > 0.0]
        low, high = np.quantile(drawn[:, 0] / drawn[:, 1], (0.025, 0.975))
        return Rate(float(whole[0] / whole[1]), float(low), float(high), round(whole[1]))

    return count


def events(found: Callable[[Line], float], way: Callable[[Line], float], each: float) -> Counter:
    """How many in so many metres, by Poisson's law."""

    def count(lines: Sequence[Line]) -> Rate | None:
        hits, metres = sum(found(one) for one in lines), sum(way(one) for one in lines)
        if not metres:
            return None
        low = 0.5 * chi2.ppf(0.025, 2 * hits) if hits else 0.0
        high = 0.5 * chi2.ppf(0.975, 2 * hits + 2)
        factor = each / metres
        return Rate(hits * factor, low * factor, high * factor, round(metres))

    return count


def middle(value: Callable[[Line], float | None]) -> Counter:
    """The median, with its interval by the bootstrap."""

    def count(lines: Sequence[Line]) -> Rate | None:
        known = np.array([v for one in lines if (v := value(one)) is not None], dtype=float)
        if not known.size:
            return None
        rng = np.random.default_rng(1)
        drawn = np.median(known[rng.integers(known.size, size=(_DRAWS, known.size))], axis=1)
        low, high = np.quantile(drawn, (0.025, 0.975))
        return Rate(float(np.median(known)), float(low), float(high), known.size)

    return count
