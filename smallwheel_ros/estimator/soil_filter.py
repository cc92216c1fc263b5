# SPDX-License-Identifier: Apache-2.0
"""The soil's law from segments: a bank of iterated Kalman filters over `law_model`'s state x.

State of a filter: x - x0 and P, for the law (u, n', m) and what may be wrong with sensors and ground.
h, H and the noise of a segment are in `law_model`.

    predict   x <- x0 + F (x - x0),  P <- F P F + Q, with the distance ds travelled. F is diagonal:
              a = exp(-ds q^2 / (2 std^2)) for the law, exp(-ds / 100 m) for the sides of the vehicle,
              1 for the other nuisances; Q = (1 - F^2) P0. For a metre behind a border u has the size
              of the change in Q besides: soil goes on changing there.
    update    z = h(x) + v, linearised at the newest x, until u moves by less than 0.01, at most 4
              times (Bell and Cathey 1993). R is that of the segment among its neighbours, larger by
              Huber's weight beyond 2.5 deviations.
    bound     -0.35 <= n' <= 5, where the contact integral can be solved; the soil's n, and the share
              of the shown sinkage that is the wheel's, have bounds in `LawModel.soil`.
    again     At the 40th, 120th and 360th segment of a soil all are taken once more from its start,
              linearised about the newest x: the first ones were linearised at the prior.

Two filters: the deviations of passes and zeros as told ("wide"), or a tenth of them ("tight"): most
sensors have hardly a zero, and a filter that allows for one learns less of n. A filter's weight is the
product of its segments' likelihoods, with R of each segment alone, squares cut at 9, to the power of 1/2:
neighbours are alike, so that half of them count. A filter never falls under exp(-15) of the best, and 0.002
of its first weight comes back with each segment, so that a zero that begins is believed again.

The mean is that of both; the covariance is always the wide one's about that mean: a nuisance that the
data does not show is still allowed for. What learns from innovations (`Scatter`, the watch for sensors)
is given their means over the two, or those of the likelier one.

A second pair, for soil that drifts six times as fast, was taken out. Over 280 drives of the 70 worlds of
docs/estimator_rates.md it changed nothing but the drives on such soil, where bands hold without it (0.98).
Over patches of two soils they hold in 0.965 in place of 0.980, on random ground in 0.900 in place of 0.875 (8
drives each). With the wide ones of both pairs alone n is off by twice as much (0.110 for 0.055), and bands
hold in 0.952 in place of 0.975.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy, deepcopy
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.estimator.law_model import (
    EACH,
    LARGEST,
    LAW,
    LEAST_SHARE,
    LOAD_SCALE,
    LOAD_ZERO,
    PASS,
    SIDE,
    SIDE_STD,
    WHEELS,
    Innovation,
    LawModel,
    N,
    Scatter,
    Shown,
    U,
)
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior
from smallwheel_ros.estimator.stretches import Position, Segment
from smallwheel_ros.estimator.wheel_sinkage import NO_SINKAGE
from smallwheel_ros.physics.wheel import Quantity

Array = NDArray[np.float64]
Law = tuple[Array, Array]  # mean (3,) and covariance (3, 3) of (ln z_ref, n, m)

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
_TEMPER = 0.5  # power of the likelihood
_SIDE_FADE = 100.0  # m, over which the sides come to differ by something else
_HUBER = 2.5  # deviations from which on a segment counts less and less
_ITERATIONS = 4
_CLOSE = 0.01  # of u: what is left of the curvature is 1e-4 of the sinkage
# Of ln: neither load cells nor a weighed mass are 10 % off.
CONTRADICTION = math.log(1.1)
_UNSETTLED = 1.0  # m behind a border on which the soil may go on changing as it has begun to


@dataclass(frozen=True)
class Border:
    """Behind a change of soil: the soil may go on changing by `size` (of u) until there (m)."""

    size: float = 0.0
    until: float = -math.inf


class Member:
    """One filter of the bank. Its arrays are never changed in place: a copy of it keeps its state.

    x: what is shown, shape (size,); P: its covariance. travelled: to where it has predicted, m. fade: m over
    which the law fades to its prior. wide: the deviations of passes and zeros are as told; else a tenth of
    them. log_prior, log_weight: of it in the bank.
    """

    def __init__(self, model: LawModel, fade: float, wide: bool, log_prior: float) -> None:
        self.model, self.fade = model, fade
        self._scale = 1.0 if wide else _TIGHT
        self.log_prior = self.log_weight = log_prior
        self.x: Array = model.mean.copy()
        self.P: Array = model.prior(self._scale)
        self.travelled = math.nan

    def add_wheel(self) -> None:
        """Give a wheel a place in the state."""
        size = len(self.x)
        whole = np.zeros((size + EACH, size + EACH))
        whole[:size, :size] = self.P
        whole[size:, size:] = np.diag(np.square(self.model.wheel_deviations * [self._scale, 1.0]))
        self.x, self.P = np.append(self.x, np.zeros(EACH)), whole

    def travel(self, distance: float, border: Border) -> None:
        """Predict to a distance (m)."""
        if distance > self.travelled:
            model, way = self.model, distance - self.travelled
            keep, side = math.exp(-way / self.fade), math.exp(-way / _SIDE_FADE)
            factors = np.ones(len(self.x))
            factors[:LAW], factors[SIDE] = keep, side
            self.x = model.mean + factors * (self.x - model.mean)
            self.P = factors[:, None] * self.P * factors
            self.P[:LAW, :LAW] += (1.0 - keep * keep) * model.soil_covariance[:LAW, :LAW]
            self.P[SIDE, SIDE] += (1.0 - side**2) * SIDE_STD**2
            unsettled = min(distance, border.until) - self.travelled
            if unsettled > 0.0:
                self.P[U, U] += border.size**2 * unsettled / _UNSETTLED
        if not distance < self.travelled:
            self.travelled = distance

    def update(self, segment: Segment, scatter: Scatter, about: Array | None = None) -> Innovation:
        """Use a segment; return its innovation.

        about: where to linearise instead of at the newest x.
        """
        model, mean = self.model, self.x
        x = mean if about is None else about
        for step in range(_ITERATIONS if about is None else 1):
            shown = model.h(x, segment)
            miss = segment.sinkage - shown.value - float(shown.row @ (mean - x))
            state = shown.variance(self.P)
            if step == 0:
                alone, counts, base = scatter.noise(segment, shown)
                first = Innovation(miss, state, state + alone, base, shown.by_load)
                square = miss * miss / first.variance
                counts *= _huber(square)
                likely = min(square, LARGEST) + math.log(first.variance)
                self.log_weight -= 0.5 * _TEMPER * likely
            new = model.bounded(mean + self.P @ shown.row * (miss / (state + counts)))
            settled = abs(new[U] - x[U]) < _CLOSE
            x = new
            if settled:
                break
        self.x, self.P = _updated(mean, self.P, shown.row, miss, counts)
        self.x = model.bounded(self.x)
        return first

    def weigh(self, loads: Sequence[tuple[int | None, float]], weight: Quantity) -> None:
        """Use the sum of all loads (see `LawFilter.weigh`)."""
        x, row, total = self.x, np.zeros(len(self.x)), 0.0
        reference = self.model.reference[0]
        for index, load in loads:
            net = max(load - x[LOAD_ZERO] * reference, LEAST_SHARE * load)
            own = None if index is None else WHEELS + EACH * index + 1
            net *= math.exp(-x[LOAD_SCALE] - (0.0 if own is None else x[own]))
            total += net
            row[LOAD_SCALE] -= net
            row[LOAD_ZERO] -= reference * net / load
            if own is not None:
                row[own] -= net
        row /= total
        off = math.log(weight.value / total)
        wider = self.P.copy()
        if abs(off) > CONTRADICTION:
            wider[LOAD_SCALE, LOAD_SCALE] += off * off
        noise = (weight.standard_deviation / weight.value) ** 2
        gain = wider @ row / (float(row @ wider @ row) + noise)
        self.x, self.P = x + gain * off, wider - np.outer(gain, row @ wider)

    def with_law(self, law: Law | None) -> tuple[Array, Array]:
        """Its x and P with another law, None: the prior's; the nuisances stay."""
        model = self.model
        y, jacobian = model.soil(self.x)
        whole = jacobian @ self.P @ jacobian.T
        whole[:LAW, :] = whole[:, :LAW] = 0.0
        whole[:LAW, :LAW] = model.soil_covariance[:LAW, :LAW] if law is None else law[1]
        y[:LAW] = model.mean[:LAW] if law is None else law[0]
        x = model.shown(y)
        back = np.linalg.inv(model.soil(x)[1])
        return x, back @ whole @ back.T


def _updated(x: Array, P: Array, row: Array, miss: float, noise: float) -> tuple[Array, Array]:
    """State and covariance after a measurement (Joseph's form); row: of H, noise: R."""
    gain = P @ row / (float(row @ P @ row) + noise)
    left = np.eye(len(x)) - np.outer(gain, row)
    after = left @ P @ left.T + noise * np.outer(gain, gain)
    return x + gain * miss, 0.5 * (after + after.T)


def _huber(square: float) -> float:
    """Factor on R for a squared normalised innovation: less and less weight beyond `_HUBER`."""
    size = max(1.0, math.sqrt(square) / _HUBER)
    return size if size < 2.0 else 0.5 * size * size


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

    @classmethod
    def of(cls, law: Law) -> LocalLaw:
        """A law alone, under a wheel whose load cell is right."""
        return cls(law[0], 0.0, 0.0, np.pad(law[1], (0, 2)))

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
        drift, fade = settings.process_noise, math.inf
        if drift > 0.0:
            fade = 2.0 * (prior.log_reference_pressure_std / drift) ** 2
        for wide, share in ((False, 1.0 - _WIDE_SHARE), (True, _WIDE_SHARE)):
            self._bank.append(Member(model, fade, wide, math.log(share)))
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
        for member in (*self._bank, *self._start):
            member.add_wheel()
        self.model.mean = np.append(self.model.mean, np.zeros(EACH))
        self.wheels += 1
        self._mix()
        return self.wheels - 1

    def twin(self) -> LawFilter:
        """The same filter, to go on by itself; segments never change, and are not copied."""
        return deepcopy(self, {id(self._store): list(self._store)})

    @property
    def prior_deviations(self) -> Array:
        """Standard deviations of the soil's numbers and the nuisances before any measurement."""
        common = np.sqrt(np.diag(self.model.soil_covariance))
        return np.append(common, np.tile(self.model.wheel_deviations, self.wheels))

    @property
    def most_likely(self) -> Member:
        """The filter of the greatest weight."""
        return self._bank[self._best]

    # -- filter

    def absorb(self, segment: Segment) -> None:
        """Use a segment for the soil.

        Raises one of `NO_SINKAGE`, with nothing changed, where the law cannot be computed.
        """
        before, scatter, stored = self._copies(), copy(self.scatter), len(self._store)
        try:
            self._use(segment)
        except NO_SINKAGE:
            self._bank, self.scatter, self._anew = before, scatter, None
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
        x = self.most_likely.x
        return x, self.model.h(x, segment)

    def innovation(self, segment: Segment, about: tuple[Array, Shown]) -> Innovation:
        """What a segment would say to the most likely filter. about: as linearised lately."""
        member, (x, shown) = self.most_likely, about
        expected = shown.value + float(shown.row @ (member.x - x))
        state = shown.variance(member.P)
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
        for member in self._start:
            member.weigh(loads, weight)
        if len(self._store) == self.used:
            self._again()
        else:
            for member in self._bank:
                member.weigh(loads, weight)
        self._mix()

    def _again(self) -> None:
        """Begin to take all segments of this soil again, linearised about the newest estimate.

        That would take a tenth of a second for hundreds of them: many are taken a few at a time, beside those
        that come, and count once they have caught up.
        """
        self._anew = _Anew([copy(start) for start in self._start], [m.x for m in self._bank])
        for member in self._anew.members:
            member.log_weight = member.log_prior
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
        self._start = self._copies()
        self._store: list[Segment] = []
        self._anew = None

    def _copies(self) -> list[Member]:
        """The filters as they are now."""
        return [copy(member) for member in self._bank]

    def _mix(self) -> None:
        """Mean and covariance of the soil's numbers (`LawModel.soil`)."""
        self._local: dict[Position, LocalLaw] = {}
        weights = np.exp([member.log_weight for member in self._bank])
        self._weights, self._best = weights / weights.sum(), int(np.argmax(weights))
        model = self.model
        soils = [model.soil(member.x) for member in self._bank]
        self.mean: Array = np.sum(
            [w * y for w, (y, _) in zip(self._weights, soils, strict=True)], axis=0
        )
        wide, (y, jacobian) = self._bank[-1], soils[-1]
        off = y - self.mean
        self.covariance: Array = jacobian @ wide.P @ jacobian.T + np.outer(off, off)
        law, jacobian = model.law(self.mean)
        self.law = law, jacobian @ self.covariance @ jacobian.T

    # -- another soil

    def reopen(self, law: Law | None, shift: float, distance: float) -> None:
        """Another soil from here on: the law is the prior's again, the nuisances stay.

        law: of a soil that is remembered. shift: of ln k, as found; the soil may go on changing by as much.
        distance: travelled (m).
        """
        self._border = Border(shift / (self.mean[N] + 0.5), distance + _UNSETTLED)
        for member in self._bank:
            member.x, member.P = member.with_law(law)
            member.log_prior = member.log_weight
        self.used, self.settled = 0, law is not None
        self._remember()
        self._mix()

    def log_likelihood(self, law: Law | None, segments: Sequence[Segment]) -> float:
        """How likely segments are of a law as in `reopen`, linearised about it."""
        x, P = self.most_likely.with_law(law)
        total = 0.0
        for segment in segments:
            shown = self.model.h(x, segment)
            alone, counts, _ = self.scatter.noise(segment, shown)
            # In ln of sinkage: under a wide prior the sinkage itself is far from normal.
            value = max(shown.value, 1e-4)
            miss = math.log(max(segment.sinkage, 1e-4) / value)
            variance = (shown.variance(P) + alone) / value**2
            total -= 0.5 * _TEMPER * (miss * miss / variance + math.log(variance))
            x, P = _updated(x, P, shown.row / value, miss, counts / value**2)
        return total

    def resume(self, mean: Array, covariance: Array, used: int) -> None:
        """Go on from the soil's numbers as saved (`LawModel.soil`; without those of wheels)."""
        model = self.model
        x = model.shown(mean)
        back = np.linalg.inv(model.soil(x)[1])
        for member in self._bank:
            member.x, member.P = x, back @ covariance @ back.T
        self.used, self.settled = used, True
        self._remember()
        self._mix()
