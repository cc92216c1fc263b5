# SPDX-License-Identifier: Apache-2.0
"""Margin of any ground, of unknown soil: from slip and accelerometer, without mass, load cell or torque.

    pull over load of the whole vehicle   p(s) = H (1 - exp(-|s|/K)) sign s - R
    margin                                p(reference slip)

H is the grip, K the slip at which 63 % of it is used, R the motion resistance over load. On a
vehicle pushed by the ground alone, the accelerometer along the direction of travel, over g, shows
the net pull over load, slope and gain of speed included. Each second without a turn *the slip at
the pull that was needed* is compared, not the pull at a slip. The ground cannot give more pull than
its grip, so what a vehicle achieves bounds its margin from below.

The belief is a set of points drawn from the prior once, with weights; what was learnt of ground
left behind is forgotten as exp(-path/10 m). For ground ahead a standard deviation of 0.08 is included,
the scatter between places of one field. If the source of motion turns out to have been wrong from the
beginning, everything learnt from it is dropped.

For the most that ground ahead can give (at the slip at which a vehicle makes no way), each metre that the
vehicle has crossed is evidence as well: had much of the ground been unable to carry it, it would have got
stuck. A point's weight is multiplied by the probability that places of such ground give what was needed,

    P(most + scatter > asked)^metres

so that the risk falls over a path without trouble. On the real drives, 305 m with an imu on which nothing
got stuck, the expected number of stops adds up to 15 from slips alone, and to 5 with this.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import log_ndtr, ndtr, ndtri

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.costmap.cost import falls_short
from smallwheel_ros.costmap.terrain import SPINS
from smallwheel_ros.physics.wheel import GRAVITY
from smallwheel_ros.pipeline.rows.steering import ASIDE
from smallwheel_ros.pipeline.tables import Array, Columns, Flags, Integers

from .hazard import Instants

# Prior: (median, standard deviation of the logarithm).
GRIP = (0.40, 0.70)  # wet ice 0.1, snow 0.3, sand 0.4, grass 0.5, gravel 0.6, asphalt 0.9
SOFTNESS = (0.10, 0.70)  # rubber on asphalt 0.03, loose sand and snow 0.3
RESISTANCE = (0.05, 0.80)  # asphalt 0.015, wheels deep in sand or snow 0.2
OFFSET = 0.02  # rad, of the accelerometer against the vehicle
RADIUS = 0.05  # error of all slips alike, by the wheels' radius: 0.00 to 0.07 on four robots
REACH = 2.5  # standard deviations of the prior
LAW = 0.03  # scatter of a second's pull about the law: bumps, turning
SHARE = 0.5  # of a second's likelihood: seconds follow each other with a correlation of 0.4
SLIDES, WHOLE = 1.0, 1.2  # odds of a step that slides; greatest slip, with its noise
DOUBT = 0.15  # share of steps whose slip tells nothing
PATCH = 10.0  # m, over which ground is forgotten
AHEAD = 0.08  # of margin: scatter between places (snow, 17 places: 13 within the band)
# Margin of that snow. Ice holds 0.08 in all: with as much scatter it would hold a vehicle back in one place
# of six, and a real one drove 215 m without being stuck.
_AHEAD_OF = 0.2
POINTS = 4096  # a step in under 2 ms
ASKED = 1.0  # m, over which the pull that the vehicle needs is averaged
STEP = SECOND  # ns
_MEASURED = 0.5  # share of the information from which on a margin counts as measured
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(7)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()
_RUNS, _TURNS, _LEAST, _NOISE, _FEWEST = (
    0.3,
    0.6,
    0.03,
    0.5,
    6,
)  # m/s, 1, slip, slip, instants of a step


def information(deviation: Array | float, reference_slip: float) -> Array:
    """Compute how much a drive has revealed of a margin, as 1 - its variance / that of any ground.

    Parameters
    ----------
    deviation
        Standard deviation of the margin, 1, any shape.
    reference_slip
        Slip at which the margin is defined, 1.

    Returns
    -------
    ndarray
        Same shape: 0 for a margin that is no better known than that of any ground before driving, 1 for one
        known exactly; NaN where the deviation is NaN.
    """
    prior = unknown_ground(reference_slip)[1]
    return np.asarray(np.clip(1.0 - np.square(deviation) / prior**2, 0.0, 1.0))


def is_prior(deviation: Array | float, reference_slip: float) -> Flags:
    """Tell whether a margin is hardly better known than that of any ground before driving.

    Parameters
    ----------
    deviation
        Standard deviation of the margin, 1, any shape; NaN where nothing was measured.
    reference_slip
        Slip at which the margin is defined, 1.

    Returns
    -------
    ndarray
        Same shape, bool: True where over half of the variance of any ground is left, or where the deviation
        is NaN.
    """
    return np.asarray(~(information(deviation, reference_slip) >= _MEASURED))


def scatter_ahead(margin: Array | float) -> Array:
    """Standard deviation (1) of the margin from place to place on ground of this mean margin; same shape."""
    return np.asarray(AHEAD * np.clip(np.asarray(margin) / _AHEAD_OF, 0.0, 1.0))


def risk_ahead(
    asked: Array | float, median: Array | float, lower_std: Array | float, beyond: Array | float
) -> Array:
    """Compute the probability that a place ahead gives less pull than is required, at whatever slip.

    The cost map uses the same probability, in per cent, for ground ahead whose slope requires as much.

    Parameters
    ----------
    asked
        Required pull over load, 1, any shape.
    median, lower_std, beyond
        Belief about ground ahead, as given by `GroundMargin.ahead`, 1, same shape.

    Returns
    -------
    ndarray
        Same shape, 0 to 1; NaN where any input is NaN.
    """
    spread = np.hypot(lower_std, scatter_ahead(median))
    return np.asarray(falls_short(np.asarray(median) + beyond, spread, asked))


@lru_cache
def unknown_ground(reference_slip: float) -> tuple[float, float]:
    """Mean and standard deviation of the margin of any ground before driving, 1."""
    return GroundMargin(reference_slip).moments()


class GroundMargin:
    """The belief about the ground, as weighted points drawn from a prior; arrays of shape (points,).

    Parameters
    ----------
    reference_slip
        Slip at which the margin is defined, 1.

    Attributes
    ----------
    grip, softness, resistance
        H, K and R of the law in this module's docstring, 1.
    offset
        Zero error of the accelerometer, over g, 1.
    radius
        Error that all slips share because the wheels' radius is in error, 1.
    margins
        Margin of each point, 1.
    logs
        Log likelihood of each point by the slips so far, compared with those at which it gives the pull
        that was needed; unnormalised logarithms of the points' weights.
    crossed
        Log likelihood of each point by the fact that the vehicle has not got stuck on its path so far; added
        to `logs` in `ahead` only.
    """

    def __init__(self, reference_slip: float) -> None:
        ranks = np.tile(np.arange(POINTS), (5, 1))  # Latin hypercube (McKay et al. 1979)
        uniform = (np.random.default_rng(44).permuted(ranks, axis=1).T + 0.5) / POINTS
        low = float(ndtr(-REACH))
        normal = ndtri(low + (1.0 - 2.0 * low) * uniform).T
        self.grip, self.softness, self.resistance = (
            median * np.exp(sd * z)
            for (median, sd), z in zip((GRIP, SOFTNESS, RESISTANCE), normal[:3], strict=True)
        )
        self.offset, self.radius = OFFSET * normal[3], RADIUS * normal[4]
        self.logs = np.zeros(uniform.shape[0])
        self.crossed = np.zeros(uniform.shape[0])
        self.margins = self.grip * -np.expm1(-reference_slip / self.softness) - self.resistance
        gained = np.exp(-reference_slip / self.softness) - np.exp(
            -max(SPINS, reference_slip) / self.softness
        )
        self._most = self.margins + self.grip * gained
        self._order, self._most_order = np.argsort(self.margins), np.argsort(self._most)

    def forget(self, metres: float) -> None:
        """Discount what was learnt of the ground, after a path (m) that leads away from it."""
        kept = math.exp(-metres / PATCH)
        self.logs *= kept
        self.crossed *= kept

    def cross(self, metres: float, asked: float) -> None:
        """Update the belief by the fact that the vehicle got over a piece of path.

        Parameters
        ----------
        metres
            Length of the path, m.
        asked
            Pull over load that it required, 1.
        """
        self.crossed += metres * log_ndtr((self._most - asked) / AHEAD)

    def update(self, slip: float, deviation: float, pull: float, way: float) -> None:
        """Update the belief by the mean slip over a second, at the pull that was needed.

        Parameters
        ----------
        slip, deviation
            Mean slip, positive where the wheels drive, and its standard deviation, 1.
        pull
            Specific force along the direction of travel, divided by g, 1.
        way
            Direction of travel: 1 forward, -1 backward.
        """
        used = (pull - way * self.offset + self.resistance) / self.grip
        used = used + (LAW / self.grip) * _NODES[:, None]
        size = np.abs(used)
        answer = np.minimum(-self.softness * np.log1p(-np.minimum(size, 0.999)), 1.0)
        off = (slip - np.copysign(answer, used) + self.radius) / deviation
        square = 1.0 + 0.25 * off * off
        near = np.where(size < 1.0, 0.375 / deviation / (square * square * np.sqrt(square)), 0.0)
        density = _WEIGHTS @ near
        whole = (
            math.copysign(1.0, slip) * self.grip - self.resistance - pull + way * self.offset
        ) / LAW
        density += SLIDES / WHOLE * np.exp(-0.5 * whole * whole)
        self.logs += SHARE * np.log((1.0 - DOUBT) * density + DOUBT / (2.0 * WHOLE))

    @property
    def weights(self) -> Array:
        """Weights of the points by slips alone, (points,); their sum is 1."""
        return _normalised(self.logs)

    def quantiles(self, levels: tuple[float, ...] = (0.025, 0.5, 0.975)) -> Array:
        """Quantiles of the margin of the present ground, 1, at levels between 0 and 1; shape (levels,)."""
        return _quantiles(self.margins, self._order, self.weights, levels)

    def moments(self) -> tuple[float, float]:
        """Mean and standard deviation of the margin of ground ahead, 1, the scatter of places included."""
        weights = self.weights
        mean = float(weights @ self.margins)
        return mean, math.sqrt(float(weights @ (self.margins - mean) ** 2) + AHEAD**2)

    def ahead(self) -> tuple[float, float, float]:
        """Summarise the belief about ground like the present by three numbers, from which risks are computed.

        The belief has a long upper tail: by its mean and standard deviation, level ground on which a vehicle
        has driven for 10 s would stop it at 10 % of the places; by the points themselves, and by these three
        numbers, at 1.6 %.

        Returns
        -------
        median : float
            Median of the margin, 1.
        lower_std : float
            Standard deviation of the lower half of the distribution of the largest pull over load that the
            ground gives at any slip, 1: distance from its 2.5 % quantile to its median, over 1.96.
        beyond : float
            Median of that largest pull over load less the median of the margin, 1.
        """
        weights = _normalised(self.logs + self.crossed)
        (median,) = _quantiles(self.margins, self._order, weights, (0.5,)).tolist()
        low, most = _quantiles(self._most, self._most_order, weights, (0.025, 0.5)).tolist()
        return median, max((most - low) / 1.96, LAW), most - median


def _normalised(logs: Array) -> Array:
    """Weights of these logarithms; their sum is 1."""
    weights = np.exp(logs - logs.max())
    return np.asarray(weights / weights.sum())


def _quantiles(values: Array, order: Integers, weights: Array, levels: tuple[float, ...]) -> Array:
    """Quantiles of weighted values at levels between 0 and 1. order: indices that sort the values."""
    total = np.cumsum(weights[order])
    place = np.minimum(np.searchsorted(total, levels), len(total) - 1)
    return np.asarray(values[order][place])


@dataclass(frozen=True)
class Margins(Columns):
    """Belief about the margin of the ground after each second; before any evidence it is the prior.

    Attributes
    ----------
    stamp
        End of the second, ns.
    margin, margin_std
        Mean margin of ground ahead and its standard deviation, 1, from `GroundMargin.moments`.
    low, middle, high
        2.5, 50 and 97.5 % quantiles of the margin of the present ground, 1.
    median, lower_std, beyond
        Belief about ground ahead as given by `GroundMargin.ahead`, 1.
    asked
        Pull over load that the vehicle has needed, averaged over the last metre, 1; NaN if unknown.
    risk
        Probability that ground ahead does not give `asked`, from `risk_ahead`; NaN until slip has shown
        anything of the ground.
    """

    stamp: Integers
    margin: Array
    margin_std: Array
    low: Array
    middle: Array
    high: Array
    median: Array
    lower_std: Array
    beyond: Array
    asked: Array
    risk: Array


class AnyGround:
    """Computes the margin of any ground from the instants of `Warnings`, second by second.

    Parameters
    ----------
    side
        Distance of each rolling wheel to the left of the base frame, shape (rolling wheels,), m.
    reference_slip
        Slip at which the margin is defined, 1.
    gravity
        Acceleration of gravity, m/s^2.

    Attributes
    ----------
    ground
        The present belief.
    steps
        Number of seconds whose slip has been learnt from since the belief last began anew.
    """

    def __init__(self, side: Array, reference_slip: float, gravity: float = GRAVITY) -> None:
        self._gravity = gravity
        self.ground, self._reference_slip = GroundMargin(reference_slip), reference_slip
        self.side = side
        self._open: Instants | None = None
        self._unshared: list[float] = []
        self._last: tuple[int, float, float] | None = (
            None  # stamp, speed, pull less rise of the last step
        )
        self._asked = np.nan
        self.steps = 0
        self._anew: list[int] = []  # stamps that no step has come to yet

    def take(self, instants: Instants, anew: Sequence[int] = ()) -> Margins | None:
        """Learn from all seconds that have ended.

        Parameters
        ----------
        instants
            New instants.
        anew
            Stamps at which everything learnt before them is dropped, ns.

        Returns
        -------
        Margins or None
            The belief after each second that has ended; None if there is none, or no wheel rolls.
        """
        self._anew += anew
        if not self.side.size:
            return None
        rows = instants if self._open is None else Instants.joined([self._open, instants])
        number = (rows.stamp - 1) // STEP
        over = number < number[-1]
        self._open = rows.take(~over)
        made = []
        for one in np.unique(number[over]).tolist():
            made.append(self._step(rows.take(number == one), one))
        if not made:
            return None
        columns = list(zip(*made, strict=True))
        return Margins(np.array(columns[0], dtype=np.int64), *(np.array(c) for c in columns[1:]))

    def _step(self, rows: Instants, number: int) -> tuple[float, ...]:
        speed, rims = float(np.mean(rows.speed)), rows.rim.mean(axis=0)
        pull, rise = float(np.mean(rows.felt)) / self._gravity, float(np.mean(rows.rise))
        rim = float(np.mean(rims))
        self.ground.forget(abs(speed) * STEP / SECOND if math.isfinite(speed) else 0.0)
        noise = self._noise(number, speed, pull - (rise if math.isfinite(rise) else 0.0))
        known = math.isfinite(speed + pull + rim) and len(rows) >= _FEWEST
        moves = known and abs(rim) > _RUNS
        if moves:
            self._learn(rows, rims, rim, speed, pull, noise)
            way = math.copysign(1.0, rim)
            share = 1.0 - math.exp(-abs(speed) / ASKED)
            before = self._asked if math.isfinite(self._asked) else way * pull
            self._asked = before + share * (way * pull - before)
            if way * speed > (1.0 - SPINS) * abs(rim):
                self.ground.cross(abs(speed) * STEP / SECOND, self._asked)
        elif not math.isfinite(pull):
            self._asked = np.nan
        if any(stamp <= (number + 1) * STEP for stamp in self._anew):
            self._begin_anew((number + 1) * STEP)
        low, middle, high = self.ground.quantiles()
        mean, std = self.ground.moments()
        median, lower_std, beyond = self.ground.ahead()
        # Without a step, or where nothing is asked for, there is no risk to speak of.
        asked = self._asked if self.steps > 0 else np.nan
        risk = float(risk_ahead(asked, median, lower_std, beyond))
        return (
            (number + 1) * STEP, mean, std, low, middle, high, median, lower_std, beyond, self._asked, risk,
        )  # fmt: skip

    def _begin_anew(self, until: int) -> None:
        """Drop what was learnt up to a stamp (ns), which ends a step."""
        self.ground, self.steps, self._asked = GroundMargin(self._reference_slip), 0, np.nan
        self._anew = [stamp for stamp in self._anew if stamp > until]

    def _learn(
        self, rows: Instants, rims: Array, rim: float, speed: float, pull: float, noise: float
    ) -> None:
        """Update the belief by a second, unless the vehicle turns or a wheel points or moves off the course.

        The margin thus remains that of wheels along the course, into which they can be turned.
        """
        if rows.apart.max() > ASIDE:
            return
        left, right = rims[self.side > 0.0], rims[self.side < 0.0]
        if left.size and right.size and abs(right.mean() - left.mean()) >= _TURNS * abs(rim):
            return
        way, size = math.copysign(1.0, rim), abs(rim)
        slip = 1.0 - way * speed / size
        change = float(np.ptp(rows.rim.mean(axis=1)))
        deviation = math.hypot(math.hypot(noise, 0.25 * change) / size, _LEAST)
        if deviation < _NOISE:
            self.ground.update(slip, deviation, way * pull, way)
            self.steps += 1

    def _noise(self, number: int, speed: float, gain: float) -> float:
        """Standard deviation (m/s) of the mean speeds of steps, from changes that the accelerometer misses.

        number: of the step. speed: its mean, m/s. gain: mean dv/dt by the accelerometer, over g.
        """
        last = self._last
        if (
            last is not None
            and last[0] == number - 1
            and math.isfinite(speed + gain + last[1] + last[2])
        ):
            self._unshared.append(speed - last[1] - self._gravity * 0.5 * (gain + last[2]))
            del self._unshared[:-60]
        self._last = number, speed, gain
        if len(self._unshared) < 5:
            return 0.05
        off = np.array(self._unshared)
        return float(1.48 * np.median(np.abs(off - np.median(off))) / math.sqrt(2.0))
