# SPDX-License-Identifier: Apache-2.0
"""What a replay goes by where nobody gives it a parameter file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from smallwheel_ros.init.from_bag import rover_of_bag
from smallwheel_ros.init.rover import InitError
from smallwheel_ros.replay.inputs import read_remaps
from smallwheel_ros.replay.spec import ReplaySpec

_NAME = "rover.yaml"


def with_assumed_config(like: ReplaySpec) -> ReplaySpec:
    """The replay with what its bag tells as the parameter file, which is put into its folder.

    Remaps that are given win. Raises BagError, or InitError where the bag does not tell enough, or
    another parameter file is in the folder.
    """
    rover = rover_of_bag(like.bag)
    if rover.missing:
        raise InitError(
            f"{like.bag}: no parameter file was given, and the bag does not tell "
            f"{', '.join(rover.missing)}: `smallwheel init {like.bag} -o {_NAME}` writes one; fill in what "
            f"is marked, and give it with --config {_NAME}"
        )
    path, text = like.folder / _NAME, rover.parameter_file()
    if path.exists() and path.read_text(encoding="utf-8", errors="replace") != text:
        raise InitError(f"{path} is not what the bag tells: give it with --config, or remove it")
    try:
        like.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InitError(f"folder {like.folder} cannot be used: {error.strerror or error}") from None
    rover.save(path)
    remaps: Mapping[str, str] = read_remaps(f"{a}:={b}" for a, b in rover.remaps.items())
    said = f"no parameter file was given: {path} is what the bag tells ({', '.join(rover.wheels)})"
    return replace(like, config=path, remaps={**remaps, **like.remaps}, notes=(said, *rover.notes))
