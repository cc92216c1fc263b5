# SPDX-License-Identifier: Apache-2.0
"""Errors of laws on measured tables: as text after each table, and of all tables as page, JSON and rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from smallwheel_ros.compare.data_sets import Benchmark
from smallwheel_ros.compare.fitted_laws import INTEGRAL, OURS
from smallwheel_ros.compare.law_table import Errors, LawTable
from smallwheel_ros.measurements.columns import CHANNELS
from smallwheel_ros.measurements.display import listed, sentence, words
from smallwheel_ros.views.blocks import (
    Block,
    Callout,
    Column,
    Details,
    Row,
    Section,
    Table,
    Text,
    of_channel,
)
from smallwheel_ros.views.page import Page

_MOST_PARTS = 12  # columns of the errors by part
_NAMED = 6  # parts that are named where ours loses on them
_READ = (
    "Error: root mean square of what was left out, by laws that were fitted to the rest. Minus ours: how "
    "much larger it is than ours, mean over the parts, with its standard error (s.e.).",
    "Ours wins or loses where that difference is more than chance gives in 5 of 100 tables (Student's t, "
    "paired by part); with fewer than three parts it cannot be told.",
    "All laws of a table are judged on the same points, those that every one predicts.",
)


def page(found: Benchmark, pictures: bool = True) -> Page:
    """Make the page of a comparison of laws: a summary, where ours has larger errors, and every table.

    Parameters
    ----------
    found
        Errors of all laws on all tables.
    pictures
        Not used: the page has tables only.
    """
    files = list(dict.fromkeys(table.file for table in found.tasks))
    left = [sentence(f"not used: {file}: {why}") for file, why in found.left_out.items()]
    return Page(
        "A table of laws",
        [
            Section("In short", [Callout(found.headline(), _READ), _summary(found)]),
            Section("Where ours loses", _losses(found)),
            *(Section(str(file), _of_file(found, file)) for file in files),
            Section("Not used", [Text(items=left)] if left else []),
        ],
        f"Files: {listed([str(file) for file in files])}",
    )


def text(found: Benchmark) -> str:
    """The text that the command prints: each table, then the ending."""
    return "\n\n".join([*map(table_text, found.tasks), ending(found)])


def table_text(table: LawTable) -> str:
    """The errors of all laws on one measured table, as the command prints them when that table is done."""
    blocks = [b for channel in table.judged for b in _of_channel(table, channel)]
    lines = [line for b in blocks if not isinstance(b, Details) for line in b.lines()]
    return "\n".join([f"{table.file} ({table.licence})", *lines, _effects(table)])


def ending(found: Benchmark) -> str:
    """The text below the tables: the summary, where our law loses, and which files were not used."""
    made = page(found)
    shown = {
        s.title: s.lines() for s in made.sections if s.title in ("Where ours loses", "Not used")
    }
    parts = [_summary(found).lines(), *([title, *(f"  {line}" for line in lines)]
             for title, lines in shown.items() if lines)]  # fmt: skip
    return "\n\n".join([*("\n".join(lines) for lines in parts), f"{found.headline()}."])


def document(found: Benchmark) -> dict[str, Any]:
    """The document that `smallwheel compare FOLDER --json` writes."""
    return {
        "folder": str(found.folder), "ours": OURS, "wins": len(found.judged("wins")),
        "losses": len(found.judged("loses")), "cannot_tell": len(found.judged("cannot tell")),
        "tasks": [
            {
                "file": str(table.file), "licence": table.licence, "contact": table.task.contact,
                "soil": table.task.soil, "left_out": table.task.what,
                "rows": len(table.task.measurements), "points": table.judged, "fits": table.fits,
                "laws": [_law(law) for law in table.laws], "lost": _lost(table, "sinkage"),
                "lost_forces": {n: _lost(table, n) for n in table.judged if n != "sinkage"},
            }
            for table in found.tasks
        ],
        "not_used": found.left_out,
    }  # fmt: skip


def rows(found: Benchmark) -> list[dict[str, Any]]:
    """One row for each table, law, channel and part; errors in SI."""
    return [
        {"file": str(table.file), "contact": table.task.contact, "soil": table.task.soil, "law": law.law,
         "channel": law.channel, "left_out": table.task.what, "part": part,
         **{f"{name}_rmse": error if name == law.channel else None for name in CHANNELS}}
        for table in found.tasks
        for law in table.laws
        for part, error in law.by_part.items()
    ]  # fmt: skip


def _law(law: Errors) -> dict[str, Any]:
    return {
        "law": law.law, "channel": law.channel, f"{law.channel}_rmse": law.rmse, "by_part": law.by_part,
        "effects": law.effects, "refused": law.refused, "at_bound": law.at_bound,
        "minus_ours": None if law.against is None else asdict(law.against), "ours": law.verdict,
    }  # fmt: skip


def _of_file(found: Benchmark, file: Path) -> list[Block]:
    tables = [table for table in found.tasks if table.file == file]
    blocks: list[Block] = [Text(f"Licence: {tables[0].licence}")]
    for table in tables:
        blocks += [b for channel in table.judged for b in _of_channel(table, channel)]
        blocks.append(Text(_effects(table)))
    return blocks


def _of_channel(table: LawTable, channel: str) -> list[Block]:
    """The laws on one channel: the table, remarks on it, and the errors of each part."""
    task, laws = table.task, table.of(channel)
    against = [None if law.against is None else asdict(law.against) for law in laws]
    listed_laws = [
        {"channel": channel, "law": law.law, "rmse": law.rmse, "ours": law.verdict or "", **law.by_part}
        | {"mean": more and more["mean"], "std": more and more["std"]}
        for law, more in zip(laws, against, strict=True)
    ]  # fmt: skip
    columns = [
        Column("law", "law"), of_channel("error", "rmse"), of_channel("minus ours", "mean"),
        of_channel("± s.e.", "std"), Column("ours", "ours"),
    ]  # fmt: skip
    shown = task.names[:_MOST_PARTS]
    more = f"; {len(task.names) - len(shown)} more" if len(shown) < len(task.names) else ""
    title = (f"{task.contact}, {task.soil}: {words(channel)}, {table.judged[channel]} points; "
             f"{_left_out(table)}")  # fmt: skip
    parts = Table([Column("law", "law"), *(of_channel(name, name) for name in shown)], listed_laws,
                  f"Error on each {task.what}{more}", _ours)  # fmt: skip
    return [
        Table(columns, listed_laws, title, _ours),
        Text(items=_said(table, channel)),
        Details(f"Each {task.what}", [parts]),
    ]


def _ours(row: Row) -> bool:
    return bool(row["law"] == OURS)


def _left_out(table: LawTable) -> str:
    what, many = table.task.what, len(table.task.names)
    if table.fits < many:
        return f"{many} {what}s left out in {table.fits} folds"
    return f"each of {many} {what}s left out"


def _said(table: LawTable, channel: str) -> list[str]:
    """Sentences below a table: least error, parts where ours loses, refused points, parameters at a bound."""
    laws, lost = table.of(channel), _lost(table, channel)
    judged = [law for law in laws if law.rmse == law.rmse]
    said = [f"Least error: {min(judged, key=lambda law: law.rmse).law}."] if judged else []
    if lost:
        to = []
        for name in dict.fromkeys(lost.values()):
            where = [part for part, one in lost.items() if one == name]
            to.append(f"{name} ({', '.join(where) if len(lost) <= _NAMED else len(where)})")
        parts = sum(error is not None for error in laws[0].by_part.values())
        said.append(
            f"On {len(lost)} of {parts} parts another law has less error than ours: {'; '.join(to)}."
        )
    if all(law.law != OURS for law in laws):
        said.append("Ours could not be fitted to any fold: no law is compared with it.")
    said += [f"{law.law} does not predict {law.refused} points, on which no law is judged."
             for law in laws if law.refused]  # fmt: skip
    for law in laws:
        if bounds := [f"{name} in {times}" for name, times in law.at_bound.items()]:
            said.append(f"{law.law}, of {table.fits} fits at a bound: {', '.join(bounds)}.")
    return said


def _lost(table: LawTable, channel: str) -> dict[str, str]:
    """By part, the other law that has the least error there; parts where ours has the least are left out."""
    found = {}
    for part in table.task.names:
        known = {law.law: e for law in table.of(channel) if (e := law.by_part[part]) is not None}
        if known and (first := min(known, key=lambda law: known[law])) not in (INTEGRAL, OURS):
            found[part] = first
    return found


def _effects(table: LawTable) -> str:
    named = dict.fromkeys(e for law in table.laws for found in law.effects.values() for e in found)
    return f"Effects found: {listed(list(named))}." if named else "No effect was found."


def _summary(found: Benchmark) -> Table:
    """A table of how often ours wins, cannot be told apart, and loses, by law and channel."""
    laws = [law for table in found.tasks for law in table.others]
    judged = Counter((law.law, law.channel, law.verdict) for law in laws)

    def of(channel: str) -> Column:
        def counts(row: Row) -> str:
            found_words = [judged[row["law"], channel, w] for w in ("wins", "cannot tell", "loses")]
            return " / ".join(map(str, found_words)) if any(found_words) else "-"

        return Column(words(channel), counts, right=True)

    names: Sequence[Row] = [{"law": name} for name in dict.fromkeys(law.law for law in laws)]
    return Table([Column("law", "law"), *map(of, CHANNELS)], names,
                 "How often ours wins / cannot be told / loses, against")  # fmt: skip


def _losses(found: Benchmark) -> list[Block]:
    losses = [
        {"rows": f"{table.file.name}, {table.task.contact}, {table.task.soil}", "law": law.law,
         "left_out": _left_out(table), "channel": law.channel, "rmse": law.rmse,
         "ours": next(one.rmse for one in table.of(law.channel) if one.law == OURS)}
        for table, law in found.judged("loses")
    ]  # fmt: skip
    columns = [
        Column("rows", "rows"), Column("left out", "left_out"), Column("channel", "channel", words),
        Column("to", "law"), of_channel("its error", "rmse"), of_channel("ours", "ours"),
    ]  # fmt: skip
    return [Table(columns, losses)] if losses else [Text("On no set of rows by more than chance.")]
