# SPDX-License-Identifier: Apache-2.0
"""The estimate in a file, so that a restart on the same soil continues where it was.

JSON, written whole or not at all. It holds the newest soil and the estimated errors of the sensors,
and also the prior and effects used: under another prior or model the numbers would mean something
else. A checksum shows whether a file is as it was written.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.files import OutputError, json_text, read_text_file, write_together
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.onboard.prior import EstimatorError, SoilPrior

from .identifiability import SoilEstimate, Variety

Array = NDArray[np.float64]

FORMAT = "smallwheel soil state"
_VERSION = 6  # of the content; files of another version are refused


@dataclass(frozen=True)
class SoilRecord:
    """State of the soil's filter without the errors of single wheels' sensors.

    Attributes
    ----------
    reference
        Load (N), diameter and width (m) of the reference wheel.
    mean, covariance
        Mean and covariance of the first WHEELS numbers of the state (`soil/model.py`), shape (WHEELS,) and
        (WHEELS, WHEELS).
    """

    reference: tuple[float, float, float]
    mean: Array
    covariance: Array


@dataclass(frozen=True)
class SavedState:
    """Content of a file of a saved soil.

    Attributes
    ----------
    soil
        The newest soil; None if nothing was measured.
    variety
        Ranges of the wheels and loads with which it was measured.
    accepted
        Number of readings of sinkage that were used for it.
    strength
        State of the strength's filters, as `Strengths.record` returns it; None if nothing was measured.
    cost_map
        SHA-256 of the map that was saved with it, in hexadecimal digits; None if there was none.
    """

    soil: SoilRecord | None
    variety: Variety
    accepted: int
    strength: Any = None
    cost_map: str | None = None


def _made_with(prior: SoilPrior, effects: Sequence[Effect]) -> dict[str, Any]:
    """Describe prior and effects, so that `_compare` can tell whether a file was saved under others."""
    numbers = {entry.name: getattr(prior, entry.name) for entry in fields(prior)}
    return {
        "prior": {**numbers, "soil": prior.soil.name},
        "effects": [{"id": e.id, "form": e.form, **dict(e.values())} for e in effects],
    }


def state_bytes(
    state: SavedState, prior: SoilPrior, effects: Sequence[Effect], now: SoilEstimate
) -> bytes:
    """Serialise a state as the content of a file.

    Parameters
    ----------
    state
        State to be saved.
    prior
        Prior used in the estimate.
    effects
        Effects used in the estimate.
    now
        The present estimate, for a summary that people can read in the file.

    Returns
    -------
    bytes
        JSON in UTF-8, with a checksum.

    Raises
    ------
    ValueError
        If a number is not finite, which is a defect.
    """
    soil = state.soil
    summary = (
        f"ln pressure {now.log_pressure:.4f}, n {now.n:.4f}, m {now.m:.4f} after "
        f"{state.accepted} measurements"
    )
    law = soil and {
        "reference": soil.reference,
        "mean": soil.mean.tolist(),
        "covariance": soil.covariance.tolist(),
    }
    content = {
        "format": FORMAT,
        "version": _VERSION,
        "summary": summary,
        **_made_with(prior, effects),
        "accepted": state.accepted,
        "diameters": state.variety.diameters,
        "loadings": state.variety.loadings,
        "soil": law,
        "strength": state.strength,
        "cost_map": state.cost_map,
    }
    return json_text({**content, "sha256": _checksum(content)}).encode()


def write_state(path: Path, content: bytes, beside: Mapping[Path, bytes]) -> None:
    """Write a saved state and the files that belong to it, all or none; the state's file comes last.

    The folder is made if it does not exist.

    Parameters
    ----------
    path
        File of the state.
    content
        Its content, as `state_bytes` returns it.
    beside
        Content of the other files, by path.

    Raises
    ------
    EstimatorError
        If a file cannot be written.
    """
    with suppress(OSError):  # without the folder the writing reports it
        path.parent.mkdir(parents=True, exist_ok=True)
    try:
        write_together({**beside, path: content})
    except OutputError as error:
        raise EstimatorError(str(error)) from None


def _checksum(content: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def check_may_replace(path: Path) -> None:
    """Raise EstimatorError if there is a file that is not a saved soil, so that it is not overwritten."""
    try:
        if not os.path.lexists(path) or _content(path).get("format") == FORMAT:
            return
    except (OSError, ValueError, RecursionError):
        pass
    raise EstimatorError(
        f"{path}: this is not a saved soil, and is left as it is; remove it, or"
        " save under another name"
    )


def _content(path: Path) -> dict[str, Any]:
    """Read the JSON object in a file. Raises OSError, ValueError or RecursionError."""
    content = json.loads(read_text_file(path), parse_constant=_no_constant)
    if not isinstance(content, dict):
        raise ValueError("not a JSON object")  # noqa: TRY004  # one of the faults of a text
    return content


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no number")


def read_state(path: Path, prior: SoilPrior, effects: Sequence[Effect]) -> SavedState:
    """Read a saved state from its file.

    Parameters
    ----------
    path
        The file.
    prior
        Present prior of the soil; the file must have been saved under the same.
    effects
        Present effects of the model; the file must have been saved under the same.

    Returns
    -------
    SavedState
        Content of the file.

    Raises
    ------
    EstimatorError
        If it cannot be used; the message says why and what to do.
    """
    try:
        content = _content(path)
    except OSError as error:
        raise EstimatorError(
            f"{path}: no saved soil can be read there: {error.strerror or error}"
        ) from None
    except (ValueError, RecursionError) as error:  # not UTF-8, not JSON, nested without end
        raise _corrupt(path, str(error)) from None
    if content.get("format") != FORMAT:
        raise _corrupt(path, f"expected a file of format '{FORMAT}'")
    if content.get("version") != _VERSION:
        raise EstimatorError(
            f"{path}: version {content.get('version')!r} of a saved soil, expected {_VERSION}: "
            "another release wrote it; delete the file to begin with the prior"
        )
    told = content.pop("sha256", None)
    if told != _checksum(content):
        raise _corrupt(
            path, "it is not as it was written: it is damaged, or somebody has changed it"
        )
    _compare(path, content, _made_with(prior, effects))
    ranges = (content[name] and tuple(content[name]) for name in ("diameters", "loadings"))
    soil = content["soil"]
    if soil is not None:
        mean, covariance = np.array(soil["mean"]), np.array(soil["covariance"])
        soil = SoilRecord(tuple(soil["reference"]), mean, covariance)
    return SavedState(
        soil, Variety(*ranges), content["accepted"], content["strength"], content.get("cost_map")
    )


def _corrupt(path: Path, why: str) -> EstimatorError:
    return EstimatorError(
        f"{path}: not a whole saved soil ({why}); delete the file to begin with the prior"
    )


def _compare(path: Path, content: dict[str, Any], expected: dict[str, Any]) -> None:
    """Raise EstimatorError if a file's content was saved under another prior, or other effects."""
    for name, value in expected["prior"].items():
        found = content["prior"].get(name)
        same = found == value
        if isinstance(value, float):  # of another processor the last digit may be another
            same = math.isclose(found, value, rel_tol=1e-9, abs_tol=1e-9)
        if not same:
            raise EstimatorError(
                f"{path}: saved under another prior ({name} {found!r}, now {value!r}); restore the "
                "old setting, or delete the file to begin with the prior"
            )
    if content["effects"] != expected["effects"]:
        names = [effect["id"] for effect in content["effects"]]
        raise EstimatorError(
            f"{path}: saved under another model (effects {names}, or other numbers of them); use "
            "that model file, or delete the file to begin with the prior"
        )
