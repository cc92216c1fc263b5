# SPDX-License-Identifier: Apache-2.0
"""The columns of a grid: which quantity each is, and its cells as checked numbers in SI units.

    find the header and the row of units                     layout.find_layout
    each header -> quantity, unit                            headers.read_heading, --map
    rows that were not measured are left out, and listed      layout.rows_not_measured
    cells -> numbers -> SI, each within its range            cells.read_numbers, columns.to_base

What is wrong is collected in `TableColumns.found` and raised at once.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.measurements.cells import (
    Cell,
    CellGrid,
    MeasurementsError,
    Numbers,
    clipped,
    is_blank,
    map_option,
    read_numbers,
    shown,
)
from smallwheel_ros.measurements.columns import (
    COLUMNS,
    DIMENSIONLESS,
    GRAVITY_COLUMN,
    LAB_COLUMNS,
    LEAST,
    OTHER,
    TEXTS,
    Array,
    ColumnSpec,
    Mask,
    Texts,
    UnitsError,
    base_unit,
    fits,
    is_bookkeeping,
    is_mass,
    shown_unit,
    to_base,
    weight_under,
)
from smallwheel_ros.measurements.headers import (
    UNKNOWN,
    Heading,
    contact_of,
    mapped_heading,
    meant,
    plain,
    read_heading,
)
from smallwheel_ros.measurements.layout import (
    Layout,
    fill_down,
    find_layout,
    is_label,
    lines_left_out,
    odd_names,
    row_names,
    rows_not_measured,
    upright,
    with_unit,
)

BEFORE_TOUCH = ("load", "sinkage")  # may be noise around 0 before a plate touches: checked by `lab`
# Settings that a table may lack: one in another unit is something else, the speed of a rim in rpm.
_OF_ANOTHER = ("speed", "slope", "slip_angle", "grouser_height")
_MOST_PROBLEMS, _MOST_ROWS, _MOST_NAMES = 20, 10, 30  # that a message lists
MOST_CHARACTERS = 64_000_000  # of all texts, rows times the longest cell: the room that NumPy takes
_GIVEN_TWICE = (
    "was given for all rows too, expected one of the two: leave the option or the column out"
)
# How a cell begins that is no number, and what to do about it.
_ODD_CELLS = (
    ("#", "an error of the spreadsheet: mend the formula, or leave the cell blank"),
    ("[0-9]{4}-", "a date; a spreadsheet makes one of 1.5 where it expects 1,5"),
    (r".*(±|\+/-)", "write the deviation in a column of its own, as in 'sinkage_std [mm]'"),
    ("[<>~≈≤≥]", "a limit is no measurement: write what was read, or leave the cell blank"),
    (r"[0-9].*[^\W\d_]$", "write the unit in the header, not in the cell"),
)


@dataclass
class TableColumns:
    """A table's columns by our names, SI units, with notes and problems from reading.

    Attributes
    ----------
    source, sha256
        The file, for messages, and the hash of its content.
    lines, place
        Number of each row in the file, shape (rows,), and what it counts: "line", "row" or "column".
    header
        Number of the header's row in the file; None if the file keeps headers apart.
    headings, cells
        Headers and cells as in the file, by our name of the column.
    numbers, units
        Columns of numbers, shape (rows,) each, NaN where blank; and the SI unit of each, "" if unknown.
    texts
        Columns of texts, shape (rows,) each: soil, run, wheel, contact, and labels of the table's own.
    contact
        "rolling", "pressed" or "plate" in each row, shape (rows,); empty before `lab.take_contact`.
    notes, understood, warnings
        Sentences for the user, as in `Measurements`.
    begins, first
        Each row's cell in the first column that is not empty, and that column's header: a message repeats
        the cell, so that people find the row.
    found
        The problems, a sentence each.
    faulty
        By our name of a column that has problems, a mask of the rows concerned, shape (rows,).
    rows_there
        Number of rows below the header, including those that are not measurements.
    """

    source: str
    place: str
    lines: NDArray[np.intp]
    header: int | None = None
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
    begins: Sequence[Cell] = ()
    first: str = ""
    found: list[str] = field(default_factory=list)
    faulty: dict[str, Mask] = field(default_factory=dict)  # rows of a column that have a problem
    rows_there: int = 0  # below the header, measurements or not

    def there(self, name: str) -> bool:
        """Whether there is such a column in the table, or values for all rows from elsewhere."""
        return name in self.headings or name in self.numbers

    def read(self, name: str) -> bool:
        """Whether the table itself has the column, and it could be read as numbers."""
        return name in self.headings and name in self.numbers

    def values(self, name: str, default: float = np.nan) -> Array:
        """Numbers of a column, shape (rows,); NaN where blank.

        Parameters
        ----------
        name
            Our name of the column.
        default
            Value of all rows if there is no such column, SI unit.
        """
        return self.numbers.get(name, np.full(self.lines.size, default))

    def sound(self, name: str) -> Mask:
        """Whether each row of a column is without a problem, shape (rows,)."""
        return ~self.faulty.get(name, np.zeros(self.lines.size, dtype=bool))

    def keep(self, rows: Mask) -> None:
        """Keep the rows of a mask."""
        index = np.flatnonzero(rows)
        self.lines, self.begins = self.lines[index], [self.begins[i] for i in index]
        self.cells = {n: [cells[i] for i in index.tolist()] for n, cells in self.cells.items()}
        self.numbers = {name: values[index] for name, values in self.numbers.items()}
        self.texts = {name: texts[index] for name, texts in self.texts.items()}
        self.contact = self.contact[index] if self.contact.size else self.contact

    def add(
        self, message: str, column: str | None = None, rows: Iterable[int] | None = None
    ) -> None:
        """Add a sentence to the problems, with the place in the file.

        Parameters
        ----------
        message
            What is wrong, and what was expected.
        column
            Header of the column as in the table; None for the whole table.
        rows
            Indices of the rows concerned; None for the header.
        """
        rows = [] if rows is None else list(rows)
        lines = [int(self.lines[row]) for row in rows]
        first = lines[0] if lines else self.header
        where = [] if first is None else [f"{self.place} {first}"]
        where += [] if column is None else [f"column '{clipped(column)}'"]
        if len(lines) > 1:
            dots = ", ..." if len(lines) > _MOST_ROWS + 1 else ""
            listed = ", ".join(map(str, lines[1 : _MOST_ROWS + 1]))
            message += f" (and {len(lines) - 1} more like it: {self.place} {listed}{dots})"
        if self.begins and (column is None or column not in self.first):
            texts = dict.fromkeys(shown(self.begins[row]) for row in rows[: _MOST_ROWS + 1])
            if names := ", ".join(f"'{text}'" for text in texts if text.strip()):
                message += f"; the row{'s begin' if len(texts) > 1 else ' begins'} with {names}"
        self.found.append(f"{', '.join(where)}: {message}" if where else message)

    def problem(self, message: str, name: str, rows: Mask | NDArray[np.intp] | None = None) -> None:
        """Add a problem of a column, and mark its rows as faulty; does nothing if `rows` selects none.

        Parameters
        ----------
        message
            What is wrong, and what was expected.
        name
            Our name of the column.
        rows
            A mask of shape (rows,), or indices of rows; None for the header, which concerns all rows.
        """
        at = None if rows is None else np.flatnonzero(rows) if rows.dtype == bool else rows
        if at is None or at.size:
            mask = self.faulty.setdefault(name, np.zeros(self.lines.size, dtype=bool))
            mask[slice(None) if at is None else at] = True
            text = self.headings[name].text if name in self.headings else name
            title = name if name in text else text  # by our name where the file does so too
            self.add(message, title, None if at is None else at.tolist())

    def outside(self, name: str, values: Array, rows: Mask, wanted: str) -> None:
        """Add a problem for the values that are not allowed; it shows the first of them.

        Parameters
        ----------
        name
            Our name of the column.
        values
            Its values, SI units, shape (rows,).
        rows
            Whether each value is wrong, shape (rows,).
        wanted
            Words for what is allowed, as "at most 0.1 m".
        """
        if rows.any():
            row = int(np.argmax(rows))
            cell, unit = shown(self.cells[name][row]), shown_unit(self.headings[name].unit)
            si = f" ({values[row]:.6g} in SI)" if unit and f"{values[row]:.10g}" != cell else ""
            value = f"{cell} {unit}".strip() + si
            self.problem(f"{clipped(name)} is {value}, expected {wanted}", name, rows)

    def lacking(self, messages: Iterable[str]) -> None:
        """Add these problems, one for each required column that is absent; the first lists those present."""
        names = listed([heading.text for heading in self.headings.values()])
        hint = f". The columns are {names}. If one of these is it, say so with --map NAME=HEADER"
        for i, message in enumerate(messages):
            self.add(message + ("" if i else hint))

    def leave_out(self, name: str, known: int) -> None:
        """Drop the column that was read last, which is not needed; its problems become one warning.

        Parameters
        ----------
        name
            Name of the column.
        known
            Number of problems that were known before the column was read.
        """
        why, self.found = self.found[known], self.found[:known]
        self.warnings.append(f"column '{clipped(name)}' is left out, and not needed: {why}")
        for kept in (self.headings, self.cells, self.numbers, self.units, self.texts, self.faulty):
            kept.pop(name, None)

    def count(self, rows: Mask, what: str) -> str:
        """A sentence such as "12 rows are left out (first in line 7)".

        Parameters
        ----------
        rows
            Mask of the rows that are counted, at least one, shape (rows,).
        what
            The words after their number, as "rows are left out".
        """
        first = f"{self.place} {self.lines[int(np.argmax(rows))]}"
        return f"{int(rows.sum())} {what} (first in {first})"

    def raise_any(self) -> None:
        """Raise MeasurementsError with all problems, if there are any."""
        if not self.found:
            return
        lines, more = self.found[:_MOST_PROBLEMS], len(self.found) - _MOST_PROBLEMS
        if len(self.found) > 1:
            lines.insert(0, f"{len(self.found)} problems")
        if more > 0:
            lines.append(f"and {more} more: these {_MOST_PROBLEMS} first, they may be the cause")
        comma = ", " if lines[0].startswith(("line ", "row ", "column ")) else ": "
        raise MeasurementsError(self.source + comma + "\n  ".join(lines))


def listed(names: Sequence[str]) -> str:
    """Join names for a message: the first 30 of them, each shortened, and the number of the others."""
    text = ", ".join(clipped(name) for name in names[:_MOST_NAMES])
    more = len(names) - _MOST_NAMES
    return f"{text} and {more} more" if more > 0 else text


def read_columns(grid: CellGrid, mapping: Mapping[str, str]) -> TableColumns:
    """Read every column of a table, and check it cell by cell.

    Problems are collected in `TableColumns.found` of the result; its `contact` is not set yet.

    Parameters
    ----------
    grid
        The cells.
    mapping
        Columns that the user has named: the table's header by our name of the quantity, with its unit if
        the header has none (`--map`).

    Raises
    ------
    MeasurementsError
        If there is no table, or no row of measurements is left.
    """
    grid = upright(grid)
    try:
        layout = find_layout(grid)
    except MeasurementsError as error:
        raise MeasurementsError(f"{grid.source}: {error}") from None
    columns = TableColumns(grid.source, grid.place, layout.numbers, layout.header_line, grid.sha256)
    columns.rows_there = int(layout.numbers.size)
    named = _headings(layout, mapping, columns)
    _begin(columns, layout)
    parsed = _numbers(layout, named, grid.comma)
    names = row_names(layout, named, parsed)
    left_out = rows_not_measured(layout, named, parsed, names)
    ragged = {row: n for row, n in layout.ragged.items() if row not in left_out}
    for count in set(ragged.values()):
        many = count > len(layout.headers)
        hint = " (a decimal comma, or a comma in a text? write 1.5, and texts in quotes)"
        columns.add(
            f"{count} cells, expected {len(layout.headers)} as in the header{hint if many else ''}",
            rows=[row for row, n in ragged.items() if n == count],
        )
    columns.understood += layout.said
    if left_out:
        columns.understood += lines_left_out(layout, left_out)
    columns.warnings += odd_names(layout, names, left_out)
    if left_out or ragged:
        layout.drop([*left_out, *ragged])
        columns.lines = layout.numbers
        _begin(columns, layout)
        if not columns.lines.size:
            columns.add("no rows of measurements are left")
            columns.raise_any()
    filled = fill_down(layout, named, grid.merged)
    if left_out or ragged or filled:
        parsed = _numbers(layout, named, grid.comma)
    columns.understood += filled
    for position, heading in named.items():
        columns.headings[heading.name] = heading
        columns.cells[heading.name] = layout.columns[position]
    asked = {plain(theirs) for theirs in mapping.values()}
    for position, heading in named.items():
        known = len(columns.found)
        _take(columns, heading, parsed.get(position))
        if len(columns.found) > known and _is_nobodys(heading) and plain(heading.text) not in asked:
            columns.leave_out(heading.name, known)
    _say(columns, parsed.values())
    return columns


def _in_its_unit(heading: Heading) -> bool:
    """Whether the unit of a column, if it has a known one, is of the dimension of its quantity."""
    unit = heading.unit
    try:
        return unit is None or unit == DIMENSIONLESS or fits(unit, COLUMNS[heading.name].unit)
    except UnitsError:
        return True  # said where its values are read


def _is_nobodys(heading: Heading) -> bool:
    """Whether neither the header of a column nor its name is one that is known here."""
    return heading.rank == UNKNOWN and heading.name not in {*COLUMNS, *TEXTS}


def _begin(columns: TableColumns, layout: Layout) -> None:
    """Take the first column that is not empty as the one whose cells messages repeat to show a row."""
    filled = (i for i, column in enumerate(layout.columns) if not all(map(is_blank, column)))
    at = next(filled, 0)
    columns.begins, columns.first = layout.columns[at], layout.headers[at]


def _numbers(layout: Layout, named: Mapping[int, Heading], comma: bool) -> dict[int, Numbers]:
    cells = {i: layout.columns[i] for i, h in named.items() if h.name not in TEXTS}
    return dict(zip(cells, read_numbers([*cells.values()], comma), strict=True))


def _headings(
    layout: Layout, mapping: Mapping[str, str], columns: TableColumns
) -> dict[int, Heading]:
    """The heading of each column, by its position; what is wrong is added to the problems.

    Of several columns of one quantity, the one with the lowest `Heading.rank` is taken: the one that the user
    mapped, else the one with our own name. The others keep their headers as names.
    """
    wanted = _mapped(layout, mapping, columns) if mapping else {}
    found: dict[int, Heading] = {}
    for position, text in enumerate(layout.headers):
        if not text.strip() or text.startswith("Unnamed: "):
            if all(map(is_blank, layout.columns[position])):
                continue
            if position == 0:
                columns.understood.append(
                    "column 1 has no name, an index? It is left out; if it names the runs, call it run"
                )
            else:  # a cell too many in each row: which one is not known
                columns.add(f"column {position + 1} has no name")
            continue
        try:
            ours = wanted.get(position)
            heading = read_heading(text) if ours is None else mapped_heading(text, ours)
            if ours is None or read_heading(ours).unit is None:
                found[position] = with_unit(heading, layout.units.get(position))
            else:
                found[position] = heading
                _say_given(heading, layout.units.get(position), columns)
        except UnitsError as error:
            both = str(error).startswith("the row")
            columns.add(f"header '{clipped(text)}'{' and ' if both else ': '}{error}")
            if both:  # the column is there, and its unit is not known
                found[position] = heading
    for position, heading in found.items():
        if position not in wanted and heading.name in _OF_ANOTHER and not _in_its_unit(heading):
            # The speed of a wheel in rpm is not the speed over ground.
            own = heading.text.partition("[")[0].partition("(")[0].strip() or heading.text
            found[position] = heading._replace(name=own, rank=UNKNOWN)
            columns.notes.append(
                f"column '{clipped(heading.text)}' is not {heading.name}, whose unit is"
                f" {COLUMNS[heading.name].unit}: it is a column of its own"
            )
    _settle(found, columns)
    names = {heading.name for heading in found.values()}
    for heading in found.values():
        near = meant(heading) if heading.rank == UNKNOWN else None
        near = "diameter" if near == "radius" else near
        if near is not None and near not in names:
            columns.add(
                f"header '{clipped(heading.text)}' is no known word, but nearly '{near}': correct it or its "
                f"unit, or say {map_option(near, heading.text)}; {map_option(heading.text, heading.text)} "
                "keeps it as a column of your own"
            )
    return found


def _say_given(heading: Heading, row: str | None, columns: TableColumns) -> None:
    """Say that the unit of a --map wins over those of the header and of the row of units."""
    given, own = shown_unit(heading.unit), read_heading(heading.text).unit
    if others := {shown_unit(unit) for unit in (own, row) if unit is not None} - {given}:
        columns.understood.append(
            f"'{clipped(heading.text)}' is in {given}, as --map says, not in "
            f"{' or '.join(sorted(others))}"
        )


def _mapped(layout: Layout, mapping: Mapping[str, str], columns: TableColumns) -> dict[int, str]:
    """Our names of the columns that the user has mapped, by position; problems are added to `columns`."""
    wanted = dict[int, str]()
    for ours, theirs in mapping.items():
        exact = [i for i, text in enumerate(layout.headers) if text == theirs.strip()]
        alike = [
            i for i, text in enumerate(layout.headers)
            if plain(theirs) in (plain(text), plain(re.split(r"[\[(]", text)[0]))
        ]  # fmt: skip
        at = exact or alike
        if len(at) == 1 and at[0] not in wanted:
            wanted[at[0]] = ours
            continue
        what = "no column" if not at else "several columns" if len(at) > 1 else "twice"
        option = map_option(ours, theirs)
        columns.add(
            f"{option}: {what} '{clipped(theirs)}'. The columns are {listed(layout.headers)}"
        )
    return wanted


def _settle(found: dict[int, Heading], columns: TableColumns) -> None:
    """Leave one column of each quantity, others get their header as name; two of equal rank are a problem."""
    by_name: dict[str, list[int]] = {}
    for position, heading in found.items():
        by_name.setdefault(heading.name, []).append(position)
    for name, positions in by_name.items():
        best = min(found[i].rank for i in positions)
        first, *others = [i for i in positions if found[i].rank == best]
        if others:
            one, other = (clipped(found[i].text) for i in (first, others[0]))
            option = map_option(name, found[first].text)
            which = f", or say which with {option}" if one != other else ""
            columns.add(
                f"two columns are named '{clipped(name)}' ('{one}' and '{other}'), expected one: remove or"
                f" rename the other{which}"
            )
        for i in positions:
            if i != first:
                text, taken = found[i].text, {heading.name for heading in found.values()}
                names = (text.partition("[")[0].strip(), text, f"{text} (column {i + 1})")
                own = next(name for name in names if name not in taken)
                found[i] = found[i]._replace(name=own, rank=UNKNOWN, factor=1.0)


def _take(columns: TableColumns, heading: Heading, parsed: Numbers | None) -> None:
    """Take a column as texts, or as numbers in SI."""
    name, cells = heading.name, columns.cells[heading.name]
    spec = COLUMNS.get(name) or (LAB_COLUMNS.get(name) if heading.rank != UNKNOWN else None)
    if parsed is None or (spec is None and is_label(heading, parsed) and not parsed.blank.all()):
        if parsed is not None:
            columns.notes.append(
                f"column '{clipped(name)}' is text: kept as a label, not used by any model"
            )
        elif shown_unit(heading.unit):
            columns.problem(f"unit '{heading.unit}' on a text", name)
        texts = [c.strip() if isinstance(c, str) else shown(c) for c in cells]
        longest = max(texts, key=len)
        taken = sum(t.nbytes // 4 for t in columns.texts.values())
        if taken + len(longest) * len(texts) > MOST_CHARACTERS:
            what = (
                f"a cell of {len(longest)} characters in a table of {len(texts)} rows: shorten it"
            )
            columns.problem(what, name, np.array([texts.index(longest)]))
            columns.raise_any()
        texts = [contact_of(text) for text in texts] if name == "contact" else texts
        columns.texts[name] = np.array(texts, dtype=np.str_)
    elif parsed.blank.all():
        if name in ("load", "diameter"):
            columns.problem("the whole column is blank", name)
        else:
            columns.notes.append(f"column '{clipped(name)}' is blank throughout and is left out")
    else:
        _take_numbers(columns, heading, parsed, spec or OTHER)


def _take_numbers(
    columns: TableColumns, heading: Heading, parsed: Numbers, spec: ColumnSpec
) -> None:
    """Take a column's numbers in SI units; those out of the range of its kind are a problem, and NaN."""
    name, unit = heading.name, heading.unit
    expected, values = spec.unit or None, parsed.values
    try:
        to_base(np.zeros(1), unit or DIMENSIONLESS, expected if unit else None)
        columns.units[name] = expected or ("" if unit is None else base_unit(unit))
    except UnitsError as error:
        # In a column in the wrong unit every value may look wrong: its values are not reported.
        mend = "correct the unit, or say what the column is with --map NAME=HEADER"
        columns.problem(f"{shown_unit(str(error))}: {mend}", name)
        return
    _check_cells(columns, name, parsed)
    if unit == "%":  # a cell of 20 % is 20 below [%]
        values = np.where(parsed.percent, 100.0 * values, values)
    elif parsed.percent.any() and (shown_unit(unit) or shown_unit(expected)):
        columns.problem(f"cells in per cent, expected {unit or expected}", name, parsed.percent)
    values = heading.factor * values
    if unit is not None:
        values = to_base(values, unit, expected)
    if spec is OTHER and is_bookkeeping(name) and np.nanmax(np.abs(values)) > spec.high:
        values = values - np.nanmin(values)  # ns since 1970: what tells the order is left
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


def weigh(columns: TableColumns) -> None:
    """Convert loads that are written as masses to weights, under the gravity in the table's own column.

    `columns` is changed; nothing changes if loads are forces or there is no such column, and a row without a
    gravity keeps the weight under the standard one.
    """
    load = columns.headings.get("load")
    if load is None or not is_mass(load.unit) or not columns.read(GRAVITY_COLUMN):
        return
    gravity = columns.values(GRAVITY_COLUMN)
    known = np.isfinite(gravity)
    loads = columns.numbers["load"]
    columns.numbers["load"] = np.where(known, weight_under(loads, gravity), loads)
    columns.understood.append(
        f"load: masses in {shown_unit(load.unit)}, of which the weight under the gravity of their row is "
        "taken; what a load cell shows as kg is kgf, or N"
    )


def check_range(
    columns: TableColumns, name: str, spec: ColumnSpec, values: Array, rows: Mask
) -> None:
    """Add a problem if values are impossible for a wheel or plate.

    A diameter or width whose header has no unit must be usual for a small wheel, too: else it is hardly in m.

    Parameters
    ----------
    columns
        The table's columns, to which the problem is added.
    name, spec
        Our name of the column, and the range of its values.
    values
        Values of the column, SI units, shape (rows,).
    rows
        Mask of the rows that are checked, shape (rows,).
    """
    no_unit = columns.headings[name].unit is None
    bad = spec.bad(values) & rows
    if no_unit and name in ("diameter", "width"):
        # a size that no small wheel has is in another unit, and not in metres
        low, high = spec.usual
        bad |= (values < low) | (values > high)
    if not bad.any():
        return
    wanted = spec.expected()
    if no_unit and name in ("diameter", "width"):
        wanted = wanted if spec.bad(values[bad]).any() else f"{low:g} to {high:g} m"
    hint = spec.hint
    if (values[bad] <= 0).all():  # the sign is wrong, not the unit
        hint = spec.hint_of_sign or hint
    elif spec.unit == "m" and no_unit:
        hint = f"without a unit it is metres: for mm the header is '{name} [mm]'"
    columns.outside(name, values, bad, f"{wanted}; {hint}" if hint else wanted)


def _check_cells(columns: TableColumns, name: str, parsed: Numbers) -> None:
    """Add a problem for each text that is no number, and for what is not finite."""
    cells = columns.cells[name]
    by_text: dict[str, list[int]] = {}
    for row, fault in parsed.faults.items():
        # Cells that are wrong in the same way are reported once, by the first of them.
        text = shown(cells[row])
        why = fault or next((why for start, why in _ODD_CELLS if re.match(start, text)), "")
        by_text.setdefault(why or text, []).append(row)
    for why, rows in by_text.items():
        text = shown(cells[rows[0]])
        words = f": {why}" if why != text else ""
        columns.problem(f"'{text}' found, expected a number{words}", name, np.array(rows))
    bad = ~np.isfinite(parsed.values) & ~parsed.blank
    bad[list(parsed.faults)] = False
    if bad.any():
        text = shown(cells[int(np.argmax(bad))])
        wanted = "a finite number, or a blank cell where nothing was measured"
        columns.problem(f"{text} found, expected {wanted}", name, bad)


def take_size(columns: TableColumns, name: str, size: float) -> None:
    """Set the diameter or width that the user gave for all rows.

    It is a problem if the size is impossible, or the table has such a column too.

    Parameters
    ----------
    columns
        The table's columns, which are changed.
    name
        diameter or width.
    size
        The size, m.
    """
    size, spec = float(size), COLUMNS[name]
    if np.isnan(size) or spec.bad(np.array([size])).any():
        columns.add(f"{name} given as {size!r} m, expected {spec.expected()}")
    elif name in columns.headings:
        columns.problem(f"{name} {_GIVEN_TWICE}", name)
    columns.numbers[name] = np.full(columns.lines.size, size)
    columns.units[name] = spec.unit


def _say(columns: TableColumns, parsed: Iterable[Numbers]) -> None:
    """Add a sentence to `columns.understood` for each header that was interpreted, and on marks in cells."""
    parsed = list(parsed)
    for heading in columns.headings.values():
        unit = f" [{shown_unit(heading.unit)}]".replace(" []", "")
        weight = ", the weight of that mass" if is_mass(heading.unit) else ""
        twice = ", twice the radius" if heading.factor == 2.0 else ""
        made = f"{heading.name}{unit}{weight}{twice}"
        plainly = (heading.name, made, f"{heading.name} [-]", f"{heading.name} [1]")
        if heading.rank != UNKNOWN and heading.text not in plainly:
            columns.understood.append(f"'{clipped(heading.text)}' -> {made}")
    columns.understood += ["decimal commas"] if any(p.comma for p in parsed) else []
    columns.understood += ["cells in per cent"] if any(p.percent.any() for p in parsed) else []
    if missing := sorted({text for p in parsed for text in p.missing}):
        columns.understood.append(f"{', '.join(missing[:5])}: read as blank")
