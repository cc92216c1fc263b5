# SPDX-License-Identifier: Apache-2.0
"""How often what is right: rates over worlds whose answer is known, by subject.

    python -m rates                         # all subjects; takes as long as --list says
    python -m rates soil slip --seeds 0:4 --jobs 2
    python -m rates field --worlds encoder --fresh

A subject has worlds, a trial that tries one world with one seed, and judges that count over trials. Trials
are lines of JSON in rates/results/SUBJECT.jsonl, appended one by one, so that an interrupted run goes on
where it was; `--fresh` begins anew, as after a change of the program. Rates of each world and of all are rows
of rates/results/SUBJECT.csv, from which the tables of docs/rates.md are made, too. Exit code 1: a rate
is beyond its limit.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from typing import Any

# One thread a job: numpy's own threads would compete with the other jobs.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pandas as pd
from tqdm import tqdm

from rates import cost_detours, faults, foreign, learn_worlds, tables
from rates import diagnosis as rates_diagnosis
from rates import drives as rates_drives
from rates import laws as rates_laws
from rates import pull as rates_pull
from rates.judges import Line, Subject
from rates.real_drives import in_short

FOLDER = Path(__file__).resolve().parent / "results"
ALL, TRIALS = "all", "trials"


def stored(path: Path) -> dict[tuple[str, int], Line]:
    """Trials of an earlier run; a last line cut short, and those that failed, are tried again."""
    found: dict[tuple[str, int], Line] = {}
    if not path.exists():
        return found
    for text in path.read_text(encoding="utf-8").splitlines():
        try:
            one = json.loads(text)
        except json.JSONDecodeError:
            continue
        if "failed" not in one:
            found[one["world"], one["seed"]] = one
    return found


def tried(subject: str, world: str, seed: int) -> Line:
    """One trial; an error is kept as text, so that the rest of a night's run is not lost."""
    start = time.process_time()
    try:
        found = subject_of(subject).trial(world, seed)
    except Exception as error:  # whatever it is, it is a finding about this world
        found = {"failed": f"{type(error).__name__}: {error}"}
    return {"world": world, "seed": seed, "seconds": time.process_time() - start} | found


def run(subject: Subject, tasks: Sequence[tuple[str, int]], store: Path, jobs: int) -> list[Line]:
    """Do the trials that are not stored, each stored as soon as it is done."""
    known = stored(store)
    missing = [task for task in tasks if task not in known]
    store.parent.mkdir(exist_ok=True)
    with store.open("a", encoding="utf-8") as file:
        file.write("\n" if store.stat().st_size else "")  # behind a line that was cut short
        for one in tqdm(
            _done(subject.name, missing, jobs), subject.name, len(missing), disable=None
        ):
            known[one["world"], one["seed"]] = one
            file.write(json.dumps(one) + "\n")
            file.flush()
    return [one for one in known.values() if one["world"] in subject.worlds]


def _done(subject: str, tasks: Sequence[tuple[str, int]], jobs: int) -> Iterator[Line]:
    if jobs == 1:
        yield from (tried(subject, *task) for task in tasks)
        return
    with ProcessPoolExecutor(jobs) as pool:
        for future in as_completed([pool.submit(tried, subject, *task) for task in tasks]):
            yield future.result()


# --- Rows


COLUMNS = ("subject", "world", "what", "value", "low", "high", "count", "limit", "fails")


def rates(subject: Subject, lines: Sequence[Line]) -> pd.DataFrame:
    """Rates of all worlds together and of each; how many trials there are, and failed, are rows too."""
    rows: list[tuple[Any, ...]] = []
    for world in (ALL, *subject.worlds):
        mine = [one for one in lines if world in (ALL, one["world"])]
        good = [one for one in mine if "failed" not in one]
        if good:
            rows.append((subject.name, world, TRIALS, *[len(good)] * 4, "", False))
        if failed := len(mine) - len(good):
            rows.append(
                (subject.name, world, "trials that failed", *[failed] * 4, "at most 0", True)
            )
        for judge in subject.judges:
            rate = judge.count(good) if good else None
            if rate is None:
                continue
            held = world == ALL or bool(re.search(judge.each, world))
            numbers = (f"{value:.4g}" for value in (rate.value, rate.low, rate.high))
            limit = judge.limit if held else ""
            fails = held and judge.fails(rate)
            rows.append((subject.name, world, judge.what, *numbers, rate.count, limit, fails))
    return pd.DataFrame(rows, columns=list(COLUMNS))


# --- The page

PAGE = FOLDER.parent.parent / "docs" / "rates.md"
# Rows, after their subject, that the page has without a limit; and those that it has only where they fail.
_SHOWN = re.compile(
    r"^(?:robots|slip): (?:(?:slip|margin): stated over true|.* by (?:second level|slip over 0\.3)$)"
    r"|^diagnosis: reported over|^laws: called better than another|by a factor of"
)
_SPARED = re.compile(
    "than the mean|true slip|beside it|each second|band holds|torque,|dummy|good run|^resistance"
)
_REAL = re.compile(r"(<!-- real drives -->\n).*?(<!-- end -->\n)", re.DOTALL)
_MARKS = re.compile(r"(<!-- rates: ([\w ]+) -->\n).*?(<!-- end -->\n)", re.DOTALL)


def page_table(of: dict[str, pd.DataFrame]) -> str:
    """Pooled rates in Markdown: a table of what several subjects have, lines of the rest.

    Below them how many seeds the worlds ran with, and which are beyond a limit.
    """
    rates: dict[str, dict[str, Any]] = {}
    for subject, rows in of.items():
        shown = rows.limit.notna() | (f"{subject}: " + rows.what).str.contains(_SHOWN)
        shown &= rows.fails | ~rows.what.str.contains(_SPARED)
        for row in rows[(rows.world == ALL) & shown].itertuples():
            rates.setdefault(row.what, {})[subject] = row
    table = [f"| | {' | '.join(of)} |", "| --- |" + " --- |" * len(of)]
    lines = []
    for what, found in rates.items():
        limits = dict.fromkeys(row.limit for row in found.values() if not pd.isna(row.limit))
        limit = ", ".join(limits).replace("at least ", "≥").replace("at most ", "≤")
        head = f"{what} ({limit})" if limit else what
        cells = {subject: _cell(row) for subject, row in found.items()}
        if len(found) > 1:
            table.append(f"| {head} | {' | '.join(cells.get(subject, '') for subject in of)} |")
        else:
            lines += [f"- {subject}, {head}: {cell}" for subject, cell in cells.items()]
    if len(of) == 1:
        lines = [line.replace(f"{next(iter(of))}, ", "", 1) for line in lines]
    trials = ", ".join(_trials(subject, rows) for subject, rows in of.items())
    beyond = _beyond(of)
    told = f"Seeds: {trials}." + (f" Beyond a limit: {beyond}." if beyond else "")
    parts = [*([table] if len(table) > 2 else []), lines, [told]]
    return "\n\n".join("\n".join(part) for part in parts if part) + "\n"


def _cell(row: Any) -> str:
    """A rate with its interval; marked where all of that is beyond its limit."""
    value, low, high = (f"{float(number):.3g}" for number in (row.value, row.low, row.high))
    return f"{value} ({low}–{high}){' ✗' if row.fails else ''}"


def _trials(subject: str, rows: pd.DataFrame) -> str:
    """How many seeds each world ran with, and how many worlds there are."""
    counts = rows[(rows.what == TRIALS) & (rows.world != ALL)].value.astype(int)
    fewest, most = counts.min(), counts.max()
    seeds = f"{most}" if fewest == most else f"{fewest} to {most}"
    return f"{subject} {seeds} of {len(counts)} worlds"


def _beyond(of: dict[str, pd.DataFrame]) -> str:
    """Single worlds whose whole interval is beyond a limit, by what is judged."""
    worlds: dict[str, list[str]] = {}
    for rows in of.values():
        for row in rows[(rows.world != ALL) & rows.fails].itertuples():
            worlds.setdefault(row.what, []).append(row.world)
    return ". ".join(f"{what}: {'; '.join(names)}" for what, names in worlds.items())


def _made(folder: Path, marks: re.Match[str]) -> str:
    """A table between its marks, which name its subjects."""
    of = {subject: pd.read_csv(folder / f"{subject}.csv") for subject in marks[2].split()}
    return marks[1] + page_table(of) + marks[3]


def write_page(page: Path = PAGE, folder: Path = FOLDER) -> None:
    """Make the tables of docs/rates.md anew out of the rows in a folder."""
    text = _MARKS.sub(partial(_made, folder), page.read_text(encoding="utf-8"))
    real = folder / "real_drives.csv"
    if real.exists():
        told = in_short(pd.read_csv(real, keep_default_na=False))
        text = _REAL.sub(lambda marks: marks[1] + told + marks[2], text)
    page.write_text(text, encoding="utf-8")


# --- The command


def subjects() -> dict[str, Subject]:
    """All subjects, by name."""
    modules = (
        rates_drives,
        foreign,
        faults,
        rates_diagnosis,
        learn_worlds,
        rates_pull,
        rates_laws,
        tables,
        cost_detours,
    )
    return {subject.name: subject for module in modules for subject in module.SUBJECTS}


def subject_of(name: str) -> Subject:
    """The subject of a name."""
    return subjects()[name]


def seeds(text: str) -> range:
    """Seeds from the first to before the end, as `0:4`; argparse tells a ValueError as bad usage."""
    first, end = text.split(":")
    return range(int(first), int(end))


def pattern(text: str) -> re.Pattern[str]:
    """A regular expression."""
    try:
        return re.compile(text)
    except re.error as error:
        raise argparse.ArgumentTypeError(f"{text!r} is no regular expression: {error}") from error


def main() -> int:
    """Run subjects and write their rates."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("subjects", nargs="*", help="all without any")
    parser.add_argument(
        "--worlds", type=pattern, default="", help="regular expression; all without it"
    )
    parser.add_argument(
        "--seeds", type=seeds, help="first and end, as 0:4; without it each subject's own"
    )
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--fresh", action="store_true", help="forget the trials of earlier runs")
    parser.add_argument(
        "--list", action="store_true", help="list subjects, worlds, minutes, and stop"
    )
    parser.add_argument("--folder", type=Path, default=FOLDER, help="of trials and rates")
    given = parser.parse_args()
    known = subjects()
    wrong = [name for name in given.subjects if name not in known]
    if wrong:
        parser.error(f"no subject {', '.join(wrong)}: there is {', '.join(known)}")
    failing = []
    for name in given.subjects or known:
        subject = known[name]
        chosen = given.seeds or range(subject.seeds)
        worlds = [world for world in subject.worlds if given.worlds.search(world)]
        minutes = len(worlds) * len(chosen) * subject.seconds / 60.0 / given.jobs
        told = f"{name}: {len(worlds)} worlds, {len(chosen)} seeds, about {minutes:.0f} min"
        print(told, flush=True)
        if given.list:
            continue
        store = given.folder / f"{name}.jsonl"
        if given.fresh:
            store.unlink(missing_ok=True)
        tasks = [(world, seed) for seed in chosen for world in worlds]
        table = rates(subject, run(subject, tasks, store, given.jobs))
        table.to_csv(given.folder / f"{name}.csv", index=False)
        for row in table[(table.world == ALL) | table.fails].itertuples():
            mark = "  FAILS" if row.fails else ""
            print(
                f"  {row.world}: {row.what} {row.value} ({row.low} to {row.high}; {row.count}){mark}"
            )
        failing += [f"{name}: {row.world}: {row.what}" for row in table[table.fails].itertuples()]
    if given.folder == FOLDER and not given.list:
        write_page()
    print(f"{len(failing)} rates beyond their limits", *failing, sep="\n  ")
    return int(bool(failing))


if __name__ == "__main__":
    sys.exit(main())
