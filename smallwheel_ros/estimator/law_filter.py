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

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray

from smallwheel_ros.estimator.law_model import LAW, ZEROS, LawModel, N, Shown, U
from smallwheel_ros.estimator.scatter import LARGEST, Innovation, Scatter
from smallwheel_ros.estimator.segment import Segment
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior

Array = NDArray[np.float64]
_State = tuple[Array, Array, float]  # x - x0, P, and to where it has travelled (m)

MODEL_ERROR = 0.02  # of sinkage: the law against the public single-wheel rig, within one soil
_FAST = 6.0  # drift of the quick filters over that of the slow: soils that change within metres
_QUICK_SHARE = 0.2  # what is believed of it before any data
_WIDE_SHARE = 0.3  # that a nuisance is there at all
_TIGHT = 0.1
_TEMPER = 0.5  # power of the likelihood
_FORGET = 0.002  # share of the first weights that comes back at each segment
_LOWEST = -15.0  # ln of a weight: a filter can come back
_HUBER = 2.5  # deviations from which on a segment counts less and less
_ITERATIONS = 4
_SETTLED = 0.01  # of u: what is left of the curvature is 1e-4 of the sinkage
UNSETTLED = 1.0  # m behind a border on which the soil may go on changing as it has begun to
_AGAIN = (40, 120, 360)  # segments after which all are taken again about the newest estimate


@dataclass
class _Member:
    """One filter of the bank: state x - x0 in `kalman`."""

    kalman: ExtendedKalmanFilter
    fade: float  # m over which the law fades to its prior
    wide: bool
    log_prior: float
    log_weight: float
    travelled: float = math.nan

    def begin(self, state: _State) -> None:
        """Go back to a state."""
        x, covariance, self.travelled = state
        self.kalman.x, self.kalman.P = x.copy(), covariance.copy()


@dataclass(frozen=True)
class WheelPlace:
    """A wheel in the state: its index among the zeros, and log2(1 + wheels ahead in its rut)."""

    index: int
    passes: float


class LawFilter:
    """The bank for one vehicle on one soil."""

    def __init__(self, model: LawModel, prior: SoilPrior, settings: EstimatorSettings) -> None:
        self.model = model
        self.scatter = Scatter(settings.soil_scatter)
        self._wheels = 0
        self._bank: list[_Member] = []
        slow = max(settings.process_noise, 1e-6)
        for drift, share in ((slow, 1.0 - _QUICK_SHARE), (_FAST * slow, _QUICK_SHARE)):
            for wide in (False, True):
                kalman = ExtendedKalmanFilter(ZEROS, 1)
                kalman.x = np.zeros(ZEROS)
                kalman.P = model.prior(1.0 if wide else _TIGHT)
                fade = 2.0 * (prior.log_reference_pressure_std / drift) ** 2
                if settings.process_noise == 0.0:
                    fade = math.inf
                odds = math.log(share * (_WIDE_SHARE if wide else 1.0 - _WIDE_SHARE))
                self._bank.append(_Member(kalman, fade, wide, odds, odds))
        self._law_prior = model.soil_covariance[:LAW, :LAW]
        self.used = 0
        self.version = 0  # rises with every change of the state
        self._law_of = -1  # version that the law was worked out for
        self._unsettled, self._settled_at = 0.0, -math.inf
        self._remember()
        self._mix()

    # -- state

    def add_wheel(self) -> int:
        """Give a wheel's zero a place in the state."""
        for i, member in enumerate(self._bank):
            factor = 1.0 if member.wide else _TIGHT
            variance = (factor * self.model.each_zero_std) ** 2
            kalman = member.kalman
            member.kalman = ExtendedKalmanFilter(len(kalman.x) + 1, 1)
            member.kalman.x = np.append(kalman.x, 0.0)
            member.kalman.P = _bordered(kalman.P, variance)
            x, covariance, travelled = self._start[i]
            self._start[i] = np.append(x, 0.0), _bordered(covariance, variance), travelled
        self.model.mean = np.append(self.model.mean, 0.0)
        self._wheels += 1
        self._mix()
        return self._wheels - 1

    @property
    def prior_deviations(self) -> Array:
        """Standard deviations of the soil's numbers and the nuisances before any measurement."""
        common = np.sqrt(np.diag(self.model.soil_covariance))
        return np.append(common, [self.model.each_zero_std] * self._wheels)

    @property
    def most_likely(self) -> ExtendedKalmanFilter:
        """The filter of the greatest weight."""
        return self._bank[self._best].kalman

    @property
    def wheels(self) -> int:
        """How many wheels have a place."""
        return self._wheels

    def law(self) -> tuple[Array, Array]:
        """Ln pressure, n, m and their covariance, (3,) and (3, 3)."""
        if self._law_of != self.version:
            law, jacobian = self.model.law(self.mean)
            self._law, self._law_of = (law, jacobian @ self.covariance @ jacobian.T), self.version
        return self._law

    # -- filter

    def absorb(self, segment: Segment, wheel: WheelPlace) -> None:
        """Use a segment for the soil.

        Raises ArithmeticError, ValueError or LinAlgError, with nothing changed, where the law cannot
        be computed.
        """
        states, weights = self._states(), [member.log_weight for member in self._bank]
        scatter, stored = copy(self.scatter), len(self._store)
        try:
            self._use(segment, wheel)
        except (ArithmeticError, ValueError, np.linalg.LinAlgError):
            for member, state, weight in zip(self._bank, states, weights, strict=True):
                member.begin(state)
                member.log_weight = weight
            self.scatter = scatter
            del self._store[stored:]
            self._mix()
            raise
        self.used += 1

    def _use(self, segment: Segment, wheel: WheelPlace) -> None:
        found: list[tuple[float, ...]] = []
        for member in self._bank:
            self._travel(member, segment.distance)
            of, base = self._update(member, segment, wheel)
            found.append((of.value, of.state_variance, of.variance, of.by_load, base))
        *innovation, base = np.average(np.array(found), axis=0, weights=self._weights).tolist()
        self.scatter.learn(Innovation(*innovation), base, wheel.index)
        self._level()
        if len(self._store) < _AGAIN[-1]:
            self._store.append((segment, wheel))
            if len(self._store) in _AGAIN:
                self._again()
        self._mix()

    def linearised(self, segment: Segment, wheel: WheelPlace) -> tuple[Array, Shown]:
        """The most likely filter's x, and what a segment should show there."""
        x = self.model.mean + self.most_likely.x
        return x, self.model.h(x, segment, wheel.passes, wheel.index)

    def innovation(self, segment: Segment, about: tuple[Array, Shown]) -> Innovation:
        """What a segment would say to the most likely filter. about: as linearised lately."""
        kalman, (x, shown) = self.most_likely, about
        expected = shown.value + float(shown.row @ (self.model.mean + kalman.x - x))
        state = float(shown.row @ kalman.P @ shown.row)
        single = self._noise(segment, shown.by_load, shown.value)[0]
        return Innovation(segment.sinkage - expected, state, state + single, shown.by_load)

    def _noise(self, segment: Segment, by_load: float, value: float) -> tuple[float, float, float]:
        """Variance of a segment alone, of it as it counts among its neighbours, and its base."""
        scatter = self.scatter
        base = (
            segment.sinkage_variance
            + by_load**2 * segment.load_variance
            + (MODEL_ERROR * value) ** 2
        )
        soil = by_load**2 * scatter.soil
        alone = base + scatter.share * soil + scatter.additive
        counts = base + scatter.together * soil + scatter.additive_together * scatter.additive
        return alone, counts, base

    def _travel(self, member: _Member, distance: float) -> None:
        kalman = member.kalman
        if distance > member.travelled:
            keep = math.exp(-(distance - member.travelled) / member.fade)
            factors = np.ones(len(kalman.x))
            factors[:LAW] = keep
            kalman.F = np.diag(factors)
            kalman.Q = np.zeros_like(kalman.P)
            kalman.Q[:LAW, :LAW] = (1.0 - keep * keep) * self._law_prior
            unsettled = min(distance, self._settled_at) - member.travelled
            if unsettled > 0.0:
                kalman.Q[U, U] += self._unsettled**2 * unsettled / UNSETTLED
            kalman.predict()
        if not distance < member.travelled:
            member.travelled = distance

    def _update(
        self, member: _Member, segment: Segment, wheel: WheelPlace, about: Array | None = None
    ) -> tuple[Innovation, float]:
        """One filter's step. about: where to linearise instead of at the newest x."""
        kalman, model = member.kalman, self.model
        mean = model.mean + kalman.x
        x = mean if about is None else about
        for step in range(_ITERATIONS if about is None else 1):
            shown = model.h(x, segment, wheel.passes, wheel.index)
            miss = segment.sinkage - shown.value - float(shown.row @ (mean - x))
            state = float(shown.row @ kalman.P @ shown.row)
            if step == 0:
                alone, counts, base = self._noise(segment, shown.by_load, shown.value)
                first = Innovation(miss, state, state + alone, shown.by_load)
                counts *= _huber(miss * miss / first.variance)
                member.log_weight -= (
                    0.5
                    * _TEMPER
                    * (min(miss * miss / first.variance, LARGEST) + math.log(first.variance))
                )
            new = model.bounded(mean + kalman.P @ shown.row * (miss / (state + counts)))
            settled = abs(new[U] - x[U]) < _SETTLED
            x = new
            if settled:
                break
        row = shown.row[None, :]
        kalman.update(
            np.array([miss]), lambda _: row, lambda _: np.zeros(1), R=np.array([[counts]])
        )
        kalman.x = model.bounded(model.mean + kalman.x) - model.mean
        kalman.P = 0.5 * (kalman.P + kalman.P.T)
        return first, base

    def _again(self) -> None:
        """Take all segments of this soil again, linearised about the newest estimate."""
        for member, start in zip(self._bank, self._start, strict=True):
            about = self.model.mean + member.kalman.x
            member.begin(start)
            member.log_weight = member.log_prior
            for segment, wheel in self._store:
                self._travel(member, segment.distance)
                self._update(member, segment, wheel, about)
        self._level()

    def _level(self) -> None:
        """Weights relative to the best, none lost for ever."""
        best = max(member.log_weight for member in self._bank)
        for member in self._bank:
            faded = (1.0 - _FORGET) * (member.log_weight - best) + _FORGET * member.log_prior
            member.log_weight = max(faded, _LOWEST)

    def _remember(self) -> None:
        """From here on segments are of this soil: what the bank is before them."""
        self._start = self._states()
        self._store: list[tuple[Segment, WheelPlace]] = []

    def _states(self) -> list[_State]:
        """What each filter is at now."""
        return [(m.kalman.x.copy(), m.kalman.P.copy(), m.travelled) for m in self._bank]

    def _mix(self) -> None:
        """Mean and covariance of the soil's numbers (`LawModel.soil`)."""
        self.version += 1
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

    # -- another soil

    def reopen(self, law: tuple[Array, Array] | None, shift: float, distance: float) -> None:
        """Another soil from here on: the law is the prior's again, the nuisances stay.

        law: mean (3,) and covariance (3, 3) of (ln z_ref, n, m) of a soil that is remembered. shift:
        of ln k, as found; the soil may go on changing by as much. distance: travelled (m).
        """
        self._unsettled = shift / (self.mean[N] + 0.5)
        self._settled_at = distance + UNSETTLED
        for member in self._bank:
            member.kalman.x, member.kalman.P = self._with_law(member, law)
            member.log_prior = member.log_weight
        self.used = 0
        self._remember()
        self._mix()

    def log_likelihood(
        self, law: tuple[Array, Array] | None, segments: Sequence[tuple[Segment, WheelPlace]]
    ) -> float:
        """How likely segments are of a law as in `reopen`, linearised about it."""
        kalman = ExtendedKalmanFilter(len(self.mean), 1)
        kalman.x, kalman.P = self._with_law(self._bank[self._best], law)
        total = 0.0
        for segment, wheel in segments:
            x = self.model.mean + kalman.x
            shown = self.model.h(x, segment, wheel.passes, wheel.index)
            state = float(shown.row @ kalman.P @ shown.row)
            alone, counts, _ = self._noise(segment, shown.by_load, shown.value)
            # In ln of sinkage: under a wide prior the sinkage itself is far from normal.
            value = max(shown.value, 1e-4)
            miss = math.log(max(segment.sinkage, 1e-4) / value)
            variance = (state + alone) / value**2
            total -= 0.5 * _TEMPER * (miss * miss / variance + math.log(variance))
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
        self.used = used
        self._remember()
        self._mix()

    def _with_law(self, member: _Member, law: tuple[Array, Array] | None) -> tuple[Array, Array]:
        """A filter's x - x0 and P with another law; the nuisances stay."""
        model = self.model
        y, jacobian = model.soil(model.mean + member.kalman.x)
        whole = jacobian @ member.kalman.P @ jacobian.T
        whole[:LAW, :] = 0.0
        whole[:, :LAW] = 0.0
        whole[:LAW, :LAW] = self._law_prior if law is None else law[1]
        y[:LAW] = model.mean[:LAW] if law is None else law[0]
        x = model.shown(y)
        back = np.linalg.inv(model.soil(x)[1])
        return x - model.mean, back @ whole @ back.T


def _huber(square: float) -> float:
    """Factor on R for a squared normalised innovation: less and less weight beyond `_HUBER`."""
    size = max(1.0, math.sqrt(square) / _HUBER)
    return size if size < 2.0 else 0.5 * size * size


def _bordered(covariance: Array, variance: float) -> Array:
    size = len(covariance)
    whole = np.zeros((size + 1, size + 1))
    whole[:size, :size] = covariance
    whole[size, size] = variance
    return whole
