# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: E501
"""Tables as labs have them: one experiment, written by people and programs of three countries.

Each is the bytes of a file and what is different in it. Workbooks are written as the programs write them:
xlsx by openpyxl, ods as LibreOffice fills its content.xml (repeated cells and rows to the end of the sheet).
"""

from __future__ import annotations

import datetime
import io
import zipfile
from collections.abc import Callable, Iterable, Mapping
from xml.sax.saxutils import escape

import openpyxl

Cell = str | float | None | tuple[str, float]
# run, load in N, diameter in mm, width in mm, slip in %, sinkage in mm
TRUTH = [
    ("a", 60.0, 275.0, 100.0, 10.0, 8.5),
    ("a", 60.0, 275.0, 100.0, 10.0, 8.75),
    ("b", 80.5, 275.0, 100.0, 20.0, 11.25),
    ("b", 80.5, 275.0, 100.0, 20.0, 11.0),
]
ENGLISH = ["Run", "Load (N)", "Diameter (mm)", "Width (mm)", "Slip (%)", "Sinkage (mm)"]
GERMAN = [
    "Versuch",
    "Radlast [N]",
    "Raddurchmesser [mm]",
    "Radbreite [mm]",
    "Schlupf [%]",
    "Einsinkung [mm]",
]
FRENCH = [
    "Essai",
    "Charge (N)",
    "Diamètre (mm)",
    "Largeur (mm)",
    "Glissement (%)",
    "Enfoncement (mm)",
]
JAPANESE = ["試験", "荷重（N）", "直径（mm）", "幅（mm）", "スリップ率（％）", "沈下量（mm）"]
BARE = ["run", "load", "diameter", "width", "slip", "sinkage"]
UNITS = ["", "N", "mm", "mm", "%", "mm"]


def text(
    header: list[str], separator: str = ",", mark: str = ".", rows: Iterable[tuple[object, ...]] = TRUTH,
    before: str = "", after: str = "", end: str = "\n",
) -> str:  # fmt: skip
    """A text table with that separator and decimal mark."""

    def shown(cell: object) -> str:
        return f"{cell:g}".replace(".", mark) if isinstance(cell, float) else str(cell)

    lines = [separator.join(header), *(separator.join(map(shown, row)) for row in rows)]
    return before + end.join(lines) + end + after


def xlsx(**sheets: list[list[Cell]]) -> bytes:
    """A workbook; a tuple is a number and its format: ("0%", 0.1)."""
    book = openpyxl.Workbook()
    book.remove(book.worksheets[0])
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for i, row in enumerate(rows, start=1):
            for j, cell in enumerate(row, start=1):
                if isinstance(cell, tuple):
                    sheet.cell(i, j, cell[1]).number_format = cell[0]
                elif cell is not None:
                    sheet.cell(i, j, cell)
    target = io.BytesIO()
    book.save(target)
    return target.getvalue()


def ods(spans: Mapping[tuple[int, int], int] | None = None, /, **sheets: list[list[Cell]]) -> bytes:
    """A spreadsheet as LibreOffice writes it; a tuple is a percentage.

    spans: rows that the cell at (row, column) is merged over; the others below it are covered.
    """
    merged = dict(spans or {})
    covered = {(i + k, j) for (i, j), rows in merged.items() for k in range(1, rows)}

    def placed(at: tuple[int, int], cell: Cell) -> str:
        if at in covered:
            return "<table:covered-table-cell/>"
        spanned = f' table:number-columns-spanned="1" table:number-rows-spanned="{merged.get(at)}"'
        return one(cell).replace(
            "<table:table-cell", "<table:table-cell" + spanned * (at in merged), 1
        )

    def one(cell: Cell) -> str:
        if cell is None or cell == "":
            return "<table:table-cell/>"
        if isinstance(cell, str):
            words = escape(cell).replace("  ", " <text:s/>")
            return f'<table:table-cell office:value-type="string" calcext:value-type="string"><text:p>{words}</text:p></table:table-cell>'
        kind, value = ("percentage", cell[1]) if isinstance(cell, tuple) else ("float", cell)
        shown = f"{value:g}".replace(".", ",")
        return (
            f'<table:table-cell office:value-type="{kind}" office:value="{value}"'
            f' calcext:value-type="{kind}"><text:p>{shown}</text:p></table:table-cell>'
        )

    body = ""
    for name, rows in sheets.items():
        body += f'<table:table table:name="{name}" table:style-name="ta1">'
        body += '<table:table-column table:number-columns-repeated="16384"/>'
        for i, row in enumerate(rows):
            body += "<table:table-row>" + "".join(
                placed((i, j), cell) for j, cell in enumerate(row)
            )
            body += '<table:table-cell table:number-columns-repeated="16000"/></table:table-row>'
        body += '<table:table-row table:number-rows-repeated="1048000"><table:table-cell table:number-columns-repeated="16384"/></table:table-row></table:table>'
    names = "".join(
        f' xmlns:{short}="urn:oasis:names:tc:opendocument:xmlns:{short}:1.0"'
        for short in ("office", "table", "text")
    )
    content = (
        f'<?xml version="1.0" encoding="UTF-8"?><office:document-content{names}'
        ' xmlns:calcext="urn:org:documentfoundation:names:experimental:calc:xmlns:calcext:1.0">'
        f"<office:body><office:spreadsheet>{body}</office:spreadsheet></office:body></office:document-content>"
    )
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        kind = "application/vnd.oasis.opendocument.spreadsheet"
        archive.writestr("mimetype", kind, zipfile.ZIP_STORED)
        space = "urn:oasis:names:tc:opendocument:xmlns:manifest:1.0"
        entries = (("/", kind), ("content.xml", "text/xml"))
        files = "".join(
            f'<manifest:file-entry manifest:full-path="{path}" manifest:media-type="{media}"/>'
            for path, media in entries
        )
        archive.writestr(
            "META-INF/manifest.xml",
            f'<?xml version="1.0"?><manifest:manifest xmlns:manifest="{space}">{files}</manifest:manifest>',
        )
        archive.writestr("content.xml", content)
    return target.getvalue()


def changed(book: bytes, part: str, old: bytes, new: bytes) -> bytes:
    """The workbook with other bytes in one of its parts."""
    target = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(book)) as before,
        zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as after,
    ):
        for entry in before.infolist():
            content = before.read(entry)
            if entry.filename.endswith(part):
                assert old in content
                content = content.replace(old, new, 1)
            after.writestr(entry, content)
    return target.getvalue()


def workbook(fill: Callable[[openpyxl.Workbook], None]) -> bytes:
    """A workbook that a person made: merged cells, hidden sheets, dates."""
    book = openpyxl.Workbook()
    fill(book)
    target = io.BytesIO()
    book.save(target)
    return target.getvalue()


def _with_a_logo(book: openpyxl.Workbook) -> None:
    """Title in merged cells, a blank column, units below, a mean, a sum, a remark."""
    sheet = book.active
    sheet.merge_cells("C1:H1")
    sheet["C1"] = "Institut für Mobilität – Einzelradprüfstand"
    sheet["C2"], sheet["D2"] = "Datum:", datetime.date(2026, 3, 12)
    rows = [[h.split(" [")[0] for h in GERMAN], UNITS, *map(list, TRUTH), MEAN, ["Summe", 281.0]]
    rows += [[], ["Bemerkung: nach Versuch a neu aufbereitet"]]
    for i, row in enumerate(rows):
        for j, cell in enumerate(row):
            sheet.cell(5 + i, 3 + j, cell)


def _with_merged_cells(book: openpyxl.Workbook) -> None:
    """Runs, loads and sizes in merged ranges; the header is merged with the empty row of units."""
    sheet = book.active
    for i, row in enumerate([ENGLISH, [None] * 6, *_cells(ENGLISH)[1:]], start=1):
        for j, cell in enumerate(row, start=1):
            sheet.cell(i, j, cell)
    for cells in ("A1:A2", "A3:A4", "A5:A6", "B3:B4", "B5:B6", "C3:C6", "D3:D6"):
        sheet.merge_cells(cells)


def _with_a_hidden_sheet(book: openpyxl.Workbook) -> None:
    for row in _cells(ENGLISH):
        book.active.append(row)
    old = book.create_sheet("old")
    old.sheet_state = "hidden"
    for row in _cells(ENGLISH):
        old.append(row)


def _cells(header: list[str], percent: bool = False) -> list[list[Cell]]:
    rows: list[list[Cell]] = [list(header)]
    for *most, slip, sinkage in TRUTH:
        rows.append([*most, ("0%", slip / 100.0) if percent else slip, sinkage])
    return rows


MEAN = ("Mittelwert", 70.25, 275.0, 100.0, 15.0, 9.875)

# What reads as the truth, by what is different in it.
GOOD: dict[str, bytes] = {
    "English Excel, CSV UTF-8": ("\ufeff" + text(ENGLISH, end="\r\n")).encode(),
    "German Excel, CSV": text(GERMAN, ";", ",", end="\r\n").encode("cp1252"),
    "French Excel, CSV": text(FRENCH, ";", ",", end="\r\n").encode("cp1252"),
    "Excel, Unicode text": text(GERMAN, "\t", ",", end="\r\n").encode("utf-16"),
    "UTF-16 without its mark": text(GERMAN, "\t", ",").encode("utf-16-le"),
    "line of Excel's separator": text(GERMAN, ";", ",", before="sep=;\r\n").encode(),
    "decimal commas in quotes": text(ENGLISH, rows=[
        (r, *(f'"{c:g}"'.replace(".", ",") for c in rest)) for r, *rest in TRUTH]).encode(),
    "bars": text(ENGLISH, "|").encode(),
    "upper case": text([h.upper() for h in BARE[:1]] + ["LOAD [N]", "DIAMETER [MM]", "WIDTH [MM]", "SLIP [%]", "SINKAGE [MM]"]).encode(),
    "underscores": text(["run", "load_N", "diameter_mm", "width_mm", "slip_pct", "sinkage_mm"]).encode(),
    "commas in headers": text(["run", '"load, N"', '"diameter, mm"', '"width, mm"', '"slip, %"', '"sinkage, mm"']).encode(),
    "symbols": text(["Run", "W [N]", "D [mm]", "b [mm]", "s [%]", "z [mm]"]).encode(),
    "other symbols": text(["Run", "Fz (N)", "D (mm)", "b (mm)", "i (%)", "z (mm)"]).encode(),
    "words and symbols": text(["Run", "Normal load W (N)", "Wheel diameter D (mm)", "Wheel width b (mm)", "Slip s (%)", "Sinkage z (mm)"]).encode(),
    "slashes": text(["Run", "Load / N", "Diameter / mm", "Width / mm", "Slip / %", "Sinkage / mm"]).encode(),
    "units in a row": text(BARE, rows=[tuple(UNITS), *TRUTH]).encode(),
    "units in brackets in a row": text(BARE, rows=[("", "[N]", "[mm]", "[mm]", "[%]", "[mm]"), *TRUTH]).encode(),
    "symbols and units in rows": text(BARE, rows=[("", "W", "D", "b", "s", "z"), tuple(UNITS), *TRUTH]).encode(),
    "titles and comments": text(ENGLISH, before="Single wheel rig,,,,,\nOperator: M,,,,,\n,,,,,\n# dry sand\n", after="# end\n").encode(),
    "header of NumPy": text(["# run", "load [N]", "diameter [mm]", "width [mm]", "slip [%]", "sinkage [mm]"]).encode(),
    "means and deviations below": text(GERMAN, ";", ",", [*TRUTH, ("",) * 6, MEAN, ("Standardabweichung", 11.8, 0.0, 0.0, 5.8, 1.4)]).encode(),
    "remarks with commas below": text(ENGLISH, after="\nNotes:\n1) dry sand, 2) lights off\nOperator,Jim\n").encode(),
    "means between": text(ENGLISH, rows=[*TRUTH[:2], ("Mean a", 60.0, 275.0, 100.0, 10.0, 8.6), *TRUTH[2:], ("Mean b", 80.5, 275.0, 100.0, 20.0, 11.1), ("Gesamt", 281.0, "", "", "", "")]).encode(),
    "a mean that the last column tells": text([*ENGLISH, "Remark"], rows=[*((*r, "") for r in TRUTH), ("", *MEAN[1:], "average")]).encode(),
    "the header once more": text(ENGLISH, rows=[*TRUTH[:2], ("",) * 6, tuple(ENGLISH), *TRUTH[2:]]).encode(),
    "narrow blanks of thousands": text(["Essai", "Charge (mN)", *FRENCH[2:]], ";", ",", rows=[(r[0], f"{1000 * r[1]:,.1f}".replace(",", "\u202f").replace(".", ","), *r[2:]) for r in TRUTH]).encode(),
    "points of thousands": text(["Versuch", "Last [mN]", *GERMAN[2:]], ";", ",", rows=[(r[0], f"{1000 * r[1]:,.1f}".translate(str.maketrans(",.", ".,")), *r[2:]) for r in TRUTH]).encode(),
    "commas of thousands": text(["Run", "Load (mN)", *ENGLISH[2:]], rows=[(r[0], f'"{1000 * r[1]:,.1f}"', *r[2:]) for r in TRUTH]).encode(),
    "inches by their mark, pounds": text(["Run", "Load (lbs)", 'Wheel dia (")', 'Width (")', "Slip (%)", 'Sinkage (")'], rows=[
        (r[0], f"{r[1] / 4.4482216152605:.9g}", *(f"{x / 25.4:.9g}" for x in r[2:4]), r[4], f"{r[5] / 25.4:.9g}") for r in TRUTH]).encode(),
    "dates and times": text(["Date", "Time", *ENGLISH], rows=[("12/03/2026", "14:05", *r) for r in TRUTH]).encode(),
    "ends of lines of old": text(ENGLISH, end="\r").replace("\n", "").encode(),
    "xlsx, a logo above and beside": workbook(_with_a_logo),
    "xlsx, a hidden sheet": workbook(_with_a_hidden_sheet),
    "Spanish": text(["Ensayo", "Carga (N)", "Diámetro (mm)", "Ancho (mm)", "Deslizamiento (%)", "Hundimiento (mm)"], ";", ",").encode("cp1252"),
    "Italian": text(["Prova", "Carico [N]", "Diametro [mm]", "Larghezza [mm]", "Slittamento [%]", "Affondamento [mm]"], ";", ",").encode(),
    "Portuguese": text(["Ensaio", "Carga (N)", "Diâmetro (mm)", "Largura (mm)", "Patinagem (%)", "Afundamento (mm)"], ";", ",").encode("cp1252"),
    "Polish": text(["Próba", "Obciążenie [N]", "Średnica [mm]", "Szerokość [mm]", "Poślizg [%]", "Zagłębienie [mm]"], ";", ",").encode(),
    "Japanese": text(JAPANESE).encode(),
    "Chinese": text(["试验", "载荷 [N]", "直径 [mm]", "宽度 [mm]", "滑转率 [%]", "沉陷量 [mm]"]).encode(),
    "runs typed once": text(ENGLISH, rows=[TRUTH[0], ("", *TRUTH[1][1:]), TRUTH[2], ("", *TRUTH[3][1:])]).encode(),
    "soils and runs typed once, and a mean": text(["Soil", *ENGLISH], rows=[("dry", *TRUTH[0]), ("", "", *TRUTH[1][1:]), ("wet", *TRUTH[2]), ("", "", *TRUTH[3][1:]), ("Keskiarvo", "", *MEAN[1:])]).encode(),
    "xlsx, merged cells": workbook(_with_merged_cells),
    "a remark below": text(ENGLISH, after="Source: notebook 7\n").encode(),
    "empty columns and rows": text([*ENGLISH, "", ""], rows=[(*r, "", "") for r in [*TRUTH[:2], ("",) * 6, *TRUTH[2:]]], after=",,,,,,,\n").encode(),
    "units in cells of per cent": text([*ENGLISH[:4], "Slip", ENGLISH[5]], rows=[(*r[:4], f"{r[4]:g} %", r[5]) for r in TRUTH]).encode(),
    "kilograms-force, centimetres, radius": text(["run", "load [kgf]", "radius [cm]", "width [cm]", "slip [%]", "sinkage [cm]"],
        rows=[(r, w / 9.80665, d / 20.0, b / 10.0, s, z / 10.0) for r, w, d, b, s, z in TRUTH]).encode(),
    "blanks around": text([f" {h} " for h in ENGLISH], rows=[(f" {r[0]}", *(f" {c:g} " for c in r[1:])) for r in TRUTH]).encode(),
    "typographic minus and blanks": text(ENGLISH, rows=TRUTH).replace("60", "\u00a060").encode(),
    "xlsx": xlsx(Data=_cells(ENGLISH)),
    "xlsx, cells in per cent": xlsx(Tabelle1=_cells(GERMAN, percent=True)),
    "xlsx, title, units and mean": xlsx(Tabelle1=[["Einzelradversuch 12"], [], BARE, UNITS, *map(list, TRUTH), [], list(MEAN)]),
    "xlsx, numbers as text": xlsx(Tabelle1=[GERMAN, *([r[0], *(f"{c:g}".replace(".", ",") for c in r[1:])] for r in TRUTH)]),
    "xlsx, the table on one of three sheets": xlsx(Info=[["Rig", "7"]], Daten=_cells(GERMAN), Notizen=[["nass"]]),
    "xlsx, below and to the right": xlsx(S=[[], [], *([None, None, *row] for row in _cells(ENGLISH))]),
    "ods": ods(Feuille1=_cells(FRENCH)),
    "ods, title, units and mean": ods(Tabelle1=[["Versuch  12"], [], BARE, UNITS, *map(list, TRUTH), [], list(MEAN)]),
}  # fmt: skip

# What is refused, and words of each problem that must be named.
BAD: dict[str, tuple[bytes, list[str]]] = {
    "many mistakes": (text(["Run", "Laod (N)", "Diameter (mm)", "Width (foo)", "Slip", "Sinkage (mm)"],
        rows=[("a", 60.0, 275.0, 100.0, 10.0, 8.5), ("a", 60.0, "27o", 100.0, 0.1, ""), ("b", 60.0, 275.0, 100.0, 0.1, -3.0)]).encode(),
        ["no column 'load'", "'27o' found", "'Width (foo)' is no known word, but nearly 'width'", "slip [%]", "sinkage is -3 mm"]),
    "millimetres without a unit": (text(BARE).encode(), ["diameter is 275", "for mm the header is 'diameter [mm]'", "width is 100"]),
    "marks of thousands or decimals": (text(ENGLISH, ";", ",", [("a", "1.234", 275.0, 100.0, 10.0, 8.5)] * 2).encode(), ["'1.234' found", "two ways"]),
    "both marks in a column": (text(ENGLISH, ";", ",", [*TRUTH, ("c", "60.5", 275.0, 100.0, 10.0, "8.5")]).encode(), ["decimal points and decimal commas"]),
    "two loads": (text(["run", "Radlast [N]", "Last [N]", "D [mm]", "b [mm]", "z [mm]"]).encode(), ["two columns are named 'load'", "--map 'load=Radlast [N]'"]),
    "values without a header": (text([*ENGLISH[:5], ""]).encode(), ["column 6 has no name", "nothing was measured"]),
    "grad": (text([*ENGLISH, "Neigung [grad]"], rows=[(*r, 5.0) for r in TRUTH]).encode(), ["write deg or gon"]),
    "decimal commas between commas": (text(ENGLISH, ",", ",").encode(), ["cells, expected 6 as in the header", "decimal comma"]),
    "units that differ": (text(ENGLISH, rows=[("", "kN", "mm", "mm", "%", "mm"), *TRUTH]).encode(), ["the row of units below it (kN) differ"]),
    "a cell in the other mark": (text(GERMAN, ";", ",", [*TRUTH, ("c", "60.5", 275.0, 100.0, 10.0, 8.5)]).encode(), ["line 6, column 'Radlast [N]': '60.5' found", "decimal points and decimal commas"]),
    "texts in cells": (text(ENGLISH, rows=[*TRUTH, ("c", "#DIV/0!", "275 mm", 100.0, 10.0, "<0.1"), ("c", 60.0, "275 mm", 100.0, "locked", "8.5 ± 0.2")]).encode(),
        ["mend the formula", "(and 1 more like it: line 7)", "a limit is no measurement", "'locked' found", "sinkage_std [mm]"]),
    "a second table of other columns": (text(ENGLISH, after="\nSieve (mm),Passing (%)\n0.1,20\n").encode(), ["line 8: 2 cells, expected 6"]),
    "names of soils that are scattered": (text(["Soil", *ENGLISH], rows=[("dry", *TRUTH[0]), ("dry", *TRUTH[1]), ("", *TRUTH[2]), ("wet", *TRUTH[3])]).encode(), ["line 4, column 'Soil'", "merged cells have to be filled"]),
    "sinkage counted upwards": (text(ENGLISH, rows=[(*r[:5], -r[5]) for r in TRUTH]).encode(), ["sinkage is -8.5 mm", "turn the sign"]),
    "xlsx, two tables": (xlsx(A=_cells(ENGLISH), B=_cells(ENGLISH)), ["several sheets have tables", "--sheet", "'A', 'B'"]),
    "ods, cells in per cent": (ods(Tabelle1=_cells(GERMAN, percent=True)), ["sheet 'Tabelle1' has cells shown in per cent: save it as xlsx"]),
    "xlsx, errors of formulas": (xlsx(A=[*_cells(ENGLISH), ["c", "#DIV/0!", 275.0, 100.0, 10.0, 8.0]]), ["'#DIV/0!' found", "mend the formula"]),
    "xlsx, no table": (xlsx(A=[["x", 1.0]], B=[["y", 2.0]]), ["no sheet has a header that is known"]),
    "xlsx, a date for 1.5": (xlsx(A=[*_cells(ENGLISH), ["c", "2026-05-01 00:00:00", 275.0, 100.0, 10.0, 8.0]]), ["a date"]),
    "xlsx, formulas never computed": (xlsx(A=[*_cells(ENGLISH), ["c", "=B2*2", 275.0, 100.0, 10.0, 8.0]]), ["formulas without a computed value"]),
    "xlsx, per cent in a length": (xlsx(A=[ENGLISH, ["a", 60.0, 275.0, 100.0, 10.0, ("0%", 0.1)]]), ["cells in per cent, expected mm"]),
    "ods, per cent in a length": (ods(A=[ENGLISH, ["a", 60.0, 275.0, 100.0, 10.0, ("0%", 0.1)]]), ["has cells shown in per cent"]),
}  # fmt: skip
