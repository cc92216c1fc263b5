# SPDX-License-Identifier: Apache-2.0
"""One fitted parameter by its name, `fit["n"]` or `fit.k`, with its deviation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError, guess
from smallwheel_ros.measurements.display import number
from smallwheel_ros.model.derived import derived_numbers
from smallwheel_ros.physics.soil import Soil

Array = NDArray[np.float64]
Status = Literal["determined", "at its bound", "not determined", "held"]

_LARGE = 1e5  # from which a number is written with its power of ten
_WORST_FIRST: tuple[Status, ...] = ("at its bound", "not determined", "held")


@dataclass(frozen=True, repr=False)
class FittedParameter:
    """One fitted parameter, or a number derived from fitted parameters.

    Attributes
    ----------
    owner
        Name of the soil, or id of the effect, that the parameter belongs to.
    name
        Its name without the owner's.
    value
        In `unit`.
    std
        Standard deviation, in `unit`; None if the parameter is fixed, or at its bound.
    unit
        As text; `1` if dimensionless.
    bounds
        Lowest and highest value that a fit may give it, in `unit`.
    status
        `determined`: the data reduced the prior's standard deviation to half or less; `not determined`: it
        did not; `at its bound`; `held`: not fitted, since all bodies had one diameter (m only).
    remedy
        The measurement that would determine it; empty if it is determined.
    """

    owner: str
    name: str
    value: float
    std: float | None
    unit: str
    bounds: tuple[float, float]
    status: Status
    remedy: str

    @property
    def full_name(self) -> str:
        """The owner's name and its own, as `dry_sand.n` or `slip_sinkage.a`."""
        return f"{self.owner}.{self.name}"

    def __str__(self) -> str:
        """Value, deviation and unit, and the status where it is not determined."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        large = abs(self.value) >= _LARGE
        value = f"{self.value:.4g}" if large else number(self.value, 4)
        std = ""
        if self.std is not None:
            std = f" +- {number(self.std, 2 if large else 3)}"
        # What follows from a number that is held is known as far as the others are.
        status = "with m held" if self.status == "held" and std else self.status
        said = "" if status == "determined" else f"  ({status})"
        return f"{value}{std}{unit}{said}"

    def __repr__(self) -> str:
        return f"<{self.full_name}: {self}>"

    def row(self, of: str) -> dict[str, Any]:
        """Return name, value, std, unit and status as a row of a table, with `of` in its column `of`."""
        known = {n: getattr(self, n) for n in ("value", "std", "unit", "status")}
        return {"of": of, "parameter": self.name, **known}

    def to_dict(self) -> dict[str, Any]:
        """Return value, std, unit, status and remedy; value and std are in `unit`."""
        return {n: getattr(self, n) for n in ("value", "std", "unit", "status", "remedy")}


def derived_parameters(
    soils: Iterable[Soil],
    parameters: Sequence[FittedParameter],
    names: Sequence[str],
    covariance: Array,
) -> tuple[FittedParameter, ...]:
    """Compute k and the shear deformation modulus of each soil from its fitted parameters.

    A derived number has the worst status among the parameters that it is computed from, and that
    parameter's remedy.

    Parameters
    ----------
    soils
        The soils with their fitted numbers.
    parameters
        Their fitted parameters, from which status and remedy are taken.
    names
        Full names of the parameters in `covariance`, as `dry_sand.n`.
    covariance
        Their covariance, shape (names, names), in the products of their units.

    Returns
    -------
    tuple of FittedParameter
        `k` [Pa/m^(n+m)] and `shear_displacement` [m]; a number is left out where `names` lacks the
        parameter that it depends on most.
    """
    known = {p.full_name: p for p in parameters}
    found = []
    for soil in soils:
        for one in derived_numbers(soil, names, covariance):
            if one.std is None:
                continue
            sources = [known[n] for p in one.follows if (n := f"{soil.name}.{p}") in known]
            worst = min(sources, key=lambda p: [*_WORST_FIRST, "determined"].index(p.status))
            std = None if worst.status == "at its bound" else one.std
            found.append(
                FittedParameter(soil.name, one.name, one.value, std, one.unit, (0.0, np.inf),
                                worst.status, worst.remedy)
            )  # fmt: skip
    return tuple(found)


class ParameterNameError(SmallwheelError, KeyError):
    """No parameter of a fit has the name asked for, or several soils or effects have one of that name."""

    __str__ = Exception.__str__  # that of KeyError is in quotes


class WithParameters:
    """A result with parameters that can be looked up by name.

    `fit["dry_sand.n"]`, or `fit["n"]` and `fit.n` if only one soil or effect has it.
    """

    def named(self) -> Mapping[str, FittedParameter]:
        """All parameters and derived numbers by full name."""
        raise NotImplementedError

    def __getitem__(self, name: str) -> FittedParameter:
        """The parameter of that name. Raises ParameterNameError that lists what there is."""
        known = self.named()
        if name in known:
            return known[name]
        mine = [full_name for full_name, p in known.items() if p.name == name]
        if len(mine) == 1:
            return known[mine[0]]
        if mine:
            raise ParameterNameError(
                f"parameter '{name}': several have it, say which: {', '.join(mine)}"
            )
        short = [*known, *dict.fromkeys(p.name for p in known.values())]
        question = guess(str(name), short)
        raise ParameterNameError(
            f"no parameter '{name}'. {question}The names are {', '.join(known)}"
        )

    __iter__ = None  # it is asked for names, not gone through

    if not TYPE_CHECKING:  # mypy would take any other slip of the pen for a parameter

        def __getattr__(self, name):
            """The parameter of that name. Raises AttributeError that lists what there is."""
            if name.startswith("_") or name in type(self).__dataclass_fields__:
                raise AttributeError(f"a {type(self).__name__} has no '{name}'")
            try:
                return self[name]
            except ParameterNameError as error:
                raise AttributeError(str(error)) from None

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *(p.name for p in self.named().values())]
