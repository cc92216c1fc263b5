# SPDX-License-Identifier: Apache-2.0
"""The tests of a lab: plates, bevameter, shear, a pressed wheel, lugs."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Annulus, Circle, Polygon, Rectangle
from scenes import arrow, measure, rim, scene
from style import FORCE, INK, PALE, PRESSURE, SHEAR, SOIL

from smallwheel_ros.physics.shear import peaked_share, rising_share, shear_strength

PLATES = (0.06, 0.10, 0.15)  # m
K, N, M = 4e6, 0.9, 0.4
COHESION, FRICTION, MODULUS = 1200.0, math.tan(math.radians(32.0)), 0.012


def draw_plates() -> Figure:
    """Pressure over sinkage of three plates: straight lines in logarithms, one above the other."""
    figure = Figure(figsize=(7.6, 3.3), layout="constrained")
    left, right = figure.subplots(1, 2)
    z = np.linspace(0.5e-3, 0.03, 60)
    for i, diameter in enumerate(PLATES):
        wave = np.exp(0.04 * np.cos(4.0 * z / 0.03 + 2.0 * i))
        pressure = 1e-3 * K * z**N * diameter**M
        for axes in (left, right):
            axes.plot(
                1e3 * z, pressure * wave, ".", ms=4, color=f"C{i}", label=f"{1e3 * diameter:.0f} mm"
            )
            axes.plot(1e3 * z, pressure, color=f"C{i}", lw=1)
    left.set(xlabel="sinkage z [mm]", ylabel="pressure p [kPa]")
    left.legend(title="plate")
    right.set(xscale="log", yscale="log", xlabel="sinkage z [mm]")
    said = "slope: n\napart: by m, or by kc/b"
    right.text(0.98, 0.05, said, ha="right", transform=right.transAxes)
    return figure


def draw_bevameter() -> Figure:
    """Round and rectangular plate and annulus, from below, with their dimensions."""
    axes = scene(7.6, 2.9, (-3.8, 3.8), (-1.5, 1.4))
    axes.add_patch(Circle((-2.7, 0.1), 0.8, facecolor=PALE, alpha=0.4, edgecolor=INK))
    measure(axes, (-3.5, 0.1), (-1.9, 0.1))
    axes.text(-2.7, 0.2, "diameter D", ha="center")
    axes.text(-2.7, -1.3, "round plate: b = D / 2", ha="center")
    axes.add_patch(Rectangle((-0.95, -0.35), 1.9, 0.9, facecolor=PALE, alpha=0.4, edgecolor=INK))
    measure(axes, (-0.95, 0.8), (0.95, 0.8))
    axes.text(0.0, 0.9, "length", ha="center")
    measure(axes, (0.7, -0.35), (0.7, 0.55))
    axes.text(0.62, 0.05, "width", ha="right")
    axes.text(
        0.0, -1.3, "rectangular: b = smaller side,\nD of the round plate of its area", ha="center"
    )
    axes.add_patch(Annulus((2.7, 0.1), 0.85, 0.35, facecolor=SHEAR, alpha=0.3, edgecolor=INK))
    turn = {"arrowstyle": "-|>", "color": SHEAR, "lw": 1.6, "connectionstyle": "arc3,rad=0.4"}
    axes.annotate("", (1.95, 0.95), (3.45, 0.95), arrowprops=turn)
    axes.text(2.7, -1.3, "annulus, turned under σ:\nτ over displacement j", ha="center")
    return axes.figure


def draw_shear_tests() -> Figure:
    """Shear stress over displacement at three normal stresses, and strength over normal stress."""
    figure = Figure(figsize=(7.6, 3.3), layout="constrained")
    left, right = figure.subplots(1, 2)
    j = np.linspace(0.0, 0.06, 200)
    stresses = np.array([10e3, 25e3, 50e3])
    strengths = shear_strength(stresses, COHESION, FRICTION)
    for i, (sigma, strength) in enumerate(zip(stresses, strengths, strict=True)):
        left.plot(1e3 * j, 1e-3 * strength * rising_share(j, MODULUS), color=f"C{i}")
        left.plot(1e3 * j, 1e-3 * strength * peaked_share(j, MODULUS, 0.75), ls=":", color=f"C{i}")
        left.text(61.0, 1e-3 * strength, f"{1e-3 * sigma:.0f} kPa", color=f"C{i}", va="center")
        right.plot(1e-3 * sigma, 1e-3 * strength, "o", color=f"C{i}")
    left.axvline(1e3 * MODULUS, color=PALE, lw=1)
    left.text(1e3 * MODULUS + 0.7, 1.0, "K", color=INK)
    left.axvline(3e3 * MODULUS, color=PALE, lw=1)
    left.text(3e3 * MODULUS + 0.7, 1.0, "3 K: shear at least this far")
    left.set(
        xlabel="displacement j [mm]", ylabel="shear stress [kPa]", xlim=(0, 70), ylim=(0, None)
    )
    left.set_title("full: Janosi-Hanamoto; dotted: peak and residual", fontsize=9)
    line = np.array([0.0, 55e3])
    right.plot(1e-3 * line, 1e-3 * shear_strength(line, COHESION, FRICTION), color=INK, lw=1)
    right.annotate("c", (0.0, 1.2), (3.0, 9.0), arrowprops={"arrowstyle": "-", "color": PALE})
    right.text(30.0, 12.0, "slope: tan φ")
    right.set(
        xlabel="normal stress σ [kPa]", ylabel="strength [kPa]", xlim=(0, None), ylim=(0, None)
    )
    return figure


def draw_pressed() -> Figure:
    """A pressed wheel is carried on both sides of its lowest point, a rolling one ahead of it."""
    axes = scene(7.6, 3.1, (-3.9, 3.9), (-1.75, 1.4))
    entry = math.acos(1.0 - 0.32)
    for middle, rolling in ((-2.0, False), (2.0, True)):
        back = 0.0 if rolling else -entry
        arc = [(middle + x, y) for x, y in map(rim, np.linspace(back, entry, 60))]
        ends = [(middle - 1.75, arc[0][1]), *arc, (middle + 1.75, arc[-1][1])]
        bottom = [(middle + 1.75, -1.75), (middle - 1.75, -1.75)]
        axes.add_patch(Polygon([*ends, *bottom], facecolor=SOIL, alpha=0.28, lw=0))
        axes.plot(*zip(*ends, strict=True), color=SOIL, lw=1.8)
        axes.plot(*zip(*arc, strict=True), color=PRESSURE, lw=5, solid_capstyle="butt")
        axes.add_patch(Circle((middle, 0.0), 1.0, fill=False, edgecolor=INK, lw=2.0))
        arrow(axes, (middle, 0.8), (middle, 0.1), FORCE)
        axes.text(middle + 0.07, 0.55, "W", color=FORCE)
        word = "contact rolling" if rolling else "contact pressed"
        axes.text(middle, -1.62, word, ha="center")
    arrow(axes, (2.1, 0.0), (2.8, 0.0), INK)
    axes.text(2.5, 0.08, "v")
    return axes.figure


def draw_lugs() -> Figure:
    """A wheel with lugs: diameter without them, and their height."""
    axes = scene(7.6, 3.0, (-2.6, 2.6), (-1.35, 1.35))
    axes.add_patch(Circle((0.0, 0.0), 1.0, fill=False, edgecolor=INK, lw=2.0))
    for angle in np.arange(0.0, 2.0 * math.pi, math.pi / 9):
        axes.plot(*zip(rim(angle), rim(angle, 1.15), strict=True), color=INK, lw=4)
    measure(axes, (-1.0, 0.0), (1.0, 0.0))
    axes.text(0.0, 0.08, "diameter of the rim", ha="center")
    axes.plot([0.0, 2.1], [-1.0, -1.0], color=PALE, lw=1)
    axes.plot([0.0, 2.1], [-1.15, -1.15], color=PALE, lw=1)
    axes.text(1.35, -0.9, "grouser_height: rim to tip")
    axes.text(1.25, 0.7, "sinkage: of the rim")
    return axes.figure
