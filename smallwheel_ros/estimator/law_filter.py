# SPDX-License-Identifier: Apache-2.0
"""The soil's law from segments: a bank of iterated Kalman filters (filterpy) over `law_model`'s x.

    predict   x <- x0 + a (x - x0),  P <- a P a + Q  for u, n', m, with the distance ds travelled:
              a = exp(-ds q^2 / (2 std^2)),  Q = (1 - a^2) P0. The nuisances are constant.
    update    z = h(x) + v, linearised at the newest x, up to 4 times (Bell and Cathey 1993).
    R         sigma^2/count + by^2 var(ln W) + (0.02 z)^2 + by^2 S^2 r + A c,  by = dh / d ln W

sigma, var(ln W): noise of the sensors (`segment`). 0.02 z: what the law itself misses. S: the soil's
deviation of ln k from place to place; A: variance of the shown sinkage that load has no part in. Both
are learnt from the innovations (`Scatter`). r, c: how much a segment's mean counts, given that its
neighbours are alike.

Four filters: soil that drifts by q = process_noise or six times that, 1/sqrt(m), each with the
deviations of passes and zeros as told ("wide") or a tenth of them. Their weights are likelihoods to
the power of 1/2, since neighbours are alike. The mean is that of all; the covariance is always of the
wide ones about that mean: a nuisance that the data does not show is still allowed for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray

from smallwheel_ros.estimator.law_member import TEMPER, UNSETTLED, Border, Member, State
from smallwheel_ros.estimator.law_model import (
    EACH,
    LAW,
    LEAST_SHARE,
    LOAD_SCALE,
    LOAD_ZERO,
    PASS,
    SIDE,
    WHEELS,
    LawModel,
    N,
    Shown,
)
from smallwheel_ros.estimator.scatter import Innovation, Scatter
from smallwheel_ros.estimator.segment import Position, Segment
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior
from smallwheel_ros.estimator.wheel_sinkage import NO_SINKAGE
from smallwheel_ros.physics.wheel import Quantity

Array = NDArray[np.float64]

_FAST = 6.0  # drift of the quick filters over that of the slow: soils that change within metres
_QUICK_SHARE = 0.2  # what is believed of it before any data
_WIDE_SHARE = 0.3  # that a nuisance is there at all
_TIGHT = 0.1
_FORGET = 0.002  # share of the first weights that comes back at each segment
_LOWEST = -15.0  # ln of a weight: a filter can come back
_LEAST_SINKAGE = 1e-9  # m: the model's of a wheel that has no weight to speak of
# Segments after which all are taken again about the newest estimate. (After 8 or 16 that is no better a point
# than the first one: the recorded trial of a pressed wheel ended 0.12 of n off.)
_AGAIN = (40, 120, 360)
_SETTLED = 16  # segments before which nothing is determined: the law may be far from where it was linearised
_AT_ONCE = 40  # segments that are taken again in one go, in some 14 ms
_SLICE = 8  # of more, so many with each that comes


@dataclass
class _Anew:
    """The bank once more, about other points, and how many segments it has taken."""

    members: list[Member]
    abouts: list[Array]
    done: int = 0


class LocalLaw(NamedTuple):
    """The law under one wheel, with what ruts and the side of the vehicle make of it; and its load cell.

    law: ln of the pressure at the soil's reference, n and m, shape (3,). log_scale: of the load cell;
    zero: N, what it shows too much. covariance: of the law, and of ln of the load by scale and, per N^-1,
    by zero, shape (5, 5).
    """

    law: Array
    log_scale: float
    zero: float
    covariance: Array

    def net(self, shown: float) -> float:
        """A load that is shown (N) without the cell's zero."""
        return max(shown - self.zero, LEAST_SHARE * shown)

    def load(self, shown: Quantity) -> Quantity:
        """The load itself (N) under one that is shown; its deviation, that of noise, stays as a share."""
        corrected = self.net(shown.value) * math.exp(-self.log_scale)
        return Quantity(corrected, corrected * shown.standard_deviation / shown.value)

    def with_load(self, shown: float) -> Array:
        """Covariance of ln load, but for its noise, with the law and with itself, shape (4,)."""
        by_zero = 1.0 / self.net(shown)
        column = self.covariance[:, 3] + by_zero * self.covariance[:, 4]
        return np.append(column[:3], column[3] + by_zero * column[4])


class LawFilter:
    """The bank for one vehicle on one soil.

    wheels: how many have a place. settled: whether the law has been linearised where it is. mean,
    covariance: of the soil's numbers (`LawModel.soil`). law: of ln pressure at the soil's reference, n and m.
    """

    def __init__(self, model: LawModel, prior: SoilPrior, settings: EstimatorSettings) -> None:
        self.model = model
        self.scatter = Scatter(settings.soil_scatter)
        self.wheels = 0
        self._bank: list[Member] = []
        slow = max(settings.process_noise, 1e-6)
        for drift, share in ((slow, 1.0 - _QUICK_SHARE), (_FAST * slow, _QUICK_SHARE)):
            for wide in (False, True):
                fade = 2.0 * (prior.log_reference_pressure_std / drift) ** 2
                if settings.process_noise == 0.0:
                    fade = math.inf
                odds = math.log(share * (_WIDE_SHARE if wide else 1.0 - _WIDE_SHARE))
                self._bank.append(Member(model, fade, wide, _TIGHT, odds))
        self.used = 0
        self.settled = False
        self._anew: _Anew | None = None
        self._border = Border()
        self._remember()
        self._mix()

    # -- state

    def add_wheel(self) -> int:
        """Give a wheel a place in the state."""
        self._anew = None
        for i, member in enumerate(self._bank):
            member.add_wheel()
            self._start[i] = member.with_wheel(self._start[i])
        self.model.mean = np.append(self.model.mean, np.zeros(EACH))
        self.wheels += 1
        self._mix()
        return self.wheels - 1

    @property
    def prior_deviations(self) -> Array:
        """Standard deviations of the soil's numbers and the nuisances before any measurement."""
        common = np.sqrt(np.diag(self.model.soil_covariance))
        return np.append(common, np.tile(self.model.wheel_deviations, self.wheels))

    @property
    def most_likely(self) -> ExtendedKalmanFilter:
        """The filter of the greatest weight."""
        return self._bank[self._best].kalman

    # -- filter

    def absorb(self, segment: Segment) -> None:
        """Use a segment for the soil.

        Raises one of `NO_SINKAGE`, with nothing changed, where the law cannot be computed.
        """
        states, weights = self._states(), [member.log_weight for member in self._bank]
        scatter, stored = copy(self.scatter), len(self._store)
        try:
            self._use(segment)
        except NO_SINKAGE:
            for member, state, weight in zip(self._bank, states, weights, strict=True):
                member.begin(state)
                member.log_weight = weight
            self.scatter, self._anew = scatter, None
            del self._store[stored:]
            self._mix()
            raise
        self.used += 1

    def _use(self, segment: Segment) -> None:
        found = []
        for member in self._bank:
            member.travel(segment.distance, self._border)
            found.append(member.update(segment, self.scatter))
        mean = np.average(np.array(found), axis=0, weights=self._weights).tolist()
        self.scatter.learn(Innovation(*mean), segment.wheel)
        self._level(self._bank)
        if len(self._store) < _AGAIN[-1] or self._anew is not None:
            self._store.append(segment)
            if len(self._store) in _AGAIN:
                self._again()
        self._go_on(_SLICE)
        self.settled = self.settled or len(self._store) >= _SETTLED
        self._mix()

    def linearised(self, segment: Segment) -> tuple[Array, Shown]:
        """The most likely filter's x, and what a segment should show there."""
        x = self.model.mean + self.most_likely.x
        return x, self.model.h(x, segment)

    def innovation(self, segment: Segment, about: tuple[Array, Shown]) -> Innovation:
        """What a segment would say to the most likely filter. about: as linearised lately."""
        kalman, (x, shown) = self.most_likely, about
        expected = shown.value + float(shown.row @ (self.model.mean + kalman.x - x))
        state = shown.variance(kalman.P)
        alone, _, base = self.scatter.noise(segment, shown)
        miss = segment.sinkage - expected
        return Innovation(miss, state, state + alone, base, shown.by_load)

    def shown(self, now: Segment) -> tuple[float, float, float]:
        """What a sensor should show (m), its variance but for its own noise, and slope by ln load."""
        _, shown = self.linearised(now)
        variance = shown.variance(self.most_likely.P) + self.scatter.at_a_place(now, shown)
        return shown.value, variance, shown.by_load

    def sinkage(self, now: Segment, missed: float) -> tuple[float, float]:
        """The sinkage of a wheel (m) and its variance: of the law, the place and the load.

        missed: variance of ln k that an effect takes which the model lacks. Raises one of
        `NO_SINKAGE` where the model has none.
        """
        shown = self.model.sinkage(self.mean, now)
        if not shown.value > _LEAST_SINKAGE:
            raise ArithmeticError(f"it is {shown.value:g} m")
        spread = shown.variance(self.covariance) + shown.by_load**2 * missed
        return shown.value, spread + self.scatter.at_a_place(now, shown)

    def local(self, position: Position) -> LocalLaw:
        """The law under one wheel, the same until the law changes."""
        found = self._local.get(position)
        if found is None:
            found = self._local[position] = self._locally(position)
        return found

    def _locally(self, position: Position) -> LocalLaw:
        x, model, index = self.mean, self.model, position.index
        reference = model.reference[0]
        scale, passes = float(x[LOAD_SCALE]), position.passes
        law, jacobian = model.law(x)
        rows = np.zeros((5, len(x)))
        rows[:LAW] = jacobian
        # A wheel that sinks deeper by a factor under the same load is on so much softer soil.
        rows[0, SIDE] += position.side
        rows[0, PASS] -= (x[N] + 0.5) * passes
        rows[0, N] -= x[PASS] * passes
        rows[LAW, LOAD_SCALE], rows[LAW + 1, LOAD_ZERO] = -1.0, -reference
        if index is not None:
            own = WHEELS + EACH * index + 1
            rows[LAW, own] = -1.0
            scale += float(x[own])
        softer = position.side * x[SIDE] - (x[N] + 0.5) * x[PASS] * passes
        zero = float(x[LOAD_ZERO]) * reference
        covariance = rows @ self.covariance @ rows.T
        return LocalLaw(law + np.array([softer, 0.0, 0.0]), scale, zero, covariance)

    def weigh(self, loads: Sequence[tuple[int | None, float]], weight: Quantity) -> None:
        """Use what all loads together should be: the vehicle's weight (N).

        loads: place of each wheel in the state, and its mean load (N). Where both are over 10 % apart one of
        them is wrong: the scale of the loads is then as unsure as that.
        """
        for i, member in enumerate(self._bank):
            self._start[i] = member.weighed(self._start[i], loads, weight)
            if len(self._store) < self.used:
                member.begin(member.weighed(member.state, loads, weight))
        if len(self._store) == self.used:
            self._again()
        self._mix()

    def _again(self) -> None:
        """Begin to take all segments of this soil again, linearised about the newest estimate.

        That would take a tenth of a second for hundreds of them: many are taken a few at a time, beside those
        that come, and count once they have caught up.
        """
        members = [copy(member) for member in self._bank]
        abouts = [self.model.mean + member.kalman.x for member in self._bank]
        for member, start in zip(members, self._start, strict=True):
            member.kalman = copy(member.kalman)
            member.begin(start)
            member.log_weight = member.log_prior
        self._anew = _Anew(members, abouts)
        if len(self._store) <= _AT_ONCE:
            self._go_on(len(self._store))

    def _go_on(self, count: int) -> None:
        """Take so many more segments again."""
        anew = self._anew
        if anew is None:
            return
        for segment in self._store[anew.done : anew.done + count]:
            for member, about in zip(anew.members, anew.abouts, strict=True):
                member.travel(segment.distance, self._border)
                member.update(segment, self.scatter, about)
        anew.done += count
        if anew.done >= len(self._store):
            self._bank, self._anew = anew.members, None
            self._level(self._bank)
            del self._store[_AGAIN[-1] :]

    def _level(self, bank: Sequence[Member]) -> None:
        """Weights relative to the best, none lost for ever."""
        best = max(member.log_weight for member in bank)
        for member in bank:
            faded = (1.0 - _FORGET) * (member.log_weight - best) + _FORGET * member.log_prior
            member.log_weight = max(faded, _LOWEST)

    def _remember(self) -> None:
        """From here on segments are of this soil: what the bank is before them."""
        self._start = self._states()
        self._store: list[Segment] = []
        self._anew = None

    def _states(self) -> list[State]:
        """What each filter is at now."""
        return [member.state for member in self._bank]

    def _mix(self) -> None:
        """Mean and covariance of the soil's numbers (`LawModel.soil`)."""
        self._local: dict[Position, LocalLaw] = {}
        weights = np.exp([member.log_weight for member in self._bank])
        self._weights, self._best = weights / weights.sum(), int(np.argmax(weights))
        model = self.model
        soils = [model.soil(model.mean + member.kalman.x) for member in self._bank]
        self.mean: Array = np.sum(
            [w * y for w, (y, _) in zip(self._weights, soils, strict=True)], axis=0
        )
        self.covariance: Array = np.zeros((len(self.mean), len(self.mean)))
        for i, member in enumerate(self._bank):
            if member.wide:
                y, jacobian = soils[i]
                off = y - self.mean
                share = self._weights[i] + self._weights[i - 1]  # with its tight twin
                self.covariance += share * (
                    jacobian @ member.kalman.P @ jacobian.T + np.outer(off, off)
                )
        law, jacobian = model.law(self.mean)
        self.law = law, jacobian @ self.covariance @ jacobian.T

    # -- another soil

    def reopen(self, law: tuple[Array, Array] | None, shift: float, distance: float) -> None:
        """Another soil from here on: the law is the prior's again, the nuisances stay.

        law: mean (3,) and covariance (3, 3) of (ln z_ref, n, m) of a soil that is remembered. shift:
        of ln k, as found; the soil may go on changing by as much. distance: travelled (m).
        """
        self._border = Border(shift / (self.mean[N] + 0.5), distance + UNSETTLED)
        for member in self._bank:
            member.kalman.x, member.kalman.P = member.with_law(law)
            member.log_prior = member.log_weight
        self.used, self.settled = 0, law is not None
        self._remember()
        self._mix()

    def log_likelihood(self, law: tuple[Array, Array] | None, segments: Sequence[Segment]) -> float:
        """How likely segments are of a law as in `reopen`, linearised about it."""
        kalman = ExtendedKalmanFilter(len(self.mean), 1)
        kalman.x, kalman.P = self._bank[self._best].with_law(law)
        total = 0.0
        for segment in segments:
            x = self.model.mean + kalman.x
            shown = self.model.h(x, segment)
            state = shown.variance(kalman.P)
            alone, counts, _ = self.scatter.noise(segment, shown)
            # In ln of sinkage: under a wide prior the sinkage itself is far from normal.
            value = max(shown.value, 1e-4)
            miss = math.log(max(segment.sinkage, 1e-4) / value)
            variance = (state + alone) / value**2
            total -= 0.5 * TEMPER * (miss * miss / variance + math.log(variance))
            row, off = shown.row / value, np.array([miss])
            R = np.array([[counts / value**2]])
            kalman.update(off, lambda _, h=row: h[None, :], lambda _: np.zeros(1), R=R)
        return total

    def resume(self, mean: Array, covariance: Array, used: int) -> None:
        """Go on from the soil's numbers as saved (`LawModel.soil`; without those of wheels)."""
        model = self.model
        x = model.shown(mean)
        back = np.linalg.inv(model.soil(x)[1])
        for member in self._bank:
            member.kalman.x, member.kalman.P = x - model.mean, back @ covariance @ back.T
        self.used, self.settled = used, True
        self._remember()
        self._mix()
