# SPDX-License-Identifier: Apache-2.0
"""Pictures of predictions, of single effects, and like the paper's figures 9, 13 and 14."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from smallwheel_ros.common.errors import nearest
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.physics.contact import contact_sinkage
from smallwheel_ros.physics.paper import (
    BEKKER,
    DIAMETER,
    MEAN_LOAD,
    MEIRION_GRIFFITH_SPENKO,
    TABLE_3,
    WIDTH,
    sinkage,
)
from smallwheel_ros.physics.sinkage import closed_form_sinkage
from smallwheel_ros.physics.soil import SOILS, effective_modulus
from smallwheel_ros.physics.traction import compaction_resistance
from smallwheel_ros.pictures.effect_curves import CHANNELS, effect_curves
from smallwheel_ros.pictures.house import COLOURS, new_figure, save, style, write_figures
from smallwheel_ros.prediction.prediction import SHOWN, UNITS, PredictionError, PredictionTable

Array = NDArray[np.float64]

_PANELS = (
    ("sinkage", "sinkage [mm]", 1e3),
    ("resistance", "resistance [N]", 1.0),
    ("drawbar_pull", "drawbar pull [N]", 1.0),
)
_MOST_CURVES = 8
_LEGEND: dict[str, Any] = {"fontsize": 7, "frameon": False}
_STYLES = ("-", "--", "-.", ":")


def plot_prediction(table: PredictionTable, path: Path) -> None:
    """Each quantity over the setting with most values, a curve for each combination of the others.

    Bands are one standard deviation. A wheel sunk to its axle is left out.
    """
    panels = [p for p in _PANELS if getattr(table.result.prediction, p[0]) is not None]
    figure = new_figure(3.4 * len(panels), 3.2)
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    for panel, shown in zip(axes, panels, strict=True):
        drawn = draw_prediction(panel, table, *shown, legend=panel is axes[0])
    if drawn > _MOST_CURVES:
        figure.suptitle(f"the first {_MOST_CURVES} of {drawn} curves", fontsize=8)
    save(figure, path)


def draw_table(axes: Axes, table: PredictionTable, quantity: str = "sinkage") -> None:
    """One quantity that was predicted, by its name. Raises PredictionError where it was not."""
    if getattr(table.result.prediction, quantity, None) is None:
        known = [q for q in SHOWN if getattr(table.result.prediction, q) is not None]
        raise PredictionError(f"no '{quantity}' was predicted: {nearest(quantity, known)}")
    draw_prediction(axes, table, quantity, *SHOWN[quantity])


def draw_prediction(
    axes: Axes,
    table: PredictionTable,
    quantity: str,
    title: str,
    factor: float,
    *,
    legend: bool = True,
) -> int:
    """Draw one quantity on axes, as `plot_prediction` says; returns how many curves there are."""
    sizes = {name: np.unique(v).size for name, v in table.settings.items()}
    along = max(sizes, key=lambda name: sizes[name])
    others = [name for name in table.varied if name != along]
    prediction = table.result.prediction
    keys = np.stack([table.settings[n] for n in others]) if others else np.zeros((1, sizes[along]))
    curves = np.unique(keys, axis=1).T if others else np.zeros((1, 1))
    std = table.result.standard_deviation.get(quantity)
    for number, curve in enumerate(curves[:_MOST_CURVES]):
        rows = np.all(keys == curve[:, None], axis=0) if others else np.ones(keys.shape[1], bool)
        rows &= ~prediction.immobilised
        label = ", ".join(f"{n} {v:g}" for n, v in zip(others, curve, strict=False))
        colour = COLOURS[number % len(COLOURS)]
        x, y = table.settings[along][rows], getattr(prediction, quantity)[rows] * factor
        mark = "o" if x.size == 1 else ""
        look = _STYLES[number % len(_STYLES)]  # curves may lie on each other
        axes.plot(x, y, color=colour, linestyle=look, label=label, marker=mark)
        if std is not None:
            band = std[rows] * factor
            axes.fill_between(x, y - band, y + band, color=colour, alpha=0.2, linewidth=0)
    unit = UNITS.get(along, "1")
    style(axes, along.replace("_", " ") + (f" [{unit}]" if unit != "1" else ""), title)
    if others and legend:
        axes.legend(**_LEGEND)
    return len(curves)


def plot_effect(family: tuple[type[Effect], ...], path: Path) -> None:
    """Each channel that an effect touches over its driver: a curve for each form, at its start."""
    drawn = effect_curves(family)
    channels = [c for c in CHANNELS if any(c in form.channels for form in family)]
    figure = new_figure(3.4 * max(len(channels), 1) + 1.2, 3.2)
    panels = figure.subplots(1, len(channels), squeeze=False)[0]
    for panel, channel in zip(panels, channels, strict=True):
        unit, factor = CHANNELS[channel]
        for number, (name, prediction) in enumerate(drawn.predictions.items()):
            panel.plot(
                drawn.x,
                factor * getattr(prediction, channel),
                color=COLOURS[(number - 1) % len(COLOURS)] if name else "#444444",
                linestyle=_STYLES[(number - 1) // len(COLOURS)] if number else (0, (1, 1)),
                linewidth=1.4 if name else 2.2,
                label=name.replace("_", " ") or "without it",
            )
        style(panel, drawn.axis, f"{channel.replace('_', ' ')} [{unit}]")
    style(panels[0], drawn.axis, panels[0].get_ylabel(), f"{family[0].id}: {drawn.setting}")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right", **_LEGEND)
    save(figure, path)


def plot_paper(folder: Path) -> list[Path]:
    """Three figures from the paper's constants; gives the files. Its own data is not printed."""
    figures = {
        "figure_9_pressure_sinkage": _pressure_sinkage(),
        "figure_13_sinkage": _over_load("sinkage"),
        "figure_14_resistance": _over_load("resistance"),
    }
    return write_figures(figures, folder)


def _pressure_sinkage() -> Figure:
    figure = new_figure(8.4, 3.0)
    panels = figure.subplots(1, 3)
    depth = np.linspace(0.0, 0.03, 100)
    for panel, name in zip(panels, ("dry_sand", "calcium_silicate", "moist_earth"), strict=True):
        soil = SOILS[name]
        for colour, diameter in zip(COLOURS, (0.1, 0.2, 0.3, 0.5), strict=False):
            pressure = effective_modulus(soil.k, soil.m, diameter) * depth**soil.n
            panel.plot(1e3 * depth, 1e-3 * pressure, color=colour, label=f"D {diameter:g} m")
        style(panel, "sinkage [mm]", "pressure [kPa]", f"{name.replace('_', ' ')}, m = {soil.m:g}")
    panels[0].legend(**_LEGEND)
    return figure


def _over_load(quantity: str) -> Figure:
    load = np.linspace(5.0, 150.0, 100)
    figure = new_figure(4.6, 3.2)
    panel = figure.subplots()
    newer = MEIRION_GRIFFITH_SPENKO
    laws: list[tuple[str, Array, float, float]] = []
    for label, soil in (
        ("Bekker, eq. 7", BEKKER),
        ("Meirion-Griffith & Spenko, eq. 10", newer),
    ):
        modulus = float(effective_modulus(soil.k, soil.m, DIAMETER))
        z = closed_form_sinkage(load, DIAMETER, WIDTH, modulus, soil.n)
        laws.append((label, z, modulus, soil.n))
    modulus = float(effective_modulus(newer.k, newer.m, DIAMETER))
    exact = contact_sinkage(load, DIAMETER, WIDTH, modulus, newer.n).sinkage
    laws.append(("Meirion-Griffith & Spenko, contact integral", exact, modulus, newer.n))
    other_n = closed_form_sinkage(load, DIAMETER, WIDTH, modulus, BEKKER.n)
    laws.append(
        (
            f"Meirion-Griffith & Spenko, eq. 10 with n = {BEKKER.n:g} (inferred)",
            other_n,
            modulus,
            BEKKER.n,
        )
    )
    for colour, look, (label, z, k, n) in zip(COLOURS, ("-", "-", "-", "--"), laws, strict=False):
        y = 1e3 * z if quantity == "sinkage" else compaction_resistance(z, WIDTH, k, n)
        panel.plot(load, y, color=colour, linestyle=look, label=label)
    if quantity == "sinkage":
        implied = [1e3 * sinkage(BEKKER, w) / (1.0 - error) for w, error in TABLE_3.items()]
        panel.plot(list(TABLE_3), implied, "ko", label="measured, as Table 3 implies")
        panel.plot(MEAN_LOAD, 8.8, "k^", label="measured, Table 7 (load inferred)")
    else:
        panel.plot(MEAN_LOAD, 20.8, "k^", label="measured, Table 7 (load inferred)")
    unit = "sinkage [mm]" if quantity == "sinkage" else "compaction resistance [N]"
    style(panel, "load [N]", unit, "dry sand, D 0.17 m, b 0.085 m")
    panel.legend(**_LEGEND)
    return figure
