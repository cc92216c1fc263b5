# SPDX-License-Identifier: Apache-2.0
"""From the bytes of a text file to a grid of cells: encoding, separator, rows."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from itertools import accumulate

from smallwheel_ros.measurements.cells import (
    EXPECTED,
    MOST_CELLS,
    SMALLER,
    Cell,
    Grid,
    MeasurementsError,
)
from smallwheel_ros.measurements.layout import SEARCHED, known_cells
from smallwheel_ros.measurements.long_text import LongText

_SAMPLE = 100_000  # characters in which the header must stand
_HEAD = 100  # lines in which titles, the header and units are; twice as many make a long file
SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}


def text_grid(data: bytes, source: str, digest: str) -> Grid:
    """Read comma, semicolon, tab or bar separated text in UTF-8, UTF-16 or Windows-1252."""
    text, said = _decoded(data, source)
    start = text[:200].lstrip()[:1]
    if start in ("{", "<") or (start == "[" and "\n" not in text.strip()):
        kind = "JSON" if start in "{[" else "HTML or XML"
        raise MeasurementsError(f"{source}: looks like {kind}, {EXPECTED}")
    first_line = 1
    if text[:4].lower() == "sep=":  # a line that only Excel knows
        text, first_line = text.partition("\n")[2], 2
    separator = _separator(text)
    if separator != ",":
        said.append(f"cells are separated by {SEPARATORS[separator]}")
    # Before any list is made of them. Twice the cells: texts in quotes have separators too.
    most = 2 * MOST_CELLS
    if len(text) > most and sum(map(text.count, (separator, "\n", "\r"))) > most:
        raise MeasurementsError(f"{source}: expected at most {MOST_CELLS} cells: {SMALLER}")

    def split(text: str) -> Grid:
        rows, numbers = _split(text, separator, source, first_line)
        return Grid(source, digest, rows, numbers, "line", comma=separator != ",", said=said)

    unix = text.replace("\r\n", "\n")
    lines = unix.split("\n", 2 * _HEAD)
    head = "\n".join(lines[:_HEAD])
    if len(lines) <= 2 * _HEAD or head.count('"') % 2:
        return split(text)
    grid = split(head)
    if len(grid.rows) == _HEAD:
        grid.long, grid.whole = LongText(unix, separator), lambda: split(text)
        return grid
    return split(text)


def _split(
    text: str, separator: str, source: str, first_line: int
) -> tuple[list[Sequence[Cell]], list[int]]:
    """The rows of the text, and the line on which each begins."""
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    rows: list[Sequence[Cell]] = []
    try:
        rows.extend(reader)
    except csv.Error as error:
        line = first_line + reader.line_num - 1
        raise MeasurementsError(f"{source}, line {line}: not CSV: {error}") from None
    if sum(map(len, rows)) > MOST_CELLS:
        raise MeasurementsError(f"{source}: expected at most {MOST_CELLS} cells: {SMALLER}")
    return rows, list(_lines(rows, reader.line_num, first_line))


def _lines(rows: list[Sequence[Cell]], lines: int, first: int) -> Iterable[int]:
    """The line on which each row begins: its number, unless texts in quotes have several."""
    if len(rows) == lines:
        return range(first, first + lines)
    breaks = (sum(len(str(c).splitlines()) - 1 for c in row if "\n" in str(c)) for row in rows)
    return accumulate((1 + n for n in breaks), initial=first)


def _decoded(data: bytes, source: str) -> tuple[str, list[str]]:
    if not data.strip(b" \t\r\n\x00"):
        raise MeasurementsError(f"{source}: the file is empty, {EXPECTED}")
    for mark, code in (
        (b"\xff\xfe", "utf-16"),
        (b"\xfe\xff", "utf-16"),
        (b"\xef\xbb\xbf", "utf-8-sig"),
    ):
        if data.startswith(mark):
            try:
                text = data.decode(code)
            except UnicodeDecodeError as error:
                raise MeasurementsError(
                    f"{source}: not {code.upper()} text as its first bytes say ({error.reason}): "
                    "save it as CSV UTF-8"
                ) from None
            return text, ["text in UTF-16"] if code == "utf-16" else []
    if b"\x00" in data:
        return _without_mark(data, source), ["text in UTF-16, without the mark of it"]
    try:
        return data.decode("utf-8"), []
    except UnicodeDecodeError as error:
        bad = error.start
    try:
        return data.decode("cp1252"), ["text in Windows-1252, as it is not UTF-8"]
    except UnicodeDecodeError:
        line = data.count(b"\n", 0, bad) + 1
        raise MeasurementsError(
            f"{source}, line {line}: byte 0x{data[bad]:02x} is neither UTF-8 nor Windows-1252 text, "
            f"{EXPECTED} (save it as CSV UTF-8)"
        ) from None


def _without_mark(data: bytes, source: str) -> str:
    """UTF-16 of Latin letters has zeros in every second byte; any other zeros are no text."""
    for code, zeros in (("utf-16-le", data[1:2000:2]), ("utf-16-be", data[0:2000:2])):
        if zeros.count(0) > 0.9 * len(zeros):
            try:
                return data.decode(code)
            except UnicodeDecodeError:
                break
    raise MeasurementsError(f"{source}: a binary file, {EXPECTED}")


def _separator(text: str) -> str:
    """The separator by which most headers are understood, else the one that makes most columns."""
    sample = text[:_SAMPLE]
    best, most = ",", (0, 0)
    for separator in SEPARATORS:
        if separator not in sample:
            continue
        try:
            rows = [
                row
                for row, _ in zip(
                    csv.reader(io.StringIO(sample, newline=""), delimiter=separator),
                    range(SEARCHED),
                    strict=False,
                )
            ]
        except csv.Error:
            continue
        known = max((known_cells(row) for row in rows), default=0)
        score = (known, max((len(row) for row in rows), default=0))
        if score > most:
            best, most = separator, score
    return best
