# SPDX-License-Identifier: Apache-2.0
"""A fit as plain values and in words."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from smallwheel_ros.measurements.display import LAW, shown_value, words

if TYPE_CHECKING:
    from smallwheel_ros.fitting.result import FitResult


def fit_document(result: FitResult) -> dict[str, Any]:
    """What a fit found, as plain values in SI units."""
    return {
        "schema": 1,
        "parameters": {p.full_name: p.to_dict() for p in result.parameters},
        "derived": {p.full_name: p.to_dict() for p in result.derived},
        "correlation": {
            "names": list(result.names),
            "matrix": [[float(f"{v:.6g}") for v in row] for row in result.correlation],
        },
        "soils": {s.name: {"k": s.k, "n": s.n, "m": s.m} for s in result.bare.soils},
        "noise": {
            name: {"absolute": n.absolute, "relative": n.relative, "source": n.source}
            for name, n in result.noise.items()
        },
        "run_scatter": dict(result.run_scatter),
        "outliers": result.outliers.tolist(),
        "notes": list(result.notes),
        "held_out_rmse": dict(result.held_out),
    }


def fit_text(result: FitResult) -> str:
    """What a fit found, in words."""
    lines = [LAW, "", "Fitted parameters"]
    lines += [f"  {p.full_name:38s} {p}" for p in result.parameters]
    lines += ["Follows from these", *(f"  {p.full_name:38s} {p}" for p in result.derived)]
    lines.append("Noise of one row")
    for name, noise in result.noise.items():
        size = f"{shown_value(name, noise.absolute)} and {100 * noise.relative:.1f} %"
        lines.append(f"  {words(name)}: {size} (from {noise.source})")
    lines += ["Notes", *[f"  {note}" for note in result.notes]] if result.notes else []
    if result.held_out:
        lines.append("Held-out error (runs left out of the fit)")
    lines += [f"  {words(name)}: {shown_value(name, v)}" for name, v in result.held_out.items()]
    return "\n".join(lines)
