# SPDX-License-Identifier: Apache-2.0
"""The base class of physical effects, and the stages at which an effect changes a prediction.

An effect is a small frozen dataclass: its fields are its parameters, its methods are the stages at
which it changes the model's computation. A model runs the stages in this order, each effect in
turn:

    corrected_load      the load itself, from what the load cell shows        N      -> N
      (from here on `conditions.load` is the load itself, for every effect)
    normal_load         the load that reaches the soil                        N      -> N
    wheel_diameter      the diameter that the soil meets                      m      -> m
    modulus_factor      multiplies k                                          1
    exponent_shift      is added to n                                         1
    pressure_factor     multiplies the pressure by a function of depth        1
      (the model finds the static sinkage, at which pressure carries the load)
    sinkage             the sinkage, from the static one                      m      -> m
    compaction_sinkage  the depth to which soil is compacted (by default changed as the sinkage)  m -> m
    added_resistance    is added to the compaction resistance                 N
    thrust_factor       multiplies thrust and torque                          1
    measured_sinkage    what the instrument shows of the sinkage              m      -> m
    measured_resistance what the instrument shows of the resistance           N      -> N

Drawbar pull and torque follow from load and sinkage (`physics.stresses`), whatever the instrument shows of
the resistance: an effect that deepens the rut leaves their balance alone.

Each takes the conditions, and before them the value that it changes, the depths (`pressure_factor`) or the
`WheelState` (`added_resistance`, `thrust_factor`). It returns shape (rows,) or one number; `pressure_factor`
the shape of the depths, (nodes, rows) or (rows,).

Override only what the effect changes. To write your own, copy a file of this folder, or see
docs/your_own_effect.md.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]

_ALL_CHANNELS = ("sinkage", "resistance", "drawbar_pull", "torque")
# The channels that each stage changes; the stages in the order in which a model runs them.
_CHANNELS = {
    "corrected_load": _ALL_CHANNELS,
    "normal_load": _ALL_CHANNELS,
    "wheel_diameter": _ALL_CHANNELS,
    "modulus_factor": _ALL_CHANNELS,
    "exponent_shift": _ALL_CHANNELS,
    "pressure_factor": _ALL_CHANNELS,
    "sinkage": _ALL_CHANNELS,
    "compaction_sinkage": ("resistance",),
    "added_resistance": ("resistance", "drawbar_pull"),
    "thrust_factor": ("drawbar_pull", "torque"),
    "measured_sinkage": ("sinkage",),
    "measured_resistance": ("resistance",),
}
STAGES = tuple(_CHANNELS)
# Stages that a body pressed straight down does not have: it neither digs nor pulls.
ROLLING_STAGES = (
    "sinkage",
    "compaction_sinkage",
    "added_resistance",
    "thrust_factor",
    "measured_resistance",
)


class EffectError(SmallwheelError):
    """An effect that does not exist, cannot be loaded or fails, or whose number is outside its domain."""


@dataclass(frozen=True)
class Parameter:
    """Description of one parameter of an effect, or of one constant.

    Attributes
    ----------
    name, description
        Name of the field in the effect's class, and what the number is, in a few words.
    start, bounds
        Value where a fit starts (of a constant: the default), and the range that it may have, both ends
        allowed, in `unit`.
    published
        Range that the literature gives, in `unit`; None where there is none.
    unit
        SI unit; "1" for a pure number.
    neutral
        The value at which the effect is absent; None for a parameter that only shapes it. An effect
        vanishes if all parameters with a neutral value are at that value.
    """

    name: str
    start: float
    bounds: tuple[float, float]
    published: tuple[float, float] | None
    unit: str
    description: str
    neutral: float | None = None


def parameter(
    start: float,
    bounds: tuple[float, float],
    description: str,
    *,
    unit: str = "1",
    published: tuple[float, float] | None = None,
    neutral: float | None = 0.0,
) -> Any:  # a dataclass field stands for a value of its annotated type
    """Declare a number that a fit determines: `a: float = parameter(1.0, (0.0, 8.0), "growth")`.

    Parameters
    ----------
    start
        Value where a fit starts, in `unit`; the field's default.
    bounds
        Range that a fit may reach, in `unit`, both ends allowed.
    description
        What the number is, in a few words.
    unit
        SI unit; "1" for a pure number.
    published
        Range that the literature gives, in `unit` (outside it a fitted value is called implausible); None
        where there is none.
    neutral
        The value at which the effect is absent; None for a parameter that only shapes it.

    Returns
    -------
    dataclasses.Field
        Its metadata has the description, a `Parameter`.
    """
    known = Parameter("", float(start), bounds, published, unit, description, neutral)
    return field(default=known.start, metadata={"parameter": known})


def constant(
    value: float, bounds: tuple[float, float], description: str, *, unit: str = "1"
) -> Any:  # as above
    """Declare a number that is given, not fitted: a reference load, a soil's unit weight.

    Parameters
    ----------
    value
        The field's default, in `unit`.
    bounds
        Range that it may have, in `unit`, both ends allowed.
    description
        What the number is, in a few words.
    unit
        SI unit; "1" for a pure number.

    Returns
    -------
    dataclasses.Field
        Its metadata has the description, a `Parameter`.
    """
    known = Parameter("", float(value), bounds, None, unit, description)
    return field(default=known.start, metadata={"constant": known})


class WheelState(NamedTuple):
    """Wheels at the sinkage that was solved for, and their soil; arrays of shape (rows,).

    Attributes
    ----------
    load
        Load that reaches the soil, N.
    diameter, width
        Size of the wheel as the soil meets it, m.
    sinkage
        Sinkage, effects included, m.
    modulus, exponent
        K = k D^m times the effects' factors, Pa/m^n, and n with the effects' shifts.
    cohesion, friction_angle
        Strength of the soil, Pa, rad.
    """

    load: Array
    diameter: Array
    width: Array
    sinkage: Array
    modulus: Array
    exponent: Array
    cohesion: Array
    friction_angle: Array


@dataclass(frozen=True)
class Effect:
    """Base of every effect: class attributes describe it, fields are its numbers.

    Fields are made by `parameter` (fitted) and `constant` (given). Where a class does not state them, `form`
    follows from its name, `stage` and `channels` from the stages that it overrides, and `drivers` from its
    `needs`. A number outside its bounds raises EffectError.

    Attributes
    ----------
    id
        Name of the physical idea, such as `slip_sinkage`, which all its forms share.
    form
        Name of the published form of the idea that this class is.
    summary, formula, source
        What the effect does, in one sentence; its formula; where the formula comes from. Texts to be shown.
    needs
        Covariates that it reads.
    channels
        Measured quantities that it changes.
    stage, acts
        The first of the stages (`STAGES`) that it overrides, and all of them in their order.
    kind
        `instrument` for a fault of an instrument, which is never reported as physics of the soil.
    drivers
        Settings that its strength follows: load, diameter, width, or covariates of `needs`.
    side
        1 where it acts only for values of its first driver over 0, -1 only for those under 0; else 0.
    idle
        Reason why it does nothing on a table in which the first of `needs` is 0 in every row; empty where it
        acts at 0, too.
    next_step
        One sentence to be shown: what to measure or to check in order to tell it from other effects.
    geometry
        For an effect that is a rule of contact: the geometry of a model to which it is added. Else empty.
    learnt_from
        SHA-256 of the table that the law was learnt from, which is no evidence for it; empty for a published
        law.
    known_physics
        Whether a model always applies it where its columns are present, so that it is never a finding.
    """

    id: ClassVar[str] = ""
    form: ClassVar[str] = ""
    summary: ClassVar[str] = ""
    formula: ClassVar[str] = ""
    source: ClassVar[str] = ""
    needs: ClassVar[tuple[str, ...]] = ()
    channels: ClassVar[tuple[str, ...]] = ()
    stage: ClassVar[str] = ""
    kind: ClassVar[Literal["soil", "instrument"]] = "soil"
    drivers: ClassVar[tuple[str, ...]] = ()
    side: ClassVar[Literal[-1, 0, 1]] = 0
    idle: ClassVar[str] = ""
    next_step: ClassVar[str] = ""
    geometry: ClassVar[str] = ""
    learnt_from: ClassVar[str] = ""
    known_physics: ClassVar[bool] = False
    acts: ClassVar[tuple[str, ...]] = ()
    _drivers_stated: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        own = vars(cls)
        if "drivers" in own:
            cls._drivers_stated = True
        elif not cls._drivers_stated:
            cls.drivers = cls.needs
        cls.acts = tuple(s for s in STAGES if getattr(cls, s) is not getattr(Effect, s))
        if "form" not in own:
            cls.form = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", cls.__name__).lower()
        if "stage" not in own:
            cls.stage = cls.acts[0] if cls.acts else ""
        if "channels" not in own:
            touched = {name for stage in cls.acts for name in _CHANNELS[stage]}
            cls.channels = tuple(name for name in _ALL_CHANNELS if name in touched)

    def __post_init__(self) -> None:
        for f in fields(self):
            known = f.metadata.get("parameter") or f.metadata.get("constant")
            if known is None:
                continue
            value, (low, high) = getattr(self, f.name), known.bounds
            number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
            if not (number and np.isfinite(value) and low <= value <= high):
                raise EffectError(
                    f"effect '{self.id}': {f.name} is {value!r}, "
                    f"expected {low:g} to {high:g} [{known.unit}]"
                )

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        """The parameters, which a fit determines, in the order of the fields."""
        known = [(f.name, f.metadata.get("parameter")) for f in fields(cls)]
        return tuple(replace(p, name=name) for name, p in known if p is not None)

    @classmethod
    def constants(cls) -> tuple[Parameter, ...]:
        """The constants, which are given, in the order of the fields."""
        known = [(f.name, f.metadata.get("constant")) for f in fields(cls)]
        return tuple(replace(p, name=name) for name, p in known if p is not None)

    def values(self) -> Iterator[tuple[str, float]]:
        """Yield name and value of each parameter, in its unit; constants are not among them."""
        for known in self.parameters():
            yield known.name, float(getattr(self, known.name))

    @classmethod
    def suited_to(cls, conditions: Conditions) -> Effect:
        """The effect from which a fit to these rows starts; a form may take reference values from them."""
        return cls()

    def objection(self, conditions: Conditions) -> str:
        """Why this form cannot be used on these rows; empty if it can."""
        return ""

    def caution(self, conditions: Conditions) -> str:
        """A sentence on rows outside the range in which the effect is known to hold; empty if none is."""
        return ""

    @classmethod
    def never_acts(cls, conditions: Conditions) -> str:
        """Why this form has no influence on any of these rows; empty if it has on some.

        The base decides by `needs`, `side`, `idle` and the stages. A form that can decide better, by the
        size of the slip for example, overrides this and calls the base first.
        """
        if not cls._reached(conditions).any():
            return "it acts on rolling wheels, and no row is of one"
        for name in cls.needs:
            if name not in conditions:
                return f"the data has no column '{name}'"
            if not cls.values_met(name, conditions).size:
                return f"column '{name}' is blank in every row that it acts on"
        if cls.side and cls.drivers:
            driver = cls.drivers[0]
            if not (cls.side * cls.values_met(driver, conditions) > 0.0).any():
                return f"no row has {driver} {'over' if cls.side > 0 else 'under'} 0"
        if cls.idle and cls.needs and not cls.values_met(cls.needs[0], conditions).any():
            return cls.idle
        return ""

    @classmethod
    def values_met(cls, name: str, conditions: Conditions) -> Array:
        """A column's values in the rows that the effect can act on, without blanks; shape (values,).

        Parameters
        ----------
        name
            Name of the column, which the conditions must have.
        conditions
            Settings, SI units, shape (rows,) each.
        """
        values = conditions[name][cls._reached(conditions)]
        return np.asarray(values[np.isfinite(values)])

    @classmethod
    def _reached(cls, conditions: Conditions) -> NDArray[np.bool_]:
        """Rows that it can act on: the rolling ones if all its stages are for those alone, else every row."""
        everywhere = not cls.acts or any(stage not in ROLLING_STAGES for stage in cls.acts)
        return np.ones(len(conditions), dtype=bool) if everywhere else conditions.rolling

    def corrected_load(self, load: Array, conditions: Conditions) -> Array:
        """Return the load itself (N, shape (rows,)), given the load that the load cell shows.

        Parameters
        ----------
        load
            Load that the load cell shows, N, shape (rows,).
        conditions
            Settings of the rows, SI units.
        """
        return load

    def normal_load(self, load: Array, conditions: Conditions) -> Array:
        """Return the load that reaches the soil, N, shape (rows,).

        Parameters
        ----------
        load
            Load of the wheel, N, shape (rows,).
        conditions
            Settings of the rows, SI units.
        """
        return load

    def wheel_diameter(self, diameter: Array, conditions: Conditions) -> Array:
        """Return the diameter that the soil meets, m, shape (rows,).

        Parameters
        ----------
        diameter
            Diameter of the wheel, m, shape (rows,).
        conditions
            Settings of the rows, SI units.
        """
        return diameter

    def modulus_factor(self, conditions: Conditions) -> Array | float:
        """Return the factor on the soil's modulus k, shape (rows,) or one number."""
        return 1.0

    def exponent_shift(self, conditions: Conditions) -> Array | float:
        """Return what is added to the soil's exponent n, shape (rows,) or one number."""
        return 0.0

    def pressure_factor(self, depth: Array, conditions: Conditions) -> Array:
        """Return the factor on the soil's pressure at some depths, in the shape of `depth`.

        Parameters
        ----------
        depth
            Depths below the surface, m, shape (nodes, rows) or (rows,).
        conditions
            Settings of the rows, SI units.
        """
        return np.ones_like(depth)

    def sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        """Return the sinkage of the wheel (m, shape (rows,)), given the static one.

        Parameters
        ----------
        sinkage
            Sinkage at which the pressure carries the load, changed by earlier effects, m, shape (rows,).
        conditions
            Settings of the rows, SI units.
        """
        return sinkage

    def compaction_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        """Return the depth to which soil is compacted (m, shape (rows,)), by default as `sinkage`.

        Parameters
        ----------
        sinkage
            Static sinkage, changed by earlier effects, m, shape (rows,).
        conditions
            Settings of the rows, SI units.
        """
        return self.sinkage(sinkage, conditions)

    def added_resistance(self, state: WheelState, conditions: Conditions) -> Array | float:
        """Return what is added to the compaction resistance, N, shape (rows,) or one number.

        Parameters
        ----------
        state
            Load, wheel, sinkage and soil of each row.
        conditions
            Settings of the rows, SI units.
        """
        return 0.0

    def thrust_factor(self, state: WheelState, conditions: Conditions) -> Array | float:
        """Return the factor on thrust and torque, shape (rows,) or one number.

        Parameters
        ----------
        state
            Load, wheel, sinkage and soil of each row.
        conditions
            Settings of the rows, SI units.
        """
        return 1.0

    def measured_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        """Return what the instrument shows of the sinkage, m, shape (rows,).

        Parameters
        ----------
        sinkage
            True sinkage, m, shape (rows,).
        conditions
            Settings of the rows, SI units.
        """
        return sinkage

    def measured_resistance(self, resistance: Array, conditions: Conditions) -> Array:
        """Return what the instrument shows of the resistance, N, shape (rows,).

        Parameters
        ----------
        resistance
            True resistance, N, shape (rows,).
        conditions
            Settings of the rows, SI units.
        """
        return resistance


# Soil that the wheel carried away may or may not have cost compaction work. A law of digging therefore has
# a form in which the data decides.
Form = TypeVar("Form", bound=type[Effect])


def partly_dug(form: Form) -> Form:
    """Make a variant of a form in which only a share c of the added sinkage (in ln) compacts soil.

    c is a further parameter: at 1 all of the added sinkage adds compaction resistance, at 0 none of it does.
    The new class belongs to the module of the given one; its `form` is `partly_dug_FORM`, FORM that of the
    given one.
    """

    def compaction_sinkage(self: Any, sinkage: Array, conditions: Conditions) -> Array:
        grown = self.sinkage(sinkage, conditions) / np.maximum(sinkage, 1e-12)
        return np.asarray(sinkage * grown**self.c)

    name = f"PartlyDug{form.__name__}"
    share = parameter(
        0.5, (0.0, 1.0), "share of the growth (in ln) that costs compaction", neutral=None
    )
    own = {
        "form": f"partly_dug_{form.form}",
        "formula": f"{form.formula}; compaction resistance at z0 (z / z0)^c",
        "source": f"{form.source}; partly dug",
        "compaction_sinkage": compaction_sinkage,
        "c": share,
        "__annotations__": {"c": "float"},
        "__module__": form.__module__,
        "__qualname__": name,
    }
    made: Any = dataclass(frozen=True)(type(name, (form,), own))
    return made  # type: ignore[no-any-return]
