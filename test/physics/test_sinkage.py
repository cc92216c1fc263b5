# SPDX-License-Identifier: Apache-2.0
"""Closed form, plates and layered soils."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from random_examples import examples
from scipy.integrate import quad

from smallwheel_ros.physics.contact import contact_load, contact_sinkage
from smallwheel_ros.physics.sinkage import (
    closed_form,
    closed_form_sinkage,
    compaction_resistance,
    layered_work,
    loads_by_depth,
    plate_sinkage,
    solve_layered,
)

# Sinkage by eq. 10 over the contact integral's, by n and z/D: the project's reference table.
RATIO_TABLE = {
    0.5: (0.939, 0.925, 0.906, 0.888, 0.869, 0.829),
    0.8: (0.970, 0.960, 0.948, 0.935, 0.922, 0.894),
    1.0: (0.998, 0.990, 0.980, 0.969, 0.958, 0.935),
    1.2: (1.029, 1.023, 1.014, 1.005, 0.996, 0.977),
    1.5: (1.084, 1.079, 1.072, 1.064, 1.057, 1.042),
}


@pytest.mark.parametrize("n", RATIO_TABLE)
def test_how_far_the_closed_form_is_off(n: float) -> None:
    z = 0.2 * np.array([0.01, 0.05, 0.10, 0.15, 0.20, 0.30])
    load = contact_load(z, 0.2, 0.1, 1e6, n)
    ratio = closed_form_sinkage(load, 0.2, 0.1, 1e6, n) / z
    assert ratio == pytest.approx(RATIO_TABLE[n], abs=0.0016)


def test_closed_form_by_hand() -> None:
    # n = 1/2, D = 1/4, m = 1/2: z = [3 W / (b 2.5 k D)]^1 with D^(m + 1/2) = D
    both = closed_form(2.0, 0.25, 0.1, 24_000.0, 0.5, 0.5)
    z = 3 * 2.0 / (0.1 * 2.5 * 24_000.0 * 0.25)
    assert both.sinkage == pytest.approx(z, rel=1e-14)
    work = 0.1 * 24_000.0 * 0.5 * z**1.5 / 1.5
    assert both.compaction_resistance == pytest.approx(work, rel=1e-14)


def test_closed_form_in_blocks() -> None:
    rng = np.random.default_rng(5)
    rows = 10_001
    load, d, b = rng.uniform(0.1, 1e4, rows), rng.uniform(0.05, 0.6, rows), rng.uniform(0.03, 0.3)
    k, n, m = np.exp(rng.uniform(9, 15, rows)), rng.uniform(0.05, 2.9, rows), -0.4
    both = closed_form(load, d, b, k, n, m)
    modulus = k * d**m
    assert both.sinkage == pytest.approx(closed_form_sinkage(load, d, b, modulus, n), rel=1e-11)
    assert both.compaction_resistance == pytest.approx(
        compaction_resistance(both.sinkage, b, modulus, n), rel=1e-11
    )
    assert closed_form(load[:0], 0.2, b, 1e6, 0.8, m).sinkage.shape == (0,)
    assert closed_form([[10.0], [20.0]], [0.1, 0.2, 0.3], b, 1e6, 0.8, m).sinkage.shape == (2, 3)


def test_plate_by_hand() -> None:
    # 0.1 m across: 7.854e-3 m2; 78.54 N are 10 kPa, which k = 1 MPa/m reaches at 10 mm
    assert plate_sinkage(78.5398163, 0.1, 1e6, 1.0) == pytest.approx(0.01, rel=1e-8)


@pytest.mark.parametrize("n", [0.05, 0.3, 0.8, 1.3, 2.5])
def test_layered_load_without_layers_is_the_contact_integral(n: float) -> None:
    z = 0.2 * np.array([1e-4, 0.02, 0.1, 0.3, 0.5])
    modulus, exponent = np.full(5, 1e6), np.full(5, n)
    depth, borne = loads_by_depth(z, np.full(5, 0.2), np.full(5, 0.1), modulus, exponent)
    assert depth.min() > 0.0
    assert (depth < z).all()
    assert borne.sum(axis=0) == pytest.approx(contact_load(z, 0.2, 0.1, 1e6, n), rel=1e-9)


def test_layered_solve_without_layers_is_the_contact_integral() -> None:
    load = np.array([0.1, 5.0, 60.0, 300.0])
    d, b, k, n = (np.full(4, v) for v in (0.2, 0.1, 8e5, 0.8))
    z, sunk = solve_layered(load, d / 2, lambda x: loads_by_depth(x, d, b, k, n)[1].sum(axis=0))
    assert z == pytest.approx(contact_sinkage(load, 0.2, 0.1, 8e5, 0.8).sinkage, rel=1e-9)
    assert not sunk.any()


@given(
    wall=st.floats(1e-4, 0.09), steep=st.floats(1.0, 500.0), load=st.floats(0.1, 500.0),
    n=st.floats(0.6, 2.5),
)  # fmt: skip
@settings(max_examples=examples(60))
def test_layered_solve_meets_the_load_at_a_wall_too(
    wall: float, steep: float, load: float, n: float
) -> None:
    """A wheel comes to rest within a fraction of a hard layer, beside one that meets none."""
    given_load = np.array([load, load])
    walls = np.array([wall, 1.0])

    def load_at(z: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(
            1e5 * z**n * np.exp(np.minimum(steep * np.maximum(z / walls - 1.0, 0.0), 600.0))
        )

    z, sunk = solve_layered(given_load, np.array([0.1, 0.1]), load_at)
    assert load_at(z)[~sunk] == pytest.approx(given_load[~sunk], rel=1e-9)
    assert (load_at(np.array([0.1, 0.1]))[sunk] < load).all()


@given(n=st.floats(0.05, 2.9), z=st.floats(1e-5, 0.2), stiffening=st.floats(0.0, 80.0))
@settings(max_examples=examples(60))
def test_layered_work_is_the_work_of_the_pressure(n: float, z: float, stiffening: float) -> None:
    work = layered_work(
        np.array([z]), np.array([1e6]), np.array([n]), lambda x: 1.0 + stiffening * x
    )
    exact = 1e6 * (z ** (n + 1) / (n + 1) + stiffening * z ** (n + 2) / (n + 2))
    assert work[0] == pytest.approx(exact, rel=1e-9)


@given(n=st.floats(0.05, 2.9), z=st.floats(1e-5, 0.3), modulus=st.floats(1e3, 1e8))
@settings(max_examples=examples(60))
def test_resistance_is_the_work_of_the_pressure(n: float, z: float, modulus: float) -> None:
    # z u^2 in place of the depth, against the singular slope of a small power
    work = quad(lambda u: modulus * (z * u * u) ** n * 2 * z * u, 0, 1, epsabs=0, epsrel=1e-12)[0]
    assert compaction_resistance(z, 0.1, modulus, n) == pytest.approx(0.1 * work, rel=1e-9)


@pytest.mark.parametrize(("n", "small"), [(0.5, 0.85), (1.0, 0.75), (1.5, 0.68)])
def test_resistance_over_load_is_free_of_k(n: float, small: float) -> None:
    """Rc/W = c(n) sqrt(z/D), whatever k is: the check that needs no calibration."""
    ratio = np.array([1e-5, 0.1, 0.3])
    for modulus in (1e4, 1e7):
        load = contact_load(0.3 * ratio, 0.3, 0.12, modulus, n)
        c = compaction_resistance(0.3 * ratio, 0.12, modulus, n) / load / np.sqrt(ratio)
        assert c[0] == pytest.approx(small, abs=0.005)
        assert 0.02 < c[1] / c[0] - 1 < 0.05
        assert 0.08 < c[2] / c[0] - 1 < 0.14
