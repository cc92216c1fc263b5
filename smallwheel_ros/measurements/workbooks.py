# SPDX-License-Identifier: Apache-2.0
"""Turns the sheet of a workbook (xlsx, xls, ods) that has the table into a grid of cells.

xlsx is read by openpyxl, which gives formats and errors of formulas. xls and ods are read by
calamine in a process of its own with limited memory: for a cell in a sheet's last corner calamine allocates
hundreds of gigabytes and aborts.
"""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import islice
from typing import Any, NamedTuple

from smallwheel_ros.common.errors import reason
from smallwheel_ros.measurements.cells import (
    MOST_BYTES,
    MOST_CELLS,
    SEARCHED,
    SMALLER,
    Cell,
    CellGrid,
    MeasurementsError,
    Percent,
    cell_of,
    clipped,
)
from smallwheel_ros.measurements.layout import known_cells

Rows = Iterable[tuple[int, Sequence[Cell]]]

_MOST_UNPACKED = 2 * MOST_BYTES  # bytes of XML: 27 for each of the most cells
_MOST_TAGS = 10_000_000  # of XML, four for each cell; reading them takes about 10 s
_MOST_COLUMNS = 16_384  # as of Excel and LibreOffice
_MOST_MEMORY = 2 * 2**30  # bytes that calamine may take
_FAR = f"expected at most {MOST_CELLS} cells: delete what stands far from the table, or {SMALLER}"
_SAVE_XLSX = "save it as xlsx, which keeps them apart, and read that"
# What an ods has and calamine does not report, with the words for it.
_LOST = (
    (rb'office:value-type="percentage"', f"has cells shown in per cent: {_SAVE_XLSX}"),
    (rb'calcext:value-type="error"', "has errors of formulas: mend them, or leave the cells blank"),
    (rb'table:formula="[^"]*"\s*/?>', "has formulas without a computed value: open it, save it, and "
     "read it again"),
)  # fmt: skip
_NO_VALUE = re.compile(rb"</f>\s*(?:<v\s*/>|<v>\s*</v>|</c>)|<f[^>]*/>\s*(?:<v\s*/>|</c>)")
_MERGED = re.compile(rb'<mergeCell [^>]*ref="([A-Z]+[0-9]+:[A-Z]+[0-9]+)"')


class _Book(NamedTuple):
    """A workbook: names of all sheets, of the hidden ones; rows and merged cells of a sheet, by its name."""

    names: list[str]
    hidden: list[str]
    rows: Callable[[str], Rows]
    merged: Callable[[str], list[tuple[int, int, int]]]


def workbook_grid(data: bytes, wanted: str | None) -> CellGrid:
    """Read one sheet of an xlsx, xls or ods workbook.

    Parameters
    ----------
    data
        Content of the file.
    wanted
        Name of the sheet, or its number from 1; None: the only visible sheet that has a table.

    Raises
    ------
    MeasurementsError
        If the workbook is damaged or too large, there is no such sheet, or not exactly one has a table.
    """
    try:
        parts = _parts(data) if data.startswith(b"PK") else {}
        xlsx = any(name.endswith("workbook.xml") for name in parts)
        if parts and not xlsx and "content.xml" not in parts:
            raise MeasurementsError("a ZIP archive and no xlsx or ods workbook: unpack it first")
        repeated = re.findall(rb'columns-repeated="(\d+)"', parts.get("content.xml", b""))
        if (most := max(map(int, repeated), default=0)) > _MOST_COLUMNS:
            raise MeasurementsError(f"a row of {most} cells, expected at most {_MOST_COLUMNS}")
        book = _xlsx(data, parts) if xlsx else _xls_or_ods(data)
        name = _chosen(book, wanted)
        grid = CellGrid([], [], "row", sheet=name, merged=book.merged(name), shares=not parts)
        cells = 0
        for number, row in book.rows(name):
            cells += len(row)
            if cells > MOST_CELLS:
                raise MeasurementsError(f"expected at most {MOST_CELLS} cells: {SMALLER}")
            grid.rows.append(row)
            grid.numbers.append(number)
        _refuse_lost(parts.get("content.xml", b""), name)
    except MeasurementsError:
        raise
    except Exception as error:  # the libraries raise many kinds for a damaged file
        why = clipped(reason(error).removeprefix("python_calamine."))
        raise MeasurementsError(f"a damaged workbook, or one with a password: {why}") from None
    if not grid.rows:
        raise MeasurementsError(f"sheet '{clipped(name)}' is empty")
    grid.said += [f"sheet '{clipped(name)}'"] if len(book.names) > 1 else []
    if book.hidden and wanted is None:
        hidden = ", ".join(f"'{clipped(name)}'" for name in book.hidden[:5])
        grid.said.append(f"hidden sheets are left out: {hidden}")
    if not parts:
        grid.said.append(
            "an xls: a cell shown as 20 % is read as 0.2, an error of a formula as blank"
        )
    return grid


def _chosen(book: _Book, wanted: str | None) -> str:
    """Name of the sheet that was asked for, else of the only one that has a table."""
    listed = ", ".join(f"'{clipped(name)}'" for name in book.names[:30])
    if wanted is not None:
        called = {str(i): name for i, name in enumerate(book.names, start=1)}
        called |= {name.strip().casefold(): name for name in reversed(book.names)}
        if wanted.strip().casefold() not in called:
            raise MeasurementsError(f"no sheet '{clipped(wanted)}', there is: {listed}")
        return called[wanted.strip().casefold()]
    if len(book.names) == 1:
        return book.names[0]
    tables = [
        name
        for name in book.names
        if name not in book.hidden
        and any(known_cells(row) > 1 for _, row in islice(book.rows(name), SEARCHED))
    ]
    if len(tables) != 1:
        what = "several sheets have tables" if tables else "no sheet has a header that is known"
        listed = ", ".join(f"'{clipped(name)}'" for name in tables) or listed
        raise MeasurementsError(f"{what}: name one with --sheet, there is: {listed}")
    return tables[0]


def _parts(data: bytes) -> dict[str, bytes]:
    """The XML files of a workbook, by name; raises MeasurementsError if they are too large or damaged."""
    archive = zipfile.ZipFile(io.BytesIO(data))
    members = archive.infolist()
    size, tags = sum(member.file_size for member in members), 0
    if size > _MOST_UNPACKED or len(members) > 10_000:
        raise MeasurementsError(
            f"{size} bytes once unpacked, expected at most {_MOST_UNPACKED}: {SMALLER}"
        )
    parts = {m.filename: archive.read(m) for m in members if m.filename.endswith((".xml", ".rels"))}
    for name, content in parts.items():
        if b"<!DOCTYPE" in content[:10_000] or b"<!ENTITY" in content:
            raise MeasurementsError(f"{name} declares entities: save it anew")
        tags += content.count(b"<")
        closed = 2 * content.count(b"</") + content.count(b"/>")
        if closed < content.count(b"<") - 1000:  # but for comments and the like
            raise MeasurementsError(f"a damaged workbook: {name} is not closed")
        if "/worksheets/" in name and _NO_VALUE.search(content):
            raise MeasurementsError(
                f"{clipped(name)} has formulas without a computed value: open the workbook in Excel "
                "or LibreOffice, save it, and read it again"
            )
    if tags > _MOST_TAGS:
        raise MeasurementsError(f"expected at most {_MOST_TAGS // 4} cells: {SMALLER}")
    return parts


def _xlsx(data: bytes, parts: Mapping[str, bytes]) -> _Book:
    import openpyxl
    from openpyxl.utils.cell import range_boundaries

    book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
    sheets: dict[str, Any] = {sheet.title: sheet for sheet in book.worksheets}

    def rows(name: str) -> Rows:
        sheets[name].reset_dimensions()  # what the file says of them need not be true
        for number, cells in enumerate(sheets[name].iter_rows(), start=1):
            row = ["" if cell.value is None else _xlsx_cell(cell) for cell in cells]
            while row and row[-1] == "":
                row.pop()
            if row:
                yield number, row

    def merged(name: str) -> list[tuple[int, int, int]]:  # openpyxl reads none row by row
        found = _MERGED.findall(parts[sheets[name]._worksheet_path])
        ranges = [range_boundaries(ref.decode("ascii")) for ref in found]
        return [(left - 1, top, last) for left, top, right, last in ranges if left == right]

    hidden = [name for name, sheet in sheets.items() if sheet.sheet_state != "visible"]
    return _Book([*sheets], hidden, rows, merged)


def _xlsx_cell(cell: Any) -> Cell:
    value = cell_of(cell.value)
    percent = isinstance(value, float) and "%" in (cell.number_format or "")
    return Percent(value) if percent else value


# Reads a workbook from standard input: names, hidden ones, merged ranges and rows of each sheet.
_CALAMINE = """
import io, json, resource, sys
from python_calamine import CalamineWorkbook, SheetVisibleEnum
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]), int(sys.argv[1])))
book = CalamineWorkbook.from_filelike(io.BytesIO(sys.stdin.buffer.read()))
metas = book.sheets_metadata
found = {"hidden": [m.name for m in metas if m.visible != SheetVisibleEnum.Visible], "sheets": {}}
for meta in metas:
    sheet = book.get_sheet_by_name(meta.name)
    big = (sheet.total_height + 1) * (sheet.total_width + 1) > int(sys.argv[2])
    rows = None if big else sheet.to_python(skip_empty_area=False)
    found["sheets"][meta.name] = [rows, sheet.merged_cell_ranges or []]
json.dump(found, sys.stdout, default=str)
"""


def _xls_or_ods(data: bytes) -> _Book:
    command = [sys.executable, "-c", _CALAMINE, str(_MOST_MEMORY), str(MOST_CELLS)]
    path = os.pathsep.join(entry for entry in sys.path if entry)
    done = subprocess.run(
        command,
        input=data,
        capture_output=True,
        env={**os.environ, "PYTHONPATH": path},
        check=False,
    )
    if done.returncode:
        last = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        if "python_calamine'" in last:
            raise MeasurementsError(
                "xls and ods need python-calamine: pip install it, or save as xlsx"
            )
        if done.returncode < 0 or "memory" in last or "Cell limit" in last:
            raise MeasurementsError(_FAR)
        if "detect" in last:  # calamine gives up on an ods of too many cells, or without a manifest
            raise MeasurementsError(f"a damaged workbook; {_FAR}")
        raise ValueError(last)
    found = json.loads(done.stdout)

    def rows(name: str) -> Rows:
        lines, _ = found["sheets"][name]
        if lines is None:
            raise MeasurementsError(_FAR)
        for number, line in enumerate(lines, start=1):
            if any(cell != "" for cell in line):
                yield number, [cell_of(cell) for cell in line]

    def merged(name: str) -> list[tuple[int, int, int]]:  # none of an ods
        ranges = found["sheets"][name][1]
        return [(c, r + 1, last + 1) for (r, c), (last, right) in ranges if right == c]

    return _Book([*found["sheets"]], found["hidden"], rows, merged)


def _refuse_lost(content: bytes, name: str) -> None:
    """Raise MeasurementsError if the sheet of an ods has cells that calamine does not report as they are."""
    for table in re.findall(rb"<table:table .*?</table:table>", content, re.DOTALL):
        called = re.search(rb'table:name="([^"]*)"', table)
        if called is not None and called[1].decode() == name:
            for lost, words in _LOST:
                if re.search(lost, table):
                    raise MeasurementsError(f"sheet '{clipped(name)}' {words}")
