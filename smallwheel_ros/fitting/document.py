# SPDX-License-Identifier: Apache-2.0
"""A fit as plain values and in words."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from smallwheel_ros.measurements.display import LAW, number, shown_value, words

if TYPE_CHECKING:
    from smallwheel_ros.fitting.result import FitResult


def fit_document(result: FitResult) -> dict[str, Any]:
    """What a fit found, as plain values in SI units."""
    return {
        "schema": 1,
        "parameters": {
            p.full_name: {
                "value": p.value,
                "std": p.std,
                "unit": p.unit,
                "status": p.status,
                "remedy": p.remedy,
            }
            for p in result.parameters
        },
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
    for p in result.parameters:
        unit = "" if p.unit == "1" else f" {p.unit}"
        std = "" if p.std is None else f" +- {number(p.std)}"
        said = "" if p.status == "determined" else f"  ({p.status})"
        lines.append(f"  {p.full_name:38s} {number(p.value, 4)}{std}{unit}{said}")
    for soil in result.bare.soils:
        lines.append(
            f"  {soil.name}: k = {soil.k:.4g} Pa/m^(n+m), n = {soil.n:.4g}, m = {soil.m:.4g}"
        )
    lines.append("Noise of one row")
    for name, noise in result.noise.items():
        size = f"{shown_value(name, noise.absolute)} and {100 * noise.relative:.1f} %"
        lines.append(f"  {words(name)}: {size} (from {noise.source})")
    lines += ["Notes", *[f"  {note}" for note in result.notes]] if result.notes else []
    if result.held_out:
        lines.append("Held-out error (runs left out of the fit)")
    lines += [f"  {words(name)}: {shown_value(name, v)}" for name, v in result.held_out.items()]
    return "\n".join(lines)
