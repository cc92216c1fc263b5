# SPDX-License-Identifier: Apache-2.0
"""Rule of `checks` about steering: an angle of the wrong sign.

Wheels that are steered roll about one point. Rims, headings, gyro and the way that an odometry
shows are compared to the rigid motion nearest
to all of them, with the signs as they are given and with those of some wheels turned over: by a wrong sign a
wheel seems to go aside by twice its angle, and only the right sign removes that.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from smallwheel_ros.pipeline.tables import Array

from .rigid_motion import ACROSS, rows_across, rows_along
from .sums import Said
from .window import MOVES, CheckedWheels, Window

SIGN_ANGLE, SIGN_OFF, SIGN_REMOVES, SIGN_STEERED = 0.1, 0.1, 2.0, 2.0  # rad, 1, 1, m
_FEWEST = 4  # wheels, of which one of three more than a rigid motion has is wrong
_ALIKE = 1.2  # of the best: of those that explain as much the one with the fewest wheels is meant
_MOST = 6  # steered wheels of which all sets are tried; of more each alone, and all of them
_APART = 0.1  # s between rows: wheels are not steered faster


class SteeringSign:
    """Squares of what is left over by the signs as given, and with those of sets of wheels turned over."""

    def __init__(self, vehicle: CheckedWheels) -> None:
        self.vehicle = vehicle
        steered = [i for i, name in enumerate(vehicle.names) if name in vehicle.steered]
        sizes = range(len(steered) + 1) if len(steered) <= _MOST else (0, 1, len(steered))
        self.sets = [one for size in sizes for one in combinations(steered, size)]
        signs = np.ones((len(self.sets), len(vehicle.names)))
        for row, one in zip(signs, self.sets, strict=True):
            row[list(one)] = -1.0
        self._signs = signs
        self.left = np.zeros(len(self.sets))  # m^2/s, over time
        self.rims = np.zeros(len(vehicle.names))  # m^2/s likewise, of each rim
        self.way = 0.0  # m while wheels are steered

    def take(self, window: Window) -> list[Said]:
        """A vehicle that turns on straight wheels is not asked."""
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
        x, y = self.vehicle.x, self.vehicle.y
        half = max(0.5 * float(np.ptp(y)), 0.05)
        known = np.isfinite(turn)
        # A direction that odometry shows counts as much as the headings of all wheels.
        told = np.where(np.isfinite(way), ACROSS * np.sqrt(len(x)), 0.0)
        way = np.nan_to_num(way)
        for k, signs in enumerate(self._signs):
            turned = signs * angles
            seen = np.zeros((len(rims), 2, 3))
            seen[:, 0, :2] = (told * np.stack([-np.sin(way), np.cos(way)])).T
            seen[:, 1, 2] = np.where(known, half, 0.0)
            parts = rows_along(x, y, turned), ACROSS * rows_across(x, y, turned), seen
            design = np.concatenate(parts, axis=1)
            shown = np.zeros(design.shape[:2])
            shown[:, : rims.shape[1]] = rims
            shown[:, -1] = np.where(known, half * turn, 0.0)
            normal = np.einsum("tri,trj->tij", design, design)
            right = np.einsum("tri,tr->ti", design, shown)
            best = np.linalg.solve(normal, right[..., None])[..., 0]
            off = shown - np.einsum("tri,ti->tr", design, best)
            self.left[k] += float((off**2).sum())
        self.rims += (rims**2).sum(axis=0)

    def _judged(self) -> list[Said]:
        if self.way < SIGN_STEERED:
            return []
        least = float(self.left.min())
        # Sets come by their size.
        alike = self.left <= _ALIKE * least
        chosen = list(next(one for one, near in zip(self.sets, alike, strict=True) if near))
        if not chosen or least * SIGN_REMOVES >= self.left[0]:
            return []
        share = float(np.sqrt((self.left[0] - least) / self.rims[chosen].sum()))
        if share <= SIGN_OFF:
            return []
        names = [self.vehicle.names[i] for i in chosen]
        text = (
            f"its steering angle is off the motion of all wheels, and with the other sign it is not (by"
            f" {share:.2f} of the speed): check steering_sign and steering_joint; until then its slip is not"
            " known"
        )
        streams = tuple(f"{name}/steering" for name in names)
        return [Said(" and ".join(names), share, text, streams, taught=True)]
