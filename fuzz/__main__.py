# SPDX-License-Identifier: Apache-2.0
"""Fuzz every way in: `python -m fuzz [--inputs N] [--minutes M] [TARGET ...]`.

Inputs are mutations of valid ones, made and shrunk by hypothesis; those that failed are kept in
.hypothesis/ and tried first. With the package `coverage` the lines reached are counted, of one input
in ten: it takes more than half of the time.
"""

from __future__ import annotations

import argparse
import re
import resource
import shutil
import sys
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from hypothesis.database import DirectoryBasedExampleDatabase

from fuzz.recorded import RECORDED
from fuzz.target import NUMBERS, Target, is_good, scratch
from fuzz.target import ROOT as _ROOT
from fuzz.written import WRITTEN

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_COUNTED = 10  # of so many inputs the lines are counted of one
_PLACES = 1 << 16
_LONGEST = 10.0  # s that an input may take
_MOST_MEMORY = 500 << 20  # bytes that an input may ask for, over what the program has by then


def targets() -> dict[str, type[Target]]:
    """Every target by its name."""
    return {kind.name: kind for kind in (*WRITTEN, *RECORDED)}


def mutations(target: Target) -> st.SearchStrategy[bytes]:
    """Valid inputs with other numbers in them, or with pieces replaced, taken out, doubled or put in."""
    # Not floats: hypothesis likes 0 and 1, and most edits would be at the beginning or the end.
    places, few = st.integers(0, _PLACES).map(lambda i: i / _PLACES), {"max_size": 4}
    number: st.SearchStrategy[bytes | float] = st.one_of(
        st.sampled_from(NUMBERS),
        st.floats(-10.0, 1e3).map(lambda x: b"%.4g" % x),
        st.floats(0.5, 2.0),  # times the number that is there
    )
    piece = st.one_of(st.sampled_from(list(target.words)), st.binary(max_size=6))
    how = st.sampled_from(("replace", "double", "cover"))
    edits = st.tuples(places, st.integers(0, 40), piece, how)
    seeds = st.sampled_from(target.seeds)
    cut = st.builds(_cut, seeds, st.lists(edits, **few))
    if not target.is_text:
        return cut
    return st.one_of(cut, st.builds(_renumbered, seeds, st.lists(st.tuples(places, number), **few)))


def _cut(data: bytes, edits: list[tuple[float, int, bytes, str]]) -> bytes:
    """Put pieces in: in place of some bytes, of as many bytes, or behind some once more."""
    for place, length, put, how in edits:
        at = round(place * len(data))
        kept = data[at : at + length] if how == "double" else b""
        behind = {"replace": length, "double": 0, "cover": len(put)}[how]
        data = data[:at] + kept + put + data[at + behind :]
    return data


def _renumbered(data: bytes, edits: list[tuple[float, bytes | float]]) -> bytes:
    """Put other numbers in the place of some."""
    for place, number in edits:
        found = list(_NUMBER.finditer(data))
        if found:
            old = found[round(place * (len(found) - 1))]
            new = b"%.6g" % (number * float(old[0])) if isinstance(number, float) else number
            data = data[: old.start()] + new + data[old.end() :]
    return data


class Failed(Exception):
    """An input that was neither taken nor refused in words."""


def check(target: Target, data: bytes) -> bool:
    """Return whether an input was taken; raise Failed where it was neither taken nor refused."""
    began = time.perf_counter()
    taken = True
    try:
        bad = [value for value in target.run(data) if not is_good(value)]
        if bad:
            raise Failed(f"{target.name}: {bad[0]} came out")
    except target.refusals as error:
        taken = False
        text = str(error)
        if not text or "\n\n" in text or len(text) > 20_000:
            raise Failed(
                f"{target.name}: no message that a person can read: {text[:200]!r}"
            ) from error
    if (took := time.perf_counter() - began) > _LONGEST:
        raise Failed(f"{target.name}: took {took:.0f} s, expected at most {_LONGEST:g} s")
    return taken


def fuzz(target: Target, inputs: int, seconds: float) -> dict[str, Any]:
    """Try inputs until there are as many, or the time is up."""
    counts = {"inputs": 0, "taken": 0}
    warnings.simplefilter("error", RuntimeWarning)  # of arithmetic that went wrong
    end = time.monotonic() + seconds

    @settings(
        max_examples=max(inputs, 1),
        deadline=None,
        report_multiple_bugs=False,
        database=DirectoryBasedExampleDatabase(_ROOT / ".hypothesis" / "fuzz"),
        suppress_health_check=list(HealthCheck),
        phases=(Phase.reuse, Phase.generate, Phase.shrink),
    )
    @given(mutations(target))
    def attempt(data: bytes) -> None:
        if time.monotonic() < end:
            counts["inputs"] += 1
            counts["taken"] += check(target, data)

    attempt()
    return counts


@contextmanager
def limited_memory() -> Iterator[None]:
    """Let the system refuse what is beyond the limit, so that it is seen as a MemoryError."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + _MOST_MEMORY
    unlimited = resource.RLIM_INFINITY
    resource.setrlimit(resource.RLIMIT_AS, (limit, unlimited))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (unlimited, unlimited))


def main() -> int:
    """Fuzz, and say what was tried, taken and reached."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", help="default: all of them")
    parser.add_argument("--inputs", type=int, default=12_000, help="of each target")
    parser.add_argument("--minutes", type=float, default=2.0, help="at most, for each target")
    asked = parser.parse_args()
    known = targets()
    if unknown := set(asked.targets) - set(known):
        parser.error(f"unknown: {', '.join(sorted(unknown))}; expected {', '.join(known)}")
    coverage = None
    with suppress(ImportError):
        from coverage import Coverage

        coverage = Coverage(source=["smallwheel_ros"], data_file=None)
    folder, failures = scratch(), 0
    try:
        for name in asked.targets or known:
            target = known[name](folder)
            for seed in target.seeds:  # what is valid is taken, and loads the libraries
                assert check(target, seed), f"{name}: a seed is refused"
            began = time.perf_counter()
            counts: Counter[str] = Counter()
            try:
                with limited_memory():
                    with coverage.collect() if coverage else nullcontext():
                        counts.update(fuzz(target, asked.inputs // _COUNTED, 60.0 * asked.minutes))
                    rest = 60.0 * asked.minutes - (time.perf_counter() - began)
                    counts.update(fuzz(target, asked.inputs - counts["inputs"], rest))
            except Exception as error:  # whatever it is, the next target is tried too
                failures += 1
                print(f"{name}: FAILED: {type(error).__name__}: {error}")
                for note in getattr(error, "__notes__", ()):
                    print(f"  {note[:2000]}")
                continue
            took = time.perf_counter() - began
            print(
                f"{name}: {counts['inputs']} inputs, {counts['taken']} taken, {took:.0f} s",
                flush=True,
            )
    finally:
        shutil.rmtree(folder)
    if coverage:
        coverage.report(file=sys.stdout, skip_empty=True, ignore_errors=True)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
