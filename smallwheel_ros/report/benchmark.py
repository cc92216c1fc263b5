# SPDX-License-Identifier: Apache-2.0
"""A table of laws on data: for the terminal as each table is done, as a page, as JSON and as rows."""

from __future__ import annotations

from dataclasses import asdict
from math import floor, log10
from pathlib import Path
from typing import Any

from smallwheel_ros.benchmark.benchmark import Benchmark
from smallwheel_ros.benchmark.laws import INTEGRAL, OURS
from smallwheel_ros.benchmark.table import Difference, Errors, LawTable
from smallwheel_ros.measurements.columns import CHANNEL_UNITS, CHANNELS
from smallwheel_ros.measurements.display import display, listed, number, sentence, words
from smallwheel_ros.report.blocks import Block, Callout, Details, Section, Table, Text
from smallwheel_ros.report.page import Page

_HEADER = ("law", "error", "minus ours", "± s.e.", "ours")
_MOST_PARTS = 12  # columns of the errors by part
_NAMED = 6  # parts that are named where ours loses on them
_READ = (
    "Error: root mean square of what was left out, by laws that were fitted to the rest. Minus ours: how "
    "much larger it is than ours, mean over the parts, with its standard error (s.e.).",
    "Ours wins or loses where that difference is more than chance gives in 5 of 100 tables (Student's t, "
    "paired by part); with fewer than three parts it cannot be told.",
    "All laws of a table are judged on the same points, those that every one predicts.",
)


def benchmark_page(result: Benchmark) -> Page:
    """The whole answer, the losses first."""
    files = dict.fromkeys(table.file for table in result.tasks)
    left = _not_used(result)
    return Page(
        "A table of laws",
        [
            Section("In short", [Callout(result.headline(), _READ), _summary(result)]),
            Section("Where ours loses", _losses(result)),
            *(Section(str(file), _of_file(result, file)) for file in files),
            Section("Not used", [Text(items=left)] if left else []),
        ],
        f"Files: {listed([str(file) for file in files])}",
    )


def benchmark_text(result: Benchmark) -> str:
    """As `smallwheel benchmark` prints it."""
    return "\n\n".join([*(table_text(table) for table in result.tasks), ending(result)])


def ending(result: Benchmark) -> str:
    """The text below the tables: where ours loses, what was not used, and the headline."""
    losses = [line for block in _losses(result) for line in block.lines()]
    parts = [
        _summary(result).lines(),
        ["Where ours loses", *(f"  {line}" for line in losses)],
        _not_used(result),
    ]
    return "\n\n".join([*("\n".join(lines) for lines in parts if lines), f"{result.headline()}."])


def table_text(table: LawTable) -> str:
    """One set of rows: its file, a table for each channel, and what was found."""
    blocks = [block for channel in table.judged for block in _of_channel(table, channel)]
    lines = [line for b in blocks if not isinstance(b, Details) for line in b.lines()]
    return "\n".join([f"{table.file} ({table.licence})", *lines, _effects(table)])


def benchmark_document(result: Benchmark) -> dict[str, Any]:
    """As `smallwheel benchmark --json` writes it."""
    return {
        "folder": str(result.folder),
        "ours": OURS,
        "wins": len(result.judged("wins")),
        "losses": len(result.judged("loses")),
        "cannot_tell": len(result.judged("cannot tell")),
        "tasks": [
            {
                "file": str(table.file),
                "licence": table.licence,
                "contact": table.task.contact,
                "soil": table.task.soil,
                "left_out": table.task.what,
                "rows": len(table.task.measurements),
                "points": table.judged,
                "fits": table.fits,
                "laws": [_law(law) for law in table.laws],
                "lost": _lost(table, "sinkage"),
                "lost_forces": {n: _lost(table, n) for n in table.judged if n != "sinkage"},
            }
            for table in result.tasks
        ],
        "not_used": result.left_out,
    }


def _law(law: Errors) -> dict[str, Any]:
    return {
        "law": law.law,
        "channel": law.channel,
        f"{law.channel}_rmse": law.rmse,
        "by_part": law.by_part,
        "effects": law.effects,
        "refused": law.refused,
        "at_bound": law.at_bound,
        "minus_ours": None if law.against is None else asdict(law.against),
        "ours": law.verdict,
    }


def benchmark_rows(result: Benchmark) -> list[dict[str, Any]]:
    """One row for each table, law, channel and part; errors in SI."""
    return [
        {
            "file": str(table.file), "contact": table.task.contact, "soil": table.task.soil,
            "law": law.law, "channel": law.channel, "left_out": table.task.what, "part": part,
            **{f"{name}_rmse": error if name == law.channel else None for name in CHANNELS},
        }
        for table in result.tasks
        for law in table.laws
        for part, error in law.by_part.items()
    ]  # fmt: skip


def _of_file(result: Benchmark, file: Path) -> list[Block]:
    tables = [table for table in result.tasks if table.file == file]
    found: list[Block] = [Text(f"Licence: {tables[0].licence}")]
    for table in tables:
        for channel in table.judged:
            found += _of_channel(table, channel)
        found.append(Text(_effects(table)))
    return found


def _of_channel(table: LawTable, channel: str) -> list[Block]:
    """The laws on one channel: the table, what is to be said of it, and the errors of each part."""
    task, shown, laws = table.task, display(channel, CHANNEL_UNITS[channel]), table.of(channel)
    title = (
        f"{task.contact}, {task.soil}: {words(channel)} [{shown.unit}], {table.judged[channel]} points; "
        f"{_left_out(table)}"
    )
    strong = [i for i, law in enumerate(laws) if law.law == OURS]
    least = min((law.rmse for law in laws if law.rmse > 0), default=1.0)
    digits = max(0, 2 - floor(log10(shown.scale * least)))  # three of the least error
    rows = [
        [
            law.law,
            _shown(law.rmse, shown.scale),
            *_against(law.against, shown.scale, digits),
            law.verdict or "",
        ]
        for law in laws
    ]
    by_part = [
        [law.law, *(_shown(e, shown.scale) for e in list(law.by_part.values())[:_MOST_PARTS])]
        for law in laws
    ]
    header = ["law", *task.names[:_MOST_PARTS]]
    more = len(task.names) - _MOST_PARTS
    caption = f"Error on each {task.what} [{shown.unit}]" + (f"; {more} more" if more > 0 else "")
    parts = Table(header, by_part, caption, numbers=range(1, len(header)), strong=strong)
    return [
        Table(_HEADER, rows, title, numbers=(1, 2, 3), strong=strong),
        Text(items=_said(table, channel)),
        Details(f"Each {task.what}", [parts]),
    ]


def _shown(value: float | None, scale: float) -> str:
    return "-" if value is None else number(scale * value)


def _against(against: Difference | None, scale: float, digits: int) -> list[str]:
    if against is None:
        return ["", ""]
    found = (against.mean, against.std)
    return ["-" if v is None else f"{round(scale * v, digits) + 0.0:.{digits}f}" for v in found]


def _left_out(table: LawTable) -> str:
    what, count = table.task.what, len(table.task.names)
    if table.fits < count:
        return f"{count} {what}s left out in {table.fits} folds"
    return f"each of {count} {what}s left out"


def _said(table: LawTable, channel: str) -> list[str]:
    """Sentences below a table: the least error, parts that ours loses, what was refused and at a bound."""
    laws, lost = table.of(channel), _lost(table, channel)
    judged = [law for law in laws if law.rmse == law.rmse]
    found = []
    if judged:
        found.append(f"Least error: {min(judged, key=lambda law: law.rmse).law}.")
    if lost:
        by_law = {law: [part for part, one in lost.items() if one == law] for law in lost.values()}
        to = [
            f"{law} ({', '.join(where) if len(lost) <= _NAMED else len(where)})"
            for law, where in by_law.items()
        ]
        parts = sum(error is not None for error in laws[0].by_part.values())
        count = f"{len(lost)} of {parts}"
        found.append(f"On {count} parts another law has less error than ours: {'; '.join(to)}.")
    if all(law.law != OURS for law in laws):
        found.append("Ours could not be fitted to any fold: no law is compared with it.")
    for law in laws:
        if law.refused:
            found.append(
                f"{law.law} does not predict {law.refused} points, on which no law is judged."
            )
    for law in laws:
        if law.at_bound:
            bounds = [f"{name} in {count}" for name, count in law.at_bound.items()]
            found.append(f"{law.law}, of {table.fits} fits at a bound: {', '.join(bounds)}.")
    return found


def _lost(table: LawTable, channel: str) -> dict[str, str]:
    """By part, the law of others that has the least error there."""
    found = {}
    for part in table.task.names:
        known = {law.law: e for law in table.of(channel) if (e := law.by_part[part]) is not None}
        if known and (first := min(known, key=lambda law: known[law])) not in (INTEGRAL, OURS):
            found[part] = first
    return found


def _effects(table: LawTable) -> str:
    effects = dict.fromkeys(
        e for law in table.laws for found in law.effects.values() for e in found
    )
    return f"Effects found: {listed(list(effects))}." if effects else "No effect was found."


def _summary(result: Benchmark) -> Table:
    """By law and channel, how often ours wins, cannot be told, and loses."""
    laws = [law for table in result.tasks for law in table.others]
    channels = [name for name in CHANNELS if any(law.channel == name for law in laws)]
    rows = []
    for name in dict.fromkeys(law.law for law in laws):
        words_ = [
            [law.verdict for law in laws if (law.law, law.channel) == (name, c)] for c in channels
        ]
        counts = [
            [found.count(word) for word in ("wins", "cannot tell", "loses")] for found in words_
        ]
        rows.append(
            [name, *(" / ".join(map(str, count)) if any(count) else "-" for count in counts)]
        )
    caption = "How often ours wins / cannot be told / loses, against"
    return Table(("law", *map(words, channels)), rows, caption, numbers=range(1, len(channels) + 1))


def _losses(result: Benchmark) -> list[Block]:
    losses = result.judged("loses")
    if not losses:
        return [Text("On no set of rows by more than chance.")]
    rows = []
    for table, law in losses:
        shown = display(law.channel, CHANNEL_UNITS[law.channel])
        ours = next(one for one in table.of(law.channel) if one.law == OURS)
        where = f"{table.file.name}, {table.task.contact}, {table.task.soil}"
        channel = f"{words(law.channel)} [{shown.unit}]"
        errors = [_shown(e.rmse, shown.scale) for e in (law, ours)]
        rows.append([where, _left_out(table), channel, law.law, *errors])
    return [Table(("rows", "left out", "channel", "to", "its error", "ours"), rows, numbers=(4, 5))]


def _not_used(result: Benchmark) -> list[str]:
    return [sentence(f"not used: {file}: {why}") for file, why in result.left_out.items()]
