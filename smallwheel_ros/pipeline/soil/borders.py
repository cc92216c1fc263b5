# SPDX-License-Identifier: Apache-2.0
"""Which soil the wheels are on: stretches in, versions of the law out.

Stretches that end in the same quarter of a second are taken together, at its end, and are used after another
0.6 m. At each such time those of leading wheels, which run in no other wheel's track, are compared with the
law (`border_evidence`). Beyond a border the law is reset to the prior, or to the one of four remembered soils
under which these stretches are likelier; what is known of the sensors is kept. Stretches nearer to
the border than their length are not used on either side.

A border that 0.6 m do not show bends n and k within metres. The law is therefore stored every half
metre, for 4 m, and all stretches since the oldest stored law are compared with that. Where they show a
border, the law returns to the stored state, uses the stretches before the border, and is reset.

Nothing counts as determined while a border is suspected by over 3 sigma, sinkages are far from predictions,
the wheels hardly sink, or pressure does not follow a power of depth (`shape`). In the last case predicted
sinkages have a deviation as if the zero of their sensors were as little known as before the first stretch.
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

_PERIOD = SECOND // 4  # ns between updates of the filter: at 0.8 m/s a wheel closes a stretch in it
_WAIT, _MOST = 3.0, 8  # lengths for which a stretch waits; stretches of one wheel that wait at most
# Stretches of a soil from which on a border is looked for; from which on the soil is remembered.
_TESTED, _SETTLED = 20, 10
# m: path over which a border is looked for again; path between the laws that are kept for that.
_BACK, _APART = 4.0, 0.5
# Newest stretches whose predictions are looked at, and the mean of their squared innovations over what is
# stated (each cut at 9) from which on predictions miss: 1 is right, and over 1.6 is rare where it is.
_LATELY, _MISSES, _WORST = 24, 2.5, 9.0
_DEEP = 3.0  # least sinkage, over the deviation of the sensors' zero


class _Past(NamedTuple):
    """A law kept from earlier.

    Attributes
    ----------
    distance
        Path of the vehicle at which it was kept, m.
    law
        Filter of the soil as it was then.
    used
        Stretches used from then on, until the next law was kept.
    """

    distance: float
    law: SoilFilter
    used: list[Stretches]


@dataclass(frozen=True)
class _Known:
    """A soil that the vehicle has left.

    Attributes
    ----------
    state
        Mean and covariance of (u, n, m), with u the ln of the reference wheel's sinkage.
    number
        Number of the soil, as in `Version`.
    variety
        Ranges of the wheels and loads with which it was measured.
    """

    state: Law
    number: int
    variety: Variety


class Soils:
    """Assigns stretches of wheels' paths to the soil that they lie on, and estimates each soil's law.

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
    mass
        Mass of the vehicle, kg; 0 if unknown. It is compared with the loads only if these are measured.
    gravity
        Acceleration of gravity, m/s^2.

    Attributes
    ----------
    versions
        Versions of the law, the newest last.
    changes
        Number of borders found.
    accepted, outliers
        Number of readings used, and of readings left out of their stretch's mean.
    filter
        Filter of the present soil; None before the first stretch.
    variety
        Ranges of the wheels and loads with which the present soil was measured.
    length
        Length of the longest kind of stretch of these wheels, m.

    Raises
    ------
    EstimatorError
        If an effect reads a column that no stream provides.
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
        covariates_of(effects)  # raises for effects that the robot cannot compute
        self.prior, self.settings, self.effects, self.wheels = prior, settings, effects, wheels
        self.mass = mass if settings.loads_measured else 0.0
        self.gravity = gravity
        self.length = max(map(length_of, wheels))
        self.changes = self.outliers = self._met = 0
        self.sensors = StuckSensors(len(wheels))
        self._coming: Stretches | None = None  # stretches of the period that is not over
        self._onward, self._distance, self._since = True, 0.0, NEVER
        self._leads = np.array(
            [[not ahead_of(wheels, w, way) for way in (-1.0, 1.0)] for w in wheels]
        )
        self.versions = Versions(self._begin())

    def _begin(self) -> Version:
        """Reset everything to the prior of a soil with the number `_met`; return its first version."""
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
        """Update the soils with the stretches that close in a block, every quarter of a second.

        Parameters
        ----------
        closed
            The stretches; None if none has closed.
        rows
            Readings of the block, at least one.
        anew
            Stamps at which everything learnt before is dropped, rising, ns.

        Returns
        -------
        version, first_soil : ndarray
            At each row, shape (rows,): number of the version of the soil under the wheel, and number of the
            soil that the first wheels are on. Both rest only on stretches that closed before the row.
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
        """Begin anew at each stamp (ns) in `anew` that is new and below `before`; return these."""
        new = [stamp for stamp in anew if self._since < stamp < before]
        for self._since in new:
            self._met += 1
            self.versions.append(self._begin())
        return new

    def _periods(self, closed: Stretches | None, until: int) -> list[tuple[int, Stretches]]:
        """Group stretches by period and direction of travel, with the end of the period, ns.

        Stretches of a period that is not over at `until` (ns) wait for a later block.
        """
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
        """Squared innovations over their variances, (rows,); NaN before the law is settled."""
        law = self.filter
        if law is None or not law.settled:
            return np.full(len(rows), np.nan)
        miss, _, variance, _ = law.innovations(rows)
        return np.asarray(miss**2 / variance)

    def _moving(self, rows: Stretches) -> Flags:
        """Mask of stretches whose sensor is not stuck; waiting stretches of stuck sensors are dropped."""
        self.sensors.add(rows)
        stuck = self.sensors.stuck
        if self.waiting is not None and stuck.any():
            self.waiting = self.waiting.take(~stuck[self.waiting.wheel])
        return np.asarray(~stuck[rows.wheel])

    def _ready(self, distance: float) -> Stretches | None:
        """Take out of `waiting` the stretches to be used when the vehicle's path is `distance` (m)."""
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
        """Why nothing counts as determined at present, whatever the deviations; empty without a reason."""
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
        """Use all waiting stretches, and forget border and kept laws: the direction of travel has changed."""
        self._absorb(self._ready(math.inf))
        self._border = -math.inf
        self._past.clear()
        self._doubted = False

    def _changed(self) -> bool:
        """Look for a border among waiting stretches, and change to the soil beyond it.

        Returns whether there was one.
        """
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
        """Keep a copy of the law every half metre, once it is settled; return whether one was kept."""
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
        """Look for a border among all stretches since the oldest kept law; return whether one was found.

        Then the law returns to that one, and changes to the soil beyond the border.
        """
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
        """Finish the old soil, and continue with the prior or with a soil that is remembered.

        used: stretches that the newest law had used, if a kept one has replaced it.
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
        """Return the state of the newest soil to be saved; None before any stretch of it was used."""
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
            Ranges of the wheels and loads with which it was measured.
        accepted
            Number of readings that were used for it.
        """
        law = SoilFilter(self.prior, self.settings, self.effects, self.wheels, saved.reference)
        law.resume(saved.mean, saved.covariance, _SETTLED)
        self.filter, self.variety, self.accepted = law, variety, accepted
        self._publish()

    # -- out

    def _version_of(
        self, rows: Readings, first: int, stamps: Integers
    ) -> tuple[Integers, Integers]:
        """Compute what `take` returns.

        first: number of the version that held before these rows. stamps (ns): after which each newer version
        holds.
        """
        version = first + np.searchsorted(stamps, rows.stamp)
        places = np.array([w.longitudinal_position for w in self.wheels])[rows.wheel]
        place = rows.distance + np.where(rows.onward, places, -places)
        since = [self.versions[number] for number in range(first, self.versions.count)]
        border, old, soil = (
            np.array([getattr(one, name) for one in since])[version - first]
            for name in ("border", "old", "number")
        )
        return np.where(place < border, old, version), soil

    def forget(self, version: Integers) -> None:
        """Drop versions that are not needed any more.

        Parameters
        ----------
        version
            Numbers of those to keep, any shape; the newest and the one before the last border are kept, too.
        """
        self.versions.forget({*np.unique(version).tolist(), self.versions.newest.old})


def _where(rows: Stretches, keep: Flags) -> Stretches:
    """Select rows by a mask of shape (rows,); without copying if it selects all."""
    found: Stretches = rows if keep.all() else rows.take(keep)
    return found
