# SPDX-License-Identifier: Apache-2.0
"""Curves of the theory, computed by the library."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure
from scenes import arrow, rim
from style import FORCE, INK, PALE, PRESSURE, SHEAR, SOIL

from smallwheel_ros.physics.contact import contact_sinkage
from smallwheel_ros.physics.sinkage import closed_form_sinkage
from smallwheel_ros.physics.soil import effective_modulus, soil
from smallwheel_ros.physics.stresses import ShearLaw, wheel_forces


def draw_stresses() -> Figure:
    """Pressure and shear stress along the arc, by the library's laws, for one wheel in dry sand."""
    sand, load, diameter, width, slip = soil("dry_sand"), 60.0, 0.2, 0.1, 0.3
    modulus = float(effective_modulus(sand.k, sand.m, diameter))
    sunk = float(contact_sinkage(load, diameter, width, modulus, sand.n).sinkage[()])
    radius = diameter / 2.0
    entry = math.acos(1.0 - sunk / radius)
    angle = np.linspace(0.0, entry, 400)
    depth = radius * (np.cos(angle) - math.cos(entry))
    static = modulus * depth**sand.n
    shape = (depth / sunk) ** sand.n
    shear = ShearLaw(0.0, sand.friction_angle, sand.shear_displacement, sand.rolling_share)
    forces = wheel_forces(load, sunk, diameter, width, slip, sand.n, shear)
    across = float(np.trapezoid(shape * np.sin(angle), angle))
    pressure = shape * float(forces.resistance) / (width * radius * across)
    rim_moved = math.sin(entry) - np.sin(angle)
    displaced = radius * (sand.rolling_share * (entry - angle - rim_moved) + slip * rim_moved)
    mobilised = -np.expm1(-displaced / sand.shear_displacement)
    figure = Figure(figsize=(7.6, 3.7), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.25))
    left.set(xlim=(-0.35, 1.5), ylim=(-1.95, -0.1), aspect="equal")
    left.set_axis_off()
    outline = np.array([rim(a * 1.0) for a in np.linspace(-0.35, 1.45, 60)])
    left.plot(*outline.T, color=INK, lw=2)
    start = rim(entry)
    left.plot([start[0], 1.5], [start[1], start[1]], color=SOIL, lw=1.8)
    left.plot([-0.35, 0.0], [-1.0, -1.0], color=SOIL, lw=1.8)
    scale = 0.7 / pressure.max()
    tips = np.array([rim(a, 1.0 + scale * p) for a, p in zip(angle, pressure, strict=True)])
    left.fill(*np.vstack([tips, np.array([rim(a) for a in angle[::-1]])]).T, PRESSURE, alpha=0.18)
    for a, p in list(zip(angle, pressure, strict=True))[5:-20:25]:
        arrow(left, rim(a, 1.0 + scale * p), rim(a), PRESSURE)
    left.text(0.75, -1.65, "p, towards\nthe axle", color=PRESSURE)
    for a in angle[10:-25:33]:
        x, y = rim(a, 0.93)
        arrow(left, (x, y), (x + 0.16 * math.cos(a), y + 0.16 * math.sin(a)), SHEAR)
    left.text(0.02, -0.72, "τ, along the rim", color=SHEAR)
    degrees = np.degrees(angle)
    right.plot(
        degrees, 1e-3 * static, color=PRESSURE, ls=":", label="p = k z(θ)ⁿ Dᵐ, pressed alone"
    )
    right.plot(degrees, 1e-3 * pressure, color=PRESSURE, label="p, as the load and shear leave it")
    shear_stress = 1e-3 * pressure * math.tan(sand.friction_angle) * mobilised
    right.plot(degrees, shear_stress, color=SHEAR, label="τ = p tan φ (1 - exp(-j/K))")
    right.set(xlabel="angle ahead of the lowest point [deg]", ylabel="stress [kPa]", ylim=(0, 28))
    right.invert_xaxis()
    right.legend(loc="upper left")
    right.set_title(
        f"dry sand, W {load:g} N, D {diameter:g} m, b {width:g} m, slip {slip:g}", fontsize=10
    )
    return figure


def draw_pressure_sinkage() -> Figure:
    """The law with D^m for three diameters, and Bekker's, which does not know the diameter."""
    figure = Figure(figsize=(7.6, 3.6), layout="constrained")
    axes = figure.subplots()
    z = np.linspace(0.0, 0.03, 200)
    sand, bekker = soil("dry_sand"), soil("dry_sand_bekker")
    for diameter, dash in ((0.4, "-"), (0.2, "--"), (0.1, "-.")):
        p = effective_modulus(sand.k, sand.m, diameter) * z**sand.n
        axes.plot(1e3 * z, 1e-3 * p, dash, color=PRESSURE)
        axes.text(30.3, 1e-3 * p[-1], f"D = {diameter:g} m", color=PRESSURE, va="center")
    p = bekker.k * z**bekker.n
    axes.plot(1e3 * z, 1e-3 * p, color=FORCE)
    axes.text(30.3, 1e-3 * p[-1], "Bekker, any D", color=FORCE, va="center")
    axes.set(xlabel="sinkage z [mm]", ylabel="pressure p [kPa]", xlim=(0, 36), ylim=(0, None))
    axes.set_title("dry sand (Meirion-Griffith and Spenko, Tables 2 and 6)", fontsize=10)
    return figure


def draw_shear() -> Figure:
    """Shear stress over displacement, and what becomes of it under a slipping wheel."""
    figure = Figure(figsize=(7.6, 3.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    j, slip = np.linspace(0.0, 0.06, 200), np.linspace(-0.6, 0.9, 301)
    for kappa, dash in ((0.005, "-"), (0.012, "--"), (0.030, "-.")):
        left.plot(
            1e3 * j, -np.expm1(-j / kappa), dash, label=f"K = {1e3 * kappa:g} mm", color=SHEAR
        )
    law = ShearLaw(300.0, 0.576, 0.012, 1.3, 0.8)
    for ratio, dash in ((0.04, "-"), (0.08, "--"), (0.15, "-.")):
        forces = wheel_forces(80.0, 0.25 * ratio, 0.25, 0.1, slip, 1.0, law)
        pull = (forces.thrust - forces.resistance) / 80.0
        right.plot(slip, pull, dash, color=FORCE, label=f"z/D = {ratio:g}")
    right.axhline(0.0, color=PALE, lw=1)
    left.set(xlabel="shear displacement j [mm]", ylabel="τ / (c + p tan φ)", ylim=(0, 1.02))
    right.set(xlabel="slip i", ylabel="drawbar pull over load, DP / W")
    left.legend()
    right.legend()
    right.set_title("pull of one wheel at three sinkages", fontsize=10)
    left.set_title("shear at one point", fontsize=10)
    return figure


def draw_closed_form() -> Figure:
    """How far eq. 10 is from the contact integral."""
    figure = Figure(figsize=(7.6, 3.2), layout="constrained")
    axes = figure.subplots()
    load, diameter, width = np.geomspace(0.05, 3000.0, 400), 0.2, 0.1
    for n, dash in ((0.5, "-"), (0.8, "--"), (1.2, "-."), (1.5, ":")):
        modulus = 50e3 / 0.02**n
        exact = contact_sinkage(load, diameter, width, modulus, n)
        ratio = closed_form_sinkage(load, diameter, width, modulus, n) / exact.sinkage
        shown = ~exact.sunk_to_axle & (exact.sinkage < 0.3 * diameter)
        axes.plot(
            exact.sinkage[shown] / diameter, ratio[shown], dash, label=f"n = {n:g}", color=INK
        )
    axes.axhline(1.0, color=PALE, lw=1)
    axes.set(
        xlabel="sinkage over diameter, z₀ / D", ylabel="eq. 10 / contact integral", xlim=(0, 0.3)
    )
    axes.legend(ncols=2)
    return figure


def draw_ridge() -> Figure:
    """What one wheel size tells of k and m, and what a second one adds."""
    sand = soil("dry_sand")
    figure = Figure(figsize=(7.6, 3.4), layout="constrained")
    axes = figure.subplots()
    m = np.linspace(-0.2, 1.0, 50)
    for diameter, colour in ((0.2, PRESSURE), (0.4, SHEAR)):
        known = math.log(sand.k) + sand.m * math.log(diameter)
        k = 1e-6 * np.exp(known - m * math.log(diameter))
        axes.plot(m, k, color=colour)
        axes.fill_between(m, 0.93 * k, 1.07 * k, color=colour, alpha=0.2, lw=0)
        axes.text(
            1.01, k[-1], f"all that a wheel of\n{diameter:g} m can tell", color=colour, va="center"
        )
    axes.plot(sand.m, 1e-6 * sand.k, "o", color=FORCE)
    axes.text(sand.m, 1e-6 * sand.k * 0.62, "both together", color=FORCE, ha="center")
    axes.set(xlabel="m", ylabel="k [MPa/m^(n+m)]", yscale="log", xlim=(-0.2, 1.35))
    axes.set_yticks([0.5, 1, 2, 4], ["0.5", "1", "2", "4"])
    axes.minorticks_off()
    return figure
