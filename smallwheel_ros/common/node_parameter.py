# SPDX-License-Identifier: Apache-2.0
"""A parameter of the node: its declaration, its allowed values, and the check of a value.

A parameter is a field of a dataclass, declared once: the field's type is its type, and its name is
the field's, after the names of the groups that contain it.

    @dataclass(frozen=True, kw_only=True)
    class Timing:
        reorder_time: float = parameter(0.2, "s", (0.0, 5.0), "How long a sinkage waits.")

    @dataclass(frozen=True, kw_only=True)
    class Parameters:
        base_frame: str = parameter("base_link", text="Link that positions are measured from.")
        timing: Timing = group(Timing)  # timing.reorder_time
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from inspect import get_annotations
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import yaml

Kind = Literal["double", "integer", "string", "bool", "string_array"]
Form = Literal["any", "topic", "no_topic", "path"]
Value = float | int | str | bool | list[str]

WHEEL = "<wheel>"  # stands for a wheel's name, in names, defaults and values of `ALL`
ALL = "all_wheels"  # group of parameters for each wheel that does not have its own
_TYPES: dict[str, type] = {
    "double": float,
    "integer": int,
    "string": str,
    "bool": bool,
    "string_array": list,
}
_KINDS: dict[Any, Kind] = {
    float: "double",
    int: "integer",
    str: "string",
    bool: "bool",
    tuple: "string_array",
}
_NAMES: dict[Any, str] = {kind: name for name, kind in _TYPES.items()} | {list: "list"}
_TOPIC = re.compile(r"(~?/)?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_LONGEST_TOPIC = 200  # DDS takes 255 characters, with a namespace and a prefix of ROS in them


@dataclass(frozen=True)
class NodeParameter:
    """One parameter of the node.

    Attributes
    ----------
    name
        Full name; `<wheel>` in it stands for each wheel's name.
    kind
        Type of its value; an integer is accepted for a double.
    default
        Value if none is given; None: the parameter is required, or optional (see the description).
    description
        Meaning of the parameter, in sentences.
    unit
        Unit of the value, such as `m` or `1`; empty if it is not a number.
    low, high
        Ends of the range, both allowed; None for no limit.
    choices
        Allowed texts or integers; empty: any.
    form
        Further condition on a text: `any` for none; `topic`: a name of a topic; `no_topic`: such a name, or
        empty; `path`: a name of a file, or empty.
    required
        Whether the parameter must be given.
    at_start
        Whether it is only read at the start of the node, from the file or command line.
    """

    name: str
    kind: Kind
    default: Value | None
    description: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[Value, ...] = ()
    form: Form = "any"
    required: bool = False
    at_start: bool = False

    def for_wheel(self, wheel: str) -> NodeParameter:
        """Return the parameter of the wheel of that name."""
        default = self.default
        if isinstance(default, str):
            default = default.replace(WHEEL, wheel)
        return replace(self, name=self.name.replace(WHEEL, wheel), default=default)

    def for_all(self) -> NodeParameter:
        """Return the parameter by which a value is given for all wheels at once; it has no default."""
        return replace(self, name=self.name.replace(WHEEL, ALL), default=None, required=False)

    def taken(self, value: Any) -> Any:
        """Convert a valid value to its declared type: 280 becomes 280.0 for a double."""
        return float(value) if self.kind == "double" and type(value) is int else value

    @property
    def allowed(self) -> str:
        """Its choices or its range, in words; empty if any value of its type is allowed."""
        if self.choices:
            return " or ".join(map(str, self.choices))
        if self.low is None or self.high is None:
            return ""
        return f"{self.low:g} to {self.high:g}"

    @property
    def expected(self) -> str:
        """The values that it may have, in words, such as `a double from 0 to 5 s`."""
        if self.choices:
            return " or ".join(repr(choice) for choice in self.choices)
        article = "an" if self.kind == "integer" else "a"
        words = f"{article} {self.kind}".replace("string_array", "list of texts")
        words += f" from {self.allowed}" if self.allowed else ""
        return words + (f" {self.unit}" if self.unit not in ("", "1") else "")

    def problem(self, value: object) -> str | None:
        """Check a value; return the mistake and its remedy in words, with the name, or None if it is valid.

        A value of None stands for a parameter that is not given.
        """
        if value is None:
            missing = f"parameter {self.name} is missing, expected {self.expected}"
            return missing if self.required else None
        found = f"parameter {self.name} is"
        if type(value) is not _TYPES[self.kind] and not (
            self.kind == "double" and type(value) is int  # a bool is none
        ):
            kind = _NAMES.get(type(value), type(value).__name__)
            return f"{found} {kind} {value!r}, expected {self.expected}{self._mend(value)}"
        good = not self.choices or value in self.choices
        if isinstance(value, list):
            good = all(isinstance(item, str) for item in value)
        elif isinstance(value, (float, int)) and not isinstance(value, bool):
            good = good and self.spans(value)
        if not good:
            return f"{found} {value!r}, expected {self.expected}"
        wrong = self._malformed(value) if isinstance(value, str) else None
        return f"{found} {value!r}, expected {wrong}" if wrong else None

    def spans(self, value: float) -> bool:
        """Whether a number is finite and in the range, ends included."""
        low = -math.inf if self.low is None else self.low
        high = math.inf if self.high is None else self.high
        return low <= value <= high and math.isfinite(
            value
        )  # the other way round 10^400 is an error

    def _malformed(self, value: str) -> str | None:
        """The form that a text must have, in words, if the value does not have it; None if it has."""
        if not value and self.form != "topic":
            return None
        of_all = self.name.startswith(f"{ALL}.")  # of each wheel by its name
        topic = value.replace(WHEEL, "wheel") if of_all else value
        named = _TOPIC.fullmatch(topic) and len(value) <= _LONGEST_TOPIC
        if self.form in ("topic", "no_topic") and not named:
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


def written(value: Value) -> str:
    """A value as YAML text on one line."""
    texts = [value] if isinstance(value, str) else value if isinstance(value, list) else []
    # Only in double quotes does a line break stay within its line.
    style = '"' if any("\n" in str(text) for text in texts) else None
    made = yaml.safe_dump([value], default_flow_style=True, default_style=style, width=math.inf)
    return str(made).strip()[1:-1]


# --- Declarations

Declared = TypeVar("Declared")


def parameter(
    default: object,
    unit: str = "",
    span: tuple[float, float] | None = None,
    text: str = "",
    *,
    form: Form = "any",
    required: bool = False,
    at_start: bool = False,
) -> Any:  # a dataclass field stands for a value of its annotated type
    """Declare a parameter of the node as a field of a dataclass.

    A field whose type is a Literal has the values listed there as choices.

    Parameters
    ----------
    default
        Default value; None if there is none: then the field's type allows None, or the parameter is required.
    unit
        Unit of the value, if it is a number.
    span
        Lowest and highest value, in its unit, both allowed; None for no limits.
    text
        Meaning of the parameter, in sentences: its `description`.
    form
        Condition on a text, see `NodeParameter`.
    required
        Whether the parameter must be given.
    at_start
        Whether it is only read at the start of the node.

    Returns
    -------
    Any
        The field of the dataclass; it is typed Any, since type checkers see the value's type instead.
    """
    low, high = span or (None, None)
    what = {"unit": unit, "low": low, "high": high, "description": text}
    what |= {"form": form, "required": required, "at_start": at_start}
    if required and default is None:
        return field(metadata={"parameter": what})
    return field(default=default, metadata={"parameter": what})


def topic(default: str, text: str, *, at_start: bool = False) -> Any:
    """Declare a parameter that names a topic; an empty value means no topic.

    Parameters
    ----------
    default
        Name of the topic if the parameter is not given; may be empty.
    text
        Description of the topic's messages.
    at_start
        Whether it is only read at the start of the node.
    """
    return parameter(default, text=text, form="no_topic", at_start=at_start)


def path(text: str, *, at_start: bool = False) -> Any:
    """Declare a parameter that names a file; the default is empty, which means no file.

    Parameters
    ----------
    text
        Description of the file's content.
    at_start
        Whether it is only read at the start of the node.
    """
    return parameter("", text=text, form="path", at_start=at_start)


def group(of: type) -> Any:
    """Declare a group of parameters, whose names begin with the field's."""
    return field(default_factory=of, metadata={"group": of})


def group_per_wheel(of: type) -> Any:
    """Declare parameters that each wheel has: a mapping by the wheel's name."""
    return field(default_factory=dict, metadata={"group_per_wheel": of})


@cache
def rows_of(declared: type) -> tuple[NodeParameter, ...]:
    """Return all parameters declared in a dataclass and its groups: its own before those that it inherits."""
    return tuple(_rows(declared, ""))


def _rows(declared: type, before: str) -> Iterator[NodeParameter]:
    hints = get_type_hints(declared)
    own = get_annotations(declared)
    for one in sorted(fields(declared), key=lambda one: one.name not in own):
        if "parameter" in one.metadata:
            yield _row(
                f"{before}{one.name}", hints[one.name], one.default, one.metadata["parameter"]
            )
        elif "group" in one.metadata:
            yield from _rows(one.metadata["group"], f"{before}{one.name}.")
        elif "group_per_wheel" in one.metadata:
            yield from _rows(one.metadata["group_per_wheel"], f"{WHEEL}.")


def _row(name: str, hint: Any, default: Any, what: Mapping[str, Any]) -> NodeParameter:
    """The parameter of a field, with its kind and choices taken from the field's type."""
    if get_origin(hint) in (Union, UnionType):  # of it and None
        (hint,) = (one for one in get_args(hint) if one is not NoneType)
    choices: tuple[Value, ...] = get_args(hint) if get_origin(hint) is Literal else ()
    of = type(choices[0]) if choices else get_origin(hint) or hint
    given = None if what["required"] else default
    return NodeParameter(name, _KINDS[of], given, choices=choices, **what)


def filled(declared: type[Declared], values: Mapping[str, Any], before: str = "") -> Declared:
    """Make an instance of a class that declares parameters, from their values.

    Fields of the class that are not parameters keep their defaults; lists become tuples.

    Parameters
    ----------
    declared
        The dataclass that declares the parameters.
    values
        Values of all its parameters, by full name; for parameters of each wheel also `wheels`, the wheels'
        names.
    before
        Prefix of its parameters' names, such as `cost.`.
    """
    found: dict[str, Any] = {}
    for one in fields(declared):  # type: ignore[arg-type]
        name, what = f"{before}{one.name}", one.metadata
        if "parameter" in what:
            value = values[name]
            found[one.name] = tuple(value) if isinstance(value, list) else value
        elif "group" in what:
            found[one.name] = filled(what["group"], values, f"{name}.")
        elif "group_per_wheel" in what:
            of = what["group_per_wheel"]
            found[one.name] = {w: filled(of, values, f"{w}.") for w in values["wheels"]}
    return declared(**found)
