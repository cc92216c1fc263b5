# SPDX-License-Identifier: Apache-2.0
"""Certifies what Meirion-Griffith and Spenko (2011) print, from their tables and equations alone.

Sinkages are roots of the closed form's balance of load, resistances integrals of the pressure over depth.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpmath import mp
from precise import Certified, Number, number, write
from reference_file import read_reference

DIAMETER, WIDTH = number("0.17"), number("0.085")
MEAN_LOAD = number(65)  # inferred: the paper names none for Table 7
ERRORS = {"46": "0.330", "84": "0.433"}  # Table 3: load, error of Bekker's sinkage


@dataclass(frozen=True)
class Soil:
    """k in Pa/m^(n+m), n and m of one table."""

    k: Number
    n: Number
    m: Number

    @property
    def modulus(self) -> Number:
        """K = k D^m."""
        return self.k * DIAMETER**self.m

    def sinkage(self, load: Number) -> Number:
        """Root of W = b K sqrt(D) z^(n+1/2) (3 - n)/3, which eq. 7 and 10 solve."""

        def excess(log_z: Number) -> Number:
            borne = WIDTH * self.modulus * mp.sqrt(DIAMETER) * (3 - self.n) / 3
            return mp.log(borne) + (self.n + 0.5) * log_z - mp.log(load)

        return mp.exp(mp.findroot(excess, mp.log("0.01")))

    def resistance(self, sinkage: Number) -> Number:
        """b Int K z^n dz (eq. 14)."""
        return WIDTH * mp.quad(lambda z: self.modulus * z**self.n, [0, sinkage])

    def sinkage_of_resistance(self, force: Number) -> Number:
        """Sinkage at which eq. 14 gives a force."""
        return mp.findroot(lambda z: self.resistance(z) - force, (0.01, 0.02), "anderson")


BEKKER = Soil(number("1783e3"), number("0.75"), number(0))  # Table 2
PROPOSED = Soil(number("1604e3"), number("0.80"), number("0.39"))  # Table 6
OTHER_N = Soil(PROPOSED.k, BEKKER.n, PROPOSED.m)

_INFERRED, _STATED = "reproduced under an inferred reading", "reproduced"


def verdict(printed: str, found: Number, *, inferred: bool) -> str:
    """Whether a number rounds to what is printed."""
    decimals = len(printed.partition(".")[2])
    if abs(found - number(printed)) > mp.mpf(10) ** -decimals * number("0.5001"):
        return "not reproduced"
    return _INFERRED if inferred else _STATED


def implied() -> list[Number]:
    """Measured sinkages that Table 3's errors imply, mm."""
    return [1000 * BEKKER.sinkage(number(w)) / (1 - number(e)) for w, e in ERRORS.items()]


def between() -> Number:
    """These at 65 N, by a power of the load, mm."""
    light, heavy = implied()
    growth = mp.log(heavy / light) / mp.log(number(84) / number(46))
    return light * (MEAN_LOAD / number(46)) ** growth


def paper() -> None:
    """Tables 3 and 7."""
    common = mp.nint(BEKKER.sinkage_of_resistance(number("50.6")) * 10000) / 10000
    error = abs(number("8.8") - 1000 * BEKKER.sinkage(MEAN_LOAD))
    improved = error / abs(1000 * PROPOSED.sinkage(MEAN_LOAD) - number("8.8"))
    lines: list[tuple[str, str, str, Number, bool]] = [
        ("resistance_bekker", "50.6", "N", BEKKER.resistance(common), True),
        ("resistance_common_sinkage", "17.9", "N", PROPOSED.resistance(common), True),
        ("resistance_own_sinkage", "17.9", "N", PROPOSED.resistance(PROPOSED.sinkage(MEAN_LOAD)), False),
        ("sinkage_bekker", "5.2", "mm", 1000 * BEKKER.sinkage(MEAN_LOAD), True),
        ("sinkage_table_6", "9.8", "mm", 1000 * PROPOSED.sinkage(MEAN_LOAD), False),
        ("sinkage_table_2_n", "9.8", "mm", 1000 * OTHER_N.sinkage(MEAN_LOAD), True),
        ("improvement_sinkage", "3.6", "1", improved, False),
        ("improvement_resistance", "10", "1", number("29.8") / number("2.9"), False),
        ("measured_sinkage", "8.8", "mm", between(), True),
    ]  # fmt: skip
    rows = read_reference("paper_2011").rows
    found = [Certified(name, value, None, unit) for name, _, unit, value, _ in lines]
    for row, (name, printed, _, value, inferred) in zip(rows, lines, strict=True):
        assert row[:2] == (name, printed), row
        assert row[3] == verdict(printed, value, inferred=inferred), row
    write("paper_2011", found)
