# SPDX-License-Identifier: Apache-2.0
"""Laws of the truth against adaptive quadrature of their stresses, and against numbers worked out by hand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad

from smallwheel_ros.simulate.truth import Circumstances
from smallwheel_ros.simulate.wheel_laws import (
    DEPTHS,
    SLIPS,
    RimStrength,
    Sand,
    Stresses,
    peaked_curves,
    response_of,
    rim_curves,
    sinkage_of,
)

D, B, LOAD, N = 0.25, 0.1, 60.0, 0.8
RADIUS = 0.5 * D
STRENGTH = RimStrength(cohesion=400.0, friction_angle=0.55, shear_deformation=0.012)


def integral(f: Callable[[float], float], low: float, high: float, *breaks: float) -> float:
    """Adaptive quadrature, to 1e-9 of it."""
    places = sorted(b for b in breaks if low < b < high) or None
    return float(quad(f, low, high, points=places, epsabs=0.0, epsrel=1e-9, limit=300)[0])


def mobilised(moved: float, deformation: float) -> float:
    return float(np.sign(moved) * (1.0 - np.exp(-abs(moved) / deformation)))


@pytest.mark.parametrize("slip", [-0.4, 0.0, 0.1, 0.5])
@pytest.mark.parametrize(("rolling", "residual"), [(1.0, 1.0), (0.3, 0.6)])
def test_curves_of_the_rim_are_those_of_wong_and_reece(
    slip: float, rolling: float, residual: float
) -> None:
    strength = RimStrength(400.0, 0.55, 0.012, rolling=rolling, residual=residual)
    curves = rim_curves(D, B, LOAD, N, strength)
    at, depth = int(np.flatnonzero(slip == SLIPS)[0]), 12
    z = DEPTHS[depth] * D
    entry = float(np.arccos(1.0 - z / RADIUS))
    travel = 1.0 - slip if slip >= 0.0 else 1.0 / (1.0 + slip)  # ground speed over that of the rim

    def pressed(angle: float) -> float:
        return max(RADIUS * (np.cos(angle) - np.cos(entry)), 0.0) ** N

    level = LOAD / (B * RADIUS * integral(lambda t: pressed(t) * np.cos(t), 0.0, entry))

    def shear(angle: float) -> float:
        # The rim's point against the soil: by rolling alone, and by what the wheel spins or is dragged.
        lower = np.sin(entry) - np.sin(angle)
        moved = RADIUS * (rolling * (entry - angle - lower) + (1.0 - travel) * lower)
        held = residual + (1.0 - residual) * np.exp(-abs(moved) / (5.0 * 0.012))
        strong = 400.0 + level * pressed(angle) * np.tan(0.55)
        return float(strong * mobilised(moved, 0.012) * held)

    def along(part: Callable[[float], float]) -> float:
        turns = np.linspace(0.0, entry, 9)[1:-1]  # the displacement changes its sign where it skids
        return B * RADIUS * integral(part, 0.0, entry, *turns) / LOAD

    assert curves.thrust[depth, at] == pytest.approx(
        along(lambda t: shear(t) * np.cos(t)), rel=2e-4, abs=2e-5
    )
    assert curves.torque[depth, at] == pytest.approx(along(shear), rel=2e-4, abs=2e-5)
    resistance = along(lambda t: level * pressed(t) * np.sin(t))
    assert curves.resistance[depth, at] == pytest.approx(resistance, rel=1e-5)


def test_beyond_the_last_slips_curves_stay_as_they_are() -> None:
    for curves in rim_curves(D, B, LOAD, N, STRENGTH):
        assert curves.shape == (DEPTHS.size, SLIPS.size)
        np.testing.assert_array_equal(curves[:, 0], curves[:, 1])
        np.testing.assert_array_equal(curves[:, -1], curves[:, -2])


def by_quadrature(
    sand: Sand, slip: float, height: float, z: float, still: float, shape: Stresses
) -> tuple[float, float, float]:
    """Thrust, resistance (N) and torque (N m), each an integral of its own stress."""
    shoe, entry = RADIUS + 0.5 * height, float(np.arccos(1.0 - z / RADIUS))
    exit_ = -shape.rear * entry
    top = (shape.peak[0] + shape.peak[1] * abs(slip)) * entry
    travel = 1.0 - slip if slip >= 0.0 else 1.0 / (1.0 + slip)
    grip = sand.rim if height == 0.0 and slip >= 0.0 else 1.0
    strength, breaks = sand.strength, [top]

    def share(angle: float) -> float:
        """Of the sinkage: how deep the pressure at an angle is that of."""
        ahead = angle >= top
        rise = (entry - angle) / (entry - top) if ahead else (angle - exit_) / (top - exit_)
        equal = entry * (1.0 - rise)
        return float(max((np.cos(equal) - np.cos(entry)) / (1.0 - np.cos(entry)), 0.0))

    def pressed(angle: float) -> float:
        s = share(angle)
        return float(s**sand.n * (shape.moved if s * z < z - still else 1.0))

    if shape.moved != 1.0:  # where the soil begins that the wheel did not dig
        angles = np.linspace(exit_, entry, 4001)
        dug = np.array([share(t) * z < z - still for t in angles])
        breaks += angles[1:][dug[1:] != dug[:-1]].tolist()

    def called(angle: float) -> float:
        moved = shoe * ((entry - angle) - travel * (np.sin(entry) - np.sin(angle)))
        x = abs(moved) / strength.shear_deformation
        hump = 1.0 + shape.hump * x * np.exp(1.0 - x)
        return float(np.sign(moved) * (1.0 - np.exp(-x)) * hump)

    def total(part: Callable[[float], float]) -> float:
        return integral(part, exit_, entry, *breaks)

    tangent = grip * np.tan(strength.friction_angle)
    held = grip * strength.cohesion
    # Vertical balance: what cohesion lifts or presses is known, the rest grows with the level.
    of_cohesion = B * shoe * total(lambda t: held * called(t) * np.sin(t))
    of_level = B * RADIUS * total(lambda t: pressed(t) * np.cos(t))
    of_level += B * shoe * total(lambda t: tangent * pressed(t) * called(t) * np.sin(t))
    level = (LOAD - of_cohesion) / of_level

    def shear(angle: float) -> float:
        return float((level * tangent * pressed(angle) + held) * called(angle))

    return (
        B * shoe * total(lambda t: shear(t) * np.cos(t)),
        B * RADIUS * level * total(lambda t: pressed(t) * np.sin(t)),
        B * shoe**2 * total(shear),
    )


@pytest.mark.parametrize("slip", [-0.4, 0.1, 0.5])
def test_curves_that_peak_are_the_integrals_of_their_stresses(slip: float) -> None:
    curves = peaked_curves(D, B, LOAD, N, STRENGTH)
    at, depth = int(np.flatnonzero(slip == SLIPS)[0]), 12
    z = float(DEPTHS[depth] * D)
    shape = Stresses(peak=(0.25, 0.2), hump=0.15)
    thrust, resistance, torque = by_quadrature(Sand(1.0, N, STRENGTH), slip, 0.0, z, z, shape)
    assert curves.thrust[depth, at] == pytest.approx(thrust / LOAD, rel=2e-4)
    assert curves.resistance[depth, at] == pytest.approx(resistance / LOAD, rel=2e-4)
    assert curves.torque[depth, at] == pytest.approx(torque / LOAD / RADIUS, rel=2e-4)


@pytest.mark.parametrize(
    ("slip", "height", "shape"),
    [
        (0.3, 0.0, Stresses()),
        (0.3, 0.01, Stresses(rear=0.3, peak=(0.2, 0.3))),
        (-0.3, 0.0, Stresses(hump=0.4)),
        (0.6, 0.0, Stresses(moved=0.4)),
    ],
)
def test_pull_and_torque_are_the_integrals_of_the_stresses(
    slip: float, height: float, shape: Stresses
) -> None:
    sand = Sand(9e5, N, STRENGTH, dug=0.1, skid=0.2, lugs=0.5)
    at = Circumstances.of(load=LOAD, diameter=D, width=B, slip=slip, grouser_height=height)
    z, pull, torque = response_of(sand, at, shape)
    still = Circumstances.of(load=LOAD, diameter=D, width=B, slip=0.0, grouser_height=height)
    thrust, resistance, turn = by_quadrature(
        sand, slip, height, float(z[0]), float(sinkage_of(sand, still)[0]), shape
    )
    # The trapezoids are coarse where moved soil ends at a step.
    assert pull[0] == pytest.approx(thrust - resistance, rel=2e-3)
    assert torque[0] == pytest.approx(turn, rel=2e-3)
    _, biased, _ = response_of(
        sand, at, Stresses(shape.peak, shape.rear, shape.moved, shape.hump, 0.05)
    )
    assert biased - pull == pytest.approx(0.05 * LOAD)


def sinks(sand: Sand, slip: float, height: float = 0.0, load: float = LOAD) -> float:
    at = Circumstances.of(load=load, diameter=D, width=B, slip=slip, grouser_height=height)
    return float(sinkage_of(sand, at)[0])


def test_the_static_sinkage_is_that_of_a_parabola() -> None:
    """With n = 1 its pressure over the ground is a parabola: load = 2/3 of the deepest times the area."""
    z = sinks(Sand(9e5, 1.0, STRENGTH), 0.0)
    assert 2.0 / 3.0 * B * np.sqrt(z * D) * 9e5 * z == pytest.approx(LOAD)


def test_what_digs_is_added_and_what_ploughs_multiplies() -> None:
    still = sinks(Sand(9e5, N, STRENGTH), 0.0)
    assert sinks(Sand(9e5, N, STRENGTH), 0.7) == still == sinks(Sand(9e5, N, STRENGTH), -0.7)
    dug = Sand(9e5, N, STRENGTH, dug=0.1)
    assert sinks(dug, 1.0) - still == pytest.approx(0.1 * D)
    # sinh(0.6) / sinh(1.2), from a table
    assert sinks(dug, 0.5) - still == pytest.approx(0.1 * D * 0.63665 / 1.50946, rel=1e-4)
    assert sinks(dug, -0.5) == still
    lugs = Sand(9e5, N, STRENGTH, lugs=0.5)
    assert sinks(lugs, 0.55, height=0.01) - still == pytest.approx(0.5 * 0.01 * 0.55 / 0.5)
    assert sinks(lugs, 0.55) == still
    skid = Sand(9e5, N, STRENGTH, skid=0.4)
    assert sinks(skid, -1.0) == pytest.approx(1.4 * still)
    assert sinks(skid, 0.5) == still
    assert sinks(Sand(9e5, N, STRENGTH), 0.0, load=1e5) == pytest.approx(
        0.45 * D
    )  # to the axle, nearly
