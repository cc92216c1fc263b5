# SPDX-License-Identifier: Apache-2.0
"""Tables of docs/rates.md out of the rows in benchmarks/rates/: pooled rates, and worlds beyond their limits.

python benchmarks/rates_page.py [docs/rates.md]
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pandas as pd

FOLDER = Path(__file__).resolve().parent / "rates"
PAGE = Path(__file__).resolve().parent.parent / "docs" / "rates.md"
ALL = "all"
# Rows without a limit that the page has all the same.
_SHOWN = re.compile(
    r"^(?:slip|margin|pull): stated over true|in time by (?:slip over 0\.3|true)"
    r"|false in 500 m by (?:slip over 0\.3|true)|slip is known|metres until|way until|too steep"
    r"|error over that|said to be better|named where"
)
_MARKS = r"(<!-- rates: {subject} -->\n).*?(<!-- end -->\n)"


def table(rows: pd.DataFrame) -> str:
    """Pooled rates of one subject in Markdown, and the worlds whose rates are beyond their limits."""
    pooled = rows[(rows.world == ALL) & (rows.limit.notna() | rows.what.str.contains(_SHOWN))]
    lines = ["| | rate (95 %) | of | limit |", "| --- | --- | --- | --- |"]
    for row in pooled.itertuples():
        limit = (
            "" if pd.isna(row.limit) else row.limit.replace("at least", "≥").replace("at most", "≤")
        )
        value = f"{float(row.value):.3g} ({float(row.low):.3g}–{float(row.high):.3g})"
        lines.append(f"| {row.what} | {value} | {row.count} | {limit}{' ✗' if row.fails else ''} |")
    failing = rows[(rows.world != ALL) & rows.fails]
    by_what = [
        f"{what}: {'; '.join(group.world)}" for what, group in failing.groupby("what", sort=False)
    ]
    told = "Worlds beyond a limit: " + (". ".join(by_what) or "none") + ".\n"
    return "\n".join([*lines, "", told])


def main() -> None:
    """Make the tables of the page anew."""
    page = Path(sys.argv[1]) if len(sys.argv) > 1 else PAGE
    text = page.read_text(encoding="utf-8")
    for path in sorted(FOLDER.glob("*.csv")):
        marks = re.compile(_MARKS.format(subject=path.stem), re.DOTALL)
        if marks.search(text):
            made = table(pd.read_csv(path))
            text = marks.sub(lambda found, made=made: found[1] + made + found[2], text)
    page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
