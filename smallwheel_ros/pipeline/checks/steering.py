# SPDX-License-Identifier: Apache-2.0
"""Rule of `checks` about steering: an angle of the wrong sign.

Wheels that are steered roll about one point. The rigid motion is fitted to rims, headings, gyro and the
odometry's direction of travel, once with the signs as given and once with those of some wheels reversed. A
wrong sign makes a wheel seem to move sideways by twice its angle, and only the right sign removes that.

The residual that a wrong sign leaves is known beforehand: it is the one that the given signs leave on a
vehicle that moves as the reversed signs imply. Reversal removes all of it if the sign is wrong (ratio 1) and
nothing if it is right (0). Differences of slip remain whatever the signs, so that speed, size of
the angles and slip have no part in the verdict.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from smallwheel_ros.pipeline.tables import Array

from .lateness import MOVES
from .rigid_motion import ACROSS, rows_across, rows_along
from .sums import Said
from .window import CheckedWheels, Window

SIGN_ANGLE = 0.1  # rad: twice the 3 degrees by which zeros of joints are off
# Of the speed: sideways speed that a wheel seems to have if its zero is off by 3 degrees.
SIGN_OFF = 0.05
SIGN_REMOVES = 0.5  # of what a wrong sign leaves over: half way between none wrong and wrong
SIGN_SURE = 3.0  # standard errors over 0, by the scatter between spans
SIGN_STEERED = 2.0  # m
_FEWEST = 4  # wheels, of which one of three more than a rigid motion has is wrong
_SPANS = 3  # by which they can be seen to differ
_REST = 0.1  # of what the best set removes: the smallest set that leaves no more is meant
_MOST = 6  # steered wheels of which all sets are tried; of more each alone, and all of them
_APART = 0.1  # s between rows: wheels are not steered faster
_NOTHING = 1e-12  # m^2/s^2: of signs that have no part in how the vehicle moves


class SteeringSign:
    """Finds wheels whose steering angle has the wrong sign, by the fit of a rigid motion.

    For each set of steered wheels it compares the residual that reversing their signs removes with the one
    that it would remove if they were wrong.

    Attributes
    ----------
    sets
        Sets of steered wheels, as indices; the first is empty.
    removed, expected
        Residual sums of squares that were removed, and that would be if the signs were wrong, by set, summed
        over spans, shape (sets,), m^2/s^2.
    """

    def __init__(self, vehicle: CheckedWheels) -> None:
        self.vehicle = vehicle
        steered = [i for i, name in enumerate(vehicle.names) if name in vehicle.steered]
        sizes = range(len(steered) + 1) if len(steered) <= _MOST else (0, 1, len(steered))
        self.sets = [one for size in sizes for one in combinations(steered, size)]
        signs = np.ones((len(self.sets), len(vehicle.names)))
        for row, one in zip(signs, self.sets, strict=True):
            row[list(one)] = -1.0
        self._signs = signs
        self.removed, self.expected, self._rr, self._re, self._ee = np.zeros((5, len(self.sets)))
        self.rims = np.zeros(len(vehicle.names))  # m^2/s^2 likewise, of each rim
        self.spans = 0
        self.way = 0.0  # m while wheels are steered

    def take(self, window: Window) -> list[Said]:
        """Process the rows of a span of 2 s; return the faults that the rule reports at its end.

        A vehicle that turns with its wheels straight is not judged.
        """
        m, rims = window.motion, window.rims
        if m is None or rims is None or len(self.sets) < 2 or len(self.vehicle.names) < _FEWEST:
            return []
        angles = window.angles_at(m.t)
        size = np.abs(rims.x).mean(axis=1)
        rows = m.inside & (size > MOVES) & np.isfinite(angles).all(axis=1)
        rows &= np.abs(angles).max(axis=1) > SIGN_ANGLE
        tenth = np.floor(m.t / _APART)
        rows &= np.diff(tenth, prepend=-np.inf) > 0
        if rows.any():
            turn = np.where(np.isfinite(m.gyro[rows]), m.gyro[rows], m.w[rows])
            self._add(rims.x[rows], angles[rows], turn, window.direction_at(m.t[rows]))
            self.way += float(size[rows].sum()) * _APART
        return self._judged()

    def _add(self, rims: Array, angles: Array, turn: Array, way: Array) -> None:
        half = max(0.5 * float(np.ptp(self.vehicle.y)), 0.05)
        known = np.isfinite(turn)
        # A direction that odometry shows counts as much as the headings of all wheels.
        told = np.where(np.isfinite(way), ACROSS * np.sqrt(rims.shape[1]), 0.0)
        way = np.nan_to_num(way)
        seen = np.zeros((len(rims), 2, 3))
        seen[:, 0, :2] = (told * np.stack([-np.sin(way), np.cos(way)])).T
        seen[:, 1, 2] = np.where(known, half, 0.0)
        given = self._design(angles, seen)
        shown = np.zeros(given.shape[:2])
        shown[:, : rims.shape[1]] = rims
        shown[:, -1] = np.where(known, half * turn, 0.0)
        left = float(((shown - _nearest(given, shown)) ** 2).sum())
        removed, expected = np.zeros((2, len(self.sets)))
        for k, signs in enumerate(self._signs[1:], 1):
            moved = _nearest(self._design(signs * angles, seen), shown)
            removed[k] = left - float(((shown - moved) ** 2).sum())
            expected[k] = float(((moved - _nearest(given, moved)) ** 2).sum())
        self.removed += removed
        self.expected += expected
        self._rr += removed**2
        self._re += removed * expected
        self._ee += expected**2
        self.rims += (rims**2).sum(axis=0)
        self.spans += 1

    def _design(self, angles: Array, seen: Array) -> Array:
        """Coefficients of (vx, vy, w) in all that is compared with a rigid motion, (instants, rows, 3)."""
        x, y = self.vehicle.x, self.vehicle.y
        parts = rows_along(x, y, angles), ACROSS * rows_across(x, y, angles), seen
        return np.concatenate(parts, axis=1)

    def _share(self, k: int) -> tuple[float, float]:
        """Return the ratio of removed to expected residual of set k, and its standard error over spans.

        Source: Cochran 1977, "Sampling Techniques", 6.4 (a ratio of sums).
        """
        expected = max(float(self.expected[k]), _NOTHING)
        share = float(self.removed[k]) / expected
        squares = self._rr[k] - 2.0 * share * self._re[k] + share**2 * self._ee[k]
        error = np.sqrt(max(float(squares), 0.0) * self.spans / (self.spans - 1)) / expected
        return share, float(error)

    def _judged(self) -> list[Said]:
        if self.way < SIGN_STEERED or self.spans < _SPANS:
            return []
        # Sets come by their size; the first, of no wheel, removes nothing.
        most = float(self.removed.max())
        k = int(np.argmax(self.removed >= (1.0 - _REST) * most))
        if k == 0:
            return []
        chosen = list(self.sets[k])
        rims = float(self.rims[chosen].sum())
        if not rims:  # wheels that never turned say nothing of their angles
            return []
        share, error = self._share(k)
        off = float(np.sqrt(self.removed[k] / rims))
        if share < SIGN_REMOVES or share < SIGN_SURE * error or off <= SIGN_OFF:
            return []
        names = [self.vehicle.names[i] for i in chosen]
        text = (
            f"its steering angle is off the motion of all wheels, and with the other sign it is not (by"
            f" {off:.2f} of the speed): check steering_sign and steering_joint; until then its slip is not"
            " known"
        )
        streams = tuple(f"{name}/steering" for name in names)
        return [Said(" and ".join(names), off, text, streams, taught=True)]


def _nearest(design: Array, shown: Array) -> Array:
    """Values of the rows for the rigid motion that fits `shown` best; both have shape (instants, rows)."""
    normal = np.einsum("tri,trj->tij", design, design)
    right = np.einsum("tri,tr->ti", design, shown)
    best = np.linalg.solve(normal, right[..., None])[..., 0]
    return np.asarray(np.einsum("tri,ti->tr", design, best))
