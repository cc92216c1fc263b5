# SPDX-License-Identifier: Apache-2.0
"""Tables of docs/rates.md out of the rows in benchmarks/rates/: pooled rates, and worlds beyond their limits.

python benchmarks/rates_page.py [docs/rates.md]
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import pandas as pd

FOLDER = Path(__file__).resolve().parent / "rates"
PAGE = Path(__file__).resolve().parent.parent / "docs" / "rates.md"
ALL = "all"
# Rows without a limit that the page has all the same; and rows that it has only where they fail.
_SHOWN = re.compile(
    r"^(?:slip|margin|pull): stated over true|by (?:first level|slip over 0\.3)$"
    r"|slip is known|error over that|called better than another"
)
_SPARED = re.compile("than the mean|true slip|beside it|each second|band holds")
_MARKS = re.compile(r"(<!-- rates: ([\w ]+) -->\n).*?(<!-- end -->\n)", re.DOTALL)


def table(of: dict[str, pd.DataFrame]) -> str:
    """Pooled rates in Markdown, a column for each subject, and the worlds beyond a limit."""
    rates: dict[str, dict[str, Any]] = {}
    for subject, rows in of.items():
        shown = rows.limit.notna() | rows.what.str.contains(_SHOWN)
        shown &= rows.fails | ~rows.what.str.contains(_SPARED)
        for row in rows[(rows.world == ALL) & shown].itertuples():
            rates.setdefault(row.what, {})[subject] = row
    heads = list(of) if len(of) > 1 else ["rate"]
    lines = [f"| | {' | '.join(heads)} | limit |", "| --- |" + " --- |" * (len(of) + 1)]
    for what, found in rates.items():
        cells = [_cell(found[subject]) if subject in found else "" for subject in of]
        limits = dict.fromkeys(row.limit for row in found.values() if not pd.isna(row.limit))
        limit = ", ".join(limits).replace("at least", "≥").replace("at most", "≤")
        lines.append(f"| {what} | {' | '.join(cells)} | {limit} |")
    beyond = _beyond(of)
    told = ["", f"Worlds beyond a limit: {beyond}."] if beyond else []
    return "\n".join([*lines, *told, ""])


def _cell(row: Any) -> str:
    """A rate with its interval and count; marked where all of the interval is beyond its limit."""
    value, low, high = (f"{float(number):.3g}" for number in (row.value, row.low, row.high))
    return f"{value} ({low}–{high}; {row.count}){' ✗' if row.fails else ''}"


def _beyond(of: dict[str, pd.DataFrame]) -> str:
    """Single worlds whose whole interval is beyond a limit, by what is judged."""
    worlds: dict[str, list[str]] = {}
    for rows in of.values():
        for row in rows[(rows.world != ALL) & rows.fails].itertuples():
            worlds.setdefault(row.what, []).append(row.world)
    return ". ".join(f"{what}: {'; '.join(names)}" for what, names in worlds.items())


def _made(marks: re.Match[str]) -> str:
    """A table between its marks, which name its subjects."""
    of = {subject: pd.read_csv(FOLDER / f"{subject}.csv") for subject in marks[2].split()}
    return marks[1] + table(of) + marks[3]


def main() -> None:
    """Make the tables of the page anew."""
    page = Path(sys.argv[1]) if len(sys.argv) > 1 else PAGE
    page.write_text(_MARKS.sub(_made, page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
