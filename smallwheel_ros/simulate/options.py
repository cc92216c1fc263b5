# SPDX-License-Identifier: Apache-2.0
"""Options of a command, made from the fields of its settings, which declare each once, with its default."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar, get_type_hints

import click

Command = TypeVar("Command", bound=Callable[..., Any])


class Option(NamedTuple):
    """Describes a field of settings as an option: ``rows: Annotated[int, Option("Repeats.")] = 3``.

    Attributes
    ----------
    text
        Help of the option.
    within
        Lowest and highest value, both allowed, and optionally their unit; or the choices, texts. Empty if
        any value is allowed.
    words
        Keyword arguments for `click.option` that do not follow from the field's default.
    """

    text: str | None = None
    within: tuple[Any, ...] = ()
    words: Mapping[str, Any] = MappingProxyType({})


def options_of(settings: type) -> dict[str, Option]:
    """The fields of settings (a dataclass) that are options, by name, in the order of the fields."""
    hints = get_type_hints(settings, include_extras=True)
    found = {name: getattr(hint, "__metadata__", (None,))[0] for name, hint in hints.items()}
    return {name: option for name, option in found.items() if isinstance(option, Option)}


def settings_options(settings: type, first: Sequence[str] = ()) -> Callable[[Command], Command]:
    """Make a decorator that gives a command the options of its settings.

    Parameters
    ----------
    settings
        Dataclass of settings, all with defaults.
    first
        Names of the fields whose options come first; the others follow in the order of the fields.

    Returns
    -------
    callable
        Decorator of a function that becomes a click command, which gets each field as a keyword argument.
    """
    said = options_of(settings)
    order = [*first, *(name for name in said if name not in first)]

    def add(command: Command) -> Command:
        for name in reversed(order):
            default, option = getattr(settings, name), said[name]
            words = {"type": type(default), "default": default}
            if isinstance(default, tuple):
                words = {"callback": names, "default": ",".join(default)}
            words = {"show_default": True, "help": option.text, **words, **option.words}
            command = click.option(f"--{name.replace('_', '-')}", **words)(command)
        return command

    return add


def names(_context: click.Context, _option: click.Parameter, text: str) -> tuple[str, ...]:
    """Split a list of names at its commas, without spaces and empty names; a callback of click."""
    return tuple(name.strip() for name in text.split(",") if name.strip())
