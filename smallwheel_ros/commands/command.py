# SPDX-License-Identifier: Apache-2.0
"""Commands made from functions: options from the signature, and their texts from the docstring.

    compare = command(compare.compare, JSON, PLOTS, HTML, words="A model file is compared as well.")

A command that does more than its function is a function of click's own; `options_of` gives it the options of
another function.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import click

from smallwheel_ros.api.read import read, read_test
from smallwheel_ros.arguments import Kind, understand
from smallwheel_ros.commands.outputs import PATH, Finish, check_outputs, finish, progress_bar
from smallwheel_ros.commands.typed import RememberedCommand, typed_again
from smallwheel_ros.common.errors import ArgumentError, SmallwheelError
from smallwheel_ros.measurements.typed import limits_of

Function = Callable[..., Any]
Decorator = Callable[[Function], Function]
Given = dict[str, Any]  # arguments of a function, by its names


class CommandError(SmallwheelError):
    """Options that do not go together, or cannot be read."""


def described(function: Function) -> tuple[str, dict[str, str]]:
    """Return a docstring's text before its first section, and by name that of each parameter (numpydoc)."""
    doc = inspect.getdoc(function) or ""
    words, *sections = re.split(r"^(\w+)\n-+\n", doc, flags=re.MULTILINE)
    parameters = dict(zip(sections[::2], sections[1::2], strict=True)).get("Parameters", "")
    entries = re.findall(r"^(\w+)(?: : .*)?\n((?: .*\n?)+)", parameters, re.MULTILINE)
    return words.strip(), {name: " ".join(text.split()) for name, text in entries}


def kinds_of(function: Function) -> dict[str, tuple[Kind, Any]]:
    """Return the kind and the Python type of each parameter whose annotation has a `Kind`, by name."""
    found = {}
    for name, parameter in inspect.signature(function).parameters.items():
        for hint in (parameter.annotation, *get_args(parameter.annotation)):
            for kind in getattr(hint, "__metadata__", ()):
                found[name] = kind, hint.__origin__
    return found


# --- Options


def options_of(function: Function, *names: str) -> Decorator:
    """Make the options (of click) for parameters of a function; with `data`, also those of `read`.

    Parameters
    ----------
    function
        A function of the API, with a numpydoc docstring.
    *names
        Names of the parameters that get an option; all that have a `Kind` if none is named.

    Returns
    -------
    callable
        Decorator for the function of a click command.
    """
    kinds = kinds_of(function)
    wanted = names or tuple(kinds)

    def add(body: Function) -> Function:
        if "data" in wanted and kinds["data"][0].unnamed:
            body = options_of(read, *_OF_TABLE)(body)
        for name in reversed(wanted):
            body = _option(function, name, *kinds[name])(body)
        return body

    return add


_OF_TABLE = tuple(name for name in kinds_of(read) if name != "data")


def _option(function: Function, name: str, kind: Kind, type: Any) -> Decorator:
    parameter = inspect.signature(function).parameters[name]
    required = parameter.default is parameter.empty and parameter.kind is not parameter.VAR_KEYWORD
    how: Given = {"type": _type_of(kind, type), "metavar": kind.metavar, "required": required}
    how["callback"] = _callback(kind)
    if _is_unnamed(function, name, kind):
        return click.argument(name, nargs=-1 if kind.several else 1, **how)
    if parameter.default not in (None, (), parameter.empty):
        how |= {"default": parameter.default, "show_default": type is not bool or parameter.default}
    flags = kind.names or (f"--{name.replace('_', '-')}",)
    if type is bool:
        how |= {"type": None, "is_flag": True}
        flags = (f"{flags[0]}/--no-{name}",) if parameter.default else flags
    text = described(function)[1][name]
    if kind.say:
        text = f"{text.removesuffix('.')}: {kind.say}"
    if kind.several:
        text += " May be given several times."
    return click.option(*flags, name, multiple=kind.several, help=text, **how)


def _type_of(kind: Kind, type: Any) -> Any:
    """The type by which click converts a value."""
    if get_origin(type) is Literal:
        return click.Choice(get_args(type))
    if kind.within is not None:
        of_numbers = click.IntRange if kind.type is int else click.FloatRange
        return of_numbers(*kind.within)  # type: ignore[arg-type]  # of whole numbers where they are
    return PATH if kind.type is Path else kind.type


def _callback(kind: Kind) -> Function | None:
    """Callback of click that converts a typed value to the function's argument; None if none is needed."""
    if kind.read is None:
        return None

    def read_typed(_context: click.Context, option: click.Parameter, typed: Any) -> Any:
        if typed is None:
            return None
        try:
            return kind.read(typed)  # type: ignore[misc]
        except ArgumentError as error:
            raise CommandError(f"{option.opts[0]} {error}") from None

    return read_typed


# --- Commands


def command(
    function: Function,
    *outputs: Decorator,
    words: str = "",
    begin: Callable[[Given], None] = lambda asked: None,
    finish: Finish = finish,
    bar: Mapping[str, Any] | None = None,
    heard: Callable[[Given], Given] = lambda asked: {},
) -> click.Command:
    """Make the command of a function of the API: it reads the table, calls the function, shows the result.

    The command's options are those of the function's parameters, and those that `outputs` add. Only the
    former are passed to the function; `begin`, `heard` and `finish` get the others, by name.

    Parameters
    ----------
    function
        A function of the API; its name is the command's, its docstring the help.
    *outputs
        Decorators that add options of click besides those of the function, such as `JSON`.
    words
        Paragraph to add to the help.
    begin
        Function that checks the other options before the table is read; it may raise a CommandError.
    finish
        Function of the result and the other options that writes files and prints; by default
        `outputs.finish`.
    bar
        Keyword arguments of `progress_bar`, such as `what`; None: the bar shows the function's name. There
        is no bar if the function has no parameter `progress`.
    heard
        Function of the other options that returns further arguments of the function by name, such as a
        callback that prints results as they arrive.

    Returns
    -------
    click.Command
        The command, with the name of the function.
    """
    kinds = kinds_of(function)
    listens = "progress" in inspect.signature(function).parameters

    def run(**options: Any) -> None:
        given = taken(function, options)
        begin(options)
        check_outputs(given, options)
        called = with_table(function, given) | heard(options)
        if listens:
            with progress_bar(**(bar or {"what": function.__name__})) as progress:
                result = function(**called, progress=progress)
        else:
            result = function(**called)
        finish(result, options)

    made: Function = run
    for output in reversed(outputs):
        made = output(made)
    made = options_of(function)(made)
    said, texts = described(function)
    unnamed = [n for n, (kind, _) in kinds.items() if _is_unnamed(function, n, kind)]
    arguments = [f"{name.upper()}: {texts[name]}" for name in unnamed]
    help = "\n\n".join([said, *arguments, words])
    return click.command(function.__name__, help=help, cls=RememberedCommand)(made)


def with_what_was_typed(function: Function, *more: str) -> str:
    """Return the command line of a function's command, with the words typed for the running command.

    Only words that belong to the table, or to an option that `function` has too, are repeated.

    Parameters
    ----------
    function
        The function of the other command, whose name is the command's.
    more
        Words to add, such as "-o", "law.py".
    """
    names = {*kinds_of(function), *_OF_TABLE}
    return f"smallwheel {function.__name__} {typed_again(names, *more)}"


def _is_unnamed(function: Function, name: str, kind: Kind) -> bool:
    return kind.unnamed and name == next(iter(inspect.signature(function).parameters))


def taken(function: Function, options: Given) -> Given:
    """Take a function's arguments, and those of `read`, out of a command's options.

    Parameters
    ----------
    function
        A function of the API.
    options
        Options of the command by name; those that are taken are removed.

    Returns
    -------
    dict
        Arguments by name, without those that were not given. If the function takes a table, `how` has all
        arguments of `read` except the file.

    Raises
    ------
    CommandError
        If an argument NAME=VALUE, for a setting, has the name of a parameter of the function.
    """
    parameters = inspect.signature(function).parameters
    names = [name for name in parameters if name in options]
    given = {name: options.pop(name) for name in names}
    given = {name: value for name, value in given.items() if value not in (None, ())}
    for name in names:
        if parameters[name].kind is parameters[name].VAR_KEYWORD:
            others = given.pop(name, {})
            if twice := next((other for other in others if other in parameters), None):
                raise CommandError(f"{twice}={others[twice]}: expected NAME=VALUE with a new NAME")
            given |= others
    if "data" in names and kinds_of(function)["data"][0].unnamed:
        given["how"] = {name: options.pop(name) for name in _OF_TABLE}
    return given


def with_table(function: Function, given: Given) -> Given:
    """Read the table, or the tables of a lab's tests, and replace the files' names by them.

    Parameters
    ----------
    function
        A function of the API.
    given
        Its arguments, as `taken` returns them; they are not changed.

    Returns
    -------
    dict
        Arguments with which the function can be called; a folder that the function reads itself stays.

    Raises
    ------
    CommandError
        If an argument does not fit the table or the folder.
    """
    if "how" not in given:
        return given
    arguments = dict(given)
    how, data = arguments.pop("how"), arguments.get("data")
    if isinstance(data, Path) and data.is_dir() and kinds_of(function)["data"][0].or_folder:
        defaults = inspect.signature(read).parameters
        for name, value in how.items():
            if value not in (None, (), {}, defaults[name].default):
                raise CommandError(
                    f"{data}: found a folder; --{name.replace('_', '-')} goes with one table"
                )
        return arguments
    if isinstance(data, tuple):
        return arguments | {"data": [told(read_test(path, **how)) for path in data]}
    if data is not None:
        arguments["data"] = told(read(data, **how))
        for name, (kind, _) in kinds_of(function).items():
            if kind.of_table and name in arguments:
                try:
                    arguments[name] = limits_of(arguments[name], arguments["data"], understand)
                except ArgumentError as error:
                    raise CommandError(f"--{error}") from None
    return arguments


def told(test: Any) -> Any:
    """Print on standard error how a table was understood, and its warnings; return the table."""
    for line in test.understood:
        understand(line)
    for warning in getattr(test, "warnings", ()):
        click.echo(f"warning: {warning}", err=True)
    return test
