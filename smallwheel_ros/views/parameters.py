# SPDX-License-Identifier: Apache-2.0
"""Fitted parameters as shown to people, in degrees and millimetres."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from smallwheel_ros.fitting import FitResult
from smallwheel_ros.measurements.display import brief, display, effect_words, number, words
from smallwheel_ros.views.blocks import Column, Row, Table

_PLAUSIBLE = {True: "yes", False: "no", None: "-"}
_LARGE = 1e5  # from which a number has its power of ten


def parameter_rows(fit: FitResult, derived: bool = False) -> list[Row]:
    """List the fitted numbers of a model.

    Parameters
    ----------
    fit
        The fit.
    derived
        Whether to include `fit.derived`, the numbers that follow from the fitted ones.

    Returns
    -------
    list of dict
        One for each number: owner (an effect's id or a soil), form, name, and the keys of its `to_dict`; SI
        units and radians.
    """
    forms = {effect.id: effect.form for effect in fit.bare.effects}
    listed_numbers = (*fit.parameters, *(fit.derived if derived else ()))
    return [{"owner": p.owner, "form": forms.get(p.owner), "name": p.name} | p.to_dict()
            for p in listed_numbers]  # fmt: skip


def parameter_table(rows: Sequence[Row], caption: str = "Fitted parameters",
                    strong: Sequence[str] = ()) -> Table:  # fmt: skip
    """Make a table of fitted numbers, in degrees and millimetres.

    Parameters
    ----------
    rows
        Mappings with owner, name, value, std and unit and, where known, form, published_range, plausible,
        status and remedy.
    caption
        Words above the table.
    strong
        Owners whose rows are printed bold.
    """

    def scaled(key: str) -> Callable[[Row], Any]:
        def of(row: Row) -> Any:
            value, scale = row.get(key), display("", str(row["unit"] or "")).scale
            if isinstance(value, (list, tuple)):
                return " to ".join(brief(scale * end) for end in value)
            return value if value is None else scale * value

        return of

    def doubt(row: Row) -> str:
        status = row.get("status") or "determined"
        said = "" if status == "determined" else status
        return f"{said}: {row['remedy']}" if said and row.get("remedy") else said

    columns = [
        Column("of", lambda row: effect_words(row["owner"]) if row.get("form") else row["owner"]),
        Column("form", "form", lambda v: words(v or "")),
        Column("parameter", "name", words),
        Column("value", scaled("value"), lambda v: _fitted(v, 4), right=True),
        Column("std", scaled("std"), lambda v: _fitted(v, 3), right=True),
        Column("unit", "unit", lambda unit: display("", str(unit or "")).unit),
        Column("published", scaled("published_range")),
        Column("plausible", lambda r: _PLAUSIBLE[r.get("plausible")]),
        Column("", doubt),
    ]  # fmt: skip
    return Table(columns, rows, caption, strong=lambda row: row["owner"] in strong)


def _fitted(value: float | None, digits: int) -> str:
    """The text of a number, a large one with its power of ten."""
    return (
        f"{value:.{digits}g}"
        if value is not None and abs(value) >= _LARGE
        else number(value, digits)
    )
