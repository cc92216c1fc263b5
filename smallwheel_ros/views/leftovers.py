# SPDX-License-Identifier: Apache-2.0
"""Residuals of models: over a setting, and as measured against predicted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.held_out import CvErrors
from smallwheel_ros.measurements.columns import CHANNEL_UNITS
from smallwheel_ros.measurements.display import Display, column_display, display, words
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.measurements.settings import levels, varied_settings
from smallwheel_ros.views.plots import Layer, Panel
from smallwheel_ros.views.svg import frame

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_PARTS = 8  # of a setting, for the means
_POINTS = 600  # of a plot: beyond, the eye sees no more
_BYTES = 120_000  # of residuals in a page
_PREDICTED = ""  # in place of a setting's name, for the plot of measured over predicted values


class Means(NamedTuple):
    """Means over parts of the range of a setting, each of shape (parts,).

    Attributes
    ----------
    x, y
        Mean of the setting, and of the averaged quantity.
    half
        Twice the standard error of y over runs; NaN for fewer than three runs.
    """

    x: Array
    y: Array
    half: Array


class Left(NamedTuple):
    """Residuals of one model, and how they are drawn.

    Attributes
    ----------
    errors
        Measured minus predicted values of each channel.
    name
        Name of the model in the plot's key; empty for none.
    colour
        Key of `PALETTE`.
    """

    errors: CvErrors
    name: str
    colour: str


def means(x: Array, y: Array, run: Index) -> Means:
    """Average y over eight parts of x with equally many rows, or at each value of x if there are few values.

    Parameters
    ----------
    x, y
        Setting and quantity, shape (rows,), in any unit.
    run
        Number of each row's run, shape (rows,).

    Returns
    -------
    Means
        In the units of x and y; empty without rows.
    """
    if not x.size:
        return Means(*np.zeros((3, 0)))
    at = levels(x)
    if at is None:
        edges = np.quantile(x, np.linspace(0.0, 1.0, _PARTS + 1)[1:-1])
        part = np.searchsorted(edges, x, side="right")
    else:
        part = np.abs(x[:, None] - at).argmin(axis=1)
    found = []
    for one in np.unique(part):
        here = part == one
        of_runs = [y[here & (run == r)].mean() for r in np.unique(run[here])]
        known = len(of_runs) > 2
        half = 2.0 * np.std(of_runs, ddof=1) / np.sqrt(len(of_runs)) if known else np.nan
        found.append((x[here].mean(), np.mean(of_runs), half))
    return Means(*np.array(found).T)


def shown_channel(name: str) -> Display:
    """Unit and scale in which values of a channel are shown."""
    return display(name, CHANNEL_UNITS[name])


def thinned(rows: Index, most: int = _POINTS) -> Index:
    """Choose the rows that a picture shows: all, or a random sample if there are too many.

    Parameters
    ----------
    rows
        Indices of rows, ascending, shape (n,).
    most
        Largest number of rows.

    Returns
    -------
    ndarray
        The chosen indices, ascending, shape (min(n, most),); always the same for the same rows.
    """
    if rows.size <= most:
        return rows
    return np.sort(np.random.default_rng(0).choice(rows, most, replace=False))


def residual_panel(
    data: Measurements,
    models: Sequence[Left],
    channel: str,
    setting: str,
    floor: float | None = None,
) -> Panel:
    """Make a plot of the models' residuals over a setting, as points and means.

    Parameters
    ----------
    data
        The measurements.
    models
        Residuals of each model, with its name and colour.
    channel
        Name of the channel, such as `sinkage`.
    setting
        Name of the setting on the x-axis, such as `load`.
    floor
        Error expected of a true model, SI, for a band of twice that; None: no band.
    """
    how, across = shown_channel(channel), column_display(data, setting)
    layers, column, ends = [_band(how, floor)], data.conditions[setting], [0.0]
    for one in models:
        error = one.errors.error.get(channel)
        if error is None:
            continue
        at = np.flatnonzero(np.isfinite(error) & np.isfinite(column))
        x, y = across.scale * column[at], how.scale * error[at]
        some = thinned(np.arange(at.size))
        mean = means(x, y, one.errors.run[at])
        layers += [
            Layer("points", x[some], y[some], colour=one.colour, name=one.name),
            Layer(
                "means", mean.x, mean.y, mean.y - mean.half, mean.y + mean.half, colour=one.colour
            ),
        ]
        ends += y.tolist()
    room = 0.06 * max(max(ends) - min(ends), 1e-9)
    return Panel(
        across.label, f"measured - predicted [{how.unit}]", words(channel), layers,
        x_range=_range(across.scale * column), y_range=(min(ends) - room, max(ends) + room),
    )  # fmt: skip


def measured_panel(measured: Array, models: Sequence[Left], channel: str) -> Panel:
    """Make a plot of measured over predicted values, a series for each model, with the line of equality.

    Points beyond the axes are not drawn, but counted in the title.

    Parameters
    ----------
    measured
        Measured values of the channel, SI, shape (rows,).
    models
        Residuals of each model, with its name and colour.
    channel
        Name of the channel, such as `sinkage`.
    """
    how = shown_channel(channel)
    layers, ends = (
        [Layer("band", low=0.0, high=0.0, diagonal=True)],
        _range(how.scale * measured, 0.15),
    )
    beyond = 0
    for one in models:
        residual = one.errors.error.get(channel)
        if residual is None:
            continue
        predicted = how.scale * (measured - residual)
        inside = (predicted >= ends[0]) & (predicted <= ends[1])
        beyond += int(np.count_nonzero(np.isfinite(residual) & ~inside))
        at = thinned(np.flatnonzero(inside))
        y = how.scale * measured[at]
        layers.append(Layer("points", predicted[at], y, colour=one.colour, name=one.name))
    title = words(channel)
    if beyond:
        title += f" ({beyond} point{'s' if beyond > 1 else ''} beyond the axes)"
    return Panel(f"predicted {how.label}", f"measured {how.label}", title, layers,
                 x_range=ends, y_range=ends)  # fmt: skip


def settings_of(data: Measurements) -> list[str]:
    """Names of the settings that were varied, or of the load if none was."""
    return list(varied_settings(data)) or ["load"]


def leftovers(
    data: Measurements,
    models: Mapping[str, CvErrors],
    base: str,
    base_name: str,
    floors: Mapping[str, float | None],
    first: str | None = None,
) -> dict[str, Any]:
    """Make the data from which a page's script draws the residuals of the model that its reader chooses.

    Parameters
    ----------
    data
        The measurements.
    models
        Residuals of each model, by its key in `Models.views`.
    base
        Key of the model that is drawn in grey beside the chosen one.
    base_name
        Name of that model on the page.
    floors
        By channel, the error expected of a true model, SI, drawn as a band; None if unknown.
    first
        Setting on the x-axis when the page opens; None: the first of `settings_of`.

    Returns
    -------
    dict
        Value of `Models.leaves`, in the units that are shown. Its main keys: `frames`, a plot with axes but
        without points for each channel over each setting; `settings`, their values; `channels`, the measured
        values; `left`, residuals by model and channel; `means`, means of the residuals over each setting. Of
        large tables only a random sample of the rows is in it.
    """
    settings, error = settings_of(data), models[base].error
    most = max(100, min(_POINTS, _BYTES // (6 * len(models) * max(len(error), 1))))
    rows = {c: thinned(np.flatnonzero(np.isfinite(e)), most) for c, e in error.items()}
    kept = np.unique(np.concatenate([np.zeros(0, int), *rows.values()])).astype(int)
    across = {name: column_display(data, name) for name in settings}
    frames, steps = [], {}
    for channel in rows:
        for name in (*settings, _PREDICTED):
            panel = _frame_panel(data, models, channel, name, floors.get(channel))
            if name != _PREDICTED:
                steps[channel] = _step(*(panel.y_range or (0.0, 1.0)))
            text, scale = frame(panel)
            frames.append({"channel": channel, "over": name, "title": panel.title, "svg": text,
                           "scale": scale, "label": panel.label})  # fmt: skip
    return {
        "base": base_name,
        "base_key": base,
        "first": first or settings[0],
        "over": {name: how.label for name, how in across.items()},
        "frames": frames,
        "rows": [f"run {data.run[row]}, {data.place} {data.line[row]}"[:100] for row in kept],
        "settings": {
            n: {"words": words(n), "unit": how.unit, "values": data.conditions[n][kept] * how.scale}
            for n, how in across.items()
        },
        "channels": {
            c: {"words": words(c), "unit": shown_channel(c).unit, "rows": np.searchsorted(kept, at),
                "measured": shown_channel(c).scale * data.channels[c][at], "step": steps[c]}
            for c, at in rows.items()
        },
        "left": {
            key: {c: _in_steps(shown_channel(c).scale * one.error[c][at], steps[c])
                  for c, at in rows.items() if c in one.error}
            for key, one in models.items()
        },
        "at": {c: {n: _means_of(data, models[base], c, n).x for n in settings} for c in rows},
        "means": {
            key: {c: {n: _in_steps(np.array(_means_of(data, one, c, n)[1:]).T.ravel(), steps[c])
                      for n in settings}
                  for c in rows if c in one.error}
            for key, one in models.items()
        },
    }  # fmt: skip


def _frame_panel(
    data: Measurements, models: Mapping[str, CvErrors], channel: str, name: str, floor: float | None
) -> Panel:
    """A plot with axes and band only: the page's script adds the points of the chosen model."""
    how = shown_channel(channel)
    left = [how.scale * e.error[channel] for e in models.values() if channel in e.error]
    measured = how.scale * data.channels[channel]
    title = f"{words(channel)}: residual over {words(name)}"
    if name == _PREDICTED:
        reach = np.nanquantile(np.concatenate([measured - e for e in left]), [0.002, 0.998])
        across = _range(np.concatenate([reach, measured[np.isfinite(left[0])]]))
        return Panel(f"predicted {how.label}", f"measured {how.label}",
                     f"{words(channel)}: measured against predicted",
                     [_band(how, floor, diagonal=True)], x_range=across,
                     y_range=_range(measured))  # fmt: skip
    shown = column_display(data, name)
    ends = np.nanquantile(np.concatenate([*left, [0.0]]), [0.002, 0.998])
    return Panel(shown.label, f"measured - predicted [{how.unit}]", title, [_band(how, floor)],
                 x_range=_range(shown.scale * data.conditions[name]), y_range=_range(ends))  # fmt: skip


def _band(how: Display, floor: float | None, diagonal: bool = False) -> Layer:
    half = 2.0 * how.scale * (floor or 0.0)
    return Layer("band", low=-half, high=half, diagonal=diagonal)


def _range(values: Array, room: float = 0.05) -> tuple[float, float]:
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    margin = room * (high - low) or 0.05 * abs(high) or 0.5
    return low - margin, high + margin


def _means_of(data: Measurements, errors: CvErrors, channel: str, name: str) -> Means:
    """Means of a channel's residuals over a setting, in the units shown."""
    how, column = shown_channel(channel), data.conditions[name]
    at = np.flatnonzero(np.isfinite(errors.error[channel]) & np.isfinite(column))
    x = column_display(data, name).scale * column[at]
    return means(x, how.scale * errors.error[channel][at], errors.run[at])


def _step(low: float, high: float) -> float:
    """The step to which residuals are rounded: a power of ten, at most a hundredth of an axis."""
    return float(10.0 ** np.floor(np.log10(1e-2 * (high - low))))


def _in_steps(values: Array, step: float) -> list[int | None]:
    """Values as whole numbers of steps, which are short in a page; None where a value is not finite."""
    return [round(value / step) if np.isfinite(value) else None for value in values]
