# SPDX-License-Identifier: Apache-2.0
"""What the tests of a lab say, in words for a terminal, and as plain values."""

from __future__ import annotations

from typing import Any

import numpy as np

from smallwheel_ros.display import listed, number
from smallwheel_ros.fitting.result import FittedParameter
from smallwheel_ros.lab.agreement import Agreement
from smallwheel_ros.lab.plate_laws import FittedLaw, PlateLaws
from smallwheel_ros.lab.shear import FittedShearLaw, ShearFit
from smallwheel_ros.lab.shear_curves import normal_stresses
from smallwheel_ros.lab.strength import Strength


def laws_text(laws: PlateLaws) -> str:
    """The laws of size side by side, and which holds where."""
    sizes = listed([f"{1e3 * d:.4g}" for d in laws.diameters])
    lines = [f"Plates of {sizes} mm in {laws.soil}, {laws.runs} runs"]
    for law in laws.laws:
        lines.append(f"  {law.name}: {law.formula}")
        off = (
            ""
            if law.held_out is None
            else (f"; the sinkage of a size left out is off by {_percent(law.held_out)}")
        )
        lines.append(f"    {', '.join(_constant(c) for c in law.constants)}{off}")
    return "\n".join([*lines, *(f"  {said}" for said in which_law(laws))])


def _constant(c: FittedParameter) -> str:
    unit = "" if c.unit == "1" else f" {c.unit}"
    doubt = "" if c.status == "determined" else " (not determined)"
    return f"{c.name} = {number(c.value)} +- {number(c.std, 2)}{unit}{doubt}"


def _percent(share: float) -> str:
    return f"{number(100.0 * share, 2)} %"


def which_law(laws: PlateLaws) -> list[str]:
    """Sentences: which law predicts a plate that it has not seen, and at which depths."""
    best = laws.best
    if best is None:
        return [
            f"Two sizes fit every law: which of them holds cannot be told. Press a third size, outside "
            f"{1e3 * laws.diameters[0]:.4g} to {1e3 * laws.diameters[1]:.4g} mm."
        ]
    said = [_comparison(laws, best)]
    everywhere = tuple(law.name for law in laws.laws)
    ranges: list[tuple[tuple[str, ...], int, int]] = []
    for at in range(len(laws.depths)):
        holding = tuple(law.name for law in laws.laws if laws.holds(law, at))
        first = at
        if ranges and ranges[-1][0] == holding:
            first = ranges.pop()[1]
        ranges.append((holding, first, at))
    if ranges == [(everywhere, 0, len(laws.depths) - 1)]:
        return [
            *said,
            "All hold at all depths that were reached, within what such curves stray by.",
        ]
    return said + [_where_holds(laws, *found) for found in ranges]


def _where_holds(laws: PlateLaws, holding: tuple[str, ...], first: int, last: int) -> str:
    depths = f"From {1e3 * laws.depths[first].low:.2g} to {1e3 * laws.depths[last].high:.2g} mm"
    if len(holding) == len(laws.laws):
        return f"{depths} all hold."
    if holding:
        return f"{depths} {listed(list(holding))} {'holds' if len(holding) == 1 else 'hold'}."
    off = min(max(law.by_depth[first : last + 1]) for law in laws.laws)
    expected = max(d.expected for d in laws.depths[first : last + 1])
    return (
        f"{depths} none holds: the best is off by {_percent(off)}, where curves of the right law stray by "
        f"{_percent(expected)}."
    )


def _comparison(laws: PlateLaws, best: FittedLaw) -> str:
    others = [law for law in laws.laws if law is not best]
    said = ", ".join(f"{law.name}'s {_percent(law.held_out or 0.0)}" for law in others)
    first = (
        f"{best.name}'s law predicts the sinkage of the size left out within "
        f"{_percent(best.held_out or 0.0)}, {said}"
    )
    close = [law.name for law in others if not laws.better(best, law)]
    if close:
        return f"{first}; {len(laws.diameters)} sizes do not tell it from {listed(close, 'or')}."
    return f"{first}."


def shear_text(fit: ShearFit, strength: Strength) -> str:
    """Strength and shape of one soil, and which law its curves follow."""
    runs = fit.plain.runs
    stresses = listed([f"{1e-3 * s:.4g}" for s in normal_stresses([r.curve for r in runs])])
    name = f" of {fit.soil}" if fit.soil else ""
    lines = [
        f"Shear tests{name}: {len(runs)} {'run' if len(runs) == 1 else 'runs'} at {stresses} kPa"
    ]
    for law in (fit.plain, fit.peaked):
        lines.append(f"  {law.law.name}: {law.law.formula}")
        lines.append(f"    {', '.join(_shear_numbers(law))}; {_shape_error(law)}")
    chosen = fit.chosen.law.name
    seen = "a peak" if fit.shows_peak else "no peak"
    lines.append(f"  The curves show {seen}: {chosen} describes them.")
    return "\n".join([*lines, *(f"  note: {note}" for note in strength.notes)])


def _shear_numbers(law: FittedShearLaw) -> list[str]:
    c, friction, log_modulus, *residual = law.values.tolist()
    std = np.sqrt(np.diag(law.covariance))
    phi, phi_std = np.degrees(np.arctan(friction)), np.degrees(std[1] / (1.0 + friction**2))
    modulus = 1e3 * float(np.exp(log_modulus))
    found = [
        f"c = {number(1e-3 * c)} +- {number(1e-3 * std[0], 2)} kPa",
        f"phi = {number(phi)} +- {number(phi_std, 2)} deg",
        f"{'K_w' if residual else 'K'} = {number(modulus)} +- {number(modulus * std[2], 2)} mm",
    ]
    return found + [f"K_r = {number(r)} +- {number(std[3], 2)}" for r in residual]


def _shape_error(law: FittedShearLaw) -> str:
    if law.held_out is None:
        return f"curve off by {_percent(law.runs[0].misfit)} of the strength (in sample: one run)"
    return f"shape of a run left out off by {_percent(law.held_out)} of the strength"


def laws_document(laws: PlateLaws) -> dict[str, Any]:
    """The laws of size as plain values, SI."""
    return {
        "soil": laws.soil,
        "diameters": list(laws.diameters),
        "runs": laws.runs,
        "laws": {
            law.id: {
                "formula": law.formula,
                "source": law.source,
                "constants": {
                    c.name: {"value": c.value, "std": c.std, "unit": c.unit, "status": c.status}
                    for c in law.constants
                },
                "covariance": law.covariance.tolist(),
                "held_out_by_size": law.held_out,
                "by_diameter": [{"diameter": d, "error": e} for d, e in law.by_size.items()],
                "by_depth": [
                    {"from": r.low, "to": r.high, "error": e, "expected": r.expected,
                     "holds": laws.holds(law, at)}
                    for at, (r, e) in enumerate(zip(laws.depths, law.by_depth, strict=False))
                ],
            }
            for law in laws.laws
        },
        "says": which_law(laws),
    }  # fmt: skip


def agreement_document(agreement: Agreement) -> dict[str, Any]:
    """A comparison as plain values, SI."""
    return {
        "soil": agreement.soil,
        "first": agreement.first,
        "second": agreement.second,
        "depth": agreement.depth,
        "diameter": agreement.diameter,
        "pressures": list(agreement.pressures),
        "ratio": agreement.ratio,
        "interval": [agreement.low, agreement.high],
        "agrees": agreement.agrees,
    }


def shear_document(fit: ShearFit, strength: Strength) -> dict[str, Any]:
    """Strength and shape of one soil as plain values, SI."""
    return {
        "soil": fit.soil,
        "follows": fit.chosen.law.id,
        "model": {
            "cohesion": strength.cohesion,
            "friction_angle": strength.friction_angle,
            "shear_displacement": strength.modulus,
            "names": ["cohesion", "friction_angle", "log_shear_displacement"],
            "covariance": strength.covariance.tolist(),
        },
        "parameters": {
            p.name: {"value": p.value, "std": p.std, "unit": p.unit, "status": p.status,
                     "remedy": p.remedy}
            for p in strength.parameters
        },
        "laws": {
            law.law.id: {
                "formula": law.law.formula,
                "source": law.law.source,
                "names": list(law.names),
                "values": law.values.tolist(),
                "covariance": law.covariance.tolist(),
                "held_out": law.held_out,
                "run_scatter": law.scatter.tolist(),
                "runs": [
                    {"run": r.curve.run, "normal_stress": r.curve.normal_stress,
                     "strength": float(r.numbers[0]), "modulus": float(np.exp(r.numbers[1])),
                     "misfit": r.misfit, "displacement": r.curve.travel}
                    for r in law.runs
                ],
            }
            for law in (fit.plain, fit.peaked)
        },
        "notes": list(strength.notes),
    }  # fmt: skip
