# SPDX-License-Identifier: Apache-2.0
"""From the bytes of a text file to a grid of cells: encoding, separator, rows."""

from __future__ import annotations

import csv
import io
from itertools import islice

from smallwheel_ros.measurements.cells import (
    EXPECTED,
    MOST_CELLS,
    SMALLER,
    Grid,
    MeasurementsError,
)
from smallwheel_ros.measurements.layout import SEARCHED, known_cells

_SAMPLE = 100_000  # characters in which the header must stand
_SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}
_MARKS = ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"), (b"\xef\xbb\xbf", "utf-8-sig"))


def text_grid(data: bytes, source: str, digest: str) -> Grid:
    """Read comma, semicolon, tab or bar separated text in UTF-8, UTF-16 or Windows-1252."""
    text, said = _decoded(data, source)
    start = text[:200].lstrip()[:1]
    if start in ("{", "<") or (start == "[" and "\n" not in text.strip()):
        kind = "JSON" if start in "{[" else "HTML or XML"
        raise MeasurementsError(f"{source}: looks like {kind}, {EXPECTED}")
    line = 1
    if text[:4].lower() == "sep=":  # a line that only Excel knows
        text, line = text.partition("\n")[2], 2
    separator = _separator(text)
    if separator != ",":
        said.append(f"cells are separated by {_SEPARATORS[separator]}")
    # Before any list is made of them. Twice the cells: texts in quotes have separators too.
    too_many = f"{source}: expected at most {MOST_CELLS} cells: {SMALLER}"
    most = 2 * MOST_CELLS
    if len(text) > most and sum(map(text.count, (separator, "\n", "\r"))) > most:
        raise MeasurementsError(too_many)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    grid = Grid(source, digest, [], [], "line", comma=separator != ",", said=said)
    before = line - 1
    try:
        for row in reader:  # a text in quotes may have several lines
            grid.rows.append(row)
            grid.numbers.append(line)
            line = before + reader.line_num + 1
    except csv.Error as error:
        at = before + reader.line_num
        raise MeasurementsError(f"{source}, line {at}: not CSV: {error}") from None
    if sum(map(len, grid.rows)) > MOST_CELLS:
        raise MeasurementsError(too_many)
    return grid


def _decoded(data: bytes, source: str) -> tuple[str, list[str]]:
    if not data.strip(b" \t\r\n\x00"):
        raise MeasurementsError(f"{source}: the file is empty, {EXPECTED}")
    for code in (c for mark, c in _MARKS if data.startswith(mark)):
        try:
            return data.decode(code), ["text in UTF-16"] if code == "utf-16" else []
        except UnicodeDecodeError as error:
            raise MeasurementsError(
                f"{source}: not {code.upper()} text as its first bytes say ({error.reason}): "
                "save it as CSV UTF-8"
            ) from None
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
    best, most = ",", (0, 0)
    for separator in _SEPARATORS:
        try:
            reader = csv.reader(io.StringIO(text[:_SAMPLE], newline=""), delimiter=separator)
            rows = list(islice(reader, SEARCHED))
        except csv.Error:
            continue
        score = max(map(known_cells, rows), default=0), max(map(len, rows), default=0)
        if separator in text[:_SAMPLE] and score > most:
            best, most = separator, score
    return best
