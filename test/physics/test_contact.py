# SPDX-License-Identifier: Apache-2.0
"""The contact integral against independent references: mpmath, and scipy's quad with brentq."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples
from scipy.integrate import quad
from scipy.optimize import brentq

from smallwheel_ros.physics.contact import contact_load, contact_sinkage, shape_integral

EXPONENTS = (0.05, 0.13, 0.5, 0.8, 1.0, 1.6, 2.2, 2.9)
RATIOS = (1e-6, 1e-3, 0.02, 0.1, 0.3, 0.49)  # sinkage over diameter


def exact_load(z: float, d: float, b: float, modulus: float, n: float) -> float:
    """W = b r int p cos(theta) dtheta in 30 digits, theta = theta0 (1 - u^4) against the power."""
    with mp.workdps(30):
        r = mp.mpf(d) / 2
        theta0 = mp.acos(1 - mp.mpf(z) / r)

        def integrand(u: mp.mpf) -> mp.mpf:
            theta = theta0 * (1 - u**4)
            depth = r * (mp.cos(theta) - mp.cos(theta0))
            return modulus * depth**n * mp.cos(theta) * theta0 * 4 * u**3

        return float(b * r * mp.quad(integrand, [0, 0.5, 1]))


@pytest.mark.parametrize("n", EXPONENTS)
def test_against_thirty_digits(n: float) -> None:
    d, b, modulus = 0.2, 0.08, 4e5
    depths = np.array(RATIOS) * d
    loads = np.array([exact_load(z, d, b, modulus, n) for z in depths])
    assert contact_load(depths, d, b, modulus, n) == pytest.approx(loads, rel=1e-12)
    solved = contact_sinkage(loads, d, b, modulus, n)
    assert solved.sinkage == pytest.approx(depths, rel=1e-12)
    assert not solved.sunk_to_axle.any()


@pytest.mark.parametrize("load", [0.1, 3.0, 84.0, 10_000.0])
@pytest.mark.parametrize("n", [0.3, 0.8, 1.4])
def test_against_the_usual_way(load: float, n: float) -> None:
    d, b = 0.17, 0.085
    modulus = load / (0.7 * b * d**0.5 * 0.02 ** (n + 0.5))  # about 2 cm deep whatever the load

    def excess(z: float) -> float:
        cos0 = 1 - 2 * z / d

        def pressure(theta: float) -> float:
            return max(0.5 * d * (np.cos(theta) - cos0), 0.0) ** n * np.cos(theta)

        carried = quad(pressure, 0, np.arccos(cos0), epsabs=0, epsrel=1e-12, limit=500)[0]
        return float(b * 0.5 * d * modulus * carried / load - 1)

    reference = brentq(excess, 1e-6, d / 2, xtol=1e-15, rtol=1e-14)
    assert contact_sinkage(load, d, b, modulus, n).sinkage == pytest.approx(reference, rel=1e-9)


@given(
    load=st.floats(0.1, 1e4),
    d=st.floats(0.03, 1.0),
    aspect=st.floats(0.1, 1.0),
    modulus=st.floats(1e2, 1e9),
    n=st.floats(0.05, 2.9),
)
@settings(max_examples=examples(300))
def test_load_and_sinkage_invert_each_other(
    load: float, d: float, aspect: float, modulus: float, n: float
) -> None:
    solved = contact_sinkage(load, d, aspect * d, modulus, n)
    assert np.isfinite(solved.sinkage)
    if solved.sunk_to_axle:
        assert contact_load(d / 2, d, aspect * d, modulus, n) <= load * (1 + 1e-12)
        assert solved.sinkage >= d / 2 * (1 - 1e-12)
    else:
        assert 0 < solved.sinkage <= d / 2
        back = contact_load(solved.sinkage, d, aspect * d, modulus, n)
        assert back == pytest.approx(load, rel=1e-11)


@given(n=st.floats(0.05, 2.9), d=st.floats(0.05, 0.6), load=st.floats(0.1, 1e4))
@settings(max_examples=examples(60))
def test_slopes_are_derivatives(n: float, d: float, load: float) -> None:
    modulus = load / (0.5 * d * np.sqrt(d) * (0.1 * d) ** (n + 0.5))
    h = 1e-6
    by_load = contact_sinkage(load * np.exp([-h, h]), d, 0.5 * d, modulus, n).sinkage
    by_n = contact_sinkage(load, d, 0.5 * d, modulus, [n - h, n + h]).sinkage
    solved = contact_sinkage(load, d, 0.5 * d, modulus, n)
    assert solved.slope_load == pytest.approx(np.diff(np.log(by_load))[0] / (2 * h), rel=1e-6)
    assert solved.slope_exponent == pytest.approx(
        np.diff(np.log(by_n))[0] / (2 * h), rel=1e-5, abs=1e-7
    )


def test_sinkage_falls_to_nothing_with_the_load() -> None:
    loads = np.array([1e-12, 1e-6, 1e-3, 0.1])
    z = contact_sinkage(loads, 0.2, 0.1, 5e5, 0.8).sinkage
    assert (z > 0).all()
    # without depth the wheel's outline is a parabola, and z a pure power of load
    assert np.diff(np.log(z)) == pytest.approx(np.diff(np.log(loads)) / 1.3, rel=1e-3)


def test_sunk_to_the_axle_is_a_status() -> None:
    axle = float(contact_load(0.1, 0.2, 0.1, 1e5, 0.8))
    solved = contact_sinkage([axle * (1 - 1e-9), axle * (1 + 1e-9)], 0.2, 0.1, 1e5, 0.8)
    assert solved.sunk_to_axle.tolist() == [False, True]
    # the continuation beyond is without a step, so that a fit can pass through
    assert solved.sinkage[1] / solved.sinkage[0] == pytest.approx(1.0, abs=1e-8)


@pytest.mark.parametrize("n", [0.3, 0.9, 1.6])
@pytest.mark.parametrize("over", [1.0 + 1e-3, 3.0, 300.0])
def test_slopes_beyond_the_axle_are_those_of_the_sinkage_given_there(n: float, over: float) -> None:
    d, b, modulus, h = 0.2, 0.1, 1e6, 1e-6
    load = over * float(contact_load(d / 2, d, b, modulus, n))
    solved = contact_sinkage(load, d, b, modulus, n)
    by_load = contact_sinkage(load * np.exp([-h, h]), d, b, modulus, n)
    by_n = contact_sinkage(load, d, b, modulus, [n - h, n + h])
    assert solved.sunk_to_axle & by_load.sunk_to_axle.all() & by_n.sunk_to_axle.all()
    slopes = (np.diff(np.log(each.sinkage))[0] / (2 * h) for each in (by_load, by_n))
    np.testing.assert_allclose([solved.slope_load, solved.slope_exponent], [*slopes], rtol=1e-6)


def test_shape_integral_at_zero_is_a_beta_function() -> None:
    # I(1, 0) = B(1/2, 2) / 2 = 2/3, which (3 - n)/3 meets at n = 1 and nowhere else
    assert shape_integral(1.0, 0.0).value == pytest.approx(2 / 3, rel=1e-15)
    assert shape_integral(0.5, 0.0).value != pytest.approx(2.5 / 3, rel=1e-2)


def test_arguments_broadcast() -> None:
    solved = contact_sinkage(np.array([[20.0], [40.0]]), np.array([0.1, 0.2, 0.3]), 0.1, 5e5, 0.8)
    assert solved.sinkage.shape == (2, 3)
    alone = contact_sinkage(40.0, 0.3, 0.1, 5e5, 0.8).sinkage
    assert solved.sinkage[1, 2] == pytest.approx(float(alone), rel=1e-15)


def test_rows_do_not_influence_each_other() -> None:
    """Blocks of rows share their number of terms; the result may not depend on the neighbours."""
    rng = np.random.default_rng(3)
    load, n = rng.uniform(1, 500, 10_000), rng.uniform(0.05, 2.9, 10_000)
    together = contact_sinkage(load, 0.2, 0.1, 3e5, n).sinkage
    some = slice(4000, 4200)  # across the border of two blocks
    assert together[some] == pytest.approx(
        contact_sinkage(load[some], 0.2, 0.1, 3e5, n[some]).sinkage, rel=1e-13
    )
