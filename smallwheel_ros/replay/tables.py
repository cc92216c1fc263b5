# SPDX-License-Identifier: Apache-2.0
"""The tables of a drive: estimates, twists, the vehicle's mobility, and steady stretches as measurements.

Consecutive readings of a sensor are not independent evidence, since they are of the same spot. Each
row of measurements is therefore the median of a wheel's readings over a stretch as long as the
circumference of the largest wheel (for a pressed wheel, 0.5 mm of new depth), and the rows of one
stretch are one run. Stretches in which load, slip or speed changed are left out, since a row must be
one steady measurement; so are the last two before a change of soil, when some wheels may be on the
new soil already. The pass number is that of the middle half of a stretch's readings. If it is known
for most rows, rows without it are left out, since that column of a table of measurements has no
blanks; otherwise the column is left out.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from smallwheel_ros.bags.types import plain_fields
from smallwheel_ros.common.errors import reason
from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.drive.messages import VALID, VEHICLE_VALID
from smallwheel_ros.fitting.noise import NORMAL
from smallwheel_ros.physics.conditions import PRESSED
from smallwheel_ros.physics.wheel import GRAVITY, Wheel
from smallwheel_ros.pipeline.mobility.status import Status
from smallwheel_ros.pipeline.soil.identifiability import SoilEstimate
from smallwheel_ros.pipeline.tables import Array, Estimates, Flags, Integers, Readings
from smallwheel_ros.pipeline.twist.twist import Twists
from smallwheel_ros.replay.new_bag import MOBILITY, SOIL
from smallwheel_ros.replay.spec import ReplayError

_FIRST = ("stamp", "time", "wheel", "x", "y", "speed", "travel", "status", "status_text")
_BLOCK = 20_000  # rows that are kept before they are written, or reduced to stretches
COUNTS = ("estimates", "with_sinkage", "with_load", "with_slip", "used_for_soil")
MARGIN = "mobility_margin"
# Share of the estimates: a quantity that fewer of them have is not summed up, such as the slip by an odometry
# that was refused after 1 s.
SUMMED_UP = 0.05
_MOBILITY = ("slip", MARGIN, f"{MARGIN}_standard_deviation")
_STATUS = np.array([status.name for status in Status], dtype=object)
_FEWEST_READINGS = 3
# Quartile to quartile: slip as it is, load and speed as a share of their median. Sinkage goes with
# load to a power near 1, so a load that scatters by half makes the median sinkage wrong by 1 %.
_STEADY_SLIP, _STEADY_SHARE = 0.1, 0.5
_KEYS = ["soil", "stretch", "wheel"]
_DEPTH = 0.5e-3  # m of new depth that make a stretch of a pressed wheel's way


# --- Estimates


@cache
def columns() -> tuple[str, ...]:
    """Names of the columns of a table of estimates, in order.

    They are the fields of MobilityEstimate and, with the prefix `soil_`, of SoilEstimate, without the flags
    of validity, since unknown cells are blank.
    """
    mobility = [name for name in plain_fields(MOBILITY) if name not in VALID]
    soil = [f"soil_{name}" for name in plain_fields(SOIL)]
    deviations = [f"soil_{name}_standard_deviation" for name in "knm"]
    return tuple(dict.fromkeys([*_FIRST, *mobility, *soil, *deviations, "soil_changes"]))


def deviations(soil: SoilEstimate) -> dict[str, float]:
    """Standard deviations of k, n and m (SI), as k_standard_deviation and so on."""
    spread = np.sqrt(np.maximum(soil.covariance.diagonal(), 0.0)).tolist()
    return {f"{name}_standard_deviation": value for name, value in zip("knm", spread, strict=True)}


class EstimatesTable(AbstractContextManager["EstimatesTable"]):
    """A table of estimates, written block by block as NAME.csv and, if pyarrow is installed, NAME.parquet.

    Use it in a `with` statement, at whose end the last block is written.

    Parameters
    ----------
    stem
        Path of the files without suffix.
    start
        Log time at which the column `time` is 0, ns.
    wheels
        Names of the wheels, in the order of their numbers.

    Attributes
    ----------
    counts
        By wheel, the numbers of estimates named in `COUNTS`, and `squares`, the sum of (measured - predicted
        sinkage)^2 over the estimates used for the soil, m^2.
    statuses
        Number of estimates by the name of their status.
    mobility
        Slip, margin and the margin's standard deviation of every estimate, block by block.
    """

    def __init__(self, stem: Path, start: int, wheels: Sequence[str]) -> None:
        self._csv, self._parquet_path = Path(f"{stem}.csv"), Path(f"{stem}.parquet")
        self._start, self._wheels = start, np.array(wheels, dtype=object)
        self._blocks: list[dict[str, Any]] = []  # columns, by turns of the pipeline
        self._soils: list[Mapping[str, Any]] = []  # of the block
        self._waiting = 0
        self._parquet: Any = None
        self._begun = False
        self.counts: dict[str, Counter[str]] = {}
        self.statuses: Counter[str] = Counter()
        self.mobility: list[pd.DataFrame] = []

    @property
    def knows_nothing(self) -> bool:
        """Whether no estimate has slip, margin or a measured sinkage."""
        sunk = any(counts["with_sinkage"] for counts in self.counts.values())
        return not sunk and not any(
            b[["slip", MARGIN]].notna().any(axis=None) for b in self.mobility
        )

    def told(self) -> dict[str, dict[str, float | None]]:
        """Summarise slip and margin over the drive.

        Returns
        -------
        dict
            For `slip`, the share of estimates that have it (`known`, 0 to 1), its `median` and its
            `quantile_95`; for `margin`, `known`, `median`, and as `std` the median of its standard
            deviations. Apart from the share, values are None where fewer than `SUMMED_UP` of the estimates
            have the quantity.
        """
        rows = pd.concat(self.mobility) if self.mobility else pd.DataFrame(columns=list(_MOBILITY))
        slip, margin, spread = (rows[name].dropna().astype(float) for name in _MOBILITY)
        figures = {
            "slip": (slip, {"median": slip.median(), "quantile_95": slip.quantile(0.95)}),
            "margin": (margin, {"median": margin.median(), "std": spread.median()}),
        }
        return {name: _figures(len(of), len(rows), found) for name, (of, found) in figures.items()}

    def add(
        self,
        rows: Estimates,
        speed: Array,
        columns: Mapping[str, Any],
        soils: Sequence[Mapping[str, Any]],
        soil_of: Integers,
    ) -> None:
        """Add the estimates of one turn of the pipeline.

        Parameters
        ----------
        rows
            The estimates.
        speed
            Speed of each row's wheel over the ground, m/s, shape (rows,).
        columns
            Fields of MobilityEstimate by name, each of shape (rows,).
        soils
            Fields of SoilEstimate by name, with standard deviations, for each soil of these rows.
        soil_of
            Index in `soils` for each row, shape (rows,).

        Raises
        ------
        ReplayError
            If a block cannot be written.
        """
        if not len(rows):
            return
        self._blocks.append(
            {
                **columns,
                "stamp": rows.stamp,
                "wheel": self._wheels[rows.wheel],
                "x": rows.x,
                "y": rows.y,
                "speed": speed,
                "travel": rows.distance,
                "status": _STATUS[rows.status],
                "rejected": rows.rejected,
                "soil_at": soil_of + len(self._soils),
            }
        )
        self._soils += soils
        self._waiting += len(rows)
        if self._waiting >= _BLOCK:
            self._write()

    def __exit__(self, *_: object) -> None:
        if self._waiting or not self._begun:
            self._write()
        if self._parquet is not None:
            self._parquet.close()

    def _write(self) -> None:
        """Write the block."""
        block = pd.DataFrame()
        if self._blocks:
            block = pd.DataFrame(
                {name: np.concatenate([b[name] for b in self._blocks]) for name in self._blocks[0]}
            )
            soil = pd.DataFrame(self._soils).drop(columns="covariance", errors="ignore")
            soil = soil.add_prefix("soil_").take(block["soil_at"].to_numpy())
            block = pd.concat([block, soil.reset_index(drop=True)], axis=1)
            block["soil_measurements_rejected"] = block["rejected"]
            block["time"] = (block["stamp"] - self._start) / SECOND
            for flag, names in VALID.items():
                unknown = [*names, *(f"{name}_standard_deviation" for name in names)]
                block.loc[~block[flag], block.columns.intersection(unknown)] = np.nan
        block = block.reindex(columns=list(columns())).astype({"wheel": str, "status": str})
        self._blocks, self._soils, self._waiting = [], [], 0
        self._count(block)
        try:
            # As objects: Python writes the same digits as NumPy, in half the time.
            block.astype(object).to_csv(self._csv, mode="a", header=not self._begun, index=False)
            self._write_parquet(block)
        except OSError as error:
            raise ReplayError(f"{self._csv}: cannot be written: {reason(error)}") from error
        self._begun = True

    def _write_parquet(self, block: pd.DataFrame) -> None:
        try:
            import pyarrow
            from pyarrow.parquet import ParquetWriter
        except ImportError:
            return
        numbers = block.columns.difference(block.select_dtypes(object).columns)
        floats = [name for name in numbers if block[name].dtype.kind == "f"]
        table = pyarrow.Table.from_pandas(block.astype(dict.fromkeys(floats, float)))
        if self._parquet is None:
            self._parquet = ParquetWriter(self._parquet_path, table.schema)
        self._parquet.write_table(table.cast(self._parquet.schema))

    def _count(self, block: pd.DataFrame) -> None:
        used = is_used(block)
        off = (block["sinkage_measured"] - block["sinkage_predicted"]).astype(float)
        counted = pd.DataFrame(
            {
                "wheel": block["wheel"],
                "estimates": 1,
                "with_sinkage": block["sinkage_measured"].notna(),
                "with_load": block["load"].notna(),
                "with_slip": block["slip"].notna(),
                "used_for_soil": used,
                "squares": (off**2).where(used).fillna(0.0),
            }
        )
        for wheel, sums in counted.groupby("wheel").sum().iterrows():
            known = self.counts.setdefault(str(wheel), Counter())
            known.update({str(name): value for name, value in sums.items()})
        self.statuses.update(block["status"])
        self.mobility.append(block[list(_MOBILITY)].astype(float))


def is_used(table: pd.DataFrame) -> pd.Series[bool]:
    """Whether the measured sinkage of each row of a table of estimates was used for the soil."""
    known = table["load"].notna() & table["sinkage_measured"].notna()
    return known & (table["status"] != "REJECTED")


def _figures(known: int, rows: int, found: Mapping[str, float]) -> dict[str, float | None]:
    """The share of rows with a quantity, and its typical values: None if too few rows have it."""
    share = known / max(rows, 1)
    values = {
        key: float(v) if math.isfinite(v) and share >= SUMMED_UP else None
        for key, v in found.items()
    }
    return {"known": share, **values}


class TwistsTable:
    """Rows of the vehicle's twist, written as NAME.csv and, if pyarrow is installed, NAME.parquet.

    Parameters
    ----------
    start
        Log time at which the column `time` is 0, ns.
    """

    def __init__(self, start: int) -> None:
        self._start = start
        self._rows: list[Twists] = []

    def add(self, rows: Twists) -> None:
        """Add rows."""
        self._rows.append(rows)

    def write(self, stem: Path) -> None:
        """Write the rows, if there are any. Raises ReplayError."""
        if not self._rows:
            return
        rows = Twists.joined(self._rows)
        found = {one.name: getattr(rows, one.name) for one in fields(rows)}
        table = pd.DataFrame(found)
        table.insert(1, "time", (table["stamp"] - self._start) / SECOND)
        _write_table(table, stem)


class VehicleTable:
    """Rows of VehicleMobility, written as NAME.csv and, if pyarrow is installed, NAME.parquet.

    They have no flags of validity: unknown values are blank.

    Parameters
    ----------
    start
        Log time at which the column `time` is 0, ns.
    """

    def __init__(self, start: int) -> None:
        self._start = start
        self._blocks: list[pd.DataFrame] = []

    def add(self, stamps: Integers, columns: Mapping[str, Any]) -> None:
        """Add the vehicle's rows of one turn of the pipeline.

        Parameters
        ----------
        stamps
            Stamps of the rows, ns, shape (rows,).
        columns
            Fields of VehicleMobility by name, each of shape (rows,).
        """
        block = pd.DataFrame({"stamp": stamps, "time": (stamps - self._start) / SECOND, **columns})
        for flag, names in VEHICLE_VALID.items():
            about = [*names, *(f"{name}_standard_deviation" for name in names)]
            about += ["margin_source", "margin_information"] if flag == "margin_valid" else []
            for name in block.columns.intersection(about):
                block[name] = block[name].astype(float).where(block[flag])
        self._blocks.append(block.drop(columns=list(VEHICLE_VALID)))

    def risk(self) -> dict[str, float | None]:
        """The risk of getting stuck, 1: the share of rows that have it (`known`), its `median` and `highest`.

        The median is None where fewer than `SUMMED_UP` of the rows have the risk, the highest where none has.
        """
        rows = [block["risk_of_getting_stuck"] for block in self._blocks]
        risk = pd.concat(rows) if rows else pd.Series(dtype=float)
        known = risk.dropna()
        # A median needs enough rows; the highest risk counts however rare it is.
        highest = float(known.max()) if len(known) else None
        return {**_figures(len(known), len(risk), {"median": known.median()}), "highest": highest}

    def write(self, stem: Path) -> None:
        """Write the rows, if there are any. Raises ReplayError."""
        if self._blocks:
            _write_table(pd.concat(self._blocks, ignore_index=True), stem)


def _write_table(table: pd.DataFrame, stem: Path) -> None:
    """Write NAME.csv and, where pyarrow is installed, NAME.parquet. Raises ReplayError."""
    try:
        table.to_csv(f"{stem}.csv", index=False)
        table.to_parquet(f"{stem}.parquet", index=False)
    except ImportError:
        pass
    except OSError as error:
        raise ReplayError(f"{stem}.csv: cannot be written: {reason(error)}") from error


# --- Steady stretches


class SteadyStretches:
    """Collects readings, and at the end makes a table of measurements of their steady stretches.

    Parameters
    ----------
    wheels
        All wheels, in the order of their numbers.
    pull_std
        Standard deviation of a measured drawbar pull, N; None if none is measured.
    gravity
        Acceleration of gravity, m/s^2.

    Attributes
    ----------
    unsteady
        Number of rows that `table` left out: of stretches that are not steady, too short, next to a change of
        soil, or with a sinkage below 0 or beyond the axle.
    at_changes
        Number of readings left out because the soil was changing.
    unusable
        Number of other readings left out because their load or sinkage or, for a rolling wheel, their slip or
        speed is unknown.
    """

    def __init__(
        self, wheels: Sequence[Wheel], pull_std: float | None = None, gravity: float = GRAVITY
    ) -> None:
        self._gravity = gravity
        self._wheels, self._pulls = {wheel.name: wheel for wheel in wheels}, pull_std is not None
        self._pull_std = math.nan if pull_std is None else pull_std
        self._names = np.array([wheel.name for wheel in wheels], dtype=object)
        self._pressed = np.array([wheel.contact == PRESSED for wheel in wheels])
        turn = math.pi * max(wheel.diameter for wheel in wheels)
        self._lengths = np.where(self._pressed, _DEPTH, turn)  # m of a stretch
        self._readings: list[pd.DataFrame] = []
        self._waiting = 0
        self._done: list[pd.DataFrame] = []
        self._soil, self._changing = 0, False
        self.unsteady = self.at_changes = self.unusable = 0

    def starts_over(self) -> None:
        """Note that the estimator starts over: readings from here on belong to another soil."""
        self._soil += 1

    def add(self, rows: Readings, changing: Flags) -> None:
        """Add the readings of one turn of the pipeline.

        Parameters
        ----------
        rows
            Readings of all wheels, in order of time.
        changing
            Whether the soil was changing at each reading, shape (rows,); such readings are left out.
        """
        if not len(rows):
            return
        begins = changing & ~np.concatenate([[self._changing], changing[:-1]])
        soil = self._soil + np.cumsum(begins)
        self._soil, self._changing = int(soil[-1]), bool(changing[-1])
        moves = np.isfinite(rows.slip) & np.isfinite(rows.speed)
        usable = np.isfinite(rows.load) & np.isfinite(rows.sinkage)
        usable &= self._pressed[rows.wheel] | moves
        self.at_changes += int(changing.sum())
        self.unusable += int((~changing & ~usable).sum())
        good = np.flatnonzero(usable & ~changing)
        if not good.size:
            return
        kept = rows.take(good)
        passes = np.nan_to_num(rows.pass_number[good]).astype(np.int64)
        table = pd.DataFrame(
            {
                "soil": soil[good],
                "stretch": (kept.distance / self._lengths[kept.wheel]).astype(np.int64),
                "wheel": self._names[kept.wheel],
                "load": kept.load,
                "sinkage": kept.sinkage,
                "drawbar_pull": kept.pull,
                "slip": kept.slip,
                "speed": np.abs(kept.speed),
                "sinkage_std": kept.sinkage_std,
                "drawbar_pull_std": np.full(good.size, self._pull_std),
                "passes": passes,
            }
        )
        self._readings.append(table)
        self._waiting += good.size
        if self._waiting >= _BLOCK:
            self._reduce(self._soil)

    def _reduce(self, soil: int) -> None:
        """Reduce the readings of ended stretches to a row for each wheel and stretch.

        A stretch has ended if it is of a soil before `soil`, or if the wheel has readings of a later stretch:
        wheels begin a stretch at different times.
        """
        if not self._readings:
            return
        table = pd.concat(self._readings, ignore_index=True)
        last = table.groupby(["soil", "wheel"])["stretch"].transform("max")
        ended = (table["soil"] < soil) | (table["stretch"] < last)
        self._readings = [table[~ended]]
        self._waiting = int((~ended).sum())
        if ended.any():
            self._done.append(_medians(table[ended], [*self._wheels]))

    def table(self) -> pd.DataFrame:
        """Make the table of measurements at the end of the drive.

        It has one row for each wheel and stretch, with columns that `smallwheel diagnose` reads; it is empty
        without readings.
        """
        self._reduce(self._soil + 1)
        if not self._done:
            return pd.DataFrame()
        rows = pd.concat(self._done).sort_values(_KEYS, ignore_index=True)
        wheels = [self._wheels[name] for name in rows["wheel"]]
        for name in ("diameter", "width", "contact"):
            rows[name] = [getattr(wheel, name) for wheel in wheels]
        pressed = rows["contact"] == PRESSED
        # The last stretches before a change of soil: some wheels were on the new one already.
        last = rows.groupby(["soil", pressed])["stretch"].transform("max")
        before_change = (rows["soil"] < self._soil) & (rows["stretch"] >= last - 1)
        steady = pressed | ((rows["count"] >= _FEWEST_READINGS) & rows["steady"])
        # With a wrong zero of its sensor a wheel may seem to be above the ground: no table may have that.
        good = steady & ~before_change & rows["sinkage"].between(0.0, rows["diameter"] / 2)
        self.unsteady = int((~good).sum())
        rows = rows[good]
        if 2 * rows["passes"].notna().sum() > len(rows):
            rows = rows[rows["passes"].notna()]
        else:
            rows = rows.drop(columns="passes")
        return self._named(rows)

    def _named(self, rows: pd.DataFrame) -> pd.DataFrame:
        """The rows with the names and units that columns of a table of measurements have."""
        names = {"load": "load [N]", "diameter": "diameter [m]", "width": "width [m]",
                 "sinkage": "sinkage [m]", "sinkage_std": "sinkage_std [m]"}  # fmt: skip
        if self._pulls:
            names |= {
                "drawbar_pull": "drawbar_pull [N]",
                "drawbar_pull_std": "drawbar_pull_std [N]",
            }
        names |= {"slip": "slip", "speed": "speed [m/s]"}
        if self._gravity != GRAVITY:
            rows, names = rows.assign(gravity=self._gravity), names | {"gravity": "gravity [m/s^2]"}
        if "passes" in rows:
            rows, names = rows.astype({"passes": int}), names | {"passes": "pass_number"}
        soil, stretch = rows["soil"].astype(str), rows["stretch"].astype(str)
        rows = rows.assign(run=soil + "." + stretch, soil="soil " + soil)
        names |= {name: name for name in ("contact", "soil", "run", "wheel")}
        return rows[list(names)].rename(columns=names)


def _medians(table: pd.DataFrame, order: list[str]) -> pd.DataFrame:
    """One row for each stretch and wheel: medians of its readings, `count`, and whether it is `steady`.

    sinkage_std and drawbar_pull_std are standard errors of these medians. passes is NaN if its quartiles
    differ, or it is unknown.
    """
    table = table.assign(wheel=pd.Categorical(table["wheel"], order))
    groups = table.groupby(_KEYS, observed=True)
    values = [name for name in table if name not in _KEYS]
    quartiles = groups[values].quantile(np.array([0.25, 0.5, 0.75]))
    low, middle, high = (quartiles.xs(share, level=-1) for share in (0.25, 0.5, 0.75))
    rows, count = middle.copy(), groups.size()
    for name in ("sinkage", "drawbar_pull"):
        # The larger of the readings' scatter and of what their sensor states for each.
        at = pd.MultiIndex.from_frame(table[_KEYS])
        off = (table[name] - middle[name].reindex(at).to_numpy()).abs()
        scatter = NORMAL * off.groupby([table[key] for key in _KEYS], observed=True).median()
        rows[f"{name}_std"] = np.maximum(scatter, middle[f"{name}_std"]) / np.sqrt(count)
    same = (high["passes"] == low["passes"]) & (low["passes"] > 0)
    rows["passes"] = high["passes"].where(same)
    rows["steady"] = ~(
        (high["slip"] - low["slip"] > _STEADY_SLIP)
        | (high["load"] - low["load"] > _STEADY_SHARE * middle["load"])
        | (high["speed"] - low["speed"] > _STEADY_SHARE * middle["speed"])
    )
    return rows.assign(count=count).reset_index()
