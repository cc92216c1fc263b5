# SPDX-License-Identifier: Apache-2.0
"""Certifies wheels: sinkage, resistance, pull and torque from stresses integrated along the arc.

Every force is an integral over the angle, by double exponential quadrature of the stresses themselves, split
where they have a kink; every unknown (sinkage, size of the pressure) is found by a root of the balance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

from mpmath import mp
from precise import Certified, Number, number, write
from reference_file import read_reference

Function = Callable[[Number], Number]
ZERO, ONE = number(0), number(1)


@dataclass(frozen=True)
class Wheel:
    """A wheel and its soil. All SI; peak: place of the largest pressure, of the entry angle."""

    load: Number
    diameter: Number
    width: Number
    k: Number
    n: Number
    m: Number
    cohesion: Number = ZERO
    friction_angle: Number = ZERO
    shear_modulus: Number = ONE
    slip: Number = ZERO
    rolling_share: Number = ONE
    rim_friction: Number = ONE
    peak: Number = ZERO

    @property
    def radius(self) -> Number:
        """r."""
        return self.diameter / 2

    @property
    def modulus(self) -> Number:
        """K = k D^m."""
        return self.k * self.diameter**self.m

    def entry(self, sinkage: Number) -> Number:
        """theta_1."""
        return mp.acos(1 - sinkage / self.radius)

    def depth(self, angle: Number, sinkage: Number) -> Number:
        """Depth below the surface at which the undisturbed soil bears what presses here."""
        entry = self.entry(sinkage)
        top = self.peak * entry
        at = angle
        if angle < top:
            at = entry - angle / top * (entry - top)
        return max(self.radius * (mp.cos(at) - mp.cos(entry)), mp.mpf(0))

    def displacement(self, angle: Number, sinkage: Number) -> Number:
        """j of Wong and Reece (1967), the part of rolling times eta."""
        entry = self.entry(sinkage)
        ratio = 1 - self.slip if self.slip >= 0 else 1 / (1 + self.slip)
        rim = mp.sin(entry) - mp.sin(angle)
        return self.radius * (self.rolling_share * (entry - angle - rim) + (1 - ratio) * rim)

    def shear(self, angle: Number, sinkage: Number, pressure: Number) -> Number:
        """tau of Janosi and Hanamoto (1961), against the displacement."""
        j = self.displacement(angle, sinkage)
        strength = self.cohesion + pressure * mp.tan(self.friction_angle)
        return self.rim_friction * strength * mp.sign(j) * -mp.expm1(-abs(j) / self.shear_modulus)

    def kinks(self, sinkage: Number) -> list[Number]:
        """Angles between which the stresses are smooth: 0, entry, peak, and where soil is not sheared."""
        entry = self.entry(sinkage)
        found = {mp.mpf(0), entry, self.peak * entry}
        grid = [entry * i / 60 for i in range(60)]
        for a, b in pairwise(grid):
            ja, jb = self.displacement(a, sinkage), self.displacement(b, sinkage)
            if ja * jb < 0:
                found.add(mp.findroot(lambda t: self.displacement(t, sinkage), (a, b), "anderson"))
        return sorted(found)

    def forces(self, sinkage: Number, pressure: Function) -> tuple[Number, Number, Number, Number]:
        """Load, thrust, resistance (N) and torque (N m) that the stresses make. pressure: by angle."""
        r, b, arc = self.radius, self.width, self.kinks(sinkage)

        def over(stress: Function) -> Number:
            return b * mp.quad(stress, arc)

        def tau(t: Number) -> Number:
            return self.shear(t, sinkage, pressure(t))

        load = over(lambda t: r * pressure(t) * mp.cos(t) + r * tau(t) * mp.sin(t))
        thrust = over(lambda t: r * tau(t) * mp.cos(t))
        return (
            load,
            thrust,
            over(lambda t: r * pressure(t) * mp.sin(t)),
            over(lambda t: r * r * tau(t)),
        )


def of_soil(wheel: Wheel, sinkage: Number) -> Function:
    """Pressure k D^m z^n at the depth of each angle."""
    return lambda t: wheel.modulus * wheel.depth(t, sinkage) ** wheel.n


def balanced(wheel: Wheel, sinkage: Number) -> Function:
    """Pressure of the same shape, as large as the load asks: from the balance at two sizes."""

    def of_size(size: Number) -> Function:
        return lambda t: size * (wheel.depth(t, sinkage) / sinkage) ** wheel.n

    guess = wheel.load / (wheel.width * wheel.radius)
    first, second = (wheel.forces(sinkage, of_size(a))[0] for a in (guess, 2 * guess))
    return of_size(guess + guess * (wheel.load - first) / (second - first))


def solved_sinkage(wheel: Wheel) -> Number:
    """Sinkage at which the soil's own stresses carry the load."""

    def excess(log_sinkage: Number) -> Number:
        z = mp.exp(log_sinkage)
        arc = wheel.kinks(z)
        press = of_soil(wheel, z)
        up = mp.quad(lambda t: press(t) * mp.cos(t) + wheel.shear(t, z, press(t)) * mp.sin(t), arc)
        return mp.log(wheel.width * wheel.radius * up / wheel.load)

    low, high = mp.log(wheel.radius) - 8, mp.log(wheel.radius)
    with mp.workdps(20):  # a tenth of the time
        near = mp.findroot(excess, (low, high), "anderson", tol=1e-30)
    return mp.exp(mp.findroot(excess, (near, near + mp.mpf(10) ** -15), "secant"))


def closed_form(wheel: Wheel) -> Number:
    """Sinkage of eq. 10 (Meirion-Griffith and Spenko 2011); eq. 7 where m = 0."""
    base = (
        3 * wheel.load / (wheel.width * (3 - wheel.n) * wheel.k * wheel.diameter ** (wheel.m + 0.5))
    )
    return base ** (2 / (2 * wheel.n + 1))


def contact_integral() -> None:
    """Sinkage under load without slip, resistance of compaction, and sinkage of the closed form."""
    found = []
    for case, *given in read_reference("contact_integral").rows:
        wheel = Wheel(*map(number, given))
        z = solved_sinkage(wheel)
        resistance = wheel.forces(z, of_soil(wheel, z))[2]
        found += [
            Certified(f"{case}.sinkage", z, None, "m"),
            Certified(f"{case}.compaction_resistance", resistance, None, "N"),
            Certified(f"{case}.closed_form_sinkage", closed_form(wheel), None, "m"),
        ]
    write("contact_integral", found)


def with_shear(row: tuple[str, ...]) -> Wheel:
    """The wheel of a row of `wheel_forces` or `wong_reece_1967`."""
    values = [number(v) for v in row[1:]]
    values[7] = values[7] * mp.pi / 180  # friction angle
    return Wheel(*values)


def forces_of(case: str, wheel: Wheel, sinkage: Number, pressure: Function) -> list[Certified]:
    """Sinkage and forces of one case."""
    _, thrust, resistance, torque = wheel.forces(sinkage, pressure)
    return [
        Certified(f"{case}.sinkage", sinkage, None, "m"),
        Certified(f"{case}.thrust", thrust, None, "N"),
        Certified(f"{case}.rolling_resistance", resistance, None, "N"),
        Certified(f"{case}.drawbar_pull", thrust - resistance, None, "N"),
        Certified(f"{case}.torque", torque, None, "N m"),
    ]


def wheel_forces() -> None:
    """Pull and torque of the balance along the arc, at the sinkage of the load without slip."""
    found = []
    for row in read_reference("wheel_forces").rows:
        wheel = with_shear(row)
        z = solved_sinkage(Wheel(*map(number, row[1:7])))
        found += forces_of(row[0], wheel, z, balanced(wheel, z))
    write("wheel_forces", found)


def wong_reece() -> None:
    """The same with the soil's own pressure, which with its shear carries the load."""
    found = []
    for row in read_reference("wong_reece_1967").rows:
        wheel = with_shear(row)
        z = solved_sinkage(wheel)
        found += forces_of(row[0], wheel, z, of_soil(wheel, z))
    write("wong_reece_1967", found)
