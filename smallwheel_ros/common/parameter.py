# SPDX-License-Identifier: Apache-2.0
"""A parameter of the node: declared once, as a field of a settings class; what is wrong with a value.

    @dataclass(frozen=True)
    class Timing:
        maximum_gap: float = Parameter(0.2, "s", 1e-3, 10.0).means("Load and speed are held so long.")

Name and kind are those of the field: float is a double, int an integer, str a text, Sequence a list of
texts; Literal gives the choices, and None beside it a parameter that nobody needs to give.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import yaml

Kind = Literal["double", "integer", "string", "bool", "string_array"]
Form = Literal["any", "topic", "path"]
Value = float | int | str | bool | list[str]
_Settings = TypeVar("_Settings")

WHEEL = "<wheel>"  # stands for a wheel's name, in names and defaults
_TYPES: dict[str, type] = {
    "double": float,
    "integer": int,
    "string": str,
    "bool": bool,
    "string_array": list,
}
_NAMES: dict[Any, str] = {kind: name for name, kind in _TYPES.items()} | {list: "list"}
_KINDS: dict[Any, Any] = _NAMES | {Sequence: "string_array"}
_TOPIC = re.compile(r"(~?/)?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_LONGEST_TOPIC = 200  # DDS takes 255 characters, with a namespace and a prefix of ROS in them


@dataclass(frozen=True)
class Parameter:
    """One parameter of the node.

    Attributes
    ----------
    default
        None: there is none. It must then be given, or is optional (see the description).
    low, high
        Ends of the range, both allowed; None: no end.
    name
        Full name; `<wheel>` in it stands for each wheel's name. To be declared only where it is not the
        field's in the group of its class.
    form
        What a text must be beside a text: the name of a topic or of a file, where it is not empty.
    at_start
        Whether it counts only in the file or command line that the node is started with.
    kind, choices
        Of the field. What a text or an integer may be; empty: anything.
    description
        What it means.
    """

    default: Value | None = None
    unit: str = ""
    low: float | None = None
    high: float | None = None
    name: str = ""
    form: Form = "any"
    required: bool = False
    at_start: bool = False
    kind: Kind = "double"
    choices: tuple[Value, ...] = ()
    description: str = ""

    def means(self, description: str) -> Any:
        """Return the field of a settings class that declares it."""
        default: Any = MISSING if self.required else self.default
        told = replace(self, description=description)
        return field(default=default, metadata={"parameter": told})

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
        """Say what is wrong with a value, naming the parameter and the mend; None: nothing.

        A value of None is one that is not given.
        """
        if value is None:
            missing = f"parameter {self.name} is missing, expected {self.expected}"
            return missing if self.required else None
        found = f"parameter {self.name} is"
        if type(value) is not _TYPES[self.kind]:
            kind = _NAMES.get(type(value), type(value).__name__)
            return f"{found} {kind} {value!r}, expected {self.expected}{self._mend(value)}"
        good = not self.choices or value in self.choices
        if isinstance(value, list):
            good = all(isinstance(item, str) for item in value)
        elif isinstance(value, (float, int)) and not isinstance(value, bool):
            good = good and self.spans(value)
        if not good:
            return f"{found} {value!r}, expected {self.expected}"
        wrong = self._malformed(value) if isinstance(value, str) and value else None
        return f"{found} {value!r}, expected {wrong}" if wrong else None

    def spans(self, value: float) -> bool:
        """Whether a number is in the range."""
        low = -math.inf if self.low is None else self.low
        high = math.inf if self.high is None else self.high
        return low <= value <= high and math.isfinite(
            value
        )  # the other way round 10^400 is an error

    def _malformed(self, value: str) -> str | None:
        """What a text is expected to be, if it is not of its form."""
        if self.form == "topic" and not (_TOPIC.fullmatch(value) and len(value) <= _LONGEST_TOPIC):
            return (
                f"the name of a topic, at most {_LONGEST_TOPIC} letters, digits and _, in parts"
                " divided by / that do not begin with a digit"
            )
        if self.form == "path":
            try:
                Path(value).expanduser().exists()
            except (OSError, RuntimeError, ValueError) as error:  # too long, no such user, a NUL
                return f"the path of a file: {getattr(error, 'strerror', None) or error}"
        return None

    def _mend(self, value: object) -> str:
        if self.kind == "double" and type(value) is int:
            return f": write {value}.0"
        if self.kind == "integer" and type(value) is float and value.is_integer():
            return f": write {int(value)}"
        if self.kind == "string" and isinstance(value, (int, float, bool)):
            return f": write '{value}' in quotes"
        if self.kind == "string_array" and isinstance(value, str):
            return f": write [{value}]"
        if not isinstance(value, str):
            return ""
        try:
            float(value)
        except ValueError:
            known = self.kind in ("double", "integer")
            return ": write the number in its place" if known else ": write it without quotes"
        return ": write it without quotes"


def _declared(kind: type, group: str) -> Iterator[tuple[str, Any, Parameter | None]]:
    """Name, type and parameter (None: a group of its own) of each field that is declared as one."""
    types = get_type_hints(kind)
    for entry in fields(kind):
        wanted, declared = types[entry.name], entry.metadata.get("parameter")
        if is_dataclass(wanted):
            yield entry.name, wanted, None
        if declared is None:
            continue
        if get_origin(wanted) is UnionType:
            (wanted,) = (part for part in get_args(wanted) if part is not NoneType)
        choices = get_args(wanted) if get_origin(wanted) is Literal else ()
        yield (
            entry.name,
            wanted,
            replace(
                declared,
                name=declared.name or f"{group}{entry.name}",
                kind=_KINDS[type(choices[0]) if choices else get_origin(wanted) or wanted],
                choices=choices,
            ),
        )


def parameters_of(kind: type, group: str = "") -> list[Parameter]:
    """Return the parameters that a settings class declares, those of groups in it too, in order."""
    found: list[Parameter] = []
    for name, wanted, parameter in _declared(kind, group):
        found += parameters_of(wanted, f"{name}.") if parameter is None else [parameter]
    return found


def settings_of(kind: type[_Settings], values: Mapping[str, Any], group: str = "") -> _Settings:
    """Make settings, groups in them too, of values by the full names of parameters."""
    given = {}
    for name, wanted, parameter in _declared(kind, group):
        if parameter is None:
            given[name] = settings_of(wanted, values, f"{name}.")
        elif parameter.name in values:
            given[name] = values[parameter.name]
    return kind(**given)


def out_of_range(settings: Any) -> str:
    """Say which number in settings is outside the range that is declared; empty: none."""
    for name, _, parameter in _declared(type(settings), ""):
        value = getattr(settings, name)
        if parameter is not None and isinstance(value, (int, float)) and not parameter.spans(value):
            return f"{name} is {value!r}, expected {parameter.expected}"
    return ""


def written(value: Value) -> str:
    """A value as YAML has it, on one line."""
    return str(yaml.safe_dump([value], default_flow_style=True, width=math.inf)).strip()[1:-1]
