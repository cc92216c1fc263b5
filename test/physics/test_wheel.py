# SPDX-License-Identifier: Apache-2.0
"""Strength of soil under a wheel: what a wider one keeps."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.physics.wheel import Quantity, Strength

DEVIATIONS = st.lists(st.floats(1e-3, 1.0), min_size=5, max_size=5)


def covariance(strength: Strength) -> np.ndarray:
    numbers = (
        strength.cohesion, strength.friction_angle, strength.shear_displacement,
        strength.rolling_share, strength.rim_friction,
    )  # fmt: skip
    deviations = np.array([one.standard_deviation for one in numbers])
    correlation = np.eye(5) if strength.correlation is None else strength.correlation
    return np.asarray(correlation * np.outer(deviations, deviations))


@given(deviations=DEVIATIONS, more=st.floats(0.0, 2.0), seed=st.integers(0, 2**32 - 1))
def test_what_is_added_goes_with_no_other_number(
    deviations: list[float], more: float, seed: int
) -> None:
    """Covariances stay, and the variance grows by what was added."""
    root = np.random.default_rng(seed).normal(size=(5, 7))
    whole = root @ root.T
    scale = np.sqrt(np.diag(whole))
    correlation = whole / np.outer(scale, scale)
    c, phi, shear, eta, mu = (Quantity(1.0, one) for one in deviations)
    before = Strength(c, phi, shear, eta, mu, correlation=correlation)
    added = np.zeros((5, 5))
    added[1, 1] = more**2
    np.testing.assert_allclose(
        covariance(before.wider(friction_angle=more)), covariance(before) + added, atol=1e-12
    )
