"""What is known of one parameter of the node, and what is wrong with a value for it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

Kind = Literal["double", "integer", "string", "bool", "string_array"]
Value = float | int | str | bool | list[str]

WHEEL = "<wheel>"  # stands for a wheel's name, in names and defaults

_TYPES: dict[str, type] = {
    "double": float,
    "integer": int,
    "string": str,
    "bool": bool,
    "string_array": list,
}
_NAMES: dict[type, str] = {kind: name for name, kind in _TYPES.items()} | {list: "list"}


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
    read_only
        Only from a file or the command line, at the node's start.
    """

    name: str
    kind: Kind
    default: Value | None
    unit: str
    description: str
    low: float | None = None
    high: float | None = None
    choices: tuple[Value, ...] = ()
    required: bool = False
    read_only: bool = False

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
        return None if good else f"parameter {self.name} is {value!r}, expected {self.expected}"

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


def double(
    name: str,
    default: float | None,
    unit: str,
    low: float,
    high: float,
    description: str,
    *,
    required: bool = False,
) -> Parameter:
    """A parameter that is a number in a range."""
    return Parameter(name, "double", default, unit, description, low, high, required=required)
