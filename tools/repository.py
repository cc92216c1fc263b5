# SPDX-License-Identifier: Apache-2.0
"""Where the repository lives: said here, and written into each file that states it.

`python tools/repository.py` after REPOSITORY was filled in. Empty: no file states an address.
"""

from __future__ import annotations

import re
from pathlib import Path

REPOSITORY = ""  # as https://github.com/OWNER/smallwheel_ros
TRACKER = "{repository}/issues"  # as GitHub, GitLab and Codeberg have it

# By file: the line before which the addresses stand, and their lines.
PLACES = {
    "pyproject.toml": (
        '"Paper of the law" =',
        ['Repository = "{repository}"', f'Issues = "{TRACKER}"'],
    ),
    "package.xml": (
        "  <buildtool_depend>ament_cmake</buildtool_depend>",
        [
            '  <url type="repository">{repository}</url>',
            f'  <url type="bugtracker">{TRACKER}</url>',
        ],
    ),
    "CITATION.cff": ("authors:", ["repository-code: {repository}", f"url: {TRACKER}"]),
}


def stated(text: str, name: str, repository: str) -> str:
    """Return the text of a file with these addresses in it; with none where `repository` is empty."""
    before, lines = PLACES[name]
    for line in lines:
        pattern = re.escape(line).replace(re.escape("{repository}"), r"\S+?")
        text = re.sub(rf"^{pattern}\n", "", text, flags=re.MULTILINE)
    if not repository:
        return text
    shown = "".join(f"{line.format(repository=repository)}\n" for line in lines)
    head, found, tail = text.partition(f"\n{before}")
    if not found:
        raise ValueError(f"{name}: no line begins with {before!r}")
    return f"{head}\n{shown}{before}{tail}"


def main() -> None:
    """Write the addresses into the checkout."""
    for name in PLACES:
        path = Path(__file__).resolve().parents[1] / name
        path.write_text(stated(path.read_text(encoding="utf-8"), name, REPOSITORY), "utf-8")


if __name__ == "__main__":
    main()
