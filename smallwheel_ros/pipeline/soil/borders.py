# SPDX-License-Identifier: Apache-2.0
"""Which soil the wheels are on: stretches in, versions of the law out.

Stretches that end in the same quarter of a second are taken together, at its end, and are used 0.6 m later.
Whenever some come, those of leading wheels (that no other runs ahead of) are compared with the law
(`border_evidence`). Beyond a border the law is reset to the prior, or to the one of four remembered soils
under which these stretches are likelier; what is known of the sensors is kept. Stretches nearer to
the border than their length are not used on either side.

A border that 0.6 m do not show bends n and k within metres. The law is therefore stored every half
metre, for 4 m, and all stretches since the oldest are compared with that. Where they show a border,
the law returns to the stored state, uses what lies before the border, and is reset.

Nothing counts as determined while a border is over 3 sigma, predictions miss, the wheels hardly sink, or
pressure does not follow a power of depth (`shape`): then sinkages are stated as if the zero of their sensors
were as little known as before.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from smallwheel_ros.common.stamps import NEVER, SECOND
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.onboard.prior import (
    EstimatorSettings,
    SoilPrior,
    covariates_of,
)
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import GRAVITY, Wheel
from smallwheel_ros.pipeline.rows.motion import ahead_of
from smallwheel_ros.pipeline.tables import Array, Flags, Integers, Readings
from smallwheel_ros.pipeline.versions import REMEMBERED, Versions

from .border_evidence import Border, border_ahead, border_behind
from .filter import Law, SoilFilter
from .health import FilterHealth
from .identifiability import Variety
from .local_law import Version, constants
from .missing_effect import MissingEffectWatch
from .model import LAW, WHEELS, ZERO, U, reference_wheel
from .saved_state import SoilRecord
from .sensors import StuckSensors, Weighing
from .shape import EVERY, NEWEST, shape_doubt
from .stretches import Stretches, length_of

_PERIOD = SECOND // 4  # of the filter's work: a wheel closes a stretch in it at 0.8 m/s
_WAIT, _MOST = 3.0, 8  # lengths that a stretch waits; stretches of a wheel that turns on the spot
# Stretches of a soil before another is looked for; after which it is worth remembering.
_TESTED, _SETTLED = 20, 10
# m: over which a border is looked for again, and between laws that are kept for that.
_BACK, _APART = 4.0, 0.5
# Newest stretches whose predictions are looked at, and the mean of their squared innovations over what is
# stated (each cut at 9) from which on predictions miss: 1 is right, and over 1.6 is rare where it is.
_LATELY, _MISSES, _WORST = 24, 2.5, 9.0
_DEEP = 3.0  # deviations of the zeros that wheels have to sink


class _Past(NamedTuple):
    """The law as it was at a distance (m), and what it has used since, until the next one."""

    distance: float
    law: SoilFilter
    used: list[Stretches]


@dataclass(frozen=True)
class _Known:
    """A soil that was met: mean and covariance of (ln z_ref, n, m)."""

    state: Law
    number: int
    variety: Variety


class Soils:
    """Assigns stretches to the soil that they lie on, and filters each soil.

    Attributes
    ----------
    versions
        Versions of the law, the newest last.
    changes
        How many borders were found.
    accepted, outliers
        Readings used, and readings left out of their stretch's mean.
    mass
        Mass of the vehicle, kg; 0: unknown.
    gravity
        Acceleration of gravity, m/s^2.
    """

    def __init__(
        self,
        prior: SoilPrior,
        settings: EstimatorSettings,
        effects: tuple[Effect, ...],
        wheels: tuple[Wheel, ...],
        mass: float = 0.0,
        gravity: float = GRAVITY,
    ) -> None:
        covariates_of(effects)  # refuses what cannot be said, before the first message
        self.prior, self.settings, self.effects, self.wheels = prior, settings, effects, wheels
        self.mass = mass if settings.loads_measured else 0.0
        self.gravity = gravity
        self.length = max(map(length_of, wheels))
        self.changes = self.outliers = self._met = 0
        self.sensors = StuckSensors(len(wheels))
        self._coming: Stretches | None = None  # of the period that is not over
        self._onward, self._distance, self._since = True, 0.0, NEVER
        self._leads = np.array(
            [[not ahead_of(wheels, w, way) for way in (-1.0, 1.0)] for w in wheels]
        )
        self.versions = Versions(self._begin())

    def _begin(self) -> Version:
        """Know nothing but the prior of the soil, whose number is `_met`: its first version."""
        self.filter: SoilFilter | None = None
        self.waiting: Stretches | None = None
        self.health = FilterHealth()
        self.watch = MissingEffectWatch(self.effects, self.wheels, self.length, self.prior)
        self.weighing = Weighing(len(self.wheels), self.mass, self.gravity)
        self.variety = Variety()
        self.accepted = 0
        self._border, self._old, self._number = -math.inf, 0, self._met
        self._known: list[_Known] = []
        self._past: deque[_Past] = deque()
        self._suspected = self._doubted = False
        self._lately: deque[float] = deque(maxlen=_LATELY)
        self._used: deque[Stretches] = deque(maxlen=NEWEST)
        self._shape, self._shape_due = "", self._distance + EVERY
        law, covariance = self.prior.law
        scatter = self.settings.soil_scatter**2, 0.0
        return Version(
            None, law, np.eye(LAW), law, covariance, scatter, self._number,
            outliers=self.outliers, changes=self.changes, distance=self._distance,
        )  # fmt: skip

    def take(
        self, closed: Stretches | None, rows: Readings, anew: Sequence[int] = ()
    ) -> tuple[Integers, Integers]:
        """Update the soils with the stretches that close in these rows; those of one period together.

        Parameters
        ----------
        closed
            The stretches; None if none has closed.
        rows
            Readings of the block, at least one.
        anew
            Stamps at which what was learnt before is dropped, ns.

        Returns
        -------
        own, newest : ndarray
            Versions at each row, shape (rows,): of the soil under the wheel, from the stretches before it,
            and of the newest soil.
        """
        first = self.versions.count - 1
        stamps: list[int] = []  # from which on each new version holds
        until = int(rows.stamp[-1])
        for end, group in self._periods(closed, until):
            stamps += self._begin_anew(anew, end)
            before = self.versions.count
            new = group.end > self._since
            if new.any():
                self._take(_where(group, new))
            stamps += [end] * (self.versions.count - before)
        stamps += self._begin_anew(anew, until)
        return self._version_of(rows, first, np.array(stamps, dtype=np.int64))

    def _begin_anew(self, anew: Sequence[int], before: int) -> list[int]:
        """Begin anew at the stamps (ns) that are new before one; which they are."""
        new = [stamp for stamp in anew if self._since < stamp < before]
        for self._since in new:
            self._met += 1
            self.versions.append(self._begin())
        return new

    def _periods(self, closed: Stretches | None, until: int) -> list[tuple[int, Stretches]]:
        """Stretches by the end (ns) of their period and their way; those of one that is not over wait."""
        if self._coming is not None:
            closed = self._coming if closed is None else Stretches.joined([self._coming, closed])
        if closed is None:
            return []
        due = -(-closed.end // _PERIOD) * _PERIOD
        over = due <= until
        self._coming = None if over.all() else closed.take(~over)
        rows, due = _where(closed, over), due[over]
        cuts = np.flatnonzero((np.diff(due) != 0) | np.diff(rows.onward)) + 1
        groups = np.split(np.arange(due.size), cuts)
        return [(int(due[group[0]]), rows.take(group)) for group in groups if group.size]

    def _take(self, rows: Stretches) -> None:
        self.outliers += int(rows.dropped.sum())
        self._distance = float(rows.distance.max())
        weighed = self.weighing.add(rows)
        if weighed is not None and self.filter is not None:
            self.filter.weigh(*weighed)
            self._past.clear()  # these laws have not been weighed
        moving = self._moving(rows)
        if not moving.any():
            return
        rows = _where(rows, moving)
        if self.filter is None:
            reference = reference_wheel(rows, self.wheels, self.prior)
            self.filter = SoilFilter(
                self.prior, self.settings, self.effects, self.wheels, reference
            )
        self.watch.take(rows, lambda: constants(self.versions.newest.law))
        squares = self._squares(rows)
        self.health.add(rows, squares)
        self._lately.extend(np.minimum(squares[np.isfinite(squares)], _WORST).tolist())
        onward = bool(rows.onward[-1])
        if onward is not self._onward:
            self._onward = onward
            self._turn_back()
        beyond = rows.place >= self._border + self.length
        rolls = np.array([wheel.contact == ROLLING for wheel in self.wheels])[rows.wheel]
        # A rig presses into one place: there is no border on the way down.
        pressed, rolled = beyond & ~rolls, beyond & rolls
        if pressed.any():
            self._absorb(_where(rows, pressed))
        if not rolled.any():
            return
        clear = _where(rows, rolled)
        self.waiting = clear if self.waiting is None else Stretches.joined([self.waiting, clear])
        leads = self._leads[clear.wheel, clear.onward.astype(int)]
        if leads.any() and self._changed():
            return
        if self._keep_law() and self._had_changed():
            return
        used = self.filter.used
        self._absorb(self._ready(float(clear.distance[-1]) if used >= _SETTLED else math.inf))

    def _squares(self, rows: Stretches) -> Array:
        """Squared innovations over their variances; NaN before the law is settled."""
        law = self.filter
        if law is None or not law.settled:
            return np.full(len(rows), np.nan)
        miss, _, variance, _ = law.innovations(rows)
        return np.asarray(miss**2 / variance)

    def _moving(self, rows: Stretches) -> Flags:
        """Which are of sensors that are not stuck; what waits of one that turns out to be is dropped."""
        self.sensors.add(rows)
        stuck = self.sensors.stuck
        if self.waiting is not None and stuck.any():
            self.waiting = self.waiting.take(~stuck[self.waiting.wheel])
        return np.asarray(~stuck[rows.wheel])

    def _ready(self, distance: float) -> Stretches | None:
        """Take out the stretches that have waited long enough."""
        waiting = self.waiting
        if waiting is None:
            return None
        ready = waiting.distance < distance - _WAIT * self.length
        for wheel in np.unique(waiting.wheel).tolist():
            mine = np.flatnonzero(waiting.wheel == wheel)
            ready[mine[:-_MOST]] = True
        if not ready.any():
            return None
        self.waiting = _where(waiting, ~ready)
        return _where(waiting, ready)

    def _absorb(self, rows: Stretches | None) -> None:
        if rows is None or not len(rows) or self.filter is None:
            return
        self.filter.absorb(rows)
        if self._past:
            self._past[-1].used.append(rows)
        self._used.append(rows)
        if self._distance >= self._shape_due:
            self._shape_due = self._distance + EVERY
            newest = Stretches.joined(list(self._used))
            self._shape = shape_doubt(newest, self.filter, bool(self._shape))
        self.accepted += int(rows.count.sum())
        for wheel, load in zip(rows.wheel.tolist(), rows.load.tolist(), strict=True):
            size = self.wheels[wheel]
            self.variety = self.variety.with_wheel(size.diameter, load / size.width)
        self._publish()

    def _publish(self) -> None:
        law, watch = self.filter, self.watch
        assert law is not None
        doubt = self._doubt(law)
        places, still = law.scatter.places
        if self._shape:  # then nothing is known of the zero, and of sinkages no more than that
            still += law.zero_by_law
        self.versions.append(
            Version(
                law.model, *law.law, law.mean, law.covariance, (places + watch.missed_variance, still),
                self._number, law.settled, doubt, self.accepted, self._border, self._old,
                self.variety, watch.alarm, watch.missed_variance, self.outliers, self.changes, self._distance,
            )
        )  # fmt: skip

    def _doubt(self, law: SoilFilter) -> str:
        """Why nothing is determined at this moment, whatever the deviations; empty for no reason."""
        if self._suspected or self._doubted:
            return "another soil may have begun"
        times = math.sqrt(sum(self._lately) / _LATELY)
        if len(self._lately) == _LATELY and times**2 > _MISSES:
            return (
                f"the newest sinkages are {times:.1f} times as far from their predictions as stated: other"
                " ground, a sensor, or physics that the model lacks"
            )
        sunk, known = math.exp(law.mean[U]), math.sqrt(law.covariance[ZERO, ZERO])
        if sunk < _DEEP * known:
            return (
                f"the wheels sink by {1e3 * sunk:.1f} mm, and the zero of their sensors is known to"
                f" {1e3 * known:.1f} mm; take it with the wheels lifted, and give its deviation as"
                " sinkage_zero_std"
            )
        return self._shape

    def _turn_back(self) -> None:
        """The vehicle drives the other way: the last wheels come first, and places count from there."""
        self._absorb(self._ready(math.inf))
        self._border = -math.inf
        self._past.clear()
        self._doubted = False

    def _changed(self) -> bool:
        """Look for a border in what waits, and go on beyond it."""
        law, waiting = self.filter, self.waiting
        assert law is not None
        assert waiting is not None
        if law.used < _TESTED:
            return False
        leads = self._leads[waiting.wheel, waiting.onward.astype(int)]
        border = border_ahead(law, _where(waiting, leads), len(self.wheels))
        self._suspected = border.suspected
        if border.found:
            self._change(border)
        return border.found

    def _keep_law(self) -> bool:
        """Keep the law as it is, each half of a metre; whether it was time for that."""
        assert self.filter is not None
        if self._past and self._distance < self._past[-1].distance + _APART:
            return False
        if not self.filter.settled:
            return False
        self._past.append(_Past(self._distance, self.filter.copy(), []))
        while len(self._past) > 1 and self._past[1].distance <= self._distance - _BACK:
            self._past.popleft()
        return True

    def _had_changed(self) -> bool:
        """Look for a border in what the law has used for the last metres, and go back to before it."""
        kept, waiting = self._past[0].law, self.waiting
        assert waiting is not None
        if kept.used < _TESTED:
            return False
        used = [rows for past in self._past for rows in past.used]
        border = border_behind(kept, Stretches.joined([*used, waiting]), len(self.wheels))
        self._doubted = border.suspected
        if border.found:
            self.filter = kept
            self._change(border, used)
        return border.found

    def _change(self, border: Border, used: Sequence[Stretches] = ()) -> None:
        """Close the old soil, and go on with the prior or with a soil that is remembered.

        used: what an earlier law had not used that has taken the place of the newest.
        """
        place = border.place
        law, waiting = self.filter, self.waiting
        assert law is not None
        assert waiting is not None
        self._past.clear()
        for rows in used:
            before = rows.place < place - self.length
            if before.any():
                law.absorb(_where(rows, before))
            self.accepted -= int(rows.count[~before].sum())
        if used:
            self._publish()
        self._absorb(waiting.take(waiting.place < place - self.length))
        both = Stretches.joined([*used, waiting])
        new, self.waiting = both.take(both.place >= place), None
        self._old = self.versions.count - 1
        if law.used >= _SETTLED:
            state = law.mean[:LAW].copy(), law.covariance[:LAW, :LAW].copy()
            self._known = [*self._known, _Known(state, self._number, self.variety)][-REMEMBERED:]
        likely = [law.log_likelihood(None, new)]
        likely += [law.log_likelihood(known.state, new) for known in self._known]
        best = int(np.argmax(likely))
        known = None if best == 0 else self._known[best - 1]
        until = float(waiting.distance.max())
        law.reopen(None if known is None else known.state, border.shift, until)
        self.variety = Variety() if known is None else known.variety
        self._met += known is None
        self._number = self._met if known is None else known.number
        self._border, self._suspected, self._doubted = place, False, False
        self.changes += 1
        self.health.forget()
        self._lately.clear()
        self._used.clear()
        self._shape, self._shape_due = "", self._distance + EVERY
        self._publish()
        clear = new.take(new.place >= place + self.length)
        self._absorb(clear)

    # -- files

    def record(self) -> SoilRecord | None:
        """State of the newest soil, to be saved; None before anything was learnt about it."""
        law = self.filter
        if law is None or not law.used:
            return None
        covariance = law.covariance[:WHEELS, :WHEELS]
        symmetric = 0.5 * (covariance + covariance.T)
        return SoilRecord(law.model.reference, law.mean[:WHEELS].copy(), symmetric)

    def resume(self, saved: SoilRecord, variety: Variety, accepted: int) -> None:
        """Continue from a saved soil, before any stretch.

        Parameters
        ----------
        saved
            Reference wheel, mean and covariance.
        variety
            Ranges of the wheels and loads it was measured with.
        accepted
            Number of measurements that it rests on.
        """
        law = SoilFilter(self.prior, self.settings, self.effects, self.wheels, saved.reference)
        law.resume(saved.mean, saved.covariance, _SETTLED)
        self.filter, self.variety, self.accepted = law, variety, accepted
        self._publish()

    # -- out

    def _version_of(
        self, rows: Readings, first: int, stamps: Integers
    ) -> tuple[Integers, Integers]:
        """See `take`. first: number of the version that held before these rows."""
        version = first + np.searchsorted(stamps, rows.stamp)
        places = np.array([w.longitudinal_position for w in self.wheels])[rows.wheel]
        place = rows.distance + np.where(rows.onward, places, -places)
        since = [self.versions[number] for number in range(first, self.versions.count)]
        border, old = (
            np.array([getattr(one, name) for one in since])[version - first]
            for name in ("border", "old")
        )
        return np.where(place < border, old, version), version

    def forget(self, version: Integers) -> None:
        """Drop versions that are not needed any more; keep these, the newest, and that before the border."""
        self.versions.forget({*np.unique(version).tolist(), self.versions.newest.old})


def _where(rows: Stretches, keep: Flags) -> Stretches:
    """Some of the rows; all of them as they are."""
    found: Stretches = rows if keep.all() else rows.take(keep)
    return found
