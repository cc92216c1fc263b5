# SPDX-License-Identifier: Apache-2.0
"""Reading and writing of YAML, in the subset whose meaning is what a person reads.

YAML 1.1 takes 010 for 8, 1:30 for 90 and 1_000 for 1000; tags create objects, and aliases let 500
bytes become gigabytes. A file of parameters or a model needs none of that: it is refused, with its
line. Allowed are mappings, lists, texts, `true` and `false`, `null`, and decimal numbers.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml
from yaml.nodes import MappingNode, Node, ScalarNode

from smallwheel_ros.common.files import read_text_file

DEEPEST = 20  # levels; parameters need five
_INTEGER = re.compile(r"[-+]?(0|[1-9][0-9]{0,17})")
# ROS takes 1e-3 for a number, YAML 1.1 only 1.0e-3.
_FLOAT = re.compile(r"[-+]?([0-9]+\.[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|[-+]?[0-9]+[eE][-+]?[0-9]+")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_BOOLEANS = {
    **dict.fromkeys(("true", "True", "TRUE", "yes", "Yes", "YES", "on", "On", "ON"), True),
    **dict.fromkeys(("false", "False", "FALSE", "no", "No", "NO", "off", "Off", "OFF"), False),
}
_NULLS = ("", "~", "null", "Null", "NULL")
# Numbers of YAML 1.1 in another base, with underscores or with colons, in digits of any script.
_OTHER_NUMBER = re.compile(
    r"[-+]?(0[xX][0-9a-fA-F_]+|0[bB][01_]+|0[oO]?[0-7_]+|[\d_]*\d[\d_]*(:[0-5]?\d)+(\.[\d_]*)?)"
)


class PlainYamlError(Exception):
    """Text that is not YAML of this subset; the message has the line and the mistake."""


def read_yaml(path: Path | str) -> Any:
    """Read a file with one document.

    Raises
    ------
    PlainYamlError
        If the file cannot be read or is not such a document; its message does not contain the path.
    """
    try:
        return parse_yaml(read_text_file(path))
    except OSError as error:
        raise PlainYamlError(f"cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise PlainYamlError(f"not YAML text: {error}") from error


def parse_yaml(text: str) -> Any:
    """Parse one document. Raises PlainYamlError as `read_yaml` does."""
    try:
        return yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"line {mark.line + 1}: " if mark else ""
        what = getattr(error, "problem", None) or " ".join(str(error).split())
        raise PlainYamlError(f"not YAML text: {where}{what}") from error


def write_yaml(document: Any) -> str:
    """Return a document as text from which `parse_yaml` returns an equal document."""
    return yaml.dump(document, Dumper=_Dumper, sort_keys=False, allow_unicode=True)


def plain_value(text: str) -> str | int | float | bool | None:
    """Return the value of a text without quotes.

    Raises ValueError for text that YAML 1.1 or Python takes for a number, though it is not a decimal one.
    """
    if text in _NULLS:
        return None
    if text in _BOOLEANS:
        return _BOOLEANS[text]
    if _INTEGER.fullmatch(text):
        return int(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    if _NOT_FINITE.fullmatch(text):
        return float(text.replace(".", ""))
    if _OTHER_NUMBER.fullmatch(text) or _is_number_of_python(text):
        raise ValueError(
            f"number {text[:40]!r}, expected decimal digits such as 12, 0.5 or 1.0e-3 (a text that"
            " looks like this goes in quotes)"
        )
    return text


def _is_number_of_python(text: str) -> bool:
    """Whether Python would take it for a number: also with underscores and digits of any script."""
    try:
        float(text)
    except ValueError:
        return False
    return any(character.isdecimal() for character in text)


def _refuse(what: str, node_or_event: Any) -> yaml.YAMLError:
    return yaml.composer.ComposerError(None, None, what, node_or_event.start_mark)


class _Loader(yaml.SafeLoader):
    """Composes plain nodes only, and constructs scalars by `plain_value`."""

    def __init__(self, stream: Any) -> None:
        super().__init__(stream)
        self._depth = 0

    def compose_node(self, parent: Node | None, index: Any) -> Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            raise _refuse("anchors and aliases (& and *) are not read: write it out", event)
        if getattr(event, "tag", None) is not None:
            raise _refuse(f"tag {event.tag!r} (!) is not read: leave it out", event)
        if self._depth > DEEPEST:
            raise _refuse(f"more than {DEEPEST} levels, one inside of the other", event)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def resolve(self, kind: type[Node], value: Any, implicit: Any) -> str:
        if kind is ScalarNode:
            return _PLAIN if implicit[0] else "tag:yaml.org,2002:str"
        return str(super().resolve(kind, value, implicit))  # type: ignore[no-untyped-call]

    def construct_plain(self, node: ScalarNode) -> Any:
        try:
            return plain_value(node.value)
        except ValueError as error:
            raise _refuse(str(error), node) from None

    def construct_mapping(self, node: MappingNode, deep: bool = False) -> dict[Any, Any]:
        mapping: dict[str, Any] = {}
        for key, value in node.value:
            if not isinstance(key, ScalarNode):
                raise _refuse("a key is a list or a mapping, expected a name", key)
            if key.value in mapping:
                raise _refuse(f"key {key.value!r} is there twice", key)
            mapping[key.value] = self.construct_object(value, deep=deep)
        return mapping


_PLAIN = "tag:smallwheel,2026:plain"
_Loader.add_constructor(_PLAIN, _Loader.construct_plain)


class _Dumper(yaml.SafeDumper):
    """Puts a text in quotes where without them it would mean something else."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def represent_text(self, text: str) -> ScalarNode:
        try:
            quotes = plain_value(text) != text
        except ValueError:
            quotes = True
        tag = "tag:yaml.org,2002:str"
        return self.represent_scalar(tag, text, style="'" if quotes else None)


_Dumper.add_representer(str, _Dumper.represent_text)
