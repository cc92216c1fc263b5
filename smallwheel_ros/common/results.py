# SPDX-License-Identifier: Apache-2.0
"""What all results have in common: words for people, plain values and tables for programs, files.

A result is what a function of `smallwheel_ros` returns and what the command of that name prints:
`print(result)` is the command's text, `to_dict()` its JSON.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smallwheel_ros.common.errors import SmallwheelError, nearest
from smallwheel_ros.common.files import check_target, json_text, write_bytes, write_whole
from smallwheel_ros.common.tables import plain, write_rows
from smallwheel_ros.common.views import function, has_view, view_of

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

Row = Mapping[str, Any]
Writer = Callable[[Path], object]
PICTURES = (".png", ".svg", ".pdf")


class ResultError(SmallwheelError):
    """Something that a result cannot be turned into."""


class Result:
    """Base of every result. `headline`, `text`, `to_dict` and `rows` are what it states, or its views."""

    def headline(self) -> str:
        """The result in half a line."""
        raise NotImplementedError

    def text(self) -> str:
        """The result as the command prints it."""
        if has_view("text", self):
            return str(view_of("text", self)(self))
        return str(view_of("page", self)(self).text())

    def to_dict(self) -> dict[str, Any]:
        """The result as the command's JSON: plain values, SI units."""
        return dict(plain(view_of("document", self)(self)))

    def rows(self) -> Sequence[Row]:
        """The result as a table: one mapping for each row, all of the same keys, SI units."""
        found: Sequence[Row] = view_of("rows", self)(self)
        return found

    def _drawn(self, axes: Axes | None, *how: Any) -> Axes:
        """Draw the result on these axes, or on those of a new figure. how: what the view takes."""
        made = axes_or_new(axes)
        view_of("plot", self)(made, self, *how)
        return made

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.headline()}>"

    def __str__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        """The headline and the table, for a notebook."""
        rows_html = function("report.blocks:rows_html")
        return f"<p>{escape(self.headline())}</p>\n{rows_html(self.rows())}"

    def to_frame(self) -> pd.DataFrame:
        """The table as a DataFrame of pandas. Raises ImportError where pandas is not installed."""
        frame: pd.DataFrame = pandas().DataFrame(list(self.rows()))
        return frame

    def save(self, path: str | PathLike[str]) -> Path:
        """Write the result into a file, whole or not at all; its suffix says as what.

        .json is `to_dict`, .csv the table; where the result has them .yaml is the model, .html the
        report, .png, .svg and .pdf the picture. Raises ResultError for another suffix, OutputError
        where it cannot be written.
        """
        target = check_target(Path(path))
        known = {".json": self._write_json, ".csv": self._write_csv} | self._writers()
        if target.suffix not in known:
            raise ResultError(
                f"{target}: a {type(self).__name__} cannot be saved as '{target.suffix}': "
                f"{nearest(target.suffix, list(known))}"
            )
        known[target.suffix](target)
        return target

    def _writers(self) -> dict[str, Writer]:
        """Further kinds of files, by suffix."""
        found: dict[str, Writer] = {}
        if has_view("plot", self):
            found |= picture_writers(self.plot)  # type: ignore[attr-defined]  # a kind that is drawn
        if has_view("page", self):
            found[".html"] = lambda path: view_of("page", self)(self).save(path)
        if has_view("model", self):
            found |= dict.fromkeys(
                (".yaml", ".yml"), lambda path: view_of("model", self)(path, self)
            )
        return found

    def _write_json(self, path: Path) -> None:
        write_bytes(path, json_text(self.to_dict()).encode())

    def _write_csv(self, path: Path) -> None:
        write_rows(path, self.rows())


def pandas() -> Any:
    """The module pandas, imported now. Raises ImportError that says what to do without it."""
    try:
        import pandas as module
    except ImportError as error:
        raise ImportError(
            "to_frame() needs pandas: pip install pandas; to_dict() gives the same without it"
        ) from error
    return module


def axes_or_new(axes: Axes | None) -> Axes:
    """The axes given, or those of a new figure that a notebook shows."""
    if axes is not None:
        return axes
    from matplotlib import pyplot

    return pyplot.subplots(layout="constrained")[1]


def picture_writers(plot: Callable[[Axes], object]) -> dict[str, Writer]:
    """Writers of a plot by suffix. plot: draws on axes."""

    def write(path: Path) -> None:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6.4, 4.0), layout="constrained")
        plot(figure.subplots())
        kind = path.suffix.removeprefix(".")
        write_whole(path, lambda draft: figure.savefig(draft, dpi=150, format=kind))

    return dict.fromkeys(PICTURES, write)
