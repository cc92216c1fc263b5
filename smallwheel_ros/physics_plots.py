"""Pictures of predictions, of single effects, and like the paper's figures 9, 13 and 14."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from smallwheel_ros.conditions import Conditions
from smallwheel_ros.contact import contact_sinkage
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.model import Model
from smallwheel_ros.model import predict as predict_rows
from smallwheel_ros.output import OutputError, check_target
from smallwheel_ros.paper import BEKKER, DIAMETER, PROPOSED, WIDTH
from smallwheel_ros.plots import COLOURS, new_figure, style
from smallwheel_ros.prediction import PredictionTable
from smallwheel_ros.sinkage import closed_form_sinkage
from smallwheel_ros.soil import SOILS, effective_modulus
from smallwheel_ros.traction import compaction_resistance

Array = NDArray[np.float64]

_PANELS = (
    ("sinkage", "sinkage [mm]", 1e3),
    ("resistance", "resistance [N]", 1.0),
    ("drawbar_pull", "drawbar pull [N]", 1.0),
)
_MOST_CURVES = 8
_TYPICAL = {
    "slip": np.linspace(0.0, 0.8, 60),
    "speed": np.geomspace(0.01, 1.0, 60),
    "pass_number": np.arange(1.0, 11.0),
    "slip_angle": np.linspace(0.0, np.pi / 2, 60),
    "slope": np.linspace(0.0, np.radians(20.0), 60),
    "grouser_height": np.linspace(0.0, 0.02, 60),
    "moisture": np.linspace(0.0, 0.3, 60),
    "width": np.linspace(0.03, 0.3, 60),
    "load": np.linspace(10.0, 150.0, 60),
}


def save(figure: Figure, path: Path) -> None:
    """Write a figure; the suffix picks the format. Raises OutputError."""
    check_target(path)
    try:
        figure.savefig(path, dpi=130)
    except (OSError, ValueError) as error:
        raise OutputError(f"{path}: cannot be drawn: {error}") from error


def plot_prediction(table: PredictionTable, path: Path) -> None:
    """Each quantity over the setting with most values, a curve for each combination of the others.

    Bands are one standard deviation. A wheel sunk to its axle is left out.
    """
    sizes = {name: np.unique(v).size for name, v in table.settings.items()}
    along = max(sizes, key=lambda name: sizes[name])
    others = [name for name in table.varied if name != along]
    prediction = table.result.prediction
    panels = [p for p in _PANELS if getattr(prediction, p[0]) is not None]
    figure = new_figure(3.4 * len(panels), 3.2)
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    keys = np.stack([table.settings[n] for n in others]) if others else np.zeros((1, sizes[along]))
    curves = np.unique(keys, axis=1).T if others else np.zeros((1, 1))
    for number, curve in enumerate(curves[:_MOST_CURVES]):
        rows = np.all(keys == curve[:, None], axis=0) if others else np.ones(keys.shape[1], bool)
        rows &= ~prediction.immobilised
        label = ", ".join(f"{n} {v:g}" for n, v in zip(others, curve, strict=False))
        colour = COLOURS[number % len(COLOURS)]
        x = table.settings[along][rows]
        for panel, (quantity, _, factor) in zip(axes, panels, strict=True):
            y = getattr(prediction, quantity)[rows] * factor
            mark = {"marker": "o"} if x.size == 1 else {}
            panel.plot(x, y, color=colour, label=label, **mark)
            std = table.result.standard_deviation.get(quantity)
            if std is not None:
                band = std[rows] * factor
                panel.fill_between(x, y - band, y + band, color=colour, alpha=0.2, linewidth=0)
    for panel, (_, title, _) in zip(axes, panels, strict=True):
        style(panel, along.replace("_", " "), title)
    if others:
        axes[0].legend(fontsize=7, frameon=False)
    if len(curves) > _MOST_CURVES:
        figure.suptitle(f"the first {_MOST_CURVES} of {len(curves)} curves", fontsize=8)
    save(figure, path)


def plot_effect(family: tuple[type[Effect], ...], path: Path) -> None:
    """Sinkage and resistance over the driver of an effect: a curve for each form, at its start."""
    driver = (family[0].needs or ("load",))[0]
    if family[0].id == "width_dependent_modulus":
        driver = "width"
    span = _TYPICAL.get(driver, np.linspace(0.1, 2.0, 60))
    if family[0].id == "skid_sinkage":
        span = np.linspace(-0.8, 0.0, 60)
    settings: dict[str, ArrayLike] = {"load": 60.0, "diameter": 0.2, "width": 0.1, "slip": 0.2}
    settings |= {n: 0.1 for form in family for n in form.needs} | {driver: span}
    conditions = Conditions.of(**settings)
    # The contact integral is an effect upon eq. 10; every other effect stands on the integral.
    closed = family[0].id == "contact_geometry"
    base = Model(SOILS["dry_sand"], "closed_form" if closed else "contact_integral")
    figure = new_figure(6.8, 3.0)
    axes = figure.subplots(1, 2)
    curves = [("without", base), *((f.form, base + f()) for f in family)]
    for number, (label, model) in enumerate(curves):
        prediction = predict_rows(model, conditions)
        look = {"color": "#444444", "linestyle": "--"}
        if number:
            look = {"color": COLOURS[(number - 1) % len(COLOURS)], "linestyle": "-"}
        axes[0].plot(span, prediction.sinkage * 1e3, label=label, **look)
        axes[1].plot(span, prediction.resistance, **look)
    style(axes[0], driver.replace("_", " "), "sinkage [mm]", family[0].id)
    style(axes[1], driver.replace("_", " "), "resistance [N]", "dry sand, W 60 N, D 0.2 m")
    axes[0].legend(fontsize=7, frameon=False)
    save(figure, path)


def plot_paper(folder: Path) -> list[Path]:
    """Three figures from the paper's constants; gives the files. Its own data is not printed."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error.strerror or error}") from error
    drawn = []
    for name, figure in (
        ("figure_9_pressure_sinkage.png", _pressure_sinkage()),
        ("figure_13_sinkage.png", _over_load("sinkage")),
        ("figure_14_resistance.png", _over_load("resistance")),
    ):
        save(figure, folder / name)
        drawn.append(folder / name)
    return drawn


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
    panels[0].legend(fontsize=7, frameon=False)
    return figure


def _over_load(quantity: str) -> Figure:
    load = np.linspace(5.0, 150.0, 100)
    figure = new_figure(4.6, 3.2)
    panel = figure.subplots()
    laws: list[tuple[str, Array, float, float]] = []
    for label, soil in (("Bekker, eq. 7", BEKKER), ("proposed, eq. 10", PROPOSED)):
        modulus = float(effective_modulus(soil.k, soil.m, DIAMETER))
        z = closed_form_sinkage(load, DIAMETER, WIDTH, modulus, soil.n)
        laws.append((label, z, modulus, soil.n))
    modulus = float(effective_modulus(PROPOSED.k, PROPOSED.m, DIAMETER))
    exact = contact_sinkage(load, DIAMETER, WIDTH, modulus, PROPOSED.n).sinkage
    laws.append(("proposed, contact integral", exact, modulus, PROPOSED.n))
    for colour, (label, z, k, n) in zip(COLOURS, laws, strict=False):
        y = 1e3 * z if quantity == "sinkage" else compaction_resistance(z, WIDTH, k, n)
        panel.plot(load, y, color=colour, label=label)
    if quantity == "sinkage":
        panel.plot((46, 65, 84), (5.85, 8.8, 11.2), "ko", label="measured (Tables 3 and 7)")
    else:
        panel.plot((65,), (20.8,), "ko", label="measured (Table 7)")
    unit = "sinkage [mm]" if quantity == "sinkage" else "compaction resistance [N]"
    style(panel, "load [N]", unit, "dry sand, D 0.17 m, b 0.085 m")
    panel.legend(fontsize=7, frameon=False)
    return figure
