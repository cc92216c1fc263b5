# SPDX-License-Identifier: Apache-2.0
r"""Which functions of a package one call passes, and in how many files: the length of a way through it.

    python tools/trace_functions.py smallwheel_ros/measurements 'sw.read("rig.csv")'
    python tools/trace_functions.py smallwheel_ros/diagnosis,smallwheel_ros/fitting 'sw.diagnose(table)' \
        --before 'table = sw.read("rig.csv")'

Both are Python; `sw` is smallwheel_ros. A function counts once however often it is called, comprehensions
and lambdas count with the function that they stand in, and what an import runs does not count.
`--first` counts the first call, caches empty, and not the second. With --list they are printed in the
order in which they are first called.
"""

from __future__ import annotations

import argparse
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import CodeType, FrameType

ROOT = Path(__file__).resolve().parents[1]


def passed(call: Callable[[], object], folders: list[str]) -> list[tuple[str, str]]:
    """(file, function) of each function that the call passes in these folders, in order of first call."""
    inside = tuple(
        str(ROOT / folder) + ("" if folder.endswith(".py") else "/") for folder in folders
    )
    found: dict[tuple[str, str], None] = {}
    seen: set[CodeType] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event == "call" and code not in seen:
            seen.add(code)
            if code.co_filename.startswith(inside) and not code.co_name.startswith("<"):
                name = getattr(code, "co_qualname", code.co_name)  # Python 3.10 has the name alone
                found[str(Path(code.co_filename).relative_to(ROOT)), name] = None

    threading.setprofile(note)
    sys.setprofile(note)
    try:
        call()
    finally:
        sys.setprofile(None)
        threading.setprofile(None)  # type: ignore[arg-type]
    return [*found]


def main() -> None:
    """Print the functions and files of a call."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", 1)[0])
    parser.add_argument("folders", help="folders or files of the repository, with commas between")
    parser.add_argument("call", help="the call, as Python")
    parser.add_argument("--before", default="", help="what runs before it, untraced")
    parser.add_argument("--first", action="store_true", help="trace the first call, not the second")
    parser.add_argument("--list", action="store_true", help="print each function")
    given = parser.parse_args()
    sys.path.insert(0, str(ROOT))
    import smallwheel_ros

    names: dict[str, object] = {"sw": smallwheel_ros}
    exec(given.before, names)
    code = compile(given.call, "<call>", "exec")
    if not given.first:
        exec(code, names)  # imports and caches
    functions = passed(lambda: exec(code, names), given.folders.split(","))
    for file, name in functions if given.list else []:
        print(f"{file}: {name}")
    print(f"{len(functions)} functions in {len({file for file, _ in functions})} files")


if __name__ == "__main__":
    main()
