# SPDX-License-Identifier: Apache-2.0
"""The soil's law from stretches: a bank of Kalman filters (filterpy) over the state of `soil/model.py`.

    predict   x <- x0 + F (x - x0),  P <- F P F + Q, with the distance ds travelled. F is diagonal:
              a = exp(-ds q^2/(2 std^2)) for the law, exp(-ds/100 m) for the sides, 1 for the rest;
              Q = (1 - F^2) P0. For a metre after a border Q of u also has the size of the change.
    update    z = h(x) + v of all stretches that are ready together. The first 40 of a soil are linearised at
              the newest x, until u moves by less than 0.01, at most 4 times (Bell and Cathey 1993). R is that
              of a stretch among its neighbours, increased by Huber's weight beyond 2.5 deviations.
    again     At the 40th stretch of a soil, and whenever there are half as many more, to the 456th, all are
              used again from its start, linearised about the newest x. While the law moves by over half a
              deviation this is repeated, up to three times in all; where it still moves, it is not settled.
    zeros     The variance with which single sensors' zeros then begin is what the estimate shows it to be
              (empirical Bayes): m is what wheels of two sizes differ by beyond that.
    between   All stretches are linearised about that same x. If each were linearised about its own, the
              differences between their slopes would seem to measure what no stretch separates (a zero, u
              and n; Huang, Mourikis and Roumeliotis 2008): n was 5.7 deviations off in a drive that keeps
              the law. After the 456th, x is the newest once the law has moved by half a deviation.

    R = sigma^2/count + by^2 var(ln W) + (0.02 z)^2 + (s i z / 2)^2 + (ruts of many passes)
        + by^2 S^2 r w + A c

`by` is d sinkage / d ln load. S is the soil's deviation of ln k from place to place; A is the
variance of shown sinkage that does not scale with `by`. Both are learnt from the innovations
(`SoilScatter`). r and c are 2/e and 1 for a stretch alone, 2 and (1 + a)/(1 - a) for one among neighbours
whose correlation is a; w, for one among neighbours, is the number of wheels that run in its track, since they
meet the same places.

A wrong zero of the sinkage sensors bends u and n together, and far from linearly. There is
therefore a filter for each of 11 zeros, whose deviation about its zero is about the distance to the next one
(a sum of Gaussians; Alspach and Sorenson 1972). Together they make up the prior, with
twice its deviation of ln pressure, since a soil is often not the one that was named. One more
filter, the first, has the named soil's deviation and a tenth of the prior's deviations of passes
and of the common zero. Weights are shares times likelihoods to the power of 0.3, or, where it is less,
of 1 over the factor by which neighbouring errors are alike: an error that the law has no part for persists
over metres and looks like a wrong zero. R is one for all filters, their mean. With R of its own, the
filter that sees the least scatter in the ground would win: under one load, that of a zero of 3 to 5 mm.

The mean is that of all filters, the covariance that of the eleven about this mean: an error of sensors that
the data does not show is still allowed for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy

import numpy as np
from filterpy.kalman import KalmanFilter

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.onboard.prior import EstimatorSettings, SoilPrior
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.tables import Array

from .model import (
    EACH,
    LAW,
    LEAST_SHARE,
    LOAD_SCALE,
    LOAD_ZERO,
    N_RANGE,
    WHEELS,
    ZERO,
    LawModel,
    N,
    U,
)
from .scatter import LARGEST, SoilScatter
from .sensors import CONTRADICTION
from .stretches import Stretches

# Initial zeros of the eleven filters, over the prior's deviation: sinh of equal steps, close together where
# most zeros are; their shares, by the Gaussian density; the variance of each about its zero. Together they
# have the prior's variance.
_REACH, _STEP = 5, 0.35
_AT = _STEP * np.arange(-_REACH, _REACH + 1)
_ZEROS, _OWN = np.sinh(_AT), (0.85 * _STEP * np.cosh(_AT)) ** 2
_SHARES = np.cosh(_AT) * np.exp(-0.5 * _ZEROS**2)
_SHARES /= _SHARES.sum()
_WHOLE = float(_SHARES @ (_ZEROS**2 + _OWN))  # variance of all together, to be 1
_ZEROS, _OWN = _ZEROS / math.sqrt(_WHOLE), _OWN / _WHOLE
_WIDE_SHARE = 0.5  # prior probability that a zero is wrong at all
# Power of the likelihoods that choose a soil; part of a filter's weight that returns to its prior with each
# update; least ln of a weight over the largest.
_TEMPER, _FORGET, _LOWEST = 0.5, 0.002, -15.0
# Largest power of the likelihoods that weigh the filters: these also differ by what the law adapts to, so
# that a zero would be known too well. Chosen from 0.2 to 0.5 by a few drives of another author's simulator,
# which hardly decide it.
_POWER = 0.3
# Numbers of stretches of a soil at which all are used again; before the first the law was linearised only at
# the prior, and nothing is determined (on "soil x0.5, n -0.2" it moved by 2 of its deviations then).
_AGAIN = (40, 60, 90, 135, 203, 304, 456)
_STAYS, _ROUNDS = 0.5, 3  # deviations that a settled law moves by at most; most repetitions
_DRIFT = 0.02  # 1/sqrt(m), of ln pressure: over 100 m a soil may change by a fifth
_SIDE_FADE = 100.0  # m, over which the difference between the two sides is correlated
_HUBER, _ITERATIONS, _CLOSE = 2.5, 4, 0.01
_UNSETTLED = 1.0  # m beyond a border on which the soil may go on changing as it does at the border
Law = tuple[Array, Array]  # mean (3,); covariance (3, 3), or d mean / d state (3, size)


class Member:
    """One filter of the bank.

    Parameters
    ----------
    model
        Model of the state.
    mean, covariance
        Initial mean and covariance of the state x, shape (size,) and (size, size).
    log_share
        ln of the filter's prior probability in the bank.

    Attributes
    ----------
    kalman
        The filter of filterpy, whose state is x - x0, with x0 the model's prior mean.
    log_prior, log_weight
        ln of the prior probability, and of the present weight up to a factor that all filters share.
    """

    def __init__(self, model: LawModel, mean: Array, covariance: Array, log_share: float) -> None:
        self.model = model
        self.kalman = KalmanFilter(dim_x=model.size, dim_z=1)
        self.kalman.x, self.kalman.P = mean - model.mean, covariance
        self.log_prior = self.log_weight = log_share

    def copy(self) -> Member:
        """Return a copy of the present state; it shares arrays, since none is changed in place."""
        own = copy(self)
        own.kalman = copy(self.kalman)
        return own

    @property
    def x(self) -> Array:
        """Mean of the state x of `soil/model.py`, shape (size,)."""
        return np.asarray(self.model.mean + self.kalman.x)

    def allow_own_zeros(self, variance: float) -> None:
        """Begin with this variance (m^2) of each sensor's own zero, of which nothing is known yet."""
        own = self.model.own_zeros
        covariance = self.kalman.P.copy()
        covariance[own, own] = variance
        self.kalman.P = covariance

    def correct(self, x: Array, value: Array, H: Array, z: Array, noise: Array) -> None:
        """Update the filter from stretches, with h linearised at a given state.

        Parameters
        ----------
        x
            State at which h is linearised, shape (size,).
        value
            h(x), shape (stretches,), m.
        H
            Jacobian of h at x, shape (stretches, size).
        z
            Measured sinkages, shape (stretches,), m.
        noise
            Diagonal of their covariance R, shape (stretches,), m^2.
        """
        kalman = self.kalman
        kalman.dim_z = len(z)
        straight = z - value + H @ (x - self.model.mean)
        kalman.update(straight, np.diag(noise), H)
        kalman.P = 0.5 * (kalman.P + kalman.P.T)
        mean = self.model.mean[N]
        kalman.x[N] = min(max(kalman.x[N], N_RANGE[0] - mean), N_RANGE[1] - mean)

    def weigh(self, loads: Array, weight: float, weight_std: float) -> None:
        """Use the vehicle's weight as a measurement of the sum of the loads.

        Where the sum of the loads differs from it by over 10 %, the difference is added to the uncertainty of
        the load cells' scale.

        Parameters
        ----------
        loads
            Loads shown by the cells of all wheels, shape (wheels,), N.
        weight, weight_std
            Weight and its standard deviation, N.
        """
        x, kalman, reference = self.x, self.kalman, self.model.reference[0]
        own = WHEELS + EACH * np.arange(loads.size) + 1
        net = np.maximum(loads - x[LOAD_ZERO] * reference, LEAST_SHARE * loads)
        net = net * np.exp(-x[LOAD_SCALE] - x[own])
        H = np.zeros((1, self.model.size))
        H[0, LOAD_SCALE] = -1.0
        H[0, LOAD_ZERO] = -float((reference * net / loads).sum() / net.sum())
        H[0, own] = -net / net.sum()
        off = math.log(weight / net.sum())
        if abs(off) > CONTRADICTION:
            kalman.P = kalman.P.copy()
            kalman.P[LOAD_SCALE, LOAD_SCALE] += off * off
        kalman.dim_z = 1
        kalman.update(H @ kalman.x + off, np.array([[(weight_std / weight) ** 2]]), H)


class SoilFilter:
    """The bank of filters for one vehicle on one soil.

    Parameters
    ----------
    prior
        Prior of the soil.
    settings
        Settings of the estimate that are about sensors and ground.
    effects
        Effects of the model.
    wheels
        All wheels.
    reference
        Load (N), diameter and width (m) of the reference wheel.

    Attributes
    ----------
    model
        Model of the state.
    scatter
        Scatter of stretches, learnt from innovations.
    bank
        The twelve filters: first the one without wrong zeros, then those that begin with eleven zeros.
    mean, covariance
        Mean and covariance of the state of `soil/model.py`, shape (size,) and (size, size).
    law
        (ln pressure at the soil's reference, n, m), shape (3,), and their derivatives with respect to
        the state, shape (3, size).
    used
        Number of stretches of this soil that were used.
    settled
        Whether the law no longer moves when all stretches are linearised at the newest state.
    """

    def __init__(
        self,
        prior: SoilPrior,
        settings: EstimatorSettings,
        effects: Sequence[Effect],
        wheels: tuple[Wheel, ...],
        reference: tuple[float, float, float],
    ) -> None:
        self.model = LawModel(prior, settings, effects, wheels, reference)
        self.scatter = SoilScatter(settings.soil_scatter, wheels)
        model = self.model
        named, unnamed = model.soil_covariance, model.unnamed_covariance
        self.bank = self._bank(model.mean, model.fault_free(named), unnamed)
        drives = any(wheel.contact == ROLLING for wheel in wheels)
        drift = 2.0 * (prior.log_reference_pressure_std / _DRIFT) ** 2
        self._fade = drift if drives else math.inf  # m; a rig presses into one soil
        self._travelled = math.nan
        self._border = (0.0, -math.inf)  # variance that u gains per m, and up to which path (m)
        self._store: list[Stretches] | None = []  # all of this soil; None when they are too many
        # State at which each filter is linearised (None: its newest x), and the law there.
        self._about: list[Array] | None = None
        self._linear: Array = model.law(model.mean)[0]
        self.used, self.settled = 0, False
        self._first = True  # soil: nothing is known of the sensors before it
        self._remember()
        self._mix()

    def _bank(self, mean: Array, tight: Array, wide: Array) -> list[Member]:
        """Make the filter without wrong zeros, and eleven with different zeros.

        mean: of the state. tight, wide: covariance of the first, and of the mixture of the eleven.
        """
        by_zero = wide[:, ZERO] / math.sqrt(wide[ZERO, ZERO])
        members = [Member(self.model, mean, tight, math.log(1.0 - _WIDE_SHARE))]
        for at, own, share in zip(_ZEROS.tolist(), _OWN.tolist(), _SHARES.tolist(), strict=True):
            covariance = wide - (1.0 - own) * np.outer(by_zero, by_zero)
            log_share = math.log(_WIDE_SHARE * share)
            members.append(Member(self.model, mean + at * by_zero, covariance, log_share))
        return members

    def absorb(self, rows: Stretches) -> None:
        """Update the soil from stretches, all at once, with the prediction over the path to the last of them.

        Parameters
        ----------
        rows
            The stretches, at least one, in the order in which they closed.
        """
        self._travel(float(rows.distance[-1]), self.bank)
        mean = np.average(self._update(rows), axis=0, weights=self._weights)  # (5, rows)
        for i, wheel in enumerate(rows.wheel.tolist()):
            self.scatter.learn(wheel, *mean[:, i].tolist())
        before, self.used = self.used, self.used + len(rows)
        if self._store is not None:
            self._store.append(rows)
            if any(before < count <= self.used for count in _AGAIN):
                self.settled = any(self._again() < _STAYS for _ in range(_ROUNDS))
            if self.used >= _AGAIN[-1]:
                self._store = None
        elif self._about is None or self._moved() > _STAYS:
            self._linearise()
        self._mix()

    def _travel(self, distance: float, bank: Sequence[Member]) -> None:
        way = distance - self._travelled
        if way > 0.0:
            size, until = self._border
            unsettled = max(min(distance, until) - self._travelled, 0.0)
            law, side = math.exp(-way / self._fade), math.exp(-way / _SIDE_FADE)
            F, Q = self.model.drift(law, side, size * unsettled / _UNSETTLED)
            for member in bank:
                member.kalman.predict(F=F, Q=Q)
        self._travelled = float(np.fmax(distance, self._travelled))

    @property
    def _power(self) -> float:
        """Power of the likelihoods that weigh the filters; less where neighbouring errors are correlated."""
        return min(_POWER, 1.0 / self.scatter.alike)

    def _update(self, rows: Stretches) -> Array:
        """Update the filters from stretches; return what `SoilScatter.learn` needs, (filters, 5, rows).

        For each filter, linearised at its first state: innovation, its variance due to the state and in all,
        that due to sensors and law, and d sinkage / d ln load.
        """
        count, z, many = len(rows), rows.sinkage, len(self.bank)
        each, power = Stretches.joined([rows] * many), self._power
        before = [(member.kalman.x, member.kalman.P) for member in self.bank]
        about = [member.x for member in self.bank] if self._about is None else self._about.copy()
        close = [False] * many
        first, noise = np.empty((many, 5, count)), np.empty((many, count))
        for step in range(_ITERATIONS if self._about is None else 1):
            shown = self.model.h(np.repeat(about, count, axis=0), each)
            value, H = shown.value.reshape(many, count), shown.H.reshape(many, count, -1)
            if step == 0:
                made = np.stack([*self.scatter.noise(each, shown), shown.by_load])
                alone, counts, base, by_load = self._weights @ made.reshape(4, many, count)
                noise[:], first[:, 2:] = counts, np.stack([alone, base, by_load])
            for i, member in enumerate(self.bank):
                if close[i]:
                    continue
                if step == 0:
                    miss = first[i, 0] = z - value[i] - H[i] @ (member.x - about[i])
                    first[i, 1], noise[i] = _weighted(
                        member, H[i], miss, first[i, 2], noise[i], power
                    )
                    first[i, 2] += first[i, 1]
                member.kalman.x, member.kalman.P = before[i]
                member.correct(about[i], value[i], H[i], z, noise[i])
                close[i] = abs(member.x[U] - about[i][U]) < _CLOSE
                about[i] = member.x
            if all(close):
                break
        return first

    def _again(self) -> float:
        """Use all stretches of this soil again from its start, linearised about the newest estimates.

        Returns the largest change of (ln p, n, m), in standard deviations: at most 0.25 in drives on soil of
        this law, 1 to 4 in 4 of 6 over bedrock.
        """
        assert self._store is not None
        self._believe()
        spread = self._deviations
        rows = Stretches.joined(self._store)
        sizes = [len(part) for part in self._store]
        started, self._travelled = self._started
        power = self._power
        own_zeros = self.model.own_zero_variance(self.mean, self.covariance)
        abouts = self._linearise()
        shown = [self.model.h(about, rows) for about in abouts]
        noise = np.array([self.scatter.noise(rows, one) for one in shown])
        alone, counts, _ = np.einsum("i,ijk->jk", self._weights, noise)
        self.bank = [member.copy() for member in started]
        for member in self.bank if self._first else []:
            member.allow_own_zeros(own_zeros)
        first = 0
        for size in sizes:
            part = slice(first, first + size)
            self._travel(float(rows.distance[first + size - 1]), self.bank)
            for member, about, one in zip(self.bank, abouts, shown, strict=True):
                value, H, z = one.value[part], one.H[part], rows.sinkage[part]
                miss = z - value - H @ (member.x - about)
                _, used = _weighted(member, H, miss, alone[part], counts[part], power)
                member.correct(about, value, H, z, used)
            first += size
        self._believe()
        return self._moved(spread)

    def _linearise(self) -> list[Array]:
        """From now on linearise each filter at its present x; return these."""
        self._about, self._linear = [member.x for member in self.bank], self.law[0]
        return self._about

    def _moved(self, spread: Array | float = math.inf) -> float:
        """Largest distance of (ln p, n, m) from where they were linearised, in standard deviations.

        spread: earlier deviations; of these and the present ones the smaller count.
        """
        least = np.minimum(spread, self._deviations)
        return float((np.abs(self.law[0] - self._linear) / least).max())

    def _remember(self) -> None:
        """Keep the present filters as those from before the first stretch of this soil."""
        for member in self.bank:
            member.log_prior = member.log_weight
        self._started = [member.copy() for member in self.bank], self._travelled
        self._store, self._about = [], None

    def _mix(self) -> None:
        """Scale the weights to the best filter, limit them so that every filter can recover, and mix."""
        best = max(member.log_weight for member in self.bank)
        for member in self.bank:
            faded = (1.0 - _FORGET) * (member.log_weight - best) + _FORGET * member.log_prior
            member.log_weight = max(faded, _LOWEST)
        self._believe()

    def _believe(self) -> None:
        """Compute mean and covariance of the state, and the law, from the filters by their weights."""
        likely = np.array([member.log_weight for member in self.bank])
        weights = np.exp(likely - likely.max())
        self._weights = weights / weights.sum()
        x = np.array([member.x for member in self.bank])
        self.mean: Array = self._weights @ x
        self.covariance: Array = self._of_wide(self.mean)
        self.law: Law = self.model.law(self.mean)

    @property
    def _deviations(self) -> Array:
        slopes = self.law[1]
        return np.asarray(np.sqrt(np.diag(slopes @ self.covariance @ slopes.T)))

    def _of_wide(self, mean: Array) -> Array:
        """Covariance, about a mean, of the mixture of the eleven filters in which zeros may be wrong."""
        wide, bank = self._weights[1:] / self._weights[1:].sum(), self.bank[1:]
        off = np.array([member.x for member in bank]) - mean
        within = np.array([member.kalman.P for member in bank])
        found: Array = np.einsum("i,ijk->jk", wide, within)
        found += np.einsum("i,ij,ik->jk", wide, off, off)
        return found

    @property
    def zero_by_law(self) -> float:
        """Reduction of the variance (m^2) of the sinkage sensors' common zero from its prior; at least 0.

        A zero shows in how far sinkages grow with load: on ground that is no power of depth it does not.
        """
        before, now = (one[ZERO, ZERO] for one in (self.model.soil_covariance, self.covariance))
        return max(float(before - now), 0.0)

    @property
    def widest(self) -> Array:
        """Mean state of the eleven filters in which the sinkage sensors' zero may be wrong."""
        wide = self._weights[1:] / self._weights[1:].sum()
        return np.asarray(wide @ [member.x for member in self.bank[1:]])

    @property
    def likeliest(self) -> Law:
        """Mean and covariance of the state under the likelier hypothesis, that zeros are wrong or not.

        Shape (size,) and (size, size).
        """
        if self._weights[0] > 0.5:
            return self.bank[0].x, self.bank[0].kalman.P
        return self.widest, self._of_wide(self.widest)

    def innovations(self, rows: Stretches) -> tuple[Array, Array, Array, Array]:
        """Compute innovations of stretches, each by itself, under the likelier hypothesis.

        Parameters
        ----------
        rows
            The stretches.

        Returns
        -------
        miss, state, variance, by_load : ndarray
            Shape (rows,): measured less predicted sinkage, m; its variance due to the state, and in all, m^2;
            d predicted sinkage / d ln load, m.
        """
        mean, covariance = self.likeliest
        shown = self.model.h(mean, rows)
        state = np.einsum("ri,ij,rj->r", shown.H, covariance, shown.H)
        alone, _, _ = self.scatter.noise(rows, shown)
        return rows.sinkage - shown.value, state, state + alone, shown.by_load

    def together(self, rows: Stretches) -> tuple[Array, Array, Array]:
        """Compute innovations of many stretches with their common covariance, about the mean of all filters.

        Parameters
        ----------
        rows
            The stretches.

        Returns
        -------
        miss, covariance, by_load : ndarray
            Measured less predicted sinkages, (rows,), m; their covariance, (rows, rows), m^2;
            derivatives of the predicted sinkages with respect to ln load, (rows,), m.
        """
        shown = self.model.h(self.mean, rows)
        _, counts, _ = self.scatter.noise(rows, shown)
        covariance = shown.H @ self.covariance @ shown.H.T + np.diag(counts)
        return rows.sinkage - shown.value, covariance, shown.by_load

    def copy(self) -> SoilFilter:
        """Return a copy, which updates of this filter by stretches do not change; `weigh` changes both."""
        own = copy(self)
        own.bank, own.scatter = [member.copy() for member in self.bank], self.scatter.copy()
        own._store = None if self._store is None else self._store.copy()
        return own

    # -- another soil

    def reopen(self, law: Law | None, shift: float, distance: float) -> None:
        """Start on another soil: reset the law to the prior or to a remembered one; keep the sensors' errors.

        Parameters
        ----------
        law
            Mean and covariance of (u, n, m) of a remembered soil, shape (3,) and (3, 3); None: the prior's.
        shift
            Change of ln k at the border.
        distance
            Path of the vehicle at the newest stretch that has not been used yet, m. Up to 1 m beyond it the
            soil may go on changing.
        """
        self._border = ((shift / (self.mean[N] + 0.5)) ** 2, distance + _UNSETTLED)
        for i, member in enumerate(self.bank):
            x, member.kalman.P = self._with_law(
                member.x, member.kalman.P, law or self._prior_law(i > 0)
            )
            member.kalman.x = x - self.model.mean
        self.used, self.settled, self._first = 0, law is not None, False
        self._remember()
        self._mix()

    def _prior_law(self, unnamed: bool) -> Law:
        """Prior mean and covariance of (u, n, m). unnamed: whether the soil may not be the named one."""
        model = self.model
        covariance = model.unnamed_covariance if unnamed else model.soil_covariance
        return model.mean[:LAW], covariance[:LAW, :LAW]

    def _with_law(self, x: Array, P: Array, law: Law) -> tuple[Array, Array]:
        """Return copies of a mean and covariance of the state in which (u, n, m) are those of a law."""
        x, P = x.copy(), P.copy()
        P[:LAW, :] = P[:, :LAW] = 0.0
        x[:LAW], P[:LAW, :LAW] = law
        return x, P

    def resume(self, mean: Array, covariance: Array, used: int) -> None:
        """Continue from a saved state, which has no errors of single wheels' sensors.

        Parameters
        ----------
        mean
            Mean of the first numbers of the state, shape (WHEELS,).
        covariance
            Their covariance, shape (WHEELS, WHEELS).
        used
            Number of stretches that count as used.
        """
        x = self.model.mean.copy()
        x[:WHEELS] = mean
        wide = self.model.soil_covariance.copy()
        tight = self.model.fault_free(wide)
        tight[:WHEELS, :WHEELS] = wide[:WHEELS, :WHEELS] = covariance
        self.bank = self._bank(x, tight, wide)
        self.used, self.settled, self._first = used, True, False
        self._remember()
        self._mix()

    def log_likelihood(self, law: Law | None, rows: Stretches) -> float:
        """Compute the ln likelihood of stretches on a soil, to compare soils with each other.

        It is that of ln sinkage, linearised at the law, and halved: a likelihood to the power of 0.5.

        Parameters
        ----------
        law
            Mean and covariance of (u, n, m) of a remembered soil, shape (3,) and (3, 3); None: the prior's.
        rows
            The stretches.

        Returns
        -------
        float
            Up to a constant that is the same for all laws.
        """
        x, P = self._with_law(*self.likeliest, law or self._prior_law(False))
        shown = self.model.h(x, rows)
        alone, _, _ = self.scatter.noise(rows, shown)
        value = np.maximum(shown.value, 1e-4)
        miss = np.log(np.maximum(rows.sinkage, 1e-4) / value)
        H = shown.H / value[:, None]
        variance = H @ P @ H.T + np.diag(alone / value**2)
        _, determinant = np.linalg.slogdet(variance)
        return float(-0.5 * _TEMPER * (miss @ np.linalg.solve(variance, miss) + determinant))

    def weigh(self, loads: Array, weight: float, weight_std: float) -> None:
        """Use the vehicle's weight as a measurement of the sum of the loads.

        If all stretches of this soil are still stored, they are used again after it, since the weight was the
        same from the start.

        Parameters
        ----------
        loads
            Loads shown by the cells of all wheels, shape (wheels,), N.
        weight, weight_std
            Weight and its standard deviation, N.
        """
        started, _ = self._started
        whole = self._store is not None and sum(map(len, self._store)) == self.used
        for member in started if whole else [*started, *self.bank]:
            member.weigh(loads, weight, weight_std)
        if whole and self._store:
            self._again()
        elif whole:
            self.bank = [member.copy() for member in started]
        self._mix()


def _weighted(
    member: Member, H: Array, miss: Array, alone: Array, counts: Array, power: float
) -> tuple[Array, Array]:
    """Update a filter's weight by the likelihood of innovations, and weigh outliers down.

    miss: innovations, m. alone, counts: variances of a stretch alone, and of one among neighbours, m^2.
    Returns the variances of the innovations due to the state, and `counts` increased for outliers, m^2.
    """
    state = np.einsum("ri,ij,rj->r", H, member.kalman.P, H)
    squares = miss * miss / (state + alone)
    likely = np.minimum(squares, LARGEST) + np.log(state + alone)
    member.log_weight -= 0.5 * power * float(likely.sum())
    return state, counts * _huber(squares)


def _huber(squares: Array) -> Array:
    """Factors on R by squared normalised innovations: 1 up to `_HUBER` deviations, beyond it they grow."""
    size = np.maximum(1.0, np.sqrt(squares) / _HUBER)
    return np.where(size < 2.0, size, 0.5 * size * size)
