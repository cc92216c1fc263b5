# SPDX-License-Identifier: Apache-2.0
"""Made tables of many structures, and the rows that a spreadsheet computes below them."""

from __future__ import annotations

import numpy as np

NAMES = ("none", "numbers", "letters", "codes", "words")
GRIDS = (
    "sweep",
    "grid",
    "repeats",
    "one load",
    "measured loads",
    "proportional",
    "centre",
    "again",
)
HEADER = (
    "run",
    "load [N]",
    "diameter [mm]",
    "width [mm]",
    "slip [%]",
    "sinkage [mm]",
    "resistance [N]",
    "drawbar_pull [N]",
)
WORDS = (
    "dry",
    "wet",
    "loose",
    "dense",
    "mixed",
    "fine",
    "coarse",
    "raked",
    "tilled",
    "old",
    "new",
    "deep",
)
# Mean and standard deviation as people of 15 languages write them.
LABELS = {
    "Spanish": ("Promedio", "Desv. est."), "Portuguese": ("Média", "Desvio padrão"),
    "Italian": ("Media", "Dev. st."), "Polish": ("Średnia", "Odch. std."),
    "Czech": ("Průměr", "Směr. odch."), "Finnish": ("Keskiarvo", "Keskihajonta"),
    "Swedish": ("Medel", "Standardavvikelse"), "Dutch": ("Gemiddelde", "Standaardafwijking"),
    "Turkish": ("Ortalama", "Std. sapma"), "Hungarian": ("Átlag", "Szórás"),
    "Russian": ("Среднее", "Стд. откл."), "Greek": ("Μέσος όρος", "Τυπική απόκλιση"),
    "Japanese": ("平均", "標準偏差"), "Chinese": ("均值", "标准差"), "Korean": ("평균", "표준편차"),
}  # fmt: skip


def _settings(rng: np.random.Generator, grid: str) -> np.ndarray:
    """Load (N) and slip (%) of each row."""
    loads = rng.choice([20.0, 30.0, 45.0, 60.0, 80.0, 100.0], rng.integers(2, 5), replace=False)
    slips = rng.choice([0.0, 5.0, 10.0, 20.0, 30.0, 40.0], rng.integers(1, 4), replace=False)
    if grid in ("sweep", "proportional"):
        step, count = rng.choice([5.0, 10.0, 12.5]), rng.integers(2, 9)
        table = np.column_stack([step * np.arange(1, count + 1), np.full(count, slips[0])])
        return rng.permutation(table) if rng.random() < 0.3 else table
    if grid == "one load":
        return np.tile([loads[0], slips[0]], (int(rng.integers(2, 10)), 1))
    table = np.array([[w, s] for w in np.sort(loads) for s in np.sort(slips)])
    if grid == "repeats":
        table = table.repeat(rng.integers(2, 5), axis=0)
    if grid == "measured loads":
        table[:, 0] += rng.normal(0.0, 0.8, len(table))
    if grid == "centre":
        table = np.vstack([table, np.tile(table.mean(axis=0), (rng.integers(1, 4), 1))])
    if grid == "again":  # the first settings are measured once more in the end
        table = np.vstack([table, table[: rng.integers(1, 3)]])
    return table


def measured(seed: int) -> tuple[list[list[str]], str, str]:
    """The measured rows of a made table, its grid and its kind of names."""
    rng = np.random.default_rng(seed)
    grid, kind = GRIDS[seed % len(GRIDS)], NAMES[seed // len(GRIDS) % len(NAMES)]
    table = _settings(rng, grid)
    load, slip = table.T
    noise = 0.0 if grid == "proportional" else rng.choice([0.0, 0.01, 0.05, 0.1])
    bent = 1.0 if grid == "proportional" else rng.choice([1.0, 0.6])
    z = 0.12 * load**bent * (1.0 + (grid != "proportional") * slip / 60.0)
    answers = np.column_stack([z, 0.2 * load**bent, 0.3 * load * (1 - np.exp(-slip / 10.0))])
    answers *= 1.0 + noise * rng.standard_normal(answers.shape)
    answers = np.abs(answers)[:, : rng.integers(1, 4)]
    digits = rng.integers(0, 4)
    cells = [
        [f"{w:.4g}", "275", "100", f"{s:.4g}", *(f"{a:.{digits}f}" for a in row)]
        for w, s, row in zip(load, slip, answers, strict=True)
    ]
    names = {
        "numbers": [str(i + 1) for i in range(len(cells))],
        "letters": [chr(97 + i // 2 % 26) for i in range(len(cells))],
        "codes": [f"R{i // 3 + 1}-{i % 3}" for i in range(len(cells))],
        "words": [WORDS[i // 2 % len(WORDS)] for i in range(len(cells))],
    }
    if kind != "none":
        cells = [[name, *row] for name, row in zip(names[kind], cells, strict=True)]
    return cells, grid, kind


def text(cells: list[list[str]], named: bool) -> str:
    """The table as CSV. named: whether its first column is the run."""
    width = max(len(row) for row in cells)
    header = HEADER[:width] if named else HEADER[1 : 1 + width]
    return "\n".join(",".join(row) for row in [list(header), *cells]) + "\n"
