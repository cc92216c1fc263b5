# SPDX-License-Identifier: Apache-2.0
"""Which rig or drive to simulate, and with which hidden effects: options, their ranges, and refusals.

The name of an effect may include its size, in SI units of its formula: `load_offset=-4`. Its
numbers are then not drawn, and `strength` does not apply to it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, is_dataclass, replace
from typing import Annotated, Any, NamedTuple

import numpy as np

from smallwheel_ros.common.errors import SmallwheelError, nearest
from smallwheel_ros.simulate.hidden import EFFECTS, OF_COLUMN, HiddenEffect
from smallwheel_ros.simulate.options import Option, options_of
from smallwheel_ros.simulate.truth import TruthSoil
from smallwheel_ros.simulate.world import ROVERS, Sensors, SimulatedRover


class SimulationError(SmallwheelError):
    """An impossible simulation: which setting, what was given, what was expected."""


def check_range(name: str, value: float, low: float, high: float, unit: str = "") -> None:
    """Check that a setting is a finite number within its bounds, both allowed.

    Parameters
    ----------
    name
        Name of the setting, for the message.
    value
        The setting.
    low, high
        Bounds of the setting, in its unit.
    unit
        Unit of the setting, for the message.

    Raises
    ------
    SimulationError
        If it is not.
    """
    if not (math.isfinite(value) and low <= value <= high):
        unit = f" {unit}" if unit else ""
        raise SimulationError(
            f"{name} is {value}: expected a number from {low:g} to {high:g}{unit}"
        )


# --- Hidden effects

_MOISTURE = "moisture"  # a column like any other, only better known
_COLUMN = "column:"
# Unit in the header, low, high. Others are pure numbers between 0.5 and 1.5.
_KNOWN_COLUMNS = {
    _MOISTURE: ("", 0.02, 0.14),
    "density": ("kg/m^3", 1400.0, 1700.0),
    "temperature": ("K", 268.0, 308.0),
}
# Columns that a measurements table knows: no effect can be driven by an extra one of that name.
_CONTRACT_COLUMNS = frozenset([
    "load", "diameter", "width", "sinkage", "resistance", "drawbar_pull", "sinkage_std",
    "resistance_std", "drawbar_pull_std", "slip", "slip_angle", "slope", "speed", "pass_number",
    "grouser_height", "contact", "soil", "run", "wheel", "hidden",
])  # fmt: skip


def hidden_names() -> tuple[str, ...]:
    """Everything that `--hidden` takes."""
    return ("none", *EFFECTS, _MOISTURE, f"{_COLUMN}NAME")


Seed = Annotated[int, Option("Same seed, same data.", (0, 2**63 - 1))]
Strength = Annotated[float, Option("Factor on the size of the hidden effects.", (0.0, 10.0))]
Hidden = Annotated[
    tuple[str, ...],
    Option(
        f"Effects and faults of instruments in the truth: {', '.join(hidden_names())}."
        " With a size, that is its amplitude in SI units: load_offset=-4.",
        words={"default": "none", "metavar": "EFFECT[=SIZE][,EFFECT]"},
    ),
]
FRACTION = {"metavar": "FRACTION"}  # of options that are a share


def check_settings(settings: Any) -> tuple[str, ...]:
    """The hidden effects of the settings, without `none`.

    Raises SimulationError that names the setting, what was given, and what was expected.
    """
    for name, option in options_of(type(settings)).items():
        value, within = getattr(settings, name), option.within
        if within and not isinstance(within[0], str):
            check_range(name.replace("_", " "), value, *within)
        elif within and value not in within and not is_dataclass(value):  # not a rover of your own
            raise SimulationError(
                f"{name} {value!r} is unknown: expected one of {', '.join(within)}"
            )
    return check_hidden(settings.hidden)


def check_hidden(texts: Sequence[str]) -> tuple[str, ...]:
    """Return the effects without `none`; raise `SimulationError` for unknown ones."""
    asked = [Asked.of(text) for text in texts]
    for name, column, _ in asked:
        if column in _CONTRACT_COLUMNS:
            raise SimulationError(
                f"hidden effect {name!r}: a column {column!r} has a meaning of its own already;"
                " take another name"
            )
        if not (name in ("none", *EFFECTS) if column is None else column.isidentifier()):
            known = nearest(name, list(hidden_names()))
            raise SimulationError(f"hidden effect {name!r} is unknown: {known}")
    if "none" in texts and len(texts) > 1:
        raise SimulationError("hidden effect 'none' together with others: give either")
    if len({one.column or one.name for one in asked}) < len(asked):
        names = ", ".join(one.name for one in asked)
        raise SimulationError(f"hidden effects {names}: one of them is given twice")
    return tuple(text for text in texts if text != "none")


class Asked(NamedTuple):
    """A requested hidden effect.

    Attributes
    ----------
    name
        Name of the effect.
    column
        The extra column that drives it; None if it has none.
    size
        Its size, in the SI unit of its formula; None if it is to be drawn.
    """

    name: str
    column: str | None
    size: float | None

    @classmethod
    def of(cls, text: str) -> Asked:
        """Read ``NAME`` or ``NAME=SIZE``. Raises SimulationError where the size is no number."""
        name, equals, size = text.partition("=")
        of_column = name == _MOISTURE or name.startswith(_COLUMN)
        column = name.removeprefix(_COLUMN) if of_column else None
        if not equals:
            return cls(name, column, None)
        if name == "none":
            raise SimulationError(f"hidden effect {text!r}: 'none' has no size")
        try:
            number = float(size)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise SimulationError(
                f"hidden effect {text!r}: its size is {size!r}, expected a number, as in {name}=0.1"
            )
        return cls(name, column, number)


def in_drives(text: str) -> bool:
    """Whether a drive's bag has sensors for what an effect depends on and for what it changes."""
    name, column, _ = Asked.of(text)
    if column is not None:
        return False
    law = EFFECTS[name]
    return not law.needs and law.stage not in ("shown_load", "shown_resistance")


def extra_column(column: str) -> tuple[str, float, float]:
    """Unit of an extra column in the header, empty for a pure number, and its range."""
    return _KNOWN_COLUMNS.get(column, ("", 0.5, 1.5))


def draw_effects(
    hidden: Sequence[str], rng: np.random.Generator, strength: float = 1.0
) -> tuple[HiddenEffect, ...]:
    """Draw the numbers of the named effects, in that order.

    Parameters
    ----------
    hidden
        Effects as typed on the command line: `NAME` or `NAME=SIZE`.
    rng
        Random number generator for the draws.
    strength
        Factor on the typical amplitudes, 1.

    Returns
    -------
    tuple of HiddenEffect
        In the order of `hidden`.

    Raises
    ------
    SimulationError
        If an effect is unknown or asked for wrongly.
    """
    texts = check_hidden(hidden)
    return tuple(_drawn(Asked.of(text), rng, strength) for text in texts)


def _drawn(asked: Asked, rng: np.random.Generator, strength: float) -> HiddenEffect:
    """Draw an effect of about the typical size (within 15 %), or of that size and its numbers."""
    name, column, size = asked
    law = EFFECTS[name] if column is None else OF_COLUMN
    amplitude = strength * law.typical
    between = {key: at for key, at in law.numbers.items() if isinstance(at, tuple)}
    if law.either_sign and rng.uniform() >= 0.5:
        amplitude = -amplitude
    if not between:
        amplitude *= rng.uniform(0.85, 1.15)
    numbers = {**law.numbers, **{key: rng.uniform(*ends) for key, ends in between.items()}}
    if column is not None:
        name, (_, low, high) = "column", extra_column(column)
        numbers = {"column": column, "centre": (low + high) / 2, "half_range": (high - low) / 2}
    return HiddenEffect(name, law, amplitude if size is None else size, numbers)


# --- Drives

TERRAINS = ("mixed", "single")
FINISHES = ("none", "slope", "slippery")
SENSORS = Sensors(
    torque=True, pull=True, sinkage_told=0.03, load_rate=50.0, joint_rate=50.0, encoder_steps=(30_000,),
    odometry_rate=(30.0,), pitch=True,
)  # fmt: skip


@dataclass(frozen=True)
class Stretch:
    """A soil from `start` (m along the path) to the next stretch."""

    start: float
    soil: TruthSoil


@dataclass(frozen=True)
class DriveSettings:
    """What drive to simulate: the options of `smallwheel simulate drive`.

    The same seed gives the same drive, to the byte. `wheels` may be a rover of your own; `stretches`,
    if given, replace `terrain`; `sensors` may be your own too, with noise and share of outliers from
    the settings. After `distance`, a `finish` gets the rover stuck: a slope that steepens, or slippery
    ground. With dropouts above 0 one wheel's sinkage is also missing for 1.5 s.
    """

    seed: Seed = 0
    distance: Annotated[float, Option("Distance, m.", (2.0, 20_000.0, "m"))] = 30.0
    speed: Annotated[float, Option("Mean speed, m/s.", (0.01, 3.0, "m/s"))] = 0.5
    wheels: Annotated[
        str | SimulatedRover, Option(f"One of {', '.join(ROVERS)}.", tuple(ROVERS))
    ] = "four"
    terrain: Annotated[str, Option(f"{' or '.join(TERRAINS)} soil.", TERRAINS)] = "mixed"
    stretches: tuple[Stretch, ...] | None = None
    sensors: Sensors = SENSORS
    finish: Annotated[
        str, Option(f"What the drive gets stuck on at its end: {', '.join(FINISHES)}.", FINISHES)
    ] = "none"
    hidden: Hidden = ()
    strength: Strength = 1.0
    noise: Annotated[float, Option("Factor on every sensor's noise.", (0.0, 20.0))] = 1.0
    outliers: Annotated[
        float, Option("Share of measured sinkages that are grossly wrong.", (0.0, 0.5), FRACTION)
    ] = 0.0
    dropouts: Annotated[
        float, Option("Share of load and sinkage messages that are missing.", (0.0, 0.9), FRACTION)
    ] = 0.01

    def check(self) -> DriveSettings:
        """Return the settings without `none` among the hidden effects.

        Raises SimulationError, naming the setting, what it was, and what was expected.
        """
        hidden = check_settings(self)
        for name in hidden:
            if not in_drives(name):
                raise SimulationError(
                    f"hidden effect {name!r} cannot be in a drive: what it depends on or acts on"
                    " has no sensor there; use `simulate rig`"
                )
        return replace(self, hidden=hidden)


# --- Rigs

TYPICAL_NOISE = 0.03
CONTINUOUS = ("load", "slip", "speed")
# By name, in the order of the table: header and factor from SI.
CHANNELS = {
    "sinkage": ("sinkage [mm]", 1e3),
    "resistance": ("resistance [N]", 1.0),
    "drawbar_pull": ("drawbar_pull [N]", 1.0),
    "torque": ("torque [N m]", 1.0),
}


@dataclass(frozen=True)
class RigSettings:
    """What table to simulate: the options of `smallwheel simulate rig`.

    The same seed gives the same table, to the byte. A hidden effect can carry its size:
    ``"load_offset=-4"``. A run is one setting of everything, its rows are repeats of it. Noise and
    scatter are standard deviations: of the channels, relative (their small absolute noise and the
    errors of measured load, slip and speed grow with it), and of ln k from run to run. A tie drives
    two settings together, r about 0.99.
    """

    seed: Seed = 0
    hidden: Hidden = ()
    strength: Strength = 1.0
    runs: Annotated[int, Option(within=(1, 100_000))] = 32
    rows_per_run: Annotated[int, Option("Repeats of each run's setting.", (1, 1000))] = 3
    noise: Annotated[float, Option("Relative noise of the channels.", (0.0, 0.5))] = TYPICAL_NOISE
    soil_scatter: Annotated[
        float, Option("Relative scatter of the soil's k from run to run.", (0.0, 1.0))
    ] = 0.05
    channels: Annotated[
        tuple[str, ...],
        Option(f"What is measured: {', '.join(CHANNELS)}.", words={"metavar": "NAME[,NAME]"}),
    ] = ("sinkage", "resistance")
    tie: Annotated[
        tuple[str, ...],
        Option(
            f"Two settings driven together: {', '.join(CONTINUOUS)}, an extra column.",
            words={"metavar": "NAME,NAME", "show_default": False},
        ),
    ] = ()
    outliers: Annotated[
        float,
        Option("Share of rows in which one channel is grossly wrong.", (0.0, 0.5), FRACTION),
    ] = 0.0

    def check(self) -> RigSettings:
        """Return the settings without `none` among the hidden effects.

        Raises SimulationError, naming the setting, what it was, and what was expected.
        """
        hidden = check_settings(self)
        wrong = [name for name in self.channels if name not in CHANNELS]
        if wrong or not self.channels or len(set(self.channels)) < len(self.channels):
            raise SimulationError(
                f"channels are {','.join(self.channels) or 'empty'}: expected one or more of"
                f" {', '.join(CHANNELS)}, each once"
            )
        columns = [column for text in hidden if (column := Asked.of(text).column) is not None]
        for name in self.tie:
            if name not in (*CONTINUOUS, *columns):
                known = nearest(name, [*CONTINUOUS, *columns])
                raise SimulationError(f"tied setting {name!r} cannot be tied: {known}")
        if self.tie and (len(self.tie) != 2 or self.tie[0] == self.tie[1]):
            raise SimulationError(f"tie is {','.join(self.tie)}: expected two different settings")
        return replace(self, hidden=hidden)
