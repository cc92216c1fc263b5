# SPDX-License-Identifier: Apache-2.0
"""The words of the running command, so that a result can name the command that continues from it."""

from __future__ import annotations

import shlex
from collections.abc import Collection

import click

_TYPED = f"{__name__}.words"


class RememberedCommand(click.Command):
    """A command that remembers its words as they were typed."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Store the words in the context, then parse them as click does.

        Parameters
        ----------
        ctx
            The context of the command.
        args
            The words after the command's name.

        Returns
        -------
        list of str
            Words that were not parsed, as click returns them.
        """
        ctx.meta[_TYPED] = list(args)
        return super().parse_args(ctx, args)


def typed_again(names: Collection[str], *more: str) -> str:
    """Repeat the words of the running command that belong to parameters of these names, quoted for a shell.

    Unnamed arguments come first, then options in the order of `--help`, then `more`. If an unnamed argument
    looks like an option, the unnamed ones come last, after `--`.

    Parameters
    ----------
    names
        Names of the parameters whose words are repeated.
    more
        Words to add, such as "-o", "law.py".
    """
    context = click.get_current_context()
    parser = context.command.make_parser(context)
    values, _, _ = parser.parse_args(list(context.meta[_TYPED]))
    unnamed: list[str] = []
    options: list[str] = []
    for parameter in context.command.params:
        value = values.get(parameter.name or "")
        if parameter.name not in names or value is None or value == ():
            continue
        if isinstance(parameter, click.Option) and parameter.is_flag:
            options.append(parameter.opts[0] if value else parameter.secondary_opts[0])
            continue
        each = [value] if isinstance(value, str) else [str(one) for one in value]
        if isinstance(parameter, click.Argument):
            unnamed += each
        else:
            options += [word for one in each for word in (parameter.opts[-1], one)]
    if any(word.startswith("-") for word in unnamed):
        return shlex.join([*options, *more, "--", *unnamed])
    return shlex.join([*unnamed, *options, *more])
