# SPDX-License-Identifier: Apache-2.0
"""Drawings of a wheel and a plate: names of lengths, angles and forces, and where each effect acts."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, Polygon, Rectangle
from style import FORCE, INK, PALE, PRESSURE, SHEAR, SOIL

# The wheel of the drawings: radius 1, sunk by 0.32 of it.
SUNK = 0.32
ENTRY = math.acos(1.0 - SUNK)
SURFACE = -1.0 + SUNK


def scene(width: float, height: float, x: tuple[float, float], y: tuple[float, float]) -> Axes:
    """A figure without axes, in which one unit is as long in both directions."""
    axes = Figure(figsize=(width, height)).add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=x, ylim=y, aspect="equal")
    axes.set_axis_off()
    return axes


def arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], colour: str) -> None:
    """An arrow with its head at `end`."""
    style = {"arrowstyle": "-|>", "color": colour, "lw": 2.0, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, arrowprops=style)


def measure(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    """A double arrow that measures a distance."""
    style = {"arrowstyle": "<|-|>", "color": INK, "lw": 1.0, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, arrowprops=style)


def rim(angle: float, radius: float = 1.0) -> tuple[float, float]:
    """The point of the rim at an angle ahead of the lowest one."""
    return radius * math.sin(angle), -radius * math.cos(angle)


def ground_and_wheel(axes: Axes, left: float, right: float, bottom: float) -> None:
    """A rigid wheel that travels to the right: fresh soil ahead of it, its rut behind it."""
    arc = [rim(a) for a in np.linspace(0.0, ENTRY, 40)]
    outline = [(left, -1.0), *arc, (right, SURFACE), (right, bottom), (left, bottom)]
    axes.add_patch(Polygon(outline, facecolor=SOIL, alpha=0.28, lw=0))
    axes.plot(*zip(*outline[:-2], strict=True), color=SOIL, lw=1.8)
    axes.plot([left, rim(ENTRY)[0]], [SURFACE, SURFACE], color=SOIL, lw=1.0, ls=(0, (4, 3)))
    axes.add_patch(Circle((0.0, 0.0), 1.0, fill=False, edgecolor=INK, lw=2.0))
    axes.add_patch(Circle((0.0, 0.0), 0.045, color=INK))


def label(axes: Axes, at: tuple[float, float], text: str, points_to: tuple[float, float]) -> None:
    """A name with a thin line to the place that it is about."""
    style = {"arrowstyle": "-", "color": PALE, "lw": 1.0, "shrinkB": 0}
    axes.annotate(text, points_to, at, arrowprops=style, va="center", fontsize=10.5)


def draw_wheel() -> Figure:
    """Names of lengths, angles and forces."""
    axes = scene(7.6, 4.9, (-2.1, 2.35), (-1.6, 1.27))
    ground_and_wheel(axes, -2.1, 2.35, -1.6)
    arc = np.array([rim(a) for a in np.linspace(0.0, ENTRY, 40)])
    axes.plot(*arc.T, color=PRESSURE, lw=5, solid_capstyle="butt")
    axes.text(1.02, -1.12, "contact arc, length l = r θ₀", color=PRESSURE)
    axes.plot([0.0, 0.0], [0.0, -1.0], color=INK, lw=1.0)
    axes.plot(*zip((0.0, 0.0), rim(ENTRY), strict=True), color=INK, lw=1.0)
    axes.add_patch(Arc((0, 0), 0.9, 0.9, theta1=270, theta2=270 + math.degrees(ENTRY), color=INK))
    axes.text(0.12, -0.62, "θ₀ entry\n     angle", linespacing=0.95)
    axes.text(-0.06, -0.80, "exit: θ = 0", ha="right")
    measure(axes, (-1.45, -1.0), (-1.45, SURFACE))
    axes.text(-1.52, -0.84, "z₀ sinkage", va="center", ha="right")
    measure(axes, (-1.0, 1.14), (1.0, 1.14))
    axes.text(0.0, 1.17, "D = 2 r diameter   (width b into the picture)", ha="center")
    arrow(axes, (0.0, 0.83), (0.0, 0.1), FORCE)
    axes.text(0.08, 0.62, "W load", color=FORCE)
    arrow(axes, (-0.05, 0.0), (-0.95, 0.0), FORCE)
    axes.text(-0.93, 0.07, "DP drawbar pull\nof what it drags", color=FORCE)
    arrow(axes, (-0.1, -1.22), (0.62, -1.22), SHEAR)
    axes.text(-0.1, -1.4, "H thrust of the soil", color=SHEAR)
    arrow(axes, (1.75, -0.9), (0.95, -0.9), FORCE)
    axes.text(1.72, -0.82, "R resistance", color=FORCE, ha="right")
    turn = {"arrowstyle": "-|>", "color": INK, "lw": 1.2, "connectionstyle": "arc3,rad=-0.4"}
    axes.annotate("", (0.78, 0.28), (0.42, 0.72), arrowprops=turn)
    axes.text(0.46, 0.3, "ω")
    arrow(axes, (1.2, 0.0), (1.75, 0.0), INK)
    axes.text(1.3, 0.08, "v speed")
    axes.text(1.45, SURFACE + 0.06, "fresh soil", color=SOIL)
    axes.text(-1.95, -1.16, "rut", color=SOIL)
    return axes.figure


def draw_plate() -> Figure:
    """A plate under a press: the test that measures k, n and m."""
    axes = scene(7.6, 3.4, (-2.3, 2.9), (-1.25, 1.15))
    hole = [(-2.3, 0), (-0.7, 0), (-0.7, -0.45), (0.7, -0.45), (0.7, 0), (2.9, 0)]
    axes.add_patch(Polygon([*hole, (2.9, -1.25), (-2.3, -1.25)], facecolor=SOIL, alpha=0.28, lw=0))
    axes.plot(*zip(*hole, strict=True), color=SOIL, lw=1.8)
    axes.add_patch(Rectangle((-0.7, -0.45), 1.4, 0.13, color=PALE))
    axes.add_patch(Rectangle((-0.06, -0.32), 0.12, 0.72, color=PALE))
    axes.add_patch(Rectangle((-0.25, 0.4), 0.5, 0.22, facecolor="none", edgecolor=INK))
    axes.text(0.33, 0.45, "load cell: W")
    arrow(axes, (0.0, 1.1), (0.0, 0.65), FORCE)
    axes.text(0.1, 0.88, "press, slow and steady", color=FORCE)
    measure(axes, (-0.7, -0.22), (0.7, -0.22))
    axes.text(0.12, -0.17, "D")
    measure(axes, (-1.0, -0.45), (-1.0, 0.0))
    axes.text(-1.07, -0.24, "z sinkage", ha="right", va="center")
    for x in np.linspace(-0.55, 0.55, 6):
        arrow(axes, (x, -0.78), (x, -0.47), PRESSURE)
    axes.text(0.0, -0.98, "p = W / (π D²/4) = k zⁿ Dᵐ", color=PRESSURE, ha="center")
    axes.text(1.0, -0.35, "several D tell m,\nseveral z tell n,\none point more tells k")
    return axes.figure


def draw_effects() -> Figure:
    """Where each effect of the library acts."""
    axes = scene(7.6, 6.3, (-3.3, 3.5), (-2.75, 2.9))
    ground_and_wheel(axes, -3.3, 3.5, -2.75)
    axes.add_patch(Rectangle((-3.3, -2.75), 6.8, 0.62, facecolor=INK, alpha=0.35, lw=0))
    heap = [rim(ENTRY), (0.95, -0.38), (1.25, -0.45), (1.55, SURFACE)]
    axes.add_patch(Polygon(heap, facecolor=SOIL, alpha=0.6, lw=0))
    rise = np.linspace(0.0, 0.5, 20)
    axes.plot(-rise, -1.0 + 0.1 * np.sin(math.pi * rise), color=SOIL, lw=1.6, ls=":")
    for angle in np.arange(0.3, 2 * math.pi, math.pi / 6):
        axes.plot(*zip(rim(angle), rim(angle, 1.08), strict=True), color=INK, lw=3)
    arrow(axes, (0.0, 0.8), (0.0, 0.1), FORCE)
    axes.text(0.06, 0.45, "W", color=FORCE)
    arrow(axes, (0.15, -0.08), (0.75, -0.08), INK)
    axes.text(0.4, -0.3, "v")
    label(axes, (0.75, 1.55), "slope", (0.02, 0.78))
    label(axes, (-3.2, 0.65), "grouser", (-0.98, 0.42))
    label(axes, (1.75, 0.55), "penetration_rate", (0.77, -0.06))
    label(axes, (1.75, -0.1), "bulldozing", (1.15, -0.42))
    label(axes, (1.75, -1.0), "contact_geometry", rim(0.55))
    label(axes, (0.75, -1.45), "slip_sinkage (i > 0)\nskid_sinkage (i < 0)", (0.05, -1.02))
    label(axes, (-3.2, -0.3), "elastic_rebound", (-0.3, -0.93))
    label(axes, (-3.2, -1.2), "multipass: the rut is\ndriven through again", (-1.4, -1.0))
    stiffness = (
        "stiffness of the soil: load_dependent_modulus,\n"
        "width_dependent_modulus, moisture, covariate:NAME"
    )
    axes.text(-3.2, -1.85, stiffness, fontsize=10.5, va="center")
    axes.text(-3.2, -2.45, "hardpan: a firm layer below", fontsize=10.5, va="center")
    # From above: a wheel that travels at an angle to its plane.
    axes.add_patch(Rectangle((1.75, 1.9), 0.75, 0.28, fill=False, edgecolor=INK, lw=1.6))
    arrow(axes, (2.125, 2.04), (2.9, 2.42), INK)
    axes.text(2.95, 2.35, "v")
    axes.text(1.45, 1.55, "slip_angle_sinkage\n(seen from above)", fontsize=10.5, va="top")
    axes.add_patch(Rectangle((-3.25, 1.25), 3.3, 1.5, fill=False, edgecolor=PALE, ls=(0, (4, 3))))
    faults = (
        "faults of instruments, never soil\n"
        "sinkage_offset, sinkage_gain,\nload_offset, load_gain,\n"
        "resistance_offset, resistance_gain,\nrig_friction, slip_resistance"
    )
    axes.text(-3.15, 2.0, faults, fontsize=10.5, va="center", linespacing=1.35)
    return axes.figure
