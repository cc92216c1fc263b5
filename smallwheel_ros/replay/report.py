# SPDX-License-Identifier: Apache-2.0
"""The report of a replayed drive: path, wheels, soil, and messages that were not used."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from smallwheel_ros.common.errors import nearest
from smallwheel_ros.common.result import ResultError
from smallwheel_ros.costmap.grid import Grid, read_map
from smallwheel_ros.drive.statements import WARNINGS
from smallwheel_ros.measurements.display import number, percent
from smallwheel_ros.pipeline.refused import NO_ROW
from smallwheel_ros.pipeline.warning.warning_level import WarningLevel
from smallwheel_ros.replay.result import FILES, Replayed
from smallwheel_ros.replay.tables import is_used
from smallwheel_ros.views.blocks import (
    Block,
    Callout,
    Column,
    Details,
    Figure,
    Section,
    Table,
    Text,
)
from smallwheel_ros.views.page import Page
from smallwheel_ros.views.plots import CYCLE, Layer, Mark, Panel
from smallwheel_ros.views.plots import draw as draw_panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_EVENTS = 25
_CAPTION = (
    "The path is in the frame of the odometry; dots are what happened, listed below. Drawbar margin: drawbar "
    "pull over load at the reference slip, of all wheels together; it is the tangent of the slope that could "
    "be climbed beyond the present one. Under 0 the wheels do not carry the vehicle on level ground. Cost: "
    "that of the ground there in cost_map.yaml, after the drive: the risk of getting stuck, in per cent, "
    "slope included. Where something is not known there is a gap."
)
_OF_WHEELS = (
    "Sinkage, where it is known, is predicted before the measurement of that instant is used; drawbar pull "
    "is at the slip of that instant; bands: 95 %. Dotted lines: the soil changed (green), a warning or a "
    "problem (orange)."
)
_OF_SOIL = (
    "The estimated soil, p = k z^n D^m. The reference pressure is what the drive determines first; "
    "k is the pressure at one metre of sinkage, far beyond small wheels."
)
_BAND = 1.96  # standard deviations: 95 %
_STEPS = 400  # of time, in which the path is drawn
_MOST_POINTS = 500  # of a curve: a plot is no wider on a screen
_LOW = 2.0  # inch, height of a plot over time
_GAP = 5.0  # times the usual step of time: a longer one is a gap
_BANDS = ("sinkage_predicted", "drawbar_pull", "mobility_margin")
_USED = {"time", "wheel", "x", "y", "status", "load", "sinkage_measured", "slip", *_BANDS}
_USED |= {f"{name}_standard_deviation" for name in _BANDS}

_MARGIN = "mobility_margin"
_SOIL = (
    ("soil_reference_pressure", "reference pressure [kPa]", 1e-3, True),
    ("soil_k", "k [Pa/m^(n+m)]", 1.0, True),
    ("soil_n", "n", 1.0, False),
    ("soil_m", "m", 1.0, False),
)


# --- The page


def page(result: Replayed, pictures: bool = True, folder: Path | None = None) -> Page:
    """Make the page of a replay.

    Parameters
    ----------
    result
        Result of the replay.
    pictures
        Whether the page has figures.
    folder
        Folder with its tables, from which figures are drawn; that of the spec if not given.
    """
    summary = result.to_dict(folder)
    return _page(summary, drive_blocks(summary, folder or result.spec.folder) if pictures else [])


def save_page(result: Replayed, folder: Path) -> None:
    """Write the page into the folder of a replay.

    Parameters
    ----------
    result
        Result of the replay.
    folder
        Folder with its tables, into which report.html is written; it may still be a draft.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    page(result, folder=folder).write(folder / FILES["report"])


def draw(axes: Axes, replayed: Replayed, quantity: str) -> None:
    """Draw one column of the estimates over time, one curve for each wheel.

    Parameters
    ----------
    axes
        Axes to draw on.
    replayed
        Result of the replay.
    quantity
        Name of the column, such as `sinkage_predicted`.

    Raises
    ------
    ResultError
        If there is no such column of numbers.
    """
    table = replayed.to_frame()
    numbers = [str(name) for name in table.select_dtypes("number").columns]
    if quantity not in numbers:
        raise ResultError(f"no column '{quantity}' in the estimates: {nearest(quantity, numbers)}")
    layers = []
    for i, (wheel, rows) in enumerate(table.groupby("wheel")):
        shown = rows.iloc[:: max(1, len(rows) // _MOST_POINTS)]
        name = str(wheel).replace("_", " ")
        layers.append(Layer("line", shown["time"], shown[quantity], colour=_colour(i), name=name,
                            width=1.0))  # fmt: skip
    draw_panel(axes, Panel("time [s]", quantity.replace("_", " "), layers=layers))


def _table(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    caption: str = "",
    numbers: Iterable[int] = (),
) -> Table:
    """A table of cells that are words already. numbers: columns set to the right."""
    right = set(numbers)
    columns = [Column(name, str(i), right=i in right) for i, name in enumerate(header)]
    return Table(columns, [{str(i): cell for i, cell in enumerate(row)} for row in rows], caption)


def _page(summary: dict[str, Any], drive: list[Block]) -> Page:
    return Page(
        "Replay of a drive",
        [
            Section("In short", _in_short(summary)),
            Section("The drive", drive),
            Section("The wheels", [_match_rates(summary)]),
            Section("The soil", _soil(summary)),
            Section("What happened", _events(summary)),
            Section("What was not used", _not_used(summary)),
            Section("Inputs", _inputs(summary)),
            Section("What to keep in mind", [_caveats(summary)]),
        ],
        summary["bag"],
        f"Parameters: {summary['config']}.",
    )


def _share(part: int, whole: int) -> str:
    """A part of a count, in per cent."""
    return f"{100.0 * part / whole:.3g} %" if whole else "-"


def _in_short(summary: dict[str, Any]) -> list[Callout]:
    blocks: list[Callout] = []
    if summary["state"] != "complete":
        headline = {
            "ended_early": "The bag is damaged: this is what could be read of it.",
            "interrupted": "The replay was interrupted: this is not the whole drive.",
        }[summary["state"]]
        blocks.append(Callout(headline, [summary["ended"]], "warning"))
    extent = (
        f"{summary['duration']:.1f} s, {summary['travel']:.1f} m, {summary['messages']['read']} messages,"
        f" {summary['estimates']} estimates of {len(summary['wheels'])} wheels."
    )
    if summary["estimates"] == 0:
        text = "Nothing could be estimated: see what was not used, and what is missing."
        blocks.append(Callout(text, [extent, *summary["missing"]], "warning"))
        return blocks
    soil, events = summary["soil"], summary["events"]
    sunk = _used(summary)
    lines = (
        [extent]
        if not sunk
        else [
            extent,
            "Pressure at "
            f"{1e3 * soil['reference_sinkage']:g} mm sinkage under a wheel of"
            f" {1e3 * soil['reference_diameter']:g} mm, at the end: "
            f"{number(1e-3 * soil['reference_pressure']['value'])} ±"
            f" {number(1e-3 * soil['reference_pressure']['std'], 2)} kPa"
            f"{'' if soil['reference_pressure']['determined'] else ', largely of the prior'}.",
        ]
    )
    if soil["status"] and sunk:
        lines.append(f"Not known: {'; '.join(soil['status'])}.")
    lines += _sentences(soil["remarks"] if sunk else [])
    lines += summary["diagnosis"]["text"] if summary["diagnosis"] else []
    lines += _mobility(summary, sunk)
    gets_stuck = any(event["kind"] == WARNINGS[-1] for event in events)
    headline = f"The soil changed {_times(soil['changes'])}."
    if soil["changes"] == 0:
        headline = "One soil throughout."
    if not sunk:
        headline = "No sinkage was used: the soil's law is unknown."
    headline += f" {_warnings(events)}"
    blocks.append(Callout(headline, lines, "warning" if gets_stuck else "result"))
    alarms = [event for event in events if event["kind"] == "missing_effect"]
    missed = [f"After {event['travel']:.0f} m: {event['text']}." for event in alarms[:3]]
    if missed:
        missed.append(
            "`smallwheel diagnose` on measurements.csv takes all of the drive into account."
        )
    concern = [summary["filter"]] if summary["filter"] else []
    blocks += [
        Callout("The model misses something", missed, "warning"),
        Callout("Look at these sensors", _sentences(summary["sensors"]), "warning"),
        Callout("The filter's innovations are not as expected", concern, "warning"),
        Callout("Inputs that the bag lacks", summary["missing"], "warning"),
    ]
    return [block for block in blocks if block.items]


def _warnings(events: list[dict[str, Any]]) -> str:
    """A sentence on how often each level of the warning began."""
    kinds = [event["kind"] for event in events]
    counts = {
        WarningLevel.warned(level).short: kinds.count(kind)
        for level, kind in enumerate(WARNINGS, 1)
    }
    parts = [f"{_times(count)} that it {words}" for words, count in counts.items() if count]
    return (
        f"Warnings of the vehicle: {', '.join(parts)}." if parts else "No warning of getting stuck."
    )


def _mobility(summary: dict[str, Any], sunk: bool) -> list[str]:
    """Slip, margin and risk, as far as they are known. sunk: whether the soil was measured."""
    told, strength = summary["mobility"], summary["strength"]
    slip, margin, risk = told["slip"], told["margin"], told["risk"]
    lines = [f"Slip: {_unknown(slip['known'])}."]
    if slip["median"] is not None:
        lines = [
            f"Slip: known in {percent(slip['known'])} of estimates, half under {number(slip['median'], 2)},"
            f" 95 % under {number(slip['quantile_95'], 2)}."
        ]
    if margin["median"] is not None:
        by = "as on any ground, by slip and the pull that was needed"
        if margin["of_prior"]:
            by = "any ground's: this drive has shown little of its own"
        if strength["of_model_file"]:
            by = "by the strength of the model file"
        if sunk and strength["determined"]:
            by = f"by {', '.join(strength['measured_by'])}"
        std = "" if margin["std"] is None else f" ± {number(margin['std'], 2)}"
        lines.append(
            f"Margin, pull over load at the reference slip: {number(margin['median'], 2)}{std},"
            f" {by}."
        )
    elif margin["known"]:
        lines.append(f"Margin: {_unknown(margin['known'])}.")
    if strength["of_prior"] and slip["median"] is not None:
        lines.append(
            f"Thrust, pull and energy: by the strength of {strength['of_prior']}, not measured."
        )
    if risk["highest"] is not None:
        lines.append(f"Risk of getting stuck: at most {number(risk['highest'], 2)}.")
    return lines


def _unknown(known: float) -> str:
    """A clause on why there are no typical values. known: share of estimates with the quantity, 0 to 1."""
    return f"known in {100 * known:.1f} % of estimates, too few to sum up" if known else "not known"


def _sentences(texts: Sequence[str]) -> list[str]:
    return [f"{text[0].upper()}{text[1:]}." for text in texts]


def _times(count: int) -> str:
    return {0: "at no point", 1: "once", 2: "twice"}.get(count, f"{count} times")


def drive_blocks(summary: dict[str, Any], folder: Path) -> list[Block]:
    """Make the figures of a drive: the path as a map, wheels and soil over time.

    Parameters
    ----------
    summary
        Content of replay.json.
    folder
        Folder with estimates.csv and, if there is one, the cost map.

    Returns
    -------
    list of Block
        Figures `path` (with odometry), `wheels` and `soil` (if a sinkage was used); empty without estimates.
    """
    counts = [wheel["estimates"] for wheel in summary["wheels"].values()]
    every = max(1, math.ceil(max(counts) / _MOST_POINTS))
    courses = read_courses(folder / FILES["estimates_csv"], every)
    if not courses:
        return []
    path = folder / FILES["cost_map"]
    ground = read_map(path) if path.exists() else None
    for course in courses.values():
        course["cost"] = _costs(ground, course)
    rows = pd.concat(list(courses.values())).sort_values("time", kind="stable")
    events = summary["events"]
    marks = [Mark(e["time"], "w2" if e["kind"] == "soil_change" else "w1") for e in events]
    maps = _maps(_way(rows), events)
    thinned = f" One estimate in {every} is shown." if every > 1 else ""
    wheels = [_wheel_data(name, course) for name, course in courses.items()]
    return [
        *([Figure("path", maps, _CAPTION)] if maps else []),
        Figure("wheels", _wheel_panels(wheels, marks), _OF_WHEELS + thinned),
        *(
            [Figure("soil", _soil_panels(_soil_data(rows), marks), _OF_SOIL)]
            if _used(summary)
            else []
        ),
    ]


def _colour(i: int) -> str:
    return CYCLE[i % len(CYCLE)]


def _maps(way: dict[str, Any] | None, events: Sequence[dict[str, Any]]) -> list[Panel]:
    """The path by sinkage, margin and cost, as far as they are known; none without odometry."""
    if way is None:
        return []
    x, y = (np.asarray(way[name], float) for name in ("x", "y"))
    places = np.reshape([e["place"] for e in events if e["place"] is not None], (-1, 2))
    happened = Layer("points", places[:, 0], places[:, 1], colour="w1", name="what happened")
    # Of the path's proportions, within limits in which it can be read.
    height = float(np.clip(7.5 * np.ptp(y[np.isfinite(y)]) / max(np.ptp(x[np.isfinite(x)]), 1e-9) + 1.0,
                           1.6, 5.0))  # fmt: skip
    names = {"sinkage": "sinkage [mm]", "margin": "drawbar margin [%]", "cost": "cost"}
    values = {label: np.asarray(way[name], float) for name, label in names.items()}
    return [
        Panel("x [m]", "y [m]", f"the path, coloured by {label}",
              [Layer("way", x, y, value=value), *([happened] if len(places) else [])],
              equal=True, wide=True, height=height)
        for label, value in values.items()
        if np.isfinite(value[:-1]).any()
    ]  # fmt: skip


def _wheel_panels(wheels: Sequence[dict[str, Any]], marks: Sequence[Mark]) -> list[Panel]:
    """Sinkage and drawbar pull of each wheel, and the slip of all, over time."""
    panels = []
    for i, wheel in enumerate(wheels):
        name, time, colour = wheel["name"].replace("_", " "), wheel["time"], _colour(i)
        deep = pd.concat([wheel["measured"], wheel["unused"], wheel["sinkage"]["y"]]).dropna()
        down = (1.15 * float(np.percentile(deep, 99.8)), 0.0) if len(deep) else None
        sinkage = [
            Layer("points", time, wheel["measured"], colour="base", name="measured"),
            Layer("points", time, wheel["unused"], colour="ink", name="measured, not used"),
            Layer("line", time, **wheel["sinkage"], colour=colour, name="predicted", width=1.2),
        ]
        shown = [layer for layer in sinkage if np.isfinite(np.asarray(layer.y, float)).any()]
        if shown:
            panels.append(_over_time("sinkage [mm]", f"{name}: sinkage", shown, marks, down))
        known = wheel["pull"]["y"].dropna()
        if len(known):
            low, high = np.percentile(known, [0.5, 99.5])
            room = 0.35 * (high - low) + 1.0
            pull = Layer("line", time, **wheel["pull"], colour=colour, width=1.2)
            panels.append(_over_time("drawbar pull [N]", f"{name}: drawbar pull", [pull], marks,
                                     (low - room, high + room)))  # fmt: skip
    slips = [
        Layer("line", w["time"], w["slip"], colour=_colour(i), name=w["name"].replace("_", " "), width=1.0)
        for i, w in enumerate(wheels)
    ]  # fmt: skip
    return [*panels, _over_time("slip", "slip", slips, marks, (-0.3, 1.05))]


def _soil_panels(soil: dict[str, Any], marks: Sequence[Mark]) -> list[Panel]:
    panels = []
    for part in soil["parts"]:
        line = Layer("line", soil["time"], part["y"], part["low"], part["high"], width=1.2)
        title = part["label"].partition(" [")[0]
        panels.append(_over_time(part["label"], title, [line], marks, log=part["log"]))
    return panels


def _over_time(y: str, title: str, layers: Sequence[Layer], marks: Sequence[Mark],
               y_range: tuple[float, float] | None = None, log: bool = False) -> Panel:  # fmt: skip
    return Panel("time [s]", y, title, layers, y_range=y_range, marks=marks, height=_LOW, log=log)


def _match_rates(summary: dict[str, Any]) -> Table:
    rows = []
    for name, wheel in summary["wheels"].items():
        count, rms = wheel["estimates"], wheel["sinkage_rms"]
        load, slip, used = (
            _share(wheel[part], count) for part in ("with_load", "with_slip", "used_for_soil")
        )
        off = "-" if rms is None else number(1e3 * rms)
        rows.append([name, str(count), load, slip if wheel["rolls"] else "-", used, off])
    header = ["wheel", "estimates", "with a load", "with slip", "used for the soil",
              "measured - predicted [mm rms]"]  # fmt: skip
    caption = "How many measurements had what they need at their instant"
    return _table(header, rows, caption, range(1, 6))


def _used(summary: dict[str, Any]) -> bool:
    """Whether any sinkage was used to update the soil."""
    return any(wheel["used_for_soil"] for wheel in summary["wheels"].values())


def _soil(summary: dict[str, Any]) -> list[Block]:
    soil = summary["soil"]
    if summary["estimates"] == 0:
        return []
    if not _used(summary):
        return [Text("No sinkage was used: k, n and m are as they were before the drive.")]
    rows = []
    for name in ("reference_pressure", "effective_modulus", "k", "n", "m"):
        found = soil[name]
        unit = "-" if found["unit"] == "1" else found["unit"]
        verdict = "yes" if found["determined"] else "no: essentially what was configured"
        value, deviation = number(found["value"], 4), number(found["std"], 2)
        rows.append([name.replace("_", " "), value, deviation, unit, verdict])
    header = ["at the end", "value", "standard deviation", "unit", "determined by the drive"]
    caption = "Under the law p = k z^n D^m"
    blocks: list[Block] = [_table(header, rows, caption, numbers=(1, 2))]
    if soil["status"]:
        blocks.append(Text("What the drive does not determine, and why:", soil["status"]))
    return blocks


def _events(summary: dict[str, Any]) -> list[Block]:
    rows = []
    for event in summary["events"]:
        place = (
            ""
            if event["place"] is None
            else "({:.1f}, {:.1f})".format(*(round(c, 1) + 0.0 for c in event["place"]))
        )
        again = f" ({event['times']} times; this is the first)" if event["times"] > 1 else ""
        rows.append(
            [f"{event['time']:.1f}", f"{event['travel']:.1f}", place, event["text"] + again]
        )
    if not rows:
        text = "No change of the soil, no wheel that digs in, no missing effect, no jump of time."
        return [Text(text)]
    header = ["time [s]", "distance [m]", "place [m]", "what"]
    blocks: list[Block] = [_table(header, rows[:_MOST_EVENTS], numbers=(0, 1))]
    if rows[_MOST_EVENTS:]:
        more = _table(header, rows[_MOST_EVENTS:], numbers=(0, 1))
        blocks.append(Details(f"{len(rows) - _MOST_EVENTS} more", [more]))
    if summary["unlisted_events"]:
        blocks.append(Text(f"{summary['unlisted_events']} more are not listed."))
    return blocks


def _not_used(summary: dict[str, Any]) -> list[Block]:
    received = {item["stream"]: item["messages"] for item in summary["inputs"]}
    for drop in summary[
        "not_used"
    ]:  # of messages that concerned a stream, those that gave it no row, too
        if drop["stream"] in received and drop["reason"] in NO_ROW:
            received[drop["stream"]] += drop["count"]
    rows = []
    for drop in summary["not_used"]:
        why = drop["reason"].replace("_", " ")
        share = _share(drop["count"], received.get(drop["stream"], 0))
        first = "-" if drop["first_time"] is None else f"{drop['first_time']:.1f}"
        rows.append([drop["topic"], why, str(drop["count"]), share, first, drop["example"]])
    if not rows:
        return [Text("Every message was used.")]
    header = ["topic", "why", "messages", "share", "first [s]", "the first one"]
    return [_table(header, rows, numbers=(2, 3, 4))]


def _inputs(summary: dict[str, Any]) -> list[Block]:
    rows = [
        [item["stream"], item["topic"], item["type"], str(item["messages"])]
        for item in summary["inputs"]
    ]
    blocks: list[Block] = [_table(["input", "topic", "type", "messages"], rows, numbers=(3,))]
    if summary["remaps"]:
        blocks.append(Text("Remapped:", [f"{a} to {b}" for a, b in summary["remaps"].items()]))
    if summary["notes"]:
        blocks.append(Callout("Parameters", summary["notes"], "warning"))
    if summary["not_copied"]:
        text = "Not in the new bag, since their type is not known:"
        blocks.append(Text(text, summary["not_copied"]))
    return blocks


def _caveats(summary: dict[str, Any]) -> Block:
    rows, lines = summary["measurements"]["rows"], []
    if _used(summary):
        lines.append("A filter can hide a missing physical effect by bending k, n and m.")
        if rows:
            lines[-1] += (
                f" The {rows} steady stretches in measurements.csv are for that question: "
                "`smallwheel diagnose`."
            )
    return Text(items=lines)


# --- Data of the page's figures; an unknown number is a gap


def _needed(column: Any) -> bool:
    return column in _USED or str(column).startswith("soil_")


def read_courses(table: Path, every: int) -> dict[str, pd.DataFrame]:
    """Read every n-th row of each wheel from a table of estimates.

    Parameters
    ----------
    table
        CSV file of estimates.
    every
        n; 1 reads all rows.

    Returns
    -------
    dict of DataFrame
        By the wheel's name, the columns that the page draws, as they stand in the file, and the column
        `used`: whether the row's sinkage was used to update the soil.
    """
    rows = pd.read_csv(table, usecols=_needed)
    rows["used"] = is_used(rows)
    return {str(wheel): course.iloc[::every].copy() for wheel, course in rows.groupby("wheel")}


def _wheel_data(name: str, course: pd.DataFrame) -> dict[str, Any]:
    rows = with_gaps(course.sort_values("time", kind="stable"))
    measured, used = 1e3 * rows["sinkage_measured"], rows["used"].eq(True)
    return {
        "name": name,
        "time": rows["time"],
        "measured": measured.where(used),
        "unused": measured.mask(used),
        "sinkage": _with_band(rows, "sinkage_predicted", 1e3),
        "pull": _with_band(rows, "drawbar_pull", 1.0),
        "slip": rows["slip"],
        "cost": rows["cost"],
    }


def _with_band(rows: pd.DataFrame, name: str, scale: float) -> dict[str, Any]:
    middle, half = scale * rows[name], _BAND * scale * rows[f"{name}_standard_deviation"]
    return {"y": middle, "low": middle - half, "high": middle + half}


def with_gaps(rows: pd.DataFrame) -> pd.DataFrame:
    """Insert a row without values wherever the column `time` makes a jump, so that no line crosses it.

    A jump is a step of more than 5 times the median one. Rows are in order of time, before and after.
    """
    time = rows["time"].to_numpy(dtype=float)
    step = np.diff(time)
    if step.size < 2:
        return rows
    jumps = np.flatnonzero(step > _GAP * np.median(step))
    blank = pd.DataFrame({"time": 0.5 * (time[jumps] + time[jumps + 1])})
    return pd.concat([rows, blank]).sort_values("time", kind="stable")


def _costs(ground: Grid | None, rows: pd.DataFrame) -> NDArray[np.float64]:
    """Costs of the map at the places of the vehicle, shape (rows,); NaN where unknown."""
    costs = np.full(len(rows), np.nan)
    if ground is None:
        return costs
    x, y = rows["x"].to_numpy(dtype=float), rows["y"].to_numpy(dtype=float)
    for i in np.flatnonzero(np.isfinite(x + y)):
        cell = ground.cell(float(x[i]), float(y[i]))
        if cell is not None and ground.cells[cell] >= 0:
            costs[i] = ground.cells[cell]
    return costs


def _way(rows: pd.DataFrame) -> dict[str, Any] | None:
    """The path in equal steps of time, NaN in an empty step; None without odometry.

    Sinkage (mm) is the mean over the wheels; the margin (per cent) that of the vehicle, with wheels weighted
    by load; the cost the highest one of the step.
    """
    rows = rows.dropna(subset=["x", "y"])
    if len(rows) < 2:
        return None
    since = rows["time"] - rows["time"].iloc[0]
    span = max(since.iloc[-1], 1e-9)
    step = (_STEPS * since / span).astype(int).clip(upper=_STEPS - 1)
    deep = rows["sinkage_measured"].fillna(rows["sinkage_predicted"])
    way = rows[["time", "x", "y"]].assign(sinkage=1e3 * deep).groupby(step).mean()
    loaded = rows.dropna(subset=["load", _MARGIN])
    weighted = pd.DataFrame({"load": loaded["load"], "pull": loaded["load"] * loaded[_MARGIN]})
    sums = weighted.groupby(step).sum().reindex(range(_STEPS))
    return {
        **way.reindex(range(_STEPS)),
        "margin": 100.0 * sums["pull"] / sums["load"],
        "cost": rows["cost"].groupby(step).max().reindex(range(_STEPS)),
    }


def _soil_data(rows: pd.DataFrame) -> dict[str, Any]:
    """Reference pressure, k, n and m over time with 95 % bands, those of the first two in the logarithm."""
    keep = np.linspace(0, len(rows) - 1, min(len(rows), _MOST_POINTS)).round().astype(int)
    rows = with_gaps(rows.iloc[np.unique(keep)])
    parts = []
    for name, label, scale, logarithmic in _SOIL:
        part: dict[str, Any] = {"label": label, "log": logarithmic}
        if logarithmic:  # closer to log-normal: such a band never reaches below zero
            spread = rows[f"{name}_standard_deviation"] / rows[name]
            factor = np.exp(_BAND * spread.clip(upper=3.0))
            middle = scale * rows[name]
            part |= {"y": middle, "low": middle / factor, "high": middle * factor}
        else:
            part |= _with_band(rows, name, scale)
        parts.append(part)
    return {"time": rows["time"], "parts": parts}
