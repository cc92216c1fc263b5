# SPDX-License-Identifier: Apache-2.0
"""Whether pressure grows with depth as the law says: residuals against depth.

Over a hard layer at depth q a wheel sinks less beyond q than any power of depth has it, over a soft one more.
With e = z - h(x0) linearised at the newest state, S = H P0 H^T + R its covariance by the state's prior and
by the noise of stretches, and c = max(z_law - q, 0) the depth beyond q as the law has it,

    share = c^T S^-1 e / (c^T S^-1 c),    sigmas = c^T S^-1 e / (c^T S^-1 c)^1/2

is what a wheel sinks more beyond q over what the law gives (-1: not at all), whatever the numbers of the
state (a score test; Rao 1948). Tried are the quartiles of the depths of the newest stretches of this soil.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from smallwheel_ros.pipeline.tables import Array

from .filter import SoilFilter
from .stretches import Stretches

_NEWEST, _ENOUGH = 240, 60  # stretches that are asked; before anything is said
EVERY = 2.0  # m between tests
# Least of both; a smaller share hardly changes a sinkage.
_SIGMAS, _SHARE = 3.0, 0.4
_QUARTILES = (0.25, 0.5, 0.75)
_CUT = 3.0  # deviations to which a residual counts in full


class ShapeTest:
    """Keeps the newest stretches of one soil. doubt: in words, where the law's shape is refuted."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Another soil begins."""
        self._kept: deque[Stretches] = deque()
        self._count, self._next = 0, -math.inf
        self.doubt, self.sigmas, self.share = "", 0.0, 0.0

    def add(self, rows: Stretches, law: SoilFilter) -> None:
        """Take stretches that the law has used; a test is due every 2 m."""
        self._kept.append(rows)
        self._count += len(rows)
        while self._count - len(self._kept[0]) >= _NEWEST:
            self._count -= len(self._kept.popleft())
        distance = float(rows.distance[-1])
        if self._count >= _ENOUGH and law.settled and distance >= self._next:
            self._next = distance + EVERY
            self._test(Stretches.joined(list(self._kept)), law)

    def _test(self, rows: Stretches, law: SoilFilter) -> None:
        model, x = law.model, law.widest.x
        state, jacobian = (part[0] for part in model.soil(x[None]))
        shown = model.h(x, rows)
        by_state = shown.H @ np.linalg.inv(jacobian)
        noise, _, _ = law.scatter.noise(rows, shown)
        miss = rows.sinkage - shown.value
        noise = noise * np.maximum(1.0, np.abs(miss) / (_CUT * np.sqrt(noise)))
        depth = model.sinkage(np.broadcast_to(state, (len(rows), model.size)), rows).value
        edges = np.quantile(depth, _QUARTILES)
        beyond = np.maximum(depth[:, None] - edges, 0.0)
        # Woodbury: S^-1 = N - N H (P0^-1 + H^T N H)^-1 H^T N, with e = miss + H (x - x0)
        by = by_state / noise[:, None]
        information = np.linalg.inv(model.soil_covariance) + by_state.T @ by
        about = miss + by_state @ (state - model.mean)

        def whitened(columns: Array) -> Array:
            return np.asarray(
                columns / noise[:, None] - by @ np.linalg.solve(information, by.T @ columns)
            )

        own = whitened(beyond)
        weight = np.einsum("ij,ij->j", beyond, own)
        score = about @ own
        sigmas = score / np.sqrt(np.maximum(weight, 1e-30))
        best = int(np.argmax(np.abs(sigmas)))
        self.sigmas, self.share = float(sigmas[best]), float(score[best] / max(weight[best], 1e-30))
        self.doubt = ""
        if abs(self.sigmas) > _SIGMAS and abs(self.share) > _SHARE:
            what, depth = "harder" if self.share < 0.0 else "softer", 1e3 * edges[best]
            self.doubt = (
                f"this ground is {what} below {depth:.0f} mm than any power of depth has it; go by the"
                " sinkages that are predicted, not by k, n and m"
            )
