# SPDX-License-Identifier: Apache-2.0
"""Settings of a simulated rig or drive, hidden effects included: options, their ranges, and their checks.

The name of an effect may be followed by its amplitude, in the SI unit of its formula: `load_offset=-4`.
The amplitude is then not drawn, and `strength` does not apply to it.
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
    """An impossible simulation; the message names the setting, what was given, and what was expected."""


def check_range(name: str, value: float, low: float, high: float, unit: str = "") -> None:
    """Raise SimulationError unless a setting is a finite number within its bounds, both allowed.

    Parameters
    ----------
    name
        Name of the setting, for the message.
    value
        The setting.
    low, high
        Bounds of the setting, in its unit.
    unit
        Unit of the setting, for the message; empty for a pure number.
    """
    if not (math.isfinite(value) and low <= value <= high):
        unit = f" {unit}" if unit else ""
        raise SimulationError(
            f"{name} is {value}: expected a number from {low:g} to {high:g}{unit}"
        )


# --- Hidden effects

_MOISTURE = "moisture"  # short for `column:moisture`
_COLUMN = "column:"
# Unit in the header, lowest and highest value. Other columns are pure numbers between 0.5 and 1.5.
_KNOWN_COLUMNS = {
    _MOISTURE: ("", 0.02, 0.14),
    "density": ("kg/m^3", 1400.0, 1700.0),
    "temperature": ("K", 268.0, 308.0),
}
# Columns of every measurements table: none of them can be the extra column of a hidden effect.
_CONTRACT_COLUMNS = frozenset([
    "load", "diameter", "width", "sinkage", "resistance", "drawbar_pull", "torque",
    "sinkage_std", "resistance_std", "drawbar_pull_std", "torque_std", "slip", "slip_angle", "slope",
    "speed", "pass_number", "gravity", "grouser_height", "contact", "soil", "run", "wheel", "hidden",
])  # fmt: skip


def hidden_names() -> tuple[str, ...]:
    """Names that `--hidden` takes; of `column:NAME`, NAME is any name of a column."""
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
FRACTION = {"metavar": "FRACTION"}  # words of an option that is a share, 0 to 1


def check_settings(settings: Any) -> tuple[str, ...]:
    """Check all settings that are options, and return the hidden effects without `none`.

    settings: `DriveSettings` or `RigSettings`. Raises SimulationError for a value that is not allowed.
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
    """Check effects as typed (`NAME` or `NAME=SIZE`), and return them without `none`.

    Raises SimulationError for one that is unknown, given twice, or given together with `none`.
    """
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
    """A hidden effect as asked for by its text, `NAME` or `NAME=SIZE`.

    Attributes
    ----------
    name
        Name of the effect.
    column
        The extra column that drives it; None if it has none.
    size
        Its amplitude, in the SI unit of its formula; None if it is to be drawn.
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
    """Whether an effect, `NAME` or `NAME=SIZE`, can be in a drive.

    A drive's bag lacks sensors for what some effects depend on or change.
    """
    name, column, _ = Asked.of(text)
    if column is not None:
        return False
    law = EFFECTS[name]
    return not law.needs and law.stage not in ("shown_load", "shown_resistance")


def extra_column(column: str) -> tuple[str, float, float]:
    """Unit of an extra column (empty for a pure number), its lowest and its highest value, in that unit."""
    return _KNOWN_COLUMNS.get(column, ("", 0.5, 1.5))


def draw_effects(
    hidden: Sequence[str], rng: np.random.Generator, strength: float = 1.0
) -> tuple[HiddenEffect, ...]:
    """Draw the amplitudes and other numbers of hidden effects.

    Parameters
    ----------
    hidden
        Effects as typed on the command line: `NAME` or `NAME=SIZE`, the amplitude in its formula's SI unit.
    rng
        Random number generator for the draws.
    strength
        Factor on the typical amplitudes; it does not change an amplitude that is given.

    Returns
    -------
    tuple of HiddenEffect
        In the order of `hidden`, `none` left out.

    Raises
    ------
    SimulationError
        If an effect is unknown, given twice, or given together with `none`.
    """
    texts = check_hidden(hidden)
    return tuple(_drawn(Asked.of(text), rng, strength) for text in texts)


def _drawn(asked: Asked, rng: np.random.Generator, strength: float) -> HiddenEffect:
    """Draw the numbers of one effect; the amplitude within 15 % of the typical one unless it is given.

    Where another number of the effect is drawn, the amplitude is exactly the typical one times `strength`.
    """
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
    """A soil from `start` (m along the path) to the start of the next stretch."""

    start: float
    soil: TruthSoil


@dataclass(frozen=True)
class DriveSettings:
    """Settings of a simulated drive: the options of `smallwheel simulate drive`, and a few for Python only.

    The same settings give the same drive, to the byte.

    Attributes
    ----------
    seed
        Selects the random numbers, 0 or more.
    distance, speed
        Distance to drive, m, and mean speed, m/s.
    wheels
        Name of a rover of `ROVERS`, or a rover of your own.
    terrain
        `single` soil, or `mixed`: three in turn.
    stretches
        Soils of your own, in place of `terrain`; None for none.
    sensors
        Sensors of the rover; their `noise_factor` and `outliers` are replaced by `noise` and `outliers`.
    finish
        Ground after the distance on which the rover gets stuck: a steepening `slope`, `slippery`, or `none`.
    hidden
        Hidden effects, each `NAME` or `NAME=SIZE`.
    strength
        Factor on the amplitudes of hidden effects whose size is not given.
    noise
        Factor on the noise of every sensor.
    outliers
        Share of sinkages that are grossly wrong, 0 to 0.5.
    dropouts
        Share of load and sinkage messages that are missing, 0 to 0.9; above 0 one wheel's sinkage is also
        missing for 1.5 s.
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
        """Check the settings, and return them without `none` among the hidden effects.

        Raises SimulationError, which names the setting, its value, and what was expected.
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
    """Settings of a simulated table of rig measurements: the options of `smallwheel simulate rig`.

    The same settings give the same table, to the byte.

    Attributes
    ----------
    seed
        Selects the random numbers, 0 or more.
    hidden
        Hidden effects, each `NAME` or `NAME=SIZE`: ``"load_offset=-4"``.
    strength
        Factor on the amplitudes of hidden effects whose size is not given.
    runs, rows_per_run
        Number of runs, each at one value of every setting, and of rows in each, which repeat it.
    noise
        Standard deviation of each channel's noise over its value; the channels' small absolute noise and the
        errors of measured load, slip and speed are proportional to it.
    soil_scatter
        Standard deviation of ln k from run to run.
    channels
        Measured quantities, names of `CHANNELS`.
    tie
        Two settings that are varied together, with a correlation of about 0.99; empty for none.
    outliers
        Share of rows in which one channel is grossly wrong, 0 to 0.5.
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
        """Check the settings, and return them without `none` among the hidden effects.

        Raises SimulationError, which names the setting, its value, and what was expected.
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
