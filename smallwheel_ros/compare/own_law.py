# SPDX-License-Identifier: Apache-2.0
"""A law of your own: its parameters, how its file is read, and its predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.effects.base import parameter
from smallwheel_ros.effects.registry import line_in, load_classes
from smallwheel_ros.measurements.columns import CHANNELS
from smallwheel_ros.physics.conditions import Conditions

__all__ = ["Law", "LawError", "OwnLaw", "load_laws", "parameter"]

Array = NDArray[np.float64]

_STARTS = 64  # for each parameter: over six decades some are within a factor of two of any value


class LawError(SmallwheelError):
    """A law of your own that cannot be used, or that fails on data."""


@dataclass(frozen=True)
class Law:
    """Base of a law of your own. Its fields, made by `parameter`, are fitted within their bounds.

    It has at least one method with the name of a channel, `sinkage(conditions)` (m), `resistance` (N),
    `drawbar_pull` (N) or `torque` (N m), which returns an array of shape (rows,); NaN: no prediction.

    Attributes
    ----------
    name
        Name of the law in the table; that of the class if not given.
    needs
        Columns besides load, diameter and width; the law is left out for a table without them.
    """

    name: ClassVar[str] = ""
    needs: ClassVar[tuple[str, ...]] = ()


class OwnLaw:
    """A user's law as a function of shares: the place of each parameter between its bounds, from 0 to 1.

    If the lower bound of a parameter is over 0, its place is that of its logarithm. The constructor raises
    LawError if the class cannot be used.

    Parameters
    ----------
    kind
        The user's class.
    path
        File of the class, for messages.
    """

    def __init__(self, kind: type[Law], path: Path) -> None:
        self.kind, self.path = kind, path
        self.name = kind.name or kind.__name__
        if not isinstance(kind.needs, tuple):
            raise self._error(
                f"needs is {kind.needs!r}, expected a tuple of columns, like ('slip',)"
            )
        self.needs = set(kind.needs)
        self.channels = [name for name in CHANNELS if callable(getattr(kind, name, None))]
        if not self.channels:
            raise self._error("predicts nothing, expected a method sinkage(conditions)")
        fitted = [f for f in fields(kind) if "parameter" in f.metadata]  # others are constants
        self.parameters = [replace(f.metadata["parameter"], name=f.name) for f in fitted]
        for p in self.parameters:
            if not -np.inf < p.bounds[0] < p.bounds[1] < np.inf:
                raise self._error(f"bounds of {p.name} are {p.bounds}, expected low < high")

    def _error(self, said: str, line: str = "") -> LawError:
        return LawError(f"{self.path}{line}: law '{self.name}': {said}")

    def starts(self) -> Array:
        """Shares from which a fit may start, drawn evenly over all ranges, shape (starts, parameters)."""
        count = len(self.parameters)
        return np.random.default_rng(0).random((max(1, _STARTS * count), count))

    def predict(self, shares: Array, conditions: Conditions) -> dict[str, Array]:
        """Predict the law's channels, by name, SI units, shape (rows,) each; NaN where it predicts nothing.

        Parameters
        ----------
        shares
            Shares of the parameters, 0 to 1, shape (parameters,).
        conditions
            Settings of the rows, SI units.

        Raises
        ------
        LawError
            If the law raises any exception, or returns other shapes.
        """
        values = {}
        for p, share in zip(self.parameters, shares.tolist(), strict=True):
            low, high = p.bounds
            values[p.name] = low * (high / low) ** share if low > 0 else low + share * (high - low)
        found = {}
        for name in self.channels:
            try:
                with np.errstate(all="ignore"):
                    said = getattr(self.kind(**values), name)(conditions)
                found[name] = np.array(np.broadcast_to(np.asarray(said, float), len(conditions)))
            except Exception as error:  # a user's law may raise anything at all
                raise self._error(
                    f"{name} gave no number for each of {len(conditions)} rows (NaN where it has no "
                    f"prediction): {type(error).__name__}: {error}",
                    line_in(error, self.path),
                ) from error
        return found


def load_laws(path: Path, taken: Sequence[str] = ()) -> tuple[OwnLaw, ...]:
    """Run a Python file, and return the laws in it: name only files that you trust.

    Parameters
    ----------
    path
        The file.
    taken
        Names of other laws of the table, which a law of the file must not have.

    Raises
    ------
    EffectError
        If the file does not run or has no law.
    LawError
        If a law cannot be used, or has the name of another.
    """
    found = tuple(OwnLaw(kind, path) for kind in load_classes(path, Law, "law"))
    names = [*taken, *(law.name for law in found)]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise LawError(f"{path}: two laws of the table are called '{twice}', expected another name")
    return found
