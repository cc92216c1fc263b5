# SPDX-License-Identifier: Apache-2.0
"""Blocks, of which pages consist; a page is text on the terminal, HTML, and pictures.

A table has rows as in the result's JSON (SI units), and columns that define how each value is
shown, so that the numbers of a file and of a page cannot differ. HTML is rendered from blocks by
web/page.html.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

from smallwheel_ros.common.tables import text_table
from smallwheel_ros.measurements.display import (
    number,
    p_text,
    percent,
    probability_text,
    shown_value,
)
from smallwheel_ros.views.plots import Panel

Row = Mapping[str, Any]
Show = Callable[[Any], str]


class Column(NamedTuple):
    """A column of a table: how the cell of each row is obtained and shown.

    Attributes
    ----------
    header
        Words above the column.
    cell
        Key of the cell's value in a row, or a function of the row that returns the value; a row without the
        key has None.
    show
        Function that converts the value to text; by default `str`, and `-` for None.
    right
        Whether the column is right-aligned, as numbers are.
    bar
        Function of a row that returns the length of a bar in the background of its cell, 0 to 1, or None for
        no bar; None if the column has no bars.
    """

    header: str
    cell: str | Callable[[Row], Any]
    show: Show = lambda value: "-" if value is None else str(value)
    right: bool = False
    bar: Callable[[Row], float | None] | None = None

    def text(self, row: Row) -> str:
        """The text of a row's cell."""
        return self.show(row.get(self.cell) if isinstance(self.cell, str) else self.cell(row))

    def share(self, row: Row) -> float | None:
        """Length of the bar in the cell's background, per cent; None without a bar."""
        share = self.bar(row) if self.bar else None
        return None if share is None else round(100.0 * share)


def count(header: str, key: str) -> Column:
    """A column of whole numbers.

    Parameters
    ----------
    header
        Words above the column.
    key
        Key of the row's value.
    """
    return Column(header, key, right=True)


def of_channel(header: str, key: str, bar: Callable[[Row], float | None] | None = None) -> Column:
    """A column of values in the unit of each row's channel, such as millimetres for `sinkage`.

    Parameters
    ----------
    header
        Words above the column.
    key
        Key of the row's value, SI. The row's key `channel` has the name of its channel.
    bar
        Function of a row that returns the length of its bar, 0 to 1; no bars if not given.
    """
    return Column(
        header, lambda row: shown_value(row["channel"], row.get(key)), right=True, bar=bar
    )


def share_of(header: str, key: str) -> Column:
    """A column of shares, in per cent.

    Parameters
    ----------
    header
        Words above the column.
    key
        Key of the row's value, 0 to 1.
    """
    return Column(header, key, percent, right=True)


def p_value(header: str, key: str) -> Column:
    """A column of p values.

    Parameters
    ----------
    header
        Words above the column.
    key
        Key of the row's value, 0 to 1.
    """
    return Column(header, key, p_text, right=True)


def probability(header: str, key: str) -> Column:
    """A column of probabilities, with bars.

    Parameters
    ----------
    header
        Words above the column.
    key
        Key of the row's value, 0 to 1.
    """
    return Column(header, key, probability_text, right=True, bar=lambda row: row.get(key))


def plain_number(header: str, key: str | Callable[[Row], Any], digits: int = 3) -> Column:
    """A column of numbers without a unit, or whose unit is in the header.

    Parameters
    ----------
    header
        Words above the column.
    key
        Key of the row's value, or a function of the row.
    digits
        Significant digits.
    """
    return Column(header, key, lambda value: number(value, digits), right=True)


@dataclass(frozen=True)
class Text:
    """A paragraph, a list, or both.

    Attributes
    ----------
    text
        The paragraph; empty for none.
    items
        Items of the list below it.
    """

    kind: ClassVar = "text"
    text: str = ""
    items: Sequence[str] = ()

    def lines(self) -> list[str]:
        """The block on the terminal."""
        inset = "  " if self.text else ""
        return [*([self.text] if self.text else []), *(f"{inset}{item}" for item in self.items)]


@dataclass(frozen=True)
class Callout:
    """A message that must not be missed.

    Attributes
    ----------
    headline
        The message in a sentence.
    items
        Further sentences below it.
    tone
        Whether it is shown as a result or as a warning.
    """

    kind: ClassVar = "callout"
    headline: str
    items: Sequence[str] = ()
    tone: Literal["result", "warning"] = "result"

    def lines(self) -> list[str]:
        """The block on the terminal."""
        return [self.headline.removesuffix(".") + ".", *(f"  {item}" for item in self.items)]


@dataclass(frozen=True)
class Table:
    """Rows under columns; columns whose cells are all empty or `-` are left out.

    Attributes
    ----------
    columns, rows
        The columns, and the rows as mappings (SI units).
    caption
        Words above the table; empty for none.
    strong
        Function of a row that returns whether it is printed bold.
    """

    kind: ClassVar = "table"
    columns: Sequence[Column]
    rows: Sequence[Row]
    caption: str = ""
    strong: Callable[[Row], bool] = lambda row: False

    @property
    def shown(self) -> list[Column]:
        """The columns that are not empty."""
        return [c for c in self.columns if any(c.text(row) not in ("", "-") for row in self.rows)]

    def lines(self) -> list[str]:
        """The block on the terminal."""
        shown = self.shown
        cells = [[column.text(row) for column in shown] for row in self.rows]
        right = [i for i, column in enumerate(shown) if column.right]
        table = text_table([column.header for column in shown], cells, right)
        inset = "  " if self.caption else ""
        return [*([self.caption] if self.caption else []),
                *(f"{inset}{line}" for line in table.splitlines())]  # fmt: skip


@dataclass(frozen=True)
class Figure:
    """Plots side by side on the page, and one picture file.

    Attributes
    ----------
    name
        Name of the picture file without its suffix.
    panels
        The plots.
    caption
        Words below them; empty for none.
    """

    kind: ClassVar = "figure"
    name: str
    panels: Sequence[Panel]
    caption: str = ""

    def lines(self) -> list[str]:
        """No lines: figures are not shown on the terminal."""
        return []


@dataclass(frozen=True)
class Details:
    """Blocks that open on a click, for the few readers who need them.

    Attributes
    ----------
    summary
        Words that are clicked on, without a full stop.
    blocks
        The blocks inside.
    """

    kind: ClassVar = "details"
    summary: str
    blocks: Sequence[Block]

    def lines(self) -> list[str]:
        """The summary alone: the blocks inside are not shown on the terminal."""
        return [f"{self.summary}."]


class Choice(NamedTuple):
    """A model or an effect that a reader of a page can choose, alone or with others.

    Attributes
    ----------
    value
        Key of the choice, from which those of `Models.views` are composed.
    label
        Name of the choice on the page.
    group
        Heading under which the choice stands; empty for none.
    chance
        Probability of the effect, shown beside it, 0 to 1; None: none is shown.
    chosen
        Whether it is chosen when the page opens.
    """

    value: str
    label: str
    group: str = ""
    chance: float | None = None
    chosen: bool = False


@dataclass(frozen=True)
class Models:
    """A part of the page where its reader chooses a model, and sees its text and plots of its residuals.

    Attributes
    ----------
    choices
        What the reader can choose: models, or effects that make up a model.
    several
        Whether any number of choices can be set together, as for effects; otherwise exactly one is.
    views
        Blocks that are shown for each model. The key is `Choice.value` of the choices that are set, joined
        by commas; empty for a model without effects.
    leaves
        Residuals of each model and plots without points, as `views.leftovers.leftovers` returns them.
    absent
        Text that is shown for a combination of choices that is not in `views`.
    stills
        Figures of residuals for picture files; they are not on the page.
    """

    kind: ClassVar = "models"
    choices: Sequence[Choice]
    several: bool
    views: Mapping[str, Sequence[Block]]
    leaves: Mapping[str, Any]
    absent: str = "This combination was not computed."
    stills: Sequence[Figure] = ()

    def lines(self) -> list[str]:
        """No lines: models are chosen on the page only."""
        return []


Block = Text | Callout | Table | Figure | Details | Models


@dataclass(frozen=True)
class Section:
    """A heading (`title`) and the blocks under it."""

    title: str
    blocks: Sequence[Block] = ()

    def lines(self) -> list[str]:
        """The section on the terminal; no lines if it is empty."""
        return [line for block in self.blocks for line in block.lines()]


def walked(blocks: Iterator[Block] | Sequence[Block]) -> Iterator[Block]:
    """Yield the blocks, each followed by the blocks inside it."""
    for block in blocks:
        yield block
        if isinstance(block, Details):
            yield from walked(block.blocks)
        elif isinstance(block, Models):
            yield from block.stills
            for inside in block.views.values():
                yield from walked(inside)
