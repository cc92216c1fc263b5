# SPDX-License-Identifier: Apache-2.0
"""Kinds of arguments of the functions of `import smallwheel_ros`, and how each is typed on the command line.

A function is declared once, in its package: its annotations are kinds of this module, or of a `given.py` (of
tables, of models), and its docstring has a text for each argument. `commands.command` makes the command of
that name from both.
"""

import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from numpy.typing import ArrayLike

from smallwheel_ros.common.errors import ArgumentError
from smallwheel_ros.physics.soil import SOILS


@dataclass(frozen=True)
class Kind:
    """A kind of argument, and how it is typed on the command line.

    Attributes
    ----------
    metavar
        Word for the value in --help, such as `FILE`; None: the one that click chooses.
    type
        Python type of each value.
    within
        Lowest and highest value, both allowed, each None for no limit; None for no limits.
    several
        Whether the argument may be given several times.
    unnamed
        Whether it is typed without an option's name if it is the first argument of its function.
    names
        Names of the option, such as `-o`; empty: --NAME with the parameter's name.
    say
        Text that --help adds to that of the docstring.
    read
        Function that converts the typed text (a tuple of texts with `several`) to the function's argument,
        and may raise ArgumentError; None: the typed value is passed on.
    of_table
        Whether it is ranges or levels of settings, which are read with the units of the table.
    or_folder
        For a table: whether it may be a folder, which the function reads itself.
    """

    metavar: str | None = None
    type: type = str
    within: tuple[float | None, float | None] | None = None
    several: bool = False
    unnamed: bool = False
    names: tuple[str, ...] = ()
    say: str = ""
    read: Callable[[Any], Any] | None = None
    of_table: bool = False
    or_folder: bool = False


def unheard(*progress: object) -> None:
    """Discard progress reports."""


# --- What was typed


def understand(said: str) -> None:
    """Report on standard error how an input was interpreted, if there is anything to report."""
    if said:
        print(f"understood: {said}", file=sys.stderr, flush=True)


def refuse_given(arguments: Mapping[str, object], why: str) -> None:
    """Raise ArgumentError for the first of these optional arguments that was given, though it has no effect.

    Parameters
    ----------
    arguments
        Values by name; None and an empty collection stand for an argument that was not given.
    why
        Why it has no effect, and what to do, to follow "NAME: found VALUE".
    """
    for name, value in arguments.items():
        if value is not None and value not in ((), [], {}):
            raise ArgumentError(f"{name}: found {value!r} {why}")


def names_of(text: str) -> tuple[str, ...]:
    """Split a list of names at its commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _pairs(texts: Sequence[str]) -> dict[str, str]:
    """The texts NAME=VALUE as a dictionary. Raises ArgumentError."""
    found: dict[str, str] = {}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not (name and equals and value):
            raise ArgumentError(f"{text}: expected NAME=VALUE")
        if name in found:
            raise ArgumentError(f"{text}: '{name}' is given twice")
        found[name] = value
    return found


# --- The kinds

_Setting: TypeAlias = float | str | Sequence[float] | ArrayLike

Headers = Annotated[
    Mapping[str, str],
    Kind("NAME=HEADER", several=True, read=_pairs, say="load=F3, or with a unit 'load [kN]=F3'."),
]
Sheets = Annotated[str | int | Sequence[str | int], Kind("NAME", several=True)]
Contact = Annotated[Literal["rolling", "pressed", "plate"], Kind()]
Size = Annotated[float | str, Kind("FLOAT")]
Compliance = Annotated[float | str, Kind("M/N")]

SoilName = Annotated[str, Kind(say=", ".join(SOILS))]
Geometry = Annotated[Literal["contact_integral", "closed_form"], Kind()]

Ids = Annotated[str | Collection[str], Kind("ID,ID", read=names_of)]
EffectId = Annotated[str, Kind("ID")]

Setting = Annotated[_Setting, Kind()]
OtherSetting = Annotated[
    _Setting,
    Kind("NAME=VALUE", several=True, names=("--set",), read=_pairs,
         say="--set speed=0.1, --set 'slope=10 deg'."),
]  # fmt: skip
Levels = Annotated[
    Mapping[str, _Setting],
    Kind("NAME=A..B|A,B,C", several=True, read=_pairs, of_table=True,
         say="slip=0..60%, load=20,40,60."),
]  # fmt: skip
Flag = Annotated[bool, Kind()]
Seed = Annotated[int, Kind(type=int, within=(0, None))]
Laws = Annotated[int, Kind(type=int, within=(1, 5))]

Copy = Literal["all", "used", "none"]
Bag = Annotated[str | PathLike[str], Kind("BAG", type=Path, unnamed=True)]
Config = Annotated[str | PathLike[str], Kind("ROVER.yaml", type=Path)]
Folder = Annotated[str | PathLike[str], Kind("FOLDER", type=Path, names=("-o", "--output"))]
SoilFile = Annotated[str | PathLike[str], Kind("FILE", type=Path)]
Remaps = Annotated[
    Mapping[str, str],
    Kind("NAME:=TOPIC", several=True, names=("--remap",), say="NAME:=TOPIC, as ROS writes it."),
]
Copied = Annotated[Copy, Kind()]
Hertz = Annotated[float, Kind("HZ", type=float, within=(0.0, 1000.0))]

OwnLaws = Annotated[str | PathLike[str], Kind("FILE", type=Path)]
BagOrUrdf = Annotated[str | PathLike[str], Kind("[BAG|URDF]", type=Path, unnamed=True)]
Urdf = Annotated[str | PathLike[str], Kind("FILE", type=Path)]
Count = Annotated[int, Kind("N", type=int)]
TopicName = Annotated[str, Kind("NAME")]
Distance = Annotated[float, Kind(type=float, within=(2.0, 500.0))]
Pace = Annotated[float, Kind(type=float, within=(0.001, 1000.0))]
Seconds = Annotated[float, Kind(type=float, within=(0.0, 86400.0))]
