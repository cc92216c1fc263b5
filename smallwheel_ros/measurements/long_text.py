# SPDX-License-Identifier: Apache-2.0
"""The rows of a long text file as columns: pandas reads them, many times quicker than cell by cell.

Only what is plain: each line with as many cells, no comments, no blank rows. In each column the cells that
pandas does not take for numbers stay texts, for `numbers` to judge one by one.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, overload

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd

_COMMENTS = re.compile(r'\n"?(?:#|%|//)')
_FIRST = frozenset("0123456789+-., ")  # characters that a number begins with


class LongColumn(Sequence[str]):
    """A column of texts that knows which of them are numbers.

    values: NaN where blank or left. blank: where nothing stands. left: rows of any other text. comma:
    whether decimal commas were read; points are left then. texts: makes the texts, when they are needed.
    """

    def __init__(
        self,
        values: NDArray[np.float64],
        blank: NDArray[np.bool_],
        left: NDArray[np.bool_],
        comma: bool,
        texts: Callable[[], list[str]],
    ) -> None:
        self.values, self.blank, self.left, self.comma = values, blank, left, comma
        self._make = texts
        self._texts: list[str] | None = None

    @property
    def texts(self) -> list[str]:
        """The cells as they stand in the file."""
        if self._texts is None:
            self._texts = self._make()
        return self._texts

    def take(self, rows: NDArray[np.intp]) -> LongColumn:
        """Keep these rows."""

        def texts() -> list[str]:
            return [self.texts[row] for row in rows.tolist()]

        return LongColumn(self.values[rows], self.blank[rows], self.left[rows], self.comma, texts)

    def __len__(self) -> int:
        return int(self.values.size)

    def __iter__(self) -> Iterator[str]:
        return iter(self.texts)

    @overload
    def __getitem__(self, row: int) -> str: ...
    @overload
    def __getitem__(self, row: slice) -> list[str]: ...
    def __getitem__(self, row: int | slice) -> str | list[str]:
        return self.texts[row]


class LongText:
    """A text of many lines and its separator; `columns` splits it from a line on.

    Line ends are those of Unix. Raises nothing: what is not plain has no columns.
    """

    def __init__(self, text: str, separator: str) -> None:
        self._text, self._separator = text.rstrip("\n"), separator

    def columns(self, first: int) -> list[LongColumn] | None:
        """The columns of the lines from `first` (counted from 0) on; None where they are not plain."""
        body = self._text.split("\n", first)[-1]
        parts = body.split('"')
        outside, inside = "".join(parts[::2]), "".join(parts[1::2])
        lines = outside.count("\n") + 1
        if "\n" in inside or "\r" in body or _COMMENTS.search(f"\n{body}"):
            return None
        comma = "," in (inside if self._separator == "," else body)
        try:
            frame = self._frame(body, decimal="," if comma else ".")
        except ValueError:  # a line with more cells than the first, a quote that never ends
            return None
        # pandas fills lines with fewer cells, and refuses those with more
        if len(frame) != lines or outside.count(self._separator) != lines * (frame.shape[1] - 1):
            return None
        found = [self._column(body, i, frame[i], comma) for i in range(frame.shape[1])]
        nothing = np.all([column.blank for column in found], axis=0)
        return None if nothing.any() else found

    def _frame(self, body: str, **how: object) -> pd.DataFrame:
        import pandas as pd

        return pd.read_csv(  # type: ignore[call-overload, no-any-return]
            io.StringIO(body),
            sep=self._separator,
            header=None,
            keep_default_na=False,
            na_values=[""],
            skip_blank_lines=False,
            low_memory=False,
            **how,
        )

    def _column(self, body: str, position: int, cells: pd.Series, comma: bool) -> LongColumn:
        if cells.dtype.kind in "iuf":
            numbers = cells.to_numpy(dtype=float)
            if not np.isinf(numbers).any():

                def texts() -> list[str]:
                    frame = self._frame(body, usecols=[position], dtype=str)
                    return _texts(frame[position])

                blank = np.isnan(numbers)
                return LongColumn(numbers, blank, np.zeros(blank.size, dtype=bool), comma, texts)
            cells = self._frame(body, usecols=[position], dtype=str)[position]
        listed = _texts(cells)
        values = _numbers(listed, comma)
        nothing = cells.isna().to_numpy()
        return LongColumn(values, nothing, np.isnan(values) & ~nothing, comma, lambda: listed)


def _texts(cells: pd.Series) -> list[str]:
    listed: list[str] = cells.fillna("").tolist()
    return listed


def _numbers(texts: Sequence[str], comma: bool) -> NDArray[np.float64]:
    """Values of the texts that pandas takes for finite numbers, NaN for the others."""
    import pandas as pd

    # Each text that is no number costs pandas an exception: a column of names is not tried.
    if not any(cell[:1] in _FIRST for cell in texts[:: max(1, len(texts) // 100)]):
        return np.full(len(texts), np.nan)
    if comma:
        texts = ["" if "." in cell else cell.replace(",", ".") for cell in texts]
    found = pd.to_numeric(np.array(texts, dtype=object), errors="coerce")
    values = np.asarray(found, dtype=float)
    return np.where(np.isinf(values), np.nan, values)


def rows_of(cells: Sequence[str | float], rows: NDArray[np.intp]) -> Sequence[str | float]:
    """Those rows of a column of any kind."""
    if isinstance(cells, LongColumn):
        return cells.take(rows)
    return [cells[row] for row in rows.tolist()]


def only_numbers(cells: Sequence[str | float]) -> bool:
    """Whether a column has nothing but numbers and blanks, of which no texts are needed."""
    return isinstance(cells, LongColumn) and not cells.left.any()
