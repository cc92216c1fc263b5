# SPDX-License-Identifier: Apache-2.0
"""Commands made of functions of the API: names, kinds and defaults of its signature, texts of its docstring.

What the command line has otherwise is said where the command is declared, in click's own words:

    @command(api.fit, effects={"metavar": "A,B"})
    def fit(given, how): ...
"""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

from smallwheel_ros import api
from smallwheel_ros.arguments import RangeError, typed
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.options import names as names_of_list
from smallwheel_ros.measurements.columns import unit_of
from smallwheel_ros.physics.soil import soil

Function = Callable[..., Any]
Click = Mapping[str, Any]  # keywords of click.option; say: a text behind that of the docstring
PATH = click.Path(path_type=Path)


class BenchError(SmallwheelError):
    """Options that do not go together, or do not fit the table."""


def _headers(
    _context: click.Context, _option: click.Parameter, given: tuple[str, ...]
) -> dict[str, str]:
    """Header by our name, of each --map NAME=HEADER. Raises BenchError."""
    found: dict[str, str] = {}
    for text in given:
        name, equals, header = (part.strip() for part in text.partition("="))
        if not (name and equals and header):
            raise BenchError(f"--map {text}: expected NAME=HEADER, as in --map load=Fz")
        if name in found:
            raise BenchError(f"--map {text}: '{name}' is given twice")
        found[name] = header
    return found


def understand(said: str) -> None:
    """Say on standard error how something was read, where that is to be said."""
    if said:
        click.echo(f"understood: {said}", err=True)


def _number(_context: click.Context, option: click.Parameter, text: str | None) -> float | None:
    """One number in SI units, as a cell of a table: 0.2, 0,2 or '20 cm'."""
    if text is None:
        return None
    name = str(option.name)
    try:
        read = typed(name, text, _UNITS.get(name) or unit_of(name), several=False)
    except RangeError as error:
        plain = "" if any(c.isdigit() for c in text) else f"'{text}' is not a valid float: "
        raise click.BadParameter(f"{plain}{error}") from None
    if read.values.size > 1:
        raise click.BadParameter(f"found '{text}', expected one number")
    understand(read.said)
    return float(read.values[0])


def _models(context: click.Context, option: click.Parameter, given: tuple[str, ...]) -> list[Any]:
    return [_model(context, option, one) for one in given]


def _model(
    _context: click.Context, _option: click.Parameter, given: str | None
) -> str | Path | None:
    """A model's file; the name as it is where there is no such file."""
    if given is None or not Path(given).is_file():
        return given
    if given in soil:
        understand(f"--model {given} is the file of that name, not the soil of the library")
    return Path(given)


# What click needs to know of a parameter, by its annotation in the API: kinds of `arguments`, plain types.
KINDS: dict[str, Click] = {
    "Data": {"type": PATH},
    "Tests": {"type": PATH, "nargs": -1},
    "Headers": {"callback": _headers, "multiple": True, "metavar": "NAME=HEADER",
                "say": "load=F3, or with a unit 'load [kN]=F3'."},
    "AnyModel": {"callback": _model, "metavar": "FILE|SOIL"},
    "Models": {"callback": _models, "metavar": "FILE|SOIL", "multiple": True},
    "AnyEffect": {"type": str},
    "Effects": {"callback": names_of_list, "default": "", "metavar": "A,B"},
    "OwnEffects": {"type": PATH, "metavar": "FILE"},
    "Ids": {"callback": names_of_list, "default": "", "metavar": "ID,ID"},
    "Levels": {"multiple": True, "metavar": "NAME=A..B|A,B,C",
               "say": "slip=0..60%, load=20,40,60."},
    "Setting": {"type": str},
    "str": {"type": str},
    "Sheets": {"type": str, "multiple": True},
    "float": {"callback": _number, "metavar": "FLOAT"},
    "int": {"type": click.IntRange(min=0), "show_default": True},
}  # fmt: skip
_UNITS = {"compliance": "m/N"}
_OF_TABLE: dict[str, Click] = {
    "sheet": {"metavar": "NAME"},
    "diameter": {"say": "0.2, or with a unit: 20cm."},
    "width": {"say": "0.1, or with a unit: 10cm."},
    "compliance": {"metavar": "M/N"},
}


def described(function: Function) -> tuple[str, dict[str, str]]:
    """What a docstring says before its first section, and of each parameter; numpydoc."""
    doc = inspect.getdoc(function) or ""
    words, *sections = re.split(r"^(\w+)\n-+\n", doc, flags=re.MULTILINE)
    parameters = dict(zip(sections[::2], sections[1::2], strict=True)).get("Parameters", "")
    entries = re.findall(r"^(\w+)(?: : .*)?\n((?: .*\n?)+)", parameters, re.MULTILINE)
    return words.strip(), {name: " ".join(text.split()) for name, text in entries}


def _is_argument(function: Function, name: str) -> bool:
    """Whether a parameter stands on the command line without a name: data or an effect that must be given."""
    parameter = inspect.signature(function).parameters[name]
    kind_of_argument = parameter.annotation in ("Data", "Tests", "AnyEffect")
    return kind_of_argument and parameter.default is parameter.empty


def option_of(function: Function, name: str, **differs: Any) -> Callable[[Function], Function]:
    """An option for a parameter of a function; an argument where it is data or an effect that must be given.

    differs: keywords of click that are not as in `KINDS`; names: what the option is called.
    """
    parameter = inspect.signature(function).parameters[name]
    kind = str(parameter.annotation).removesuffix(" | None")
    choices = re.findall(r"'(\w+)'", kind)  # of a Literal
    how: dict[str, Any] = {"required": parameter.default is parameter.empty}
    how |= {} if how["required"] else {"default": parameter.default}
    how |= {"type": click.Choice(choices)} if choices else KINDS[kind]
    how |= differs
    if how.get("default", ...) in (None, ()):
        del how["default"]
    if _is_argument(function, name):
        return click.argument(name, **how)
    names, text = how.pop("names", ("--" + name,)), described(function)[1][name]
    if "say" in how:
        text = f"{text.removesuffix('.')}: {how.pop('say')}"
    if how.get("multiple"):
        text += " May be given several times."
    return click.option(*names, name, **{"help": text} | how)


def command(
    function: Function, *names: str, **differs: Click | None
) -> Callable[[Function], click.Command]:
    """Make a command of a body; its options are those parameters of the function, and those of the body.

    names: of the parameters; all if not given, and the function's words are the command's help, before
    those of the body. differs: by parameter, as in `option_of`; None: no option.
    The body gets `given`, the function's arguments, and, where a table is read, `how`, those of `read`.
    """
    wanted = names or tuple(inspect.signature(function).parameters)
    of_function = [n for n in wanted if n != "progress" and differs.get(n, {}) is not None]
    of_table = []
    if "data" in of_function:
        of_table = [n for n in inspect.signature(api.read).parameters if n != "data"]

    def made(body: Function) -> click.Command:
        @functools.wraps(body)
        def parted(**options: Any) -> Any:
            own = {"given": {name: options.pop(name) for name in of_function}}
            if of_table:
                own["how"] = {name: options.pop(name) for name in of_table}
            return body(**own, **options)

        run: Function = parted
        for name in reversed(of_table):
            run = option_of(api.read, name, **_OF_TABLE.get(name, {}))(run)
        for name in reversed(of_function):
            run = option_of(function, name, **(differs.get(name) or {}))(run)
        words, texts = described(function)
        arguments = [f"{n.upper()}: {texts[n]}" for n in of_function if _is_argument(function, n)]
        own_words = inspect.getdoc(body) or ""
        said = own_words if names else "\n\n".join([words, *arguments, own_words])
        return click.command(help=said)(run)

    return made
