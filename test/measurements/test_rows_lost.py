# SPDX-License-Identifier: Apache-2.0
"""No row of 200 made tables is lost in silence: statistics, repeated headers, comments, units, gaps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from smallwheel_ros.measurements.from_file import read_measurements

STATISTICS = {
    "mean": np.mean, "Mittelwert": np.mean, "Ø": np.mean, "avg": np.mean, "MW": np.mean,
    "sd": lambda x: np.std(x, ddof=1), "Std.abw.": lambda x: np.std(x, ddof=1), "CV %": None,
    "max": np.max, "min": np.min,
}  # fmt: skip
# Names of runs: with digits, letters alone, words, one that is numbered above 9, and words of places.
NAMES = (
    lambda i: f"R{i + 1}",
    lambda i: str(i + 1),
    lambda i: chr(65 + i),
    lambda i: f"{'abcdefghijklmnop'[i]}{'xyz'[i % 3]}",
    lambda i: (
        ["dry", "wet", "loose", "dense", "mixed", "fine", "coarse", "old", "new", "deep"][i % 10]
        + ("" if i < 10 else str(i))
    ),
    lambda i: f"2024-07-{i + 1:02d} bin",
)


def made(seed: int) -> tuple[str, list[int]]:
    """A table as text, and the line of each measurement in it."""
    rng = np.random.default_rng(seed)
    name = NAMES[rng.integers(len(NAMES))]
    runs, repeats = int(rng.integers(3, 15)), int(rng.integers(1, 5))
    german = bool(rng.integers(2))
    cell = ";" if german else ","
    head = (
        "Versuch;Radlast [N];Durchmesser [mm];Breite [mm];Schlupf [%];Einsinkung [mm]"
        if german
        else "run,load [N],diameter [mm],width [mm],slip [%],sinkage [mm]"
    )
    lines, measured = [head], []
    if rng.random() < 0.2:
        lines = [cell.join(part.split(" [")[0] for part in head.split(cell))]
        lines.append(cell.join(("", "N", "mm", "mm", "%", "mm")))
    labels = [*STATISTICS]
    own = [str(label) for label in rng.choice(labels, rng.integers(1, 4), replace=False)]
    after = rng.choice(["each", "end", "never"])

    def row(name: str, values: np.ndarray) -> str:
        digits = (1, 0, 0, 0, 2)
        cells = [f"{v:.{d}f}" for v, d in zip(values, digits, strict=True)]
        text = cell.join((name, *cells))
        return text.replace(".", ",") if german else text

    def statistics(block: list[np.ndarray]) -> None:
        for label in own:
            of = STATISTICS[label]
            columns = np.array(block).T
            if of is not None:
                lines.append(row(label, np.array([of(c) if len(c) > 1 else c[0] for c in columns])))

    everything: list[np.ndarray] = []
    for i in range(runs):
        block = []
        load, slip = (
            float(rng.choice([20.0, 35.0, 60.0, 90.0])),
            float(rng.choice([5.0, 20.0, 40.0])),
        )
        for _ in range(repeats):
            sinkage = 0.3 * load**0.8 * np.exp(rng.normal(0.0, 0.05))
            block.append(np.array([load + rng.normal(0.0, 0.3), 200.0, 100.0, slip, sinkage]))
            lines.append(row(name(i), block[-1]))
            measured.append(len(lines))
        everything += block
        if after == "each":
            statistics(block)
        if rng.random() < 0.15:
            lines.append("")
        if rng.random() < 0.1:
            lines.append("# the bin was raked")
        if rng.random() < 0.1:
            lines.append(head)
        if rng.random() < 0.05:
            lines.append(cell.join(("break, rain", "", "", "", "", "")) if german else "break,,,,,")
    if after == "end":
        statistics(everything)
    return "\n".join(lines) + "\n", measured


@pytest.mark.parametrize("first", range(0, 200, 50))
def test_no_row_of_200_made_tables_is_lost_in_silence(tmp_path: Path, first: int) -> None:
    lost, kept, silent = [], [], []
    for seed in range(first, first + 50):
        text, measured = made(seed)
        path = tmp_path / "a.csv"
        path.write_text(text, encoding="utf-8")
        data = read_measurements(path)
        lines = {*data.line.tolist()}
        lost += [(seed, line) for line in measured if line not in lines]
        kept += [(seed, line) for line in lines if line not in measured]
        rows = len(measured), text.count("\n") - 1
        # Empty lines, comments and units are no rows of a table.
        odd = sum(not line.strip(";,") or line.startswith("#") for line in text.split("\n")[:-1])
        odd += any("units in" in words for words in data.understood)
        said = any(words.startswith(f"{len(lines)} of ") for words in data.understood[:1])
        silent += [(seed, rows)] if len(lines) < rows[1] - odd and not said else []
    assert lost == []
    assert silent == []
    assert kept == []
