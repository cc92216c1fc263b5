# SPDX-License-Identifier: Apache-2.0
"""The balance of stresses along the contact, against adaptive quadrature and against itself."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples
from scipy.integrate import quad

from smallwheel_ros.model.model import Model, ModelError, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import Soil, soil
from smallwheel_ros.physics.stresses import (
    ShearLaw,
    closed_form_forces,
    mean_place,
    rim_friction,
    wheel_forces,
)

WHEELS = st.fixed_dictionaries(
    {
        "load": st.floats(5.0, 300.0),
        "diameter": st.floats(0.1, 0.5),
        "deep": st.floats(0.01, 0.2),  # z/D
        "aspect": st.floats(0.2, 0.8),
        "exponent": st.floats(0.4, 1.8),
        "cohesion": st.floats(0.0, 600.0),
        "friction": st.floats(0.35, 0.75),
        "modulus": st.floats(0.004, 0.03),
        "rolling": st.floats(0.0, 2.0),
        "mu": st.floats(0.6, 1.0),
        "lugs": st.sampled_from([0.0, 0.03, 0.08]),  # h/D
    }
)
DRIVEN, SKIDDING = st.floats(0.0, 0.95), st.floats(-0.95, -0.01)


def by_quadrature(
    w: dict[str, float], slip: float, beta: float = 0.0, peak: float = 0.0
) -> tuple[float, float]:
    """Pull (N) and torque (N m) by adaptive quadrature, in TRACTION's terms and not the module's code."""
    r = 0.5 * w["diameter"]
    big, z, b = r + 0.5 * w["lugs"] * w["diameter"], w["deep"] * w["diameter"], w["aspect"] * r
    entry = math.acos(1.0 - z / r)
    u = 1.0 - slip if slip >= 0.0 else 1.0 / (1.0 + slip)
    c, tangent = w["cohesion"], math.tan(w["friction"])

    def displacement(t: float) -> float:
        rim = math.sin(entry) - math.sin(t)
        return big * (w["rolling"] * (entry - t - rim) + (1.0 - u) * rim)

    def called(t: float) -> float:
        j = displacement(t)
        length = math.hypot(j, big * u * math.tan(beta) * (entry - t))
        mu = w["mu"] if j > 0.0 else 1.0  # soil sticks ahead of a rim that is dragged
        return 0.0 if length == 0.0 else mu * j / length * -math.expm1(-length / w["modulus"])

    top = peak * entry

    def shape(t: float) -> float:
        t = entry - t / top * (entry - top) if t < top else t
        return max(r * (math.cos(t) - math.cos(entry)) / z, 0.0) ** w["exponent"]

    inside = np.linspace(0.0, entry, 400)[1:-1]
    signs = np.sign([displacement(t) for t in inside])
    kinks = inside[np.flatnonzero(np.diff(signs))].tolist() + [top] * (peak > 0.0)

    def over(f) -> float:  # type: ignore[no-untyped-def]
        return quad(f, 0.0, entry, limit=400, points=kinks or None)[0]

    up, back = over(lambda t: shape(t) * math.cos(t)), over(lambda t: shape(t) * math.sin(t))
    rubbed = [
        over(lambda t, g=g: shape(t) * called(t) * g(t))
        for g in (math.sin, math.cos, lambda t: 1.0)
    ]
    held = [over(lambda t, g=g: called(t) * g(t)) for g in (math.sin, math.cos, lambda t: 1.0)]
    p = (w["load"] / b - c * big * held[0]) / (r * up + big * tangent * rubbed[0])
    pull = b * (big * (c * held[1] + p * tangent * rubbed[1]) - r * p * back)
    return pull, b * big**2 * (c * held[2] + p * tangent * rubbed[2])


def by_nodes(
    w: dict[str, float], slip: float, beta: float = 0.0, peak: float = 0.0
) -> tuple[float, float, float]:
    shear = ShearLaw(w["cohesion"], w["friction"], w["modulus"], w["rolling"], w["mu"])
    d = w["diameter"]
    found = wheel_forces(
        w["load"], w["deep"] * d, d, 0.5 * w["aspect"] * d, slip, w["exponent"], shear,
        lug_height=w["lugs"] * d, slip_angle=beta, peak=peak,
    )  # fmt: skip
    pull, torque, load = found.thrust - found.resistance, found.torque, found.load
    return float(pull), float(torque), float(load)


@settings(max_examples=examples(60), deadline=None)
@given(w=WHEELS, slip=DRIVEN)
def test_driven_wheels_by_quadrature(w: dict[str, float], slip: float) -> None:
    pull, torque, load = by_nodes(w, slip)
    expected = by_quadrature(w, slip)
    assert load == pytest.approx(w["load"], rel=1e-12)
    # Shear that starts forward (slip 0 with little rolling) has a kink, as where a wheel skids.
    assert pull == pytest.approx(expected[0], abs=2e-6 * w["load"])
    assert torque == pytest.approx(expected[1], abs=2e-6 * w["load"] * w["diameter"])


@settings(max_examples=examples(60), deadline=None)
@given(w=WHEELS, slip=DRIVEN, peak=st.floats(0.005, 0.7))
def test_a_peak_of_the_pressure_by_quadrature(
    w: dict[str, float], slip: float, peak: float
) -> None:
    pull, torque, _ = by_nodes(w, slip, peak=peak)
    expected = by_quadrature(w, slip, peak=peak)
    assert pull == pytest.approx(expected[0], abs=2e-6 * w["load"])
    assert torque == pytest.approx(expected[1], abs=2e-6 * w["load"] * w["diameter"])


@settings(max_examples=examples(60), deadline=None)
@given(w=WHEELS, slip=SKIDDING, beta=st.sampled_from([0.0, 0.2]))
def test_skidding_wheels_by_quadrature(w: dict[str, float], slip: float, beta: float) -> None:
    pull, torque, _ = by_nodes(w, slip, beta)
    expected = by_quadrature(w, slip, beta)
    assert pull == pytest.approx(expected[0], abs=5e-4 * w["load"])  # shear is steep where j = 0
    assert torque == pytest.approx(expected[1], abs=5e-4 * w["load"] * w["diameter"])


@settings(max_examples=examples(60), deadline=None)
@given(w=WHEELS)
def test_forces_are_continuous_at_slip_0(w: dict[str, float]) -> None:
    """A bare rim's mu takes hold as the rim begins to slide: no force jumps where a wheel begins to skid."""
    before, at, after = (by_nodes(w, slip) for slip in (-1e-7, 0.0, 1e-7))
    for pull, torque, load in (before, after):
        assert pull == pytest.approx(at[0], abs=1e-4 * w["load"])
        assert torque == pytest.approx(at[1], abs=1e-4 * w["load"] * w["diameter"])
        assert load == pytest.approx(w["load"])


def test_pull_rises_with_slip_through_0() -> None:
    slip = np.linspace(-0.2, 0.2, 81)
    found = predict(Model("dry_sand"), Conditions.of(60.0, 0.25, 0.1, slip=slip))
    assert found.drawbar_pull is not None
    assert (np.diff(found.drawbar_pull) > 0.0).all()


def test_the_closed_form_is_near() -> None:
    """Over wheels as they are: 0.004 of the load in the mean where driven."""
    rng = np.random.default_rng(4)
    off = []
    for _ in range(500):
        w = {
            "load": rng.uniform(10, 200), "diameter": rng.uniform(0.1, 0.5), "deep": rng.uniform(0.02, 0.15),
            "aspect": rng.uniform(0.4, 1.0), "exponent": rng.uniform(0.7, 1.3), "cohesion": 300.0,
            "friction": rng.uniform(0.45, 0.65), "modulus": rng.uniform(0.006, 0.02), "mu": 0.8,
            "rolling": rng.uniform(1.0, 1.6), "lugs": 0.0,
        }  # fmt: skip
        slip, d = rng.uniform(0.0, 0.9), w["diameter"]
        pull, torque, _ = by_nodes(w, slip)
        found = closed_form_forces(
            w["load"], w["deep"] * d, d, 0.5 * w["aspect"] * d, slip, mean_place(w["exponent"]),
            w["cohesion"], math.tan(w["friction"]), w["modulus"], w["rolling"], w["mu"],
        )  # fmt: skip
        off.append([(found[0] - pull) / w["load"], (found[1] - torque) / (w["load"] * 0.5 * d)])
    assert np.sqrt(np.mean(np.square(off), axis=0)) == pytest.approx(0.0, abs=0.005)
    assert np.abs(off).max() < 0.05


def test_mean_place_of_a_spring() -> None:
    place = mean_place(1.0)
    assert place.mean == pytest.approx(0.375)
    assert place.deviation == pytest.approx(math.sqrt(0.2 - 0.375**2))


@settings(max_examples=examples(100))
@given(w=WHEELS, slip=st.one_of(DRIVEN, SKIDDING))
def test_no_pull_is_beyond_what_friction_holds_at_this_sinkage(
    w: dict[str, float], slip: float
) -> None:
    w = w | {"cohesion": 0.0, "lugs": 0.0}
    pull, _, _ = by_nodes(w, slip)
    entry = math.acos(1.0 - 2.0 * w["deep"])
    most = math.tan(w["friction"] - mean_place(w["exponent"]).mean * entry) * w["load"]
    assert pull <= most + 0.02 * w["load"]


def test_a_deeper_rut_costs_what_its_arc_says_and_not_the_power_of_depth() -> None:
    """Effects deepen the rut under the load as it is: resistance is about W tan(kappa t1)."""
    sand = Soil("sand", 1.6e6, 1.0)
    rows = Conditions.of(60.0, 0.2, 0.1, slip=[0.0, 0.6])
    base, dug = (
        predict(model, rows) for model in (Model(sand), Model(sand) + "slip_sinkage/added_depth")
    )
    assert dug.sinkage[1] > 1.5 * base.sinkage[1]
    assert dug.rolling_resistance is not None
    entry = np.arccos(1.0 - dug.sinkage / 0.1)
    # Shear lifts a little, so pressure has less to carry.
    assert dug.rolling_resistance == pytest.approx(60.0 * np.tan(0.375 * entry), rel=0.3)
    for found in (base, dug):
        assert found.thrust is not None
        assert found.drawbar_pull == pytest.approx(found.thrust - found.rolling_resistance)


def test_mu_is_of_bare_rims() -> None:
    assert rim_friction(0.8, [0.0, 0.01]).tolist() == [0.8, 1.0]


def test_a_pressed_wheel_pulls_nothing_and_a_blank_slip_is_refused() -> None:
    rows = Conditions.of(60.0, 0.2, 0.1, contact=["rolling", "pressed"], slip=[0.3, np.nan])
    found = predict(Model("dry_sand"), rows)
    assert found.drawbar_pull is not None
    assert found.torque is not None
    assert found.drawbar_pull[1] == found.torque[1] == 0.0
    with pytest.raises(ModelError, match="slip is blank in row 2"):
        predict(Model("dry_sand"), Conditions.of(60.0, 0.2, 0.1, slip=[0.3, np.nan]))


@pytest.mark.parametrize("slip", [-0.3, 0.0, 0.3, 0.8])
def test_wong_and_reece_balance_the_load_with_k(slip: float) -> None:
    """Against quadrature of their two arcs, at the sinkage that the model solved."""
    sand, load, d, b = soil("wong_dry_sand"), 80.0, 0.3, 0.15
    found = predict(Model(sand, thrust_form="wong_reece"), Conditions.of(load, d, b, slip=slip))
    r, z = 0.5 * d, float(found.sinkage[0])
    entry = math.acos(1.0 - z / r)
    top = (0.4 + 0.3 * max(slip, 0.0)) * entry
    u = 1.0 - slip if slip >= 0.0 else 1.0 / (1.0 + slip)
    modulus = sand.k * d**sand.m

    def pressure(t: float) -> float:
        at = t if t >= top else entry - t / top * (entry - top)
        return modulus * max(r * (math.cos(at) - math.cos(entry)), 0.0) ** sand.n

    def shear(t: float) -> float:
        j = r * ((entry - t) - u * (math.sin(entry) - math.sin(t)))
        limit = sand.cohesion + pressure(t) * math.tan(sand.friction_angle)
        return math.copysign(-math.expm1(-abs(j) / sand.shear_displacement), j) * limit

    def over(f) -> float:  # type: ignore[no-untyped-def]
        return quad(f, 0.0, top, limit=200)[0] + quad(f, top, entry, limit=200)[0]

    carried = b * r * over(lambda t: pressure(t) * math.cos(t) + shear(t) * math.sin(t))
    assert carried == pytest.approx(load, rel=0.02)
    assert found.drawbar_pull is not None
    pull = b * r * over(lambda t: shear(t) * math.cos(t) - pressure(t) * math.sin(t))
    assert float(found.drawbar_pull[0]) == pytest.approx(pull, abs=0.02 * load)
