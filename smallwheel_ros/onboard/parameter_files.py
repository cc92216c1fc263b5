# SPDX-License-Identifier: Apache-2.0
"""The node's parameters in a YAML file, read without ROS."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import yaml

from smallwheel_ros.common.plain_yaml import PlainYamlError, read_yaml
from smallwheel_ros.onboard.parameter import Value
from smallwheel_ros.onboard.parameters import NODE_NAME, ParametersError

_SECTION = "ros__parameters"


def read_parameters(path: Path | str, node: str = NODE_NAME) -> dict[str, Value]:
    """Read the values that a ROS parameter file gives a node, by full name.

    Sections `/**` and those of the node count, in the order of the file.

    Raises
    ------
    ParametersError
        If the file cannot be read, is not YAML, or has nothing for this node.
    """
    try:
        content = read_yaml(path)
    except PlainYamlError as error:
        raise ParametersError(f"{path}: {error}") from error
    sections = content if isinstance(content, dict) else {}
    own = re.compile(rf"/\*\*|(/\*\*|/\w+)*/?{re.escape(node)}")
    found = {name: section for name, section in sections.items() if own.fullmatch(str(name))}
    values: dict[str, Value] = {}
    for name, section in found.items():
        if not isinstance(section, dict) or not isinstance(section.get(_SECTION), dict):
            raise ParametersError(f"{path}: section {name} has no {_SECTION}: in it")
        values.update(_flat(section[_SECTION]))
    if not found:
        there = ", ".join(str(name) for name in sections) or "nothing"
        raise ParametersError(
            f"{path} has no parameters for the node: found {there}, expected a section /**: or"
            f" {node}: with {_SECTION}: in it"
        )
    return values


def _flat(tree: dict[Any, Any], prefix: str = "") -> dict[str, Value]:
    flat: dict[str, Value] = {}
    for name, value in tree.items():
        if isinstance(value, dict):
            flat.update(_flat(value, f"{prefix}{name}."))
        else:
            flat[f"{prefix}{name}"] = value
    return flat


def written(value: Value) -> str:
    """A value as YAML has it, on one line."""
    return str(yaml.safe_dump([value], default_flow_style=True, width=math.inf)).strip()[1:-1]
