# SPDX-License-Identifier: Apache-2.0
"""Calls effects stage by stage, with the rules that hold for all of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.effects.base import ROLLING_STAGES, Effect, EffectError
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import effective_modulus

Array = NDArray[np.float64]
T = TypeVar("T")


class LoadedRows(NamedTuple):
    """Load (N), diameter (m), K (Pa/m^n) and n for which the contact is solved, shape (rows,) each."""

    load: Array
    diameter: Array
    modulus: Array
    exponent: Array


class Stages:
    """Calls effects stage by stage.

    A stage is a method of `Effect`; `effects.base.STAGES` lists them. A row of a pressed wheel or a plate may
    leave a covariate blank (NaN): an effect that reads it then does nothing in that row. An error names the
    effect that failed.

    Parameters
    ----------
    effects
        Effects in the order in which they act.
    conditions
        Settings, SI units, shape (rows,) each. The attribute of this name has the load as corrected
        by the stage `corrected_load`.
    """

    def __init__(self, effects: Sequence[Effect], conditions: Conditions) -> None:
        self.effects = effects
        self.conditions = conditions
        self.rolling = conditions.rolling
        self.all_rolling = bool(self.rolling.all())
        # Whether some effect makes pressure other than a power of depth.
        self.layered = bool(self.acting_at("pressure_factor"))
        if self.acting_at("corrected_load"):
            load = self.change("corrected_load", conditions.load)
            self.conditions = replace(conditions, load=load)

    def acting_at(self, stage: str) -> list[Effect]:
        """The effects that act at a stage, in the model's order."""
        return [effect for effect in self.effects if stage in effect.acts]

    def call(self, effect: Effect, stage: str, neutral: Any, *arguments: Any) -> Any:
        """Call one effect's method of a stage, and check its result.

        Parameters
        ----------
        effect, stage
            The effect, and the name of its method.
        neutral
            Result that leaves the prediction unchanged: 1 for a factor, 0 for a term that is added, the
            value itself for a changed value; a number, or an array of the result's shape. It replaces NaN
            in rows of pressed wheels and plates, which may have a blank covariate.
        arguments
            The arguments that the method takes before `conditions`; `conditions` are added.

        Returns
        -------
        number or array
            What the method returns, SI units: one number for all rows, or an array of the first argument's
            shape; without such an argument, or if it is no array, of shape (rows,).

        Raises
        ------
        EffectError
            If the method fails, or returns anything else.
        """
        value = guarded(effect, stage, getattr(effect, stage), *arguments, self.conditions)
        first = arguments[0] if arguments else None
        expected = first.shape if isinstance(first, np.ndarray) else (len(self.conditions),)
        if np.asarray(value).dtype.kind not in "fiu":
            raise EffectError(
                f"effect '{effect.id}': {stage} gave {type(value).__name__}, expected numbers"
            )
        if np.shape(value) not in ((), expected):
            raise EffectError(
                f"effect '{effect.id}': {stage} gave values of shape {np.shape(value)}, "
                f"expected {expected}"
            )
        return value if self.all_rolling else without_covariate(value, neutral, self.rolling)

    def loaded(self, k: ArrayLike, n: ArrayLike, m: ArrayLike) -> LoadedRows:
        """Apply to load, wheel and soil the effects that act before the contact is solved.

        Parameters
        ----------
        k, n, m
            The soil's modulus k (Pa/m^(n+m)) and the exponents of p = k z^n D^m, each one number for all rows
            or of shape (rows,).

        Raises
        ------
        EffectError
            If the effects make a load or a diameter that is not above 0.
        """
        load = _positive("load", self.change("normal_load", self.conditions.load))
        diameter = _positive("diameter", self.change("wheel_diameter", self.conditions.diameter))
        modulus = effective_modulus(np.asarray(k), np.asarray(m), diameter)
        exponent = np.broadcast_to(np.asarray(n), modulus.shape)
        return LoadedRows(load, diameter, *self._soil(modulus, exponent))

    def on_soil(self, before: LoadedRows) -> LoadedRows:
        """Apply the effects on load, modulus and exponent to rows that other effects have changed already.

        The diameter stays. Raises EffectError where a load is not above 0.
        """
        load = _positive("load", self.change("normal_load", before.load))
        return LoadedRows(load, before.diameter, *self._soil(before.modulus, before.exponent))

    def _soil(self, modulus: Array, exponent: Array) -> tuple[Array, Array]:
        return modulus * self.product("modulus_factor"), exponent + self.total("exponent_shift")

    def pressure_factor(self, depth: Array) -> Array:
        """Product of the effects' factors on pressure. depth: m, (nodes, rows) or (rows,); the same shape."""
        return np.asarray(np.ones_like(depth) * self.product("pressure_factor", depth))

    def product(self, stage: str, *arguments: Any) -> Any:
        """Product of the effects' factors at a stage, a number or of shape (rows,); 1 if none acts.

        Parameters
        ----------
        stage
            Name of the method, such as `modulus_factor`.
        arguments
            The method's arguments before the conditions; if the first is an array, the product has its shape.

        Raises
        ------
        EffectError
            As by `call`.
        """
        calls = (self.call(e, stage, 1.0, *arguments) for e in self.acting_at(stage))
        return math.prod(calls, start=1.0)

    def total(self, stage: str, *arguments: Any) -> Any:
        """Sum of the effects' terms at a stage, in its unit, a number or of shape (rows,); 0 if none acts.

        Parameters
        ----------
        stage
            Name of the method, such as `added_resistance` (N).
        arguments
            The method's arguments before the conditions.

        Raises
        ------
        EffectError
            As by `call`.
        """
        return sum((self.call(e, stage, 0.0, *arguments) for e in self.acting_at(stage)), 0.0)

    def change(self, stage: str, value: Array) -> Array:
        """Apply each effect to a value in turn; the stages in `ROLLING_STAGES` change rolling rows only.

        A pressed body does not dig, does not compact its rut further, and has no resistance.

        Parameters
        ----------
        stage
            Name of the method, such as `sinkage`.
        value
            Value to change, SI units, shape (rows,).

        Returns
        -------
        ndarray
            The changed value, of the same unit and shape; `value` itself if no effect acts.

        Raises
        ------
        EffectError
            As by `call`.
        """
        everywhere = self.all_rolling or stage not in ROLLING_STAGES
        for effect in self.acting_at(stage):
            changed = self.call(effect, stage, value, value)
            value = changed if everywhere else np.where(self.rolling, changed, value)
        return value


def _positive(name: str, column: Array) -> Array:
    bad = np.flatnonzero(~(column > 0.0))
    if bad.size:
        raise EffectError(
            f"the effects make the {name} {column[bad[0]]:.4g} in row {bad[0] + 1}, "
            "expected a number over 0"
        )
    return column


def without_covariate(value: Any, neutral: Any, rolling: NDArray[np.bool_]) -> Any:
    """Replace NaN by the neutral result in rows of pressed wheels and plates, which may lack a covariate.

    Parameters
    ----------
    value
        Result of a method of a stage, whose last axis is the rows; NaN where a covariate is blank.
    neutral
        Result of an effect that changes nothing (`Stages.call`): a number, or an array of the result's shape.
    rolling
        Whether the row's body rolls, shape (rows,).
    """
    return np.where(~rolling & np.isnan(value), neutral, value)


def guarded(effect: Effect, stage: str, function: Callable[..., T], *arguments: Any) -> T:
    """Call an effect's method, and name the effect in any error that it raises.

    numpy's warnings are suppressed: the prediction later refuses a result that is not a number, and names row
    and setting.

    Parameters
    ----------
    effect, stage
        The effect and the name of the stage, for the message.
    function, arguments
        The method, and its arguments; its result is returned unchanged.

    Raises
    ------
    EffectError
        For whatever the method raises, but for a SmallwheelError, which is passed on unchanged.
    """
    try:
        with np.errstate(all="ignore"):
            return function(*arguments)
    except SmallwheelError:
        raise
    except Exception as error:  # a user's effect may raise anything at all
        raise EffectError(
            f"effect '{effect.id}' failed in {stage}: {type(error).__name__}: {error}"
        ) from error
