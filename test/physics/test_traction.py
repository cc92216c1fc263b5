# SPDX-License-Identifier: Apache-2.0
"""Compaction resistance, and thrust in both forms."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from smallwheel_ros.physics.sinkage import compaction_resistance
from smallwheel_ros.physics.traction import contact_length, thrust


@given(
    depth=st.floats(0.0, 0.1), n=st.floats(0.0, 3.0), above=st.floats(-0.05, 0.0, exclude_max=True)
)
def test_compaction_is_the_work_of_the_pressure_and_none_above_the_soil(
    depth: float, n: float, above: float
) -> None:
    # Tanh-sinh quadrature: z^n has no derivatives at z = 0, where rules for smooth functions err. In
    # z / depth, so that the rule's tolerance, which is absolute, is small against the integral.
    mean = float(mpmath.quad(lambda u: u**n, [0, 1]))
    work = 0.1 * depth * 2e5 * depth**n * mean
    found = compaction_resistance([depth, above, np.nan], 0.1, 2e5, n)
    assert found[0] == pytest.approx(work, rel=1e-10, abs=1e-300)
    assert found[1] == 0.0
    assert np.isnan(found[2])


def test_contact_length_is_an_arc() -> None:
    assert contact_length(0.1, 0.2) == pytest.approx(0.1 * np.pi / 2)  # to the axle
    assert contact_length(0.15, 0.2) == pytest.approx(0.1 * np.pi / 2)  # and no further
    z = 0.02  # 0.2 r: the chord's shadow sqrt(z (D - z)) is 0.06 m, the arc 7 % longer
    assert contact_length(z, 0.2) == pytest.approx(0.0643501, rel=1e-6)


@given(slip=st.floats(0.001, 1.0), length=st.floats(0.01, 0.15), kappa=st.floats(0.002, 0.06))
def test_integrated_form_averages_the_exponential(slip: float, length: float, kappa: float) -> None:
    z = 0.1 * (1 - np.cos(length / 0.1))  # of a wheel 0.2 m across
    args = (60.0, slip, z, 0.2, 0.1, 500.0, 0.5, kappa)
    limit = 0.1 * length * 500.0 + 60.0 * np.tan(0.5)
    mean = quad(lambda x: -np.expm1(-slip * x / kappa), 0, length)[0] / length
    assert thrust(*args, "integrated") == pytest.approx(limit * mean, rel=1e-8)
    assert thrust(*args, "exponential") == pytest.approx(
        limit * -np.expm1(-slip * length / kappa), rel=1e-9
    )


@pytest.mark.parametrize("form", ["integrated", "exponential"])
def test_thrust_of_small_slips_keeps_its_digits(form: str) -> None:
    slips = np.array([1e-12, 1e-9, 1e-6, 1e-4])
    push = thrust(60.0, slips, 0.01, 0.2, 0.1, 0.0, 0.5, 0.015, form)  # type: ignore[arg-type]
    assert np.diff(np.log(push)) == pytest.approx(np.diff(np.log(slips)), rel=1e-4)
    assert thrust(60.0, 0.0, 0.01, 0.2, 0.1, 0.0, 0.5, 0.015) == 0.0


@given(slip=st.floats(-1, 1))
def test_a_skidding_wheel_is_held_back_as_much(slip: float) -> None:
    args = (0.01, 0.2, 0.1, 200.0, 0.5, 0.015)
    assert thrust(60.0, slip, *args) == pytest.approx(-thrust(60.0, -slip, *args))


def test_thrust_grows_to_its_limit() -> None:
    slips = np.linspace(0, 1, 30)
    push = thrust(60.0, slips, 0.03, 0.2, 0.1, 300.0, 0.5, 1e-4)
    assert (np.diff(push) > 0).all()
    limit = 0.1 * contact_length(0.03, 0.2) * 300.0 + 60.0 * np.tan(0.5)
    assert push[-1] == pytest.approx(limit, rel=2e-3)
