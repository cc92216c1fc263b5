# SPDX-License-Identifier: Apache-2.0
"""The base of every error that this package raises on purpose, and phrases for their messages."""

from __future__ import annotations

import difflib


class SmallwheelError(Exception):
    """An error that the user can correct: the message says what was wrong, where, and what to do.

    Each module derives one class of its own from it. The command line prints the message and
    ends with exit code 2; the node reports it in its diagnostics. Anything else that is raised
    is a defect of this package.
    """


class ArgumentError(SmallwheelError):
    """An argument of a public function has a type that it does not take."""


def reason(error: Exception) -> str:
    """The text of another library's error on one line, or the name of its type if it has no text."""
    text = " ".join(str(getattr(error, "strerror", None) or error).split())
    return text.rstrip(".") or type(error).__name__


def nearest(name: str, known: list[str]) -> str:
    """Make the end of an error's message on an unknown name: the name probably meant, and those that exist.

    Parameters
    ----------
    name
        The unknown name.
    known
        The names that exist.

    Returns
    -------
    str
        Such as "did you mean 'slip'? Expected one of load, slip", or without the question if no name is near.
    """
    hint = guess(name, known)
    which = f"xpected {'one of ' if len(known) > 1 else ''}{', '.join(sorted(known))}"
    return f"{hint}{'E' if hint else 'e'}{which}"


def guess(name: str, known: list[str]) -> str:
    """Make a question for error messages: whether the nearest of the known names was meant.

    Parameters
    ----------
    name
        The unknown name.
    known
        The names that exist.

    Returns
    -------
    str
        Such as "did you mean 'slip'? ", with a space at its end; empty if no name is near.
    """
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"did you mean '{close[0]}'? " if close else ""


def kind_of(value: object) -> str:
    """Describe a value by the name of its type."""
    return "nothing" if value is None else type(value).__name__
