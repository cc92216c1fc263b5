# SPDX-License-Identifier: Apache-2.0
"""From a workbook, xlsx or ods, to a grid of cells: the sheet that has the table.

openpyxl reads xlsx row by row. ods is read here: its libraries build the whole document in memory, and
one stray cell in the last column of the last row would make them ask for hundreds of gigabytes.
Both are judged before: what they unpack to is limited, and no entities are expanded.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import Any, NamedTuple
from xml.etree import ElementTree

from smallwheel_ros.measurements.cells import (
    MOST_CELLS,
    SMALLER,
    TOO_MANY,
    Cell,
    Grid,
    MeasurementsError,
    Percent,
    clipped,
)
from smallwheel_ros.measurements.layout import SEARCHED, known_cells

_MOST_UNPACKED = 128 * 2**20  # bytes of XML: 27 for each of the most cells
_MOST_TAGS = 10_000_000  # of XML, four for each cell; reading them takes about 10 s
_NO_VALUE = re.compile(rb"</f>\s*(?:<v\s*/>|<v>\s*</v>|</c>)|<f[^>]*/>\s*(?:<v\s*/>|</c>)")
_MERGED = re.compile(rb'<mergeCell [^>]*ref="([A-Z]+[0-9]+:[A-Z]+[0-9]+)"')

Row = Sequence[Cell]


def workbook_grid(data: bytes, sheet: str | None) -> Grid:
    """Read one sheet. Raises MeasurementsError; where several have tables, it lists them."""
    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
        names = archive.namelist()
        _refuse_bombs(archive)
        if "content.xml" in names:
            sheets = _ods_sheets(archive)
        elif any(name.endswith("workbook.xml") for name in names):
            sheets = _xlsx_sheets(data)
        else:
            raise MeasurementsError(
                "this is a ZIP archive and no xlsx or ods workbook: unpack it first, or "
                "save the table as xlsx"
            )
        name = _chosen(sheets, sheet)
        grid, cells = Grid([], [], "row", sheet=name), 0
        for number, row in sheets.rows(name):
            cells += len(row)
            if cells > MOST_CELLS:
                raise MeasurementsError(TOO_MANY)
            grid.rows.append(row)
            grid.numbers.append(number)
        grid.merged = sheets.merged(name)
    except MeasurementsError:
        raise
    except Exception as error:  # the libraries raise many kinds for a damaged file
        reason = clipped(str(error)) or type(error).__name__
        raise MeasurementsError(
            f"a damaged xlsx or ods workbook or ZIP archive: {reason}"
        ) from None
    if not grid.rows:
        raise MeasurementsError(f"sheet '{clipped(name)}' is empty")
    grid.said += [f"sheet '{clipped(name)}'"] if len(sheets.names) > 1 else []
    if sheets.hidden and sheet is None:
        hidden = ", ".join(f"'{clipped(name)}'" for name in sheets.hidden[:5])
        grid.said.append(f"hidden sheets are left out: {hidden}")
    return grid


def _refuse_bombs(archive: zipfile.ZipFile) -> None:
    """Refuse what unpacks to more than a table needs; a member longer than it says is damaged."""
    sizes = sum(member.file_size for member in archive.infolist())
    if sizes > _MOST_UNPACKED or len(archive.infolist()) > 10_000:
        raise MeasurementsError(
            f"{sizes} bytes once unpacked, expected at most {_MOST_UNPACKED}: {SMALLER}"
        )
    tags = 0
    for member in archive.infolist():
        if not member.filename.endswith((".xml", ".rels")):
            continue
        content = archive.read(member)
        if b"<!DOCTYPE" in content[:10_000] or b"<!ENTITY" in content:
            raise MeasurementsError(f"{member.filename} declares entities: save it anew")
        tags += content.count(b"<")
        closed = 2 * content.count(b"</") + content.count(b"/>")
        if closed < content.count(b"<") - 1000:  # but for comments and the like
            raise MeasurementsError(f"a damaged workbook: {member.filename} is not closed")
        if "/worksheets/" in member.filename and _NO_VALUE.search(content):
            raise MeasurementsError(
                f"{clipped(member.filename)} has formulas without a computed value: open "
                "the workbook in Excel or LibreOffice, save it, and read it again"
            )
    if tags > _MOST_TAGS:
        raise MeasurementsError(f"expected at most {_MOST_TAGS // 4} cells: {SMALLER}")


class _Sheets(NamedTuple):
    """Names of the sheets of a workbook; of the one of a name its rows (line, cells) and merged ranges."""

    names: list[str]
    rows: Callable[[str], Iterator[tuple[int, Row]]]
    merged: Callable[[str], list[tuple[int, int, int]]]
    hidden: Sequence[str] = ()


def _chosen(sheets: _Sheets, wanted: str | None) -> str:
    """The name of the sheet that was asked for, else of the one that has a table."""
    listed = ", ".join(f"'{clipped(name)}'" for name in sheets.names[:30])
    if not sheets.names:
        raise MeasurementsError("no sheet with cells in it")
    if wanted is not None:
        called = {str(i): name for i, name in enumerate(sheets.names, start=1)}
        called |= {name.casefold(): name for name in reversed(sheets.names)}
        if wanted.strip().casefold() not in called:
            raise MeasurementsError(f"no sheet '{clipped(wanted)}', there is: {listed}")
        return called[wanted.strip().casefold()]
    if len(sheets.names) == 1:
        return sheets.names[0]
    tables = [
        name
        for name in sheets.names
        if name not in sheets.hidden
        and any(known_cells(row) > 1 for _, row in islice(sheets.rows(name), SEARCHED))
    ]
    if len(tables) != 1:
        what = "several sheets have tables" if tables else "no sheet has a header that is known"
        listed = ", ".join(repr(clipped(name)) for name in tables) or listed
        raise MeasurementsError(f"{what}: name one with --sheet, there is: {listed}")
    return tables[0]


def _xlsx_sheets(data: bytes) -> _Sheets:
    try:
        import openpyxl
    except ImportError:
        raise MeasurementsError(
            "reading xlsx needs openpyxl: pip install openpyxl, or save it as CSV UTF-8"
        ) from None
    book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
    sheets = {sheet.title: sheet for sheet in book.worksheets}

    def rows(name: str) -> Iterator[tuple[int, Row]]:
        sheet = sheets[name]
        sheet.reset_dimensions()  # what the file says of them need not be true
        for number, cells in enumerate(sheet.iter_rows(), start=1):
            row = [_xlsx_cell(cell) for cell in cells]
            while row and row[-1] == "":
                row.pop()
            if row:
                yield number, row

    hidden = [name for name, sheet in sheets.items() if sheet.sheet_state != "visible"]
    return _Sheets(list(sheets), rows, lambda name: _xlsx_merged(data, sheets[name]), hidden)


def _xlsx_merged(data: bytes, sheet: Any) -> list[tuple[int, int, int]]:
    """Ranges of one column; openpyxl does not give them where it reads row by row."""
    from openpyxl.utils.cell import range_boundaries

    content = zipfile.ZipFile(io.BytesIO(data)).read(sheet._worksheet_path)
    found = []
    for ref in _MERGED.findall(content):
        left, top, right, bottom = range_boundaries(ref.decode("ascii"))
        if left == right and top < bottom:
            found.append((left - 1, top, bottom))
    return found


def _xlsx_cell(cell: Any) -> Cell:
    value = cell.value
    if value is None:
        return ""
    if isinstance(value, str):
        return value.strip()
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)  # a date, a time
    return Percent(value) if "%" in (cell.number_format or "") else float(value)


_OFFICE = "{urn:oasis:names:tc:opendocument:xmlns:office:1.0}"
_TABLE = "{urn:oasis:names:tc:opendocument:xmlns:table:1.0}"
_TEXT = "{urn:oasis:names:tc:opendocument:xmlns:text:1.0}"


def _ods_sheets(archive: zipfile.ZipFile) -> _Sheets:
    content = archive.read("content.xml")
    names = [
        str(element.get(f"{_TABLE}name"))
        for event, element in _elements(content)
        if event == "start" and element.tag == f"{_TABLE}table"
    ]
    merged: list[tuple[int, int, int]] = []

    def rows(name: str) -> Iterator[tuple[int, Row]]:
        merged.clear()
        yield from _ods_rows(content, name, merged)

    return _Sheets(names, rows, lambda _: merged)


def _elements(content: bytes) -> Iterator[tuple[str, ElementTree.Element]]:
    """Every element as it begins and ends; rows and tables are emptied behind."""
    kept = (f"{_TABLE}table-row", f"{_TABLE}table")
    for event, element in ElementTree.iterparse(io.BytesIO(content), events=("start", "end")):
        yield event, element
        if event == "end" and element.tag in kept:
            element.clear()


def _ods_rows(
    content: bytes, name: str, merged: list[tuple[int, int, int]]
) -> Iterator[tuple[int, Row]]:
    """Rows of a sheet; ranges of one column are added to `merged`."""
    inside = False
    number = 1
    for event, element in _elements(content):
        if element.tag == f"{_TABLE}table":
            if inside and event == "end":
                return
            inside = event == "start" and element.get(f"{_TABLE}name") == name
        elif event == "end" and element.tag == f"{_TABLE}table-row":
            repeated = int(element.get(f"{_TABLE}number-rows-repeated", "1"))
            row = _ods_row(element) if inside else []
            merged += _ods_merged(element, number) if inside else []
            if row and repeated * len(row) > MOST_CELLS:
                raise MeasurementsError(TOO_MANY)
            if row:
                yield from ((number + i, row) for i in range(repeated))
            number += repeated


def _ods_row(element: ElementTree.Element) -> list[Cell]:
    row: list[Cell] = []
    blanks = 0
    for cell in element:
        if cell.tag not in (f"{_TABLE}table-cell", f"{_TABLE}covered-table-cell"):
            continue
        repeated = int(cell.get(f"{_TABLE}number-columns-repeated", "1"))
        value = _ods_cell(cell)
        if value == "":
            blanks += repeated  # thousands of them end most rows
            continue
        if len(row) + blanks + repeated > MOST_CELLS:
            raise ValueError(f"a row of {len(row) + blanks + repeated} cells")
        row += [""] * blanks + [value] * repeated
        blanks = 0
    return row


def _ods_merged(element: ElementTree.Element, number: int) -> Iterator[tuple[int, int, int]]:
    column = 0
    for cell in element:
        rows = int(cell.get(f"{_TABLE}number-rows-spanned", "1"))
        if rows > 1 and cell.get(f"{_TABLE}number-columns-spanned", "1") == "1":
            yield column, number, number + rows - 1
        column += int(cell.get(f"{_TABLE}number-columns-repeated", "1"))


def _ods_cell(cell: ElementTree.Element) -> Cell:
    kind = cell.get(f"{_OFFICE}value-type")
    if kind in ("float", "percentage", "currency"):
        value = float(cell.get(f"{_OFFICE}value", "nan"))
        return Percent(value) if kind == "percentage" else value
    for blank in cell.iter(f"{_TEXT}s"):  # a run of blanks
        blank.text = " "
    return "\n".join("".join(p.itertext()) for p in cell.findall(f"{_TEXT}p")).strip()
