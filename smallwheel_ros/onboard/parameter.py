"""What is known of one parameter of the node, and what is wrong with a value for it."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

Kind = Literal["double", "integer", "string", "bool", "string_array"]
Form = Literal["any", "topic", "path"]
Changes = Literal["always", "unconfigured", "at start"]
Value = float | int | str | bool | list[str]

_TOPIC = re.compile(r"(~?/)?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_LONGEST_TOPIC = 200  # DDS takes 255 characters, with a namespace and a prefix of ROS in them

WHEEL = "<wheel>"  # stands for a wheel's name, in names and defaults

_TYPES: dict[str, type] = {
    "double": float,
    "integer": int,
    "string": str,
    "bool": bool,
    "string_array": list,
}
_NAMES: dict[type, str] = {kind: name for name, kind in _TYPES.items()} | {list: "list"}


def _topic_problem(name: str) -> str | None:
    if _TOPIC.fullmatch(name) and len(name) <= _LONGEST_TOPIC:
        return None
    return (
        f"expected the name of a topic, at most {_LONGEST_TOPIC} letters, digits and _, in parts"
        " divided by / that do not begin with a digit"
    )


def _path_problem(name: str) -> str | None:
    try:
        Path(name).expanduser().exists()
    except (OSError, RuntimeError, ValueError) as error:  # too long, no such user, a NUL in it
        return f"expected the path of a file: {getattr(error, 'strerror', None) or error}"
    return None


_FORMS: dict[Form, Callable[[str], str | None]] = {
    "any": lambda _: None,
    "topic": _topic_problem,
    "path": _path_problem,
}


@dataclass(frozen=True)
class Parameter:
    """One parameter of the node.

    Attributes
    ----------
    name
        Full name; `<wheel>` in it stands for each wheel's name.
    default
        None: there is none. It must then be given, or is optional (see the description).
    low, high
        Ends of the range, both allowed; None: no end.
    choices
        What a text or an integer may be; empty: anything.
    form
        What a text must be beside a text: the name of a topic or of a file, where it is not empty.
    changes
        When it may be changed: while the node runs, only while it is not configured, or only in the
        file or command line that the node is started with.
    description
        What it means.
    """

    name: str
    kind: Kind
    default: Value | None
    unit: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[Value, ...] = ()
    form: Form = "any"
    required: bool = False
    changes: Changes = "always"
    description: str = ""

    def for_wheel(self, wheel: str) -> Parameter:
        """Return the parameter of that wheel."""
        default = self.default
        if isinstance(default, str):
            default = default.replace(WHEEL, wheel)
        return replace(self, name=self.name.replace(WHEEL, wheel), default=default)

    @property
    def expected(self) -> str:
        """What a value must be, in words."""
        if self.choices:
            return " or ".join(repr(choice) for choice in self.choices)
        article = "an" if self.kind == "integer" else "a"
        words = f"{article} {self.kind}".replace("string_array", "list of texts")
        if self.low is not None and self.high is not None:
            words += f" from {self.low:g} to {self.high:g}"
        return words + (f" {self.unit}" if self.unit not in ("", "1") else "")

    def problem(self, value: object) -> str | None:
        """Say what is wrong with a value, naming the parameter and the mend; None: nothing."""
        wanted = _TYPES[self.kind]
        if type(value) is not wanted:
            mend = self._mend(value)
            found = f"{_NAMES.get(type(value), type(value).__name__)} {value!r}"
            return f"parameter {self.name} is {found}, expected {self.expected}{mend}"
        if isinstance(value, list) and not all(isinstance(item, str) for item in value):
            return f"parameter {self.name} is {value!r}, expected {self.expected}"
        good = not self.choices or value in self.choices
        if isinstance(value, (float, int)) and not isinstance(value, bool):
            good = good and math.isfinite(value)
            good = good and (self.low is None or value >= self.low)
            good = good and (self.high is None or value <= self.high)
        if not good:
            return f"parameter {self.name} is {value!r}, expected {self.expected}"
        wrong = _FORMS[self.form](value) if isinstance(value, str) and value else None
        return f"parameter {self.name} is {value!r}, {wrong}" if wrong else None

    def _mend(self, value: object) -> str:
        if self.kind == "double" and type(value) is int:
            return f": write {value}.0"
        if self.kind == "integer" and type(value) is float and value.is_integer():
            return f": write {int(value)}"
        if self.kind == "string" and isinstance(value, (int, float, bool)):
            return f": write '{value}' in quotes"
        if self.kind == "string_array" and isinstance(value, str):
            return f": write [{value}]"
        if isinstance(value, str) and self.kind != "string":
            return ": write it without quotes"
        return ""
