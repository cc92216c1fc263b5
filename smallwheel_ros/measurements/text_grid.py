"""From the bytes of a text file to a grid of cells: encoding, separator, rows."""

from __future__ import annotations

import csv
import io

from smallwheel_ros.measurements.cells import MOST_CELLS, SMALLER, Grid, MeasurementsError
from smallwheel_ros.measurements.layout import known_cells

_EXPECTED = "expected a table: CSV text, xlsx, ods or Parquet"
_SAMPLE = 100_000  # characters in which the header must stand
_SAMPLE_ROWS = 40
SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}


def text_grid(data: bytes, source: str, digest: str) -> Grid:
    """Read comma, semicolon, tab or bar separated text in UTF-8, UTF-16 or Windows-1252."""
    text, said = _decoded(data, source)
    start = text[:200].lstrip()[:1]
    if start in ("{", "<") or (start == "[" and "\n" not in text.strip()):
        kind = "JSON" if start in "{[" else "HTML or XML"
        raise MeasurementsError(f"{source}: looks like {kind}, {_EXPECTED}")
    first_line = 1
    if text[:4].lower() == "sep=":  # a line that only Excel knows
        text, first_line = text.partition("\n")[2], 2
    separator = _separator(text)
    if separator != ",":
        said.append(f"cells are separated by {SEPARATORS[separator]}")
    # Before any list is made of them. Twice the cells: texts in quotes have separators too.
    if text.count(separator) + text.count("\n") + text.count("\r") > 2 * MOST_CELLS:
        raise MeasurementsError(f"{source}: expected at most {MOST_CELLS} cells: {SMALLER}")
    grid = Grid(source, digest, [], [], "line", comma=separator != ",", said=said)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    line = first_line
    cells = 0
    try:
        for row in reader:
            grid.rows.append(row)
            grid.numbers.append(line)
            line = first_line + reader.line_num
            cells += len(row)
            if cells > MOST_CELLS:
                raise MeasurementsError(f"{source}: expected at most {MOST_CELLS} cells: {SMALLER}")
    except csv.Error as error:
        raise MeasurementsError(f"{source}, line {line}: not CSV: {error}") from None
    return grid


def _decoded(data: bytes, source: str) -> tuple[str, list[str]]:
    if not data.strip(b" \t\r\n\x00"):
        raise MeasurementsError(f"{source}: the file is empty, {_EXPECTED}")
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
            f"{_EXPECTED} (save it as CSV UTF-8)"
        ) from None


def _without_mark(data: bytes, source: str) -> str:
    """UTF-16 of Latin letters has zeros in every second byte; any other zeros are no text."""
    for code, zeros in (("utf-16-le", data[1:2000:2]), ("utf-16-be", data[0:2000:2])):
        if zeros.count(0) > 0.9 * len(zeros):
            try:
                return data.decode(code)
            except UnicodeDecodeError:
                break
    raise MeasurementsError(f"{source}: a binary file, {_EXPECTED}")


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
                    range(_SAMPLE_ROWS),
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
