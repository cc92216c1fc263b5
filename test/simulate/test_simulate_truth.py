# SPDX-License-Identifier: Apache-2.0
"""Tests `hidden.py`, `truth.py` and `wheel_laws.py`."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from smallwheel_ros.measurements.columns import COLUMNS
from smallwheel_ros.simulate.hidden import EFFECTS, HiddenEffect, HiddenLaw, shown_by_instrument
from smallwheel_ros.simulate.settings import (
    Asked,
    SimulationError,
    check_hidden,
    draw_effects,
    hidden_names,
)
from smallwheel_ros.simulate.truth import (
    Circumstances,
    Contact,
    TruthSoil,
    bracketed_root,
    soil_of_pressure,
    static_sinkage,
    supported_load,
)
from smallwheel_ros.simulate.wheel_laws import WheelsOnSoil, shear_stress

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
    contact = Contact.at(diameter * one, sinkage)
    back = contact.backward(law(contact.depth), width * one)
    assert back[0] == pytest.approx(work, rel=6e-6)
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
        assert WheelsOnSoil(soil, (), at).response().depth[0] == pytest.approx(expected, rel=1e-5)


def test_too_soft_soil_is_nan_and_does_not_spoil_its_neighbour():
    at = Circumstances.of(load=[50.0, 1e6], diameter=0.2, width=0.1)
    response = WheelsOnSoil(SOIL, (), at).response()
    assert np.isfinite(response.depth[0])
    assert np.isnan(response.depth[1])
    assert np.isnan(response.resistance[1])
    alone = WheelsOnSoil(SOIL, (), Circumstances.of(load=50.0, diameter=0.2, width=0.1)).response()
    assert response.depth[0] == pytest.approx(alone.depth[0], rel=1e-9)


def test_thrust_grows_with_slip_towards_coulomb():
    slip = np.array([-0.5, -0.1, 0.0, 0.05, 0.2, 0.6, 0.99])
    at = Circumstances.of(load=60.0, diameter=0.25, width=0.1, slip=slip)
    response = WheelsOnSoil(SOIL, (), at).response()
    assert np.all(np.diff(response.thrust) > 0)
    assert response.thrust[2] == 0.0
    area = 0.1 * np.sqrt(response.depth[0] * (0.25 - response.depth[0]))
    limit = SOIL.cohesion * area + 60.0 * np.tan(SOIL.friction_angle)
    assert 0.6 * limit < response.thrust[-1] < limit
    # With no end of shear deformation left, the whole strength is there.
    stiff = TruthSoil("stiff", SOIL.k, SOIL.n, SOIL.m, shear_deformation=1e-7)
    assert WheelsOnSoil(stiff, (), at).response().thrust[-1] == pytest.approx(limit, rel=1e-3)
    assert np.all(response.drawbar_pull == response.thrust - response.resistance)


def test_torque_is_the_shear_along_the_arc_times_the_radius():
    """The power at the axle is that of the rim: T = b r^2 times the integral of shear."""
    slip = np.array([-0.4, 0.0, 0.1, 0.3, 0.8])
    at = Circumstances.of(load=60.0, diameter=0.25, width=0.1, slip=slip)
    found = WheelsOnSoil(SOIL, (), at).response()
    contact = Contact.at(at.diameter, found.depth)
    pressure = SOIL.k * 0.25**SOIL.m * contact.depth**SOIL.n
    shear = shear_stress(pressure, contact, SOIL, at)
    by_hand = 0.1 * 0.125**2 * np.sum(shear * contact.weight, axis=1)
    assert found.torque == pytest.approx(by_hand, rel=1e-12)
    assert found.torque[1] == 0.0
    # the lever of shear on an arc is longer than the radius, by no more than 1 / cos(entry)
    lever = found.torque[slip != 0] / found.thrust[slip != 0]
    assert np.all((lever > 0.125) & (lever < 0.125 / np.cos(contact.entry[0])))


def test_root_outside_the_bracket_is_its_end():
    low, high = np.zeros(3), np.ones(3)
    root = bracketed_root(lambda x: x - np.array([-1.0, 0.25, 3.0]), low, high, 1e-12)
    assert root == pytest.approx([0.0, 0.25, 1.0])


@pytest.mark.parametrize("name", list(EFFECTS))
def test_strength_zero_is_no_effect(name):
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
    (effect,) = draw_effects([name], np.random.default_rng(2), 0.0)
    plain, with_it = (
        WheelsOnSoil(SOIL, (), at).response(),
        WheelsOnSoil(SOIL, (effect,), at).response(),
    )
    assert with_it.shown_sinkage == pytest.approx(plain.shown_sinkage, rel=1e-9)
    assert with_it.resistance == pytest.approx(plain.resistance, rel=1e-9)


def ratios(name, **settings):
    """Sinkage shown and resistance with the effect over those without, shape (rows, 20 draws)."""
    at = Circumstances.of(load=60.0, diameter=0.25, width=0.1, **settings)
    plain = WheelsOnSoil(SOIL, (), at).response()
    out = []
    for seed in range(20):
        effects = draw_effects([name], np.random.default_rng(seed))
        there = WheelsOnSoil(SOIL, effects, at).response()
        shown = there.shown_sinkage / plain.shown_sinkage
        out.append([shown, there.resistance / plain.resistance])
    return np.moveaxis(np.array(out), 0, -1)


def test_sizes_are_those_of_real_wheels():
    sinkage, resistance = ratios("slip_sinkage", slip=[0.0, 0.3, 0.6])
    assert sinkage[0] == pytest.approx(1.0, abs=1e-8)
    assert np.all((sinkage[2] > 2) & (sinkage[2] < 3))
    assert np.all((sinkage[1] > 1.2) & (sinkage[1] < sinkage[2]))
    # The stress moves forward: the front has the soil of the greater depth to push down.
    assert np.all(resistance[2] > np.sqrt(sinkage[2]))
    sinkage, _ = ratios("multipass", pass_number=[1.0, 2.0, 3.0, 4.0, 5.0])
    assert sinkage[0] == pytest.approx(1.0, abs=1e-8)
    assert np.all((sinkage[4] > 1.3) & (sinkage[4] < 1.7))
    assert np.all(np.diff(sinkage, axis=0) > 0)
    assert np.all(np.diff(sinkage, n=2, axis=0) < 0)  # ever less
    sinkage, _ = ratios("penetration_rate", speed=[0.01, 0.5])
    assert np.all((1 - sinkage[1] / sinkage[0] > 0.1) & (1 - sinkage[1] / sinkage[0] < 0.25))
    sinkage, resistance = ratios("bulldozing")
    assert sinkage == pytest.approx(1.0, abs=1e-8)
    assert np.all((resistance > 1.15) & (resistance < 1.7))
    sinkage, _ = ratios("skid_sinkage", slip=[-0.6, 0.0, 0.6])
    assert sinkage[1:] == pytest.approx(1.0, abs=1e-8)
    assert np.all((sinkage[0] > 2) & (sinkage[0] < 3.5))


@pytest.mark.parametrize(("name", "driver"), [("load", [20.0, 150.0]), ("width", [0.2, 0.03])])
def test_modulus_effects_are_those_of_real_wheels(name, driver):
    settings = {"load": 60.0, "width": 0.1, "diameter": 0.3} | {name: driver}
    at = Circumstances.of(**settings)
    plain = WheelsOnSoil(SOIL, (), at).response().depth
    for seed in range(10):
        effects = draw_effects([f"{name}_dependent_modulus"], np.random.default_rng(seed))
        low, high = (WheelsOnSoil(SOIL, effects, at).response().depth / plain) ** -(SOIL.n + 0.5)
        exponent = np.log(high / low) / abs(np.log(driver[1] / driver[0]))
        assert 0.15 < exponent < 0.45


# What each effect does to (sinkage shown, resistance shown) where its driver grows.
DIRECTIONS = {
    "slip_sinkage": ({"slip": 0.5}, 1, 1),
    "skid_sinkage": ({"slip": -0.5}, 1, 1),
    "slip_angle_sinkage": ({"slip_angle": 0.6}, 1, 1),
    "bulldozing": ({}, 0, 1),
    "penetration_rate": ({"speed": 0.4}, -1, -1),
    "load_dependent_modulus": ({}, -1, -1),
    "width_dependent_modulus": ({}, -1, -1),
    "multipass": ({"pass_number": 5.0}, 1, None),  # less of the front, more of the depth
    "hardpan": ({"load": 140.0}, -1, -1),
    "grouser": ({"slip": 0.5, "grouser_height": 0.01}, 1, 1),
    "elastic_rebound": ({}, -1, -1),
    "unrecorded": ({"hidden": 1.0}, -1, -1),
    "sinkage_offset=0.002": ({}, 1, 0),
    "sinkage_offset=-0.002": ({}, -1, 0),
    "sinkage_gain=-0.1": ({}, -1, 0),
    "load_offset=4": ({}, 0, 0),
    "load_gain=0.1": ({}, 0, 0),
    "resistance_offset=-2": ({}, 0, -1),
    "resistance_gain=0.1": ({}, 0, 1),
    "rig_friction": ({}, 0, 1),
    "slip_resistance": ({"slip": 0.5}, 0, 1),
}


def test_directions_cover_all_effects():
    assert {text.partition("=")[0] for text in DIRECTIONS} == set(EFFECTS)


@pytest.mark.parametrize("text", list(DIRECTIONS))
def test_each_effect_moves_its_channels_in_its_direction(text):
    settings, deeper, harder = DIRECTIONS[text]
    at = Circumstances.of(**({"load": 60.0, "diameter": 0.25, "width": 0.1} | settings))
    effects = draw_effects([text], np.random.default_rng(5))
    plain, there = WheelsOnSoil(SOIL, (), at).response(), WheelsOnSoil(SOIL, effects, at).response()

    def direction(after, before):
        return int(np.sign(np.where(np.abs(after / before - 1) < 1e-3, 0.0, after - before))[0])

    assert direction(there.shown_sinkage, plain.shown_sinkage) == deeper
    if harder is not None:
        assert direction(there.shown_resistance, plain.shown_resistance) == harder
    if effects[0].law.stage.startswith("shown_"):  # the wheel does not notice
        assert np.array_equal(there.depth, plain.depth)
        assert np.array_equal(there.drawbar_pull, plain.drawbar_pull)


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("slip_sinkage", {"slip": 0.0}),
        ("slip_sinkage", {"slip": -0.5}),
        ("skid_sinkage", {"slip": 0.5}),
        ("slip_angle_sinkage", {"slip_angle": 0.0}),
        ("multipass", {"pass_number": 1.0}),
        ("grouser", {"slip": 0.5, "grouser_height": 0.0}),
        ("slip_resistance", {"slip": 0.0}),
        ("penetration_rate", {"speed": 1e-9}),
        ("hardpan", {"load": 5.0}),
    ],
)
def test_without_its_driver_an_effect_is_not_there(name, settings):
    at = Circumstances.of(**({"load": 60.0, "diameter": 0.25, "width": 0.1} | settings))
    effects = draw_effects([name], np.random.default_rng(5))
    plain, there = WheelsOnSoil(SOIL, (), at).response(), WheelsOnSoil(SOIL, effects, at).response()
    assert there.shown_sinkage == pytest.approx(plain.shown_sinkage, rel=1e-3)
    assert there.shown_resistance == pytest.approx(plain.shown_resistance, rel=1e-3)


# Stress at an angle over that of the untouched soil, written down anew from the formulas.
def _slipping(angle, entry, amplitude):
    carried = 0.5 * (1 - np.sin(angle) / np.sin(entry))
    return 1 / (1 + (amplitude * carried) ** 1.7)


def _fast(angle, entry, amplitude):
    x = 0.3 * np.sin(angle) / 0.02
    return 1 + amplitude * x / (1 + x)


def _loaded(angle, entry, amplitude):
    return 1 + amplitude * 0.5 * (1 - 0.1 * (angle / entry) ** 2)


def _edged(angle, entry, amplitude):
    zone = 0.02 + 0.125 * (np.cos(angle) - np.cos(entry))
    inner = quad(lambda y: np.exp(-y / zone), 0, 0.05, epsrel=1e-10)[0]
    return 1 + amplitude * inner / 0.05  # mean over half the width


@pytest.mark.parametrize(
    ("name", "share"),
    [
        ("slip_sinkage", _slipping),
        ("penetration_rate", _fast),
        ("load_dependent_modulus", _loaded),
        ("width_dependent_modulus", _edged),
    ],
)
def test_effects_inside_the_contact_against_adaptive_quadrature(name, share):
    """Both channels are components of one stress over the arc."""
    (effect,) = draw_effects([name], np.random.default_rng(3))
    at = Circumstances.of(load=60.0, diameter=0.25, width=0.1, slip=0.5, speed=0.3)
    there = WheelsOnSoil(SOIL, (effect,), at).response()
    entry = np.arccos(1 - there.depth[0] / 0.125)

    def force(component):
        def density(angle):
            depth = max(0.125 * (np.cos(angle) - np.cos(entry)), 0.0)
            pressure = SOIL.k * depth**SOIL.n * 0.25**SOIL.m
            return pressure * share(angle, entry, effect.amplitude) * component(angle)

        return 0.1 * 0.125 * quad(density, 0, entry, epsabs=0, epsrel=1e-9, limit=200)[0]

    assert force(np.cos) == pytest.approx(60.0, rel=3e-5)
    assert force(np.sin) == pytest.approx(there.resistance[0], rel=3e-5)


def test_slip_moves_the_stress_forward():
    """More resistance than the same sinkage gain by a softer soil: Wong and Reece's peak."""
    (effect,) = draw_effects(["slip_sinkage"], np.random.default_rng(0))
    slipping = replace(NORMAL, slip=np.full(2, 0.5))
    there = WheelsOnSoil(SOIL, (effect,), slipping).response()
    plain = WheelsOnSoil(SOIL, (), slipping).response()
    softer = (plain.depth / there.depth) ** (SOIL.n + 0.5)
    soft = WheelsOnSoil(SOIL, (), slipping, scatter=softer).response()
    assert soft.depth == pytest.approx(there.depth, rel=0.1)
    assert np.all(there.resistance / there.depth**0.5 > 1.2 * soft.resistance / soft.depth**0.5)


def test_later_passes_go_down_to_a_limit():
    at = Circumstances.of(load=60.0, diameter=0.25, width=0.1, pass_number=[1.0, 2.0, 30.0, 40.0])
    effects = draw_effects(["multipass"], np.random.default_rng(0))
    depth = WheelsOnSoil(SOIL, effects, at).response().depth
    assert depth[1] > 1.1 * depth[0]
    assert depth[3] == pytest.approx(depth[2], rel=1e-6)
    # In the limit all of the contact is in loose soil, at most as deep as in one so soft throughout.
    soft = WheelsOnSoil(SOIL, (), at, scatter=1.0 - effects[0].amplitude).response().depth
    assert np.all(depth < soft)


def test_stiff_layer_stops_the_wheel():
    at = Circumstances.of(load=[20.0, 150.0, 400.0], diameter=0.25, width=0.05)
    (effect,) = draw_effects(["hardpan"], np.random.default_rng(0), 10.0)
    plain, there = (
        WheelsOnSoil(SOIL, (), at).response().depth,
        WheelsOnSoil(SOIL, (effect,), at).response().depth,
    )
    assert there[0] == pytest.approx(plain[0], rel=0.02)
    assert there[2] < 1.7 * effect.numbers["level"] < plain[2]


def test_offset_is_two_to_three_millimetres_of_the_reading_only():
    for seed in range(20):
        (effect,) = draw_effects(["sinkage_offset"], np.random.default_rng(seed))
        response = WheelsOnSoil(SOIL, (effect,), NORMAL).response()
        assert np.all((response.shown_sinkage - response.depth) >= 0.002)
        assert np.all((response.shown_sinkage - response.depth) <= 0.003)


def test_faults_are_as_large_as_said():
    names = ("sinkage", "resistance", "load")
    true = {"sinkage": np.array([0.01]), "resistance": np.array([8.0]), "load": np.array([60.0])}
    at = Circumstances.of(load=60.0, diameter=0.25, width=0.1, slip=0.4)
    expected = {
        "sinkage_gain=-0.1": [0.009, 8.0, 60.0],
        "sinkage_offset=-0.001": [0.009, 8.0, 60.0],
        "load_gain=0.1": [0.01, 8.0, 66.0],
        "load_offset=-4": [0.01, 8.0, 56.0],
        "resistance_gain=0.1": [0.01, 8.8, 60.0],
        "resistance_offset=-2": [0.01, 6.0, 60.0],
        "rig_friction=0.06": [0.01, 11.6, 60.0],
    }
    for text, shown in expected.items():
        effects = draw_effects([text], np.random.default_rng(0))
        got = [shown_by_instrument(effects, name, true[name], at)[0] for name in names]
        assert got == pytest.approx(shown, rel=1e-12), text
    slip = draw_effects(["slip_resistance=0.5"], np.random.default_rng(0))
    shown = shown_by_instrument(slip, "resistance", true["resistance"], at)
    assert shown[0] == pytest.approx(
        8.0 * (1.0 + 0.5 * (1.0 - np.exp(-0.8)) / (1.0 - np.exp(-2.0)))
    )
    both = draw_effects(["resistance_gain=0.1", "rig_friction=0.06"], np.random.default_rng(0))
    assert shown_by_instrument(both, "resistance", true["resistance"], at)[0] == pytest.approx(12.4)


@pytest.mark.parametrize("name", ["sinkage_gain", "load_gain", "load_offset", "resistance_offset"])
def test_faults_without_a_size_have_either_sign(name):
    sizes = [draw_effects([name], np.random.default_rng(seed))[0].amplitude for seed in range(20)]
    assert min(sizes) < 0 < max(sizes)
    assert np.ptp(np.abs(sizes)) < 0.31 * np.mean(np.abs(sizes))


def test_rut_is_shallower_than_the_wheel_was():
    effects = draw_effects(["elastic_rebound"], np.random.default_rng(0))
    there, plain = (
        WheelsOnSoil(SOIL, effects, NORMAL).response(),
        WheelsOnSoil(SOIL, (), NORMAL).response(),
    )
    assert np.all(there.shown_sinkage < there.depth)
    assert np.all(there.depth < plain.depth)  # the rising soil carries its share
    assert np.all((there.resistance > 0) & (there.resistance < plain.resistance))


def test_linear_rebound_gives_back_half_of_pressure_times_rise():
    law = HiddenLaw("rut = z - A p", 7e-8, "rebound", lambda a, p: (a * p, 1.0))
    effects = (HiddenEffect("linear_rebound", law, 3e-8, {}),)
    there = WheelsOnSoil(SOIL, effects, NORMAL).response()
    pressure = SOIL.k * NORMAL.diameter**SOIL.m * there.depth**SOIL.n
    work = pressure * there.depth / (SOIL.n + 1) - pressure * (3e-8 * pressure) / 2
    assert there.resistance == pytest.approx(NORMAL.width * work, rel=1e-5)


def test_names():
    assert check_hidden(["none"]) == ()
    assert check_hidden(["slip_sinkage", "column:density", "moisture"]) == (
        "slip_sinkage",
        "column:density",
        "moisture",
    )
    assert Asked.of("column:density").column == "density"
    assert check_hidden(["load_offset=-4"]) == ("load_offset=-4",)
    assert Asked.of("column:density=0.2").column == "density"
    assert Asked.of("bulldozing").column is None
    assert set(EFFECTS) < set(hidden_names())
    for wrong, match in [
        (["slip_sinkag"], "did you mean 'slip_sinkage'"),
        (["column:"], "unknown"),
        (["column:a b"], "unknown"),
        (["none", "bulldozing"], "give either"),
        *(([f"column:{name}"], "has a meaning of its own") for name in COLUMNS),
        (["bulldozing", "bulldozing"], "twice"),
        (["moisture", "column:moisture"], "twice"),
        (["load_offset=4", "load_offset=-4"], "twice"),
        (["load_offset=heavy"], "its size is 'heavy', expected a number"),
        (["load_offset="], "its size is ''"),
        (["load_offset=nan"], "its size is 'nan'"),
        (["none=1"], "'none' has no size"),
    ]:
        with pytest.raises(SimulationError, match=match):
            check_hidden(wrong)


def test_every_effect_describes_itself_in_plain_json():
    names = [name for name in hidden_names() if name not in ("none", "column:NAME")]
    for effect in draw_effects([*names, "column:x"], np.random.default_rng(0)):
        told = json.loads(json.dumps(effect.describe(), allow_nan=False))
        assert told["formula"]
        assert told["effect"]
