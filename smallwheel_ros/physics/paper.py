# SPDX-License-Identifier: Apache-2.0
"""The numbers that the paper prints, computed again, and what of them reproduces.

Meirion-Griffith and Spenko 2011, "A modified pressure-sinkage model for small, rigid wheels on
deformable terrains", J. Terramechanics 48. Loads, measured sinkages and tables are the paper's;
where it does not say at which load or exponent a number was computed, the reading that comes
closest is spelled out and marked as inferred.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import brentq

from smallwheel_ros.physics.sinkage import closed_form_sinkage, compaction_resistance
from smallwheel_ros.physics.soil import SOILS, Soil, effective_modulus

Status = Literal["reproduced", "reproduced under an inferred reading", "not reproduced"]

DIAMETER = 0.17  # m, the paper's wheel on dry sand
WIDTH = 0.085  # m
TABLE_3 = {46.0: 0.330, 84.0: 0.433}  # load (N): error of Bekker's sinkage
LOADS = tuple(TABLE_3)
MEAN_LOAD = 65.0  # N; inferred: the paper names no load for Table 7
BEKKER, MEIRION_GRIFFITH_SPENKO = SOILS["dry_sand_bekker"], SOILS["dry_sand"]


@dataclass(frozen=True)
class PaperLine:
    """One printed number, what we get for it, and under which reading. Units as named."""

    quantity: str
    unit: str
    printed: float
    computed: float
    reading: str
    status: Status


def sinkage(soil: Soil, load: float, exponent: float | None = None) -> float:
    """Sinkage (m) of the paper's wheel by eq. 10 (eq. 7 for m = 0) or with another n."""
    modulus = effective_modulus(soil.k, soil.m, DIAMETER)
    n = soil.n if exponent is None else exponent
    return float(closed_form_sinkage(load, DIAMETER, WIDTH, modulus, n))


def resistance(soil: Soil, depth: float) -> float:
    """Compaction resistance (N) of the paper's wheel at a sinkage (m), by eq. 14."""
    modulus = effective_modulus(soil.k, soil.m, DIAMETER)
    return float(compaction_resistance(depth, WIDTH, modulus, soil.n))


def sinkage_for(soil: Soil, force: float) -> float:
    """Sinkage (m) at which eq. 14 gives a compaction resistance (N)."""
    return float(brentq(lambda depth: resistance(soil, depth) - force, 1e-4, 0.1, xtol=1e-12))


def _line(
    quantity: str, unit: str, printed: float, computed: float, reading: str, *, inferred: bool
) -> PaperLine:
    """Judge a number by the digits that are printed."""
    decimals = len(f"{printed:g}".partition(".")[2])
    agrees = abs(computed - printed) <= 0.5001 * 10.0**-decimals
    status: Status = "not reproduced"
    if agrees:
        status = "reproduced under an inferred reading" if inferred else "reproduced"
    return PaperLine(quantity, unit, printed, computed, reading, status)


def paper_lines() -> tuple[PaperLine, ...]:
    """Every number of Tables 3 and 7 that can be computed, in the paper's order."""
    common = sinkage_for(BEKKER, 50.6)
    bekker = sinkage(BEKKER, MEAN_LOAD)
    newer = sinkage(MEIRION_GRIFFITH_SPENKO, MEAN_LOAD)
    other_n = sinkage(MEIRION_GRIFFITH_SPENKO, MEAN_LOAD, BEKKER.n)
    fixed = f"eq. 14 at a sinkage of {1e3 * common:.1f} mm, which this number fixes"
    at_common = f"eq. 14 at Bekker's {1e3 * common:.1f} mm: one common sinkage, not its own"
    measured = 8.8e-3
    improvement_printed = (8.8 - 5.2) / (9.8 - 8.8)
    lines = [
        _line(
            "Table 7: compaction resistance, Bekker", "N", 50.6,
            resistance(BEKKER, round(common, 4)), fixed, inferred=True,
        ),
        _line(
            "Table 7: compaction resistance, Meirion-Griffith & Spenko", "N", 17.9,
            resistance(MEIRION_GRIFFITH_SPENKO, round(common, 4)), at_common, inferred=True,
        ),
        _line(
            "Table 7: compaction resistance, Meirion-Griffith & Spenko", "N", 17.9,
            resistance(MEIRION_GRIFFITH_SPENKO, newer), "eq. 14 at the sinkage of eq. 10 at 65 N",
            inferred=False,
        ),
        _line(
            "Table 7: sinkage, Bekker", "mm", 5.2, 1e3 * bekker,
            "eq. 7 at 65 N, the mean of 46 and 84 N", inferred=True,
        ),
        _line(
            "Table 7: sinkage, Meirion-Griffith & Spenko", "mm", 9.8, 1e3 * newer,
            "eq. 10 at 65 N with Table 6 (n = 0.80)", inferred=False,
        ),
        _line(
            "Table 7: sinkage, Meirion-Griffith & Spenko", "mm", 9.8, 1e3 * other_n,
            "eq. 10 at 65 N with Table 2's n = 0.75 and the rest of Table 6", inferred=True,
        ),
        _line(
            "improvement of sinkage", "times", round(improvement_printed, 1),
            abs(measured - bekker) / abs(newer - measured),
            "errors at 65 N against the measured 8.8 mm, with Table 6", inferred=False,
        ),
        _line(
            "improvement of resistance", "times", 10.0,
            (50.6 - 20.8) / (20.8 - 17.9), "from the printed 50.6, 17.9 and measured 20.8 N",
            inferred=False,
        ),
    ]  # fmt: skip
    # Table 3 prints errors only: its measured sinkages follow from them, so they check nothing by
    # themselves. Against Table 7's measured sinkage they do.
    implied = [sinkage(BEKKER, load) / (1.0 - error) for load, error in TABLE_3.items()]
    growth = np.log(implied[1] / implied[0]) / np.log(LOADS[1] / LOADS[0])
    at_mean = implied[0] * (MEAN_LOAD / LOADS[0]) ** growth
    lines.append(
        _line(
            "Table 7: measured sinkage", "mm", 8.8, 1e3 * at_mean,
            f"Table 3's errors imply {1e3 * implied[0]:.2f} mm at 46 N and"
            f" {1e3 * implied[1]:.2f} mm at 84 N; between them at 65 N",
            inferred=True,
        )
    )  # fmt: skip
    return tuple(lines)
