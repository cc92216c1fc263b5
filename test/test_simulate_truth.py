from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from smallwheel_ros.simulate.hidden import (
    EFFECTS,
    check_hidden,
    draw_effects,
    hidden_column,
    hidden_names,
)
from smallwheel_ros.simulate.response import wheel_response
from smallwheel_ros.simulate.terrain import soil_of_pressure
from smallwheel_ros.simulate.truth import (
    Circumstances,
    SimulationError,
    TruthSoil,
    bracketed_root,
    motion_resistance,
    static_sinkage,
    supported_load,
)

SOIL = TruthSoil("sand", 1.6e6, 0.8, 0.39)
NORMAL = Circumstances.of(load=[40.0, 80.0], diameter=0.25, width=0.1)


def quad_load(k, n, m, diameter, width, sinkage):
    radius, entry = diameter / 2, np.arccos(1 - 2 * sinkage / diameter)

    def vertical(angle):
        depth = max(radius * (np.cos(angle) - np.cos(entry)), 0.0)
        return k * depth**n * diameter**m * np.cos(angle)

    return width * radius * quad(vertical, 0, entry, epsabs=0, epsrel=1e-11, limit=300)[0]


@pytest.mark.parametrize("n", [0.25, 0.5, 0.8, 1.0, 1.4, 2.1])
@pytest.mark.parametrize("ratio", [0.002, 0.05, 0.2, 0.45])
def test_contact_integral_against_adaptive_quadrature(n, ratio):
    k, m, diameter, width = 9e5, 0.3, 0.22, 0.08

    def law(depth):
        return k * depth**n * diameter**m

    one = np.ones(1)
    sinkage = ratio * diameter * one
    load = supported_load(law, diameter * one, width * one, sinkage)
    assert load[0] == pytest.approx(quad_load(k, n, m, diameter, width, sinkage[0]), rel=4e-6)
    # The horizontal force is the work of compaction, whatever the shape of the contact.
    work = width * k * diameter**m * sinkage[0] ** (n + 1) / (n + 1)
    assert motion_resistance(law, diameter * one, width * one, sinkage)[0] == pytest.approx(
        work, rel=6e-6
    )
    back = static_sinkage(law, load, diameter * one, width * one)
    assert back[0] == pytest.approx(sinkage[0], rel=1e-8)


def test_sinkage_against_quadrature_and_brentq():
    rng = np.random.default_rng(1)
    for load, diameter, width, n, m in zip(
        rng.uniform(10, 150, 12),
        rng.uniform(0.12, 0.5, 12),
        rng.uniform(0.05, 0.2, 12),
        rng.uniform(0.3, 1.3, 12),
        rng.uniform(-0.3, 0.5, 12),
        strict=True,
    ):
        soil = soil_of_pressure("s", 30e3, n, m)
        at = Circumstances.of(load=load, diameter=diameter, width=width)
        expected = brentq(
            lambda z: quad_load(soil.k, n, m, diameter, width, z) - load,  # noqa: B023
            1e-7,
            diameter / 2,
            rtol=1e-11,
        )
        assert wheel_response(soil, (), at).depth[0] == pytest.approx(expected, rel=1e-5)


def test_too_soft_soil_is_nan_and_does_not_spoil_its_neighbour():
    at = Circumstances.of(load=[50.0, 1e6], diameter=0.2, width=0.1)
    response = wheel_response(SOIL, (), at)
    assert np.isfinite(response.depth[0])
    assert np.isnan(response.depth[1])
    assert np.isnan(response.resistance[1])
    alone = wheel_response(SOIL, (), Circumstances.of(load=50.0, diameter=0.2, width=0.1))
    assert response.depth[0] == pytest.approx(alone.depth[0], rel=1e-9)


def test_thrust_grows_with_slip_towards_coulomb():
    slip = np.array([-0.5, -0.1, 0.0, 0.05, 0.2, 0.6, 0.99])
    at = Circumstances.of(load=60.0, diameter=0.25, width=0.1, slip=slip)
    response = wheel_response(SOIL, (), at)
    assert np.all(np.diff(response.thrust) > 0)
    assert response.thrust[2] == 0.0
    area = 0.1 * np.sqrt(response.depth[0] * (0.25 - response.depth[0]))
    limit = SOIL.cohesion * area + 60.0 * np.tan(SOIL.friction_angle)
    assert 0.6 * limit < response.thrust[-1] < limit
    # With no end of shear deformation left, the whole strength is there.
    stiff = TruthSoil("stiff", SOIL.k, SOIL.n, SOIL.m, shear_deformation=1e-7)
    assert wheel_response(stiff, (), at).thrust[-1] == pytest.approx(limit, rel=1e-3)
    assert np.all(response.drawbar_pull == response.thrust - response.resistance)


def test_root_outside_the_bracket_is_its_end():
    low, high = np.zeros(3), np.ones(3)
    root = bracketed_root(lambda x: x - np.array([-1.0, 0.25, 3.0]), low, high, 1e-12)
    assert root == pytest.approx([0.0, 0.25, 1.0])


@pytest.mark.parametrize("form", ["own", "published"])
@pytest.mark.parametrize("name", list(EFFECTS))
def test_strength_zero_is_no_effect(name, form):
    at = Circumstances.of(
        load=[30.0, 90.0, 60.0],
        diameter=[0.2, 0.3, 0.45],
        width=0.08,
        slip=[0.5, -0.4, 0.1],
        speed=0.3,
        pass_number=4.0,
        slip_angle=0.5,
        grouser_height=0.01,
        hidden=0.7,
    )
    (effect,) = draw_effects([name], np.random.default_rng(2), 0.0, form)
    plain, with_it = wheel_response(SOIL, (), at), wheel_response(SOIL, (effect,), at)
    assert with_it.shown_sinkage == pytest.approx(plain.shown_sinkage, rel=1e-9)
    assert with_it.resistance == pytest.approx(plain.resistance, rel=1e-9)


def ratios(name, form, **settings):
    """Sinkage shown and resistance with the effect over those without, shape (rows, 20 draws)."""
    at = Circumstances.of(load=60.0, diameter=0.25, width=0.1, **settings)
    plain = wheel_response(SOIL, (), at)
    out = []
    for seed in range(20):
        effects = draw_effects([name], np.random.default_rng(seed), 1.0, form)
        there = wheel_response(SOIL, effects, at)
        shown = there.shown_sinkage / plain.shown_sinkage
        out.append([shown, there.resistance / plain.resistance])
    return np.moveaxis(np.array(out), 0, -1)


@pytest.mark.parametrize("form", ["own", "published"])
def test_sizes_are_those_of_real_wheels(form):
    sinkage, resistance = ratios("slip_sinkage", form, slip=[0.0, 0.3, 0.6])
    assert np.all(sinkage[0] == 1)
    assert np.all((sinkage[2] > 2) & (sinkage[2] < 3))
    assert np.all((sinkage[1] > 1.2) & (sinkage[1] < sinkage[2]))
    assert np.all(resistance[2] > sinkage[2])  # the work of compaction to the greater depth
    sinkage, _ = ratios("multipass", form, pass_number=[1.0, 5.0])
    assert np.all(sinkage[0] == 1)
    assert np.all((sinkage[1] > 1.35) & (sinkage[1] < 1.65))
    sinkage, _ = ratios("penetration_rate", form, speed=[0.01, 0.5])
    assert np.all((1 - sinkage[1] / sinkage[0] > 0.1) & (1 - sinkage[1] / sinkage[0] < 0.25))
    sinkage, resistance = ratios("bulldozing", form)
    assert np.all(sinkage == 1)
    assert np.all((resistance > 1.15) & (resistance < 1.7))
    sinkage, _ = ratios("skid_sinkage", form, slip=[-0.6, 0.0, 0.6])
    assert np.all(sinkage[1:] == 1)
    assert np.all((sinkage[0] > 2) & (sinkage[0] < 3.5))


@pytest.mark.parametrize(("name", "driver"), [("load", [20.0, 150.0]), ("width", [0.2, 0.03])])
@pytest.mark.parametrize("form", ["own", "published"])
def test_modulus_effects_are_those_of_real_wheels(name, driver, form):
    settings = {"load": 60.0, "width": 0.1, "diameter": 0.3} | {name: driver}
    at = Circumstances.of(**settings)
    for seed in range(20):
        (effect,) = draw_effects(
            [f"{name}_dependent_modulus"], np.random.default_rng(seed), 1.0, form
        )
        low, high = effect.modulus(at)
        exponent = np.log(high / low) / abs(np.log(driver[1] / driver[0]))
        assert 0.15 < exponent < 0.45


def test_offset_is_two_to_three_millimetres_of_the_reading_only():
    for seed in range(20):
        (effect,) = draw_effects(["sinkage_offset"], np.random.default_rng(seed), 1.0, "own")
        response = wheel_response(SOIL, (effect,), NORMAL)
        assert np.all((response.shown_sinkage - response.depth) >= 0.002)
        assert np.all((response.shown_sinkage - response.depth) <= 0.003)


def test_rut_is_shallower_than_the_wheel_was():
    effects = draw_effects(["elastic_rebound"], np.random.default_rng(0), 1.0, "own")
    there, plain = wheel_response(SOIL, effects, NORMAL), wheel_response(SOIL, (), NORMAL)
    assert np.all(there.shown_sinkage < plain.shown_sinkage)
    assert np.all(there.depth == plain.depth)
    assert np.all((there.resistance > 0) & (there.resistance < plain.resistance))


def test_own_forms_differ_from_the_published_ones():
    same = {
        name for name, kind in EFFECTS.items() if kind.formula["own"] == kind.formula["published"]
    }
    assert same == {"sinkage_offset", "unrecorded"}


def test_names():
    assert check_hidden(["none"]) == ()
    assert check_hidden(["slip_sinkage", "column:density", "moisture"]) == (
        "slip_sinkage",
        "column:density",
        "moisture",
    )
    assert hidden_column("column:density") == "density"
    assert hidden_column("bulldozing") is None
    assert set(EFFECTS) < set(hidden_names())
    for wrong, match in [
        (["slip_sinkag"], "did you mean 'slip_sinkage'"),
        (["column:"], "unknown"),
        (["column:a b"], "unknown"),
        (["column:slip"], "meaning of its own"),
        (["none", "bulldozing"], "give either"),
        (["bulldozing", "bulldozing"], "twice"),
        (["moisture", "column:moisture"], "twice"),
    ]:
        with pytest.raises(SimulationError, match=match):
            check_hidden(wrong)


def test_every_effect_describes_itself_in_plain_json():
    names = [name for name in hidden_names() if name not in ("none", "column:NAME")]
    for effect in draw_effects([*names, "column:x"], np.random.default_rng(0), 1.0, "own"):
        told = json.loads(json.dumps(effect.describe(), allow_nan=False))
        assert told["formula"]
        assert told["effect"]
