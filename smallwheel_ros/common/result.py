# SPDX-License-Identifier: Apache-2.0
"""The common base of all results: text for people, plain values and tables for programs, files.

A result is what a function of `smallwheel_ros` returns and what the command of the same name prints:
`print(result)` is the command's text, `to_dict()` its JSON. The module named by `shown` defines how
a result looks, with some of these functions:

    page(result, pictures=True) -> Page    text, HTML and pictures
    document(result) -> dict               its JSON, if the result does not hold it
    rows(result) -> list of mappings       its table, likewise
    draw(axes, result, ...)                one plot of it
    writers(result) -> dict                further kinds of files, by suffix
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from smallwheel_ros.common.errors import SmallwheelError, nearest
from smallwheel_ros.common.files import check_target, json_text, write_bytes, write_whole
from smallwheel_ros.common.tables import plain, write_rows

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

Row = Mapping[str, Any]
Writer = Callable[[Path], object]
PICTURES = (".png", ".svg", ".pdf")
_MOST_ROWS = 20  # of a table in a notebook


class ResultError(SmallwheelError):
    """A result cannot be converted as asked."""


class Result:
    """Base of every result.

    A class that derives from it names the module that shows its results by the class argument `shown`,
    without the package's name: `class Replayed(Result, shown="replay.report")`.
    """

    _module: ClassVar[str] = ""

    def __init_subclass__(cls, shown: str = "", **how: Any) -> None:
        """Note the module that shows results of this class."""
        super().__init_subclass__(**how)
        if shown:
            cls._module = f"smallwheel_ros.{shown}"

    @classmethod
    def _view(cls, name: str) -> Callable[..., Any] | None:
        """The function of that name in the module that shows the result, imported only now; None if none."""
        found: Callable[..., Any] | None = None
        if cls._module:
            found = getattr(import_module(cls._module), name, None)
        return found

    def headline(self) -> str:
        """The result in half a line."""
        raise NotImplementedError

    def text(self) -> str:
        """The result as the command prints it."""
        told, page = self._view("text"), self._view("page")
        if told is None and page is None:
            raise NotImplementedError(f"a {type(self).__name__} has no text")
        return str(told(self) if told else page(self, pictures=False).text())  # type: ignore[misc]

    def to_dict(self) -> dict[str, Any]:
        """The result as the command's JSON: plain values, SI units."""
        document = self._view("document")
        if document is None:
            raise NotImplementedError(f"a {type(self).__name__} has no document")
        return dict(plain(document(self)))

    def rows(self) -> Sequence[Row]:
        """The result as a table: one mapping for each row, all with the same keys, SI units."""
        rows = self._view("rows")
        if rows is None:
            raise NotImplementedError(f"a {type(self).__name__} has no rows")
        found: Sequence[Row] = rows(self)
        return found

    def _drawn(self, axes: Axes | None, *how: Any) -> Axes:
        """Draw the result on axes, or on those of a new figure. how: further arguments of `draw`."""
        made, draw = axes_or_new(axes), self._view("draw")
        assert draw is not None, f"a {type(self).__name__} is not drawn"
        draw(made, self, *how)
        return made

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.headline()}>"

    def __str__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        """The headline and the first rows of the table, for a notebook."""
        rows = self.rows()
        head = "".join(f"<th>{escape(name)}</th>" for name in rows[0]) if rows else ""
        body = "".join(
            f"<tr>{''.join(f'<td>{escape(_cell(v))}</td>' for v in row.values())}</tr>"
            for row in rows[:_MOST_ROWS]
        )
        more = len(rows) - _MOST_ROWS
        table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
        return f"<p>{escape(self.headline())}</p>\n{table}" + (
            f"<p>and {more} more rows</p>" if more > 0 else ""
        )

    def to_frame(self) -> pd.DataFrame:
        """The table as a DataFrame of pandas. Raises ImportError where pandas is not installed."""
        frame: pd.DataFrame = pandas().DataFrame(list(self.rows()))
        return frame

    def save(self, path: str | PathLike[str]) -> Path:
        """Write the result into a file, whole or not at all; the suffix selects the kind of file.

        .json is `to_dict`, .csv the table; some results also have .yaml, the model; .html, the report; and
        .png, .svg and .pdf, the picture. Returns the path. Raises ResultError for another suffix, OutputError
        if the file cannot be written.
        """
        target = check_target(Path(path))
        known = {
            ".json": lambda path: write_bytes(path, json_text(self.to_dict()).encode()),
            ".csv": lambda path: write_rows(path, self.rows()),
        } | self._writers()
        if target.suffix not in known:
            raise ResultError(
                f"{target}: a {type(self).__name__} cannot be saved as '{target.suffix}': "
                f"{nearest(target.suffix, list(known))}"
            )
        known[target.suffix](target)
        return target

    def _writers(self) -> dict[str, Writer]:
        """Further kinds of files, by suffix."""
        page, writers = self._view("page"), self._view("writers")
        found: dict[str, Writer] = dict(writers(self)) if writers else {}
        if self._view("draw") is not None:
            plot: Callable[[Axes], object] = self.plot  # type: ignore[attr-defined]  # a kind that is drawn
            found |= dict.fromkeys(PICTURES, lambda path: write_plot(plot, path))
        if page is not None:
            found[".html"] = lambda path: page(self).write(path)
        return found

    def write_pictures(self, folder: Path) -> list[Path]:
        """Write every figure of the result's page as NAME.png into a folder; return the paths."""
        page = self._view("page")
        assert page is not None, f"a {type(self).__name__} has no page"
        written: list[Path] = page(self).write_pictures(folder)
        return written


def name_to_draw(name: str | None, known: Iterable[str]) -> str:
    """Return the name of a channel or setting to draw, checked.

    Parameters
    ----------
    name
        The name that was asked for; None: the first of those known.
    known
        Names of what can be drawn.

    Raises
    ------
    ResultError
        If it cannot be drawn, or nothing can.
    """
    names = list(known)
    if not names:
        raise ResultError("there is nothing to draw: no channel has a result")
    if name is None:
        return names[0]
    if name not in names:
        raise ResultError(f"no column '{name}' to draw: {nearest(name, names)}")
    return name


def axes_or_new(axes: Axes | None) -> Axes:
    """The axes given, or those of a new figure that a notebook shows."""
    if axes is not None:
        return axes
    from matplotlib import pyplot

    return pyplot.subplots(layout="constrained")[1]


def write_plot(plot: Callable[[Axes], object], path: Path) -> None:
    """Write a plot as a picture.

    Parameters
    ----------
    plot
        Function that draws on axes of matplotlib.
    path
        The file; its suffix selects the format, such as .png.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    plot(figure.subplots())
    write_whole(path, lambda draft: figure.savefig(draft, dpi=150, format=path.suffix[1:]))


def _cell(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else "" if value is None else str(value)


def pandas() -> Any:
    """Import pandas and return the module. Raises an ImportError that says how to do without it."""
    try:
        import pandas as module
    except ImportError as error:
        raise ImportError(
            "to_frame() needs pandas: pip install pandas; to_dict() gives the same without it"
        ) from error
    return module
