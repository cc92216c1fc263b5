# SPDX-License-Identifier: Apache-2.0
"""Whether pressure grows with depth as the law says: a test of residuals against depth.

Over a hard layer at depth q a wheel sinks less beyond q than any power of depth predicts, over a
soft one more. Let e = z - h(x0), linearised at the newest state, S = H P0 H^T + R its covariance, by the
state's prior and the noise of a stretch among its neighbours, and c = max(z_law - q, 0) the depth beyond q by
the law. Then

    share = c^T S^-1 e / (c^T S^-1 c),    sigmas = c^T S^-1 e / (c^T S^-1 c)^1/2

is the additional sinkage beyond q as a share of the law's (-1: it sinks no deeper than q), whatever
the state's values (a score test; Rao 1948). The depths q tried are the quartiles over the newest
stretches of this soil.
"""

from __future__ import annotations

import numpy as np

from smallwheel_ros.pipeline.tables import Array

from .filter import SoilFilter
from .stretches import Stretches

NEWEST = 120  # updates of the filter whose stretches are tested
EVERY = 2.0  # m between tests
_ENOUGH = 60  # stretches
# Least sigmas and share; a smaller share hardly changes a sinkage. In another author's simulator a layer is
# reported in 15 of 16 drives over one, and in 1 of 16 without (in 4 by 3 deviations of stretches taken each
# alone). Ground once reported stays so until either is below a third of that: the newest stretches do not
# always show it.
_SIGMAS, _SHARE, _STAYS = 2.75, 0.4, 1.0 / 3.0
_QUARTILES = (0.25, 0.5, 0.75)
_CUT = 3.0  # deviations beyond which the noise of a residual is increased


def shape_doubt(rows: Stretches, law: SoilFilter, doubted: bool = False) -> str:
    """Explain how stretches contradict the law's power of depth.

    Parameters
    ----------
    rows
        Newest stretches of this soil that the filter has used.
    law
        Filter of the soil.
    doubted
        Whether the last test of this soil contradicted the law; then less evidence suffices.

    Returns
    -------
    str
        In words; empty where they do not, or with fewer than 60 stretches, or before the law is settled.
    """
    if len(rows) < _ENOUGH or not law.settled:
        return ""
    model, state = law.model, law.widest
    shown = model.h(state, rows)
    by_state = shown.H
    _, noise, _ = law.scatter.noise(rows, shown)
    miss = rows.sinkage - shown.value
    noise = noise * np.maximum(1.0, np.abs(miss) / (_CUT * np.sqrt(noise)))
    depth = model.sinkage(np.broadcast_to(state, (len(rows), model.size)), rows).value
    edges = np.quantile(depth, _QUARTILES)
    beyond = np.maximum(depth[:, None] - edges, 0.0)
    # Woodbury: S^-1 = N - N H (P0^-1 + H^T N H)^-1 H^T N, with e = miss + H (x - x0)
    by = by_state / noise[:, None]
    information = np.linalg.inv(model.unnamed_covariance) + by_state.T @ by
    about = miss + by_state @ (state - model.mean)

    def whitened(columns: Array) -> Array:
        """S^-1 times columns of shape (rows, any)."""
        return np.asarray(
            columns / noise[:, None] - by @ np.linalg.solve(information, by.T @ columns)
        )

    own = whitened(beyond)
    weight = np.einsum("ij,ij->j", beyond, own)
    score = about @ own
    sigmas = score / np.sqrt(np.maximum(weight, 1e-30))
    best = int(np.argmax(np.abs(sigmas)))
    share = float(score[best] / max(weight[best], 1e-30))
    least = _STAYS if doubted else 1.0
    if abs(sigmas[best]) <= least * _SIGMAS or abs(share) <= least * _SHARE:
        return ""
    what, depth = "harder" if share < 0.0 else "softer", 1e3 * edges[best]
    return (
        f"this ground is {what} below {depth:.0f} mm than any power of depth describes: rely on predicted"
        " sinkages and their deviations, not on k, n and m"
    )
