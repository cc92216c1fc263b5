# SPDX-License-Identifier: Apache-2.0
"""The conditions of a wheel: one row for each measurement or prediction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smallwheel_ros.common.errors import SmallwheelError

Array = NDArray[np.float64]

ROLLING, PRESSED, PLATE = "rolling", "pressed", "plate"
CONTACTS = (ROLLING, PRESSED, PLATE)


class ConditionsError(SmallwheelError):
    """Conditions that contradict each other, or a covariate that is missing."""


@dataclass(frozen=True)
class Conditions:
    """Load, wheel and covariates of each row, in SI units; make one with `Conditions.of`.

    Attributes
    ----------
    load
        Normal load, N, shape (rows,).
    diameter, width
        Size of the wheel or plate, m, shape (rows,); the width of a round plate may be NaN or 0.
    contact
        `rolling`, `pressed` or `plate` for each row, shape (rows,).
    soil
        Name of each row's soil, shape (rows,); None if there is only one soil.
    covariates
        Further columns by name (slip, speed, pass_number, moisture, ...), each of shape (rows,).
    """

    load: Array
    diameter: Array
    width: Array
    contact: NDArray[np.str_]
    soil: NDArray[np.str_] | None = None
    covariates: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        load: ArrayLike,
        diameter: ArrayLike,
        width: ArrayLike,
        *,
        contact: ArrayLike = ROLLING,
        soil: ArrayLike | None = None,
        **covariates: ArrayLike,
    ) -> Conditions:
        """Make conditions from scalars and one-dimensional arrays, broadcast to one length.

        Parameters
        ----------
        load
            Normal load, N, above 0.
        diameter
            Diameter of the wheel, or equivalent diameter of the plate, m, above 0.
        width
            Width of the wheel, m, above 0; of a plate its smaller side, NaN or 0 if it is round.
        contact
            `rolling`, `pressed` (a wheel pushed straight down) or `plate`, for all rows or for each.
        soil
            Name of the soil of each row; None if there is only one.
        **covariates
            What else is known of each row, by name: slip, slope (rad), speed (m/s), columns of your own.

        Raises
        ------
        ConditionsError
            If lengths differ, an array has more than one dimension, a contact is unknown, or a load, a
            diameter or a wheel's width is not a finite number above 0.
        """
        numbers = {"load": load, "diameter": diameter, "width": width, **covariates}
        columns = {name: np.asarray(value, dtype=float) for name, value in numbers.items()}
        texts = {"contact": np.asarray(contact, dtype=np.str_)}
        if soil is not None:
            texts["soil"] = np.asarray(soil, dtype=np.str_)
        try:
            shape = np.broadcast_shapes(
                (1,), *(a.shape for a in (*columns.values(), *texts.values()))
            )
        except ValueError:
            lengths = ", ".join(f"{name} {a.size}" for name, a in columns.items())
            raise ConditionsError(f"columns of different lengths: {lengths}") from None
        if len(shape) != 1:
            raise ConditionsError(
                f"conditions are one row per wheel, found an array of shape {shape}"
            )
        columns = {name: np.broadcast_to(a, shape) for name, a in columns.items()}
        texts = {name: np.broadcast_to(a, shape) for name, a in texts.items()}
        for name in ("load", "diameter", "width"):
            needed = texts["contact"] != PLATE if name == "width" else np.ones(shape, dtype=bool)
            bad = np.flatnonzero(needed & ~(columns[name] > 0) | np.isinf(columns[name]))
            if bad.size:
                raise ConditionsError(
                    f"{name} in row {bad[0] + 1} is {columns[name][bad[0]]}, "
                    "expected a number over 0"
                )
        unknown = set(np.unique(texts["contact"])) - set(CONTACTS)
        if unknown:
            raise ConditionsError(
                f"contact '{sorted(unknown)[0]}' is unknown, expected one of {', '.join(CONTACTS)}"
            )
        return cls(
            columns.pop("load"),
            columns.pop("diameter"),
            columns.pop("width"),
            texts["contact"],
            texts.get("soil"),
            columns,
        )

    def __len__(self) -> int:
        return int(self.load.size)

    @cached_property
    def rolling(self) -> NDArray[np.bool_]:
        """Mask of the rows of a wheel that rolls, shape (rows,)."""
        return self._contact_is(ROLLING)

    @cached_property
    def pressed(self) -> NDArray[np.bool_]:
        """Mask of the rows of a wheel that is pressed straight down, shape (rows,)."""
        return self._contact_is(PRESSED)

    @cached_property
    def plate(self) -> NDArray[np.bool_]:
        """Mask of the rows of a flat plate, shape (rows,)."""
        return self._contact_is(PLATE)

    def _contact_is(self, contact: str) -> NDArray[np.bool_]:
        column = self.contact
        if column.strides == (0,):  # one value for all rows: comparing texts is slow
            return np.full(column.shape, bool(column[0] == contact))
        return np.asarray(column == contact)

    def __contains__(self, name: str) -> bool:
        return name in ("load", "diameter", "width") or name in self.covariates

    def __getitem__(self, name: str) -> Array:
        """Return the column of that name. Raises an error that lists the columns if there is none."""
        if name in ("load", "diameter", "width"):
            return np.asarray(getattr(self, name))
        try:
            return self.covariates[name]
        except KeyError:
            there = ", ".join(("load", "diameter", "width", *self.covariates))
            raise ConditionsError(f"no column '{name}'. The columns are {there}") from None

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_] | slice) -> Conditions:
        """Return the conditions of some rows, selected by indices, a mask of shape (rows,) or a slice."""
        return Conditions(
            self.load[rows],
            self.diameter[rows],
            self.width[rows],
            self.contact[rows],
            None if self.soil is None else self.soil[rows],
            {name: column[rows] for name, column in self.covariates.items()},
        )
