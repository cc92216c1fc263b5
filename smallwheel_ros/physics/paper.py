# SPDX-License-Identifier: Apache-2.0
"""The paper's tables and equations, computed again, and which of them reproduce.

Meirion-Griffith and Spenko 2011, "A modified pressure-sinkage model for small, rigid wheels on
deformable terrains", J. Terramechanics 48. Loads, measured sinkages and tables are the paper's.
Where it does not say at which load or exponent a number was computed, the assumption that comes
closest is stated and marked as inferred.

Printed values are typed from the paper once more, so that they check the library's soils
(`physics.soil`); equations are written out once more, so that they check its functions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq

from smallwheel_ros.physics.contact import contact_load, contact_sinkage
from smallwheel_ros.physics.sinkage import closed_form_sinkage, compaction_resistance
from smallwheel_ros.physics.soil import SOILS, Soil, bekker_modulus, effective_modulus
from smallwheel_ros.physics.traction import contact_length, thrust

# taken over: an input of the paper that the library has, too.
# follows: not printed in the paper, but implied by numbers that are.
Status = Literal[
    "reproduced", "reproduced under an inferred reading", "not reproduced", "taken over", "follows"
]

DIAMETER = 0.17  # m, the paper's wheel on dry sand
WIDTH = 0.085  # m
TABLE_3 = {46.0: 0.330, 84.0: 0.433}  # load (N): error of Bekker's sinkage
LOADS = tuple(TABLE_3)
MEAN_LOAD = 65.0  # N; inferred: the paper names no load for Table 7
BEKKER, MEIRION_GRIFFITH_SPENKO = SOILS["dry_sand_bekker"], SOILS["dry_sand"]


SLIP = 0.3  # at which eq. 2 is evaluated; the paper names none
# As the paper prints them: k in kN/m^(n+m+2), cohesion in kPa, friction angle in degrees.
TABLE_1 = {"diameter": (DIAMETER, "m"), "width": (WIDTH, "m"), "speed": (10.0, "cm/s")}
TABLE_2 = {"dry_sand_bekker": {"cohesion": 2.05, "friction_angle": 27.5, "n": 0.75, "k": 1783.0}}
TABLE_4 = {
    "wong_sandy_loam": {"k": 1515.0, "n": 0.7},
    "wong_heavy_clay": {"k": 1556.0, "n": 0.13},
    "wong_snow": {"k": 197.0, "n": 1.6},
    "wong_dry_sand": {"k": 1528.0, "n": 1.1},
}
TABLE_5 = {
    "dry_sand": {"cohesion": 2.05, "friction_angle": 27.2},
    "calcium_silicate": {"cohesion": 3.08, "friction_angle": 32.2},
    "moist_earth": {"cohesion": 3.13, "friction_angle": 34.0},
}
TABLE_6 = {
    "dry_sand": {"k": 1604.0, "n": 0.8, "m": 0.39},
    "calcium_silicate": {"k": 17.0, "n": 0.48, "m": 0.0},
    "moist_earth": {"k": 79.0, "n": 0.88, "m": -0.49},
}
_UNITS = {"k": ("kN/m^(n+m+2)", 1e-3), "cohesion": ("kPa", 1e-3),
          "friction_angle": ("deg", 180.0 / np.pi), "n": ("1", 1.0), "m": ("1", 1.0)}  # fmt: skip


@dataclass(frozen=True)
class PaperLine:
    """One number of Meirion-Griffith and Spenko's paper of 2011, and the library's value of it.

    Attributes
    ----------
    place
        The table or equation, such as `Table 3` or `eq. 7`.
    quantity, unit
        Name of the quantity, and the unit of both values.
    printed
        The number that is printed, or that a printed equation gives; None if the paper prints none.
    computed
        The library's value.
    reading
        The assumption under which the library's value was computed, in words.
    status
        Whether the two agree; see `Status`.
    """

    place: str
    quantity: str
    unit: str
    printed: float | None
    computed: float
    reading: str
    status: Status


def sinkage(soil: Soil, load: float, exponent: float | None = None) -> float:
    """Sinkage (m) of the wheel of Meirion-Griffith and Spenko 2011, by its eq. 10 (eq. 7 for m = 0).

    The wheel has a diameter of 0.17 m and a width of 0.085 m.

    Parameters
    ----------
    soil
        Soil, of which k, n and m are used.
    load
        Normal load, N.
    exponent
        Exponent n to use instead of the soil's; None: the soil's.
    """
    modulus = effective_modulus(soil.k, soil.m, DIAMETER)
    n = soil.n if exponent is None else exponent
    return float(closed_form_sinkage(load, DIAMETER, WIDTH, modulus, n))


def resistance(soil: Soil, depth: float) -> float:
    """Compaction resistance (N) of the wheel of Meirion-Griffith and Spenko 2011, by its eq. 14.

    The wheel has a diameter of 0.17 m and a width of 0.085 m.

    Parameters
    ----------
    soil
        Soil, of which k, n and m are used.
    depth
        Sinkage, m.
    """
    modulus = effective_modulus(soil.k, soil.m, DIAMETER)
    return float(compaction_resistance(depth, WIDTH, modulus, soil.n))


def sinkage_for(soil: Soil, force: float) -> float:
    """Sinkage (m) at which eq. 14 of Meirion-Griffith and Spenko 2011 gives a compaction resistance.

    The wheel is the paper's, with a diameter of 0.17 m and a width of 0.085 m.

    Parameters
    ----------
    soil
        Soil, of which k, n and m are used.
    force
        Compaction resistance, N.

    Raises
    ------
    ValueError
        If the sinkage is not between 0.1 mm and 100 mm.
    """
    return float(brentq(lambda depth: resistance(soil, depth) - force, 1e-4, 0.1, xtol=1e-12))


def _line(
    place: str, quantity: str, unit: str, printed: float, computed: float, reading: str, *, inferred: bool
) -> PaperLine:  # fmt: skip
    """Judge a number by the digits that are printed."""
    decimals = len(f"{printed:g}".partition(".")[2])
    agrees = abs(computed - printed) <= 0.5001 * 10.0**-decimals
    status: Status = "not reproduced"
    if agrees:
        status = "reproduced under an inferred reading" if inferred else "reproduced"
    return PaperLine(place, quantity, unit, printed, computed, reading, status)


def paper_lines() -> tuple[PaperLine, ...]:
    """Every number of Tables 1 to 7 and of equations 1 to 14, in the paper's order."""
    tables = (*_inputs(), *_table_3(), *table_7())
    return (*sorted(tables, key=lambda line: line.place), *_equations())


def _inputs() -> list[PaperLine]:
    """Tables 1, 2, 4, 5 and 6: the paper's input values, next to those of the library."""
    lines = [
        PaperLine(
            "Table 1", name, unit, value, value, "the wheel of all that follows", "taken over"
        )
        for name, (value, unit) in TABLE_1.items()
    ]
    lines += [
        PaperLine("Table 1", "load", "N", load, load, "the loads of Table 3", "taken over")
        for load in LOADS
    ]
    for place, table in (
        ("Table 2", TABLE_2), ("Table 4", TABLE_4), ("Table 5", TABLE_5), ("Table 6", TABLE_6)
    ):  # fmt: skip
        for soil, numbers in table.items():
            for name, printed in numbers.items():
                unit, factor = _UNITS[name]
                found = factor * float(getattr(SOILS[soil], name))
                same = abs(found - printed) < 1e-9 * abs(printed) + 1e-12
                lines.append(
                    PaperLine(
                        place, f"{soil}, {name.replace('_', ' ')}", unit, printed, found,
                        f"the library's {soil}", "taken over" if same else "not reproduced",
                    )
                )  # fmt: skip
    return lines


def implied_sinkages() -> list[float]:
    """Measured sinkages (m) at `LOADS` that Table 3's errors imply: eq. 7 divided by (1 - error)."""
    return [sinkage(BEKKER, load) / (1.0 - error) for load, error in TABLE_3.items()]


def _table_3() -> list[PaperLine]:
    """Measured sinkages that Table 3 implies, and the errors of eq. 10 and of the exact contact there."""
    lines = []
    soil = MEIRION_GRIFFITH_SPENKO
    modulus = effective_modulus(soil.k, soil.m, DIAMETER)
    for (load, error), measured in zip(TABLE_3.items(), implied_sinkages(), strict=True):
        exact = float(contact_sinkage(load, DIAMETER, WIDTH, modulus, soil.n).sinkage)
        of = f"at {load:g} N"
        for quantity, unit, value, reading in (
            (f"measured sinkage {of}", "mm", 1e3 * measured,
             f"eq. 7 under-predicts by {100 * error:g} %"),
            (f"over-prediction of eq. 10 {of}", "%", 100.0 * (sinkage(soil, load) / measured - 1.0),
             "with Table 6"),
            (f"over-prediction of the exact contact integral {of}", "%",
             100.0 * (exact / measured - 1.0), "with Table 6; eq. 3 solved without a series"),
        ):  # fmt: skip
            lines.append(PaperLine("Table 3", quantity, unit, None, value, reading, "follows"))
    at_mean = 100.0 * (1.0 - sinkage(BEKKER, MEAN_LOAD) / 8.8e-3)
    lines.append(
        PaperLine(
            "Table 3", "under-prediction of eq. 7 at 65 N", "%", None, at_mean,
            "by Table 7's measured 8.8 mm: between the printed 33.0 and 43.3 %", "follows",
        )
    )  # fmt: skip
    return lines


def table_7() -> tuple[PaperLine, ...]:
    """Every number of Table 7, with its measured sinkages as Table 3 implies them."""
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
            "Table 7", "compaction resistance, Bekker", "N", 50.6,
            resistance(BEKKER, round(common, 4)), fixed, inferred=True,
        ),
        _line(
            "Table 7", "compaction resistance, Meirion-Griffith & Spenko", "N", 17.9,
            resistance(MEIRION_GRIFFITH_SPENKO, round(common, 4)), at_common, inferred=True,
        ),
        _line(
            "Table 7", "compaction resistance, Meirion-Griffith & Spenko", "N", 17.9,
            resistance(MEIRION_GRIFFITH_SPENKO, newer), "eq. 14 at the sinkage of eq. 10 at 65 N",
            inferred=False,
        ),
        _line(
            "Table 7", "sinkage, Bekker", "mm", 5.2, 1e3 * bekker,
            "eq. 7 at 65 N, the mean of 46 and 84 N", inferred=True,
        ),
        _line(
            "Table 7", "sinkage, Meirion-Griffith & Spenko", "mm", 9.8, 1e3 * newer,
            "eq. 10 at 65 N with Table 6 (n = 0.80)", inferred=False,
        ),
        _line(
            "Table 7", "sinkage, Meirion-Griffith & Spenko", "mm", 9.8, 1e3 * other_n,
            "eq. 10 at 65 N with Table 2's n = 0.75 and the rest of Table 6", inferred=True,
        ),
        _line(
            "Table 7", "improvement of sinkage", "times", round(improvement_printed, 1),
            abs(measured - bekker) / abs(newer - measured),
            "errors at 65 N against the measured 8.8 mm, with Table 6", inferred=False,
        ),
        _line(
            "Table 7", "improvement of resistance", "times", 10.0,
            (50.6 - 20.8) / (20.8 - 17.9), "from the printed 50.6, 17.9 and measured 20.8 N",
            inferred=False,
        ),
    ]  # fmt: skip
    # Table 3 prints errors only: its measured sinkages follow from them, so they check nothing by
    # themselves. Against Table 7's measured sinkage they do.
    implied = implied_sinkages()
    growth = np.log(implied[1] / implied[0]) / np.log(LOADS[1] / LOADS[0])
    at_mean = implied[0] * (MEAN_LOAD / LOADS[0]) ** growth
    lines.append(
        _line(
            "Table 7", "measured sinkage", "mm", 8.8, 1e3 * at_mean,
            f"Table 3's errors imply {1e3 * implied[0]:.2f} mm at 46 N and"
            f" {1e3 * implied[1]:.2f} mm at 84 N; between them at 65 N",
            inferred=True,
        )
    )  # fmt: skip
    return tuple(lines)


def _equations() -> list[PaperLine]:
    """Equations 1 to 14 written out for the paper's wheel, next to what the library's functions give."""
    load, soil, bekker = LOADS[0], MEIRION_GRIFFITH_SPENKO, BEKKER
    r, kappa = 0.5 * DIAMETER, bekker.shear_displacement
    modulus = soil.k * DIAMETER**soil.m
    deep = sinkage(bekker, load)
    exact = float(contact_sinkage(load, DIAMETER, WIDTH, modulus, soil.n).sinkage)
    of_six = sinkage(soil, load)
    length = float(contact_length(deep, DIAMETER))
    shear = (bekker.cohesion, bekker.friction_angle)

    def around(depth: float, part: Callable[[float], float]) -> float:
        """Integral of p(theta) part(theta) over the contact at a sinkage (m), with p (Pa) of eq. 9."""
        cosine = 1.0 - depth / r
        return float(
            quad(
                lambda t: modulus * max(r * (np.cos(t) - cosine), 0.0) ** soil.n * part(t),
                0.0, np.arccos(cosine), epsabs=0.0, epsrel=1e-11, limit=200,
            )[0]
        )  # fmt: skip

    def pushed(form: Literal["integrated", "exponential"], slip: float, modulus: float) -> float:
        return float(thrust(load, slip, deep, DIAMETER, WIDTH, *shear, modulus, form))

    limit = WIDTH * length * bekker.cohesion + load * np.tan(bekker.friction_angle)
    of_wheel = f"Table 2, {load:g} N, sunk by eq. 7"
    work = quad(lambda z: modulus * z**soil.n, 0.0, of_six, epsabs=0.0, epsrel=1e-11)[0]
    written = [
        ("eq. 1", "ideal thrust", "N", limit, pushed("exponential", 1.0, 1e-6), of_wheel),
        ("eq. 2", f"thrust at slip {SLIP:g}", "N", limit * (1.0 - np.exp(-SLIP * length / kappa)),
         pushed("exponential", SLIP, kappa), f"{of_wheel}; kappa {1e3 * kappa:g} mm is ours"),
        ("eq. 3", "load on the arc", "N", WIDTH * r * around(exact, np.cos),
         float(contact_load(exact, DIAMETER, WIDTH, modulus, soil.n)), "Table 6, the exact contact"),
        ("eq. 4", "load over the ground, dx = r cos(theta) d theta", "N",
         WIDTH * around(exact, lambda t: r * float(np.cos(t))), load, "Table 6, the exact contact"),
        ("eq. 5", "pressure at 10 mm", "kPa", 1e-3 * bekker.k * 0.01**bekker.n,
         1e-3 * float(bekker_modulus(0.0, bekker.k, WIDTH)) * 0.01**bekker.n,
         "Table 2; the paper does not split k, so k_c = 0"),
        ("eq. 6", "load at eq. 7's sinkage", "N",
         WIDTH * bekker.k * np.sqrt(DIAMETER) * deep ** (bekker.n + 0.5) * (3.0 - bekker.n) / 3.0,
         load, "Table 2, with the square root of D"),
        ("eq. 7", f"sinkage at {load:g} N", "mm",
         1e3 * (3.0 * load / (WIDTH * (3.0 - bekker.n) * bekker.k * np.sqrt(DIAMETER)))
         ** (2.0 / (2.0 * bekker.n + 1.0)), 1e3 * deep, "Table 2, with the square root of D"),
        ("eq. 8", "pressure at 10 mm, calcium silicate", "kPa", 17.0 * 0.01**0.48,
         1e-3 * SOILS["calcium_silicate"].k * 0.01 ** SOILS["calcium_silicate"].n, "Table 6, m = 0"),
        ("eq. 9", "pressure at 10 mm, D = 0.17 m", "kPa", 1604.0 * 0.01**0.8 * 0.17**0.39,
         1e-3 * float(effective_modulus(soil.k, soil.m, DIAMETER)) * 0.01**soil.n, "Table 6, dry sand"),
        ("eq. 10", f"sinkage at {load:g} N", "mm",
         1e3 * (3.0 * load / (WIDTH * (3.0 - soil.n) * soil.k * DIAMETER ** (soil.m + 0.5)))
         ** (2.0 / (2.0 * soil.n + 1.0)), 1e3 * of_six, "Table 6, dry sand"),
        ("eq. 11", "backward part of the pressure", "N",
         WIDTH * r * around(of_six, lambda t: float(np.sin(t))), resistance(soil, of_six),
         "Table 6 at eq. 10's sinkage: the arc's integral is eq. 13's"),
        ("eq. 12", "compaction resistance, Bekker", "N",
         WIDTH * quad(lambda z: bekker.k * z**bekker.n, 0.0, deep, epsabs=0.0, epsrel=1e-11)[0],
         resistance(bekker, deep), "Table 2 at eq. 7's sinkage"),
        ("eq. 13", "compaction resistance", "N", WIDTH * work, resistance(soil, of_six),
         "Table 6 at eq. 10's sinkage"),
        ("eq. 14", "compaction resistance", "N",
         WIDTH * soil.k * DIAMETER**soil.m * of_six ** (soil.n + 1.0) / (soil.n + 1.0),
         resistance(soil, of_six), "Table 6 at eq. 10's sinkage"),
    ]  # fmt: skip
    return [
        PaperLine(
            place, quantity, unit, float(by_hand), float(found), reading,
            "reproduced" if abs(found - by_hand) <= 1e-9 * abs(by_hand) else "not reproduced",
        )
        for place, quantity, unit, by_hand, found, reading in written
    ]  # fmt: skip
