"""The estimate in a file, so that a restart on the same soil goes on where it was.

JSON, written whole or not at all. It holds the newest soil without the wheels' spots: after a
restart nobody knows where the wheels stand. What it was estimated with, prior and effects, is in it
too: under another prior or another model the numbers would mean something else.
"""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.identifiability import Variety
from smallwheel_ros.estimator.saved_strength import (
    StrengthRecord,
    strength_content,
    strength_record,
)
from smallwheel_ros.estimator.settings import EstimatorError, SoilPrior

Array = NDArray[np.float64]

FORMAT = "smallwheel soil state"
_VERSION = 1
_TOLERANCE = 1e-9  # relative, of the prior's numbers
_LAW = 3
_LARGEST_LOG = 40.0  # of sinkage
_BEYOND = 0.12  # of q, see `bounded_exponent`


@dataclass(frozen=True)
class SoilRecord:
    """A soil's filter without the spots.

    reference: load (N), diameter, width (m) of the reference wheel (see `coordinates`). mean: of the
    prior, (ln z_ref, q, m), shape (3,); deviation from it; covariance and that of the prior, (3, 3).
    """

    reference: tuple[float, float, float]
    mean: Array
    deviation: Array
    covariance: Array
    prior: Array


@dataclass(frozen=True)
class SavedState:
    """What a file holds; None: no soil, or no drawbar pull, had been measured."""

    soil: SoilRecord | None
    variety: Variety
    accepted: int
    strength: StrengthRecord | None = None


def _made_with(prior: SoilPrior, effects: Sequence[Effect]) -> dict[str, Any]:
    return {
        "prior": {
            "soil": prior.soil.name,
            "log_reference_pressure": prior.log_reference_pressure,
            "n": prior.n,
            "m": prior.m,
            "log_reference_pressure_std": prior.log_reference_pressure_std,
            "n_std": prior.n_std,
            "m_std": prior.m_std,
        },
        "effects": [{"id": e.id, "form": e.form, **dict(e.values())} for e in effects],
    }


def write_state(
    path: Path, state: SavedState, prior: SoilPrior, effects: Sequence[Effect], summary: str
) -> None:
    """Write a file whole or not at all. Raises EstimatorError where it cannot be written."""
    soil = state.soil
    content = {
        "format": FORMAT,
        "version": _VERSION,
        "summary": summary,
        **_made_with(prior, effects),
        "accepted": state.accepted,
        "diameters": state.variety.diameters,
        "loadings": state.variety.loadings,
        "soil": None
        if soil is None
        else {
            "reference": soil.reference,
            "mean": soil.mean.tolist(),
            "deviation": soil.deviation.tolist(),
            "covariance": soil.covariance.tolist(),
            "prior_covariance": soil.prior.tolist(),
        },
        "strength": strength_content(state.strength),
    }
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(
            "w", dir=path.parent, prefix=f".{path.name}.", delete=False, encoding="utf-8"
        ) as stream:
            temporary = stream.name
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except OSError as error:
        if temporary is not None and os.path.exists(temporary):
            os.unlink(temporary)
        raise EstimatorError(
            f"{path}: the soil cannot be saved there: {error.strerror or error}"
        ) from None


def read_state(path: Path, prior: SoilPrior, effects: Sequence[Effect]) -> SavedState:
    """Read a file. Raises EstimatorError saying what is wrong with it and what to do."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise EstimatorError(
            f"{path}: no saved soil can be read there: {error.strerror or error}"
        ) from None
    except ValueError as error:  # not UTF-8, or not JSON
        raise _corrupt(path, str(error)) from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise _corrupt(path, f"expected a file of format '{FORMAT}'")
    if content.get("version") != _VERSION:
        raise EstimatorError(
            f"{path}: version {content.get('version')!r} of a saved soil, expected {_VERSION}; "
            "delete the file to begin with the prior"
        )
    _compare(path, content, _made_with(prior, effects))
    try:
        variety = Variety(_pair(content["diameters"]), _pair(content["loadings"]))
        accepted = int(content["accepted"])
        soil = None if content["soil"] is None else _soil(content["soil"])
        strength = strength_record(content.get("strength"))  # older files have none
        if accepted < 0:
            raise ValueError("accepted is negative")
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
    if not 0.0 < low <= high < math.inf:
        raise ValueError(f"{value!r} is no range")
    return low, high


def _soil(content: dict[str, Any]) -> SoilRecord:
    reference = np.array(content["reference"], dtype=float)
    mean, deviation = (np.array(content[name], dtype=float) for name in ("mean", "deviation"))
    covariance, prior = (
        np.array(content[name], dtype=float) for name in ("covariance", "prior_covariance")
    )
    if not (reference.shape == mean.shape == deviation.shape == (_LAW,)) or reference.min() <= 0:
        raise ValueError("reference, mean or deviation is no soil")
    for matrix in (covariance, prior):
        if matrix.shape != (_LAW, _LAW) or not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0):
            raise ValueError("a covariance is not symmetric, 3 by 3")
        np.linalg.cholesky(matrix)
    if not np.isfinite(np.concatenate([reference, mean, deviation, covariance.ravel()])).all():
        raise ValueError("a number is not finite")
    law = mean + deviation
    if np.abs(law[0]) > _LARGEST_LOG or not -_BEYOND < law[1] < 3.0 + _BEYOND or abs(law[2]) > 3.0:
        raise ValueError("its soil is outside of the model's range")
    load, diameter, width = reference.tolist()
    return SoilRecord((load, diameter, width), mean, deviation, covariance, prior)
