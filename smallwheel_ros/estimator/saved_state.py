# SPDX-License-Identifier: Apache-2.0
"""The estimate in a file, so that a restart on the same soil goes on where it was.

JSON, written whole or not at all. It holds the newest soil, and what is
known of the sensors. What it was estimated with, prior and effects, is in it
too: under another prior or another model the numbers would mean something else.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.files import OutputError, json_text, read_text_file, write_bytes
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.identifiability import SoilEstimate, Variety
from smallwheel_ros.estimator.law_model import WHEELS
from smallwheel_ros.estimator.settings import EstimatorError, SoilPrior

Array = NDArray[np.float64]

FORMAT = "smallwheel soil state"
_VERSION = 3  # 1, of 0.1.0: without the sensors' faults; 2: without the zero of the load cells
_TOLERANCE = 1e-9  # relative, of the prior's numbers
_MOST_ACCEPTED = 2**32 - 1  # what SoilEstimate.msg can hold
_LARGEST = 1e9  # of any number: loads in N are the largest, and the square of it is finite
_SMALLEST = 1e-9  # of a load or a size, in N and m
_LARGEST_STATE = 40.0  # of any number of the state; the first is ln of a sinkage


@dataclass(frozen=True)
class SoilRecord:
    """A soil's law and what is known of the sensors' faults, but for those of single wheels.

    reference: load (N), diameter, width (m) of the reference wheel. mean, covariance: of the soil's
    numbers (`law_model.LawModel.soil`), shape (WHEELS,) and (WHEELS, WHEELS).
    """

    reference: tuple[float, float, float]
    mean: Array
    covariance: Array


@dataclass(frozen=True)
class SavedState:
    """What a file holds; None: no soil had been measured. strength: as the traction's filter has it."""

    soil: SoilRecord | None
    variety: Variety
    accepted: int
    strength: Any = None


def _made_with(prior: SoilPrior, effects: Sequence[Effect]) -> dict[str, Any]:
    numbers = {entry.name: getattr(prior, entry.name) for entry in fields(prior)}
    return {
        "prior": {**numbers, "soil": prior.soil.name},
        "effects": [{"id": e.id, "form": e.form, **dict(e.values())} for e in effects],
    }


def write_state(
    path: Path, state: SavedState, prior: SoilPrior, effects: Sequence[Effect], now: SoilEstimate
) -> None:
    """Write a file beside and rename it: whole or not at all. Raises EstimatorError where it cannot be.

    now: for people who look into the file.
    """
    soil = state.soil
    summary = (
        f"ln pressure {now.log_reference_pressure:.4f}, n {now.n:.4f}, m {now.m:.4f} after "
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
    }
    with suppress(OSError):  # without the folder the writing says so
        path.parent.mkdir(parents=True, exist_ok=True)
    try:
        write_bytes(path, json_text(content).encode())
    except OutputError as error:
        raise EstimatorError(str(error)) from None


def check_may_replace(path: Path) -> None:
    """Refuse to write over something else than a saved soil. Raises EstimatorError."""
    try:
        if not os.path.lexists(path) or _content(path).get("format") == FORMAT:
            return
    except (OSError, ValueError, RecursionError):
        pass
    raise EstimatorError(
        f"{path}: there is something that is no saved soil, and it is left as it is; remove it, or"
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
    """Read a file. Raises EstimatorError saying what is wrong with it and what to do."""
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
            f"{path}: version {content.get('version')!r} of a saved soil, expected {_VERSION}; "
            "delete the file to begin with the prior"
        )
    try:
        _compare(path, content, _made_with(prior, effects))
        variety = Variety(_pair(content["diameters"]), _pair(content["loadings"]))
        accepted = int(content["accepted"])
        soil = None if content["soil"] is None else _soil(content["soil"])
        strength = content.get("strength")
        if not 0 <= accepted <= _MOST_ACCEPTED:
            raise ValueError(f"accepted is {accepted}")
    except (KeyError, TypeError, ValueError, OverflowError, np.linalg.LinAlgError) as error:
        raise _corrupt(path, f"{type(error).__name__}: {error}") from None
    return SavedState(soil, variety, accepted, strength)


def _corrupt(path: Path, why: str) -> EstimatorError:
    return EstimatorError(
        f"{path}: not a whole saved soil ({why}); delete the file to begin with the prior"
    )


def _compare(path: Path, content: dict[str, Any], expected: dict[str, Any]) -> None:
    found_prior, found_effects = content.get("prior"), content.get("effects")
    if not isinstance(found_prior, dict) or not isinstance(found_effects, list):
        raise _corrupt(path, "prior or effects are missing")
    for name, value in expected["prior"].items():
        found = found_prior.get(name)
        same = found == value
        if isinstance(value, float) and isinstance(found, (int, float)):
            same = math.isclose(found, value, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE)
        if not same:
            raise EstimatorError(
                f"{path}: saved under another prior ({name} {found!r}, now {value!r}); restore the "
                "old setting, or delete the file to begin with the prior"
            )
    if found_effects != expected["effects"]:
        names = [e.get("id") if isinstance(e, dict) else e for e in found_effects]
        raise EstimatorError(
            f"{path}: saved under another model (effects {names}, or other numbers of them); use "
            "that model file, or delete the file to begin with the prior"
        )


def _pair(value: Any) -> tuple[float, float] | None:
    if value is None:
        return None
    low, high = (float(v) for v in value)
    if not _SMALLEST <= low <= high < math.inf:
        raise ValueError(f"{value!r} is no range")
    return low, high


def _soil(content: dict[str, Any]) -> SoilRecord:
    reference, mean, covariance = (
        np.array(content[name], dtype=float) for name in ("reference", "mean", "covariance")
    )
    numbers = np.concatenate([reference.ravel(), mean.ravel(), covariance.ravel()])
    if not np.abs(numbers).max() < _LARGEST:  # NaN too
        raise ValueError("a number is not finite, or too large")
    if reference.shape != (3,) or reference.min() < _SMALLEST or mean.shape != (WHEELS,):
        raise ValueError("reference or mean is no soil")
    check_covariance(covariance, WHEELS)
    if np.abs(mean).max() > _LARGEST_STATE:
        raise ValueError("its soil is outside of the model's range")
    load, diameter, width = reference.tolist()
    return SoilRecord((load, diameter, width), mean, covariance)


def check_covariance(covariance: Array, size: int) -> None:
    """Raise ValueError or LinAlgError for finite numbers that are no covariance of that size."""
    if covariance.shape != (size, size) or not np.allclose(
        covariance, covariance.T, rtol=1e-9, atol=0
    ):
        raise ValueError(f"the covariance is not symmetric, {size} by {size}")
    np.linalg.cholesky(covariance)
