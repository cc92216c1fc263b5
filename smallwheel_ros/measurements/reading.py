# SPDX-License-Identifier: Apache-2.0
"""The columns of a grid: which quantity each is, and its cells as checked numbers in SI units."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.cells import (
    Cell,
    Grid,
    Problems,
    array_of_texts,
    clipped,
    is_blank,
    naming,
    refuse_long_texts,
    shown,
)
from smallwheel_ros.measurements.columns import (
    COLUMNS,
    LAB_COLUMNS,
    LEAST,
    OTHER,
    TEXTS,
    Array,
    ColumnSpec,
    Mask,
    Texts,
)
from smallwheel_ros.measurements.layout import Layout, find_layout, listed, match_columns
from smallwheel_ros.measurements.merged import fill_down
from smallwheel_ros.measurements.not_measured import is_label, lines_left_out, rows_not_measured
from smallwheel_ros.measurements.numbers import Numbers, read_numbers
from smallwheel_ros.measurements.units import (
    DIMENSIONLESS,
    UnitsError,
    base_unit,
    shown_unit,
    to_base,
)
from smallwheel_ros.measurements.words import (
    UNKNOWN,
    Heading,
    contact_of,
)

_MOST_TEXTS = 30  # that are told apart in one column
_GIVEN_TWICE = (
    "{} was given for all rows too, expected one of the two: leave the option or the column out"
)
# How a cell begins that is no number, and what to do about it.
_ODD_CELLS = (
    ("#", "an error of the spreadsheet: mend the formula, or leave the cell blank"),
    ("[0-9]{4}-", "a date; a spreadsheet makes one of 1.5 where it expects 1,5"),
    (r".*(±|\+/-)", "write the deviation in a column of its own, as in 'sinkage_std [mm]'"),
    ("[<>~≈≤≥]", "a limit is no measurement: write what was read, or leave the cell blank"),
    (r"[0-9].*[^\W\d_]$", "write the unit in the header, not in the cell"),
)
_MOST_SAID = 5  # texts that are read as blank


@dataclass
class Columns(Problems):
    """A table's columns by our names, SI units; what was understood, noted, and is wrong.

    headings: as the file has them. numbers: NaN where blank. texts: of the contract and labels
    alike. contact: what meets the soil in each row (`plates.take_contact`).
    """

    sha256: str = ""
    headings: dict[str, Heading] = field(default_factory=dict)
    cells: dict[str, Sequence[Cell]] = field(default_factory=dict)
    numbers: dict[str, Array] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    texts: dict[str, Texts] = field(default_factory=dict)
    contact: Texts = field(default_factory=lambda: np.array([], dtype=np.str_))
    notes: list[str] = field(default_factory=list)
    understood: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    faulty: dict[str, Mask] = field(default_factory=dict)  # rows of a column that have a problem

    def begin(self, layout: Layout) -> None:
        """Take the first filled column of a layout as that by which people know the rows."""
        filled = (i for i, column in enumerate(layout.columns) if not all(map(is_blank, column)))
        at = next(filled, 0)
        self.begins, self.first = layout.columns[at], layout.headers[at]

    def there(self, name: str) -> bool:
        """Whether the table has the column or a value for all rows."""
        return name in self.headings or name in self.numbers

    def read(self, name: str) -> bool:
        """Whether the table has the column with numbers."""
        return name in self.headings and name in self.numbers

    def values(self, name: str, default: float = np.nan) -> Array:
        """Numbers of the column, the default throughout where there is none; shape (rows,)."""
        return self.numbers.get(name, np.full(self.lines.size, default))

    def sound(self, name: str) -> Mask:
        """Rows of a column that have no problem."""
        return ~self.faulty.get(name, np.zeros(self.lines.size, dtype=bool))

    def title(self, name: str) -> str:
        """The column as messages name it: by our name where the file does so too."""
        heading = self.headings.get(name)
        return name if heading is None or name in heading.text else heading.text

    def lacking(self, messages: Iterable[str]) -> None:
        """Add a problem for each column that must be there and is not; the first says what is."""
        names = listed([heading.text for heading in self.headings.values()])
        hint = f". There is: {names}. If one of these is it, say so with --map NAME=HEADER"
        for i, message in enumerate(messages):
            self.add(message + ("" if i else hint))

    def keep(self, rows: Mask) -> None:
        """Keep the rows of that mask."""
        index = np.flatnonzero(rows)
        self.lines = self.lines[index]
        self.begins = [self.begins[i] for i in index.tolist()]
        self.cells = {n: [cells[i] for i in index.tolist()] for n, cells in self.cells.items()}
        self.numbers = {name: values[index] for name, values in self.numbers.items()}
        self.texts = {name: texts[index] for name, texts in self.texts.items()}
        self.contact = self.contact[index] if self.contact.size else self.contact

    def problem(self, message: str, name: str, rows: Mask | NDArray[np.intp] | None = None) -> None:
        """Add a problem of a column: of its header, or of these rows if there are any."""
        at = None if rows is None else np.flatnonzero(rows) if rows.dtype == bool else rows
        if at is None or at.size:
            mask = self.faulty.setdefault(name, np.zeros(self.lines.size, dtype=bool))
            mask[slice(None) if at is None else at] = True
            self.add(message, self.title(name), None if at is None else at.tolist())

    def outside(self, name: str, values: Array, rows: Mask, wanted: str) -> None:
        """Add a problem for the values of these rows, if there are any; wanted: in the first."""
        if rows.any():
            value = self.written(name, values, int(np.argmax(rows)))
            self.problem(f"{clipped(name)} is {value}, expected {wanted}", name, rows)

    def count(self, rows: Mask, what: str) -> str:
        """How many rows these are, what of them is said, and where the first is."""
        first = f"{self.place} {self.lines[int(np.argmax(rows))]}"
        return f"{int(rows.sum())} {what} (first in {first})"

    def written(self, name: str, values: Array, row: int) -> str:
        """Show a value as it stands in the file, and converted where the file has another unit."""
        cell, unit = shown(self.cells[name][row]), shown_unit(self.headings[name].unit)
        if not unit:
            return cell
        try:
            same = float(values[row]) == float(cell)
        except ValueError:
            same = False
        return f"{cell} {unit}" + ("" if same else f" ({values[row]:.6g} in SI)")


def read_columns(grid: Grid, mapping: Mapping[str, str]) -> Columns:
    """Every column of the table, checked cell by cell.

    mapping: our name -> their header, where words do not say it. What is wrong is in `problems`.
    Raises MeasurementsError where there is no table.
    """
    with naming(grid.source):
        layout = find_layout(grid)
    columns = Columns(grid.source, grid.place, layout.numbers, layout.header_line)
    columns.sha256 = grid.sha256
    named = match_columns(layout, mapping, columns)
    columns.begin(layout)
    parsed = _numbers(layout, named, grid.comma)
    texts = [i for i in range(len(layout.headers)) if i not in parsed or parsed[i].faults]
    refuse_long_texts([(layout.headers[i], layout.columns[i]) for i in texts], columns)
    left_out = rows_not_measured(layout, named, parsed)
    ragged = {row: n for row, n in layout.ragged.items() if row not in left_out}
    for count in set(ragged.values()):
        many = count > len(layout.headers)
        hint = " (a decimal comma, or a comma in a text? write 1.5, and texts in quotes)"
        columns.add(
            f"{count} cells, expected {len(layout.headers)} as in the header{hint if many else ''}",
            rows=[row for row, n in ragged.items() if n == count],
        )
    columns.understood += layout.said
    columns.understood += lines_left_out(layout, left_out)
    if left_out or ragged:
        layout.keep(np.delete(np.arange(layout.numbers.size), [*left_out, *ragged]))
        columns.lines = layout.numbers
        columns.begin(layout)
        if not columns.lines.size:
            columns.add("no rows of measurements are left")
            columns.raise_any()
    columns.understood += fill_down(layout, named, grid.merged)
    parsed = _numbers(layout, named, grid.comma)
    for position, heading in named.items():
        columns.headings[heading.name] = heading
        columns.cells[heading.name] = layout.columns[position]
    for position, heading in named.items():
        _take(columns, heading, parsed.get(position))
    _say(columns, parsed.values())
    return columns


def _numbers(layout: Layout, named: Mapping[int, Heading], comma: bool) -> dict[int, Numbers]:
    columns = {i: layout.columns[i] for i, h in named.items() if h.name not in TEXTS}
    return dict(zip(columns, read_numbers([*columns.values()], comma), strict=True))


def _take(columns: Columns, heading: Heading, parsed: Numbers | None) -> None:
    name, cells = heading.name, columns.cells[heading.name]
    spec = COLUMNS.get(name) or (LAB_COLUMNS.get(name) if heading.rank != UNKNOWN else None)
    if parsed is None:
        if shown_unit(heading.unit):
            columns.problem(f"unit '{heading.unit}' on a text", name)
        if name == "contact":
            cells = [contact_of(shown(cell)) for cell in cells]
        columns.texts[name] = array_of_texts(cells)
    elif parsed.blank.all():
        if name in ("load", "diameter"):
            columns.problem("the whole column is blank", name)
        else:
            columns.notes.append(f"column '{clipped(name)}' is blank throughout and is left out")
    elif spec is None and heading.rank == UNKNOWN and is_label(heading, parsed):
        columns.texts[name] = array_of_texts(cells)
        columns.notes.append(
            f"column '{clipped(name)}' is text: kept as a label, not used by any model"
        )
    else:
        _take_numbers(columns, heading, parsed, spec or OTHER)


# Before a plate touches the soil these are noise around 0: `plates` looks at what is under their range.
BEFORE_TOUCH = ("load", "sinkage")


def _take_numbers(columns: Columns, heading: Heading, parsed: Numbers, spec: ColumnSpec) -> None:
    """Numbers of a column in SI units, each within the range of its kind."""
    name, unit = heading.name, heading.unit
    expected, values = spec.unit or None, parsed.values
    try:
        to_base(np.zeros(1), unit or DIMENSIONLESS, expected if unit else None)
        columns.units[name] = expected or ("" if unit is None else base_unit(unit))
    except UnitsError as error:
        # Of a column in the wrong unit every value may look wrong: say nothing of those.
        columns.problem(str(error).replace("*g_0", ""), name)
        return
    _check_cells(columns, name, parsed)
    if unit == "%":  # a cell of 20 % is 20 below [%]
        values = np.where(parsed.percent, 100.0 * values, values)
    elif shown_unit(unit) or shown_unit(expected):
        columns.problem(f"cells in per cent, expected {unit or expected}", name, parsed.percent)
    values = heading.factor * values
    if unit is not None:
        values = to_base(values, unit, expected)
    early = name in BEFORE_TOUCH
    rows = np.isfinite(parsed.values) & ~(early & (values < spec.low))
    check_range(columns, name, spec, values, rows)
    values = np.where(columns.sound(name), values, np.nan)  # the others are checked on
    tiny = (np.abs(values) < LEAST) & (values != 0.0)
    if tiny.any():
        many = f"{tiny.sum()} numbers under {LEAST:g}"
        columns.notes.append(f"column '{clipped(name)}': {many} are taken as 0")
        values = np.where(tiny, 0.0, values)
    columns.numbers[name] = np.clip(values, -spec.high if early else spec.low, spec.high)


def check_range(columns: Columns, name: str, spec: ColumnSpec, values: Array, rows: Mask) -> None:
    """Add a problem for values of these rows that no wheel or plate has."""
    no_unit = columns.headings[name].unit is None
    bad, wanted = spec.bad(values) & rows, spec.expected()
    if no_unit and name in ("diameter", "width"):
        # a size that no small wheel has is in another unit, and not in metres
        low, high = spec.usual
        bad |= (values < low) | (values > high)
        wanted = wanted if spec.bad(values[bad]).any() else f"{low:g} to {high:g} m"
    hint = f"; {spec.hint}" if spec.hint else ""
    if spec.unit == "m" and no_unit:
        hint = f"; without a unit it is metres: for mm the header is '{name} [mm]'"
    columns.outside(name, values, bad, wanted + hint)


def _check_cells(columns: Columns, name: str, parsed: Numbers) -> None:
    """Add a problem for each text that is no number, and for what is not finite."""
    cells = columns.cells[name]
    by_text: dict[tuple[str, str], list[int]] = {}
    for row, fault in parsed.faults.items():
        # Of cells that are wrong in the same way the first says it all.
        text = shown(cells[row])
        why = fault or next((why for start, why in _ODD_CELLS if re.match(start, text)), "")
        many = why or len(by_text) >= _MOST_TEXTS
        key = next((t for t, w in by_text if w == why), text) if many else text
        by_text.setdefault((key, why), []).append(row)
    for (text, why), rows in by_text.items():
        words = f": {why}" if why else ""
        columns.problem(f"'{text}' found, expected a number{words}", name, np.array(rows))
    bad = ~np.isfinite(parsed.values) & ~parsed.blank
    bad[list(parsed.faults)] = False
    text = shown(cells[int(np.argmax(bad))])
    wanted = "a finite number, or a blank cell where nothing was measured"
    columns.problem(f"{text} found, expected {wanted}", name, bad)


def take_size(columns: Columns, name: str, size: float | None) -> None:
    """Take a diameter or width (m) for all rows, where it is given."""
    if size is None:
        return
    size, spec = float(size), COLUMNS[name]
    if np.isnan(size) or spec.bad(np.array([size])).any():
        columns.add(f"{name} given as {size!r} m, expected {spec.expected()}")
    elif name in columns.headings:
        columns.problem(_GIVEN_TWICE.format(name), name)
    columns.numbers[name] = np.full(columns.lines.size, size)
    columns.units[name] = spec.unit


def _say(columns: Columns, parsed: Collection[Numbers]) -> None:
    """Say in one line each what was understood of the headers and the cells."""
    for heading in columns.headings.values():
        if heading.rank == UNKNOWN:
            continue
        unit = f" [{shown_unit(heading.unit)}]".replace(" []", "")
        weight = ", the weight of that mass" if "*g_0" in str(heading.unit) else ""
        twice = ", twice the radius" if heading.factor == 2.0 else ""
        made = f"{heading.name}{unit}{weight}{twice}"
        if heading.text not in (heading.name, made, f"{heading.name} [-]", f"{heading.name} [1]"):
            columns.understood.append(f"'{clipped(heading.text)}' -> {made}")
    if any(p.comma for p in parsed):
        columns.understood.append("decimal commas")
    if any(p.percent.any() for p in parsed):
        columns.understood.append("cells in per cent")
    missing = sorted({text for p in parsed for text in p.missing})
    if missing:
        columns.understood.append(f"{', '.join(missing[:_MOST_SAID])}: read as blank")
