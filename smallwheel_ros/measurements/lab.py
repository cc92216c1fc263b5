# SPDX-License-Identifier: Apache-2.0
"""Tests of a lab in a table: plates and pressed wheels (pressure, rectangles, compliance), and shear tests.

load = pressure x area of the plate
sinkage = measured sinkage - compliance x load
"""

from __future__ import annotations

import numpy as np

from smallwheel_ros.measurements.columns import COLUMNS, LAB_COLUMNS, Mask, Texts
from smallwheel_ros.measurements.measurements import ShearTests
from smallwheel_ros.measurements.reading import BEFORE_TOUCH, TableColumns, check_range
from smallwheel_ros.measurements.settings import Index, curves_of_rows
from smallwheel_ros.physics.conditions import CONTACTS, PLATE, ROLLING, Array
from smallwheel_ros.physics.plates import equivalent_diameter, plate_area

_STIFFEST, _SOFTEST = 1e-10, 1e-2  # m/N: a press's steel frame, and a soft spring
_LIGHT = 0.01  # of a curve's largest load: less may be noise
_MOVED = 0.02  # of a curve's depth, travelled without load: before that it may be a power of depth
_ON_SOIL = 0.05  # of a curve's largest load: from there its power of depth is taken
_ABSENT = 5.0  # times the noise: a load by this power of depth that would have been noticed
_MOST_ZEROS = 12
_UNLOADED = 0.9  # of the largest load before it: less is a load that was taken off
_REBOUND = 0.002  # of the depth: less is noise of the sinkage
# Rank correlation of depth with the row number: above it, rows are taken to be in the order of time. Rebound
# is a small share of the depth and lowers it little; rows in no order have a correlation near 0.
_IN_ORDER = 0.7
_FEWEST = 5  # rows of a curve
_SAME_LOAD = 0.01  # of the load: a load cell reads a constant load to that
_NEEDED = ("normal_stress", "shear_stress", "shear_displacement")
_NEW_STRESS = 0.10  # of the normal stress: a change that begins another shear test
_NO_AREA = (
    "pressure needs the area that it acts on, and that of a wheel changes with its depth: give the "
    "wheel's load; for plates say contact = plate (--contact plate)"
)
_TWO_SHAPES = "a plate with a diameter too, expected one of the two: round or rectangular"


def take_contact(columns: TableColumns, given: str | None) -> None:
    """Set the contact of each row: rolling, pressed or plate.

    With neither a column nor an option, a table of pressures instead of loads is one of plates, unless it has
    a width and no length; any other table is one of rolling wheels.

    Parameters
    ----------
    columns
        The table's columns; `contact` is set.
    given
        Contact of all rows, from the option; None: it is taken from the table's column.
    """
    texts = columns.texts.get("contact")
    if given is not None and given not in CONTACTS:
        columns.add(f"contact given as '{given}', expected one of {', '.join(CONTACTS)}")
    elif given is not None and texts is not None:
        columns.problem("contact was given for all rows too, expected one of the two", "contact")
    if texts is None:
        pressed = columns.read("pressure") and not columns.there("load")
        plates = pressed and not (columns.there("width") and not columns.there("length"))
        if plates and given is None:
            columns.understood.append("pressure over sinkage and no width: tests of plates")
        columns.contact = np.full(columns.lines.size, given or (PLATE if plates else ROLLING))
        return
    columns.contact = contact = np.where(texts == "", ROLLING, texts)
    for word in np.setdiff1d(contact, CONTACTS):
        wanted = f"one of {', '.join(CONTACTS)} (blank is {ROLLING})"
        columns.problem(f"'{word}' found, expected {wanted}", "contact", contact == word)


def take_plates(columns: TableColumns, compliance: float | None) -> None:
    """Convert what a plate test states to load, diameter, width and the sinkage in the soil.

    A pressure times the plate's area is the load, and a rectangular plate has the diameter of the round one
    of the same area.

    Parameters
    ----------
    columns
        The table's columns, which are changed.
    compliance
        Compliance of the rig, m/N: its product with the load is subtracted from each sinkage; None: rigid.
    """
    plate, rolling = columns.contact == PLATE, columns.contact == ROLLING
    if plate.any():
        _take_sizes(columns, plate)
    if columns.read("pressure"):
        _take_pressure(columns, plate)
    for name in BEFORE_TOUCH:
        if columns.read(name):
            check_range(columns, name, COLUMNS[name], columns.numbers[name], rolling)
    if compliance is not None:
        _take_compliance(columns, rolling, compliance)


def _take_sizes(columns: TableColumns, plate: Mask) -> None:
    """Set diameter and width (the smaller side) of rectangular plates; round ones get no width."""
    diameter, width = columns.values("diameter"), columns.values("width")
    rectangular = np.zeros(plate.size, dtype=bool)
    if columns.read("length"):
        length = columns.numbers.pop("length")
        rectangular = plate & np.isfinite(length)
        columns.problem(_TWO_SHAPES, "length", rectangular & np.isfinite(diameter))
        lacking = rectangular & np.isnan(width)
        columns.problem("a plate's length without its width", "length", lacking)
        diameter = np.where(rectangular, equivalent_diameter(width, length), diameter)
        width = np.where(rectangular, np.minimum(width, length), width)
        columns.understood.append(
            f"rectangular plates in {int(rectangular.sum())} rows: b is the smaller side, D of the round "
            "plate of the same area"
        )
    if np.isfinite(diameter).any():
        columns.numbers["diameter"], columns.units["diameter"] = diameter, "m"
    if "width" in columns.numbers:
        columns.numbers["width"] = np.where(plate & ~rectangular, np.nan, width)


def _take_pressure(columns: TableColumns, plate: Mask) -> None:
    """Set the loads of plates that lack one to pressure times area; a problem for other contacts."""
    load = columns.values("load")
    wanted = np.isnan(load)
    if not wanted.any():
        return  # a column beside the load: a covariate, as any other
    pressure = columns.numbers.pop("pressure")
    columns.problem(_NO_AREA, "pressure", wanted & ~plate & np.isfinite(pressure))
    borne = pressure * plate_area(columns.values("diameter"))
    columns.numbers["load"] = np.where(wanted & plate, borne, load)
    columns.units["load"] = "N"
    columns.understood.append("load = pressure x area of the plate")


def _take_compliance(columns: TableColumns, rolling: Mask, compliance: float) -> None:
    load, sinkage = (columns.numbers.get(name) for name in ("load", "sinkage"))
    if not _STIFFEST <= compliance <= _SOFTEST:
        columns.add(
            f"compliance given as {compliance!r} m/N, expected {_STIFFEST:g} to {_SOFTEST:g} m/N: 1 mm "
            "under 1 kN is 1e-6 m/N"
        )
    elif load is not None and sinkage is not None:
        soil = sinkage - compliance * load
        less = f"sinkage less {compliance:g} m/N x load"
        wrong = f"{less} is under 0: is the compliance right?"
        columns.problem(wrong, "sinkage", rolling & (soil < 0.0))
        columns.numbers["sinkage"] = soil
        most = 1e3 * compliance * float(np.fmax.reduce(load))
        columns.understood.append(f"{less}, by the machine's compliance: up to {most:.3g} mm")


def name_curves(columns: TableColumns) -> None:
    """Name the runs "curve 1", "curve 2" ... in a table of curves without a column of runs.

    A curve begins where size or soil changes, or load and sinkage fall back (`settings.curves_of_rows`).
    Otherwise each row of a curve would count as a run of its own.
    """
    texts, sinkage = columns.texts.get("run"), columns.numbers.get("sinkage")
    named = texts is not None and (texts != "").any()
    if named or sinkage is None:
        return
    load, z = columns.numbers["load"], np.nan_to_num(sinkage)
    sizes = [columns.numbers["diameter"], np.nan_to_num(columns.values("width"))]
    another = np.any([c[1:] != c[:-1] for c in (*sizes, *columns.texts.values())], axis=0)
    curve = curves_of_rows([load, z], lambda first, row: bool(another[row - 1]))
    columns.texts["run"] = np.array([f"curve {c + 1}" for c in curve])
    columns.understood.append(
        f"no column 'run': {int(curve[-1]) + 1} curves, each begins where size or soil changes or load "
        "and sinkage begin anew"
    )


def keep_rows_on_soil(columns: TableColumns, run: Texts) -> None:
    """Keep those rows of plates and pressed wheels in which the load presses them in for the first time.

    Before contact, load and sinkage are noise around 0, and a law of first loading does not describe a
    load that is removed and applied again. Where a curve begins above the soil, its sinkage is counted from
    the last row before contact. What is left out is reported. Rows of rolling wheels are all kept.

    Parameters
    ----------
    columns
        The table's columns, which are changed.
    run
        Name of each row's run, shape (rows,).

    Raises
    ------
    MeasurementsError
        If no row is left.
    """
    load, sinkage = columns.numbers["load"], columns.numbers.get("sinkage")
    pushed = columns.contact != ROLLING
    if sinkage is None:
        return
    early = pushed & ~((load >= COLUMNS["load"].low) & ~(sinkage < 0.0))
    if early.any():
        what = "rows of plates or pressed wheels are left out: load or sinkage is not over 0 there"
        columns.understood.append(columns.count(early, what))
    off = np.zeros(pushed.size, dtype=bool)
    zeros: dict[str, float] = {}
    for name in dict.fromkeys(run[pushed].tolist()):
        rows = np.flatnonzero((run == name) & pushed & ~early)
        travel = _free_travel(load[rows], sinkage[rows])
        if travel:
            zeros[str(name)] = zero = float(sinkage[rows[travel - 1]])
            early[rows[:travel]], rows = True, rows[travel:]
            sinkage[rows] -= zero
            early[rows[sinkage[rows] <= 0.0]] = True
            rows = rows[sinkage[rows] > 0.0]
        if rows.size >= _FEWEST:
            off[rows] = _unloaded(load[rows], sinkage[rows])
            _say_odd_load(columns, name, load[rows[~off[rows]]], sinkage[rows[~off[rows]]])
    if zeros:
        shown = ", ".join(f"{n} {1e3 * z:.3g}" for n, z in [*zeros.items()][:_MOST_ZEROS])
        columns.understood.append(
            f"{len(zeros)} curves begin before the body touches: rows up to there are left out, and their "
            f"sinkage counts from there (mm: {shown}{', ...' if len(zeros) > _MOST_ZEROS else ''})"
        )
    if off.any():
        what = "rows of curves are left out: the load was taken off or put on again there"
        columns.understood.append(columns.count(off, what))
    if (early | off).all():
        named = {"load": load, "sinkage": sinkage}
        hints = "; ".join(f"{name} {why}" for name, v in named.items() if (why := _never_over_0(v)))
        columns.add(f"no row of load and sinkage over 0 is left{': ' if hints else ''}{hints}")
        columns.raise_any()
    columns.keep(~(early | off))


def _never_over_0(values: Array) -> str:
    """Words for a likely cause if no reading of a load cell or depth gauge is over 0; empty if one is."""
    if (values > 0.0).any():
        return ""
    if not (values < 0.0).any():
        return "is 0 throughout, was its sensor connected?"
    span = float(np.nanmax(values) - np.nanmin(values))
    if span < float(np.nanmedian(np.abs(values))):
        return "is under 0 throughout and hardly changes, has its zero been subtracted?"
    return "is under 0 throughout, is its sign the other one?"


def _free_travel(load: Array, sinkage: Array) -> int:
    """Number of rows of a curve, in order, before the body touches soil: it moves, the load does not rise.

    The load on soil is about a power of depth. If the power that fits the rest of the curve gives a load at
    the last of these rows that is not far over the noise, soil may be there unnoticed: 0 is returned.
    """
    light = load < _LIGHT * float(np.max(load, initial=0.0))
    count = int(np.argmin(light)) if not light.all() else 0
    if count < _FEWEST or not np.isfinite(sinkage).all():
        return 0
    noise = 2.0 * float(np.max(load[:_FEWEST]))
    above = np.flatnonzero(load > noise)
    loaded = above[
        np.all([load[np.minimum(above + i, load.size - 1)] > noise for i in range(3)], axis=0)
    ]
    count = int(loaded[0]) if loaded.size else 0
    moved = float(sinkage[count - 1] - sinkage[0]) if count >= _FEWEST else 0.0
    third = max(count // 3, 1)
    rises = np.median(load[count - third : count]) > noise
    far = moved > _MOVED * float(np.max(sinkage)) and sinkage[count - 1] > 3.0 * sinkage[0]
    on = (load > _ON_SOIL * float(np.max(load))) & (sinkage > 0.0)
    if count < _FEWEST or not far or rises or np.count_nonzero(on) < _FEWEST:
        return 0
    slope, level = np.polyfit(np.log(sinkage[on]), np.log(load[on]), 1)
    carried = np.exp(level + slope * np.log(sinkage[count - 1]))
    return count if carried > _ABSENT * noise else 0


def _unloaded(load: Array, sinkage: Array) -> Mask:
    """Mask of the rows of one curve, in order, whose load and sinkage are below what was reached before."""
    end = 0 if np.isnan(sinkage).all() else int(np.nanargmax(sinkage))
    down = sinkage[: end + 1]
    if end < _FEWEST or not _rise(np.arange(end + 1), down) > _IN_ORDER:
        return np.zeros(load.size, dtype=bool)
    reached, deepest = np.maximum.accumulate(load), np.fmax.accumulate(sinkage)
    back = sinkage < deepest - _REBOUND * sinkage[end]
    return np.asarray((load < _UNLOADED * reached) & back)


def _rise(one: Array | Index, other: Array) -> float:
    """Spearman's rank correlation; NaN if either has one value throughout."""
    from scipy.stats import spearmanr  # slow to import, and few tables have curves

    return np.nan if np.ptp(one) == 0 or np.ptp(other) == 0 else float(spearmanr(one, other)[0])


def _say_odd_load(columns: TableColumns, name: str, load: Array, sinkage: Array) -> None:
    """Warn of a curve of load (N) over sinkage (m) that no soil has: constant, or falling with depth."""
    known = np.isfinite(sinkage)
    if known.sum() < _FEWEST or np.ptp(sinkage[known]) == 0.0:
        return
    least, most = sinkage[known].min(), sinkage[known].max()
    constant = np.ptp(load) <= _SAME_LOAD * load.max()
    if constant and most > 2.0 * least:
        columns.warnings.append(
            f"run '{name}': the load is {load.mean():.4g} N at all depths from {1e3 * least:.3g} to "
            f"{1e3 * most:.3g} mm, which no soil has: is it the load at that depth, or that of "
            "the whole test?"
        )
    elif not constant and _rise(load[known], sinkage[known]) < 0.0:
        columns.warnings.append(
            f"run '{name}': the load falls while the body goes deeper, and no law of pressure over depth "
            "does that: are load and sinkage in the right columns, with the right signs?"
        )


def shear_tests(columns: TableColumns) -> ShearTests:
    """The shear tests in the columns of a table; rows with a blank cell are left out.

    Raises MeasurementsError, which lists all problems.
    """
    columns.lacking(
        f"no column '{name}' ({LAB_COLUMNS[name].description})"
        for name in _NEEDED
        if name not in columns.headings
    )
    sigma = columns.values("normal_stress")
    columns.outside("normal_stress", sigma, sigma <= 0.0, "over 0")
    columns.raise_any()
    for name in (n for n in _NEEDED if n not in columns.numbers):
        columns.problem("the whole column is blank", name)
    columns.raise_any()
    blank = np.any([np.isnan(columns.numbers[name]) for name in _NEEDED], axis=0)
    if blank.any():
        columns.understood.append(f"{int(blank.sum())} rows with a blank cell are left out")
        columns.keep(~blank)
    sigma, stress, j = (columns.numbers[name] for name in _NEEDED)
    soil = columns.texts.get("soil", np.full(sigma.size, ""))
    run = _shear_runs(columns, sigma, j, soil)
    said = tuple(columns.notes), tuple(columns.understood)
    return ShearTests(
        sigma, stress, j, run, soil, columns.lines, *said, columns.source, columns.sha256
    )


def _shear_runs(columns: TableColumns, sigma: Array, j: Array, soil: Texts) -> Texts:
    named = columns.texts.get("run")
    if named is not None and (named != "").all():
        return named

    def other(first: int, row: int) -> bool:
        """Whether a row has another stress or soil than the first row of the curve."""
        new_stress = abs(sigma[row] - sigma[first]) > _NEW_STRESS * sigma[first]
        return bool(new_stress or soil[row] != soil[first])

    run = curves_of_rows([j], other)
    columns.understood.append(
        f"no column 'run': {int(run[-1]) + 1} tests, each begins where the normal stress changes or the "
        "displacement begins anew"
    )
    return np.array([f"test {i + 1}" for i in run])
